"""The bars that tracks are judged by."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.results import Report
from benchmarks.shared.track_records import TOLD, Record
from ursnav_torch.tracking.tracker import LOST, TRACKING

Array = NDArray[np.float64]
#: A track this far off is wrong; a loss is over when it is nearer again.
FAR_MM = 3.0
_SD, _SCORE = TOLD.index("sd_mm"), TOLD.index("score")
#: A pose this near to the true one names another calyx only where it is on a border.
NEAR_MM, NEAR_DEG = 1.0, 10.0
#: Deviations up to which a picture may count as coverage, mm; the last is that of `CoverageSettings`.
SURE_MM = (2.0, 1.5, 1.2, 0.9)


def add_scores(report: Report, group: str, records: Sequence[Record]) -> None:
    """One group of rows over all pictures of some tracks."""
    on = np.concatenate([r.state == TRACKING for r in records])
    off = np.concatenate([r.off_mm for r in records])
    n, known = len(on), on & np.isfinite(off)
    report.add(group, "a place (tracking)", "%", [100 * on.mean()], n=n)
    since = np.concatenate([np.logical_or.accumulate(r.state == TRACKING) for r in records])
    report.add(group, "a place, once there was one", "%", [100 * float(on[since].mean())], n=int(since.sum()))
    _add_causes(report, group, records)
    report.add(
        group, "tracking, yet more than 3 mm off", "%", [100 * float((off[known] > FAR_MM).mean())], n=int(on.sum())
    )
    report.add(group, "position", "mm", off[known].tolist())
    report.add(group, "position, 90th percentile", "mm", [float(np.percentile(off[known], 90))], n=int(on.sum()))
    held = off <= np.concatenate([r.told[:, TOLD.index("region_mm")] for r in records])
    fog = np.concatenate([r.flown.fogged for r in records])
    for where, at in (("", known), (", foggiest quarter", known & (fog >= np.quantile(fog, 0.75)))):
        share = 100 * float(held[at].mean())
        report.add(group, f"90 % region holds the truth{where}", "%", [share], n=int(at.sum()))
    _add_counted(report, group, records, known)
    turned = np.concatenate([r.turned_deg for r in records])
    report.add(group, "direction", "deg", turned[known].tolist())
    true, named = (np.concatenate([getattr(r, name) for r in records]) for name in ("true_calyx", "calyx"))
    one = on & (true >= 0)
    right, at_border = (true == named)[one], (known & (off < NEAR_MM) & (turned < NEAR_DEG))[one]
    report.add(group, "right calyx, of pictures tracked that have one", "%", [100 * float(right.mean())], n=len(right))
    share = 100 * float((right | at_border).mean())
    report.add(group, "right calyx, or within 1 mm and 10 deg", "%", [share], n=len(right))
    found = [s for r in records for s in losses_s(r)]
    if found:
        soon = [s <= 2.0 for s in found]
        report.add(group, "losses found again within 2 s", "%", [100 * float(np.mean(soon))], n=len(soon))
        report.add(group, "longest loss", "s", [max(found)], n=len(found))
    ended = sum(r.state[-1] == LOST for r in records)
    report.add(group, "flights that end lost", f"of {len(records)}", [float(ended)], n=len(records))


def add_refusals(report: Report, group: str, records: Sequence[Record]) -> None:
    """What a VID makes of flights through another kidney: nothing is believed, and they end lost."""
    on = np.concatenate([r.state == TRACKING for r in records])
    report.add(group, "believed", "%", [100 * float(on.mean())], n=len(on))
    ended = [r.state[-1] == LOST for r in records]
    report.add(group, "flights that end lost", f"of {len(ended)}", [float(sum(ended))], n=len(ended))
    until = [float(r.flown.flight.t_s[int(np.argmax(r.state == LOST))]) for r in records if (r.state == LOST).any()]
    if until:
        report.add(group, "time until lost", "s", until)


def losses_s(record: Record) -> list[float]:
    """How long each stretch without a place, or with a wrong one, lasted; the first place's is not among them."""
    t = record.flown.flight.t_s
    bad = (record.state != TRACKING) | ~(record.off_mm <= FAR_MM)
    if bad.all():
        return [float(t[-1] - t[0])]
    first = int(np.argmin(bad))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad[first:], [False]]))) + first
    ends = [min(e, len(t) - 1) for e in edges[1::2].tolist()]
    return [float(t[e] - t[s]) for s, e in zip(edges[::2].tolist(), ends, strict=True)]


def _add_counted(report: Report, group: str, records: Sequence[Record], known: NDArray[np.bool_]) -> None:
    """How many pictures coverage counts if their places may be off by so much, and how many of these are too far."""
    off, sd = np.concatenate([r.off_mm for r in records]), np.concatenate([r.told[:, _SD] for r in records])
    shown = known & np.isfinite(np.concatenate([r.told[:, _SCORE] for r in records]))
    for limit in SURE_MM:
        counted = shown & (sd <= limit)
        share, far = 100 * float(counted.sum()) / max(int(shown.sum()), 1), int((off[counted] > FAR_MM).sum())
        report.add(group, f"deviation of at most {limit:g} mm, of places seen", "%", [share], n=int(shown.sum()))
        report.add(group, f"of these more than 3 mm off ({limit:g} mm)", "pictures", [far], n=int(counted.sum()))


def _add_causes(report: Report, group: str, records: Sequence[Record]) -> None:
    """Why pictures have no place: before the first one, refused, a region too wide for one, or no pose at all."""
    state = np.concatenate([r.state for r in records])
    since = np.concatenate([np.logical_or.accumulate(r.state == TRACKING) for r in records])
    posed = np.isfinite(np.concatenate([r.off_mm for r in records]))
    shown = np.isfinite(np.concatenate([r.told[:, _SCORE] for r in records]))
    later = (state != TRACKING) & (state != LOST) & since
    for why, at in (
        ("before the first", ~since),
        ("the kidney is refused", (state == LOST) & since),
        ("its region is too wide", later & posed & shown),
        ("its region is too wide, nothing shown", later & posed & ~shown),
        ("it is looked for", later & ~posed),
    ):
        report.add(group, f"no place: {why}", "pictures", [float(at.sum())], n=len(state))
