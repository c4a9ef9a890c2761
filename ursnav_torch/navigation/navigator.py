"""The loop: pictures in, poses, coverage and the way on out; every stage in a thread of its own, newest first."""

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import PictureCut
from ursnav_torch.columns import SURE_COLUMNS
from ursnav_torch.devices import SILENT_S, Frame, Note, RobotSample, Stamper, TrackerSample
from ursnav_torch.devices.robots.safety import STOPPED
from ursnav_torch.errors import InputError, UrsnavError
from ursnav_torch.exploration import ExplorationSettings
from ursnav_torch.features import Features
from ursnav_torch.kidney import NO_CALYX, set_words
from ursnav_torch.navigation.bus import Newest, StateBus
from ursnav_torch.navigation.effort import WORDS, Governor
from ursnav_torch.navigation.guide import Guide
from ursnav_torch.navigation.state import Latency, NavigationState
from ursnav_torch.navigation.status import status_line
from ursnav_torch.navigation.trail import Trail
from ursnav_torch.session import Event, Pace, Result
from ursnav_torch.stones import KnownStone, watch_stones
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import Vid, pose_cells

Array = NDArray[np.float64]
Sensor = Callable[[TrackerSample], SensorReading | None]
Telling = TypeVar("Telling")
logger = logging.getLogger(__name__)

#: Pictures whose latency is remembered for `Navigator.latencies`; and seconds between lines in the log.
REMEMBERED, LOG_S = 20_000, 10.0
#: The way on need not be found anew more often than this, by the pictures' time.
GUIDE_S = 0.1
#: A pose older than this is said to be old.
STALE_S = 2.0


@dataclass(frozen=True, slots=True)
class _Job:
    """A picture to be located: its number among those given, when it was captured by this machine's clock, the newest
    EM reading and report of the robot before it, and how often the place had been forgotten when it came."""

    number: int
    frame: Frame
    captured_s: float
    sensor: SensorReading | None
    odometry: OdometryReading | None
    epoch: int


@dataclass(frozen=True, slots=True)
class _Seen:
    """A picture's features, None where it showed too little, and how long they took."""

    job: _Job
    features: Features | None
    features_s: float


@dataclass(frozen=True, slots=True)
class _Told(Generic[Telling]):
    """What a device told last, if anything, and when."""

    what: Telling | None = None
    at_s: float = -np.inf

    def at(self, t_s: float) -> Telling | None:
        """What it says of a picture taken at a time; nothing when it has been silent for long."""
        return self.what if t_s - self.at_s <= SILENT_S else None


