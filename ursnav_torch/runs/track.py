"""A `track` run: pictures in, rows, coverage and the painted wall out."""

import csv
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import PictureCut
from ursnav_torch.columns import TRACK_COLUMNS
from ursnav_torch.devices import CameraDevice, SourceAtEndError
from ursnav_torch.errors import DeviceError, DeviceTimeoutError, InputError
from ursnav_torch.exploration.coverage import REACH_STRIDE, Coverage
from ursnav_torch.exploration.coverage_report import coverage_report
from ursnav_torch.files import Progress, cell, write_image, write_json
from ursnav_torch.reports.coverage import draw_coverage
from ursnav_torch.reports.stones import write_stone_files
from ursnav_torch.results import WholeSet, whole_set
from ursnav_torch.runs.sources import live_source
from ursnav_torch.runs.track_files import NOTHING_BESIDES, Besides
from ursnav_torch.runs.track_rows import track_rows
from ursnav_torch.stones import watch_stones
from ursnav_torch.tracking.follow import Instruments, Moment, Source, follow_source
from ursnav_torch.tracking.offline import follow_both_ways
from ursnav_torch.tracking.tracker import LOST, TRACKING, Tracker

#: A camera may be silent for so many times five seconds, in which it is opened anew.
_SILENCES = 4


def track_source(
    tracker: Tracker,
    source: Source,
    out: Path,
    instruments: Instruments | None,
    overwrite: bool,
    progress: Progress,
    offline: bool = False,
    besides: Besides = NOTHING_BESIDES,
) -> tuple[str, bool]:
    """Track a source; write the rows to ``out`` and what was seen to ``.coverage.json`` and ``.png`` beside it.

    Live rows are written as they come, so memory does not grow with the video. An interruption (Ctrl-C) keeps what was
    tracked so far. All files appear as one.

    Args:
        tracker: fresh.
        source: the pictures.
        out: CSV file of the rows.
        instruments: EM readings and odometry for pictures, as far as there are.
        overwrite: replace what stands there.
        progress: shows how far it is.
        offline: follow a recording both ways before anything is answered, see `track_offline`.
        besides: what else is made of the rows.

    Returns:
        The summary, for people to read, and whether the source was tracked to its end, and scored where that was asked
        for; Ctrl-C is a camera's end.

    Raises:
        InputError: a result stands there already, the source gives no picture, offline is asked of a camera, another
            process writes the same result, or the disk is full.
    """
    paths = track_results(out, besides)
    work = {
        "vid": str(tracker.vid.folder),
        "source": source.what,
        "offline": offline,
        "settings": tracker.described(),
        "exploration": str(besides.exploration),
        "inputs": besides.fingerprints(),
    }
    with whole_set(paths, overwrite, work) as whole:
        if whole.outcome is None:
            summary, ended = _tracked(tracker, source, whole, instruments, progress, offline, besides)
            more, is_all = besides.write(whole)
            whole.outcome = [summary + more, ended and is_all]
    told, ended = whole.outcome
    return str(told), bool(ended)


def track_results(out: Path, besides: Besides) -> tuple[Path, ...]:
    """The files that `track_source` makes, the rows first."""
    kinds = ("coverage.json", "coverage.png", "stones.csv", "stones.png")
    return (out, *(out.with_suffix(f".{kind}") for kind in kinds), *besides.paths(out))


def _tracked(
    tracker: Tracker,
    source: Source,
    whole: WholeSet,
    instruments: Instruments | None,
    progress: Progress,
    offline: bool,
    besides: Besides,
) -> tuple[str, bool]:
    """Track, write rows, coverage and stones; the summary, and whether the source was tracked to its end.

    What was tracked of a camera that fails on its way is kept.
    """
    out, exploration = whole.paths[0], besides.exploration
    vid, last, states, ended = tracker.vid, None, dict[str, int](), ""
    spent, start, interrupted, failed = list[float](), time.perf_counter(), False, ""
    with whole.staged(out).open("w", newline="", encoding="utf-8") as file:
        reach = vid.T_kidney_camera[::REACH_STRIDE]
        coverage = Coverage(vid.kidney, vid.camera, tracker.lumen, reach, exploration.coverage)
        watch = watch_stones(tracker, exploration.stones, besides.known_stones)
        writer = csv.DictWriter(file, TRACK_COLUMNS, lineterminator="\n")
        writer.writeheader()
        follow, ways = (follow_both_ways, 2) if offline else (follow_source, 1)
        with progress(ways * source.length, "pictures, there and back" if offline else "pictures") as advance:
            try:
                for row, tracked in track_rows(tracker, follow(tracker, source, instruments, advance), coverage, watch):
                    writer.writerow({name: cell(row.get(name)) for name in TRACK_COLUMNS})
                    spent.append(tracked.seconds)
                    states[tracked.state] = states.get(tracked.state, 0) + 1
                    last, ended = (last if tracked.T_kidney_camera is None else tracked.T_kidney_camera), tracked.state
            except KeyboardInterrupt:
                interrupted = True
            except DeviceError as error:
                if not states:
                    raise
                failed = f"\nThe camera failed, and the track ends there: {error}"
        if interrupted and not states:
            raise KeyboardInterrupt
        if not states:
            raise InputError(f"{source.what} gave no picture at all.")
    rate = len(spent) / (time.perf_counter() - start)
    report = coverage_report(coverage, last, exploration.limits)
    write_json(whole.staged(whole.paths[1]), report | {"pictures": states, "ended": ended})
    write_image(whole.staged(whole.paths[2]), draw_coverage(coverage))
    told = write_stone_files(watch, *(whole.staged(path) for path in whole.paths[3:5]))
    said = _summary(source, states, ended, coverage, out, interrupted), _speed(spent, rate), told.text()
    summary = "\n".join(said) + failed
    if interrupted and offline:
        summary += "\nThe rows are what live tracking answered: the way back was not finished."
    return summary, not failed and (source.live or not interrupted)


def put_back(source: Source, cut: PictureCut, tracker: Tracker) -> Source:
    """The source with its pictures as the VID's lens gives them; the tracker leaves out what was cut away of them."""
    if cut.narrows:
        tracker.narrow(cut.inside())

    def moments() -> Iterator[Moment]:
        for moment in source.moments():
            yield replace(moment, image=cut.put_back(moment.image))

    return replace(source, moments=moments)


def camera_source(device: CameraDevice, seconds: float | None) -> Source:
    """The pictures of a camera, connected with the first and disconnected after the last, or after an error.

    A camera that gives nothing for `_SILENCES` times five seconds has failed.
    """

    def read() -> NDArray[np.uint8] | None:
        for again in reversed(range(_SILENCES)):
            try:
                return device.read(5.0).image
            except SourceAtEndError:
                return None
            except DeviceTimeoutError:
                if not again:
                    raise
        return None

    source = live_source(read, seconds)

    def moments() -> Iterator[Moment]:
        with device:
            yield from source.moments()

    return replace(source, moments=moments)


def _summary(
    source: Source, states: dict[str, int], ended: str, coverage: Coverage, out: Path, interrupted: bool
) -> str:
    total = sum(states.values())
    lines = [
        f"{total} pictures: {states.get(TRACKING, 0)} tracking, {total - states.get(TRACKING, 0)} not; rows in {out}"
    ]
    if interrupted and not source.live:
        lines.append(f"interrupted after {total} pictures of {source.what}: the rows so far are kept, and no more.")
    elif 0 < source.length != total:
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
