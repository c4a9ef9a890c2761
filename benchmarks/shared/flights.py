"""A population of flights to choose the settings of tracking by, and another that judges them, drawn once and kept.

Every phantom is flown through three times, once with each kind of sensor. Severity grows from 0 to 1 over the flights
of each half: fog, blur and white-out come in stretches that are longer and thicker, the drive has more play, the
kidney has moved and swollen more since its scan, and the lumen breathes more. Given kidneys only judge.
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.kidneys import vid_of
from benchmarks.shared.phantoms import phantom_vid
from ursnav_torch.kidney import Kidney, LumenDistance, make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.deform import Deformation, WarpSettings, deform_mesh
from ursnav_torch.rendering.sensor import PRESETS, SensorFaults, severity, simulate
from ursnav_torch.simulation.flight import Flight, FlightSettings, fly
from ursnav_torch.simulation.twin import Scope
from ursnav_torch.vid import PlanSettings, Vid

Array = NDArray[np.float64]

#: The two halves; no phantom is in both.
CHOOSING, JUDGING = "choosing", "judging"
KINDS = ("thesis_simulation", "thesis_phantom", "in_vivo_like")
FIRST_SEED = 40
_RATES, _SPEEDS = (10.0, 15.0, 30.0), (2.0, 20.0)
_LENS_PX = 250
#: Part of its range that severity 1 takes a preset's faults to; the ends of all of them together are no picture.
_WORST_SHARE = 0.6


@dataclass(frozen=True, slots=True)
class Case:
    """One flight of the population.

    Attributes:
        kidney: folder name of its VID; ``seed`` makes it, or it lies in the given data (seed < 0).
        half: `CHOOSING` or `JUDGING`.
        kind: preset of the sensor.
        severity: 0..1.
        number: of the flight; draws all that is random.
    """

    kidney: str
    seed: int
    half: str
    kind: str
    severity: float
    number: int

    @property
    def name(self) -> str:
        """For people and for folders."""
        return f"{self.number:02d}_{self.kidney}_{self.kind}"


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight as it lies on disk.

    Attributes:
        case: which.
        flight: times, true poses, odometry.
        fogged: (N,) how much of the picture is lost on purpose, 0..1.
        images: (N, H, W, 3) uint8, mapped from disk.
        folder: where they lie.
    """

    case: Case
    flight: Flight
    fogged: Array
    folder: Path

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """The pictures, one after the other."""
        for i in range(len(self.flight.t_s)):
            yield cv2.imread(str(self.folder / f"{i:04d}.png"))


