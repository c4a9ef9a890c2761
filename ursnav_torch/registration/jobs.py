"""What the `register` runner does: a file in, a registration and a text about it out."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.registration.centerline import register_centerline
from ursnav_torch.registration.files import read_em_samples, read_landmarks
from ursnav_torch.registration.landmarks import register_landmarks
from ursnav_torch.registration.result import Registration
from ursnav_torch.registration.surface import register_surface
from ursnav_torch.registration.touch import touched_points


def landmarks_job(
    path: str | Path,
    kidney: Kidney | None = None,
    *,
    reach_mm: float = 0.0,
    with_scale: bool = False,
    ransac: float | None = None,
) -> Registration:
    """``registration=landmarks``: `register_landmarks` on a landmark file; the kidney is not needed.

    Args:
        path: CSV with the columns of `read_landmarks`.
        kidney: passed over.
        reach_mm: from the sensor's position to the tip that touched; needs the columns em_dx, em_dy, em_dz.
        with_scale, ransac: see `register_landmarks`.

    Raises:
        InputError, RegistrationError: as `register_landmarks` does; or the axes are missing.
    """
    pairs = read_landmarks(path)
    em = pairs.em_mm
    if reach_mm and pairs.em_axis is None:
        raise InputError(
            f"reach_mm={reach_mm} needs the sensor's axis at each touch: columns em_dx,em_dy,em_dz in {path}."
        )
    if reach_mm and pairs.em_axis is not None:
        em = touched_points(em, pairs.em_axis, reach_mm)
    return register_landmarks(em, pairs.kidney_mm, with_scale=with_scale, ransac=ransac)


def surface_job(path: str | Path, kidney: Kidney, *, trim: float = 0.9, max_error_mm: float = 5.0) -> Registration:
    """``registration=surface``: `register_surface` on a file of touched points (columns x_mm,y_mm,z_mm)."""
    found = register_surface(read_em_samples(path).position_mm, kidney.mesh, trim=trim, max_error_mm=max_error_mm)
    return replace(found, model_scale=kidney.scale)


def centerline_job(
    path: str | Path,
    kidney: Kidney,
    *,
    sensor_offset_mm: tuple[float, float, float] | None = None,
    max_error_mm: float = 5.0,
) -> Registration:
    """``registration=centerline``: `register_centerline` on a file of EM samples."""
    samples = read_em_samples(path)
    found = register_centerline(
        samples.position_mm,
        samples.axis,
        kidney.mesh,
        kidney.centerline,
        sensor_offset_mm=sensor_offset_mm,
        max_error_mm=max_error_mm,
    )
    return replace(found, model_scale=kidney.scale)


def registration_summary(found: Registration, kidney: Kidney | None = None) -> str:
    """A few lines for people: residuals, leave-one-out error, expected error over the kidney, suspicions."""
    unit = f"mm at scale {found.model_scale:g}"
    lines = [f"{found.method}: {found.n} of {len(found.fre_mm)} used, residual {found.fre_rmse_mm:.2f} RMS ({unit})"]
    if found.tre_loo_rmse_mm is not None:
        worst = int(np.nanargmax(found.tre_loo_mm))
        lines.append(
            f"leave-one-out error {found.tre_loo_rmse_mm:.2f} RMS, largest {found.tre_loo_mm[worst]:.2f} at pair {worst + 1}"
        )
    if kidney is not None:
        expected = found.tre_mm(kidney.tips_mm)
        names = ", ".join(f"{c.name} {e:.1f}" for c, e in zip(kidney.calyces, expected, strict=True))
        lines.append(f"expected error at the calyces: {names}")
    lines += [f"{name}: {value:.3g}" for name, value in (found.report or {}).items()]
    return "\n".join(lines)
