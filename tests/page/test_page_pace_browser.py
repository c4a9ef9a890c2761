"""What the page shows when: the kidney's drawing by simulated time, and messages where no frame is drawn."""

import itertools

import cv2
import numpy as np
import pytest
from browsing import BROWSED, chromium, eventually

from ursnav_torch.navigation import NavigationState
from ursnav_torch.page import PageServer
from ursnav_torch.page.live import state_values

pytest.importorskip("uvicorn")
pytestmark = BROWSED

#: For so many ms of simulated time drawings of so many ms each are asked for every 10 ms; tells when each began.
#: A cost of null is that of drawings that fail.
SIMULATED = """async ([url, lasts, cost, hurried]) => {
  const { paced } = await import(url);
  const begun = [], due = [];
  let now = 0;
  const later = (action, after) => due.push([now + after, action]);
  const clock = { now: () => now, later, frame: (action) => later(action, 0) };
  const draw = () => { begun.push(now); if (cost === null) throw Error("planted"); };
  const view = paced(draw, () => now >= begun.at(-1) + cost, clock);
  for (; now < lasts; now += 10) {
    if (hurried) view.askNow(); else view.ask();
    let ready;
    while ((ready = due.findIndex(([at]) => at <= now)) >= 0) {
      due.splice(ready, 1)[0][1]();
      for (let i = 0; i < 10; i++) await null;
    }
  }
  return begun;
}"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture
def server():
    server = PageServer("live.html", {}, {"/kidney.bin": ("text/plain", bytes)}, ("127.0.0.1", 0))
    yield server
    server.stop()


@pytest.fixture
def simulated(browser, server):
    """Call `SIMULATED` in a page of ours."""
    tab = browser.new_page()
    tab.goto(f"{server.url}/static/icon.svg")
    yield lambda *given: tab.evaluate(SIMULATED, [f"{server.url}/static/pace.js", *given])
    tab.close()


@pytest.mark.parametrize("cost", [10, 40, 200, 1000])
def test_drawing_takes_a_share_of_the_time_whatever_it_costs(simulated, cost):
    begun = simulated(60_000, cost, False)
    share = len(begun) * cost / 60_000
    assert 0.1 <= share <= 0.25 and len(begun) >= 10


def test_what_a_hand_turns_is_drawn_at_once_and_never_two_at_a_time(simulated):
    begun = simulated(2_000, 200, True)
    apart = [b - a for a, b in itertools.pairwise(begun)]
    assert begun[0] <= 10 and all(200 <= gap <= 230 for gap in apart)


def test_a_drawing_that_is_never_done_is_not_waited_for_for_ever(simulated):
    begun = simulated(60_000, 1e9, False)
    apart = [b - a for a, b in itertools.pairwise(begun)]
    assert len(begun) >= 4 and all(3_000 <= gap <= 16_000 for gap in apart)


def test_a_drawing_that_fails_is_not_the_last(simulated):
    assert len(simulated(1_000, None, False)) > 10


#: A window that draws no frame, as that of a tab that nobody sees.
NO_FRAMES = "window.requestAnimationFrame = () => 0;"
#: A window that decodes its first picture when it is told to.
SLOW_PICTURE = """
const decode = window.createImageBitmap; let first = true;
window.createImageBitmap = (picture) => {
  if (!first) return decode(picture);
  first = false;
  return new Promise((done) => { window.decoded = () => done(decode(picture)); });
};"""


@pytest.fixture
def opened(browser, server):
    """Open the live page with a script of the test's own before those of the page."""
    tabs = []

    def open_with(script):
        tab = browser.new_page()
        tabs.append(tab)
        tab.add_init_script(script)
        tab.goto(server.url)
        return tab

    yield open_with
    for tab in tabs:
        tab.close()


ABOUT = dict.fromkeys(("robot", "drive", "by_itself", "pilot"), False) | {"duration_s": None, "calyces": []}


def said(version):
    """The values of a state whose status is its number."""
    return state_values(NavigationState(version=version, status=f"state {version}"), 0.0) | {"by_hand": False}


def test_a_page_that_draws_no_frames_shows_every_state_and_says_so(server, opened):
    tab = opened(NO_FRAMES)
    server.publish("about", **ABOUT)
    for version in range(3):
        server.publish("state", **said(version))
        eventually(lambda version=version: tab.text_content("#status") == f"state {version}")
    eventually(lambda: server.wanted("state"))


def test_a_picture_that_was_decoded_when_the_program_starts_anew_is_not_shown(server, opened):
    """The states of the program before have high numbers: none of the new one would be shown for minutes."""
    tab = opened(SLOW_PICTURE)
    server.publish("about", **ABOUT)
    picture = cv2.imencode(".jpg", np.zeros((9, 9), np.uint8))[1].tobytes()
    server.publish_picture("scope", picture, state=said(5000), width=9, height=9, edges=[], way=None)
    eventually(lambda: tab.evaluate("'decoded' in window"))
    server.stop()
    anew = PageServer("live.html", {}, {}, ("127.0.0.1", server.port))
    try:
        anew.publish("about", **ABOUT)
        anew.publish("replay", playing=False, at_s=7.0)
        eventually(lambda: tab.text_content("#time") == "7.0 s")
        tab.evaluate("window.decoded()")
        tab.wait_for_timeout(1000)
        anew.publish("state", **said(1))
        eventually(lambda: tab.text_content("#status") == "state 1")
        assert tab.get_attribute("#picture", "data-shown") is None
    finally:
        anew.stop()
