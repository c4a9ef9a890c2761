"""Can an EM log's lengths be in mm? A scope in a kidney moves some cm, some way off the field generator."""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.em_log.samples import EmFormat
from ursnav_torch.errors import InputError

Array = NDArray[np.float64]

#: Fewer readings tell no size of the path.
_FEW = 10
#: A sensor that is held still scatters by more than this, mm: a smaller spread is one of meters.
_STILL_MM = 0.5
#: A path as short as this, so near the EM frame's origin, is one of centimeters or inches, mm: collecting systems are
#: 40 to 150 mm long, and field generators see from 50 mm (NDI Aurora, planar) or 120 mm (table top) on.
_SHORT_MM, _NEAR_MM = 15.0, 100.0
#: The same of a short log: a scope that is moved goes faster, mm/s; and what trackers read a second, whatever is said.
_SLOW_MM_S, _RATE_HZ = 1.0, 40.0
#: A path as long as this is no scope's in a kidney, mm: one of millimeters under a name in cm.
_LONG_MM = 300.0
#: What of the path counts, percentiles: a sensor is seen before and after, too, and sometimes wrong.
_MIDDLE = (10, 90)


def check_lengths(position_mm: Array, t_s: Array | None, source: str, form: EmFormat) -> None:
    """Refuse positions (N, 3), NaN where not visible, whose path is no scope's, unless ``em_unit`` says their unit.

    ``t_s`` (N,) are their times, where known.

    Raises:
        InputError: see there.
    """
    seen = position_mm[np.isfinite(position_mm).all(axis=1)]
    if form.unit is not None or len(seen) < _FEW:
        return
    spread = float(np.linalg.norm(np.ptp(seen, axis=0)))
    low, high = np.percentile(seen, _MIDDLE, axis=0)
    path = float(np.linalg.norm(high - low))
    away = float(np.linalg.norm(seen, axis=1).max())
    if 0 < spread < _STILL_MM:
        raise InputError(
            f"The {len(seen)} positions of {source} lie within {spread:.2g} mm, closer than a sensor that is held "
            "still. If they are in meters, say em_unit=m (or cm, in); if they are right, em_unit=mm."
        )
    known = np.array([]) if t_s is None else t_s[np.isfinite(t_s)]
    lasted = min(float(np.ptp(known)) if len(known) else np.inf, len(seen) / _RATE_HZ)
    if path < min(_SHORT_MM, _SLOW_MM_S * lasted) and away < _NEAR_MM:
        raise InputError(
            f"The {len(seen)} positions of {source} lie within {path:.2g} mm and no farther than {away:.2g} mm from "
            "the field generator, where a scope moves some centimeters some way off it. If they are in centimeters, "
            "say em_unit=cm, if in inches em_unit=in; if they are right, em_unit=mm."
        )
    if path > _LONG_MM:
        raise InputError(
            f"The {len(seen)} positions of {source} are spread over {path:.4g} mm, and no kidney is as large. If they "
            "are in millimeters whatever the column's name says, say em_unit=mm; give only what was recorded in the "
            "kidney; and if they are right, say their unit, em_unit=mm, cm, m or in."
        )
