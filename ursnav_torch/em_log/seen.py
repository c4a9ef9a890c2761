"""Trackers' words for "not visible": flags, blanks, numbers beyond any field, zeros."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.tables import Row

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: A number beyond this is a tracker's word for "not visible", such as NDI's bad float -3.697314E28.
NO_NUMBER = 1e6
#: Cells that stand for no number.
NO_READING = {"", "-", "nan", "na", "n/a", "#n/a", "null", "none", "missing",
              "inf", "-inf", "+inf", "infinity", "-infinity"}  # fmt: skip
#: No field generator reaches farther, mm; what one value repeats beyond it (-9999) means "not visible", too.
FIELD_MM = 5000.0
#: Zeros are a reading where others come this near to the EM frame's origin, mm.
_NEAR_ORIGIN_MM = 10.0

_YES, _NO = {"1", "true", "yes"}, {"0", "false", "no"}
_GOOD = {"ok", "visible", "valid", "tracked", "tracking", "enabled", "good", "seen", "in volume"}
_BAD = {"", "invalid", "missing", "not visible", "invisible", "lost", "disabled", "bad", "unseen", "unknown", "nan",
        "none", "not tracked", "out of volume", "out of range", "partially out of volume"}  # fmt: skip
#: What the columns with flags may say: the words for a sensor that was visible, and for one that was not.
_FLAGS = dict.fromkeys(("visible", "valid", "tracked", "seen", "state", "status"), (_YES | _GOOD, _NO | _BAD)) | (
    dict.fromkeys(("missing", "invalid", "out_of_volume", "out_of_range"), (_NO | {""}, _YES))
)


def flagged_seen(rows: list[Row], names: Mapping[str, str]) -> BoolArray:
    """(N,) whether a row's flags, where there are any, call the sensor visible; ``names`` by their small letters.

    Raises:
        InputError: a word that is none of those known.
    """
    seen = np.ones(len(rows), bool)
    for column, (yes, no) in _FLAGS.items():
        if column not in names:
            continue
        for i, row in enumerate(rows):
            word = " ".join(row[names[column]].lower().replace("_", " ").split())
            if word not in yes | no:
                raise InputError(
                    f"{row.path}, line {row.line}: {column} is {word!r}; known are {', '.join(sorted(yes - {''}))} "
                    f"and {', '.join(sorted(no - {''}))}. Rename the column if it means another thing."
                )
            seen[i] &= word in yes
    return seen


def in_field(position_mm: Array, rows: list[Row]) -> BoolArray:
    """(N,) rows with a position (N, 3) that a tracker can reach.

    Raises:
        InputError: positions beyond any field that differ, so that they are no word for "not visible".
    """
    far = np.abs(np.nan_to_num(position_mm)).max(axis=1) > FIELD_MM
    if far.any() and len(np.unique(np.nan_to_num(position_mm[far]), axis=0)) > 2:
        row, at = rows[int(far.argmax())], np.round(position_mm[far][0], 1).tolist()
        raise InputError(
            f"{row.path}, line {row.line}: the position {at} mm is farther away than any tracker reaches "
            f"({FIELD_MM:.0f} mm). If the columns are in another unit, say which: em_unit=mm, cm, m or in."
        )
    return np.isfinite(position_mm).all(axis=1) & ~far


def no_place(position_mm: Array) -> BoolArray:
    """(N,) rows of positions (N, 3) that are a word for "not visible", whatever the axis beside them.

    Zeros, where the readings else stay away from the EM frame's origin; and one number three times (-1, 999) in more
    than one row, where others differ.
    """
    known: BoolArray = np.asarray(np.isfinite(position_mm).all(axis=1))
    same = known & (np.ptp(np.nan_to_num(position_mm), axis=1) == 0)
    zero = same & (position_mm[:, 0] == 0)
    others = position_mm[known & ~same]
    if not len(others):
        return np.zeros(known.shape, bool)
    repeated = [value for value in np.unique(position_mm[same & ~zero, 0]) if np.sum(position_mm[same, 0] == value) > 1]
    far = np.linalg.norm(others, axis=1).min() >= _NEAR_ORIGIN_MM
    return np.asarray((zero & far) | (same & np.isin(position_mm[:, 0], repeated)))
