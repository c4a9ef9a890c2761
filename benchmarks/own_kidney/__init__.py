"""Whether a kidney is known from another: the test's weights, learned from flights and inspections and judged on them.

    python -m benchmarks.own_kidney work=DIR             # an hour; DIR as of benchmarks.flights
    python -m benchmarks.own_kidney work=DIR others=3    # each sequence in three other VIDs instead of one

Sequences are the flights of the choosing half of `benchmarks.flights`, and inspections: the same half's phantoms
explored by true places, slowly and close to walls that look alike from many places and in a mirror. Each is tracked in
its own kidney's VID and in those of other phantoms of the half, and every picture that is weighed against all views is
mirrored, too. Weights fitted to them (`weights.fitted`) are judged on each phantom by those of the others: the test is
run again over what its pictures say.
"""

import itertools
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.own_kidney.inspections import inspected, one_a_phantom
from benchmarks.own_kidney.weights import PRIOR, RELATIVE, fitted
from benchmarks.shared.flights import CHOOSING, Case, Flown, flown, population, vid_for
from benchmarks.shared.results import Report, overrides
from benchmarks.shared.track_records import TOLD, Choice, tracked
from ursnav_torch.tracking.own_kidney import KidneyEvidence, OwnKidneyTest
from ursnav_torch.tracking.settings import OwnKidneySettings
from ursnav_torch.vid import Vid

SETTINGS = {"phantoms": 8, "pictures": 120, "inspected": 12, "inspections": 450, "others": 1, "work": "", "out": ""}
#: Views a calyx and around of the VIDs in which flights and inspections are tracked.
FLIGHT_VIEWS, INSPECTION_VIEWS = (60, 8.0), (150, 2.0)
FLIGHT, INSPECTION = "flight", "inspection"
#: Shares of the evidence that may count, and the most that a picture may speak against a kidney.
INDEPENDENT, AGAINST = (0.2, 0.3, 0.5, 1.0), (0.2, 0.3, 0.5, 1.0)
#: Sums from which on a kidney may be believed, and the choices of `weights.RELATIVE` and `weights.PRIOR`.
ABOVE, RELATIVES, PRIORS = (1.0, 1.5, 2.0), (0.0, 0.5, 1.0), (0.0, 0.5, 1.0)
_ALWAYS = (("own_kidney", "doubt_below", "99"),)  # every picture that is weighed is mirrored
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Seen:
    """What the pictures of one sequence say of a VID.

    Attributes:
        kind: `FLIGHT` or `INSPECTION`.
        kidney: that was seen.
        own: whether the VID is of that kidney.
        t_s: (N,) seconds.
        evidence: (N, 3) score, fit and decoy, see `KidneyEvidence`; nan where a picture was not asked.
    """

    kind: str
    kidney: str
    own: bool
    t_s: Array
    evidence: Array


def main(arguments: list[str]) -> None:
    """Fly and inspect, fit, test, print."""
    settings = overrides(SETTINGS, arguments)
    report = Report("own_kidney", {k: v for k, v in settings.items() if k not in ("work", "out")})
    with tempfile.TemporaryDirectory() as scratch:
        found = list(_all_seen(settings, Path(settings["work"] or scratch)))
    used = OwnKidneySettings()
    add_beliefs(report, "as set", [(one, used) for one in found])
    add_beliefs(report, "never mirrored", [(one, OwnKidneySettings(doubt_below=used.min_sum)) for one in found])
    for share, against in itertools.product(INDEPENDENT, AGAINST):
        name = f"fitted to others, independent={share:g}, max_llr_against={against:g}"
        add_beliefs(report, name, _left_out(found, replace(used, independent=share, max_llr_against=against)))
    for above in ABOVE:
        add_beliefs(
            report, f"fitted to others, accept_above={above:g}", _left_out(found, replace(used, accept_above=above))
        )
    for relative, prior in itertools.product(RELATIVES, PRIORS):
        name = f"fitted to others, relative={relative:g}, prior={prior:g}"
        add_beliefs(report, name, _left_out(found, used, relative, prior))
    whole = _fitted(found, used)
    for name, weights in (("weights", whole.weights), ("doubt_weights", whole.doubt_weights)):
        report.add("fitted", name, "log-odds", list(weights), note=", ".join(f"{w:g}" for w in weights))
    report.finish(settings["out"])


