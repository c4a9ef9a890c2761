"""An exploration from end to end in simulated time, watched in a real browser."""

import re
import threading
import time
from contextlib import contextmanager

import pytest
from browsing import BROWSED, chromium
from small_explorations import explore_whole, small_vid

from ursnav_torch.page import web_page

PATIENCE_S = 300.0
#: Of every calyx on the strip: its name, whether it is the one headed for, and its verdict.
STRIP = """() => [...document.querySelectorAll("#strip button")].map((b) => [
  b.querySelector("b").textContent, b.getAttribute("aria-pressed") === "true",
  b.querySelector(".verdict").textContent,
])"""

pytestmark = BROWSED


@pytest.fixture(scope="module")
def watched(phantom, lens, tmp_path_factory):
    """The page of an exploration, which begins when somebody looks, and what it brought in the end."""
    vid = small_vid(phantom, lens, tmp_path_factory.mktemp("watched") / "vid")
    pages, brought, ready, looks = [], [], threading.Event(), threading.Event()

    @contextmanager
    def page_of(navigator, controls):
        with web_page(navigator, controls, port=0) as live:
            pages.append(live)
            ready.set()
            assert looks.wait(PATIENCE_S)
            yield

    session = threading.Thread(target=lambda: brought.append(explore_whole(vid, page=page_of)))
    session.start()
    assert ready.wait(PATIENCE_S)
    yield pages[0], looks, brought, session
    looks.set()
    pages[0].controls.stop()
    session.join(timeout=PATIENCE_S)
    assert not session.is_alive()


def test_a_whole_exploration_is_watched_until_every_calyx_is_inspected(watched):
    page, looks, brought, session = watched
    errors, said, headed_for, inspected = [], set(), set(), []
    with chromium() as browser:
        tab = browser.new_page(viewport={"width": 1000, "height": 700})
        tab.set_default_timeout(1e3 * PATIENCE_S)
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.goto(page.url)
        tab.wait_for_selector("#strip button")
        looks.set()
        until = time.monotonic() + PATIENCE_S
        while "By itself: finished: every calyx was visited." not in (text := tab.inner_text("#status")):
            assert time.monotonic() < until, f"the status still says {text!r}"
            said |= set(re.findall(r"By itself: ([a-z ]+):", text))
            strip = tab.evaluate(STRIP)
            headed_for |= {name for name, aimed, _ in strip if aimed}
            inspected.append(sum(verdict == "inspected" for _, _, verdict in strip))
            tab.wait_for_timeout(50)
        assert {"approaching", "retreating"} <= said, said
        assert len(headed_for) >= 2, f"the strip follows the calyx that it heads for, but showed {headed_for}"
        assert inspected[0] == 0 and {1, 2} & set(inspected) and inspected == sorted(inspected), inspected
        assert "All 3 inspected." in tab.inner_text("#status")
        strip = [re.sub(r"\s+", " ", text) for text in tab.locator("#strip button").all_inner_texts()]
        assert len(strip) == 3 and all("inspected" in text or "✓" in text for text in strip), strip
        assert errors == []
    page.controls.stop()
    session.join(timeout=PATIENCE_S)
    assert brought[0].explored.finished and {v.verdict for v in brought[0].explored.visits} == {"inspected"}
