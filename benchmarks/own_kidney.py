"""Whether a kidney is known from another: what pictures say of it, and the weights that `OwnKidneySettings` has.

    python -m benchmarks.own_kidney                        # 8 phantoms; a quarter of an hour
    python -m benchmarks.own_kidney phantoms=4 work=DIR    # VIDs are kept there

Every phantom is flown through in its own VID and in two others'. Over the pictures of all flights the log-odds that
they show the VID's kidney are fitted anew (logistic regression, both kinds of flight counting the same) and printed
beside those in use; of the flights it is told how much was tracked, and how they ended.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import rankdata

from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, overrides
from benchmarks.tracking import fly
from ursnav_torch.errors import InputError
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, draw_faults, simulate
from ursnav_torch.tracking.settings import OwnKidneySettings
from ursnav_torch.tracking.tracker import TRACKING, Tracked, Tracker
from ursnav_torch.vid import PlanSettings, Vid

SETTINGS = {"phantoms": 8, "views": 150, "pictures": 120, "work": "", "out": ""}
KINDS = ("thesis_simulation", "thesis_phantom", "in_vivo_like")
FIRST_SEED = 20
#: Added to the fitted constant: a right VID is likelier than a wrong one, e to 1.
IN_FAVOR = 1.0
#: Poses of an own flight that are farther off say nothing of whether a right one is believed.
LOST_MM = 4.0
_BEGIN = 2  # pictures of a flight before anything is known
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Flight:
    """Answers to the pictures of one flight, and how far off each aligned pose is (N,), in mm."""

    own: bool
    kind: str
    answers: list[Tracked]
    off_mm: Array


def main(arguments: list[str]) -> None:
    """Fly, fit, print."""
    settings = overrides(SETTINGS, arguments)
    if settings["phantoms"] < 3:
        raise InputError(f"phantoms={settings['phantoms']} leaves no two others for each; ask for 3 or more.")
    report = Report("own_kidney", {k: v for k, v in settings.items() if k not in ("work", "out")})
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        vids = [_vid(FIRST_SEED + i, settings["views"], work) for i in range(settings["phantoms"])]
        flights = []
        for i, vid in enumerate(vids):
            for k in range(2):
                kind = KINDS[(i + k) % 3]
                flights.append(_flight(vid, vid, kind, FIRST_SEED + i, settings["pictures"]))
                other = vids[(i + 1 + k) % len(vids)]
                flights.append(_flight(vid, other, kind, FIRST_SEED + i, settings["pictures"]))
                print(f"phantom {i + 1} of {len(vids)}, {kind}", file=sys.stderr, flush=True)
    _tell(report, flights)
    _fit(report, flights)
    report.finish(settings["out"])


def _vid(seed: int, views: int, work: Path) -> Vid:
    kidney = make_phantom_kidney(seed, calyces=6 + seed % 4)
    return phantom_vid(kidney, PlanSettings(views, views), work / f"own_kidney_{seed}_{views}")


def _flight(seen: Vid, vid: Vid, kind: str, seed: int, pictures: int) -> Flight:
    """A flight through one kidney, tracked in a VID."""
    renderer, rng = RaycastRenderer(seen.kidney.mesh, seen.camera), np.random.default_rng(seed)
    T = fly(seen.kidney, range(0, 4, 2), rng, 0.8)[:pictures]
    faults, tracker = draw_faults(PRESETS[kind], rng), Tracker(vid)
    answers = [tracker.step(simulate(renderer, pose, faults, rng), i / 10) for i, pose in enumerate(T)]
    aligned = np.array([np.full(3, np.inf) if a.T_aligned is None else a.T_aligned[:3, 3] for a in answers])
    return Flight(seen is vid, kind, answers, np.linalg.norm(aligned - T[:, :3, 3], axis=1))


def _tell(report: Report, flights: list[Flight]) -> None:
    """How much of the flights was tracked, and how they ended."""
    for own, name in ((True, "its own VID"), (False, "another's VID")):
        for kind in KINDS:
            these = [f for f in flights if f.own == own and f.kind == kind]
            shares = [100 * float(np.mean([a.state == TRACKING for a in f.answers])) for f in these]
            if shares:
                right = sum((f.answers[-1].state == TRACKING) == own for f in these)
                note = f"{right} of {len(these)} end as they should"
                report.add(f"{kind} in {name}", "tracking", "%", shares, note)


def _fit(report: Report, flights: list[Flight]) -> None:
    """The weights anew, beside those in use."""
    rows, own = [], []
    for flight in flights:
        for answer, off in list(zip(flight.answers, flight.off_mm, strict=True))[_BEGIN:]:
            if answer.evidence is not None and (off < LOST_MM or not flight.own):
                rows.append([1.0, answer.evidence.score, answer.evidence.lead, answer.evidence.fit])
                own.append(flight.own)
    x, y = np.array(rows), np.array(own)
    sign, weight = np.where(y, 1.0, -1.0), np.where(y, 0.5 / y.mean(), 0.5 / (1 - y.mean()))
    found = minimize(lambda w: float((weight * np.logaddexp(0, -sign * (x @ w))).mean()), np.zeros(4)).x
    found[0] += IN_FAVOR
    used = OwnKidneySettings().weights
    for name, weights in (("fitted", found.tolist()), ("in use", list(used))):
        rank = rankdata(x @ np.array(weights))
        auroc = (rank[y].sum() - y.sum() * (y.sum() + 1) / 2) / (y.sum() * (~y).sum())
        report.add(f"weights {name}", "AUROC of a picture", "of 1", [float(auroc)], n=len(y))
        for what, value in zip(("constant", "score", "lead", "fit"), weights, strict=True):
            report.add(f"weights {name}", what, "log-odds", [value], n=len(y))


if __name__ == "__main__":
    main(sys.argv[1:])
