"""The painted wall: what of a kidney was seen, drawn from both sides, with the verdict on every calyx."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import GLIMPSED, INSPECTED, OUT_OF_REACH, UNSEEN, CalyxCoverage, Coverage
from ursnav_torch.geometry import apply
from ursnav_torch.reports.overview import Overview, draw_overview

Picture = NDArray[np.uint8]

#: Blue, green, red.
_SEEN, _HIDDEN, _BEYOND = np.array([[90.0, 160.0, 70.0], [150.0, 145.0, 225.0], [190.0, 190.0, 190.0]])
_INK = {INSPECTED: (50, 110, 30), GLIMPSED: (0, 130, 220), UNSEEN: (40, 40, 200), OUT_OF_REACH: (130, 130, 130)}
_TEXT = cv2.FONT_HERSHEY_SIMPLEX


def draw_coverage(coverage: Coverage, side_px: int = 480, calyces: Sequence[CalyxCoverage] | None = None) -> Picture:
    """Front and side of the kidney (S + legend, 2 S, 3): seen wall green, wall to be seen red, out of reach gray.

    Args:
        coverage: what was seen.
        side_px: S.
        calyces: the verdict on each, where another than the coverage's own was told.
    """
    verdicts = coverage.calyces() if calyces is None else calyces
    bare = [draw_overview(coverage.kidney, side_px, from_side, names=False) for from_side in (False, True)]
    views = [_painted(coverage, overview, verdicts) for overview in bare]
    return np.asarray(np.concatenate([np.concatenate(views, axis=1), _legend(verdicts, 2 * side_px)]), np.uint8)


def _painted(coverage: Coverage, overview: Overview, verdicts: Sequence[CalyxCoverage]) -> Picture:
    """The overview with every patch in its color: the nearest wall over the one behind it."""
    picture, R = overview.picture.copy(), overview.T_view_kidney[:3, :3]
    patches, seen = coverage.patches, coverage.seen()
    color = np.where(seen[:, None], _SEEN, np.where(coverage.in_reach[:, None], _HIDDEN, _BEYOND))
    facing = np.abs(patches.normal @ R[2])
    color = color * (0.55 + 0.45 * facing)[:, None]
    depth = apply(overview.T_view_kidney, patches.center_mm)[:, 2]
    radius = max(1, round(0.75 * coverage.of_kidney.patch_mm * overview.px_per_mm))
    veil = picture.copy()
    for i in np.argsort(-depth):
        x, y = np.rint(overview.project(patches.center_mm[i])).astype(int).tolist()
        cv2.circle(veil, (x, y), radius, color[i].tolist(), -1, cv2.LINE_AA)
    picture = cv2.addWeighted(veil, 0.8, picture, 0.2, 0)
    for verdict, at in zip(verdicts, overview.project(coverage.kidney.tips_mm), strict=True):
        x, y = np.rint(at).astype(int).tolist()
        cv2.circle(picture, (x, y), 4, _INK[verdict.verdict], -1, cv2.LINE_AA)
        for ink, thick in (((255, 255, 255), 3), (_INK[verdict.verdict], 1)):
            cv2.putText(picture, verdict.calyx, (x + 4, y - 4), _TEXT, 0.4, ink, thick, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


def _legend(verdicts: Sequence[CalyxCoverage], width: int, line: int = 20, columns: int = 3) -> Picture:
    """One entry a calyx: its verdict, and how much of it was seen."""
    legend = np.full((line * (-(-len(verdicts) // columns)) + 8, width, 3), 255, np.uint8)
    for i, c in enumerate(verdicts):
        at = (8 + (i % columns) * width // columns, line * (i // columns) + 17)
        cv2.putText(legend, f"{c.calyx}: {c.verdict} ({c.share:.0%})", at, _TEXT, 0.45, _INK[c.verdict], 1, cv2.LINE_AA)
    return legend
