"""The thesis's plots redone, as PNG bytes."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Plot

from ursnav_torch.geometry import Array
from ursnav_torch.thesis.figures import r_squared
from ursnav_torch.thesis.run import Outcome

_RIGHT, _WRONG, _LINE = "#2a7a3b", "#b3392f", "#d9a400"


def plot_registration(o: Outcome) -> bytes:
    """Fig. 5.1: the landmarks in the kidney frame, the touched ones carried over, and the residuals."""
    plot = Plot(figsize=(9, 3.8), layout="constrained")
    space = plot.add_subplot(1, 2, 1, projection="3d")
    model, touched = o.landmarks_kidney, o.registration.apply(o.landmarks_em)
    tree = o.vid.kidney.centerline.points_mm
    space.scatter(*tree.T, s=1, color="#bbbbbb", label="centerline")
    space.scatter(*model.T, color=_WRONG, label="on the model")
    space.scatter(*touched.T, color="#2f5fb3", marker="^", label="touched, after registration")
    for a, b in zip(model, touched, strict=True):
        space.plot(*np.stack([a, b]).T, color="#2f5fb3", lw=1)
    space.legend(fontsize=7, loc="upper left")
    space.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
    bars = plot.add_subplot(1, 2, 2)
    n = np.arange(1, len(model) + 1)
    bars.bar(n - 0.2, o.registration.fre_mm, 0.4, color="#2f5fb3", label="residual")
    bars.bar(n + 0.2, np.nan_to_num(o.registration.tre_loo_mm), 0.4, color="#9db7e0", label="left out of the fit")
    bars.axhline(o.registration.fre_rmse_mm, color="#2f5fb3", ls="--", lw=1, label="RMS of the residuals")
    bars.axhline(5.20, color=_LINE, ls="--", lw=1, label="RMS in the thesis, 5.20")
    bars.set(xlabel="landmark", ylabel=_mm(o), xticks=n)
    bars.legend(fontsize=7)
    return _png(plot)


def plot_points(o: Outcome) -> bytes:
    """Fig. 5.15: edge points of every phantom picture."""
    return _bars(o, o.phantom.column("points"), "edge points")


def plot_seconds(o: Outcome) -> bytes:
    """Fig. 5.24: time to locate every phantom picture."""
    return _bars(o, o.phantom.column("seconds"), "seconds")


def plot_time_against_points(o: Outcome) -> bytes:
    """Fig. 5.25: time against points, with the line of least squares where there is one."""
    plot = Plot(figsize=(5, 3.4), layout="constrained")
    ax = plot.add_subplot()
    for series, color in ((o.phantom, "#2f5fb3"), (o.simulation, "#aaaaaa")):
        ax.scatter(
            series.column("points"), series.column("seconds"), s=16, color=color, label=series.pictures.folder.name
        )
    x, y = o.phantom.column("points"), o.phantom.column("seconds")
    r2 = r_squared(x, y)
    if np.isfinite(r2):
        known = np.isfinite(x)
        slope, start = np.polyfit(x[known], y[known], 1)
        ends = np.array([x[known].min(), x[known].max()])
        ax.plot(ends, start + slope * ends, ":", color="#2f5fb3", label=f"phantom: R² = {r2:.2f} (thesis 0.98)")
    ax.set(xlabel="edge points", ylabel="seconds", ylim=(0, None))
    ax.legend(fontsize=8)
    return _png(plot)


def plot_distances(o: Outcome) -> bytes:
    """Fig. 5.26: distance of the sensor from the matched view, and the threshold."""
    plot, ax = _wide()
    _draw_bars(ax, o, o.verdicts.distance_mm)
    ax.axhline(o.verdicts.threshold_mm, color=_LINE, lw=2, label=f"threshold {o.verdicts.threshold_mm:.2f}")
    ax.axhline(15.10, color=_LINE, lw=1, ls=":", label="the thesis's threshold, 15.10")
    ax.set_ylabel(_mm(o))
    ax.legend(fontsize=8)
    return _png(plot)


def plot_directions(o: Outcome) -> bytes:
    """What the thesis's rule leaves out: angle between the sensor's axis and the matched view's optical axis."""
    angle = np.full(len(o.phantom.rows), np.nan)
    angle[o.verdicts.judged] = np.degrees(o.verdicts.comparison.angle_rad)
    return _bars(o, angle, "degrees")


def _bars(o: Outcome, values: Array, label: str) -> bytes:
    plot, ax = _wide()
    _draw_bars(ax, o, values)
    ax.set_ylabel(label)
    return _png(plot)


def _draw_bars(ax: Axes, o: Outcome, values: Array) -> None:
    n = np.arange(len(values))
    ax.bar(n, np.nan_to_num(values), color=np.where(o.phantom.right, _RIGHT, _WRONG))
    names = [name.removesuffix(".png") for name in o.phantom.pictures.names]
    ax.set_xticks(n, names, fontsize=7)
    ax.set_title("green: matched with the right calyx, red: not; no bar: no match", fontsize=8)


def _mm(o: Outcome) -> str:
    return f"mm at scale {o.vid.kidney.scale:g}"


def _wide() -> tuple[Plot, Axes]:
    plot = Plot(figsize=(9, 2.6), layout="constrained")
    return plot, plot.add_subplot()


def _png(plot: Plot) -> bytes:
    buffer = io.BytesIO()
    plot.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()
