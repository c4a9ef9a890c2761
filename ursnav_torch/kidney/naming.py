"""Names of calyces: letters along the tree, and poles."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney.anatomy import Calyx, Centerline

Array = NDArray[np.float64]

#: Beyond this angle from the transverse plane a calyx belongs to the upper or lower pole.
_POLE_RAD = np.radians(30.0)


def name_calyces(tree: Centerline, tips_mm: Array) -> tuple[Calyx, ...]:
    """Calyces "A", "B", ... for tips (C, 3), in depth-first order of their tree, so that neighbors get neighboring letters."""
    children: dict[int, list[int]] = {}
    for node, parent in enumerate(tree.parent):
        children.setdefault(int(parent), []).append(node)
    along = tree.from_root_mm()
    reach = along.copy()
    for node in range(len(reach) - 1, 0, -1):
        reach[tree.parent[node]] = max(reach[tree.parent[node]], reach[node])
    order, stack = [], [0]
    while stack:
        node = stack.pop()
        below = children.get(node, [])
        if not below:
            order.append(int(tree.calyx[node]))
        stack.extend(sorted(below, key=lambda n: reach[n]))
    return tuple(Calyx(letter(i), tips_mm[c]) for i, c in enumerate(order))


def letter(number: int) -> str:
    """0 -> "A", 25 -> "Z", 26 -> "AA"."""
    return (letter(number // 26 - 1) if number >= 26 else "") + chr(ord("A") + number % 26)


def with_poles(calyces: tuple[Calyx, ...], superior: ArrayLike) -> tuple[Calyx, ...]:
    """Calyces with "upper", "mid" or "lower" where they have no pole yet; ``superior`` (3,) points to the head.

    A tip belongs to a pole where, seen from the middle of all tips, it lies more than 30 degrees out of the transverse
    plane.

    Raises:
        InputError: ``superior`` is no direction.
    """
    up = np.asarray(superior, float)
    if up.shape != (3,) or not np.all(np.isfinite(up)) or not np.any(up):
        raise InputError(f"kidney.superior must be a direction [x, y, z] in the kidney frame, got {superior}.")
    off = np.array([c.tip_mm for c in calyces]) - np.mean([c.tip_mm for c in calyces], axis=0)
    angle = np.pi / 2 - angle_between(off, up)
    poles = np.where(angle > _POLE_RAD, "upper", np.where(angle < -_POLE_RAD, "lower", "mid"))
    return tuple(replace(c, pole=c.pole or str(p)) for c, p in zip(calyces, poles, strict=True))
