"""The page in a real browser, headless, while a simulated scope explores the phantom."""

import re
import time
from dataclasses import replace

import numpy as np
from browsing import BROWSED, PATIENCE_S, Tab, eventually

from ursnav_torch.devices import OperatorInput
from ursnav_torch.page import web_page
from ursnav_torch.session import HOLD
from ursnav_torch.session.console import Console

pytestmark = BROWSED


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
        if "stopped" in text or "acknowledge once more" in tab.text("notice-robot"):
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


def test_closing_and_opening_the_page_again_loses_nothing(tab, browser, page):
    before, path = tab.text("strip"), len(page.navigator.bus.latest().path_mm)
    tab.tab.close()
    located = page.navigator.located
    time.sleep(1.0)
    again = Tab(browser, page.url)
    again.wait(lambda text: text.count("%") == 6, "strip")
    shares = [[int(v) for v in re.findall(r"(\d+) %", text)] for text in (before, again.text("strip"))]
    assert all(b >= a for a, b in zip(*shares, strict=True)), shares
    assert len(page.navigator.bus.latest().path_mm) >= path and page.navigator.located > located
    eventually(lambda: draws_the_kidney(again))
    assert (tab.errors, again.errors) == ([], [])
    assert (tab.foreign, again.foreign) == ([], [])
    again.tab.close()


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
