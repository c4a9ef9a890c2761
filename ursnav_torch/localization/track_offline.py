"""A recorded exploration tracked with hindsight: followed to its end and back again, and both ways joined.

Where a picture alone leaves two poses, those after it often tell which. Not for live use: every answer takes later
pictures into account.
"""

import tempfile
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
from ursnav_torch.localization.consensus import are_near, mean_pose
from ursnav_torch.localization.motion import Hypotheses, transition
from ursnav_torch.localization.smooth_offline import Measured, smooth_stretch
from ursnav_torch.localization.track import SEARCHING, TRACKING, Tracked, Tracker
from ursnav_torch.localization.track_search import SensorReading
from ursnav_torch.localization.track_video import Moment, Source, extracted

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Followed:
    """A picture on the way there: when, the EM reading, the answer, and whether its relief was kept."""

    moment: Moment
    reading: SensorReading | None
    answer: Tracked
    kept: bool


def follow_both_ways(
    tracker: Tracker,
    source: Source,
    sensor: Callable[[Moment], SensorReading | None] | None = None,
    advance: Callable[[int], None] = lambda n: None,
) -> Iterator[tuple[Moment, Tracked]]:
    """Every picture of a file, without its image, and the answer to it once all have been seen.

    Reliefs are kept in a temporary file, about 60 kB a picture. An interruption (Ctrl-C) gives the answers that live
    tracking gave so far, and then goes on upwards.

    Args:
        tracker: fresh; it goes on from there and back, knowing on the way back what it learned on the way there.
        source: of recorded pictures.
        sensor: an EM reading for a picture.
        advance: called with 1 after every picture, on both ways.

    Raises:
        InputError: the source is live.
    """
    if source.live:
        raise InputError("offline=true needs a recording: a video or a folder of pictures, not a camera.")
    there: list[_Followed] = []
    try:
        with tempfile.TemporaryFile() as spool:
            for moment, features, _ in extracted(tracker, source):
                reading = sensor(moment) if sensor else None
                answer = tracker.follow(features, moment.t_s, reading)
                if features is not None:
                    spool.write(features.fields[0].numpy().tobytes())
                light = replace(moment, image=np.zeros((0, 0), np.uint8))
                there.append(_Followed(light, reading, answer, features is not None))
                advance(1)
            back = []
            for step, features in zip(reversed(there), _recalled(tracker, there, spool), strict=True):
                t_s = 2 * there[-1].moment.t_s - step.moment.t_s
                back.append(tracker.follow(features, t_s, step.reading))
                advance(1)
    except KeyboardInterrupt:
        yield from ((step.moment, step.answer) for step in there)
        raise
    answers = join([step.answer for step in there], back[::-1], [step.moment.t_s for step in there], tracker,
                   [step.reading for step in there])  # fmt: skip
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
    poses the better aligned counts, weighed against the motion it asks for (Viterbi's algorithm); poses that agree
    are averaged; then all are smoothed.
    """
    answers = []
    for f, b in zip(forward, backward, strict=True):
        seen = b if b.state == TRACKING or not (f.state == TRACKING and b.state == SEARCHING) else f
        answers.append(replace(seen, seconds=f.seconds + b.seconds))
    for start, stop in _stretches([a.state == TRACKING for a in answers]):
        measured = _chosen(forward[start:stop], backward[start:stop], t_s[start:stop], tracker)
        measured = [_with_sensor(m, r) for m, r in zip(measured, readings[start:stop], strict=True)]
        for first, last in _unbroken(measured, tracker):
            unit = tracker.vid.kidney.scale
            poses = smooth_stretch(measured[first:last], t_s[start + first : start + last], tracker.smoothing, unit)
            calyces = observed_calyx(np.stack(poses), tracker.vid.kidney, tracker.lumen)
            for i, pose, calyx in zip(range(start + first, start + last), poses, calyces.tolist(), strict=True):
                ways = [a.confidence if a.calyx == calyx else 0.0 for a in (forward[i], backward[i]) if _on(a)]
                answers[i] = replace(
                    answers[i], T_kidney_camera=pose, calyx=calyx, confidence=float(np.mean(ways)),
                )  # fmt: skip
    return answers


def _on(answer: Tracked) -> bool:
    return answer.state == TRACKING


def _recalled(tracker: Tracker, there: Sequence[_Followed], spool: IO[bytes]) -> Iterator[Features | None]:
    """The pictures' features again, from the last to the first."""
    camera = tracker.working_camera
    size = 4 * camera.height * camera.width
    end = spool.tell()
    for step in reversed(there):
        if not step.kept:
            yield None
            continue
        end -= size
        spool.seek(end)
        relief = np.frombuffer(spool.read(size), np.float32).reshape(camera.height, camera.width)
        yield tracker.recall(torch.from_numpy(relief.copy()))


def _chosen(
    forward: Sequence[Tracked], backward: Sequence[Tracked], t_s: Sequence[float], tracker: Tracker
) -> list[Measured | None]:
    """Of both ways' poses the more probable sequence; None where a picture showed nothing."""
    shown = [i for i, f in enumerate(forward) if f.T_aligned is not None and backward[i].T_aligned is not None]
    result: list[Measured | None] = [None] * len(forward)
    if not shown:
        return result
    poses = np.array([[forward[i].T_aligned, backward[i].T_aligned] for i in shown])  # (K, 2, 4, 4)
    scores = np.array([[forward[i].score, backward[i].score] for i in shown])
    to_tips = tracker.lumen.to_calyces(poses[:, :, :3, 3].reshape(-1, 3)).reshape(len(shown), 2, -1)
    settings, unit = tracker.settings, tracker.vid.kidney.scale
    best, came = scores / settings.motion_weight, np.zeros(scores.shape, int)
    for k in range(1, len(shown)):
        seconds = max(t_s[shown[k]] - t_s[shown[k - 1]], 1e-3)
        steps = [
            transition(
                Hypotheses(poses[k - 1, j, None], to_tips[k - 1, j, None], np.ones(1)),
                poses[k], to_tips[k], seconds, tracker.motion, unit,
            )
            for j in range(2)
        ]  # fmt: skip
        way = best[k - 1][:, None] + np.stack(steps)
        came[k] = way.argmax(0)
        best[k] += way.max(0)
    at = int(best[-1].argmax())
    for k in range(len(shown) - 1, -1, -1):
        near = bool(are_near(poses[k, 1 - at, None], poses[k, at], settings.near_mm * unit, settings.near_deg)[0])
        weight = np.array([tracker.smoothing.noise(float(score), unit)[0] ** -2 for score in scores[k]])
        pose = mean_pose(poses[k], weight, at, settings.near_mm * unit)[0] if near else poses[k, at]
        result[shown[k]] = Measured(pose, float(scores[k, at]))
        at = int(came[k, at])
    return result


def _with_sensor(measured: Measured | None, reading: SensorReading | None) -> Measured | None:
    """The sensor's word beside the picture's, where the two do not contradict each other."""
    if measured is None or reading is None:
        return measured
    T = measured.T_kidney_camera
    at = reading.position_mm - T[:3, :3] @ reading.offset_camera_mm
    if np.linalg.norm(at - T[:3, 3]) > 4 * reading.sigma_mm:
        return measured
    return replace(measured, positions=((at, reading.sigma_mm),))


def _unbroken(measured: list[Measured | None], tracker: Tracker) -> list[tuple[int, int]]:
    """Where tracks begin and end between which the scope jumped, or the pictures were cut; begun by something seen."""
    s, unit = tracker.settings, tracker.vid.kidney.scale
    seen = [i for i, m in enumerate(measured) if m is not None]
    begin = seen[:1]
    for i, j in pairwise(seen):
        a, b = measured[i], measured[j]
        assert a is not None and b is not None
        if not are_near(a.T_kidney_camera[None], b.T_kidney_camera, 2 * s.near_mm * unit, 2 * s.near_deg)[0]:
            begin.append(j)
    return list(zip(begin, [*begin[1:], len(measured)], strict=True))


def _stretches(flags: Sequence[bool]) -> list[tuple[int, int]]:
    """Start and stop of every run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(flags, bool), [False]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
