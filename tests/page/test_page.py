"""The page without a browser: who may reach it, its words and pictures, what is collected on it."""

import base64
import csv
import http.client
import itertools
import json
import re
import threading
import time
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import torch

from ursnav_torch.devices import Frame, Stamp
from ursnav_torch.errors import InputError
from ursnav_torch.exploration.coverage import INSPECTED, CalyxCoverage
from ursnav_torch.features import EdgePoints
from ursnav_torch.kidney import read_calyces
from ursnav_torch.navigation import Guidance, NavigationState, Navigator, run_navigation
from ursnav_torch.page import ExplorePage, LivePage, PagePictures, check_address, web_page
from ursnav_torch.page.collected import FLIGHT, Collection, fly, pick_wall
from ursnav_torch.page.live import state_values, timeline
from ursnav_torch.page.scene import edge_strokes, kidney_bytes, path_pieces, stone_rows
from ursnav_torch.rendering import RayScene
from ursnav_torch.reports.session import session_figures, write_comparison, write_session_report
from ursnav_torch.reports.stones import StonesTold
from ursnav_torch.session import Recorder, Replay, SessionControls
from ursnav_torch.stones import FoundStone, StoneList
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import PlanSettings, read_views

pytest.importorskip("uvicorn")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.org", ""])
def test_other_computers_are_kept_out_and_told_how_to_tunnel(host):
    with pytest.raises(InputError, match=r"no password.*ssh -L 8080:127\.0\.0\.1:8080"):
        check_address(host, 8080)


def test_a_port_that_is_taken_is_refused(vid):
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match=r"cannot be had.*viewer\.port="):
            check_address("127.0.0.1", taken.getsockname()[1])


def test_a_state_is_plain_and_says_its_confidence_in_words():
    rows = (CalyxCoverage("A <b>", "upper", INSPECTED, 0.5, 1.0, 1.0),)
    known = NavigationState(T_kidney_camera=np.eye(4), confidence=0.95, guidance=Guidance(coverage=rows))
    found = json.loads(json.dumps(state_values(known, 12.34)))
    assert found["words"] == "sure" and found["coverage"] == [["A <b>", "upper", "inspected", 0.5]]
    assert found["pose"] == np.eye(4).ravel().tolist() and "12.3 poses a second" in found["latency"]
    lost = state_values(replace(known, T_kidney_camera=None), 0.0)
    assert (lost["pose"], lost["confidence"], lost["words"]) == (None, 0.0, "no place known")


