"""What an exploration saw, as plain data: the content of ``FILE.coverage.json``."""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import INSPECTED, Coverage
from ursnav_torch.exploration.route import ScopeLimits, nearest_route


def coverage_report(
    coverage: Coverage, T_kidney_camera: NDArray[np.float64] | None, limits: ScopeLimits | None = None
) -> dict[str, Any]:
    """The content of ``FILE.coverage.json``: what was seen, and the way from the last pose to what was not."""
    found, verdicts = coverage.to_dict(), coverage.calyces()
    open_ = [i for i, c in enumerate(verdicts) if c.verdict != INSPECTED]
    kidney, start = coverage.kidney, coverage.kidney.pelvis_mm
    if T_kidney_camera is not None:
        start = T_kidney_camera[:3, 3]
    worst = [i for i in open_ if verdicts[i].share < coverage.settings.glimpsed] or open_
    route = nearest_route(kidney, start, worst, limits)
    found["next"] = None
    if route is not None:
        plain = asdict(route) | {"points_mm": route.points_mm.round(3).tolist(), "branches": list(route.branches)}
        found["next"] = {k: round(v, 2) if isinstance(v, float) else v for k, v in plain.items()}
    return found
