"""The page in a real browser, headless, while a simulated scope explores the phantom."""

import re
import shutil
import threading
import time
from contextlib import contextmanager
from functools import partial

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.devices import RobotLight
from ursnav_torch.kidney import read_calyces
from ursnav_torch.navigation import Navigator, run_navigation
from ursnav_torch.page import ExplorePage, web_page
from ursnav_torch.session import build_rig
from ursnav_torch.simulation import SimulatedGrblRobot, TwinCamera, TwinPilot, World, make_twin
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import read_views

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE_S = 60.0

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this computer")]


@pytest.fixture(scope="module")
def page(vid, renderer, phantom_lumen):
    """The page of a running session, without a browser yet."""
    hardware = partial(
        build_rig,
        camera=partial(TwinCamera, rate_hz=8.0),
        robot=partial(SimulatedGrblRobot, deadline_s=5.0),
        light=partial(RobotLight),
        gamepad=partial(TwinPilot, rounds=0),
        twin=partial(make_twin, lumen=phantom_lumen),
    )
    pages, ready = [], threading.Event()

    @contextmanager
    def page_of(navigator, controls):
        with web_page(navigator, controls, port=0) as live:
            pages.append(live)
            ready.set()
            yield

    navigator = Navigator(Tracker(vid, phantom_lumen))
    job = partial(run_navigation, navigator, hardware, lambda: World(vid.kidney, renderer), page=page_of)
    session = threading.Thread(target=job)
    session.start()
    assert ready.wait(PATIENCE_S)
    yield pages[0]
    pages[0].controls.stop()
    session.join(timeout=30)
    assert not session.is_alive()