def _fitted(
    seen: Sequence[Seen], settings: OwnKidneySettings, relative: float = RELATIVE, prior: float = PRIOR
) -> OwnKidneySettings:
    own, other = ([one.evidence for one in seen if one.own == side] for side in (True, False))
    return fitted(own, other, settings, relative, prior)


def _left_out(
    seen: Sequence[Seen], settings: OwnKidneySettings, relative: float = RELATIVE, prior: float = PRIOR
) -> list[tuple[Seen, OwnKidneySettings]]:
    """Every sequence with the settings that those of the other phantoms teach."""
    taught = {
        k: _fitted([s for s in seen if s.kidney != k], settings, relative, prior) for k in {s.kidney for s in seen}
    }
    return [(one, taught[one.kidney]) for one in seen]


def _all_seen(settings: dict[str, Any], work: Path) -> Iterator[Seen]:
    def fly(case: Case, vid: Vid) -> Flown:
        return flown(case, vid, vid.lumen, settings["pictures"], work)

    def inspect(case: Case, vid: Vid) -> Flown:
        return inspected(case, vid, settings["inspections"], work)

    flights = [c for c in population(settings["phantoms"]) if c.half == CHOOSING]
    yield from _tracked(FLIGHT, flights, FLIGHT_VIEWS, fly, settings["others"], work)
    cases = [c for c in population(settings["inspected"]) if c.half == CHOOSING]
    yield from _tracked(INSPECTION, one_a_phantom(cases), INSPECTION_VIEWS, inspect, settings["others"], work)


def _tracked(
    kind: str,
    cases: Sequence[Case],
    views: tuple[int, float],
    see: Callable[[Case, Vid], Flown],
    others: int,
    work: Path,
) -> Iterator[Seen]:
    """Every case in its own VID and in the next ones."""
    vids = {c.kidney: vid_for(c, *views, work, None) for c in cases}
    kidneys = list(vids)
    for case in cases:
        own, at = vids[case.kidney], kidneys.index(case.kidney)
        seen = see(case, own)
        for kidney in [*kidneys[at:], *kidneys[:at]][: 1 + others]:
            choice = Choice(_ALWAYS, other=kidney != case.kidney)
            told = tracked(seen, vids[kidney], vids[kidney].lumen, choice).told
            evidence = told[:, [TOLD.index(name) for name in ("plain", "fit", "decoy")]]
            yield Seen(kind, case.kidney, kidney == case.kidney, seen.flight.t_s, evidence)
        print(f"{kind} {case.name}", file=sys.stderr, flush=True)


def verdicts(seen: Seen, settings: OwnKidneySettings) -> list[bool | None]:
    """What the test says at every picture, see `OwnKidneyTest.verdict`; what it said stands until it says otherwise."""
    test, looked_s = OwnKidneyTest(settings), None
    said: list[bool | None] = []
    for t_s, evidence in zip(seen.t_s.tolist(), seen.evidence, strict=True):
        if np.isfinite(evidence).all():
            score, fit, decoy = evidence.tolist()
            told = KidneyEvidence(score, fit, decoy if test.in_doubt else None)
            test.add(told, settings.frame_s if looked_s is None else t_s - looked_s)
            looked_s = t_s
        before = said[-1] if said else None
        said.append(before if test.verdict is None else test.verdict)
    return said


def add_beliefs(report: Report, group: str, tested: Sequence[tuple[Seen, OwnKidneySettings]]) -> None:
    """How much of right and of wrong kidneys is believed and given up, by kind, and how their sequences end."""
    for kind in dict.fromkeys(one.kind for one, _ in tested):
        for own, name in ((True, "a right kidney"), (False, "a wrong kidney")):
            found = [verdicts(one, s) for one, s in tested if (one.kind, one.own) == (kind, own)]
            if not found:
                continue
            every = [v for said in found for v in said]
            note = f"{sum(said[-1] is False for said in found)} of {len(found)} end lost"
            report.add(group, f"{kind}: {name} believed", "%", [100 * every.count(True) / len(every)], note, len(every))
            report.add(group, f"{kind}: {name} given up", "%", [100 * every.count(False) / len(every)], n=len(every))
