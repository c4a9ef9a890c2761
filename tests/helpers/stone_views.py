"""Pictures' stones without pictures: what a perfect finder would tell of balls in a kidney."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import Array, apply, inverse, look_along
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.stones import StoneMap, StoneMapSettings, StoneWatch
from ursnav_torch.tracking.tracker import TRACKING, Tracked


def stone_watch(kidney: Kidney, lumen: LumenDistance, lens: Camera) -> StoneWatch:
    """A watch for outlines that are whole, as `ball_bodies` gives them."""
    return StoneWatch(StoneMap(kidney, lumen, lens, StoneMapSettings(size_factor=1.0)))


def answer(T: Array, bodies: tuple[ForegroundBody, ...]) -> Tracked:
    """What a tracker that errs in nothing says of a picture from ``T`` (4, 4)."""
    return Tracked(TRACKING, T, 0, 0.99, 1.0, 1.0, 0.01, bodies=bodies)


def body_of(mask: NDArray[np.bool_], kind: str = "stone") -> ForegroundBody:
    """A region (h, w) as the finder tells it."""
    y, x = np.argwhere(mask).mean(0)
    return ForegroundBody(kind, 0.95, (float(x), float(y)), 2 * float(np.sqrt(mask.sum() / np.pi)), mask.mean(), mask)


def ball_bodies(
    camera: Camera, lumen: LumenDistance, T: Array, balls: Iterable[tuple[Array, float]], least_px: int = 12
) -> tuple[ForegroundBody, ...]:
    """Balls (center in the kidney frame, radius) as a lens at ``T`` (4, 4) sees them where no wall is before them."""
    rays, inside = camera.pixel_rays()
    found = []
    for center, radius in balls:
        at = apply(inverse(T), center)
        distance = float(np.linalg.norm(at))
        way = T[:3, 3] + np.linspace(0.05, 1 - radius / distance, 30)[:, None] * (center - T[:3, 3])
        mask = inside & (rays @ at / distance > np.sqrt(max(1 - (radius / distance) ** 2, 0)))
        if distance > radius and lumen.clearance_mm(way).min() > 0 and mask.sum() >= least_px:
            found.append(body_of(mask))
    return tuple(found)


def ball_on_wall(kidney: Kidney, lumen: LumenDistance, calyx: int, radius: float) -> Array:
    """The middle (3,) of a ball that touches the wall beside the way into a calyx, some way before its tip."""
    tree = kidney.centerline
    path = tree.points_mm[tree.path_to(calyx)]
    on = path[int(np.abs(np.linalg.norm(path - path[-1], axis=1) - 3.0).argmin())]
    side = np.cross(path[-1] - path[0], [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side)
    steps = np.arange(0, 6, 0.02)
    room = lumen.clearance_mm(on + steps[:, None] * side)
    return on + steps[int(np.flatnonzero(room < radius)[0])] * side


def way_in(kidney: Kidney, calyx: int, count: int, seed: int = 0) -> list[Array]:
    """Poses (4, 4) along the way into a calyx, a little off it and turned."""
    rng = np.random.default_rng(seed)
    tree = kidney.centerline
    path = tree.path_to(calyx)
    points, tangents = tree.points_mm[path], tree.tangents(path)
    away = np.linalg.norm(points - points[-1], axis=1)
    use = np.flatnonzero((away < 16) & (away > 4))[:: max(1, int(((away < 16) & (away > 4)).sum()) // count)]
    return [
        look_along(points[i] + rng.normal(0, 0.4, 3), tangents[i] + rng.normal(0, 0.1, 3), float(rng.uniform(-3, 3)))
        for i in use
    ]
