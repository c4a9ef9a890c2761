"""A whole video, folder or stream of pictures tracked: pictures with their times in, rows and coverage out."""

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.features import IMAGE_SUFFIXES, Features, read_image
from ursnav_torch.localization.coverage import INSPECTED, Coverage
from ursnav_torch.localization.matches import natural_key
from ursnav_torch.localization.route import ScopeLimits, nearest_route
from ursnav_torch.localization.track import Tracked, Tracker
from ursnav_torch.localization.track_search import SensorReading
from ursnav_torch.vid import POSE_COLUMNS, pose_cells

TRACK_COLUMNS = ("frame", "t_s", "calyx", *POSE_COLUMNS, "confidence", "state", "seconds")


@dataclass(frozen=True, slots=True)
class Moment:
    """One picture of a source.

    Attributes:
        frame: its number, from 0; pictures that were lost leave gaps.
        t_s: when it was taken, from the first picture on.
        image: (H, W) or (H, W, 3) uint8, blue, green, red.
        name: file name of the picture, or its number.
    """

    frame: int
    t_s: float
    image: NDArray[np.uint8]
    name: str


@dataclass(frozen=True, slots=True)
class Source:
    """Pictures to be tracked.

    Attributes:
        moments: gives them one after the other.
        length: how many there should be; 0 where nobody knows.
        what: where they come from, for people to read.
        live: whether asking for the next picture waits for a device.
    """

    moments: Callable[[], Iterator[Moment]]
    length: int
    what: str
    live: bool = False


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


def extracted(tracker: Tracker, source: Source) -> Iterator[tuple[Moment, Features | None, float]]:
    """Every picture with its features and the seconds those took; of files, the next is read beside its follower."""
    moments = source.moments()

    def prepare() -> tuple[Moment, Features | None, float] | None:
        moment, start = next(moments, None), time.perf_counter()
        return None if moment is None else (moment, tracker.extract(moment.image), time.perf_counter() - start)

    if source.live:
        while (ready := prepare()) is not None:
            yield ready
        return
    with ThreadPoolExecutor(1) as beside:
        coming = beside.submit(prepare)
        while (ready := coming.result()) is not None:
            coming = beside.submit(prepare)
            yield ready


def follow_source(
    tracker: Tracker,
    source: Source,
    sensor: Callable[[Moment], SensorReading | None] | None = None,
    advance: Callable[[int], None] = lambda n: None,
) -> Iterator[tuple[Moment, Tracked]]:
    """Every picture and the answer to it, as soon as it is known; ``advance`` is called with 1 after each."""
    for moment, features, spent in extracted(tracker, source):
        start = time.perf_counter() - spent
        yield moment, tracker.follow(features, moment.t_s, sensor(moment) if sensor else None, start)
        advance(1)


def track_rows(
    tracker: Tracker, answers: Iterable[tuple[Moment, Tracked]], coverage: Coverage | None = None
) -> Iterator[tuple[dict[str, Any], Tracked]]:
    """A row of `TRACK_COLUMNS` for every picture, and the answer it was made from; ``coverage`` is painted along.

    A picture is painted when the track is believed, for the time since the one before.
    """
    last = None
    for moment, tracked in answers:
        passed = moment.t_s - last if last is not None else 0.0
        last = moment.t_s
        if coverage is not None and tracked.T_kidney_camera is not None and np.isfinite(tracked.score):
            coverage.add(tracked.T_kidney_camera, passed)
        yield track_row(moment, tracked, tracker), tracked


def track_row(moment: Moment, tracked: Tracked, tracker: Tracker) -> dict[str, Any]:
    """The columns of one answer; pose and calyx are blank unless tracking."""
    row: dict[str, Any] = {"frame": moment.frame, "t_s": moment.t_s, "state": tracked.state}
    if tracked.T_kidney_camera is not None:
        row |= pose_cells(tracked.T_kidney_camera[None])[0]
        row |= {"calyx": tracker.vid.calyx_name(tracked.calyx), "confidence": float(tracked.confidence)}
    return row | {"seconds": tracked.seconds}


def coverage_report(
    coverage: Coverage, T_kidney_camera: NDArray[np.float64] | None, limits: ScopeLimits | None = None
) -> dict[str, Any]:
    """The content of ``FILE.coverage.json``: what was seen, and the way from the last pose to what was not."""
    found, verdicts = coverage.to_dict(), coverage.calyces()
    open_ = [i for i, c in enumerate(verdicts) if c.verdict != INSPECTED]
    kidney, start = coverage.kidney, coverage.kidney.pelvis_mm
    if T_kidney_camera is not None:
        start = T_kidney_camera[:3, 3]
    worst = [i for i in open_ if verdicts[i].share < coverage.settings.glimpsed] or open_
    route = nearest_route(kidney, start, worst, limits)
    found["next"] = None
    if route is not None:
        plain = asdict(route) | {"points_mm": route.points_mm.round(3).tolist(), "branches": list(route.branches)}
        found["next"] = {k: round(v, 2) if isinstance(v, float) else v for k, v in plain.items()}
    return found


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