def population(phantoms: int = 8, given: tuple[str, ...] = ()) -> list[Case]:
    """All flights: three a phantom, the phantoms in turn in the one half and in the other; given kidneys only judge."""
    cases = []
    for i in range(phantoms):
        half = (CHOOSING, JUDGING)[i % 2]
        for k, kind in enumerate(KINDS):
            number = 3 * i + k
            place = (i // 2 * 3 + (k + i // 2) % 3) / max(3 * ((phantoms + 1) // 2) - 1, 1)
            cases.append(
                Case(f"flights_{FIRST_SEED + i}", FIRST_SEED + i, half, kind, round(min(place, 1.0), 2), number)
            )
    for i, name in enumerate(given):
        for k, kind in enumerate(KINDS):
            number = 3 * (phantoms + i) + k
            cases.append(Case(name, -1, JUDGING, kind, round((k + i + 0.5) / (len(KINDS) + 1), 2), number))
    return cases


def vid_for(case: Case, views: int, around: float, work: Path, data: Path | None) -> Vid:
    """The VID of a case's kidney; built once."""
    plan = PlanSettings(views, views, around)
    if case.seed < 0:
        assert data is not None
        return vid_of(data, case.kidney, work, f"flights_{views}_{around:g}", plan=plan, calibrate=False)
    return phantom_vid(phantom_of(case), plan, work / f"{case.kidney}_{views}_{around:g}")


def phantom_of(case: Case) -> Kidney:
    """The phantom of a case that is none of the given kidneys."""
    return make_phantom_kidney(case.seed, calyces=6 + case.seed % 4)


def flown(case: Case, vid: Vid, lumen: LumenDistance, pictures: int, work: Path, *, breathless: bool = False) -> Flown:
    """A case's flight, drawn on the first call and read from disk on the others; ``breathless``: all else is equal."""
    settings, scope = _drawn(case, pictures)
    if breathless:
        settings = replace(settings, breathing_mm=0.0)
    key = hashlib.sha256(repr((case, settings, scope)).encode()).hexdigest()[:8]
    folder = work / f"{case.name}_{key}"
    if not (folder / "flight.npz").exists():
        _draw(case, vid, lumen, settings, scope, folder)
    with np.load(folder / "flight.npz") as kept:
        return Flown(case, Flight(kept["t_s"], kept["T"], kept["odometry"]), kept["fogged"], folder)


def _drawn(case: Case, pictures: int) -> tuple[FlightSettings, Scope]:
    """How a case is flown, and with what scope."""
    rng, s = np.random.default_rng([case.number, 1]), case.severity
    low, high = _SPEEDS
    flying = FlightSettings(
        speed_mm_s=float(low * (high / low) ** rng.beta(1.5, 2)),
        withdrawal=float(rng.uniform(1, 3)),
        turn_deg_s=float(rng.uniform(40, 90)),
        pictures_per_s=float(rng.choice(_RATES, p=(0.6, 0.2, 0.2))),
        pictures=pictures,
        stops=float(rng.uniform(0, 0.25)),
        breathing_mm=float(1.2 * s * rng.random()),
        roll_deg_s=float(rng.uniform(0, 6)),
    )
    plays = (0.05 + 0.5 * s * rng.random(), 0.05 + 0.5 * s * rng.random(), 0.2 + 3.0 * s * rng.random())
    return flying, Scope(backlash=plays, compression_mm=float(1 + 3 * s))


def _draw(case: Case, vid: Vid, lumen: LumenDistance, settings: FlightSettings, scope: Scope, folder: Path) -> None:
    """Fly, and draw the pictures in the kidney as it is now."""
    rng = np.random.default_rng([case.number, 2])
    names = [c.name for c in vid.kidney.calyces]
    order = tuple(names[i] for i in rng.permutation(len(names)))
    flight = fly(vid.kidney, lumen, order, settings, rng, scope)
    warp = WarpSettings(1.5 * case.severity, 45.0 * vid.kidney.scale, 0.0, 0.06 * case.severity)
    moved = deform_mesh(vid.kidney.mesh, warp, rng) if case.severity > 0 else None
    renderer = RaycastRenderer(vid.kidney.mesh if moved is None else moved.mesh, vid.camera)
    faults = severity(PRESETS[case.kind], _WORST_SHARE * case.severity, rng)
    fogged, white = _bad_stretches(flight.t_s, case.severity, rng)
    folder.mkdir(parents=True, exist_ok=True)
    for i, T in enumerate(flight.T_kidney_camera):
        image = _picture(renderer, moved, T, _thickened(faults, float(fogged[i])), rng)
        cv2.imwrite(str(folder / f"{i:04d}.png"), np.full_like(image, 250) if white[i] else image)
    (folder / "case.json").write_text(json.dumps({"name": case.name, "half": case.half, "severity": case.severity}))
    fogged = np.where(white, 1.0, fogged)
    np.savez(folder / "flight.npz", t_s=flight.t_s, T=flight.T_kidney_camera, odometry=flight.odometry, fogged=fogged)


def _picture(
    renderer: RaycastRenderer, moved: Deformation | None, T: Array, faults: SensorFaults, rng: np.random.Generator
) -> NDArray[np.uint8]:
    return simulate(renderer, T if moved is None else moved.carry(T), faults, rng)


def _bad_stretches(t_s: Array, s: float, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """How thick the fog is (N,), 0..1, coming and going within half a second; and which pictures are white."""
    fog = np.zeros(len(t_s))
    for _ in range(rng.poisson(t_s[-1] / 6)):
        middle, long, thick = rng.uniform(0, t_s[-1]), rng.exponential(1 + 2 * s), s * rng.uniform(0.3, 1.0)
        fog = np.maximum(fog, thick * np.clip((long / 2 - np.abs(t_s - middle)) / 0.5 + 1, 0, 1))
    white = rng.random(len(t_s)) < 0.03 * (s > 0)
    for _ in range(rng.poisson(s * t_s[-1] / 10)):
        begin = rng.uniform(0, t_s[-1])
        white |= (t_s >= begin) & (t_s < begin + rng.exponential(0.4))
    return fog, white


def _thickened(faults: SensorFaults, fog: float) -> SensorFaults:
    """A scope's faults in fog of a thickness 0..1: murk, glare and blur."""
    if fog == 0:
        return faults
    light, optics = faults.light, faults.optics
    return replace(
        faults,
        light=replace(light, turbidity_per_mm=min(light.turbidity_per_mm + 0.08 * fog, 0.12)),
        optics=replace(optics, veil=min(optics.veil + 0.45 * fog, 0.8), defocus_px=optics.defocus_px + 2.0 * fog * fog),
    )