class Navigator:
    """Navigates in one kidney. Use it in a ``with`` block; `take` never waits, results come out on `bus`.

    Args:
        tracker: what locates pictures.
        exploration: when wall counts as seen, and what the scope can do.
        sensor: where an EM sample has the sensor in the kidney frame; None to do without.
        governor: when to spend less on a picture.
        known_stones: those of a scan.
        cut: where pictures lie in those of the VID's lens; what was cut away or masked there is left out. None: they
            are as the lens gives them.

    Attributes:
        shows_edges: whether `NavigationState.edges` are wanted: whoever draws them says so.
    """

    def __init__(
        self,
        tracker: Tracker,
        exploration: ExplorationSettings | None = None,
        sensor: Sensor | None = None,
        governor: Governor | None = None,
        known_stones: tuple[KnownStone, ...] = (),
        cut: PictureCut | None = None,
    ) -> None:
        self.tracker, self.vid, self.bus = tracker, tracker.vid, StateBus()
        self._cut = cut or tracker.vid.cut_of(None)
        if self._cut.narrows:
            tracker.narrow(self._cut.inside())
        settings = exploration or ExplorationSettings()
        stones = watch_stones(tracker, settings.stones, known_stones)
        self.guide = Guide(tracker.vid, tracker.lumen, stones, settings)
        self.shows_edges = False
        self.located, self._pace = 0, Pace()
        self.latencies: deque[Latency] = deque(maxlen=REMEMBERED)
        self._sensor, self._governor, self._trail = sensor, governor or Governor(), Trail()
        self._jobs: Newest[_Job] = Newest()
        self._seen: Newest[_Seen] = Newest()
        self._answers: Newest[tuple[Tracked, Frame]] = Newest()
        self._reading: _Told[SensorReading] = _Told()
        self._joints: _Told[OdometryReading] = _Told()
        self._told_coverage = ""
        self._results: deque[Result] = deque(maxlen=1000)
        self._stamp, self._done, self._end = Stamper(), threading.Condition(), threading.Event()
        self._given = self._finished = 0
        self._epoch, self._choose_again, self._failing = 0, False, False
        self._logged_s, self._published_s, self._painting_s = time.monotonic(), 0.0, 0.0
        self._seen_from: Array | None = None
        self._counted_s: float | None = None
        self._shown_s = -np.inf
        self._threads: list[threading.Thread] = []

    @property
    def passed_over(self) -> int:
        """Pictures that were not located because a newer one came."""
        return self._jobs.replaced + self._seen.replaced

    @property
    def patch_of_face(self) -> NDArray[np.int64]:
        """(F,) the patch of wall that each triangle of the kidney's mesh belongs to; see `Guidance.seen`."""
        return self.guide.coverage.patches.of_face

    def expect(self, pace: Pace) -> None:
        """Say how the pictures of the coming session come; live devices' without it."""
        self._pace = pace

    def take(self, event: Event) -> None:
        """Take an event of a session: pictures, EM samples, the robot's reports, devices' warnings; never waits."""
        if isinstance(event, Frame):
            captured = event.stamp.t_mono_s if self._pace.stamped_now else time.monotonic()
            self._given += 1
            image = self._cut.put_back(event.image)
            frame = event if image is event.image else replace(event, image=image)
            t_s = event.stamp.t_mono_s
            told, joints = self._reading.at(t_s), self._joints.at(t_s)
            self._jobs.put(_Job(self._given, frame, captured, told, joints, self._epoch))
        elif isinstance(event, TrackerSample) and self._sensor is not None:
            self._reading = _Told(self._sensor(event), event.stamp.t_mono_s)
        elif isinstance(event, RobotSample):
            at, known = event.joints, event.place_known
            said = OdometryReading(at.insertion_mm, at.bend_x_rad, at.bend_y_rad) if known else None
            self._joints = _Told(said, event.stamp.t_mono_s)
            if event.state != self.bus.latest().robot:
                self.bus.update(lambda state: _worded(replace(state, robot=event.state)))
        elif isinstance(event, Note) and event.level != "info":
            self.bus.update(lambda state: replace(state, notice=event.text))

    def wait(self, timeout_s: float = 5.0) -> bool:
        """Wait until the last picture given is located; False when that took too long."""
        with self._done:
            return self._done.wait_for(lambda: self._finished == self._given, timeout_s)

    def results(self) -> list[Result]:
        """The rows made since the last call, for the record; at most the last thousand."""
        return [self._results.popleft() for _ in range(len(self._results))]

    def choose(self, calyx: str) -> None:
        """Head for a calyx by its name; blank leaves the choice to navigation.

        Raises:
            InputError: the kidney has no such calyx.
        """
        names = [c.name for c in self.vid.kidney.calyces]
        if calyx and calyx not in names:
            raise InputError(f"The kidney has no calyx {calyx!r}; it has {', '.join(names)}.")
        self.guide.chosen = names.index(calyx) if calyx else -1
        self._choose_again = True

    def say_autonomy(self, text: str, headed: int = -1) -> None:
        """What exploring by itself is doing, for whoever looks, and the calyx (index) it heads for, -1 for none."""
        self.guide.headed, self._choose_again = headed, True
        self.bus.update(lambda state: _worded(replace(state, autonomy=text)))

    def forget_place(self) -> None:
        """The next picture may be from anywhere: a replay was moved. Those that still wait are not located."""
        self._reading, self._joints = _Told(), _Told()
        self._epoch += 1

    def __enter__(self) -> Self:
        self._end.clear()
        self._show(None)
        for stage in (self._extract, self._track, self._paint):
            name = f"navigation{stage.__name__}"
            self._threads.append(threading.Thread(target=stage, name=name, daemon=True))
            self._threads[-1].start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join(timeout=5.0)
        self._threads.clear()
        self.bus.update(lambda state: replace(state, ended=True))

    def _extract(self) -> None:
        """Features of the newest picture, and again."""
        while not self._end.is_set():
            job = self._jobs.take(0.2)
            if job is None:
                continue
            begun = time.monotonic()
            try:
                features = self.tracker.extract(job.frame.image, self.shows_edges)
            except Exception as error:  # one picture must not end navigation
                self._fail(job, error)
                continue
            self._seen.put(_Seen(job, features, time.monotonic() - begun))

    def _track(self) -> None:
        """Locate the newest picture with features, publish, again."""
        epoch = 0
        while not self._end.is_set():
            seen = self._seen.take(0.2)
            if seen is None:
                continue
            job, begun = seen.job, time.monotonic()
            if job.epoch != self._epoch:
                self._finish(job)
                continue
            if job.epoch != epoch:
                epoch = job.epoch
                self.tracker.reset()
            try:
                t_s = job.frame.stamp.t_mono_s
                tracked = self.tracker.follow(seen.features, t_s, job.sensor, None, job.odometry, job.frame.image)
            except Exception as error:
                self.tracker.reset()  # whatever it was, it must not last
                self._fail(job, error)
                continue
            self._failing = False
            self._publish(seen, tracked, begun)
            if self._pace.patient:  # then what a row tells is the same on a slow machine
                self._count(tracked, job.frame)
            else:
                self._answers.put((tracked, job.frame))
            self._finish(job)

    def _fail(self, job: _Job, error: Exception) -> None:
        """A picture that cannot be located has a row that says why; the log tells of the first in a row."""
        expected = isinstance(error, UrsnavError)
        text = str(error) if expected else f"{type(error).__name__}: {error}"
        self._results.append(Result(self._stamp(), job.frame.stamp.sequence, {"error": text}))
        self.bus.update(lambda state: replace(state, notice=text))
        if not self._failing:
            logger.warning(
                "picture %d: %s", job.frame.stamp.sequence, text, exc_info=not isinstance(error, UrsnavError)
            )
        self._failing = True
        self._finish(job)

    def _finish(self, job: _Job) -> None:
        with self._done:
            self._finished = max(self._finished, job.number)
            self._done.notify_all()

    def _publish(self, seen: _Seen, tracked: Tracked, begun: float) -> None:
        """Put a picture's pose on the bus and its row among the results."""
        job = seen.job
        certain = tracked.state == TRACKING  # what is only searched about is on the record, not before the operator
        T, names = tracked.T_kidney_camera if certain else None, _names(tracked, self.vid)
        if T is not None:
            self._trail.add(T[:3, 3])
        now, level = time.monotonic(), self._governor.level
        total, tracking = now - job.captured_s, now - begun
        latency = Latency(total - seen.features_s - tracking, seen.features_s, tracking, total, self._painting_s)

        def change(state: NavigationState) -> NavigationState:
            return _worded(
                replace(
                    state,
                    frame=job.frame,
                    **_shown(seen.features, tracked),
                    slack_mm=self.tracker.slider_play_mm,
                    T_kidney_camera=T,
                    seen_s=state.seen_s if _believed(tracked) is None else job.frame.stamp.t_mono_s,
                    calyx=self.vid.calyx_name(tracked.calyx) if certain else "",
                    calyces=names,
                    confidence=float(tracked.confidence),
                    path_mm=self._trail.points(),
                    latency=latency,
                    effort=level,
                    stale=False,
                )
            )

        self.bus.update(change)
        self.located, self._published_s = self.located + 1, now
        self.latencies.append(latency)
        row = _row(job, tracked, names, latency, level) | self._news_of_coverage()
        self._results.append(Result(self._stamp(), job.frame.stamp.sequence, row))
        new_level = level if self._pace.patient else self._governor.observe(latency.total_s)
        if new_level != level:
            self.tracker.ease(new_level)
            logger.warning("%s", WORDS[new_level] or "The machine keeps up again: everything is done.")
        if now - self._logged_s >= LOG_S:
            self._logged_s = now
            _log(job.frame.stamp.sequence, latency)

    def _news_of_coverage(self) -> dict[str, str]:
        """Verdict and share of every calyx as JSON, where they differ from what was last told; else nothing."""
        found = {c.calyx: [c.verdict, round(c.share, 2)] for c in self.bus.latest().guidance.coverage}
        text = json.dumps(found, ensure_ascii=False)
        if not found or text == self._told_coverage:
            return {}
        self._told_coverage = text
        return {"coverage": text}

    def _paint(self) -> None:
        """Count what was seen and find the way on, as often as there is time."""
        while not self._end.is_set():
            found = self._answers.take(0.1)
            if found is not None:
                self._count(*found)
            if self._choose_again:
                self._choose_again = False
                self._show(self._seen_from)
            if (
                self._pace.steady
                and self.located
                and time.monotonic() - self._published_s > STALE_S
                and not self.bus.latest().stale
            ):
                self.bus.update(lambda state: _worded(replace(state, stale=True)))

    def _count(self, tracked: Tracked, frame: Frame) -> None:
        """Count what a picture shows of the wall and of stones; find the way on where it was not found just now."""
        begun, t_s = time.monotonic(), frame.stamp.t_mono_s
        if tracked.T_kidney_camera is not None and tracked.is_settled and self._counted_s is not None:
            passed_s = t_s - self._counted_s
            self.guide.coverage.look_through(self.tracker.shown)
            self.guide.paint(tracked.T_kidney_camera, passed_s, tracked.bodies, tracked.position_sd_mm)
        self._see_stones(tracked, frame)
        self._seen_from, self._counted_s = _believed(tracked), t_s
        if not 0 <= t_s - self._shown_s < GUIDE_S:  # a replay may go back
            self._show(self._seen_from)
            self._shown_s, self._painting_s = t_s, time.monotonic() - begun

    def _see_stones(self, tracked: Tracked, frame: Frame) -> None:
        """Stones of a picture; whatever one does to their map, coverage and the way on stay."""
        try:
            self.guide.see_stones(tracked, frame.image, frame.stamp.t_mono_s, frame.stamp.sequence)
        except Exception:
            logger.exception("picture %d: its stones could not be placed", frame.stamp.sequence)

    def _show(self, T: Array | None) -> None:
        """Publish coverage and route beside the newest pose."""
        guidance = self.guide.guidance(T)

        self.bus.update(lambda state: _worded(replace(state, guidance=guidance)))


