"""The page in a real browser, headless, while a simulated scope explores the phantom."""

import re
import shutil
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from ursnav_torch.devices import OperatorInput, RobotLight
from ursnav_torch.kidney import read_calyces
from ursnav_torch.navigation import Navigator, run_navigation
from ursnav_torch.page import ExplorePage, web_page
from ursnav_torch.session import HOLD, build_rig
from ursnav_torch.session.console import Console
from ursnav_torch.simulation import SimulatedGrblRobot, TwinCamera, TwinPilot, World, make_twin
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import read_views

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE_S = 180.0

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this computer")]


@pytest.fixture(scope="module")
def page(vid, renderer):
    """The page of a running session, without a browser yet."""
    hardware = partial(
        build_rig,
        camera=partial(TwinCamera, rate_hz=8.0),
        robot=partial(SimulatedGrblRobot, deadline_s=5.0),
        light=partial(RobotLight),
        gamepad=partial(TwinPilot, rounds=0),
        twin=make_twin,
    )
    pages, ready = [], threading.Event()

    @contextmanager
    def page_of(navigator, controls):
        with web_page(navigator, controls, port=0) as live:
            pages.append(live)
            ready.set()
            yield

    navigator = Navigator(Tracker(vid))
    navigator._see_stones = lambda tracked, frame: None  # those on the page are the test's own
    job = partial(run_navigation, navigator, hardware, lambda: World(vid.kidney, renderer, vid.lumen), page=page_of)
    session = threading.Thread(target=job)
    session.start()
    assert ready.wait(PATIENCE_S)
    yield pages[0]
    pages[0].controls.stop()
    session.join(timeout=30)
    assert not session.is_alive()


class Tab:
    """A browser's tab on the page, and all that went wrong in it."""

    def __init__(self, browser, url, shown="#strip button"):
        self.errors, self.foreign = [], []
        self.tab = browser.new_page(viewport={"width": 1300, "height": 900})
        self.tab.set_default_timeout(1e3 * PATIENCE_S)
        self.tab.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.tab.on("pageerror", lambda e: self.errors.append(str(e)))
        self.tab.on("request", self._request)
        self.tab.on("websocket", lambda s: s.url.startswith("ws://127.0.0.1:") or self.foreign.append(s.url))
        self.tab.goto(url)
        self.tab.wait_for_selector(shown, timeout=1e3 * PATIENCE_S)

    def _request(self, request):
        if not request.url.startswith(("http://127.0.0.1:", "data:", "blob:")):
            self.foreign.append(request.url)

    @contextmanager
    def elsewhere(self):
        """The tab shows nothing meanwhile: without a graphics card two pages that draw starve each other."""
        url = self.tab.url
        self.tab.goto("about:blank")
        yield
        self.tab.goto(url)
        self.tab.wait_for_selector("#strip button")

    def press(self, part):
        """Press a button by its id, as a keyboard does: it has the focus, and Enter is pressed."""
        self.tab.focus(f"#{part}")
        self.tab.keyboard.press("Enter")

    def calyx(self, name):
        """The button of a calyx in the strip."""
        return self.tab.locator("#strip button", has=self.tab.locator("b", has_text=re.compile(f"^{name}$")))

    def text(self, part):
        return re.sub(r"\s+", " ", self.tab.inner_text(f"#{part}")).strip()

    def wait(self, what, part="status"):
        """The text of a part once ``what(text)`` is true."""
        until = time.monotonic() + PATIENCE_S
        while not what(text := self.text(part)):
            assert time.monotonic() < until, f"{part} still says {text!r}"
            self.tab.wait_for_timeout(100)
        return text

    def scene(self):
        """The kidney's pane, blue, green, red."""
        shot = self.tab.locator("#kidney").screenshot()
        return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR).astype(int)

    def screen(self, points_mm):
        """Where places (N, 3) in the kidney frame are on the screen, N pairs of px."""
        return self.tab.evaluate("points => window.kidney.screen(points)", np.asarray(points_mm).tolist())


