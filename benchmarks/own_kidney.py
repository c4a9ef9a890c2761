"""Whether a kidney is known from another: what the test makes of flights, by what a mirrored picture counts.

    python -m benchmarks.own_kidney work=DIR             # an hour; DIR as of benchmarks.flights
    python -m benchmarks.own_kidney work=DIR others=1    # each flight in one other VID instead of three

Every flight of the choosing half of `benchmarks.flights` is tracked in its own VID and in those of the half's other
phantoms, and every picture that is weighed against all views is mirrored, too. With what these pictures say the test is
run again for each of several `OwnKidneySettings.doubt_weights`: how much of its own kidney is believed, and of others.
A weight of 0 tells what a stricter constant does alone. The weights of the rest stay as they were learned, in VIDs of
more views, where the lead of a place tells more.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.flights import CHOOSING, flown, population, vid_for
from benchmarks.shared.results import Report, overrides
from benchmarks.shared.track_records import TOLD, Choice, tracked
from ursnav_torch.tracking.own_kidney import KidneyEvidence, OwnKidneyTest
from ursnav_torch.tracking.settings import OwnKidneySettings

SETTINGS = {"phantoms": 8, "views": 60, "around": 8.0, "pictures": 120, "others": 3, "work": "", "out": ""}
#: Weights of the decoy's score that are tried.
DECOY = (0.0, -4.0, -6.0, -8.0, -10.0, -12.0)
#: And what they and the constant make together, in log-odds, of a decoy that scores as wrong kidneys' pictures do.
TOGETHER, USUAL = (-1.25, -1.0, -0.75, -0.5, -0.25, 0.0), 0.5
_ALWAYS = (("own_kidney", "doubt_below", "99"),)  # every picture that is weighed is mirrored
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Flight:
    """What the pictures of one flight say of a VID.

    Attributes:
        own: whether the VID is of the kidney that was flown through.
        t_s: (N,) seconds.
        evidence: (N, 4) score, lead, fit and decoy, see `KidneyEvidence`; nan where a picture was not asked.
    """

    own: bool
    t_s: Array
    evidence: Array


def main(arguments: list[str]) -> None:
    """Fly, test, print."""
    settings = overrides(SETTINGS, arguments)
    report = Report("own_kidney", {k: v for k, v in settings.items() if k not in ("work", "out")})
    with tempfile.TemporaryDirectory() as scratch:
        flights = list(_flights(settings, Path(settings["work"] or scratch)))
    used = OwnKidneySettings()
    add_beliefs(report, "as set", flights, used)
    add_beliefs(report, "never mirrored", flights, OwnKidneySettings(doubt_below=used.min_sum))
    for weight in DECOY:
        for together in TOGETHER:
            tried = OwnKidneySettings(doubt_weights=(together - USUAL * weight, weight))
            add_beliefs(report, f"decoy's weight {weight:g}, {together:g} at {USUAL:g}", flights, tried)
    report.finish(settings["out"])


def _flights(settings: dict[str, Any], work: Path) -> Iterator[Flight]:
    cases = [c for c in population(settings["phantoms"]) if c.half == CHOOSING]
    vids = {c.kidney: vid_for(c, settings["views"], settings["around"], work, None) for c in cases}
    kidneys = list(vids)
    for case in cases:
        own, at = vids[case.kidney], kidneys.index(case.kidney)
        seen = flown(case, own, own.lumen, settings["pictures"], work)
        for kidney in [*kidneys[at:], *kidneys[:at]][: 1 + settings["others"]]:
            choice = Choice(_ALWAYS, other=kidney != case.kidney)
            told = tracked(seen, vids[kidney], vids[kidney].lumen, choice).told
            evidence = told[:, [TOLD.index(name) for name in ("plain", "lead", "fit", "decoy")]]
            yield Flight(kidney == case.kidney, seen.flight.t_s, evidence)
        print(f"{case.name}: severity {case.severity:g}", file=sys.stderr, flush=True)


def verdicts(flight: Flight, settings: OwnKidneySettings) -> list[bool | None]:
    """What the test says at every picture, see `OwnKidneyTest.verdict`; what it said stands until it says otherwise."""
    test, looked_s = OwnKidneyTest(settings), None
    said: list[bool | None] = []
    for t_s, evidence in zip(flight.t_s.tolist(), flight.evidence, strict=True):
        if np.isfinite(evidence).all():
            score, lead, fit, decoy = evidence.tolist()
            told = KidneyEvidence(score, lead, fit, decoy if test.in_doubt else None)
            test.add(told, settings.frame_s if looked_s is None else t_s - looked_s)
            looked_s = t_s
        before = said[-1] if said else None
        said.append(before if test.verdict is None else test.verdict)
    return said


def add_beliefs(report: Report, group: str, flights: Sequence[Flight], settings: OwnKidneySettings) -> None:
    """How much of right and of wrong kidneys is believed, and how their flights end."""
    for own, name in ((True, "a right kidney"), (False, "a wrong kidney")):
        found = [verdicts(flight, settings) for flight in flights if flight.own == own]
        share = 100 * float(np.mean([v is True for said in found for v in said]))
        note = f"{sum(said[-1] is False for said in found)} of {len(found)} end lost"
        report.add(group, f"{name} believed", "%", [share], note, sum(len(said) for said in found))


if __name__ == "__main__":
    main(sys.argv[1:])
