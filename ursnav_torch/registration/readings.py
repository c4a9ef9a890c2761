"""EM samples as readings in the kidney frame, as tracking takes them."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.em_log import EmFormat, EmSamples, join_pictures, read_em_samples
from ursnav_torch.errors import InputError
from ursnav_torch.registration.result import Registration
from ursnav_torch.tracking.follow import Moment
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.units import other_units

Array = NDArray[np.float64]

#: Root mean square noise of a 5-DoF sensor, mm of the EM frame; how far the kidney moves on its own, mm of the kidney.
SENSOR_MM, BREATH_MM = 0.7, 0.8
#: A scope in the kidney has its sensor no farther than this outside the lumen's bounds, mm.
_FAR_MM = 100.0
#: Readings farther from where they belong than this, in the median, and in another unit nearer, are in that unit, mm.
_ODD_MM = 20.0


def readings_in_kidney(
    em_to_kidney: Path, offset_camera_mm: Sequence[float]
) -> Callable[[ArrayLike], list[SensorReading | None]]:
    """What turns positions (N, 3) mm in the EM frame into readings; None where a position is not finite.

    Args:
        em_to_kidney: the file that `register` made.
        offset_camera_mm: (3,) the sensor's place in the camera frame, mm of the EM frame.

    Raises:
        InputError: one of them cannot be used.
    """
    offset = np.asarray(offset_camera_mm, float)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InputError(f"sensor_offset_mm must be [x,y,z] in mm in the camera frame, got {offset_camera_mm}.")
    registration = Registration.from_json(em_to_kidney)
    offset, sensor_mm = registration.scale * offset, registration.scale * SENSOR_MM

    def readings(position_em_mm: ArrayLike) -> list[SensorReading | None]:
        position = registration.apply(np.asarray(position_em_mm, float))
        tre = np.nan_to_num(registration.tre_mm(position))
        sigma = np.sqrt((sensor_mm**2 + tre**2 + BREATH_MM**2) / 3)
        return [
            SensorReading(p, offset, float(s)) if np.isfinite(p).all() else None
            for p, s in zip(position, sigma, strict=True)
        ]

    return readings


def recorded_readings(
    em: Path,
    em_to_kidney: Path | None,
    offset_camera_mm: Sequence[float],
    images: Sequence[str],
    t_s: ArrayLike,
    form: EmFormat | None = None,
    bounds_mm: ArrayLike | None = None,
) -> tuple[Callable[[Moment], SensorReading | None], str]:
    """Readings of an EM log for the pictures of a recording, and a line that says how many have one.

    Args:
        em: the log, see `read_em_samples`.
        em_to_kidney: the file that `register` made.
        offset_camera_mm: (3,) the sensor's place in the camera frame.
        images, t_s: names and times (M,) of the pictures, in their order; see `join_pictures`.
        form: what the log does not tell.
        bounds_mm: (2, 3) corners of the kidney.

    Raises:
        InputError: no registration is given, a file cannot be used, or the readings are nowhere near the kidney.
    """
    if em_to_kidney is None:
        raise InputError("em= needs em_to_kidney=, the registration that `register` makes from landmarks.")
    to_kidney = readings_in_kidney(em_to_kidney, offset_camera_mm)
    joined = join_pictures(read_em_samples(em, form), images, t_s, form)
    readings = to_kidney(joined.samples.position_mm)
    if bounds_mm is not None:
        registration = Registration.from_json(em_to_kidney)
        _check_near(joined.samples.visible(), registration, np.asarray(bounds_mm, float), em_to_kidney)

    def reading(moment: Moment) -> SensorReading | None:
        return readings[moment.frame] if moment.frame < len(readings) else None

    return reading, joined.said()


def check_em_unit(
    position_em_mm: Array, away: Callable[[Array], Array], what: str, mend: str = "say em_unit={unit}"
) -> None:
    """Refuse positions (N, 3) in the EM frame that are near where they belong in another unit than mm alone.

    Args:
        position_em_mm: as they were read.
        away: how far (N,) positions are from where they belong, mm.
        what: their file.
        mend: what the user does, with ``{unit}`` in it.

    Raises:
        InputError: see there.
    """
    off = float(np.median(away(position_em_mm)))
    if not off > _ODD_MM:
        return
    units = other_units(position_em_mm, lambda p: float(np.median(away(p))) < min(_ODD_MM, off / 4))
    if units:
        raise InputError(
            f"By the registration, the {len(position_em_mm)} positions of {what} are {off:.0f} mm from where they "
            f"belong, and near if they are in {' or '.join(units)}: {mend.format(unit=units[0])}."
        )


def _check_near(seen: EmSamples, registration: Registration, bounds_mm: Array, em_to_kidney: Path) -> None:
    def outside(position_em_mm: Array) -> Array:
        at = registration.apply(position_em_mm)
        return np.linalg.norm(np.maximum(np.maximum(bounds_mm[0] - at, at - bounds_mm[1]), 0), axis=1)

    check_em_unit(seen.position_mm, outside, seen.source)
    away = outside(seen.position_mm)
    if away.min() > _FAR_MM:
        raise InputError(
            f"By {em_to_kidney}, the {len(away)} readings of {seen.source} lie {away.min():.0f} to {away.max():.0f} mm "
            "outside the kidney: the registration belongs to another EM frame or kidney, or the log to another unit "
            "(em_unit=)."
        )
