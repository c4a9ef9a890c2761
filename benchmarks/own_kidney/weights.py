"""The weights of evidence in the own-kidney test, by logistic regression."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ursnav_torch.tracking.settings import OwnKidneySettings

Array = NDArray[np.float64]

#: Of the squared weights but the constant, beside sequences that count `_EACH` pictures apiece.
_RIDGE, _EACH = 0.01, 100.0
#: Part of the evidence in doubt that is of the score's lead over the decoy's alone, and what is added to it in every
#: picture, as people seldom load another kidney's VID.
RELATIVE, PRIOR = 0.5, 0.5


def fitted(
    own: Sequence[Array],
    other: Sequence[Array],
    settings: OwnKidneySettings,
    relative: float = RELATIVE,
    prior: float = PRIOR,
) -> OwnKidneySettings:
    """The settings with weights that tell sequences in the right kidney's VID from those in another's.

    In doubt two regressions count, a free one and one that sees the score's lead over the decoy's alone: how high a
    right kidney's scores are was learned from drawings, and other light does not reach it.

    Args:
        own, other: evidence (N, 3) of each sequence: score, fit and decoy, see `KidneyEvidence`; rows with nan, of
            pictures that were not asked, do not count. Both sides and all of a side's sequences count alike.
        settings: all but the weights.
        relative, prior: see `RELATIVE`.
    """
    rows = [e[np.isfinite(e).all(1)] for e in (*own, *other)]
    right = np.concatenate([np.full(len(e), i < len(own)) for i, e in enumerate(rows)])
    half = (len(own) + len(other)) / 2
    shares = [_EACH * half / (len(own) if i < len(own) else len(other)) / max(len(e), 1) for i, e in enumerate(rows)]
    counts = np.concatenate([np.full(len(e), share) for e, share in zip(rows, shares, strict=True)])
    score, fit, decoy = np.concatenate(rows).T
    ones = np.ones(len(right))
    plain = _regression(np.column_stack([ones, score, fit]), right, counts)
    free = _regression(np.column_stack([ones, score, fit, decoy]), right, counts)
    constant, lead = _regression(np.column_stack([ones, score - decoy]), right, counts)
    doubt = (1 - relative) * np.array(free) + relative * np.array([constant, lead, 0.0, -lead])
    doubt[0] += prior
    return replace(settings, weights=tuple(plain), doubt_weights=tuple(round(float(w), 1) for w in doubt))


def _regression(basis: Array, right: NDArray[np.bool_], counts: Array) -> list[float]:
    """Weights (B,) of a basis (M, B), whose first column is 1, by maximum likelihood."""
    sign, ridge = np.where(right, 1.0, -1.0), np.full(basis.shape[1], _RIDGE)
    ridge[0] = 0.0

    def loss(w: Array) -> tuple[float, Array]:
        z = sign * (basis @ w)
        slope = -(sign * counts / (1 + np.exp(np.minimum(z, 500.0)))) @ basis
        return float(counts @ np.logaddexp(0, -z) + 0.5 * ridge @ w**2), slope + ridge * w

    found = minimize(loss, np.zeros(basis.shape[1]), jac=True, method="L-BFGS-B").x
    return [round(float(w), 1) for w in found]
