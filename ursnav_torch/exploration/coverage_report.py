"""What an exploration saw, as plain data: the content of ``FILE.coverage.json``."""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.exploration.route import ScopeLimits
from ursnav_torch.exploration.target import next_target


def coverage_report(
    coverage: Coverage, T_kidney_camera: NDArray[np.float64] | None, limits: ScopeLimits | None = None
) -> dict[str, Any]:
    """The content of ``FILE.coverage.json``: what was seen, and the way from the last pose to the next target.

    Args:
        coverage: what was seen.
        T_kidney_camera: (4, 4) the last pose, or None for the pelvis.
        limits: what the scope can do.
    """
    found = coverage.to_dict()
    start = coverage.kidney.pelvis_mm if T_kidney_camera is None else T_kidney_camera[:3, 3]
    route = next_target(coverage, start, limits)
    found["next"] = None
    if route is not None:
        plain = asdict(route) | {"points_mm": route.points_mm.round(3).tolist(), "branches": list(route.branches)}
        found["next"] = {k: round(v, 2) if isinstance(v, float) else v for k, v in plain.items()}
    return found
