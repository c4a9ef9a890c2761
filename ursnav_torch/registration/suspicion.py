"""What may be wrong with landmark pairs: refusals for what cannot be solved, sentences for what looks odd."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ursnav_torch.errors import InputError, RegistrationError, ShapeError
from ursnav_torch.geometry import Array

#: Size ratios that have a name, kidney over EM.
_KNOWN_RATIOS = (
    (1e-3, "the kidney points are in meters, the EM points in mm: multiply them by 1000"),
    (1e3, "the EM points are in meters, the kidney points in mm: multiply them by 1000"),
    (6e-3, "the kidney points are in Unity units of the thesis's scene: divide by 6 and multiply by 1000"),
    (0.1, "the kidney points are in cm: multiply them by 10"),
    (10.0, "the EM points are in cm: multiply them by 10"),
    (1.8, "the kidney points are of a phantom printed 1.8 times larger than what was touched"),
    (1 / 1.8, "the phantom touched was printed 1.8 times larger than the kidney model: use the model at scale 1.8"),
)
#: Residual over spread above which pairs are looked at twice; noise of 5 mm in 85 mm (the thesis) gives 0.07.
_ODD_RESIDUAL = 0.12


def check_pairs(em: ArrayLike, kidney: ArrayLike, weights: ArrayLike | None) -> tuple[Array, Array, Array]:
    """The pairs (N, 3), (N, 3) and weights (N,) as float64, refused where no rotation can be found from them.

    Raises:
        ShapeError: not two sets (N, 3) of the same length, or weights not (N,).
        InputError: not finite, or a negative weight.
        RegistrationError: fewer than three pairs of positive weight, or points that coincide or lie on one line.
    """
    a, b = np.asarray(em, float), np.asarray(kidney, float)
    if a.ndim != 2 or a.shape[-1] != 3 or a.shape != b.shape:
        raise ShapeError(f"Landmarks must be two sets (N, 3) in the same order, got EM {a.shape} and kidney {b.shape}.")
    w = np.ones(len(a)) if weights is None else np.asarray(weights, float)
    if w.shape != (len(a),):
        raise ShapeError(f"weights must have shape ({len(a)},), one a pair, got {w.shape}.")
    bad = np.flatnonzero(~np.isfinite(np.c_[a, b, w]).all(axis=1))
    if len(bad):
        raise InputError(
            f"Landmark {bad[0] + 1} is not finite (NaN or infinite): EM {a[bad[0]]}, kidney {b[bad[0]]}. "
            "A sensor that was not visible often writes NaN; touch that landmark again or leave it out."
        )
    if np.any(w < 0):
        raise InputError(f"weights must not be negative, got {w.min()}.")
    for name, points in (("EM", a[w > 0]), ("kidney", b[w > 0])):
        _check_spread(points, name)
    return a, b, w


def _check_spread(points: Array, name: str) -> None:
    if len(points) < 3:
        raise RegistrationError(
            f"{len(points)} landmark pairs do not fix a rotation (two leave the turn about the line through them "
            "free); at least three that are not on a line are needed, six or more are better."
        )
    size = np.linalg.norm(points, axis=1).max()
    sides = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if sides[0] <= 1e-9 * max(size, 1e-12):
        raise RegistrationError(
            f"All {name} landmarks coincide at {points[0]}: the rotation is free. Touch different places."
        )
    if sides[1] < 1e-3 * sides[0]:
        raise RegistrationError(
            f"The {name} landmarks are collinear ({sides[1] / len(points) ** 0.5:.3g} mm RMS off one line): the turn "
            "about that line is free. Add a landmark beside the line."
        )


def check_size(em: Array, kidney: Array) -> float:
    """Ratio of the RMS radii of two sets (N, 3), kidney over EM.

    Raises:
        InputError: they differ by more than half, as they do when units are mixed up.
    """
    ratio = float(np.linalg.norm(kidney - kidney.mean(axis=0)) / np.linalg.norm(em - em.mean(axis=0)))
    if 2 / 3 < ratio < 3 / 2:
        return ratio
    guess = min(_KNOWN_RATIOS, key=lambda known: abs(np.log(ratio / known[0])))
    near = abs(np.log(ratio / guess[0])) < np.log(1.12)
    hint = f"It looks as if {guess[1]}." if near else "Check the units; both must be mm."
    raise InputError(
        f"The kidney landmarks spread {ratio:.4g} times as far as the EM landmarks; a rigid registration needs equal "
        f"sizes. {hint} (A scale is fitted only on request: with_scale=true.)"
    )


def suspicions(em: Array, kidney: Array, residual: Callable[[Array, Array], float]) -> tuple[str, ...]:
    """Sentences about pairs (N, 3), (N, 3) that a rigid transform explains badly, and better if something were changed.

    ``residual(em, kidney)`` is the RMS residual of the fit. Pairs with a residual below an eighth of their spread are
    taken as they are.
    """
    spread = np.linalg.norm(kidney - kidney.mean(axis=0)) / len(kidney) ** 0.5
    found = residual(em, kidney)
    said = _nearly_flat_or_straight(em) + _repeated(em, kidney)
    if found < _ODD_RESIDUAL * spread:
        return said
    says = f"the residual is {found:.1f} mm RMS where the landmarks spread {spread:.1f} mm"
    mirrored = residual(em * [1, 1, -1], kidney)
    if mirrored < 0.5 * found:
        return (
            *said,
            f"One set looks mirrored ({says}; with one axis flipped it is {mirrored:.1f} mm): "
            "coordinates from Unity or another left-handed program need their z flipped.",
        )
    order = best_order(em, kidney)
    shuffled = residual(em, kidney[order])
    if shuffled < 0.5 * found:
        moved = np.flatnonzero(order != np.arange(len(order)))
        pairs = ", ".join(f"EM {i + 1} with kidney {order[i] + 1}" for i in moved[:6])
        return (
            *said,
            f"The pairs look shuffled ({says}; in another order it is {shuffled:.1f} mm). "
            f"Try pairing {pairs}{' ...' if len(moved) > 6 else ''}.",
        )
    return (*said, f"The pairs fit badly ({says}). {_worst_pair(em, kidney, residual, found)}")


def _worst_pair(em: Array, kidney: Array, residual: Callable[[Array, Array], float], found: float) -> str:
    without = [residual(np.delete(em, i, 0), np.delete(kidney, i, 0)) for i in range(len(em))]
    i = int(np.argmin(without))
    if len(em) > 4 and without[i] < 0.5 * found:
        return f"Pair {i + 1} looks wrong: without it the residual is {without[i]:.1f} mm (ransac=5.0 leaves it out)."
    return "Several pairs may be wrong, or the kidney has changed its shape since the scan."


def best_order(em: Array, kidney: Array) -> np.ndarray:
    """(N,) order that seems to pair ``kidney[order]`` with ``em``: by each point's sorted distances to the others."""
    signature = [np.sort(cdist(points, points), axis=1) for points in (em, kidney)]
    return linear_sum_assignment(cdist(*signature))[1]


def _nearly_flat_or_straight(em: Array) -> tuple[str, ...]:
    sides = np.linalg.svd(em - em.mean(axis=0), compute_uv=False)
    if sides[1] > 0.05 * sides[0]:
        return ()
    return (
        f"The landmarks lie almost on a line ({sides[0] / sides[1]:.0f} times as long as wide): the turn about it is "
        "poorly known. Add landmarks beside the line.",
    )


def _repeated(em: Array, kidney: Array) -> tuple[str, ...]:
    same = [np.argwhere(np.triu(cdist(points, points) < 1e-6, k=1)).tolist() for points in (em, kidney)]
    said = []
    for i, j in sorted({tuple(pair) for pair in same[0] + same[1]}):
        where = " and ".join(name for name, found in zip(("EM", "kidney"), same, strict=True) if [i, j] in found)
        said.append(f"Landmarks {i + 1} and {j + 1} coincide ({where}): one was probably entered twice.")
    return tuple(said)