def test_the_kidney_arrives_as_it_is(phantom):
    patch = np.arange(len(phantom.mesh.faces))
    data = kidney_bytes(phantom, patch)
    end = data.index(b"\n") + 1
    about = json.loads(data[:end])
    assert end % 4 == 0 and [c["name"] for c in about["calyces"]] == [c.name for c in phantom.calyces]
    n, m = 3 * about["vertices"], 3 * about["faces"]
    vertices = np.frombuffer(data, "<f4", n, end).reshape(-1, 3)
    faces = np.frombuffer(data, "<u4", m, end + 4 * n).reshape(-1, 3)
    of_vertex = np.frombuffer(data, "<i4", about["vertices"], end + 4 * n + 4 * m)
    assert len(data) == end + 4 * (n + m + about["vertices"])
    np.testing.assert_allclose(vertices, phantom.mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(faces, phantom.mesh.faces)
    assert all(v in phantom.mesh.faces[of_vertex[v]] for v in range(0, about["vertices"], 97))
    assert (np.frombuffer(kidney_bytes(phantom), "<i4", about["vertices"], end + 4 * n + 4 * m) == -1).all()


def test_a_path_is_parted_at_jumps_and_edges_are_strokes_along_them():
    path = np.array([[0, 0, 0], [1, 0, 0], [9, 0, 0], [10, 0, 0], [11, 0, 0]], float)
    assert [len(piece) for piece in path_pieces(path, 1.0)] == [2, 3]
    assert [len(piece) for piece in path_pieces(path, 2.0)] == [5]
    assert path_pieces(np.zeros((0, 3)), 1.0) == [] and edge_strokes(None) == []
    upright = EdgePoints(torch.tensor([[10.0, 20.0]]), torch.tensor([np.pi / 2]), torch.ones(1))
    np.testing.assert_allclose(edge_strokes(upright), [[10, 17, 10, 23]], atol=0.1)


def found_stones(*states):
    """Stones in the first calyx and outside of all, by turns; the first is known from the scan."""
    seen = [
        FoundStone(i + 1, -(i % 2), np.array([1.0, 2.0, 3.004 + i]), np.eye(3), 6.14, 0.58, 9, 0.99, state, i)
        for i, state in enumerate(states)
    ]
    return StoneList(tuple(seen), ("S1", *[""] * (len(seen) - 1)), (), True)


def test_stones_are_plain_rows_with_their_calyx_and_place(phantom):
    rows = json.loads(json.dumps(stone_rows(found_stones("there", "gone"), phantom)))
    first = {"number": 1, "calyx": "A", "size": 6.1, "sd": 0.6, "state": "there", "known": "S1", "at": [1.0, 2.0, 3.0]}
    assert rows[0] == first and (rows[1]["calyx"], rows[1]["state"], rows[1]["known"]) == ("", "gone", "")


def test_stones_are_sent_when_they_change(vid, phantom_lumen, monkeypatch):
    page = LivePage(Navigator(Tracker(vid)), SessionControls(lambda: None), port=0)
    try:
        server = Mock()
        monkeypatch.setattr(page, "server", server)
        monkeypatch.setattr(page, "_due", lambda *given: True)
        one, two = (NavigationState(guidance=Guidance(stones=found_stones(*["there"] * n))) for n in (1, 2))
        for state in (NavigationState(), one, one, two):
            page._show_ways(state)
        sent = [c.kwargs["stones"] for c in server.publish.call_args_list if c.args[0] == "stones"]
        assert [len(stones) for stones in sent] == [1, 2]
        monkeypatch.undo()
    finally:
        page.close()


def test_the_report_says_and_shows_the_stones(vid, record, tmp_path):
    picture = np.full((20, 40, 3), 200, np.uint8)
    told = StonesTold(("1 stone in the lower pole: 6.1 ± 0.6 mm in <F>.",), picture)
    text = write_session_report(vid, Replay(record, speed=0), tmp_path / "report.html", told).read_text("utf-8")
    assert "<li>1 stone in the lower pole: 6.1 ± 0.6 mm in &lt;F&gt;.</li>" in text and "<h2>Stones</h2>" in text
    without = write_session_report(vid, Replay(record, speed=0), tmp_path / "none.html").read_text("utf-8")
    assert "<h2>Stones</h2>" not in without and text.count("<img ") == without.count("<img ") + 1


def test_convention_the_virtual_picture_stands_as_the_scopes_does(vid, renderer):
    """The same pose gives the same picture on both sides, not mirrored, not turned."""
    image = renderer.render(vid.T_kidney_camera[3]).image
    virtual = PagePictures(vid).virtual(vid.T_kidney_camera[3]).astype(float).mean(axis=2)
    shown = cv2.resize(image, virtual.shape[::-1]).astype(float)

    def alike(a, b):
        return np.corrcoef(a.ravel(), b.ravel())[0, 1]

    assert alike(shown, virtual) > 0.98
    assert max(alike(shown, turned) for turned in (virtual[::-1], virtual[:, ::-1], np.rot90(virtual))) < 0.97


def test_every_calyx_has_a_thumbnail(vid):
    pictures = PagePictures(vid)
    shown = [pictures.thumbnail(i) for i in range(len(vid.kidney.calyces))]
    assert all(picture.shape == (125, 125, 3) and picture.std() > 5 for picture in shown)
    assert not any(np.array_equal(a, b) for a, b in itertools.pairwise(shown))


def test_flying_keeps_off_the_wall_and_what_is_flown_can_be_flown_back(vid, phantom_lumen):
    T = vid.T_kidney_camera[3]
    for move, back in (("forward", "back"), ("look left", "look right"), ("look up", "look down"),
                       ("roll left", "roll right")):  # fmt: skip
        there = fly(T, move, phantom_lumen, 0.2, 0.1, 1.0)
        assert np.allclose(fly(there, back, phantom_lumen, 0.2, 0.1, 1.0), T, atol=1e-9)
    for _ in range(200):
        T = fly(T, "forward", phantom_lumen, 0.5, 0.1, 1.0)
    assert phantom_lumen.clearance_mm(T[None, :3, 3])[0] >= 0.5
    with pytest.raises(InputError, match="no move 'fly away'"):
        fly(T, "fly away", phantom_lumen, 1.0, 1.0, 1.0)
    assert len(FLIGHT) == 8


def test_convention_looking_right_moves_the_picture_left(vid, phantom_lumen):
    """x is to the right and y down in the picture."""
    T = vid.T_kidney_camera[3]
    assert fly(T, "look right", phantom_lumen, 0.2, 0.1, 1.0)[:3, 2] @ T[:3, 0] > 0
    assert fly(T, "look up", phantom_lumen, 0.2, 0.1, 1.0)[:3, 2] @ T[:3, 1] < 0


def test_landmarks_are_picked_where_the_ray_meets_the_wall_first(phantom):
    scene, center = RayScene(phantom.mesh), phantom.pelvis_mm
    origin = center + np.array([0.0, 0.0, 200.0])
    place = pick_wall(scene, origin, center - origin)
    assert place is not None and np.linalg.norm(origin - place) < 200
    assert abs(phantom.mesh.nearest.on_surface(place[None])[1][0]) < 1e-3
    assert pick_wall(scene, origin, np.array([0, 0, 1.0])) is None


def test_what_was_collected_is_what_build_vid_reads(vid, renderer, phantom_lumen, tmp_path):
    kept = Collection(vid.kidney)
    kept.rename("A", "oberer Kelch, ä")
    kept.T_kidney_camera += [vid.T_kidney_camera[3], vid.T_kidney_camera[20]]
    kept.landmarks_mm.append(vid.kidney.tips_mm[0])
    said = kept.save(tmp_path / "my views", renderer, phantom_lumen, False)
    assert "2 views, 6 names, 1 landmarks" in said
    views = read_views(tmp_path / "my views")
    assert np.allclose(views.T_kidney_camera, vid.T_kidney_camera[[3, 20]], atol=1e-5)
    assert len(views.plan(kept.kidney, phantom_lumen).calyx) == 2
    calyces, pelvis = read_calyces(tmp_path / "my views" / "calyces.csv")
    assert calyces[0].name == "oberer Kelch, ä" and pelvis is not None
    assert (tmp_path / "my views" / "landmarks.csv").read_text(encoding="utf-8").count("\n") == 2
    with pytest.raises(InputError, match="exists already"):
        kept.save(tmp_path / "my views", renderer, phantom_lumen, False)


@pytest.mark.parametrize("name", ["", "  ", "B", "pelvis", "Pelvis", "none", "x" * 41, "a\nb", "../a", "a|b"])
def test_a_name_that_would_confuse_is_refused(phantom, name):
    with pytest.raises(InputError, match="cannot be called"):
        Collection(phantom).rename("A", name)


def test_views_are_planned_again(phantom, phantom_lumen):
    kept = Collection(phantom)
    assert kept.plan(PlanSettings(views_per_calyx=3, passage_views=3), phantom_lumen) == len(kept.T_kidney_camera) > 18


@pytest.fixture(scope="module")
def record(vid, renderer, tmp_path_factory):
    """Six seconds in front of two calyces and one dark moment, navigated and recorded."""
    folder = tmp_path_factory.mktemp("page")
    with Recorder(folder / "raw") as recorder:
        for i in range(60):
            view = np.flatnonzero(vid.calyx == (0 if i < 40 else 1))[2]
            T = vid.T_kidney_camera[view].copy()
            T[:3, 3] += 0.8 * np.sin(i / 4) * T[:3, 2]
            image = renderer.render(T).image if not 28 <= i < 40 else np.zeros((96, 96), np.uint8)
            recorder.write(Frame(Stamp(i, i / 10, 1e9 + i / 10), image))
    navigator = Navigator(Tracker(vid))
    run_navigation(navigator, Replay(folder / "raw", speed=0), recorder=Recorder(folder / "navigated"))
    return folder / "navigated"


def test_a_session_in_figures(vid, record):
    figures = session_figures(Replay(record, speed=0), vid.kidney)
    first, second = (c.name for c in vid.kidney.calyces[:2])
    assert len(figures.t_s) == 60 and figures.t_s[-1] == pytest.approx(5.9)
    assert figures.time_in_s[first] > 1.5
    assert figures.best[first] < 40
    assert 0 < figures.path_mm < 40 and len(figures.T_kidney_camera) == figures.believed.sum()
    assert any(m.from_s >= 2.5 and m.to_s <= 4.5 for m in figures.moments)
    assert second in figures.time_in_s or figures.moments


def test_the_report_needs_nothing_but_itself(vid, record, tmp_path):
    path = write_session_report(vid, Replay(record, speed=0), tmp_path / "report.html")
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"(?:src|href)=\"(?!data:|#t\d)", text) and "http" not in text
    for part in ("Path", "What was seen", "Calyces", "Doubtful moments", "duration", "mm/s"):
        assert part in text
    assert text.count("<img ") >= 4
    ids = set(re.findall(r'<figure id="(t\d+)"', text))
    assert len(ids) > 20 and set(re.findall(r'<a href="#(t\d+)"', text)) <= ids
    assert re.search(r"<title>\d.* s: sure, A</title>", text)
    names, addresses = zip(*re.findall(r'download="(.*?)" href="data:text/csv;base64,(.*?)"', text), strict=True)
    assert names == ("moments.csv", "calyces.csv", "path.csv")
    rows = list(csv.DictReader(base64.b64decode(addresses[2]).decode().splitlines()))
    assert len(rows) == 60 and {row["accepted"] for row in rows} == {"true", "false"} and rows[5]["calyx"] == "A"


