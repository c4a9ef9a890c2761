"""Names of calyces: letters along the tree, and poles."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.kidney.anatomy import Calyx, Centerline

Array = NDArray[np.float64]


def name_calyces(tree: Centerline, tips_mm: Array) -> tuple[Calyx, ...]:
    """Calyces "A", "B", ... for tips (C, 3), in depth-first order of their tree: neighbors get neighboring letters."""
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

    The poles are the upper and the lower third of the height between the lowest and the highest tip.

    Raises:
        InputError: ``superior`` is no direction.
    """
    up = np.asarray(superior, float)
    if up.shape != (3,) or not np.all(np.isfinite(up)) or not np.any(up):
        raise InputError(f"kidney.superior must be a direction [x, y, z] in the kidney frame, got {superior!r}.")
    height = np.array([c.tip_mm for c in calyces]) @ up
    low, third = height.min(), np.ptp(height) / 3
    poles = ["lower" if h < low + third else "upper" if h > low + 2 * third else "mid" for h in height]
    return tuple(replace(c, pole=c.pole or p) for c, p in zip(calyces, poles, strict=True))
