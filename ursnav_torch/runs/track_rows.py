"""A track's answers as the rows that `track` writes."""

from collections.abc import Iterable, Iterator
from typing import Any

from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.stones import StoneWatch
from ursnav_torch.tracking.follow import Moment
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import pose_cells


def track_rows(
    tracker: Tracker,
    answers: Iterable[tuple[Moment, Tracked]],
    coverage: Coverage | None = None,
    stones: StoneWatch | None = None,
) -> Iterator[tuple[dict[str, Any], Tracked]]:
    """A row of `TRACK_COLUMNS` for every picture, and the answer it was made from; ``coverage`` is painted along,
    and ``stones`` are looked for.

    A picture is painted when the track is believed and leaves one calyx, for the time since the one before,
    but for the wall behind stones and instruments.
    """
    last = None
    for moment, tracked in answers:
        passed = moment.t_s - last if last is not None else 0.0
        last = moment.t_s
        if coverage is not None and tracked.T_kidney_camera is not None and tracked.is_settled:
            coverage.look_through(tracker.shown)
            coverage.add(tracked.T_kidney_camera, passed, tracked.bodies, tracked.position_sd_mm)
        if stones is not None:
            stones.see(tracked, moment.image, moment.t_s, moment.frame)
        yield track_row(moment, tracked, tracker), tracked


def track_row(moment: Moment, tracked: Tracked, tracker: Tracker) -> dict[str, Any]:
    """The columns of one answer; the calyx is blank unless tracking, the pose where nothing is known."""
    row: dict[str, Any] = {"frame": moment.frame, "t_s": moment.t_s, "state": tracked.state}
    if tracked.T_kidney_camera is not None:
        row |= pose_cells(tracked.T_kidney_camera[None])[0]
    if tracked.state == TRACKING:
        row |= {"calyx": tracker.vid.calyx_name(tracked.calyx), "confidence": float(tracked.confidence)}
    if tracked.certainty is not None:
        sure = tracked.certainty
        row |= {"calyces": "|".join(tracker.vid.set_names(sure.calyces)), "position_sd_mm": sure.position_sd_mm}
        row |= {"direction_sd_deg": sure.direction_sd_deg}
    return row | {"seconds": tracked.seconds}
