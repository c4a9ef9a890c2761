"""The stone in a phantom: what it hides, and what pictures tell of it where none are drawn."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.exploring.twins import Anatomy
from ursnav_torch.autonomy.neck import find_neck
from ursnav_torch.autonomy.steering import Way
from ursnav_torch.camera import Camera
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.rendering import RayScene
from ursnav_torch.scaling import scaled
from ursnav_torch.stones import THERE, FoundStone

Array = NDArray[np.float64]

#: The map tells a stone after so many seconds in sight, nearer than this, mm; assumed.
_TOLD_S, _NEARER_MM = 2.0, 15.0
#: Errors of its place, mm an axis, and of its size, as a share: what ``python -m benchmarks.stones`` gave.
_PLACE_MM, _SIZE = 0.3, 0.2
#: How sure the map says to be of the size, as a share; assumed.
_SIZE_SD = 0.15


class StoneSight:
    """Tells of a stone once the lens has seen it for long enough, with the errors that the map of stones has.

    Args:
        known: the kidney and the lens.
        stone: x, y, z and radius of the stone.
        calyx: index of the calyx that it closes.
        rng: draws the errors.
    """

    def __init__(self, known: Anatomy, stone: Array, calyx: int, rng: np.random.Generator) -> None:
        self._camera, self._scene, self._stone = known.camera, RayScene(known.kidney.mesh), stone
        size = 2 * float(stone[3]) * float(np.exp(rng.normal(0, _SIZE)))
        center = stone[:3] + rng.normal(0, _PLACE_MM, 3)
        spread = _PLACE_MM**2 * np.eye(3)
        self._told = FoundStone(1, calyx, center, spread, size, _SIZE_SD * size, 1, 0.99, THERE, 0)
        self._seen_s, self._last_s = 0.0, 0.0

    def see(self, T_kidney_camera: Array, t_s: float) -> tuple[FoundStone, ...]:
        """What is told after a picture from a true pose (4, 4)."""
        self._seen_s += (t_s - self._last_s) * self._shows(T_kidney_camera)
        self._last_s = t_s
        return (self._told,) if self._seen_s >= _TOLD_S else ()

    def _shows(self, T: Array) -> bool:
        """Whether the middle of the stone's near side is in the picture."""
        return shows(T, self._stone, self._camera, self._scene)


def shows(T_kidney_camera: Array, stone: Array, camera: Camera, scene: RayScene) -> bool:
    """Whether a picture from a pose (4, 4) shows the middle of the near side of a stone (x, y, z, radius)."""
    T = T_kidney_camera
    way = stone[:3] - T[:3, 3]
    distance = float(np.linalg.norm(way))
    near = distance - float(stone[3])
    if not 0 < near < _NEARER_MM or not camera.project((way @ T[:3, :3])[None])[1][0]:
        return False
    return bool(scene.depth_mm(T[:3, 3], way[None] / distance)[0] >= near)


def in_sight(known: Anatomy, stone: Array) -> bool:
    """Whether any pose before the necks that the scope does not pass shows a stone (x, y, z, radius)."""
    kidney, scene = known.kidney, RayScene(known.kidney.mesh)
    ways = [Way(kidney, calyx) for calyx in range(len(kidney.calyces))]
    necks = [find_neck(way, scaled(ScopeLimits(), kidney.scale), kidney.scale) for way in ways]
    for T in known.T_kidney_camera:
        way = min(ways, key=lambda way: way.away_mm(T[:3, 3]))
        neck = necks[way.calyx]
        if (neck is None or way.place_mm(T[:3, 3]) <= neck.end_mm) and shows(T, stone, known.camera, scene):
            return True
    return False


class CoverageBehind(Coverage):
    """The wall as true poses see it, but for what lies behind a stone.

    Args:
        stone: x, y, z and radius of the stone.
        of: as of `Coverage`.
    """

    def __init__(self, stone: Array, *of: Any) -> None:
        super().__init__(*of)
        self._stone = stone

    def surely_in_view(
        self, T_kidney_camera: Array, position_sd_mm: float, among: NDArray[np.bool_] | None = None
    ) -> NDArray[np.int64]:
        """See `Coverage.surely_in_view`."""
        seen = super().surely_in_view(T_kidney_camera, position_sd_mm, among)
        way = self.patches.center_mm[seen] - T_kidney_camera[:3, 3]
        to_stone = self._stone[:3] - T_kidney_camera[:3, 3]
        nearest = np.clip(way @ to_stone / np.sum(way**2, axis=1), 0, 1)  # share of the way
        apart = np.linalg.norm(to_stone - nearest[:, None] * way, axis=1)
        return seen[apart > self._stone[3]]
