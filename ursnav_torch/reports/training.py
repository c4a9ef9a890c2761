"""What a trainee asks of a session: visits, time to inspect, missed calyces, and the path beside published ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import INSPECTED, OUT_OF_REACH, UNSEEN, CalyxCoverage, Coverage

Array = NDArray[np.float64]

#: Way of the tip through a whole kidney, mm: mean and standard deviation of ten each, beside which a trainee's is read
#: (kinematics of the ureteroscope's tip, synapsesocial W4399358136).
NOVICES_MM, EXPERTS_MM = (2182.0, 613.0), (1164.0, 290.0)
#: A visit is so long, s; and the same calyx after a shorter absence is the same visit.
VISIT_S, ABSENCE_S = 0.5, 1.0
#: How often the wall that was seen is looked at as the session goes on, s.
_EVERY_S = 0.25


@dataclass(slots=True)
class TrainingFigures:
    """What a session was like to whoever learns.

    Attributes:
        visits: by calyx, how often the scope came into it.
        inspected_s: by calyx that was inspected, s from when its wall was first seen.
        calyces: how far each was seen in the end.
    """

    visits: dict[str, int] = field(default_factory=dict)
    inspected_s: dict[str, float] = field(default_factory=dict)
    calyces: list[CalyxCoverage] = field(default_factory=list)

    @property
    def missed(self) -> list[str]:
        """Calyces in the scope's reach that were not inspected."""
        return [c.calyx for c in self.calyces if c.verdict not in (INSPECTED, OUT_OF_REACH)]


def training_figures(
    coverage: Coverage,
    t_s: Array,
    names: Sequence[str],
    T_kidney_camera: Array,
    seconds: Array,
    position_sd_mm: Array | None = None,
) -> TrainingFigures:
    """The figures of a session; paints what was seen into ``coverage`` as the session went on.

    Args:
        coverage: of nothing yet.
        t_s: (N,) of every picture that was believed.
        names: (N,) the calyx in it; blank for none.
        T_kidney_camera: (N, 4, 4) from where; NaN where the wall seen does not count.
        seconds: (N,) since the picture before.
        position_sd_mm: (N,) how far off the place may be, NaN where nobody said; nobody did anywhere without it.
    """
    sds = np.full(len(t_s), np.nan) if position_sd_mm is None else position_sd_mm
    first: dict[str, float] = {}
    found, due = TrainingFigures(count_visits(t_s, names)), -np.inf
    for t, T, passed, sd in zip(t_s, T_kidney_camera, seconds, sds, strict=True):
        if np.isfinite(T).all():
            coverage.add(T, float(passed), position_sd_mm=float(sd) if np.isfinite(sd) else None)
        if t < due:
            continue
        due = t + _EVERY_S
        _look(_verdicts(coverage.calyces()), float(t), first, found.inspected_s)
    found.calyces = coverage.calyces()
    if len(t_s):
        _look(_verdicts(found.calyces), float(t_s[-1]), first, found.inspected_s)
    return found


def as_told(found: TrainingFigures, told: Sequence[tuple[float, Mapping[str, Sequence[Any]]]]) -> TrainingFigures:
    """Figures with the verdicts that navigation told as the session went on, if it told any.

    It knows what stood before the wall and how far off the place may have been, and when wall is to count.

    Args:
        found: the figures.
        told: moments in seconds, and verdict and share by the calyx.
    """
    if not told:
        return found
    first: dict[str, float] = {}
    inspected_s: dict[str, float] = {}
    for t_s, said in told:
        _look({name: str(verdict) for name, (verdict, _) in said.items()}, t_s, first, inspected_s)
    last = {name: (str(verdict), float(share)) for name, (verdict, share) in told[-1][1].items()}
    calyces = [
        replace(c, verdict=last[c.calyx][0], share=last[c.calyx][1]) if c.calyx in last else c for c in found.calyces
    ]
    return replace(found, inspected_s=inspected_s, calyces=calyces)


