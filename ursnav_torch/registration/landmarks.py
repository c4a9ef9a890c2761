"""Registration from landmarks touched by the EM sensor and known in the kidney."""

import itertools
import warnings

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError, RegistrationError
from ursnav_torch.geometry import Array
from ursnav_torch.registration.result import Registration, skew
from ursnav_torch.registration.rigid import fit_rigid
from ursnav_torch.registration.suspicion import check_pairs, check_size, suspicions

#: Triples tried by RANSAC; all of them up to 26 landmarks.
_MAX_TRIPLES = 3000


class RegistrationWarning(UserWarning):
    """The registration was computed, but something about its input looks wrong."""


def register_landmarks(
    em: ArrayLike,
    kidney: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    with_scale: bool = False,
    ransac: float | None = None,
) -> Registration:
    """Least-squares transform from the EM to the kidney frame (thesis section 4.4; Arun et al., PAMI 1987).

    What looks wrong but can be computed (mirrored or shuffled sets, a wrong pair, a landmark entered twice, nearly
    collinear landmarks) is said in ``suspicions`` and as a `RegistrationWarning`.

    Args:
        em: (N, 3) landmarks in the EM frame, mm.
        kidney: (N, 3) the same landmarks in the kidney frame, mm, in the same order.
        weights: (N,) weights of the pairs: one over the variance of each.
        with_scale: fit a scale too.
        ransac: tolerance in mm; pairs farther off are left out (at least four, and more than half, must agree).

    Raises:
        ShapeError: not two sets (N, 3).
        InputError: NaN or infinite values; sets of different size, such as meters for mm.
        RegistrationError: fewer than three pairs, coincident or collinear landmarks, no agreement in RANSAC.
    """
    a, b, w = check_pairs(em, kidney, weights)
    used = w > 0
    if ransac is not None:
        used = _consensus(a, b, used, with_scale, ransac)
        check_pairs(a[used], b[used], None)
    if not with_scale:
        check_size(a[used], b[used])
    said = suspicions(a[used], b[used], lambda x, y: _rms(_residuals(x, y, np.ones(len(x)), with_scale)))
    for sentence in said:
        warnings.warn(sentence, RegistrationWarning, stacklevel=2)
    return _registration(a, b, np.where(used, w, 0.0), with_scale, said)


def _registration(a: Array, b: Array, w: Array, with_scale: bool, said: tuple[str, ...]) -> Registration:
    used = w > 0
    R, t, scale = _fit(a, b, w, with_scale)
    fre = np.linalg.norm(scale * a @ R.T + t - b, axis=1)
    loo = _leave_one_out(a, b, w, with_scale)
    known = np.isfinite(loo) & used
    center = np.average(b, axis=0, weights=w)
    return Registration(
        R=R,
        t_mm=t,
        scale=float(scale),
        n=int(used.sum()),
        fre_mm=fre,
        fre_rmse_mm=_rms(fre[used]),
        tre_loo_mm=loo,
        tre_loo_rmse_mm=_rms(loo[known]) if known.any() else None,
        used=used,
        center_mm=center,
        covariance=_covariance(scale * a @ R.T + t - center, fre, w, with_scale),
        suspicions=said,
    )


def _fit(a: Array, b: Array, w: Array, with_scale: bool) -> tuple[Array, Array, Array]:
    R, t, scale = fit_rigid(torch.from_numpy(a), torch.from_numpy(b), torch.from_numpy(w), with_scale=with_scale)
    return R.numpy(), t.numpy(), scale.numpy()


def _residuals(a: Array, b: Array, w: Array, with_scale: bool) -> Array:
    """(..., N) distances after the fit with weights (..., N)."""
    wide = np.broadcast_to(a, (*w.shape, 3)), np.broadcast_to(b, (*w.shape, 3))
    R, t, scale = _fit(wide[0].copy(), wide[1].copy(), w, with_scale)
    return np.linalg.norm(scale[..., None, None] * a @ np.swapaxes(R, -1, -2) + t[..., None, :] - b, axis=-1)


def _rms(distances: Array) -> float:
    return float(np.sqrt(np.mean(distances**2)))


def _leave_one_out(a: Array, b: Array, w: Array, with_scale: bool) -> Array:
    """(N,) error at each pair of the fit without it; NaN where the others do not fix a rotation."""
    others = np.broadcast_to(w, (len(w), len(w))) * (1 - np.eye(len(w)))
    loo = np.diagonal(_residuals(a, b, others, with_scale)).copy()
    for i, weights in enumerate(others):
        points = a[weights > 0]
        sides = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(points) < 3 or sides[1] < 1e-3 * sides[0]:
            loo[i] = np.nan
    return loo


def _covariance(from_center: Array, residual: Array, w: Array, with_scale: bool) -> Array:
    """(6, 6) covariance of rotation (rad) and shift (mm), from residuals (N,) and weights of points about their center.

    To first order the formula of Fitzpatrick, West and Maurer (TMI 1998), with their estimate of the localization
    error, ``FLE^2 = N / (N - 2) FRE^2``, written for any weights.
    """
    J = np.concatenate([-skew(from_center), np.broadcast_to(np.eye(3), (len(w), 3, 3))], axis=-1)
    freedom = 3 * np.count_nonzero(w) - (7 if with_scale else 6)
    variance = np.sum(w * residual**2) / freedom
    return variance * np.linalg.inv(np.einsum("n,nij,nik->jk", w, J, J))


def _consensus(a: Array, b: Array, used: NDArray[np.bool_], with_scale: bool, tolerance: float) -> NDArray[np.bool_]:
    """(N,) the pairs that agree to ``tolerance`` mm with the best triple, refitted until they stay the same."""
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"ransac={tolerance} must be a tolerance in mm, such as 5.0.")
    triples = np.zeros((0, 3), int)
    if used.sum() >= 3:
        triples = _triples(np.flatnonzero(used))
    weights = np.zeros((len(triples), len(a)))
    np.put_along_axis(weights, triples, 1.0, axis=1)
    distances = np.where(used, _residuals(a, b, weights, with_scale), np.inf)
    inlier = distances[np.minimum(distances, tolerance).sum(axis=1).argmin()] <= tolerance
    for _ in range(10):
        if inlier.sum() < 3:
            break
        before = inlier
        inlier = used & (_residuals(a, b, inlier.astype(float), with_scale) <= tolerance)
        if np.array_equal(before, inlier):
            break
    if inlier.sum() < max(4, used.sum() // 2 + 1):
        raise RegistrationError(
            f"Only {inlier.sum()} of {used.sum()} landmark pairs agree to {tolerance:g} mm; at least four, and more "
            "than half, must. Check the order of the pairs and the units, or allow a larger ransac tolerance."
        )
    return inlier


def _triples(index: NDArray[np.int64]) -> NDArray[np.int64]:
    count = len(index) * (len(index) - 1) * (len(index) - 2) // 6
    if count <= _MAX_TRIPLES:
        return np.array(list(itertools.combinations(index, 3)))
    rng = np.random.default_rng(0)
    return np.array([rng.choice(index, 3, replace=False) for _ in range(_MAX_TRIPLES)])