def eventually(what, patience_s=PATIENCE_S):
    """Wait until ``what()`` is true."""
    until = time.monotonic() + patience_s
    while not (found := what()):
        assert time.monotonic() < until
        time.sleep(0.1)
    return found


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


def draws_the_kidney(tab):
    blue, green, red = np.moveaxis(tab.scene(), -1, 0)
    return ((red - blue > 12) & (red - green > 12)).mean() >= 0.01  # tissue


def test_the_page_draws_the_kidney_and_the_pictures(tab, page):
    eventually(lambda: draws_the_kidney(tab))
    size = tab.tab.evaluate("[document.getElementById('picture').width, document.getElementById('picture').height]")
    assert size == [page.navigator.vid.camera.width, page.navigator.vid.camera.height]
    lit = (
        "c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data"
        ".filter((v, i) => i % 4 === 0 && v > 40).length"
    )
    eventually(lambda: tab.tab.eval_on_selector("#picture", lit) > 500)
    eventually(lambda: tab.tab.eval_on_selector("#virtual", lit) > 500)


def test_the_status_line_follows_the_exploration(tab, page):
    bus, seen = page.navigator.bus, set()
    eventually(lambda: seen.add(tab.text("status")) or len(seen) >= 4)
    assert all(re.search(r"(\d of|All) 6 inspected\.", text) for text in seen), seen
    version = bus.latest().version
    wanted = set()

    def told(text):
        wanted.add(bus.latest().status)
        return text in wanted and bus.latest().version > version + 3

    tab.wait(told)
    assert "poses a second" in tab.text("latency")
    assert tab.tab.locator("#strip button").count() == 6


@pytest.mark.parametrize("size", [(1280, 720), (1000, 900), (1920, 1080)])
def test_the_whole_kidney_is_in_the_middle_of_its_pane_and_fills_it(tab, vid, size):
    tab.tab.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    tab.tab.wait_for_timeout(500)
    pane, shown = tab.tab.locator("#kidney").bounding_box(), np.array(tab.screen(vid.kidney.mesh.vertices))
    low, high = (
        shown.min(0) - [pane["x"], pane["y"]],
        [pane["x"] + pane["width"], pane["y"] + pane["height"]] - shown.max(0),
    )
    margins, sides = np.stack([low, high]), np.array([pane["width"], pane["height"]])
    assert (margins > 0.02 * sides).all() and (margins.min(0) < 0.15 * sides).any()
    tab.tab.set_viewport_size({"width": 1300, "height": 900})


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)])
def test_the_scopes_picture_is_large_and_no_texts_overlap(tab, size):
    width, height = size
    tab.tab.set_viewport_size({"width": width, "height": height})
    tab.tab.wait_for_timeout(500)
    box = tab.tab.locator(".scope").bounding_box()
    assert box["height"] >= 0.55 * height and abs(box["width"] - box["height"]) < 2
    texts = tab.tab.evaluate(TEXT_BOXES)
    assert len(texts) > 25
    for i, (name, *a) in enumerate(texts):
        assert a[0] >= -1 and a[1] >= -1 and a[2] <= width + 1, f"{name} is cut off by the page"
        for other, *b in texts[i + 1 :]:
            apart = a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1
            assert apart, f"{name!r} and {other!r} overlap"
    tab.tab.set_viewport_size({"width": 1300, "height": 900})


#: Every text that is shown, with the box of what is visible of it: left, top, right, bottom.
TEXT_BOXES = """() => {
  const found = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const node = walk.currentNode, element = node.parentElement;
    if (!node.textContent.trim() || !element.checkVisibility() || element.closest("script, option")) continue;
    const range = document.createRange(); range.selectNodeContents(node);
    let { left, top, right, bottom } = range.getBoundingClientRect();
    for (let e = element; e; e = e.parentElement) if (getComputedStyle(e).overflow !== "visible") {
      const b = e.getBoundingClientRect();
      left = Math.max(left, b.left); top = Math.max(top, b.top);
      right = Math.min(right, b.right); bottom = Math.min(bottom, b.bottom);
    }
    if (right > left && bottom > top) found.push([node.textContent.trim(), left, top, right, bottom]);
  }
  return found;
}"""


