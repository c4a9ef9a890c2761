"""EM logs whose rows name a picture, or number it."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.em_log.samples import EmSamples
from ursnav_torch.errors import InputError

Rows = NDArray[np.int64]

#: Fewer pictures in step than this say nothing about frame numbers.
_FEW = 3
#: Readings of one picture lie no farther apart, mm: a scope moves a few mm between two pictures.
_ONE_PICTURE_MM = 10.0
#: Numbers are none of the pictures' where less than the one share of the pictures has a reading, and more than the
#: other share of the readings no picture.
_FEW_PICTURES, _MANY_READINGS = 0.6, 0.3


def join_names(names: Sequence[str], images: Sequence[str]) -> Rows:
    """(M,) row of ``names`` that belongs to each image, -1 where none does.

    The same name counts first, at its first row; then the same name without folder, ending and leading zeros, unless
    two rows or two images share it.
    """
    exact = {name: i for i, name in reversed(list(enumerate(names)))}
    plain = [_plain(name) for name in names]
    count, pictures = Counter(plain), Counter(_plain(image) for image in set(images))
    loose = {name: i for i, name in enumerate(plain) if count[name] == 1 and pictures[name] == 1}
    return np.array([exact.get(image, loose.get(_plain(image), -1)) for image in images], int)


def check_counting(samples: EmSamples, images: Sequence[str]) -> None:
    """Refuse numbers from 1 of as many pictures as are counted from 0: each would have its neighbor's reading.

    Raises:
        InputError: they are.
    """
    if samples.key is None or samples.key_column != "frame":
        return
    try:
        numbers, pictures = ([int(float(_plain(word))) for word in words] for words in (samples.key, images))
    except (ValueError, OverflowError):
        return
    if (min(numbers), max(numbers)) == (1, max(pictures) + 1) and min(pictures) == 0 and len(pictures) > _FEW:
        raise InputError(
            f"{samples.source} counts its frames from 1 to {max(numbers)}, the pictures are counted from 0 to "
            f"{max(pictures)}: number them from 0, or say em_join=frame if picture 1 is really its frame 1."
        )


def check_keys(samples: EmSamples, named: Rows, ask: bool) -> None:
    """Refuse names or numbers that stand for several moments, and, with ``ask``, numbers that hardly fit the pictures.

    Raises:
        InputError: they do.
    """
    key, what = samples.key or (), samples.key_column
    rows_of: dict[str, list[int]] = {}
    for i, name in enumerate(key):
        rows_of.setdefault(name, []).append(i)
    for name in {key[i] for i in named if i >= 0}:
        rows = rows_of[name]
        seen = samples.position_mm[rows][samples.seen[rows]]
        apart = float(np.linalg.norm(np.ptp(seen, axis=0))) if len(seen) > 1 else 0.0
        if rows[-1] - rows[0] >= len(rows) or apart > _ONE_PICTURE_MM:
            raise InputError(
                f"{samples.source} has {len(rows)} readings of {what} {name}, {samples.stretch(rows[0], rows[-1])}, "
                f"{apart:.0f} mm apart: a counter that begins anew or stands still, or two recordings? "
                f"Give each picture its own {what}, or delete the column and join by t_s."
            )
    pictures, readings = float((named >= 0).mean()), 1 - len(set(named[named >= 0])) / max(len(key), 1)
    if ask and what == "frame" and pictures < _FEW_PICTURES and readings > _MANY_READINGS and len(named) > _FEW:
        raise InputError(
            f"Only {int((named >= 0).sum())} of {len(named)} pictures have a reading of {samples.source} by frame "
            f"number, and {readings:.0%} of its readings no picture: are its numbers the tracker's own, or of another "
            "recording? Say em_join=frame if they are the pictures', or give times: t_s in both, and em_join=time."
        )


def _plain(name: str) -> str:
    stem = Path(name).stem
    return (stem.lstrip("0") or "0") if stem.isascii() and stem.isdecimal() else stem
