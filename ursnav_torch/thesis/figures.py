"""The experiment's figures, the thesis's printed value beside ours."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ursnav_torch.geometry import Array, angle_between
from ursnav_torch.registration import Confusion
from ursnav_torch.thesis.run import Outcome
from ursnav_torch.thesis.series import Matched


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure.

    Attributes:
        name: what it is, with its unit.
        printed: as the thesis prints it; "" where it does not.
        ours: the same of this run.
        where: table, figure or equation of the thesis; a note where there is none.
    """

    name: str
    printed: str
    ours: str
    where: str = ""


def compare_figures(outcome: Outcome) -> list[Figure]:
    """All figures of the thesis's chapter 5, and those that it could not have."""
    return [*_setting(outcome), *_registration(outcome), *_matching(outcome), *_judging(outcome), *_time(outcome)]


def _setting(o: Outcome) -> list[Figure]:
    kidney = o.vid.kidney
    return [
        Figure("scale of the phantom", "1.8", f"{kidney.scale:g}", "3.2.1"),
        Figure("calyces", "8", str(len(kidney.calyces)), "3.4"),
        Figure("views in the VID", "40", str(len(o.vid)), "3.4"),
        Figure("calyces reached by the robot", "8", str(len(set(o.drive.visited))), "3.4"),
    ]


def _registration(o: Outcome) -> list[Figure]:
    r, v, mm = o.registration, o.verdicts, f"mm at scale {o.vid.kidney.scale:g}"
    loo = "" if r.tre_loo_rmse_mm is None else f"{r.tre_loo_rmse_mm:.2f}"
    e = v.e_cam_mm
    return [
        Figure("landmarks touched", "8", str(r.n), "Table 5.1"),
        Figure(f"registration residual, {mm}", "5.20", f"{r.fre_rmse_mm:.2f}", "5.1"),
        Figure(f"leave-one-out error, {mm}", "", loo, "6.72 from its Table 5.1"),
        Figure(f"true error over the kidney, {mm}", "", f"{o.registration_error_mm:.2f}", "only a simulation knows"),
        Figure(f"e_cam, mean and deviation, {mm}", "13.70, 0.70", f"{e.mean():.2f}, {e.std(ddof=1):.2f}", "Table 5.2"),
        Figure(f"threshold of the EM sensor, {mm}", "15.10", f"{v.threshold_mm:.2f}", "Eq. 5.3"),
    ]


def _matching(o: Outcome) -> list[Figure]:
    found = [
        Figure("simulation pictures matched right", "22/24 = 92 %", share(o.simulation), "6.1.2"),
        Figure("phantom pictures matched right", "15/24 = 62 %", share(o.phantom), "6.1.2"),
    ]
    for series, name in ((o.simulation, "simulation"), (o.phantom, "phantom")):
        refused = sum(1 for row in series.rows if row.get("error"))
        found.append(Figure(f"{name} pictures with too few edges to match", "", f"{refused}/{len(series.rows)}"))
        if any(row.get("accepted") is False for row in series.rows):
            found.append(Figure(f"right among those that are sure, {name}", "", sure_share(series)))
        position, direction = pose_errors(series)
        if np.isfinite(position).any():
            ours = f"{np.nanmedian(position):.1f} mm, {np.degrees(np.nanmedian(direction)):.1f}°"
            name = f"median error of the pose, {name}, at scale {o.vid.kidney.scale:g}"
            found.append(Figure(name, "", ours, "only a simulation knows"))
    return found


def _judging(o: Outcome) -> list[Figure]:
    v, found = o.verdicts, o.verdicts.confusions()
    judged = int(v.judged.sum())
    position, both = found["position"], found["position_and_direction"]
    return [
        Figure(
            "judged right by the sensor's position", "16 of 24", f"{v.right_by_position.sum()} of {judged}", "6.1.2"
        ),
        Figure("  its TP, FN, FP, TN", "14, 1, 2, 7", counts(position), "Eq. 6.1"),
        Figure("  verdicts that agree with the truth", "21 of 24", agreement(position), "Eq. 6.1"),
        Figure("judged right by position and direction", "", f"{v.right.sum()} of {judged}", "ours"),
        Figure("  its TP, FN, FP, TN", "", counts(both), "ours"),
        Figure("  verdicts that agree with the truth", "", agreement(both), "ours"),
    ]


