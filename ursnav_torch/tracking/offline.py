"""A recorded exploration tracked with hindsight: followed to its end and back again, and both ways joined.

Where a picture alone leaves two poses, those after it often tell which. Not for live use: every answer takes later
pictures into account.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import IO

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.features import Features
from ursnav_torch.kidney import observed_calyx
from ursnav_torch.search.pose_mean import are_near, mean_pose
from ursnav_torch.tracking.certainty import joined_certainty
from ursnav_torch.tracking.follow import Instruments, Moment, Source, extracted
from ursnav_torch.tracking.motion import Hypotheses, transition
from ursnav_torch.tracking.reading import planes_of, recalled
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.smooth import Measured, smooth_stretch
from ursnav_torch.tracking.tracker import SEARCHING, Tracked, Tracker

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Followed:
    """A picture on the way there: when, the EM reading, the robot's report, the answer, how many planes were kept."""

    moment: Moment
    reading: SensorReading | None
    joints: OdometryReading | None
    answer: Tracked
    planes: int


def follow_both_ways(
    tracker: Tracker,
    source: Source,
    instruments: Instruments | None = None,
    advance: Callable[[int], None] = lambda n: None,
) -> Iterator[tuple[Moment, Tracked]]:
    """Every picture of a file, without its image, and the answer to it once all have been seen.

    Reliefs are kept in a temporary file, 60 or 120 kB a picture. An interruption (Ctrl-C) gives the answers that live
    tracking gave so far, and then goes on upwards.

    Args:
        tracker: fresh; it goes on from there and back, knowing on the way back what it learned on the way there.
        source: of recorded pictures.
        instruments: what is known beside the pictures.
        advance: called with 1 after every picture, on both ways.

    Raises:
        InputError: the source is live.
    """
    if source.live:
        raise InputError("offline=true needs a recording: a video or a folder of pictures, not a camera.")
    told, there = instruments or Instruments(), list[_Followed]()
    try:
        with tempfile.TemporaryFile() as spool:
            for moment, features, spent in extracted(tracker, source):
                start, reading, joints = time.perf_counter() - spent, told.reading(moment), told.joints(moment)
                answer = tracker.follow(features, moment.t_s, reading, start, joints, moment.image)
                planes = torch.zeros(0) if features is None else planes_of(features)
                spool.write(planes.numpy().tobytes())
                light = replace(moment, image=np.zeros((0, 0), np.uint8))
                there.append(_Followed(light, reading, joints, answer, len(planes)))
                advance(1)
            back = []
            for step, features in zip(reversed(there), _recalled(tracker, there, spool), strict=True):
                t_s = 2 * there[-1].moment.t_s - step.moment.t_s
                back.append(tracker.follow(features, t_s, step.reading, odometry=step.joints))
                advance(1)
        forward, times = [step.answer for step in there], [step.moment.t_s for step in there]
        answers = join(forward, back[::-1], times, tracker, [step.reading for step in there])
    except KeyboardInterrupt:
        yield from ((step.moment, step.answer) for step in there)
        raise
    yield from zip((step.moment for step in there), answers, strict=True)


def join(
    forward: Sequence[Tracked],
    backward: Sequence[Tracked],
    t_s: Sequence[float],
    tracker: Tracker,
    readings: Sequence[SensorReading | None],
) -> list[Tracked]:
    """One answer a picture from the answers of both ways, in the order of the pictures.

    The way back has seen everything before it judges a picture, so its word counts whether this is the kidney. Of two
    poses the better aligned counts, weighed against the motion it asks for and the sensor's word (Viterbi's
    algorithm); poses that agree are averaged; then all are smoothed.
    """
    answers = []
    for f, b in zip(forward, backward, strict=True):
        seen = b if _is_followed(b) or not (_is_followed(f) and b.state == SEARCHING) else f
        answers.append(replace(seen, seconds=f.seconds + b.seconds, bodies=f.bodies))
    for start, stop in _stretches([_is_followed(a) for a in answers]):
        here = slice(start, stop)
        measured = _chosen(forward[here], backward[here], t_s[here], tracker, readings[here])
        if not any(measured):  # bridged from a place that hindsight does not believe
            answers[here] = [
                replace(a, state=SEARCHING, T_kidney_camera=None, calyx=-1, confidence=0.0, certainty=None)
                for a in answers[here]
            ]
        for first, last in _unbroken(measured, t_s[here], tracker):
            stretch = slice(start + first, start + last)
            ways = list(zip(forward[stretch], backward[stretch], strict=True))
            answers[stretch] = _smoothed(answers[stretch], ways, measured[first:last], t_s[stretch], tracker)
    return answers


