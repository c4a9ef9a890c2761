"""Names of calyces: letters along the tree, and poles."""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
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


def pole_of(from_middle_mm: Array, superior: Array) -> str:
    """ "upper", "mid" or "lower" for a tip (3,) relative to the middle of all tips; ``superior`` (3,) points to the head.

    Raises:
        InputError: ``superior`` is no direction.
    """
    length = np.linalg.norm(superior)
    if np.shape(superior) != (3,) or not np.isfinite(length) or length == 0:
        raise InputError(f"kidney.superior must be a direction [x, y, z] in the kidney frame, got {superior}.")
    height = from_middle_mm @ superior / length
    angle = np.arcsin(np.clip(height / max(np.linalg.norm(from_middle_mm), 1e-9), -1, 1))
    return "upper" if angle > _POLE_RAD else "lower" if angle < -_POLE_RAD else "mid"