def test_two_sessions_are_laid_side_by_side_and_one_that_was_never_navigated_is_refused(vid, record, tmp_path):
    path = write_comparison(vid, Replay(record, speed=0), Replay(record, speed=0), tmp_path / "both.html")
    text = path.read_text(encoding="utf-8")
    assert text.count("2182 ± 613 mm") == 1 and text.count("<th>navigated</th>") >= 4, "training, side by side"
    assert text.count('class="time-line"') == 2 and text.count("duration") == 1 and text.count("navigated</h3>") == 4
    assert set(re.findall(r'<a href="#([ab])\d+"', text)) == {"a", "b"}
    raw = Replay(record.parent / "raw", speed=0)
    with pytest.raises(InputError, match=r"raw holds no results; navigate it first"):
        write_comparison(vid, Replay(record, speed=0), raw, tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()


def test_a_records_time_line_says_what_was_known_when(record):
    found = timeline(SimpleNamespace(replay=Replay(record, speed=0), duration_s=5.9))
    kinds = [(kind, calyx) for _, _, kind, calyx in found["moments"]]
    assert ("sure", "A") in kinds and {"searching", "unsure"} & {kind for kind, _ in kinds}
    ends = [(a, b) for a, b, _, _ in found["moments"]]
    assert ends[0][0] < 0.3 and ends[-1][1] <= 6.0 and all(b <= c + 1e-6 for (_, b), (c, _) in itertools.pairwise(ends))


def request(port, path):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path)
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


