"""The HTML page of a `match` run: for each picture what was seen, what it was matched with, and where that is."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features import EdgePoints
from ursnav_torch.files import write_image
from ursnav_torch.localization import Location
from ursnav_torch.reports.html import render_page
from ursnav_torch.reports.match_words import answer_words, filters_of, summary_words
from ursnav_torch.reports.overview import Overview, draw_overview
from ursnav_torch.vid import Vid

Picture = NDArray[np.uint8]
Figure = dict[str, str]

_GREEN, _ORANGE = (60, 230, 60), (40, 160, 255)


@dataclass
class MatchReport:
    """Writes ``index.html`` and its pictures into a folder.

    Args:
        folder: where to write; it exists.
        vid: what was searched.
        title: headline.
        entries: plain data of every picture: what `answer_words` gives, its ``figures``, and ``others`` (the next
            candidates), each a ``file`` in the folder and a ``caption``.
    """

    folder: Path
    vid: Vid
    title: str = "Where these pictures were taken"
    entries: list[dict[str, Any]] = field(default_factory=list)
    _outlook: tuple[Overview, Overview] | None = None

    def add(
        self, row: dict[str, Any], location: Location | None, image: Picture | None, truth: str | None = None
    ) -> None:
        """One picture: its row of the CSV, its location (None when there is an error) and itself, (H, W) or (H, W, 3).

        ``truth`` is the true calyx's name, blank for a picture of none, None where it is not known.
        """
        number = len(self.entries)
        figures = [] if image is None else [self._figure(image, f"{number}_image", "picture")]
        others: list[Figure] = []
        if location is not None and image is not None:
            figures += self._location_figures(number, image, location)
            others = self._candidate_figures(number, location)
        self.entries.append(answer_words(row, truth) | {"figures": figures, "others": others})

    def finish(self, searched: str) -> Path:
        """Write the page; ``searched`` is the summary's first sentence: which pictures, in what."""
        names = [c.name for c in self.vid.kidney.calyces]
        groups = {"": "passage", **{name: f"c{i}" for i, name in enumerate(names)}}
        entries = [e | {"group": groups.get(e["calyx"], "other") if e["located"] else ""} for e in self.entries]
        page = render_page(
            "matches.html.j2",
            title=self.title,
            summary=f"{searched} {summary_words(entries)}",
            filters=filters_of(entries, groups),
            entries=entries,
            has_truth=any(e["truth_words"] for e in entries),
            has_sets=any(e["calyces"] for e in entries),
        )
        path = self.folder / "index.html"
        path.write_text(page, encoding="utf-8")
        return path

    def _location_figures(self, number: int, image: Picture, location: Location) -> list[Figure]:
        best = location.candidates[0]
        edges = draw_edges(image, location.features.edges, _GREEN)
        figures = [
            self._figure(edges, f"{number}_edges", f"its {len(location.features.edges)} edge points"),
            self._figure(self._view(best.view), f"{number}_view", f"best view: {best.view}, {self._name(best.view)}"),
            self._figure(
                self._view_edges(best.view), f"{number}_view_edges", f"its edges; distance {best.distance:.3f}"
            ),
        ]
        for k, overview in enumerate(self._overviews()):
            drawn = overview.with_camera(location.T_kidney_camera, self.vid.camera.fov_deg or 90.0)
            figures.append(self._figure(drawn, f"{number}_place{k}", "place, from the side" if k else "place"))
        return figures

    def _candidate_figures(self, number: int, location: Location) -> list[Figure]:
        return [
            self._figure(self._view(c.view), f"{number}_other{k}", f"{c.view}, {self._name(c.view)}: {c.distance:.3f}")
            for k, c in enumerate(location.candidates[1:])
        ]

    def _figure(self, picture: Picture, name: str, caption: str) -> Figure:
        file = f"{name}.jpg"
        write_image(self.folder / file, picture, 88)
        return {"file": file, "caption": caption}

    def _overviews(self) -> tuple[Overview, Overview]:
        if self._outlook is None:
            kidney = self.vid.kidney
            self._outlook = draw_overview(kidney), draw_overview(kidney, from_side=True)
        return self._outlook

    def _name(self, view: int) -> str:
        return self.vid.calyx_name(int(self.vid.calyx[view])) or "passage"

    def _view(self, view: int) -> Picture:
        return self.vid.read_picture(view)

    def _view_edges(self, view: int) -> Picture:
        f, mask = self.vid.features, self.vid.features.mask[view]
        edges = EdgePoints(f.points[view][mask], f.direction[view][mask], f.weight[view][mask])
        return draw_edges(self._view(view), edges, _ORANGE)


def draw_edges(image: Picture, edges: EdgePoints, color: tuple[int, int, int]) -> Picture:
    """A copy of a picture (H, W) or (H, W, 3) with its edge points as short strokes along the edge."""
    out = image.copy() if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    along = np.stack([np.cos(edges.direction.numpy()), np.sin(edges.direction.numpy())], axis=1)
    for p, d in zip(edges.points.numpy(), along, strict=True):
        a, b = np.rint(p - 3 * d).astype(int), np.rint(p + 3 * d).astype(int)
        cv2.line(out, a.tolist(), b.tolist(), color, 1, cv2.LINE_AA)
    return np.asarray(out, np.uint8)
