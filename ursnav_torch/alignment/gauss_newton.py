"""The arithmetic of one Gauss-Newton step, of B alignments at once.

Every pass through the pixels costs, so sums over them are the entries of one product of rows with themselves: of the
fields and a row of ones, and of the Jacobian's rows and the residual. These products of few long rows are PyTorch's.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.alignment.fields import Floats

Array = NDArray[np.float64]

#: Fields compared: relief, and the gradient's x and y.
FIELDS = 3
_TUKEY = 5.0  # residuals beyond this many root mean squares do not count
_LEAST_GAIN = 0.2
_LEAST_SIZE = 1e-6


def correlated(fields: Floats, good: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """How well fields of pictures and of drawings agree over the pixels that count.

    Args:
        fields: (B, 3 + 3 + 1, N) the pictures' first, then the drawings', then ones.
        good: (B, N) how much each pixel counts.

    Returns:
        How many count (B,); correlations (B, 3); and three numbers a field (B, 3, 1): the residual of fields that were
        brought to mean 0 and size 1, the drawing's times its correlation, is ``a * picture - b * drawing + c``.
    """
    sums = _products(fields * good[:, None], fields)
    count = np.maximum(sums[:, -1, -1], np.float32(1e-3))
    sums /= count[:, None, None]
    mean = sums[:, :-1, -1]
    square = sums[:, :-1, :-1] - mean[:, :, None] * mean[:, None]
    size = np.sqrt(np.maximum(np.einsum("bii->bi", square), 0)) + np.float32(_LEAST_SIZE)
    each = np.arange(FIELDS)
    correlation = square[:, each, FIELDS + each] / (size[:, :FIELDS] * size[:, FIELDS:])
    a, b = 1 / size[:, :FIELDS], np.maximum(correlation, np.float32(_LEAST_GAIN)) / size[:, FIELDS:]
    c = b * mean[:, FIELDS:] - a * mean[:, :FIELDS]
    return count, correlation, a[..., None], b[..., None], c[..., None]


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

    Args:
        motion: (B, 6, 2, N) of the pixels, which all fields share.
        gradient: (B, 2, 3, N) of each field.
        lit: (B, L, 3, N) what the light changes.
        b: (B, 3, 1) see `correlated`.
        weight, residual: (B, 3, N).
    """
    count, size = len(motion), 6 + lit.shape[1]
    rows = np.empty((count, size + 1, *residual.shape[1:]), np.float32)
    np.multiply(motion[:, :, 0, None], gradient[:, None, 0], out=rows[:, :6])
    rows[:, :6] += motion[:, :, 1, None] * gradient[:, None, 1]
    np.multiply(lit, -b[:, None], out=rows[:, 6:size])
    rows[:, size] = residual
    rows *= np.sqrt(weight)[:, None]
    flat = rows.reshape(count, size + 1, -1)
    sums = _products(flat, flat).astype(float)
    return sums[:, :size, :size], sums[:, :size, size]


def _products(one: Floats, other: Floats) -> Floats:
    """Products (B, R, S) of rows (B, R, N) and (B, S, N)."""
    return np.asarray(torch.bmm(torch.from_numpy(one), torch.from_numpy(other).transpose(1, 2)).numpy())