def _smoothed(
    answers: Sequence[Tracked],
    ways: Sequence[tuple[Tracked, Tracked]],
    measured: Sequence[Measured | None],
    t_s: Sequence[float],
    tracker: Tracker,
) -> list[Tracked]:
    """The answers of one unbroken stretch at their smoothed poses; confidence is the mean of what both ways had."""
    poses = smooth_stretch(measured, t_s, tracker.settings.smoothing)
    calyces = observed_calyx(np.stack(poses), tracker.vid.kidney, tracker.lumen).tolist()
    result = []
    for answer, both, m, T, calyx in zip(answers, ways, measured, poses, calyces, strict=True):
        believed = [a for a in both if _is_followed(a)]
        agree = [a.confidence if a.calyx == calyx else 1 - a.confidence for a in believed]
        sure = joined_certainty([a.certainty for a in believed if a.certainty is not None], calyx)
        state = answer.state if sure is None else tracker.state_at(sure)
        confidence = float(np.mean(agree))
        moved = replace(answer, state=state, T_kidney_camera=T, calyx=calyx, confidence=confidence, certainty=sure)
        result.append(moved if m is None else replace(moved, score=m.score, T_aligned=m.T_kidney_camera))
    return result


def _is_followed(answer: Tracked) -> bool:
    """Whether there is a pose, sure enough to be a place or not."""
    return answer.T_kidney_camera is not None


def _recalled(tracker: Tracker, there: Sequence[_Followed], spool: IO[bytes]) -> Iterator[Features | None]:
    """The pictures' features again, from the last to the first."""
    camera = tracker.working_camera
    end = spool.tell()
    for step in reversed(there):
        if not step.planes:
            yield None
            continue
        size = 4 * step.planes * camera.height * camera.width
        end -= size
        spool.seek(end)
        planes = np.frombuffer(spool.read(size), np.float32).reshape(step.planes, camera.height, camera.width)
        yield recalled(torch.from_numpy(planes.copy()))


def _chosen(
    forward: Sequence[Tracked],
    backward: Sequence[Tracked],
    t_s: Sequence[float],
    tracker: Tracker,
    readings: Sequence[SensorReading | None],
) -> list[Measured | None]:
    """Of both ways' poses the more probable sequence; None where a picture showed nothing."""
    shown = [i for i, f in enumerate(forward) if f.T_aligned is not None and backward[i].T_aligned is not None]
    result: list[Measured | None] = [None] * len(forward)
    if not shown:
        return result
    poses = np.array([[forward[i].T_aligned, backward[i].T_aligned] for i in shown])  # (K, 2, 4, 4)
    scores = np.array([[forward[i].score, backward[i].score] for i in shown])
    to_tips = tracker.lumen.to_calyces(poses[:, :, :3, 3].reshape(-1, 3)).reshape(len(shown), 2, -1)
    settings = tracker.settings
    best, came = scores / settings.challenger.prior_weight, np.zeros(scores.shape, int)
    for k, i in enumerate(shown):
        reading = readings[i]
        if reading is not None:
            best[k] += reading.log_probability(poses[k])
    for k in range(1, len(shown)):
        seconds = max(t_s[shown[k]] - t_s[shown[k - 1]], 1e-3)
        steps = [
            transition(
                Hypotheses(poses[k - 1, j, None], to_tips[k - 1, j, None], np.ones(1)),
                poses[k], to_tips[k], seconds, settings.motion,
            )
            for j in range(2)
        ]  # fmt: skip
        way = best[k - 1][:, None] + np.stack(steps)
        came[k] = way.argmax(0)
        best[k] += way.max(0)
    at = int(best[-1].argmax())
    for k in range(len(shown) - 1, -1, -1):
        same = (settings.filter.same_place_mm, settings.filter.same_place_deg)
        near = bool(are_near(poses[k, 1 - at, None], poses[k, at], *same)[0])
        weight = np.array([settings.smoothing.noise(float(score))[0] ** -2 for score in scores[k]])
        pose = mean_pose(poses[k], weight, at, *same)[0] if near else poses[k, at]
        reading = readings[shown[k]]
        place = None if reading is None else reading.camera_at(pose)
        besides = () if reading is None or place is None else ((place, reading.sigma_mm),)
        result[shown[k]] = Measured(pose, float(scores[k, at]), besides)
        at = int(came[k, at])
    return result


def _unbroken(measured: Sequence[Measured | None], t_s: Sequence[float], tracker: Tracker) -> list[tuple[int, int]]:
    """Where tracks begin and end between which the scope jumped, or the pictures were cut; begun by something seen."""
    s, motion = tracker.settings.filter, tracker.settings.motion
    seen = [(i, m) for i, m in enumerate(measured) if m is not None]
    begin = [i for i, _ in seen[:1]]
    for (i, a), (j, b) in pairwise(seen):
        seconds = t_s[j] - t_s[i]
        far = 2 * s.same_place_mm + motion.speed_mm_s * seconds
        if not are_near(
            a.T_kidney_camera[None],
            b.T_kidney_camera,
            far,
            min(2 * s.same_place_deg + motion.turn_deg_s * seconds, 180.0),
        )[0]:
            begin.append(j)
    return list(zip(begin, [*begin[1:], len(measured)][: len(begin)], strict=True))


def _stretches(flags: Sequence[bool]) -> list[tuple[int, int]]:
    """Start and stop of every run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(flags, bool), [False]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
