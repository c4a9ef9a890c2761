"""Building a VID: plan, draw in shards on all cores or a cluster, join, and give it its name when all is there."""

import hashlib
import json
import os
import shutil
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.features import Settings, settings_to_dict
from ursnav_torch.files import Progress, check_output, no_progress, whole_folder
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.vid.base import Vid
from ursnav_torch.vid.compute import Compute, LocalCompute
from ursnav_torch.vid.draw import MakeRenderer, Studio, join, load_features, save_features
from ursnav_torch.vid.exchange import CollectedViews
from ursnav_torch.vid.plan import Plan, PlanSettings, plan_views
from ursnav_torch.vid.screen import SCREEN_FROM, make_screen
from ursnav_torch.vid.store import load_vid, save_vid

#: Views drawn in one go; what an interruption can lose.
SHARD = 50

Advance = Callable[[int], None]


def build_vid(
    kidney: Kidney,
    camera: Camera,
    settings: Settings,
    make_renderer: MakeRenderer,
    plan: PlanSettings | CollectedViews,
    out: Path,
    *,
    overwrite: bool = False,
    workers: int | None = None,
    compute: Compute | None = None,
    progress: Progress = no_progress,
    learn: Callable[..., dict[str, object]] | None = None,
) -> Vid:
    """Build the VID of a kidney in folder ``out``; a build that was interrupted goes on from its last shard.

    Args:
        kidney, camera: what to draw, through which lens.
        settings: of the features.
        make_renderer: called as ``make_renderer(mesh, camera)`` in every worker process.
        plan: which views to draw, or views collected elsewhere, whose pictures are taken as they are.
        out: the folder to be made.
        overwrite: replace what stands there.
        workers: processes; all cores when None, none besides this one when 1.
        compute: where views are planned and drawn; ``LocalCompute(workers)`` when None.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        learn: called as ``learn(vid, progress=progress)`` with the drawn VID; what it returns is stored as the VID's
            calibration.

    Raises:
        InputError: ``out`` exists, a calyx has no room for the scope, collected views do not fit kidney or lens, or a
            cluster does not do its part; another process builds it; the disk is full.
    """
    check_output(out, overwrite)
    compute = compute or LocalCompute(workers)
    compute.check_folder(out.parent)
    with whole_folder(out, overwrite, resume=True) as work:
        views, lumen = _planned(kidney, plan, compute)
        pictures = () if isinstance(plan, PlanSettings) else plan.pictures
        studio = Studio(kidney.mesh, camera, settings, make_renderer, pictures)
        _prepare(work, _fingerprint(studio, views))
        with progress(len(views.calyx), "views") as advance:
            _draw_all(studio, views.T_kidney_camera, work, compute, advance)
        shards = [load_features(path) for path in sorted((work / "shards").glob("*.safetensors"))]
        features = join(shards)
        screen = make_screen(features) if len(features) >= SCREEN_FROM else None
        T, calyx = views.T_kidney_camera, views.calyx
        vid = Vid(kidney, camera, settings, T, calyx, features, work, lumen, screen=screen)
        if learn is not None:
            vid = replace(vid, calibration=learn(vid, progress=progress))
        save_vid(vid, work)
        (work / "fingerprint.json").unlink()  # first: without it what lies there is of no use to another call
        shutil.rmtree(work / "shards")
    return load_vid(out)


def _prepare(work: Path, fingerprint: str) -> None:
    """Make the work folder; keep what an interrupted build of the very same VID left there."""
    mark = work / "fingerprint.json"
    if not (mark.exists() and mark.read_text(encoding="utf-8") == fingerprint):
        shutil.rmtree(work, ignore_errors=True)
    for folder in (work / "images", work / "shards"):
        folder.mkdir(parents=True, exist_ok=True)
    mark.write_text(fingerprint)


def _planned(kidney: Kidney, plan: PlanSettings | CollectedViews, compute: Compute) -> tuple[Plan, LumenDistance]:
    if not isinstance(plan, PlanSettings):
        lumen = LumenDistance.from_kidney(kidney)
        return plan.plan(kidney, lumen), lumen
    return next(iter(list(compute.map(_plan, kidney, [(plan,)]))))


def _plan(kidney: Kidney, settings: PlanSettings) -> tuple[Plan, LumenDistance]:
    lumen = LumenDistance.from_kidney(kidney)
    return plan_views(kidney, lumen, settings), lumen


def _draw_all(studio: Studio, T: NDArray[np.float64], work: Path, compute: Compute, advance: Advance) -> None:
    """Draw what is missing of shards 0, 1, ... of ``SHARD`` views each."""
    todo = []
    for shard, start in enumerate(range(0, len(T), SHARD)):
        if _shard_path(work, shard).exists():
            advance(len(T[start : start + SHARD]))
        else:
            todo.append((work, shard, start, T[start : start + SHARD]))
    for drawn in compute.map(draw_shard, studio, todo) if todo else ():
        advance(drawn)


def draw_shard(studio: Studio, work: Path, shard: int, first: int, T: NDArray[np.float64]) -> int:
    """Draw views ``first``... and store their features as one shard; the number of views.

    ``T`` (N, 4, 4) are their camera poses in the kidney frame.

    Pictures and features get their names one by one when they are whole, the features last: the same shard may be
    drawn by two workers of which one was thought lost, and either leaves the same bytes.
    """
    path = _shard_path(work, shard)
    own = path.with_name(f"{path.stem}.{socket.gethostname()}.{os.getpid()}")
    own.mkdir(exist_ok=True)
    features = studio.draw(T, first, own)
    save_features(own / path.name, features)
    for picture in own.glob("*.png"):
        os.replace(picture, work / "images" / picture.name)
    os.replace(own / path.name, path)
    own.rmdir()
    return len(T)


def _shard_path(work: Path, shard: int) -> Path:
    return work / "shards" / f"{shard:05d}.safetensors"


def _fingerprint(studio: Studio, views: Plan) -> str:
    """Changes when any input of the drawing does."""
    digest = hashlib.sha256()
    for array in (studio.mesh.vertices, studio.mesh.faces, views.T_kidney_camera):
        digest.update(np.ascontiguousarray(array).tobytes())
    for picture in studio.pictures:
        digest.update(hashlib.sha256(picture.read_bytes()).digest())
    plain = {"camera": studio.camera.to_dict(), "features": settings_to_dict(studio.settings)}
    return json.dumps(plain | {"renderer": repr(studio.make_renderer), "arrays": digest.hexdigest()}, sort_keys=True)
