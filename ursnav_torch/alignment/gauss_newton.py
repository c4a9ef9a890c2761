"""The arithmetic of one Gauss-Newton step, of B alignments at once.

Every pass through the pixels costs, so means, sizes and correlations come from one product of the fields with
themselves, and what is constant over a field is multiplied in last. Products with a single vector are sums: NumPy's
library of matrices would wake a second thread for each.
"""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.alignment.fields import Floats

Array = NDArray[np.float64]

#: Fields compared: relief, and the gradient's x and y.
FIELDS = 3
_TUKEY = 5.0  # residuals beyond this many root mean squares do not count
_LEAST_GAIN = 0.2
_LEAST_SIZE = 1e-6


def correlated(fields: Floats, good: Floats, count: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """How well fields of pictures and of drawings (B, 3 + 3, N) agree over the pixels that count (B, N).

    Args:
        fields: the pictures' first.
        good: how much each pixel counts; ``count`` (B,) are the sums.

    Returns:
        Correlations (B, 3), and three numbers a field (B, 3, 1): the residual of fields that were brought to mean 0
        and size 1, the drawing's times its correlation, is ``a * picture - b * drawing + c``.
    """
    every = count[:, None]
    mean = np.einsum("bcn,bn->bc", fields, good) / every
    square = (fields * good[:, None]) @ fields.swapaxes(1, 2) / every[..., None] - mean[:, :, None] * mean[:, None]
    size = np.sqrt(np.maximum(np.einsum("bii->bi", square), 0)) + np.float32(_LEAST_SIZE)
    each = np.arange(FIELDS)
    correlation = square[:, each, FIELDS + each] / (size[:, :FIELDS] * size[:, FIELDS:])
    a, b = 1 / size[:, :FIELDS], np.maximum(correlation, np.float32(_LEAST_GAIN)) / size[:, FIELDS:]
    c = b * mean[:, FIELDS:] - a * mean[:, :FIELDS]
    return correlation, a[..., None], b[..., None], c[..., None]


def tukey(residual: Floats, good: Floats, count: Floats) -> Floats:
    """Tukey's biweights (B, 3, N) of residuals (B, 3, N), zero where ``good`` (B, N) is."""
    weight = np.square(residual)
    size = np.float32(_TUKEY**2) * np.einsum("bcn,bn->bc", weight, good)[..., None] / count[:, None, None] + np.float32(
        1e-6
    )
    weight *= -1 / size
    weight += 1
    np.maximum(weight, 0, out=weight)
    np.square(weight, out=weight)
    weight *= good[:, None]
    return weight


def normal_equations(
    motion: Floats, gradient: Floats, lit: Floats, b: Floats, weight: Floats, residual: Floats
) -> tuple[Array, Array]:
    """J W J^T (B, 6 + L, 6 + L) and J W r (B, 6 + L) for the rows ``gradient . motion`` and ``-b lit`` of J.

    A field's row is the field's gradient (2, 3, N) times the motion of its pixels (6, 2, N), which all fields share,
    so fields are summed before they are multiplied out.
    """
    count, pixels = len(motion), motion.shape[-1]
    weighted = gradient * weight[:, None]
    own = np.einsum("bkcn,bkcn->bkn", weighted, gradient)
    cross = np.einsum("bcn,bcn->bn", weighted[:, 0], gradient[:, 1])
    asked = np.einsum("bkcn,bcn->bkn", weighted, residual)
    turned = motion * own[:, None]
    turned += motion[:, :, ::-1] * cross[:, None, None]
    flat = motion.reshape(count, 6, 2 * pixels)
    normal = turned.reshape(flat.shape) @ flat.swapaxes(1, 2)
    slant = np.einsum("bin,bn->bi", flat, asked.reshape(count, -1))
    if lights := lit.shape[1]:
        weighted *= -b[:, None]
        at = weighted[:, None, :, 0] * lit[:, :, None, 0]  # (B, L, 2, N)
        for field in range(1, FIELDS):
            at += weighted[:, None, :, field] * lit[:, :, None, field]
        beside, rows = flat @ at.reshape(count, lights, -1).swapaxes(1, 2), lit.reshape(count, lights, -1)
        counted = weight * np.square(b)
        own_lit = (lit * counted[:, None]).reshape(rows.shape) @ rows.swapaxes(1, 2)
        asked_lit = np.einsum("bln,bn->bl", rows, (weight * -b * residual).reshape(count, -1))
        normal = np.block([[normal, beside], [beside.swapaxes(1, 2), own_lit]])
        slant = np.concatenate([slant, asked_lit], 1)
    return normal.astype(float), slant.astype(float)
