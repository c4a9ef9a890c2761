"""The choices of ``registration=`` for the `register` runner: files in, a registration and a text about it out."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ursnav_torch.em_log import EmSamples
from ursnav_torch.errors import InputError, naming
from ursnav_torch.kidney import Kidney
from ursnav_torch.registration.centerline import register_centerline
from ursnav_torch.registration.files import read_landmarks
from ursnav_torch.registration.landmarks import register_landmarks
from ursnav_torch.registration.result import Registration
from ursnav_torch.registration.touch import touched_points
from ursnav_torch.registration.touched_surface import register_surface


def landmarks_job(
    landmarks: Path | None,
    points: EmSamples | None,
    kidney: Kidney | None,
    *,
    reach_mm: float = 0.0,
    with_scale: bool = False,
    ransac: float | None = None,
    unit: str | None = None,
) -> Registration:
    """``registration=landmarks``: `register_landmarks` on a landmark file.

    Args:
        landmarks: CSV with the columns of `read_landmarks`.
        points: must be None.
        kidney: not needed; tells the scale where it is given.
        reach_mm: from the sensor's position to the tip that touched; needs the columns em_dx, em_dy, em_dz.
        with_scale, ransac: see `register_landmarks`.
        unit: of the landmarks' lengths, where the columns do not say it, or say it wrong.

    Raises:
        InputError, RegistrationError: as `register_landmarks` does; or a file or the axes are missing.
    """
    if landmarks is None or points is not None:
        raise InputError("registration=landmarks takes landmarks=FILE; points=FILE goes with surface or centerline.")
    pairs = read_landmarks(landmarks, unit)
    em = pairs.em_mm
    if reach_mm and pairs.em_axis is None:
        raise InputError(f"reach_mm={reach_mm} needs the columns em_dx,em_dy,em_dz (the sensor's axis) in {landmarks}.")
    with naming(landmarks):
        if reach_mm and pairs.em_axis is not None:
            em = touched_points(em, pairs.em_axis, reach_mm)
        found = register_landmarks(em, pairs.kidney_mm, with_scale=with_scale, ransac=ransac)
    return found if kidney is None else replace(found, model_scale=kidney.scale)


def surface_job(
    landmarks: Path | None,
    points: EmSamples | None,
    kidney: Kidney | None,
    *,
    trim: float = 0.9,
    max_error_mm: float = 5.0,
) -> Registration:
    """``registration=surface``: `register_surface` on touched points, with axes if known.

    Raises:
        InputError, RegistrationError: as `register_surface` does; or the points or the kidney are missing.
    """
    samples, kidney = _points_and_kidney("surface", landmarks, points, kidney)
    with naming(samples.source):
        found = register_surface(
            samples.position_mm, kidney.mesh, axis_em=samples.axis, trim=trim, max_error_mm=max_error_mm
        )
    return replace(found, model_scale=kidney.scale)


def centerline_job(
    landmarks: Path | None,
    points: EmSamples | None,
    kidney: Kidney | None,
    *,
    sensor_offset_mm: tuple[float, float, float] | None = None,
    max_error_mm: float = 5.0,
) -> Registration:
    """``registration=centerline``: `register_centerline` on EM samples.

    Raises:
        InputError, RegistrationError: as `register_centerline` does; or the points or the kidney are missing.
    """
    samples, kidney = _points_and_kidney("centerline", landmarks, points, kidney)
    with naming(samples.source):
        found = register_centerline(
            samples.position_mm,
            samples.axis,
            kidney.mesh,
            kidney.centerline,
            sensor_offset_mm=sensor_offset_mm,
            max_error_mm=max_error_mm,
        )
    return replace(found, model_scale=kidney.scale)


def _points_and_kidney(
    choice: str, landmarks: Path | None, points: EmSamples | None, kidney: Kidney | None
) -> tuple[EmSamples, Kidney]:
    if points is None or landmarks is not None:
        raise InputError(f"registration={choice} takes points=FILE; landmarks=FILE goes with registration=landmarks.")
    if kidney is None:
        raise InputError(f"registration={choice} needs the kidney: give vid=DIR, a folder from build_vid.")
    return points, kidney


def registration_summary(found: Registration, kidney: Kidney | None = None) -> str:
    """A few lines for people: residuals, leave-one-out error, expected error over the kidney, suspicions."""
    unit = f"mm at scale {found.model_scale:g}"
    lines = [f"{found.method}: {found.n} of {len(found.fre_mm)} used, residual {found.fre_rmse_mm:.2f} RMS ({unit})"]
    if found.tre_loo_rmse_mm is not None:
        worst = int(np.nanargmax(found.tre_loo_mm))
        largest = f"largest {found.tre_loo_mm[worst]:.2f} at pair {worst + 1}"
        lines.append(f"leave-one-out error {found.tre_loo_rmse_mm:.2f} RMS, {largest} ({unit})")
    if kidney is not None:
        expected = found.tre_mm(kidney.tips_mm)
        names = ", ".join(f"{c.name} {e:.1f}" for c, e in zip(kidney.calyces, expected, strict=True))
        lines.append(f"expected error at the calyces ({unit}): {names}")
    lines += [f"{name}: {value:.3g}" for name, value in (found.report or {}).items()]
    return "\n".join(lines)