def _log(picture: int, latency: Latency) -> None:
    """Where a picture's time went, as a line of the log."""
    logger.info(
        "picture %d, ms: waiting %.0f, features %.0f, tracking %.0f, on the bus after %.0f; painting %.0f",
        picture,
        *(1e3 * seconds for seconds in astuple(latency)),
    )


def _believed(tracked: Tracked) -> Array | None:
    """The pose, where it was seen and not only expected."""
    return tracked.T_kidney_camera if tracked.state == TRACKING and np.isfinite(tracked.score) else None


def _shown(features: Features | None, tracked: Tracked) -> dict[str, Any]:
    """What of a picture and its answer is told as it is."""
    return {
        "edges": features.edges if features is not None and len(features.edges) else None,
        "bodies": features.bodies if features is not None else (),
        "tracking": tracked.state,
        "position_sd_mm": tracked.position_sd_mm,
        "places": tracked.places if tracked.places is not None else np.zeros((0, 4)),
    }


def _names(tracked: Tracked, vid: Vid) -> tuple[str, ...]:
    """Of the calyces that the answer may be, the answer first."""
    return vid.set_names((tracked.calyx,) if tracked.certainty is None else tracked.certainty.calyces)


def _worded(state: NavigationState) -> NavigationState:
    """A state with its line of plain words."""
    remarks = ["No new picture."] * state.stale + ["The robot is stopped."] * (state.robot == STOPPED)
    remarks += [f"By itself: {state.autonomy}."] * bool(state.autonomy)
    remark = " ".join([*remarks, WORDS[state.effort]]).strip()
    calyx = set_words(state.calyces) if state.calyx else ""
    line = status_line(state.tracking, calyx, state.confidence, state.guidance, remark)
    return replace(state, status=line)


def _row(job: _Job, tracked: Tracked, calyces: tuple[str, ...], latency: Latency, effort: int) -> dict[str, Any]:
    """The result's row: as `track` writes it, with latencies."""
    row: dict[str, Any] = {"t_s": job.frame.stamp.t_mono_s, "state": tracked.state, "accepted": False}
    if tracked.T_kidney_camera is not None:
        row |= {k: float(v) for k, v in pose_cells(tracked.T_kidney_camera[None])[0].items()}
        row |= {"calyces": "|".join(calyces)}
    if tracked.certainty is not None:
        row |= {k: round(float(getattr(tracked.certainty, k)), 4) for k in SURE_COLUMNS[1:]}
    if tracked.state == TRACKING:
        calyx = "" if calyces[0] == NO_CALYX else calyces[0]
        row |= {"calyx": calyx, "confidence": float(tracked.confidence), "accepted": _believed(tracked) is not None}
    seconds = {"waiting_s": latency.waiting_s, "features_s": latency.features_s, "tracking_s": latency.tracking_s}
    seconds["latency_s"] = latency.total_s
    return row | {k: round(v, 4) for k, v in seconds.items()} | {"effort": effort}
