"""Large view databases: a first look at all views by one table, a second at the few that are left by full costs.

The table lies in a file and is mapped into memory, so that opening takes no time and only what a query touches is
read. See `occupancy` for how views are scored.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching.directions import estimate_directions
from ursnav_torch.matching.matcher import Matcher, Matching
from ursnav_torch.matching.occupancy import MOST_POINTS, Occupancy, best_sums, fill, table_rows
from ursnav_torch.threads import map_chunks

_FORMAT = "ursnav screen 1"
#: Views filled in at once while building.
_VIEWS_A_CHUNK = 500
#: Views scored at once by one thread.
_COLUMNS_A_CHUNK = 50_000


def build_screen(
    path: Path,
    points: Tensor,
    mask: Tensor,
    direction: Tensor | None = None,
    settings: Occupancy | None = None,
) -> Path:
    """Write the screen of V views to a file, which appears under its name only when it is whole.

    Args:
        path: a .safetensors file; an older one there is replaced.
        points: (V, P, 2) px.
        mask: (V, P) bool, true where there is a point.
        direction: (V, P) edge direction in radians, modulo pi; estimated from the points where left out.
        settings: bins and search; a grid around all points where left out.

    Size is V (cells^2 orientations + 13 P) bytes: 0.5 GB for 100,000 views of 100 points.
    """
    if points.ndim != 3 or points.shape[2] != 2 or mask.shape != points.shape[:2]:
        raise ShapeError(
            f"Expected points (V, P, 2) and mask (V, P), got {tuple(points.shape)} and {tuple(mask.shape)}."
        )
    settings = settings or _around(points, mask)
    points = points.float().contiguous()
    if direction is None:
        direction = estimate_directions(points, mask)
    table = np.empty((settings.bins, len(points)), np.uint8)

    def work(part: slice) -> None:
        table[:, part] = fill(points[part], mask[part], direction[part], settings)

    map_chunks(work, len(points), _VIEWS_A_CHUNK, float(len(points)) * settings.bins * 30)
    tensors = {
        "table": torch.from_numpy(table),
        "chance": torch.from_numpy(table.mean(0, dtype=np.float32)),
        "points": points,
        "mask": mask.contiguous(),
        "direction": direction.float().contiguous(),
    }
    partial = path.with_name(path.name + ".partial")
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file(tensors, partial, {"format": _FORMAT, "settings": json.dumps(asdict(settings))})
    partial.replace(path)
    return path


class Screen:
    """An opened screen: `shortlist` names the views worth a second look, `matcher` takes it.

    Args:
        path: a file that `build_screen` wrote.

    Raises:
        InputError: no such file, or not a whole screen.
    """

    def __init__(self, path: Path) -> None:
        try:
            with safe_open(path, framework="pt") as file:
                told = file.metadata() or {}
                tensors = {name: file.get_tensor(name) for name in file.keys()}
        except (OSError, SafetensorError) as error:
            raise InputError(f"{path} cannot be opened as a screen ({error}); build it again.") from None
        if told.get("format") != _FORMAT:
            raise InputError(f"{path} has the format {told.get('format')!r}, expected {_FORMAT!r}; build it again.")
        settings: dict[str, Any] = json.loads(told["settings"])
        tuples: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
        self.settings = Occupancy(**tuples)
        self.points, self.mask, self.direction = (tensors[k] for k in ("points", "mask", "direction"))
        self._table, self._chance = tensors["table"].numpy(), tensors["chance"].numpy()

    def __len__(self) -> int:
        return len(self.points)

    def scores(self, points: Tensor, direction: Tensor | None = None) -> NDArray[np.float32]:
        """Score (V,) of every view, higher is likelier, for a query's points (N, 2) px and directions (N,).

        A point is worth 1 in a cell and direction where the view has an edge and 1/2 beside it, less what chance
        gives.
        """
        if not len(points):
            return np.zeros(len(self), np.float32)
        points, direction = _with_direction(points, direction)
        kept = torch.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().long()
        rows = table_rows(points[kept], direction[kept], self.settings)
        out = np.empty(len(self), np.float32)

        def work(part: slice) -> None:
            out[part] = best_sums(self._table, rows, part)

        map_chunks(work, len(self), _COLUMNS_A_CHUNK, float(rows.size) * len(self))
        return (out - rows.shape[1] * self._chance) / 2

    def shortlist(self, points: Tensor, direction: Tensor | None = None, count: int = 200) -> Tensor:
        """The `count` likeliest views (K,) int64, best first; arguments as for `scores`."""
        scores = self.scores(points, direction)
        count = min(count, len(scores))
        best = np.argpartition(-scores, count - 1)[:count] if count else np.zeros(0, np.int64)
        return torch.from_numpy(best[np.argsort(-scores[best], kind="stable")].astype(np.int64))

    def matcher(self, views: Tensor, settings: Matching | None = None) -> Matcher:
        """A `Matcher` of some views (K,), described now: 0.4 ms a view of 100 points."""
        return Matcher(self.points[views], self.mask[views], self.direction[views], settings)

    def nearest(
        self,
        points: Tensor,
        direction: Tensor | None = None,
        settings: Matching | None = None,
        count: int = 200,
    ) -> tuple[Tensor, Tensor]:
        """The `count` likeliest views (K,), nearest first, and their distances (K,) in full cost."""
        points, direction = _with_direction(points, direction)
        views = self.shortlist(points, direction, count)
        distances = self.matcher(views, settings).distances(points, direction)
        order = distances.argsort(stable=True)
        return views[order], distances[order]


def _with_direction(points: Tensor, direction: Tensor | None) -> tuple[Tensor, Tensor]:
    """A query's points (N, 2) and directions (N,), estimated if there are none."""
    points = points.float()
    if direction is None:
        direction = estimate_directions(points[None], torch.ones(1, len(points), dtype=torch.bool))[0]
    return points, direction


def _around(points: Tensor, mask: Tensor) -> Occupancy:
    """A grid around all points."""
    if not bool(mask.any()):
        raise InputError("No view has a point; there is nothing to screen.")
    low, high = points[mask].amin(0), points[mask].amax(0)
    high = torch.maximum(high, low + 1)
    return Occupancy((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