def test_what_lies_over_the_picture_is_switched_by_keys_and_a_gamepad_goes_everywhere(tab, page):
    drawn = "JSON.parse(document.getElementById('edges').dataset.drawn ?? '{}')"
    eventually(lambda: tab.tab.evaluate(drawn).get("edges") is not None)
    for key, part in (("e", "edges"), ("s", "stones"), ("n", "names"), ("c", "cloud"), ("v", "drawn")):
        button = tab.tab.locator(f"[data-shows={part}]")
        assert button.get_attribute("aria-pressed") == "true"
        tab.tab.keyboard.press(key)
        assert button.get_attribute("aria-pressed") == "false"
    eventually(lambda: set(tab.tab.evaluate(drawn).values()) == {None})
    assert not tab.tab.locator("#virtual").is_visible()
    for key in "esncv":
        tab.tab.keyboard.press(key)
    eventually(lambda: None not in tab.tab.evaluate(drawn).values())
    eventually(lambda: int(tab.tab.get_attribute("#kidney canvas", "data-cloud") or 0) > 100)
    tab.tab.evaluate(FAKE_GAMEPAD)
    reached, focused = set(), "document.activeElement.id || document.activeElement.innerText"
    while True:  # once round the page
        tab.tab.evaluate("window.pad.press(15)")  # the cross, right
        if (name := tab.tab.evaluate(focused)) in reached:
            break
        reached.add(name)
    buttons = tab.tab.locator("button:visible").count()
    assert len(reached) >= buttons > 20 and {"stop", "end", "acknowledge", "arm"} <= reached
    tab.tab.focus("[data-shows=edges]")
    tab.tab.evaluate("window.pad.press(3)")
    assert tab.tab.locator("[data-shows=edges]").get_attribute("aria-pressed") == "false"
    tab.tab.evaluate("window.pad.press(3)")


#: A gamepad that presses what it is told to; `press` comes back when the page has looked at it.
FAKE_GAMEPAD = """() => {
  const pad = { buttons: Array.from({ length: 17 }, () => ({ pressed: false })), axes: [0, 0, 0, 0] };
  navigator.getGamepads = () => [pad];
  const wait = () => new Promise((done) => setTimeout(done, 120));
  pad.press = async (i) => {
    for (const pressed of [true, false]) { pad.buttons[i].pressed = pressed; await wait(); }
  };
  window.pad = pad;
  dispatchEvent(new Event("gamepadconnected"));
}"""


