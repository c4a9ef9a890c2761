"""How sharply the fields pin a pose down where an alignment ended: the Gauss-Newton normal matrix, inverted."""

import numpy as np

from ursnav_torch.alignment.align import Drawing

#: Directions that the fields hardly see are not pinned down at all: no eigenvalue of the normal matrix counts as less.
_LEAST = 1e-6


def unit_noise_sd(drawing: Drawing) -> tuple[float, float]:
    """Standard deviations of position (mm) and turn (radians), were every pixel's residual of size 1 and independent.

    Residuals are neither, so these are no errors yet; poses compare by them (Cramér and Rao's bound, up to a factor).

    Args:
        drawing: where the alignment ended.
    """
    seen = drawing.seen
    size = np.sqrt((drawing.value**2 @ seen) / max(float(seen.sum()), 1.0)) + 1e-6
    gradient = drawing.slope / size[:, None] * np.sqrt(seen)
    xx, yy = (gradient**2).sum(1)
    xy = (gradient[0] * gradient[1]).sum(0)
    x, y = drawing.motion[:, 0], drawing.motion[:, 1]
    normal = ((x * xx + y * xy) @ x.T + (x * xy + y * yy) @ y.T).astype(float)
    value, axes = np.linalg.eigh(normal)
    spread = (axes / np.maximum(value, _LEAST * max(value[-1], 1e-9))) @ axes.T
    return float(np.sqrt(np.trace(spread[:3, :3]))), float(np.sqrt(np.trace(spread[3:, 3:])))