def _verdicts(calyces: Sequence[CalyxCoverage]) -> dict[str, str]:
    return {c.calyx: c.verdict for c in calyces}


def _look(verdicts: Mapping[str, str], t_s: float, first: dict[str, float], inspected_s: dict[str, float]) -> None:
    """Note when a calyx was first seen, and how long it then took until it was inspected."""
    for calyx, verdict in verdicts.items():
        if verdict not in (UNSEEN, OUT_OF_REACH):
            begun = first.setdefault(calyx, t_s)
            if verdict == INSPECTED:
                inspected_s.setdefault(calyx, t_s - begun)


def count_visits(t_s: Array, names: Sequence[str]) -> dict[str, int]:
    """How often the scope came into each calyx, by the calyx (N,) in its pictures; blank is none.

    What is shorter than `VISIT_S` is none; who is back within `ABSENCE_S` was not away.
    """
    stays: dict[str, list[list[float]]] = {}
    before = ""
    for t, name in zip(t_s.tolist(), names, strict=True):
        if name:
            own = stays.setdefault(name, [])
            if own and (name == before or t - own[-1][1] <= ABSENCE_S):
                own[-1][1] = t
            else:
                own.append([t, t])
        before = name
    counted = {name: sum(end - begin >= VISIT_S for begin, end in own) for name, own in stays.items()}
    return {name: count for name, count in counted.items() if count}


def training_rows(found: TrainingFigures, path_mm: float, speed_mm_s: float, scale: float) -> list[dict[str, str]]:
    """Rows of a table: ``name``, ``value`` of this session, and what was published of ``novices`` and ``experts``.

    Args:
        found: the figures.
        path_mm, speed_mm_s: length of the tip's way, and median speed while it moved.
        scale: the kidney's; published ways are of kidneys of scale 1.
    """
    reachable = [c for c in found.calyces if c.verdict != OUT_OF_REACH]
    missed = found.missed
    took = list(found.inspected_s.values())
    again = sum(count - 1 for count in found.visits.values())
    plain = path_mm / scale
    at_anatomy = f" ({plain:.0f} mm at scale 1)" if scale != 1 else ""
    beside = "not of a whole kidney" if missed else _beside(plain)
    return [
        _row("path of the tip", f"{path_mm:.0f} mm{at_anatomy}: {beside}", _published(NOVICES_MM),
             _published(EXPERTS_MM)),
        _row("speed while moving, median", f"{speed_mm_s:.1f} mm/s"),
        _row("calyces inspected", f"{len(reachable) - len(missed)} of {len(reachable)} in reach"),
        _row("missed calyces", ", ".join(missed) or "none"),
        _row("visits", f"{sum(found.visits.values())} in {len(found.visits)} calyces, {again} of them again"),
        _row("from first sight of a calyx to inspected", f"{np.median(took):.1f} s, median of {len(took)}" if took
             else "none was inspected"),
    ]  # fmt: skip


def _row(name: str, value: str, novices: str = "", experts: str = "") -> dict[str, str]:
    return {"name": name, "value": value, "novices": novices, "experts": experts}


def _published(figure: tuple[float, float]) -> str:
    return f"{figure[0]:.0f} ± {figure[1]:.0f} mm"


def _beside(path_mm: float) -> str:
    """A path in words, beside the published ones."""
    (novice, its_sd), (expert, own_sd) = NOVICES_MM, EXPERTS_MM
    if path_mm < expert - own_sd:
        return "shorter than experts'"
    if path_mm <= expert + own_sd:
        return "as experts'"
    if path_mm < novice - its_sd:
        return "between experts' and novices'"
    return "as novices'" if path_mm <= novice + its_sd else "longer than novices'"


def calyx_training(found: TrainingFigures, calyx: str) -> dict[str, Any]:
    """What a page's row of a calyx says: ``visits`` and ``inspected`` after how long."""
    took = found.inspected_s.get(calyx)
    return {"visits": found.visits.get(calyx, 0), "inspected": "" if took is None else f"{took:.1f} s"}
