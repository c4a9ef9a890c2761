import json
import re
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from ursnav_torch.devices import Frame, Stamp
from ursnav_torch.errors import InputError
from ursnav_torch.exploration.coverage import CalyxCoverage, Coverage
from ursnav_torch.features import EdgePoints, read_image
from ursnav_torch.files import no_progress
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import Kidney
from ursnav_torch.localization import Localizer
from ursnav_torch.reports import draw_edges, draw_overview
from ursnav_torch.reports.session import session_values
from ursnav_torch.runs.match import match_images
from ursnav_torch.session import Recorder, Replay, Result
from ursnav_torch.vid import Vid, pose_cells


class Page(HTMLParser):
    """Tags that are open, pictures that are named, text that is shown."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.pictures: list[str] = []
        self.shown: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            self.pictures.append(dict(attrs)["src"] or "")
        elif tag not in ("meta", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.shown.append(data)


@pytest.fixture(scope="module")
def page(vid: Vid, picture: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    (folder / "images").mkdir()
    cv2.imwrite(str(folder / "images" / "<b>&a ä.png"), picture)
    cv2.imwrite(str(folder / "images" / "black.png"), np.zeros_like(picture))
    (folder / "images" / "no.png").write_text("<script>")
    rows = match_images(
        Localizer(vid), str(folder / "images"), folder / "rows.csv", folder / "page", False, no_progress
    )
    assert [bool(row.get("error")) for row in rows] == [False, True, True]
    return folder / "page"


def test_the_page_shows_every_picture_and_names_each_file_it_has(page: Path) -> None:
    seen = Page((page / "index.html").read_text(encoding="utf-8"))
    assert not seen.open, "every tag is closed"
    assert sorted(set(seen.pictures)) == sorted(p.name for p in page.glob("*.jpg"))
    text = " ".join(seen.shown)
    assert "<b>&a ä.png" in text and "all black" in text and "not a readable picture" in text
    assert "next 4 candidates" in text and "not a medical device" in text
    assert len(seen.pictures) == 10 + 1 + 2, "picture, edges, view, its edges, place twice, four others; the black one"
    assert str(page.parent) not in text and ".partial" not in text, "no folder that moves or is gone is named"
    for name in seen.pictures:
        assert read_image(page / name).size


def test_the_page_needs_nothing_from_elsewhere(page: Path) -> None:
    text = (page / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=\"(?!#)[^\"]*[:/]", text) and "<script" not in text


def test_a_page_is_whole_or_absent(vid: Vid, tmp_path: Path, picture: np.ndarray) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "mine").touch()
    with pytest.raises(InputError, match="exists already"):
        match_images(Localizer(vid), str(tmp_path / "a.png"), tmp_path / "x.csv", tmp_path / "page", False, no_progress)
    assert [p.name for p in (tmp_path / "page").iterdir()] == ["mine"] and not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize("from_side", [False, True])
def test_the_overview_is_where_it_says(phantom: Kidney, from_side: bool) -> None:
    overview = draw_overview(phantom, 200, from_side)
    at = overview.project(phantom.tips_mm)
    assert ((at > 0) & (at < 200)).all()
    x, y = np.rint(at).astype(int).T
    for px, py in zip(x, y, strict=True):
        assert overview.picture[py, px].max() < 120, "a dark dot at every tip"
    corners = overview.picture[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert (corners == 255).all()
    inside = np.rint(overview.project(phantom.pelvis_mm[None]))[0].astype(int)
    assert overview.picture[inside[1], inside[0]].min() < 250
    R = overview.T_view_kidney[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1), "not mirrored"


def test_a_camera_is_drawn_at_its_place_looking_its_way(phantom: Kidney) -> None:
    overview = draw_overview(phantom, 300)
    right = overview.T_view_kidney[0, :3]  # the kidney's direction that is right in the picture
    T = look_along(phantom.pelvis_mm, right)
    drawn = overview.with_camera(T, 90.0, 12.0)
    changed = np.argwhere((drawn != overview.picture).any(2))[:, ::-1]
    tip = overview.project(phantom.pelvis_mm[None])[0]
    assert np.abs(changed - tip).min(0).max() < 3, "something is drawn at the tip"
    assert (changed.mean(0) - tip)[0] > 2, "and mostly to where it looks"
    np.testing.assert_array_equal(drawn.shape, overview.picture.shape)


def test_edges_are_strokes_along_the_edge() -> None:
    edges = EdgePoints(torch.tensor([[30.0, 20.0]]), torch.tensor([0.0]), torch.ones(1))
    blank = np.zeros((40, 60), np.uint8)
    drawn = draw_edges(blank, edges, (0, 255, 0))
    y, x = np.nonzero(drawn[..., 1])
    assert np.ptp(x) in (6, 7) and np.ptp(y) <= 2 and abs(x.mean() - 30) < 1 and not blank.any()


def record(folder: Path, picture: np.ndarray, row: dict[str, Any], count: int, apart_s: float) -> None:
    """A session of so many pictures (h, w), so far apart, that were all answered alike."""
    with Recorder(folder) as recorder:
        for i in range(count):
            stamp = Stamp(i, i * apart_s, i * apart_s)
            recorder.write(Frame(stamp, picture))
            recorder.write(Result(stamp, i, row | {"t_s": i * apart_s}))


def test_the_session_report_tells_and_draws_the_verdicts_that_navigation_told(
    vid: Vid, picture: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It knew what stood before the wall, and painted with it; three pictures alone inspect nothing."""
    told, drawn = json.dumps({c.name: ["inspected", 0.9] for c in vid.kidney.calyces}), list[CalyxCoverage]()
    row = {"state": "tracking", "accepted": True, "calyx": "A", "confidence": 1.0, "coverage": told}
    row |= pose_cells(vid.T_kidney_camera[3:4])[0]
    record(tmp_path / "record", picture, row, 3, 0.1)

    def draw(coverage: Coverage, calyces: Sequence[CalyxCoverage] = ()) -> np.ndarray:
        drawn.extend(calyces)
        return picture

    monkeypatch.setattr("ursnav_torch.reports.session.draw_coverage", draw)
    page = session_values(vid, Replay(tmp_path / "record", speed=0))
    assert [c["verdict"] for c in page["calyces"]] == ["inspected"] * 6 == [c.verdict for c in drawn]
    assert {"calyces inspected", "6 of 6 in reach"} <= {word for words in page["training"] for word in words.values()}


@pytest.mark.parametrize(("sd_mm", "counts"), [(None, True), (0.3, True), (1.5, False)])
def test_the_session_report_paints_wall_only_where_places_were_sure(
    vid: Vid, picture: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sd_mm: float | None, counts: bool
) -> None:
    painted: list[bool] = []
    row = {"state": "tracking", "accepted": True, "calyx": "A", "confidence": 1.0}
    row |= pose_cells(vid.T_kidney_camera[3:4])[0]
    row |= {} if sd_mm is None else {"position_sd_mm": sd_mm}
    record(tmp_path / "record", picture, row, 6, 0.2)

    def draw(coverage: Coverage, calyces: Sequence[CalyxCoverage] = ()) -> np.ndarray:
        painted.append(bool(coverage.seen().any()))
        return picture

    monkeypatch.setattr("ursnav_torch.reports.session.draw_coverage", draw)
    session_values(vid, Replay(tmp_path / "record", speed=0))
    assert painted == [counts]
