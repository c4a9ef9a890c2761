"""The matrix of calyces that look alike, as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ursnav_torch.localization import LookAlikes
from ursnav_torch.vid import Vid


def report_look_alikes(vid: Vid) -> list[str]:
    """Sentences on calyces that look alike; their matrix goes to ``look_alikes.png`` in the VID's folder.

    A VID without calibration knows of none.
    """
    known = (vid.calibration or {}).get("look_alikes")
    if not isinstance(known, Mapping):
        return []
    look_alikes, names = LookAlikes.from_dict(known), [c.name for c in vid.kidney.calyces]
    draw_look_alikes(look_alikes, names, vid.folder / "look_alikes.png")
    return look_alikes.sentences(names)


def draw_look_alikes(look_alikes: LookAlikes, names: Sequence[str], path: Path) -> None:
    """Write the matrix as a PNG: rows what is shown, columns what it was taken for, in percent of the row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # here, so that `match` starts without it
    from matplotlib.figure import Figure

    labels = [*names, "(no calyx)"]
    share = 100 * look_alikes.counts / np.maximum(look_alikes.counts.sum(axis=1, keepdims=True), 1)
    size = 1.6 + 0.55 * len(labels)
    figure = Figure(figsize=(size + 1.0, size), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.imshow(share, vmin=0, vmax=100, cmap="Blues")
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    axes.set_xlabel("taken for")
    axes.set_ylabel("shown")
    axes.set_title("Simulated pictures, % of the row")
    for (row, column), value in np.ndenumerate(share):
        if value >= 0.5:
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", color="white" if value > 55 else "black")
    figure.savefig(path, dpi=110)
