"""The whole experiment, from the anatomy to the verdicts (thesis chapters 3 to 5)."""

import contextlib
import hashlib
import shutil
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.columns import EM_COLUMNS, LANDMARK_COLUMNS
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import Settings
from ursnav_torch.files import Progress, no_progress, write_csv, write_json
from ursnav_torch.geometry import Array, apply
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.localization import Localizer, learn_confidence
from ursnav_torch.registration import Registration, RegistrationWarning, register_landmarks
from ursnav_torch.runs.validate import Verdicts, judge_matches, verdict_report
from ursnav_torch.simulation import EmField, World, make_twin
from ursnav_torch.thesis.drive import RobotDrive, choose_pictures, drive_robot
from ursnav_torch.thesis.series import DrawnPictures, Matched, draw_pictures, match_pictures
from ursnav_torch.thesis.settings import ProtocolSettings
from ursnav_torch.thesis.touch import find_views, read_em, touch_landmarks
from ursnav_torch.thesis.views import hand_collected, simulation_poses
from ursnav_torch.vid import MakeRenderer, PlanSettings, Vid, build_vid, load_vid


@dataclass(frozen=True, slots=True)
class Pipeline:
    """What the experiment tests.

    Attributes:
        camera: the lens. features: settings of the extractor.
        make_renderer: called as ``make_renderer(mesh, camera)``; draws the views.
        views: which views to draw.
        make_localizer: called with the VID.
        calibrate: learn from simulated pictures how far an answer can be trusted.
        workers: processes for building the VID; None takes all cores.
    """

    camera: Camera
    features: Settings
    make_renderer: MakeRenderer
    views: PlanSettings
    make_localizer: Callable[[Vid], Localizer]
    calibrate: bool = True
    workers: int | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """All that came out; mm at the kidney's scale.

    Attributes:
        simulation, phantom: the two series of pictures.
        registration: EM to kidney; landmarks_kidney, landmarks_em: (N, 3) what it was computed from.
        registration_error_mm: its root mean square error over the kidney, which only a simulation knows.
        reference: (K,) rows of the phantom pictures whose view was looked up, T_reference (K, 4, 4) where.
        verdicts: of the EM sensor on the phantom pictures' matches.
        drive: of the robot.
    """

    vid: Vid
    simulation: Matched
    phantom: Matched
    registration: Registration
    landmarks_kidney: Array
    landmarks_em: Array
    registration_error_mm: float
    reference: NDArray[np.int64]
    T_reference: Array
    verdicts: Verdicts
    drive: RobotDrive


def perform(
    kidney: Kidney, pipeline: Pipeline, settings: ProtocolSettings, work: Path, progress: Progress = no_progress
) -> Outcome:
    """Do the experiment in folder ``work``, which gets ``vid/``, ``simulation/``, ``phantom/``, CSV and JSON files.

    A VID that stands in ``work`` from an interrupted run of the same experiment is used again.

    Args:
        kidney: the phantom.
        pipeline: what is tested. settings: how.
        work: folder to work in.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.

    Raises:
        InputError: a calyx has no room for the scope, or the robot can take no pictures.
    """
    lumen, em = LumenDistance.from_kidney(kidney), replace(settings.em)
    renderer = pipeline.make_renderer(kidney.mesh, pipeline.camera)
    twin = make_twin(World(kidney, renderer, lumen), settings.scope, em)
    T_start = twin.pose()
    vid = _prepared_vid(kidney, lumen, pipeline, settings, T_start, work, progress)
    rng = np.random.default_rng(settings.seed)
    poses, calyx = simulation_poses(settings, kidney, lumen, T_start)
    simulation = draw_pictures(work / "simulation", renderer, poses, calyx, vid, "thesis_simulation", rng)
    spheres, touched = _touch(kidney, em, settings, work, rng)
    with warnings.catch_warnings():  # what looks wrong about the landmarks is in the registration, for the report
        warnings.simplefilter("ignore", RegistrationWarning)
        registration = replace(register_landmarks(touched, spheres), model_scale=kidney.scale)
    registration.to_json(work / "em_to_kidney.json")
    with progress(1, "robot driven") as advance:
        drive = drive_robot(twin, kidney, settings)
        advance(1)
    taken, calyx = choose_pictures(drive, kidney, lumen, settings)
    if len(taken) < settings.references:
        raise InputError(
            f"The robot took only {len(taken)} pictures, fewer than the {settings.references} references; it reached "
            f"the calyces {', '.join(drive.visited) or 'none'}. Take another kidney.seed or a smaller scope."
        )
    phantom = draw_pictures(work / "phantom", renderer, drive.T_kidney_camera[taken], calyx, vid, "thesis_phantom", rng)
    readings = _read_sensor(em, phantom)
    reference, T_reference = _look_up(phantom, readings, settings, work, rng)
    localizer = pipeline.make_localizer(vid)
    with contextlib.suppress(FeatureError):  # the first picture would pay for warming up, which is not its own time
        localizer.locate(simulation.read(0))
    matched = [match_pictures(localizer, pictures, progress) for pictures in (simulation, phantom)]
    return Outcome(
        vid=vid,
        simulation=matched[0],
        phantom=matched[1],
        registration=registration,
        landmarks_kidney=spheres,
        landmarks_em=touched,
        registration_error_mm=_error(registration, em, kidney),
        reference=reference,
        T_reference=T_reference,
        verdicts=_judge(registration, kidney, settings, em, work),
        drive=drive,
    )