class Tab:
    """A browser's tab on the page, and all that went wrong in it."""

    def __init__(self, browser, url, shown=".ursnav-coverage"):
        self.errors, self.foreign = [], []
        self.tab = browser.new_page(viewport={"width": 1300, "height": 900})
        self.tab.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.tab.on("pageerror", lambda e: self.errors.append(str(e)))
        self.tab.on("request", self._request)
        self.tab.on("websocket", lambda s: s.url.startswith("ws://127.0.0.1:") or self.foreign.append(s.url))
        self.tab.goto(url)
        self.tab.wait_for_selector(shown, timeout=1e3 * PATIENCE_S)

    def _request(self, request):
        if not request.url.startswith(("http://127.0.0.1:", "data:", "blob:")):
            self.foreign.append(request.url)

    def press(self, button):
        self.tab.get_by_role("button", name=button, exact=True).click()

    def field(self, label):
        """The input beside a label."""
        return self.tab.locator("label", has_text=label).locator("xpath=(ancestor::*[.//input])[last()]//input")

    def text(self, part):
        return re.sub(r"\s+", " ", self.tab.inner_text(f".ursnav-{part}")).strip()

    def wait(self, what, part="status"):
        """The text of a part once ``what(text)`` is true."""
        until = time.monotonic() + PATIENCE_S
        while not what(text := self.text(part)):
            assert time.monotonic() < until, f"{part} still says {text!r}"
            self.tab.wait_for_timeout(100)
        return text

    def scene(self):
        """The middle of the page, blue, green, red, without notices."""
        shot = cv2.imdecode(np.frombuffer(self.tab.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        return shot[160:, 280:820].astype(int)


def screen_positions(page, tab, points_mm):
    """Where places (N, 3) in the kidney frame are on the screen, (N, 2) px, as the browser says its camera stands."""
    camera = next(iter(page.server.get_clients().values())).camera
    box = tab.tab.locator("canvas").first.bounding_box()
    R = Rotation.from_quat(np.roll(camera.wxyz, -1)).as_matrix()
    local = (points_mm - np.array(camera.position)) @ R
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    return (local[:, :2] / local[:, 2:] * focal + middle).tolist()


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def tab(browser, page):
    return Tab(browser, page.url)


def test_the_page_draws_the_kidney_and_the_pictures(tab):
    until = time.monotonic() + PATIENCE_S
    share = 0.0
    while share < 0.01 and time.monotonic() < until:
        blue, green, red = np.moveaxis(tab.scene(), -1, 0)
        share = float(((red - blue > 12) & (red - green > 12)).mean())  # tissue
        tab.tab.wait_for_timeout(300)
    assert share >= 0.01
    size = "els => els.map(e => [e.naturalWidth, e.naturalHeight])"
    (width, height), *_ = tab.tab.eval_on_selector_all(".ursnav-pair img", size)
    assert width == 2 * height > 0


def test_the_status_line_follows_the_exploration(tab, page):
    bus, seen = page.navigator.bus, set()
    until = time.monotonic() + PATIENCE_S
    while len(seen) < 4 and time.monotonic() < until:
        seen.add(tab.text("status"))
        tab.tab.wait_for_timeout(200)
    assert len(seen) >= 4
    assert all(" of 6 inspected." in text for text in seen)
    version = bus.latest().version
    wanted = set()

    def told(text):
        wanted.add(bus.latest().status)
        return text in wanted and bus.latest().version > version + 3

    tab.wait(told)
    assert "poses a second" in tab.text("latency")
    assert tab.tab.locator(".ursnav-coverage tr").count() == 6


def test_a_click_on_a_calyx_routes_there_and_shows_its_views(tab, page):
    tab.tab.get_by_role("button", name="D", exact=True).click()
    tab.wait(lambda text: "Next: D, " in text and page.navigator.bus.latest().guidance.chosen == "D")
    tab.wait(lambda text: text.startswith("views of calyx D"), "views")
    tab.tab.get_by_role("button", name="Propose the next one").click()
    until = time.monotonic() + PATIENCE_S
    while page.navigator.bus.latest().guidance.chosen and time.monotonic() < until:
        tab.tab.wait_for_timeout(100)
    assert page.navigator.bus.latest().guidance.chosen == ""


def test_a_click_on_a_ball_in_the_scene_does_the_same(tab, page):
    kidney = page.navigator.vid.kidney
    at = np.array(screen_positions(page, tab, kidney.tips_mm))
    free = (at[:, 0] > 300) & (at[:, 0] < 800) & (at[:, 1] > 170) & (at[:, 1] < 880)
    for index in np.flatnonzero(free):  # one of them is in front
        tab.tab.mouse.click(*(at[index]).tolist())
        until = time.monotonic() + 5
        while time.monotonic() < until and not page.navigator.bus.latest().guidance.chosen:
            tab.tab.wait_for_timeout(100)
        if page.navigator.bus.latest().guidance.chosen:
            break
    assert page.navigator.bus.latest().guidance.chosen == kidney.calyces[index].name
    page.navigator.choose("")


def test_the_robot_is_stopped_by_a_key_and_acknowledged_by_a_button(tab, page):
    tab.wait(lambda text: "robot: armed" in text, "robot")
    tab.tab.mouse.move(640, 800)
    tab.tab.keyboard.press("Space")
    tab.wait(lambda text: "robot: stopped" in text, "robot")
    before = page.navigator.bus.latest()
    tab.tab.get_by_role("button", name="Acknowledge the stop").click()
    tab.wait(lambda text: "robot: disarmed" in text, "robot")
    assert page.controls.console.by_hand and before.robot == "stopped"
    tab.tab.get_by_role("button", name="Arm", exact=True).click()
    tab.wait(lambda text: "robot: armed" in text, "robot")
    tab.press("Brighter")
    tab.wait(lambda text: not text.startswith("Searching"))


def test_no_button_moves_while_the_words_change(tab):
    button, seen = tab.tab.get_by_role("button", name="End the session"), set()
    for _ in range(10):
        seen.add(button.bounding_box()["y"])
        tab.tab.wait_for_timeout(200)
    assert len(seen) == 1


def test_closing_and_opening_the_page_again_loses_nothing(tab, browser, page):
    before, path = tab.text("coverage"), len(page.navigator.bus.latest().path_mm)
    tab.tab.close()
    located = page.navigator.located
    time.sleep(1.0)
    again = Tab(browser, page.url)
    assert again.text("coverage").count("%") == before.count("%") == 6
    shares = [[int(v) for v in re.findall(r"(\d+)%", text)] for text in (before, again.text("coverage"))]
    assert all(b >= a for a, b in zip(*shares, strict=True))
    assert len(page.navigator.bus.latest().path_mm) >= path and page.navigator.located > located
    test_the_page_draws_the_kidney_and_the_pictures(again)
    assert (tab.errors, again.errors) == ([], [])
    assert (tab.foreign, again.foreign) == ([], [])
    again.tab.close()


def test_exploring_by_hand_takes_views_and_picks_landmarks(browser, vid, tmp_path):
    page = ExplorePage(vid, tmp_path / "kept", port=0)
    try:
        tab = Tab(browser, page.url, shown=".ursnav-pair")
        tab.wait(lambda text: text.endswith("0 views and 0 landmarks kept."))
        tab.press("Go there")
        tab.wait(lambda text: text.startswith("Calyx A."))
        before = page.T_kidney_camera
        tab.tab.keyboard.press("j")
        tab.press("Take this view")
        tab.wait(lambda text: "1 view and" in text)
        assert not np.allclose(before, page.T_kidney_camera)
        tab.tab.get_by_text("Pick landmarks").click()
        for x, y in screen_positions(page, tab, vid.kidney.centerline.points_mm[[0, 5, 10]]):
            tab.tab.mouse.click(x, y)
            tab.tab.wait_for_timeout(500)
        tab.wait(lambda text: "0 landmarks" not in text)
        off = vid.kidney.mesh.nearest.on_surface(np.array(page.collection.landmarks_mm))[1]
        assert np.abs(off).max() < 1e-2
        tab.press("Save")
        until = time.monotonic() + PATIENCE_S
        while not (tmp_path / "kept" / "landmarks.csv").exists() and time.monotonic() < until:
            tab.tab.wait_for_timeout(100)
        assert {p.name for p in (tmp_path / "kept").iterdir()} == {
            "calyces.csv",
            "images",
            "landmarks.csv",
            "poses.csv",
        }
        assert (tab.errors, tab.foreign) == ([], [])
        tab.tab.close()
    finally:
        page.close()


def test_a_calyx_named_and_a_view_taken_by_hand_are_read_back(browser, vid, renderer, phantom_lumen, tmp_path):
    kept = tmp_path / "my kept views"
    page = ExplorePage(vid, kept, port=0)
    try:
        tab = Tab(browser, page.url, shown=".ursnav-pair")
        tab.press("Go there")
        tab.wait(lambda text: text.startswith("Calyx A."))
        name = tab.field("new name")
        name.fill("B")
        name.press("Tab")
        tab.press("Rename")
        tab.tab.get_by_text("cannot be called 'B'").wait_for(timeout=1e3 * PATIENCE_S)
        name.fill("oberer Kelch, ä")
        name.press("Tab")
        tab.press("Rename")
        tab.wait(lambda text: text.startswith("Calyx oberer Kelch, ä."))
        before = page.T_kidney_camera
        tab.press("look left (J)")
        until = time.monotonic() + PATIENCE_S
        while np.allclose(before, page.T_kidney_camera) and time.monotonic() < until:
            tab.tab.wait_for_timeout(100)
        tab.press("Take this view")
        tab.wait(lambda text: "1 view and 0 landmarks kept" in text)
        tab.press("Save")
        tab.tab.get_by_text("1 views, 6 names, 0 landmarks in").wait_for(timeout=1e3 * PATIENCE_S)
        calyces, pelvis = read_calyces(kept / "calyces.csv")
        assert [c.name for c in calyces] == ["oberer Kelch, ä", "B", "C", "D", "E", "F"]
        assert np.allclose([c.tip_mm for c in calyces], vid.kidney.tips_mm, atol=1e-4)
        assert np.allclose(pelvis, vid.kidney.pelvis_mm, atol=1e-4)
        views = read_views(kept)
        assert np.allclose(views.T_kidney_camera, page.T_kidney_camera[None], atol=1e-5)
        assert not np.allclose(views.T_kidney_camera[0], before, atol=1e-2)
        assert views.plan(page.collection.kidney, phantom_lumen).calyx.tolist() == [0]
        picture = cv2.imread(str(views.pictures[0]), cv2.IMREAD_GRAYSCALE)
        drawn = renderer.render(page.T_kidney_camera).image
        assert np.array_equal(picture, drawn if drawn.ndim == 2 else cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY))
        assert tab.text("views").startswith("views of calyx oberer Kelch, ä")
        for x, y in screen_positions(page, tab, vid.kidney.tips_mm[1:]):  # a ball still leads to its calyx
            if 300 < x < 800 and 170 < y < 880:
                tab.tab.mouse.click(x, y)
                tab.wait(lambda text: not text.startswith("views of calyx oberer Kelch, ä"), "views")
                break
        assert (tab.errors, tab.foreign) == ([], [])
        tab.tab.close()
    finally:
        page.close()


def test_another_sites_page_cannot_show_ours_to_steal_clicks(page, browser):
    """Click-jacking: a page from elsewhere frames ours, unseen, below what it wants to be clicked."""
    tab = browser.new_page()
    try:
        tab.goto("data:text/html,<h1>elsewhere</h1>")
        tab.set_content(f'<iframe src="{page.url}" width="900" height="700" style="opacity:.01"></iframe>')
        tab.wait_for_timeout(3000)
        framed = [frame for frame in tab.frames if frame != tab.main_frame]
        assert framed and not any(frame.query_selector("#root *") for frame in framed)
        assert all("STOP" not in (frame.content() or "") for frame in framed)
    finally:
        tab.close()
