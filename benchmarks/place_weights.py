"""The settings of the place test that make the tracks of the choosing flights most likely.

    python -m benchmarks.place_weights work=DIR     # after benchmarks.flights work=DIR half=choosing

No flight is tracked again: the evidence of every picture and whether its aligned pose was right lie in ``work``; the
hidden Markov filter runs over them with other weights and times, until its probabilities fit best (log score).
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.shared.flights import CHOOSING, population
from benchmarks.shared.results import Report, overrides
from ursnav_torch.errors import InputError
from ursnav_torch.tracking.own_kidney import KidneyEvidence
from ursnav_torch.tracking.place_test import PlaceTest
from ursnav_torch.tracking.settings import PlaceSettings

SETTINGS = {"work": "", "phantoms": 8, "rounds": 260, "out": ""}
#: A pose nearer than the first is right, one farther than the second is wrong; between them it is neither.
RIGHT_MM, WRONG_MM = 3.0, 4.0
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sequence:
    """A track: seconds since the picture before (N,), evidence (N, 3), and how far off the aligned poses are (N,).

    Attributes:
        stepped_mm: (N,) from one aligned pose to the next.
    """

    seconds: Array
    evidence: Array
    off_mm: Array
    stepped_mm: Array


def main(arguments: list[str]) -> None:
    """Fit, print, keep."""
    settings = overrides(SETTINGS, arguments)
    found = list(_sequences(Path(settings["work"]), settings["phantoms"]))
    if not found:
        raise InputError(
            f"There are no tracks in {settings['work']!r}; run benchmarks.flights work=DIR half=choosing first."
        )
    report = Report("place_weights", {k: v for k, v in settings.items() if k not in ("work", "out")})
    used = PlaceSettings()
    best = minimize(
        lambda x: _log_loss(_settings(x), found), _vector(used), method="Nelder-Mead",
        options={"maxiter": settings["rounds"], "xatol": 0.02, "fatol": 1e-4},
    ).x  # fmt: skip
    for name, chosen in (("fitted", _settings(best)), ("in use", used)):
        report.add(name, "log loss a picture", "nat", [_log_loss(chosen, found)], n=len(found))
        for what, value in zip(("constant", "score", "lead", "fit"), chosen.weights, strict=True):
            report.add(name, what, "log-odds", [value])
        for what in ("slip_s", "found_s", "max_llr", "first"):
            report.add(name, what, "s" if what.endswith("_s") else "log-odds", [getattr(chosen, what)])
    print(report.table())
    print(f"\nwritten to {report.write(Path(settings['out']) if settings['out'] else None)}")


def _sequences(work: Path, phantoms: int) -> Iterator[Sequence]:
    """The tracks of the choosing flights, all that were ever run."""
    for case in population(phantoms):
        for folder in sorted(work.glob(f"{case.name}_*")) if case.half == CHOOSING else ():
            with np.load(folder / "flight.npz") as flight:
                t_s, true = flight["t_s"], flight["T"][:, :3, 3]
            for path in sorted(folder.glob("track_*.npz")):
                with np.load(path) as track:
                    place, evidence = track["aligned"][:, :3, 3], track["evidence"][:, 1:]
                stepped = np.linalg.norm(np.diff(place, axis=0, prepend=place[:1]), axis=1)
                seconds = np.diff(t_s, prepend=t_s[0] - 0.1)
                yield Sequence(seconds, evidence, np.linalg.norm(place - true, axis=1), stepped)


def _log_loss(settings: PlaceSettings, sequences: list[Sequence]) -> float:
    """Mean negative log-probability of what is true, over all pictures that are plainly right or wrong."""
    total, count = 0.0, 0
    for s in sequences:
        test = PlaceTest(settings)
        for seconds, evidence, off, stepped in zip(s.seconds, s.evidence, s.off_mm, s.stepped_mm, strict=True):
            test.passed(float(seconds))
            if not np.isfinite(off):
                continue
            if stepped > RIGHT_MM:
                test.reset()
            test.add(test.llr(KidneyEvidence(*evidence.tolist())), float(seconds))
            if off < RIGHT_MM or off > WRONG_MM:
                total -= float(np.log(test.right if off < RIGHT_MM else 1 - test.right))
                count += 1
    return total / max(count, 1)


def _vector(settings: PlaceSettings) -> Array:
    times = np.log([settings.slip_s, settings.found_s])
    return np.array([*settings.weights, *times, settings.max_llr, settings.first])


def _settings(x: Array) -> PlaceSettings:
    changed: dict[str, Any] = {"weights": tuple(x[:4].tolist()), "max_llr": max(abs(float(x[6])), 0.1)}
    slip, found = np.exp(np.clip(x[4:6], -3, 6)).tolist()
    return replace(PlaceSettings(), slip_s=slip, found_s=found, first=float(x[7]), **changed)


if __name__ == "__main__":
    main(sys.argv[1:])