def test_a_page_lives_as_long_as_its_session_and_serves_no_files(vid, record, phantom_lumen):
    pages = []

    @contextmanager
    def page_of(navigator, controls):
        with web_page(navigator, controls, port=0) as live:
            pages.append(live)
            yield

    navigator = Navigator(Tracker(vid))
    done = []
    thread = threading.Thread(
        target=lambda: done.append(run_navigation(navigator, Replay(record, speed=0), page=page_of))
    )
    thread.start()
    until = time.monotonic() + 30
    while not pages and time.monotonic() < until:
        time.sleep(0.05)
    page: LivePage = pages[0]
    port = page.server.port
    assert page.url == f"http://127.0.0.1:{port}" and request(port, "/")[0] == 200
    for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/etc/passwd", "/..\\..\\etc\\passwd",
                 "/static/../live.py", "/static/%2e%2e/live.py", "/static//etc/passwd", "/calyx/99.jpg"):  # fmt: skip
        status, content = request(port, path)
        assert status in (400, 404, 405) and b"root:" not in content and b"import" not in content
    page.choose("C")
    page.choose("C")
    while navigator.located < 60 and time.monotonic() < until:
        time.sleep(0.05)
    page.controls.player.stop()
    thread.join(timeout=20)
    assert done and done[0].located == 60