def serious(url, browser):
    """What axe-core calls serious or critical on a page."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    context = browser.new_context(bypass_csp=True, viewport={"width": 1280, "height": 720})
    tab = context.new_page()
    tab.goto(url)
    tab.wait_for_selector("#strip button", timeout=1e3 * PATIENCE_S)
    found = axe.run(tab).response["violations"]
    context.close()
    return [(v["impact"], v["id"], v["nodes"][0]["html"]) for v in found if v["impact"] in ("serious", "critical")]


def test_axe_finds_nothing_serious_on_the_live_page(tab, page, browser):
    with tab.elsewhere():
        assert serious(page.url, browser) == []


def test_a_click_on_a_calyx_routes_there(tab, page):
    tab.calyx("D").click()
    tab.wait(lambda text: "Next: D, " in text and page.navigator.bus.latest().guidance.chosen == "D")
    assert tab.calyx("D").get_attribute("aria-pressed") == "true"
    tab.press("propose")
    eventually(lambda: page.navigator.bus.latest().guidance.chosen == "")


def test_a_click_on_a_ball_in_the_scene_does_the_same(tab, page):
    kidney, chosen = page.navigator.vid.kidney, lambda: page.navigator.bus.latest().guidance.chosen
    box, hit = tab.tab.locator("#virtual").bounding_box(), ""
    for calyx, (x, y) in zip(kidney.calyces, tab.screen(kidney.tips_mm), strict=True):  # one of them is in front
        if x > box["x"] and y > box["y"]:
            continue
        tab.tab.mouse.click(x, y)
        tab.tab.wait_for_timeout(2000)
        if chosen():
            hit = calyx.name
            break
    assert chosen() == hit != ""
    page.navigator.choose("")


def arm(tab):
    """The robot armed, whatever stood before: a slow machine stops it, as it should, and may lose its place."""
    until = time.monotonic() + PATIENCE_S
    while "armed" not in (text := tab.text("robot")).split():
        assert time.monotonic() < until, f"the robot cannot be armed: {text!r}"
        if "stopped" in text:
            tab.press("acknowledge")
        elif "disarmed" in text:
            tab.tab.keyboard.press("r")
        tab.tab.wait_for_timeout(500)


def test_the_robot_is_stopped_by_a_key_and_acknowledged_by_a_button(tab, page):
    arm(tab)
    tab.tab.focus("#end")
    tab.tab.keyboard.press("Space")  # stops wherever the focus is, and presses nothing else
    tab.wait(lambda text: "stopped" in text, "robot")
    before = page.navigator.bus.latest()
    tab.press("acknowledge")
    tab.wait(lambda text: "disarmed" in text, "robot")
    assert page.controls.console.by_hand and before.robot == "stopped"
    tab.tab.keyboard.press("r")
    tab.wait(lambda text: "armed" in text.split(), "robot")
    tab.press("brighter")
    tab.wait(lambda text: not text.startswith("Searching"))


#: Waits for ten turns of the page's own timers, however slow the machine is.
TEN_TURNS = """new Promise((done) => {
    let turns = 0;
    const timer = setInterval(() => { if (++turns === 10) { clearInterval(timer); done(); } }, 100);
})"""


class Hands(Console):
    """A page's hands that no session reads, and all moves that were asked of them."""

    def __init__(self, robot):
        super().__init__(None, robot, may_drive=True)
        self.asked = []

    def drive(self, move, *given):
        self.asked.append(move)
        super().drive(move, *given)


def test_the_dead_man_button_is_held_by_a_button_or_a_key_that_move_nothing(browser, page, tab):
    with tab.elsewhere(), Hands(page.controls.console._robot) as hands:
        with web_page(page.navigator, replace(page.controls, console=hands, by_itself=True), port=0) as live:
            other, told = Tab(browser, live.url), []

            def held():
                told.append(hands.read())
                return told[-1].dead_man

            def quiet():
                before = len(hands.asked)
                other.tab.evaluate(TEN_TURNS)
                return len(hands.asked) == before and not held()

            eventually(lambda: other.tab.keyboard.down("h") or held())
            other.tab.keyboard.up("h")
            eventually(quiet)
            by_key = len(hands.asked)
            other.tab.hover("#hold")
            other.tab.mouse.down()
            eventually(held)
            eventually(lambda: len(hands.asked) >= by_key + 5)  # for as long as it is held
            other.tab.mouse.up()
            eventually(quiet)
            assert not other.errors
            other.tab.close()
        assert by_key and set(hands.asked) == {HOLD}
        assert {replace(own, stamp=told[0].stamp, dead_man=False) for own in told} == {OperatorInput(told[0].stamp)}


def test_nothing_moves_while_the_words_change(tab):
    tab.tab.reload()
    tab.tab.wait_for_selector("#strip button")
    tab.tab.evaluate(
        "window.shift = 0; new PerformanceObserver((l) => l.getEntries().forEach((e) => { window.shift += e.value; }))"
        ".observe({ type: 'layout-shift', buffered: true })"
    )
    seen = set()
    for _ in range(20):
        seen.add(tuple(tab.tab.locator("#end").bounding_box().values()))
        tab.tab.wait_for_timeout(200)
    assert len(seen) == 1 and tab.tab.evaluate("window.shift") <= 0.01


#: Where everything is that has a place of its own: left, top, width, height. A tag is as wide as its words.
BOXES = """() => [...document.querySelectorAll("button, h2, canvas, ul, nav, .keep, summary")]
  .filter((e) => e.checkVisibility()).map((e) => { const b = e.getBoundingClientRect();
    return [b.x, b.y, b.width, b.height]; })"""