def _time(o: Outcome) -> list[Figure]:
    points, seconds = o.phantom.column("points"), o.phantom.column("seconds")
    return [
        Figure("edge points a phantom picture, median (range)", "", spread(points, "{:.0f}"), "Fig. 5.15, no numbers"),
        Figure("seconds a phantom picture, median (range)", "", spread(seconds, "{:.3f}"), "Fig. 5.24, no numbers"),
        Figure("R² of seconds against points", "0.98", r_squared_text(points, seconds), "Fig. 5.25"),
    ]


def share(series: Matched) -> str:
    """``22/24 = 92 %``."""
    right, whole = int(series.right.sum()), len(series.right)
    return f"{right}/{whole} = {100 * right / whole:.0f} %"


def sure_share(series: Matched) -> str:
    """How many of the accepted answers are right."""
    sure = np.array([row.get("accepted") is True for row in series.rows])
    right = int((series.right & sure).sum())
    return f"{right}/{sure.sum()}"


def pose_errors(series: Matched) -> tuple[Array, Array]:
    """(N,) distance in mm and angle in radians between the found and the true camera; NaN where nothing was found."""
    position, direction = np.full(len(series.rows), np.nan), np.full(len(series.rows), np.nan)
    for i, (location, T) in enumerate(zip(series.locations, series.pictures.T_kidney_camera, strict=True)):
        if location is not None:
            position[i] = np.linalg.norm(location.T_kidney_camera[:3, 3] - T[:3, 3])
            direction[i] = angle_between(location.T_kidney_camera[:3, 2], T[:3, 2])
    return position, direction


def counts(c: Confusion) -> str:
    """``14, 1, 2, 7``."""
    return f"{c.TP}, {c.FN}, {c.FP}, {c.TN}"


def agreement(c: Confusion) -> str:
    """``21 of 24``."""
    return f"{c.TP + c.TN} of {c.TP + c.FN + c.FP + c.TN}"


def spread(values: Array, form: str) -> str:
    """Median and range of the finite ones of values (N,)."""
    known = values[np.isfinite(values)]
    if not len(known):
        return "none"
    return f"{form} ({form} to {form})".format(np.median(known), known.min(), known.max())


def r_squared(x: Array, y: Array) -> float:
    """Coefficient of determination of the line through points (N,), (N,); NaN where x hardly varies."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if len(x) < 3 or np.ptp(x) < 0.2 * np.median(x) or np.ptp(y) == 0:
        return float("nan")
    return float(np.corrcoef(x, y)[0, 1] ** 2)


def r_squared_text(points: Array, seconds: Array) -> str:
    """R² of seconds (N,) against points (N,) of N pictures, or why there is none."""
    r2 = r_squared(points, seconds)
    if np.isfinite(r2):
        return f"{r2:.2f}"
    return "none: all pictures have about as many points" if np.isfinite(points).sum() > 2 else "none: too few pictures"


def beside_text(figures: list[Figure]) -> str:
    """The figures as a table for a terminal."""
    head = Figure("figure", "thesis", "ours", "thesis's place, or note")
    rows = [(f.name, f.printed or "-", f.ours or "-", f.where) for f in (head, *figures)]
    width = [max(len(row[k]) for row in rows) for k in range(4)]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "  ".join("-" * w for w in width), *lines[1:]])


def results(outcome: Outcome, figures: list[Figure], settings: dict[str, Any]) -> dict[str, Any]:
    """Everything as plain data, for ``results.json``."""
    o = outcome
    return {
        "scale": o.vid.kidney.scale,
        "kidney": o.vid.kidney.source,
        "settings": settings,
        "figures": [asdict(f) for f in figures],
        "simulation": _series(o.simulation),
        "phantom": _series(o.phantom),
        "r_squared": _plain(r_squared(o.phantom.column("points"), o.phantom.column("seconds"))),
        "confusion": {name: asdict(c) for name, c in o.verdicts.confusions().items()},
        "landmark_residuals_mm": o.registration.fre_mm.tolist(),
        "e_cam_mm": o.verdicts.e_cam_mm.tolist(),
        "threshold_mm": o.verdicts.threshold_mm,
    }


def _series(s: Matched) -> dict[str, Any]:
    position, direction = pose_errors(s)
    return {
        "right": int(s.right.sum()),
        "pictures": len(s.right),
        "refused": sum(1 for row in s.rows if row.get("error")),
        "median_position_mm": _plain(float(np.nanmedian(position)) if np.isfinite(position).any() else float("nan")),
        "median_direction_deg": _plain(
            float(np.degrees(np.nanmedian(direction))) if np.isfinite(direction).any() else float("nan")
        ),
        "seconds": [_plain(x) for x in s.column("seconds").tolist()],
        "points": [_plain(x) for x in s.column("points").tolist()],
    }


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None