def _prepared_vid(
    kidney: Kidney,
    lumen: LumenDistance,
    pipeline: Pipeline,
    settings: ProtocolSettings,
    T_start: Array,
    work: Path,
    progress: Progress,
) -> Vid:
    """The VID in ``work``: the one that is there if it was made for the very same experiment, else a new one."""
    mark = work / "made_for.txt"
    mesh = hashlib.sha256(kidney.mesh.vertices.tobytes() + kidney.mesh.faces.tobytes()).hexdigest()
    same = f"{kidney.source} {kidney.scale} {mesh} "
    same += f"{pipeline.camera} {pipeline.features} {pipeline.make_renderer} {pipeline.views} {pipeline.calibrate} "
    same += f"{settings.views_by_hand} {pipeline.make_localizer}"
    if not (mark.exists() and mark.read_text(encoding="utf-8") == same):
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True, exist_ok=True)
        mark.write_text(same, encoding="utf-8")
    for left in work.iterdir():  # everything but the VID is made anew
        if left.name not in (mark.name, "vid", "vid.partial"):
            shutil.rmtree(left) if left.is_dir() else left.unlink()
    if (work / "vid").exists():
        return load_vid(work / "vid")
    learn = partial(
        learn_confidence, make_renderer=pipeline.make_renderer, plan=pipeline.views,
        make_localizer=pipeline.make_localizer,
    )  # fmt: skip
    return build_vid(
        kidney,
        pipeline.camera,
        pipeline.features,
        pipeline.make_renderer,
        hand_collected(pipeline.views, kidney, lumen, T_start) if settings.views_by_hand else pipeline.views,
        work / "vid",
        workers=pipeline.workers,
        progress=progress,
        learn=learn if pipeline.calibrate else None,
    )


def _touch(
    kidney: Kidney, em: EmField, settings: ProtocolSettings, work: Path, rng: np.random.Generator
) -> tuple[Array, Array]:
    spheres, touched = touch_landmarks(kidney, em, settings, rng)
    _write_pairs(work / "landmarks.csv", spheres, touched)
    return spheres, touched


def _write_pairs(path: Path, kidney_mm: Array, em_mm: Array) -> None:
    rows = [dict(zip(LANDMARK_COLUMNS, pair, strict=True)) for pair in np.c_[kidney_mm, em_mm].tolist()]
    write_csv(path, LANDMARK_COLUMNS, rows)


def _read_sensor(em: EmField, pictures: DrawnPictures) -> Array:
    """Readings (N, 6), position and axis, of the sensor behind the camera; written to ``em.csv``."""
    sensor = pictures.T_kidney_camera.copy()
    sensor[:, :3, 3] = apply(sensor, np.broadcast_to(em.sensor_offset_mm, (len(sensor), 3)))
    readings = np.array([np.concatenate(read_em(em, T)) for T in sensor])
    rows: list[dict[str, Any]] = [
        {"image": name} | dict(zip(EM_COLUMNS, values, strict=True))
        for name, values in zip(pictures.names, readings.tolist(), strict=True)
    ]
    write_csv(pictures.folder / "em.csv", ("image", *EM_COLUMNS), rows)
    return readings


def _look_up(
    pictures: DrawnPictures, readings: Array, settings: ProtocolSettings, work: Path, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Array]:
    """Which phantom pictures (K,) serve as references, and where (K, 4, 4) a hand found their view (§4.5)."""
    seen = np.flatnonzero(np.isfinite(readings[:, 0]))
    rows = seen[np.linspace(0, len(seen) - 1, settings.references).round().astype(int)]
    T = find_views(pictures.T_kidney_camera[rows], settings, rng)
    _write_pairs(work / "reference_pairs.csv", T[:, :3, 3], readings[rows, :3])
    return rows, T


def _judge(registration: Registration, kidney: Kidney, settings: ProtocolSettings, em: EmField, work: Path) -> Verdicts:
    verdicts = judge_matches(
        work / "phantom" / "matches.csv",
        work / "phantom" / "em.csv",
        registration,
        sensor_offset_mm=em.sensor_offset_mm,
        reference_pairs=work / "reference_pairs.csv",
        truth=work / "phantom" / "truth.csv",
        budget=settings.budget,
        least_p=settings.least_p,
    )
    write_json(work / "verdicts.json", verdict_report(verdicts, kidney.scale))
    return verdicts


def _error(registration: Registration, em: EmField, kidney: Kidney) -> float:
    """Root mean square error in mm over the centerline, from the true frame."""
    points = kidney.centerline.points_mm
    found = registration.apply(apply(em.T_em_kidney, points))
    return float(np.sqrt(np.mean(np.sum((found - points) ** 2, axis=1))))
