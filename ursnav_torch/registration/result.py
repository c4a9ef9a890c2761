"""The result of a registration: the transform, its residuals, and how far it can be trusted where."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.files import write_json
from ursnav_torch.geometry import Array, check_rigid, transform_from
from ursnav_torch.records import read_json, to_record

_Row = tuple[float, float, float]
_Row6 = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """EM frame -> kidney frame: ``p_kidney = scale * R @ p_em + t_mm``.

    Lengths are mm of the kidney as it was given: ``model_scale`` times anatomy's.

    Attributes:
        R: (3, 3) rotation.
        t_mm: (3,) translation.
        scale: size of the kidney over size in the EM frame; 1 unless it was fitted.
        n: number of pairs or samples that the fit used.
        fre_mm: (M,) residual of every pair or sample given, used or not.
        fre_rmse_mm: root mean square residual of those used.
        tre_loo_mm: (M,) error at each pair when it is left out of the fit; empty where there is no such thing.
        tre_loo_rmse_mm: its root mean square over the pairs used, or None.
        used: (M,) which pairs or samples the fit used.
        center_mm: (3,) kidney frame, the point about which the covariance is stated, or None.
        covariance: (6, 6) of a small rotation vector about ``center_mm`` (rad, kidney axes) and a small shift (mm),
            or None where the error of the transform is not known.
        method: ``landmarks``, ``surface`` or ``centerline``.
        suspicions: sentences that say what may be wrong with the input.
        report: further figures about the fit, by name.
        model_scale: 1.0 where the kidney has its natural size, 1.8 for the phantom of the thesis; for people to read.
    """

    R: Array
    t_mm: Array
    scale: float
    n: int
    fre_mm: Array
    fre_rmse_mm: float
    tre_loo_mm: Array
    tre_loo_rmse_mm: float | None
    used: NDArray[np.bool_]
    center_mm: Array | None = None
    covariance: Array | None = None
    method: str = "landmarks"
    suspicions: tuple[str, ...] = ()
    report: dict[str, float] | None = None
    model_scale: float = 1.0

    @property
    def T_kidney_em(self) -> Array:  # noqa: N802
        """(4, 4) the transform; its 3x3 part carries the scale where one was fitted."""
        return transform_from(self.scale * self.R, self.t_mm)

    def apply(self, points_em: ArrayLike) -> Array:
        """Points (..., 3) of the EM frame in the kidney frame."""
        return self.scale * np.asarray(points_em, float) @ self.R.T + self.t_mm

    def apply_direction(self, directions_em: ArrayLike) -> Array:
        """Directions (..., 3) of the EM frame in the kidney frame."""
        return np.asarray(directions_em, float) @ self.R.T

    def error_covariance(self, points_kidney: ArrayLike) -> Array:
        """(..., 3, 3) covariance in mm^2 of the registration's error at points (..., 3), kidney frame.

        A registration read from a file that does not say it has the same error everywhere: its leave-one-out error, or
        its residual where even that is missing.
        """
        p = np.asarray(points_kidney, float)
        if self.covariance is None or self.center_mm is None:
            rmse = self.tre_loo_rmse_mm if self.tre_loo_rmse_mm is not None else self.fre_rmse_mm
            return np.broadcast_to(np.eye(3) * rmse**2 / 3, (*p.shape, 3)).copy()
        J = np.concatenate([-skew(p - self.center_mm), np.broadcast_to(np.eye(3), (*p.shape, 3))], axis=-1)
        return J @ self.covariance @ np.swapaxes(J, -1, -2)

    def tre_mm(self, points_kidney: ArrayLike) -> Array:
        """(...) expected root mean square error of the registration at points (..., 3), kidney frame.

        From landmarks this is the formula of Fitzpatrick, West and Maurer (TMI 1998).
        """
        return np.sqrt(np.trace(self.error_covariance(points_kidney), axis1=-2, axis2=-1))

    def to_json(self, path: str | Path, overwrite: bool = True) -> None:
        """Write the ``register`` JSON, whole or not at all; what is unknown is null."""
        data = {k: _plain(v) for k, v in asdict(self).items()} | {"from": "em", "to": "kidney"}
        write_json(Path(path), data, overwrite)

    @classmethod
    def from_json(cls, path: str | Path) -> "Registration":
        """Read and check a ``register`` JSON. Only ``R`` and ``t_mm`` must be there; unknown keys are passed over.

        Raises:
            InputError: the file cannot be read, or does not hold a transform from the EM to the kidney frame.
        """
        data = read_json(Path(path), "registration")
        if not isinstance(data, dict) or not {"R", "t_mm"} <= data.keys():
            raise InputError(
                f"{path} is not a registration: it needs the keys R (3x3) and t_mm. Make one with `register`."
            )
        if (data.get("from", "em"), data.get("to", "kidney")) != ("em", "kidney"):
            raise InputError(
                f"{path} maps {data.get('from')!r} to {data.get('to')!r}; expected from 'em' to 'kidney'. "
                "Invert it first."
            )
        try:
            return to_record(data, _RegistrationFile, "Its content").registration()
        except InputError as error:
            raise InputError(f"{path} is not a registration: {error}") from error


@dataclass(frozen=True, slots=True)
class _RegistrationFile:
    """What a ``register`` JSON may hold, by its keys; only the transform must be there."""

    R: tuple[_Row, _Row, _Row]
    t_mm: _Row
    scale: float = 1.0
    n: int | None = None
    fre_mm: tuple[float | None, ...] | None = None
    fre_rmse_mm: float | None = None
    tre_loo_mm: tuple[float | None, ...] | None = None
    tre_loo_rmse_mm: float | None = None
    used: tuple[bool, ...] | None = None
    center_mm: _Row | None = None
    covariance: tuple[_Row6, _Row6, _Row6, _Row6, _Row6, _Row6] | None = None
    method: str = "landmarks"
    suspicions: tuple[str, ...] = ()
    report: dict[str, float] | None = None
    model_scale: float = 1.0

    def registration(self) -> Registration:
        """The registration; raises InputError for a transform that moves no rigid body."""
        R, fre = np.array(self.R, float), _array(self.fre_mm)
        check_rigid(transform_from(R, self.t_mm), "R")
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise InputError(f"scale={self.scale} must be a positive number.")
        known = self.covariance is not None and self.center_mm is not None
        covariance = np.array(self.covariance, float) if known else None
        if covariance is not None and np.linalg.eigvalsh(covariance).min() < -1e-9 * np.abs(covariance).max():
            raise InputError("covariance is not positive semidefinite.")
        return Registration(
            R=R,
            t_mm=np.array(self.t_mm, float),
            scale=self.scale,
            n=len(fre) if self.n is None else self.n,
            fre_mm=fre,
            fre_rmse_mm=self.fre_rmse_mm or 0.0,
            tre_loo_mm=_array(self.tre_loo_mm),
            tre_loo_rmse_mm=self.tre_loo_rmse_mm,
            used=np.ones(len(fre), bool) if self.used is None else np.array(self.used, bool),
            center_mm=np.array(self.center_mm, float) if known else None,
            covariance=covariance,
            method=self.method,
            suspicions=self.suspicions,
            report=self.report,
            model_scale=self.model_scale,
        )


def skew(v: ArrayLike) -> Array:
    """Matrices (..., 3, 3) with ``skew(v) @ x == cross(v, x)`` of vectors (..., 3)."""
    return np.cross(np.asarray(v, float)[..., None, :], -np.eye(3))


def _plain(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype == bool or np.all(np.isfinite(value)):
        return value.tolist()
    return [v if np.isfinite(v) else None for v in value.tolist()]


def _array(values: tuple[float | None, ...] | None) -> Array:
    """Numbers (M,) of a file; null is NaN."""
    return np.array(values or (), float)
