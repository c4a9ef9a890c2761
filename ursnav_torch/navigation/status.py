"""Navigation in plain words; pure functions."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import INSPECTED, OUT_OF_REACH, CalyxCoverage
from ursnav_torch.exploration.route import Route
from ursnav_torch.navigation.state import Guidance
from ursnav_torch.stones import stone_count
from ursnav_torch.tracking.tracker import LOST, TRACKING

Array = NDArray[np.float64]

SURE, FAIRLY_SURE = 0.9, 0.6
#: Shorter ways back are not worth saying; the point steered for lies this far ahead; "straight on" within the angle.
BACK_MM, AHEAD_MM, STRAIGHT_DEG = 3.0, 6.0, 20.0


def status_line(tracking: str, calyx: str, confidence: float, guidance: Guidance, remark: str = "") -> str:
    """The line that a surgeon reads.

    Args:
        tracking: ``tracking``, ``searching`` or ``lost``.
        calyx: the calyx observed, or the few that it may be in words; blank for none.
        confidence: probability that this is right.
        guidance: what was seen, and the way on as far as it is known.
        remark: one more sentence, as it is.

    Example:
        >>> status_line("tracking", "C", 0.97, Guidance("calyx C"))
        'In calyx C, sure.'
    """
    g = guidance
    parts = [where(tracking, calyx, g.place, confidence), progress(g.coverage), way_on(tracking, g.route, g.turn)]
    parts += [stone_count(g.stones), remark]
    return " ".join(part for part in parts if part)


def where(tracking: str, calyx: str, place: str, confidence: float) -> str:
    """The place and how sure it is."""
    if tracking == LOST:
        return "Lost: the pictures do not fit this kidney."
    if tracking != TRACKING:
        return "Searching for the place."
    if calyx:
        return f"In calyx {calyx}, {confidence_words(confidence)}."
    into = place.startswith("calyx ")
    return f"{'On the way into' if into else 'In the'} {place or 'collecting system'}, {confidence_words(confidence)}."


def confidence_words(confidence: float) -> str:
    """A probability in words: sure from 0.9 on, fairly sure from 0.6 on, else unsure."""
    return "sure" if confidence >= SURE else "fairly sure" if confidence >= FAIRLY_SURE else "unsure"


def progress(coverage: Sequence[CalyxCoverage]) -> str:
    """How many calyces were inspected, of those within reach."""
    within = [c for c in coverage if c.verdict != OUT_OF_REACH]
    done = sum(c.verdict == INSPECTED for c in within)
    if not within:
        return ""
    return f"All {done} inspected." if done == len(within) else f"{done} of {len(within)} inspected."


def way_on(tracking: str, route: Route | None, turn: str) -> str:
    """Where to next, how far, and the next move."""
    if route is None:
        return ""
    parts = [f"Next: {route.calyx}", f"{route.length_mm:.0f} mm", turn if tracking == TRACKING else ""]
    return ", ".join(part for part in parts if part) + ("." if route.feasible else ", hard to reach.")


def turn_words(T_kidney_camera: Array, route: Route, scale: float = 1.0) -> str:
    """The next move along a route, as seen in the picture: pull back, straight on, or where to bend.

    Args:
        T_kidney_camera: (4, 4).
        route: from there.
        scale: the kidney's.
    """
    if route.back_mm > BACK_MM * scale:
        return f"pull back {route.back_mm:.0f} mm"
    x, y, z = way_ahead(T_kidney_camera, route, scale)
    if np.degrees(np.arctan2(np.hypot(x, y), z)) <= STRAIGHT_DEG:
        return "straight on"
    if abs(x) >= abs(y):
        return f"bend {'right' if x > 0 else 'left'}"
    return f"bend {'down' if y > 0 else 'up'}"


def way_ahead(T_kidney_camera: Array, route: Route, scale: float = 1.0) -> Array:
    """The point of a route that is steered for, (3,) in the camera frame, mm; arguments as of `turn_words`."""
    position = T_kidney_camera[:3, 3]
    way = np.linalg.norm(route.points_mm - position, axis=1)
    ahead = np.flatnonzero((way >= AHEAD_MM * scale) & (np.arange(len(way)) >= int(way.argmin())))
    goal = route.points_mm[ahead[0] if len(ahead) else -1]
    return np.asarray((goal - position) @ T_kidney_camera[:3, :3], float)
