"""Where pictures come from: video files, folders, cameras; and what a robot reported beside them."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import ODOMETRY_COLUMNS
from ursnav_torch.devices import SILENT_S
from ursnav_torch.errors import InputError
from ursnav_torch.features import IMAGE_SUFFIXES, read_image
from ursnav_torch.files import natural_key
from ursnav_torch.tables import numbers, read_csv
from ursnav_torch.tracking.follow import Moment, Source
from ursnav_torch.tracking.robot.odometry import OdometryReading


def open_source(path: Path, fps: float = 10.0) -> Source:
    """The pictures of a video file, or of a folder in natural order, ``fps`` a second.

    Raises:
        InputError: there is nothing there, or nothing that can be read.
    """
    if path.is_dir():
        return _folder(path, fps)
    if not path.is_file():
        raise InputError(f"There is no video or folder {path}; source= takes one of the two, or camera.")
    rate, count = _checked_video(path, fps)
    return Source(lambda: _video(path, rate), max(count, 0), str(path))


def _checked_video(path: Path, fps: float) -> tuple[float, int]:
    """Frames a second and how many the file says it has; ``fps`` where it does not say.

    Raises:
        InputError: it is no video, or has no frame.
    """
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
    return (rate if np.isfinite(rate) and 0 < rate < 1000 else fps), count


def live_source(read: Callable[[], NDArray[np.uint8] | None], seconds: float | None) -> Source:
    """Pictures as a camera gives them, until some seconds have passed or it is interrupted (Ctrl-C).

    Args:
        read: waits for the next picture, uint8 (H, W) or (H, W, 3); None when the camera is at its end.
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


def picture_times(path: Path, fps: float = 10.0) -> tuple[list[str], NDArray[np.float64]]:
    """Names and times (M,) in s of all pictures of `open_source`, without taking one apart.

    Raises:
        InputError: as `open_source` does.
    """
    if path.is_dir():
        names = _names(path)
        if fps <= 0:
            raise InputError(f"fps must be above 0, got {fps}.")
        return names, np.arange(len(names)) / fps
    if not path.is_file():
        raise InputError(f"There is no video or folder {path}.")
    stamps = [stamp for _, stamp, _ in _frames(path, _checked_video(path, fps)[0], pictures=False)]
    return [str(n) for n in range(len(stamps))], np.array(stamps)


def _video(path: Path, rate: float) -> Iterator[Moment]:
    for number, t_s, image in _frames(path, rate):
        yield Moment(number, t_s, np.asarray(image, np.uint8), str(number))


def _frames(path: Path, rate: float, pictures: bool = True) -> Iterator[tuple[int, float, NDArray[np.uint8] | None]]:
    """Frames with the file's own times where they rise, else evenly spaced."""
    capture, number, t_s = cv2.VideoCapture(str(path)), 0, 0.0
    try:
        while True:
            own = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
            ok, image = capture.read() if pictures else (capture.grab(), None)
            if not ok:
                return
            stamp = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
            t_s = stamp if number and stamp > t_s + 1e-4 else (t_s + 1 / rate if number else max(own, 0.0))
            yield number, t_s, image
            number += 1
    finally:
        capture.release()


def _folder(path: Path, fps: float) -> Source:
    names = _names(path)
    if not names:
        raise InputError(f"The folder {path} holds no picture ({', '.join(IMAGE_SUFFIXES)}).")
    if fps <= 0:
        raise InputError(f"fps must be above 0, got {fps}.")

    def moments() -> Iterator[Moment]:
        for number, name in enumerate(names):
            yield Moment(number, number / fps, read_image(path / name), name)

    return Source(moments, len(names), str(path))


def _names(folder: Path) -> list[str]:
    return sorted((p.name for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES), key=natural_key)


def recorded_odometry(path: Path) -> Callable[[Moment], OdometryReading | None]:
    """The joints at a picture's time, from a CSV file ``t_s,insertion_mm,bend_x_deg,bend_y_deg``.

    Between two reports the joints are interpolated; where the robot was silent, see `SILENT_S`, there is none. A row
    without all of its joints is no report.

    Raises:
        InputError: the file cannot be read, holds something that is no number, or its times do not rise.
    """
    rows = read_csv(path, ODOMETRY_COLUMNS, "odometry")
    table = numbers(rows, ODOMETRY_COLUMNS)
    timeless = np.flatnonzero(~np.isfinite(table[:, 0]))
    if len(timeless):
        raise InputError(f"{path}: data row {int(timeless[0]) + 1} has no t_s; every report needs its time.")
    t_s = table[:, 0]
    stays = np.flatnonzero(np.diff(t_s) <= 0)
    if len(stays):
        at = int(stays[0])
        raise InputError(
            f"{path}: t_s must rise from row to row, but {t_s[at + 1]:g} s in data row {at + 2} follows {t_s[at]:g} s. "
            "Sort the rows by time, and keep one row a time."
        )
    table = table[np.isfinite(table).all(1)]
    if not len(table):
        raise InputError(f"{path}: no row has all of insertion_mm, bend_x_deg and bend_y_deg.")
    t_s, joints = table[:, 0], table[:, 1:] * [1.0, np.pi / 180, np.pi / 180]

    def reading(moment: Moment) -> OdometryReading | None:
        after = int(np.searchsorted(t_s, moment.t_s))
        around = t_s[max(after - 1, 0) : after + 1]
        if np.abs(around - moment.t_s).min() > SILENT_S or np.ptp(around) > SILENT_S:
            return None
        return OdometryReading(*(float(np.interp(moment.t_s, t_s, column)) for column in joints.T))

    return reading
