"""Where pictures come from: video files, folders, cameras."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.features import IMAGE_SUFFIXES, read_image
from ursnav_torch.files import natural_key
from ursnav_torch.tracking.follow import Moment, Source


def open_source(path: Path, fps: float = 10.0) -> Source:
    """The pictures of a video file, or of a folder in natural order, ``fps`` a second.

    Raises:
        InputError: there is nothing there, or nothing that can be read.
    """
    if path.is_dir():
        return _folder(path, fps)
    if not path.is_file():
        raise InputError(f"There is no video or folder {path}; source= takes one of the two, or camera.")
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            raise InputError(
                f"{path} is not a video that can be read: it is of an unknown kind, or its end, with the list of its "
                "frames, is missing. Copy it again, or repair it with ffmpeg."
            )
        count, rate = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), float(capture.get(cv2.CAP_PROP_FPS))
        if not capture.read()[0]:
            raise InputError(f"The video {path} has no frames that can be read (it says it has {max(count, 0)}).")
    finally:
        capture.release()
    rate = rate if np.isfinite(rate) and 0 < rate < 1000 else fps
    return Source(lambda: _video(path, rate), max(count, 0), str(path))


def live_source(read: Callable[[], NDArray[np.uint8] | None], seconds: float | None) -> Source:
    """Pictures as a camera gives them, until some seconds have passed or it is interrupted (Ctrl-C).

    Args:
        read: waits for the next picture; None when the camera is at its end.
        seconds: how long; None for ever.
    """

    def moments() -> Iterator[Moment]:
        start, number = time.monotonic(), 0
        try:
            while (image := read()) is not None:
                t_s = time.monotonic() - start
                if seconds is not None and t_s > seconds:
                    return
                yield Moment(number, t_s, image, str(number))
                number += 1
        except KeyboardInterrupt:
            return

    return Source(moments, 0, "the camera", live=True)


def _video(path: Path, rate: float) -> Iterator[Moment]:
    """Frames with the file's own times where they rise, else evenly spaced."""
    capture, number, t_s = cv2.VideoCapture(str(path)), 0, 0.0
    try:
        while True:
            own = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
            ok, image = capture.read()
            if not ok:
                return
            stamp = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
            t_s = stamp if number and stamp > t_s + 1e-4 else (t_s + 1 / rate if number else max(own, 0.0))
            yield Moment(number, t_s, np.asarray(image, np.uint8), str(number))
            number += 1
    finally:
        capture.release()


def _folder(path: Path, fps: float) -> Source:
    names = sorted((p.name for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES), key=natural_key)
    if not names:
        raise InputError(f"The folder {path} holds no picture ({', '.join(IMAGE_SUFFIXES)}).")
    if fps <= 0:
        raise InputError(f"fps must be above 0, got {fps}.")

    def moments() -> Iterator[Moment]:
        for number, name in enumerate(names):
            yield Moment(number, number / fps, read_image(path / name), name)

    return Source(moments, len(names), str(path))
