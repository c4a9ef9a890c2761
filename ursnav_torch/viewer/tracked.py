"""A `track` run: pictures in, rows, coverage and the painted wall out."""

import csv
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress, cell, check_output_file, whole_file, write_json
from ursnav_torch.hardware import Camera
from ursnav_torch.hardware.base import SourceAtEndError
from ursnav_torch.localization.coverage import Coverage
from ursnav_torch.localization.track import LOST, TRACKING, Tracker
from ursnav_torch.localization.track_search import SensorReading
from ursnav_torch.localization.track_video import (
    TRACK_COLUMNS,
    Moment,
    Source,
    coverage_report,
    live_source,
    track_rows,
)
from ursnav_torch.registration import Registration, read_em_samples
from ursnav_torch.viewer.coverage_picture import draw_coverage

Array = NDArray[np.float64]
Sensor = Callable[[Moment], SensorReading | None]

#: Root mean square noise of a 5-DoF sensor, and how far the kidney moves on its own, mm.
SENSOR_MM, BREATH_MM = 0.7, 0.8
#: Every so many views of the VID are asked what they can see; neighbors see the same.
_REACH_STRIDE = 4


def track_source(
    tracker: Tracker, source: Source, out: Path, sensor: Sensor | None, overwrite: bool, progress: Progress
) -> str:
    """Track a source; write the rows to ``out`` and what was seen to ``.coverage.json`` and ``.png`` beside it.

    Rows are written as they come, so memory does not grow with the video.

    Returns:
        The summary, for people to read.

    Raises:
        InputError: a result stands there already, or the source gives no picture.
    """
    beside = [out.with_suffix(f".coverage.{kind}") for kind in ("json", "png")]
    for path in beside:
        check_output_file(path, overwrite)
    vid, last, states, ended = tracker.vid, None, dict[str, int](), ""
    spent, start = list[float](), time.perf_counter()
    with whole_file(out, overwrite) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        coverage = Coverage(vid.kidney, vid.camera, tracker.lumen, vid.T_kidney_camera[::_REACH_STRIDE])
        writer = csv.DictWriter(file, TRACK_COLUMNS, lineterminator="\n")
        writer.writeheader()
        with progress(source.length, "pictures") as advance:
            for row, tracked in track_rows(tracker, source, sensor, coverage, advance):
                writer.writerow({name: cell(row.get(name)) for name in TRACK_COLUMNS})
                spent.append(tracked.seconds)
                states[tracked.state] = states.get(tracked.state, 0) + 1
                last, ended = (last if tracked.T_kidney_camera is None else tracked.T_kidney_camera), tracked.state
        if not states:
            raise InputError(f"{source.what} gave no picture at all.")
    rate = len(spent) / (time.perf_counter() - start)
    report = coverage_report(coverage, last)
    write_json(beside[0], report | {"pictures": states, "ended": ended}, overwrite)
    with whole_file(beside[1], overwrite) as partial:
        partial.write_bytes(cv2.imencode(".png", draw_coverage(coverage))[1].tobytes())
    return _summary(source, states, ended, coverage, out) + "\n" + _speed(spent, rate)


def camera_source(device: Camera, seconds: float | None) -> Source:
    """The pictures of a camera, which is connected for it."""

    def read() -> NDArray[np.uint8] | None:
        if not device.is_connected:
            device.connect()
        try:
            return device.read(5.0).image
        except SourceAtEndError:
            return None

    return live_source(read, seconds)


def read_sensor(em: Path, em_to_kidney: Path | None, offset_camera_mm: list[float]) -> Sensor:
    """Readings of an EM file in the kidney frame, by the picture's name or number, else by the nearest time.

    Raises:
        InputError: no registration is given, or a file cannot be used.
    """
    if em_to_kidney is None:
        raise InputError("em= needs em_to_kidney=, the registration that `register` makes from landmarks.")
    offset = np.asarray(offset_camera_mm, float)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InputError(f"sensor_offset_mm must be [x,y,z] in mm in the camera frame, got {offset_camera_mm}.")
    registration, samples = Registration.from_json(em_to_kidney), read_em_samples(em)
    position = registration.apply(samples.position_mm)
    tre = np.nan_to_num(registration.tre_mm(position))
    sigma = np.sqrt((SENSOR_MM**2 + tre**2 + BREATH_MM**2) / 3)
    rows = {Path(name).stem.lstrip("0") or "0": i for i, name in enumerate(samples.key or ())}

    def reading(moment: Moment) -> SensorReading | None:
        row = rows.get(Path(moment.name).stem.lstrip("0") or "0")
        if row is None and samples.key is None and samples.t_s is not None:
            near = int(np.nanargmin(np.abs(samples.t_s - moment.t_s)))
            row = near if abs(samples.t_s[near] - moment.t_s) <= _NEAR_S else None
        if row is None or not np.isfinite(position[row]).all():
            return None
        return SensorReading(position[row], offset, float(sigma[row]))

    return reading


def _summary(source: Source, states: dict[str, int], ended: str, coverage: Coverage, out: Path) -> str:
    total = sum(states.values())
    lines = [
        f"{total} pictures: {states.get(TRACKING, 0)} tracking, {total - states.get(TRACKING, 0)} not; rows in {out}"
    ]
    if 0 < source.length != total:
        lines.append(
            f"warning: {source.what} says it has {source.length} frames, {total} could be read: it is cut short."
        )
    if ended == LOST:
        lines.append("The track ended lost: the pictures do not fit this kidney. Is it the right VID?")
    lines += [f"  {c.calyx}: {c.verdict}, {c.share:.0%} of its wall seen" for c in coverage.calyces()]
    return "\n".join(lines)


def _speed(spent: list[float], rate: float) -> str:
    median, slow = (1e3 * float(np.percentile(spent, q)) for q in (50, 95))
    return f"{rate:.1f} pictures a second; {median:.0f} ms a picture, 95th percentile {slow:.0f} ms"


#: A reading belongs to a picture taken within this time.
_NEAR_S = 0.25
