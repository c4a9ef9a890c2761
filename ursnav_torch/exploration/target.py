"""The next target: which calyx to inspect next, asked alike by the live navigator and by the report on a track."""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import INSPECTED, OUT_OF_REACH, Coverage
from ursnav_torch.exploration.route import Route, ScopeLimits, nearest_route


def next_target(
    coverage: Coverage, position_mm: NDArray[np.float64], limits: ScopeLimits | None = None
) -> Route | None:
    """The route from a place to the next calyx: the nearest unseen one, else the nearest that is not inspected.

    A calyx of which no view sees any wall is never a target, as nobody could inspect it.

    Args:
        coverage: what was seen so far.
        position_mm: (3,) in the lumen, kidney frame.
        limits: what the scope can do.

    Returns:
        None when every calyx within reach is inspected.
    """
    verdicts = coverage.calyces()
    left = [i for i, c in enumerate(verdicts) if c.verdict not in (INSPECTED, OUT_OF_REACH)]
    unseen = [i for i in left if verdicts[i].share < coverage.settings.glimpsed]
    return nearest_route(coverage.kidney, position_mm, unseen or left, limits)
