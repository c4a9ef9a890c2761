"""The pages in a real browser, headless: a tab, what goes wrong in it, and which of its words are cut off."""

import re
import shutil
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE_S = 180.0
#: Marks of a file of tests that need a browser.
BROWSED = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this computer")]
#: Of what says something in words, what does not fit: its text, its widths (whole, seen) and its heights.
CUT_OFF = """() => {
  const said = "#status, #tag, #words, #robot, #notice, #notice-robot, #stones li, #time, .share, .verdict";
  return [...document.querySelectorAll(`${said}, .side button, .foot div`)]
    .filter((e) => e.checkVisibility() && !e.matches(".replay, .when"))
    .map((e) => [e.textContent, e.scrollWidth, e.clientWidth, e.scrollHeight, e.clientHeight,
                 e.matches("#status, .keep")])
    .filter(([, wide, width, high, height, wraps]) => wide > width || (wraps && high > height));
}"""


@contextmanager
def chromium(*flags):
    """A headless browser; without flags one that draws in three dimensions without a graphics card."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(flags) or FLAGS)
        yield browser
        browser.close()


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
        self.wait(lambda text: "%" in text, "strip")  # the calyces come before the first state

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