def test_on_a_slow_machine_drawings_wait(vid, phantom_lumen, monkeypatch):
    """Words and the scope's pictures must keep coming; what is drawn for the page comes less often."""
    page = LivePage(Navigator(Tracker(vid)), SessionControls(lambda: None), port=0)
    try:
        clock, number = [1000.0], 0
        monkeypatch.setattr("ursnav_torch.page.live.time", SimpleNamespace(monotonic=lambda: clock[0]))
        drawn, frame = {}, Frame(Stamp(0, 0.0, 0.0), np.zeros((96, 96), np.uint8))
        for effort in (0, 2):
            server, start = Mock(), clock[0]
            monkeypatch.setattr(page, "server", server)
            while clock[0] < start + 30:
                number += 1
                state = NavigationState(version=number, effort=effort, frame=replace(frame))
                page._show_state(state)
                page._show_drawings(state)
                clock[0] += 0.1
            drawn[effort] = Counter(call.args[0] for call in server.publish_picture.call_args_list)
            monkeypatch.undo()
            monkeypatch.setattr("ursnav_torch.page.live.time", SimpleNamespace(monotonic=lambda: clock[0]))
        assert drawn[0]["virtual"] == pytest.approx(60, abs=3) and drawn[2]["virtual"] == pytest.approx(15, abs=2)
        assert all(counts["scope"] == pytest.approx(300, abs=3) for counts in drawn.values())
    finally:
        page.close()


def test_views_of_a_vid_stored_without_pictures_are_drawn_again(vid, renderer, tmp_path):
    bare = PagePictures(replace(vid, folder=tmp_path))
    drawn, stored = bare.view(3).astype(float), PagePictures(vid).view(3)
    stored = cv2.resize(stored, drawn.shape[1::-1], interpolation=cv2.INTER_AREA).astype(float)
    assert np.corrcoef(drawn.ravel(), stored.ravel())[0, 1] > 0.97


def test_exploring_without_a_place_to_save_says_so(vid, tmp_path):
    page = ExplorePage(vid, None, port=0)
    try:
        page.go_to("B")
        before = page.T_kidney_camera.copy()
        page.fly("look left")
        assert not np.allclose(before, page.T_kidney_camera)
        page.take_view()
        with pytest.raises(InputError, match="out=FOLDER"):
            page.save()
        assert page.collection.T_kidney_camera[0] is not page.T_kidney_camera
    finally:
        page.close()
