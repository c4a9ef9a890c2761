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
from ursnav_torch.localization.learned import PositionErrors, packaged_models, save_packaged

Array = NDArray[np.float64]
#: Added to errors before their logarithm is taken, mm, and to the spread, as `tracking.certainty` does.
_SMALL_MM, _FINEST_MM = 0.02, 0.1
#: A place too far off counts as so many that are missing: 5 % of pictures may be without one, 1.5 % too far off.
_FAR_COSTS = 5 / 1.5
#: Regions that may be asked of a place, see `TrackCertaintySettings.largest_mm`.
_REGIONS_MM = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)


def fit_position(report: Report, records: Mapping[str, Sequence[Record]], save: bool) -> None:
    """Fit the weights of position errors over all flights; judge them on each phantom by those of the others.

    Args:
        report: takes the figures.
        records: tracks without a robot's word (``position``), and with it (``position_told``); each has its own.
        save: whether the package keeps the weights.

    Raises:
        InputError: the package has no weights to be replaced.
    """
    position, told = (_fitted(report, name, records[name]) for name in ("position", "position_told"))
    if save:
        packaged = packaged_models()
        if packaged is None or packaged.track is None:
            raise InputError("The package has no track weights yet; learn them first: benchmarks.certainty save=true.")
        save_packaged(replace(packaged, track=replace(packaged.track, position=position, position_told=told)))


def _fitted(report: Report, name: str, records: Sequence[Record]) -> PositionErrors:
    """The errors of one kind of tracks."""
    basis, off = (np.concatenate(column) for column in zip(*(_errors(r) for r in records), strict=True))
    kidney = np.concatenate([[r.flown.case.kidney] * int(_seen(r).sum()) for r in records])
    told, region = np.zeros((2, len(off)))
    for phantom in np.unique(kidney):
        others = kidney != phantom
        fitted = _fit(basis[others], off[others])
        told[~others] = np.exp(basis[~others] @ np.array(fitted.weights))
        region[~others] = fitted.region_sd * told[~others]
    _tell(report, f"{name}, phantoms left out", off, told, region)
    errors = _fit(basis, off)
    for what, value in zip(("constant", "score", "log spread"), errors.weights, strict=True):
        report.add(name, what, "log mm", [value], n=len(off))
    report.add(name, "90 % region", "sd", [errors.region_sd], n=len(off))
    return errors


def _fit(basis: Array, off: Array) -> PositionErrors:
    """Of errors (N,) told from (N, 3)."""
    weights = fit_quantile(basis, np.log(off + _SMALL_MM))
    region_sd = float(np.quantile(off / np.exp(basis @ weights), 0.9))
    a, b, c, region = (float(f"{w:.5g}") for w in (*weights, region_sd))
    return PositionErrors((a, b, c), region)


def _tell(report: Report, group: str, off: Array, told: Array, region: Array) -> None:
    """How well errors (N,) are told, and what is a place for each region that may be asked of it."""
    report.add(group, "within one sd", "%", [100 * float((off <= told).mean())], n=len(off))
    report.add(group, "within the 90 % region", "%", [100 * float((off <= region).mean())], n=len(off))
    for within in _REGIONS_MM:
        kept, what = region <= within, f"90 % region within {within:g} mm"
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
