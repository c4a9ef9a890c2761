"""How far off a track's poses are, learned from flights: the weights that `tracking.certainty` tells errors with."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared.results import Report
from benchmarks.shared.track_records import TOLD, Record
from benchmarks.shared.track_scores import FAR_MM
from ursnav_torch.errors import InputError
from ursnav_torch.localization.fitting import fit_quantile
from ursnav_torch.localization.learned import packaged_models, save_packaged
from ursnav_torch.tracking.certainty import REGION_90

Array = NDArray[np.float64]
#: Added to errors before their logarithm is taken, mm, and to the spread, as `tracking.certainty` does.
_SMALL_MM, _FINEST_MM = 0.02, 0.1
#: A place too far off counts as so many that are missing: 5 % of pictures may be without one, 1.5 % too far off.
_FAR_COSTS = 5 / 1.5
#: Regions that may be asked of a place, see `TrackCertaintySettings.largest_mm`.
_REGIONS_MM = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)


def fit_position(report: Report, flights: Mapping[str, Sequence[Record]], save: bool) -> None:
    """Fit the weights of position errors over all flights; judge them on each phantom by those of the others.

    Args:
        report: takes the figures.
        flights: tracks by how they were followed (without a robot's word, and with it); all teach alike.
        save: whether the package keeps the weights.

    Raises:
        InputError: the package has no weights to be replaced.
    """
    records = [(how, record) for how, found in flights.items() for record in found]
    how, kidney = (
        np.concatenate([[name] * int(_seen(r).sum()) for name, r in named])
        for named in (records, [(r.flown.case.kidney, r) for _, r in records])
    )
    basis, off = (np.concatenate(column) for column in zip(*(_errors(r) for _, r in records), strict=True))
    told = np.zeros(len(off))
    for name in np.unique(kidney):
        others = kidney != name
        told[~others] = np.exp(basis[~others] @ fit_quantile(basis[others], np.log(off[others] + _SMALL_MM)))
    for name in flights:
        _tell(report, f"position told, phantoms left out, {name}", off[how == name], told[how == name])
    weights = fit_quantile(basis, np.log(off + _SMALL_MM))
    for what, weight in zip(("constant", "score", "log spread"), weights.tolist(), strict=True):
        report.add("weights of position", what, "log mm", [weight], n=len(off))
    if save:
        packaged = packaged_models()
        if packaged is None or packaged.track is None:
            raise InputError("The package has no track weights yet; learn them first: benchmarks.certainty save=true.")
        a, b, c = (float(f"{w:.5g}") for w in weights)
        save_packaged(replace(packaged, track=replace(packaged.track, position=(a, b, c))))


def _tell(report: Report, group: str, off: Array, told: Array) -> None:
    """How well errors (N,) are told, and what is a place for each region that may be asked of it."""
    report.add(group, "within one sd", "%", [100 * float((off <= told).mean())], n=len(off))
    report.add(group, "90th percentile of errors in sd", "sd", [float(np.quantile(off / told, 0.9))], n=len(off))
    for within in _REGIONS_MM:
        kept, what = REGION_90 * told <= within, f"90 % region within {within:g} mm"
        report.add(group, what, "%", [100 * float(kept.mean())], n=len(off))
        far = kept & (off > FAR_MM)
        worth = 100 * float(kept.mean() - _FAR_COSTS * far.mean())
        report.add(group, f"{what}, less {_FAR_COSTS:.1f} times those too far off", "%", [worth], n=len(off))
        wrong = 100 * float(far.sum() / max(kept.sum(), 1))
        report.add(group, f"{what}, yet more than 3 mm off", "%", [wrong], n=int(kept.sum()))


def _seen(record: Record) -> NDArray[np.bool_]:
    """Pictures (N,) that showed something, and have a pose."""
    told = record.told[:, [TOLD.index(name) for name in ("score", "spread_mm")]]
    return np.isfinite(record.off_mm) & np.isfinite(told).all(1)


def _errors(record: Record) -> tuple[Array, Array]:
    """What errors are told from (M, 3), see `TrackEvidence.error_numbers`, and the errors (M,)."""
    seen = _seen(record)
    score, spread = (record.told[seen, TOLD.index(name)] for name in ("score", "spread_mm"))
    return np.column_stack([np.ones(len(score)), score, np.log(spread + _FINEST_MM)]), record.off_mm[seen]
