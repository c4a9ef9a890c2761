"""The HTML page of a `match` run: for each picture what was seen, what it was matched with, and where that is."""

import html
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features import EdgePoints, read_image
from ursnav_torch.files import write_image
from ursnav_torch.localization import Location
from ursnav_torch.reports.overview import Overview, draw_overview
from ursnav_torch.vid import Vid

Picture = NDArray[np.uint8]

_GREEN, _ORANGE = (60, 230, 60), (40, 160, 255)
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1180px;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.25em .7em;border-bottom:1px solid #ddd;text-align:left}
figure{display:inline-block;margin:0 .6em .6em 0;vertical-align:top}figcaption{font-size:13px;color:#555}
article{border-top:2px solid #888;padding:.6em 0 1em}img{display:block}
.no{color:#a33}.unsure{color:#96640a}.yes{color:#17691f}
details{margin:.3em 0}footer{color:#666;border-top:1px solid #ccc;margin-top:2em}
"""


@dataclass
class MatchReport:
    """Writes ``index.html`` and its pictures into a folder.

    Args:
        folder: where to write; it exists.
        vid: what was searched.
        title: headline.
        entries: HTML of every picture, its ``row`` of the table and its ``article``.
    """

    folder: Path
    vid: Vid
    title: str = "Where these pictures were taken"
    entries: list[dict[str, str]] = field(default_factory=list)
    _outlook: tuple[Overview, Overview] | None = None

    def add(
        self, row: dict[str, Any], location: Location | None, image: Picture | None, truth: str | None = None
    ) -> None:
        """One picture: its row of the CSV, its location (None when there is an error) and itself."""
        number, name = len(self.entries), html.escape(str(row["image"]))
        answer = _answer(location)
        cells = "" if truth is None else f"<td>{html.escape(truth) or '(none)'}</td>"
        detail = f"{location.confidence:.0%}" if location else html.escape(str(row.get("error", "")))
        line = f'<tr><td><a href="#p{number}">{name}</a></td><td>{answer}</td>{cells}<td>{detail}</td></tr>'
        figures = [] if image is None else [self._figure(image, f"{number}_image", "picture")]
        if location is not None and image is not None:
            figures += self._location_figures(number, image, location)
        article = f'<article id="p{number}"><h3>{name}: {answer}</h3>{"".join(figures)}</article>'
        self.entries.append({"row": line, "article": article})

    def finish(self, summary: str) -> Path:
        """Write the page; ``summary`` is a paragraph below the headline."""
        head = "<tr><th>picture</th><th>calyx</th>" + ("<th>truth</th>" if "</td><td>" in self._truths() else "")
        rows, articles = ("".join(entry[part] for entry in self.entries) for part in ("row", "article"))
        page = (
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(self.title)}</title>'
            f"<style>{_STYLE}</style><h1>{html.escape(self.title)}</h1><p>{html.escape(summary)}</p>"
            f"<table>{head}<th>confidence</th></tr>{rows}</table>{articles}"
            "<footer>Edges are green in the picture, orange in the view. Camera axes: x red, y green, z (viewing "
            "direction) blue. Research software, not a medical device.</footer></html>"
        )
        path = self.folder / "index.html"
        path.write_text(page, encoding="utf-8")
        return path

    def _truths(self) -> str:
        return "</td><td>" if self.entries and self.entries[0]["row"].count("<td>") == 4 else ""

    def _location_figures(self, number: int, image: Picture, location: Location) -> list[str]:
        best, *others = location.candidates
        edges = draw_edges(image, location.features.edges, _GREEN)
        figures = [
            self._figure(edges, f"{number}_edges", f"its {len(location.features.edges)} edge points"),
            self._figure(self._view(best.view), f"{number}_view", f"best view: {best.view}, {self._name(best.view)}"),
            self._figure(
                self._view_edges(best.view), f"{number}_view_edges", f"its edges; distance {best.distance:.3f}"
            ),
        ]
        for k, overview in enumerate(self._overviews()):
            fov = self.vid.camera.fov_deg or 90.0
            drawn = overview.with_camera(location.T_kidney_camera, fov)
            figures.append(self._figure(drawn, f"{number}_place{k}", "place, from the side" if k else "place"))
        more = "".join(
            self._figure(self._view(c.view), f"{number}_other{k}", f"{c.view}, {self._name(c.view)}: {c.distance:.3f}")
            for k, c in enumerate(others)
        )
        return [*figures, f"<details><summary>next {len(others)} candidates</summary>{more}</details>"]

    def _figure(self, picture: Picture, name: str, caption: str) -> str:
        file = f"{name}.jpg"
        write_image(self.folder / file, picture, 88)
        return (
            f'<figure><img src="{file}" loading="lazy" alt="{html.escape(caption)}">'
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        )

    def _overviews(self) -> tuple[Overview, Overview]:
        if self._outlook is None:
            kidney = self.vid.kidney
            self._outlook = draw_overview(kidney), draw_overview(kidney, from_side=True)
        return self._outlook

    def _name(self, view: int) -> str:
        return self.vid.calyx_name(int(self.vid.calyx[view])) or "passage"

    def _view(self, view: int) -> Picture:
        return read_image(self.vid.image_path(view))

    def _view_edges(self, view: int) -> Picture:
        f, mask = self.vid.features, self.vid.features.mask[view]
        edges = EdgePoints(f.points[view][mask], f.direction[view][mask], f.weight[view][mask])
        return draw_edges(self._view(view), edges, _ORANGE)


def draw_edges(image: Picture, edges: EdgePoints, color: tuple[int, int, int]) -> Picture:
    """A copy of a picture with its edge points as short strokes along the edge."""
    out = image.copy() if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    along = np.stack([np.cos(edges.direction.numpy()), np.sin(edges.direction.numpy())], axis=1)
    for p, d in zip(edges.points.numpy(), along, strict=True):
        a, b = np.rint(p - 3 * d).astype(int), np.rint(p + 3 * d).astype(int)
        cv2.line(out, a.tolist(), b.tolist(), color, 1, cv2.LINE_AA)
    return np.asarray(out, np.uint8)


def _answer(location: Location | None) -> str:
    if location is None:
        return '<span class="no">not located</span>'
    name = html.escape(location.calyx_name) or "no calyx (passage)"
    return (
        f'<span class="yes">{name}</span>'
        if location.accepted
        else f'<span class="unsure">unsure, perhaps {name}</span>'
    )
