"""A whole video, folder or stream of pictures followed: pictures with their times in, answers out."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features import Features
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.tracker import Tracked, Tracker


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


@dataclass(frozen=True, slots=True)
class Instruments:
    """What is known beside the pictures: an EM reading, and what the robot reports, for a picture; None without."""

    sensor: Callable[[Moment], SensorReading | None] | None = None
    odometry: Callable[[Moment], OdometryReading | None] | None = None

    def reading(self, moment: Moment) -> SensorReading | None:
        """The EM reading for a picture, if there is one."""
        return self.sensor(moment) if self.sensor else None

    def joints(self, moment: Moment) -> OdometryReading | None:
        """The robot's report for a picture, if there is one."""
        return self.odometry(moment) if self.odometry else None


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
    instruments: Instruments | None = None,
    advance: Callable[[int], None] = lambda n: None,
) -> Iterator[tuple[Moment, Tracked]]:
    """Every picture and the answer to it, as soon as it is known; ``advance`` is called with 1 after each."""
    told = instruments or Instruments()
    for moment, features, spent in extracted(tracker, source):
        start = time.perf_counter() - spent
        reading, joints = told.reading(moment), told.joints(moment)
        yield moment, tracker.follow(features, moment.t_s, reading, start, joints, moment.image)
        advance(1)