def test_stones_are_listed_and_drawn_and_move_nothing(tab, page):
    lines = tab.tab.locator("#stones li")
    assert lines.all_inner_texts() == ["none yet"]
    places = tab.tab.evaluate(BOXES)
    row = {
        "calyx": "B",
        "size": 6.1,
        "sd": 0.6,
        "state": "there",
        "known": "",
        "at": page.navigator.vid.kidney.pelvis_mm.tolist(),
    }
    rows = [row | {"number": i + 1} for i in range(9)]
    rows[1] |= {"state": "gone", "calyx": "a calyx with quite a long name", "known": "S1"}
    page.server.publish("stones", stones=rows)
    eventually(lambda: lines.count() == 9)
    assert lines.nth(0).inner_text() == "1 · B · 6.1 ± 0.6 mm · there" and "gone · S1" in lines.nth(1).inner_text()
    eventually(lambda: tab.tab.get_attribute("#kidney canvas", "data-stones") == "9")
    assert len(places) > 25 and tab.tab.evaluate(BOXES) == places, "the list is as high with nine stones as with none"
    page.server.publish("stones", stones=[])
    eventually(lambda: lines.all_inner_texts() == ["none yet"])
    assert tab.errors == []


def test_closing_and_opening_the_page_again_loses_nothing(tab, browser, page):
    before, path = tab.text("strip"), len(page.navigator.bus.latest().path_mm)
    tab.tab.close()
    located = page.navigator.located
    time.sleep(1.0)
    again = Tab(browser, page.url)
    again.wait(lambda text: text.count("%") == before.count("%") == 6, "strip")
    shares = [[int(v) for v in re.findall(r"(\d+) %", text)] for text in (before, again.text("strip"))]
    assert all(b >= a for a, b in zip(*shares, strict=True))
    assert len(page.navigator.bus.latest().path_mm) >= path and page.navigator.located > located
    eventually(lambda: draws_the_kidney(again))
    assert (tab.errors, again.errors) == ([], [])
    assert (tab.foreign, again.foreign) == ([], [])
    again.tab.close()


def test_exploring_by_hand_takes_views_and_picks_landmarks(browser, vid, tmp_path):
    page = ExplorePage(vid, tmp_path / "kept", port=0)
    try:
        tab = Tab(browser, page.url, shown="#strip button")
        tab.wait(lambda text: text.endswith("0 views and 0 landmarks kept."))
        assert serious(page.url, browser) == []
        tab.press("go")
        tab.wait(lambda text: text.startswith("Calyx A."))
        before = page.T_kidney_camera
        tab.tab.keyboard.press("j")
        tab.press("take")
        tab.wait(lambda text: "1 view and" in text)
        assert not np.allclose(before, page.T_kidney_camera)
        tab.tab.check("#picking")
        for x, y in tab.screen(vid.kidney.centerline.points_mm[[0, 5, 10]]):
            tab.tab.mouse.click(x, y)
            tab.tab.wait_for_timeout(500)
        tab.wait(lambda text: "0 landmarks" not in text)
        off = vid.kidney.mesh.nearest.on_surface(np.array(page.collection.landmarks_mm))[1]
        assert np.abs(off).max() < 1e-2
        tab.press("save")
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
        tab = Tab(browser, page.url, shown="#strip button")
        tab.press("go")
        tab.wait(lambda text: text.startswith("Calyx A."))
        name = tab.tab.locator("#name")
        name.fill("B")
        tab.press("rename")
        tab.tab.get_by_text("cannot be called 'B'").wait_for(timeout=1e3 * PATIENCE_S)
        name.fill("oberer Kelch, ä")
        tab.press("rename")
        tab.wait(lambda text: text.startswith("Calyx oberer Kelch, ä."))
        before = page.T_kidney_camera
        tab.tab.get_by_role("button", name="look left J").click()
        until = time.monotonic() + PATIENCE_S
        while np.allclose(before, page.T_kidney_camera) and time.monotonic() < until:
            tab.tab.wait_for_timeout(100)
        tab.press("take")
        tab.wait(lambda text: "1 view and 0 landmarks kept" in text)
        tab.press("save")
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
        tab.calyx("B").click()
        tab.wait(lambda text: text.startswith("Calyx B."))
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
