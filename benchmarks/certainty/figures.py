"""What certainty says of pictures whose truth is known, and the figures that judge it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.shared.results import Report
from benchmarks.shared.statistics import auroc, calibration_error
from ursnav_torch.localization.certainty import CertaintyModel
from ursnav_torch.localization.fitting import Asked


@dataclass(frozen=True, slots=True)
class Told:
    """One picture's answer beside the truth.

    Attributes:
        kind: of picture; ``none`` for one of nothing.
        right: whether the calyx is.
        confidence, accepted: as told.
        held: whether the set holds the right calyx; ``size`` of the set.
        position_mm, direction_deg: errors in standard deviations; nan for a picture of nothing.
    """

    kind: str
    right: bool
    confidence: float
    accepted: bool
    held: bool
    size: int
    position: float
    direction: float


def told(model: CertaintyModel, asked: Asked, risk: float, probability: float) -> list[Told]:
    """What a model says of pictures."""
    threshold, found = model.threshold(risk), []
    for i, e in enumerate(asked.evidence):
        sure, shown = model.certainty(e, probability), int(asked.shown[i])
        found.append(
            Told(
                str(asked.kind[i]), e.answer == shown, sure.confidence, sure.confidence >= threshold,
                max(shown, -1) in sure.calyces, len(sure.calyces), float(asked.position_mm[i]) / sure.position_sd_mm,
                float(asked.direction_deg[i]) / sure.direction_sd_deg,
            )
        )  # fmt: skip
    return found


def report_told(report: Report, group: str, found: Sequence[Told]) -> None:
    """Rows for every kind of picture, and for all that show something."""
    for kind in dict.fromkeys(t.kind for t in found):
        own = [t for t in found if t.kind == kind]
        if kind == "none":
            refused = sum(not t.accepted for t in own)
            report.add(f"{group}, nothing", "refused", "%", [100 * refused / len(own)], n=len(own))
        else:
            _report_kind(report, group, kind, own)
    shown = [t for t in found if t.kind != "none"]
    _report_kind(report, group, "all", shown)
    confidence, right = np.array([t.confidence for t in shown]), np.array([t.right for t in shown])
    report.add(f"{group}, all", "AUROC of confidence", "of 1", [auroc(confidence, right)], n=len(shown))


def _report_kind(report: Report, group: str, kind: str, own: Sequence[Told]) -> None:
    accepted, name = [t for t in own if t.accepted], f"{group}, {kind}"
    good, count = sum(t.right for t in accepted), len(own)
    note = f"{good}/{len(accepted)} of the accepted"
    report.add(name, "right", "%", [_percent(own, "right")], n=count)
    report.add(name, "accepted", "%", [_percent(own, "accepted")], n=count)
    if accepted:
        report.add(name, "right of the accepted", "%", [_percent(accepted, "right")], note, len(accepted))
    report.add(name, "set holds the right calyx", "%", [_percent(own, "held")], n=count)
    report.add(name, "mean size of the set", "calyces", [float(np.mean([t.size for t in own]))], n=count)
    confidence, right = np.array([t.confidence for t in own]), np.array([t.right for t in own])
    report.add(name, "expected calibration error", "of 1", [calibration_error(confidence, right)], n=count)
    for what in ("position", "direction"):
        within = 100 * float(np.mean([getattr(t, what) <= 1 for t in own]))
        report.add(name, f"{what} within one sd", "%", [within], n=count)


def _percent(found: Sequence[Told], what: str) -> float:
    return 100 * float(np.mean([getattr(t, what) for t in found]))
