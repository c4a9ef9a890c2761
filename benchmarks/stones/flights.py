"""Flights past simulated stones, drawn once and kept: phantoms to choose by, and others that judge."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.phantoms import phantom_vid
from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.geometry import Array, apply, inverse
from ursnav_torch.kidney import Kidney, LumenDistance, make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import IN_VIVO_LIKE, STONE, SensorFaults, Stone, draw_faults, simulate_labeled
from ursnav_torch.simulation.flight import FlightSettings, fly
from ursnav_torch.simulation.stones import ObstructedLumen, lay_stones
from ursnav_torch.simulation.twin import Scope
from ursnav_torch.vid import PlanSettings, Vid

#: First seeds of the two halves; no phantom is in both.
CHOOSING, JUDGING = 500, 600
#: Most stones in a kidney, and fewest and most calyces.
MOST_STONES, CALYCES = 4, (6, 12)
#: Faults of `IN_VIVO_LIKE` that would draw another stone than those that lie there.
_STICKERS = ("occluders.stone", "occluders.stone_bgr")


@dataclass(frozen=True, slots=True, eq=False)
class StoneFlight:
    """A flight of N pictures past S stones.

    Attributes:
        seed: of the phantom and of all that is random.
        kidney, lumen: where.
        stones: the truth.
        t_s: (N,).
        T_kidney_camera: (N, 4, 4) true poses.
        odometry: (N, 3) what the robot reports.
        shown: (N, S) share of the picture that each stone covers.
        folder: of the pictures.
    """

    seed: int
    kidney: Kidney
    lumen: LumenDistance
    stones: tuple[Stone, ...]
    t_s: Array
    T_kidney_camera: Array
    odometry: Array
    shown: Array
    folder: Path

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """The pictures (H, W, 3), one after the other."""
        for i in range(len(self.t_s)):
            yield cv2.imread(str(self.folder / f"{i:04d}.png"))


def stone_flight(seed: int, work: Path) -> StoneFlight:
    """The flight of a seed, drawn on the first call and read from disk on the others."""
    rng = np.random.default_rng([seed, 5])
    kidney = make_phantom_kidney(seed, calyces=CALYCES[0] + seed % (CALYCES[1] - CALYCES[0] + 1))
    lumen = LumenDistance.from_kidney(kidney)
    stones = lay_stones(kidney, lumen, seed % (MOST_STONES + 1), rng)
    flying = FlightSettings(pictures_per_s=3.0, pictures=1000, breathing_mm=float(rng.uniform(0, 1.2)))
    plays = (0.05 + 0.4 * rng.random(), 0.05 + 0.4 * rng.random(), 0.2 + 2.0 * rng.random())
    scope = Scope(backlash=plays, compression_mm=float(rng.uniform(1, 3)))
    faults = draw_faults({k: v for k, v in IN_VIVO_LIKE.items() if k not in _STICKERS}, rng)
    key = hashlib.sha256(repr((seed, stones, flying, scope, faults)).encode()).hexdigest()[:8]
    folder = work / f"stones_{seed}_{key}"
    if not (folder / "flight.npz").exists():
        names = [c.name for c in kidney.calyces]
        order = tuple(names[i] for i in rng.permutation(len(names)))
        flight = fly(kidney, ObstructedLumen(lumen, stones), order, flying, rng, scope)
        shown = _draw(kidney, stones, flight.T_kidney_camera, faults, folder, rng)
        np.savez(folder / "flight.npz", t_s=flight.t_s, T=flight.T_kidney_camera, odometry=flight.odometry, shown=shown)
    with np.load(folder / "flight.npz") as kept:
        return StoneFlight(seed, kidney, lumen, stones, kept["t_s"], kept["T"], kept["odometry"], kept["shown"], folder)


def stone_vid(flight: StoneFlight, views: int, work: Path) -> Vid:
    """The VID of a flight's kidney, in which no stone lies; built once."""
    return phantom_vid(flight.kidney, PlanSettings(views, views), work / f"vid_{flight.seed}_{views}")


def _draw(
    kidney: Kidney,
    stones: tuple[Stone, ...],
    poses: Array,
    faults: SensorFaults,
    folder: Path,
    rng: np.random.Generator,
) -> Array:
    """Draw the pictures; how much of each every stone covers."""
    folder.mkdir(parents=True, exist_ok=True)
    renderer = RaycastRenderer(kidney.mesh, equidistant_camera())
    shown = np.zeros((len(poses), len(stones)))
    for i, T in enumerate(poses):
        seen = simulate_labeled(renderer.render(T), renderer.camera, T, faults, rng, stones)
        cv2.imwrite(str(folder / f"{i:04d}.png"), seen.image)
        if stones:
            shown[i] = _shares(seen.kind == STONE, stones, T, renderer.camera)
    return shown


def _shares(is_stone: NDArray[np.bool_], stones: tuple[Stone, ...], T: Array, camera: Camera) -> Array:
    """(S,) share of the picture (H, W) that each stone covers: a pixel shows the one that it is least beside."""
    rays, inside = camera.pixel_rays()
    centers = apply(inverse(T), np.array([s.center_mm for s in stones]))
    away = np.linalg.norm(centers, axis=1)
    half = np.array([s.radii_mm.max() for s in stones]) / away
    angle = np.arccos(np.clip(rays[is_stone] @ (centers / away[:, None]).T, -1, 1))
    owner = (angle / half).argmin(1) if len(angle) else np.zeros(0, int)
    return np.asarray(np.bincount(owner, minlength=len(stones)) / inside.sum(), float)
