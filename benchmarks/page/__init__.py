"""The live page beside navigation: how often does a browser on the same machine show a new state, and at what price?

    python -m benchmarks.page                              # the phantom, a minute without and a minute with a browser
    python -m benchmarks.page vid=my_vid record=my_session seconds=30

A recorded flight is fed at the camera's rate to `Navigator` with its page served, first while nobody looks, then with
headless Chromium, which draws the kidney by software on the same cores. What the browser shows is read in the browser,
at every frame that it draws: the number of the state, the status line, and the number of the picture's state.
"""

import shutil
import sys
import tempfile
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.navigation import SETTINGS as FLIGHT
from benchmarks.navigation import at_rate, prepare
from benchmarks.shared.results import Report, overrides
from ursnav_torch.devices import Frame
from ursnav_torch.navigation import WORDS, NavigationState, Navigator
from ursnav_torch.page import LivePage
from ursnav_torch.session import SessionControls

SETTINGS = {k: v for k, v in FLIGHT.items() if k != "minutes"} | {"seconds": 60.0, "screenshot": ""}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
#: Seconds that a page has to open, and then to settle before anything counts.
PATIENCE_S, SETTLE_S, FOREVER_S = 60.0, 5.0, 1e9
#: At every frame drawn: when, which state, what the status line says, which picture; frames apart are counted.
WATCH = """() => {
  window.seen = []; window.pictures = []; window.frames = 0;
  const look = () => {
    const text = document.querySelector(".ursnav-latency"), line = document.querySelector(".ursnav-status");
    const state = text ? +text.dataset.state : -1, last = window.seen.at(-1);
    const picture = +(document.getElementById("picture").dataset.state ?? -1);
    window.frames += 1;
    if (picture >= 0 && window.pictures.at(-1)?.[1] !== picture) window.pictures.push([Date.now() / 1e3, picture]);
    if (state >= 0 && (!last || last[1] !== state)) window.seen.push([Date.now() / 1e3, state, line.innerText]);
    requestAnimationFrame(look);
  };
  look();
}"""


@dataclass(slots=True)
class Beside:
    """What was measured for a while.

    Attributes:
        seconds: for how long.
        states: every state published in it, by version, with the wall clock's time.
        located: poses.
        latency_ms: picture to pose.
        seen: in the browser: wall clock's time, version, status line; once for every state shown.
        pictures: of the scope, shown in the browser: wall clock's time, version of the state that it came with.
        drawn: frames that the browser drew.
    """

    seconds: float
    states: dict[int, tuple[float, NavigationState]]
    located: int
    latency_ms: list[float]
    seen: list[tuple[float, int, str]] = field(default_factory=list)
    pictures: list[tuple[float, int]] = field(default_factory=list)
    drawn: int = 0


def main(arguments: list[str]) -> None:
    """Measure, print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    torch.set_num_threads(1)
    report = Report("page", settings)
    with tempfile.TemporaryDirectory() as folder:
        navigator, frames = prepare(settings, Path(folder))
        with _navigating(navigator, frames, settings["rate_hz"]):
            _measure(report, navigator, settings)
    report.finish(settings["out"])


def _measure(report: Report, navigator: Navigator, settings: dict[str, Any]) -> None:
    page = LivePage(navigator, SessionControls(lambda: None), port=0)
    seconds = settings["seconds"]
    try:
        time.sleep(SETTLE_S)
        alone = _watch(navigator, seconds, time.sleep)
        with _tab(page.url) as tab:
            tab.wait_for_timeout(1e3 * SETTLE_S)
            tab.evaluate(WATCH)
            both = _watch(navigator, seconds, lambda s: tab.wait_for_timeout(1e3 * s))
            both.seen, both.drawn = [tuple(row) for row in tab.evaluate("window.seen")], tab.evaluate("window.frames")
            both.pictures = [tuple(row) for row in tab.evaluate("window.pictures")]
            if settings["screenshot"]:
                tab.screenshot(path=settings["screenshot"])
    finally:
        page.close()
    flight = f"{len(navigator.vid)} views, {settings['rate_hz']:g} pictures a second for {seconds:g} s"
    _add_navigation(report, f"page served, no browser; {flight}", alone)
    _add_navigation(report, f"Chromium beside it; {flight}", both)
    _add_browser(report, f"Chromium beside it; {flight}", both)


def _watch(navigator: Navigator, seconds: float, wait: Callable[[float], None]) -> Beside:
    """Note every state that is published for a while."""
    states: dict[int, tuple[float, NavigationState]] = {}
    end, begun, located = threading.Event(), time.monotonic(), navigator.located

    def note() -> None:
        version = navigator.bus.latest().version
        while not end.is_set():
            state = navigator.bus.wait(version, 0.1)
            if state is not None:
                version, states[state.version] = state.version, (time.time(), state)

    navigator.latencies.clear()
    thread = threading.Thread(target=note)
    thread.start()
    wait(seconds)
    passed, latency = time.monotonic() - begun, [1e3 * x.total_s for x in list(navigator.latencies)]
    end.set()
    thread.join()
    return Beside(passed, states, navigator.located - located, latency)


def _add_navigation(report: Report, group: str, found: Beside) -> None:
    """Poses, latency and effort."""
    total = found.latency_ms
    effort = np.array([state.effort for _, state in found.states.values()])
    report.add(group, "picture to pose", "ms", total)
    report.add(group, "picture to pose, 95th percentile", "ms", [float(np.percentile(total, 95))], n=len(total))
    report.add(group, "poses a second", "1/s", [found.located / found.seconds], n=found.located)
    for level, words in enumerate(WORDS):
        said = [words in state.status for _, state in found.states.values() if state.effort == level]
        if level == 0 or said:
            note = f"the status line said so in {100 * np.mean(said):.0f} % of them" if level else ""
            share = 100.0 * float(np.mean(effort == level))
            report.add(group, f"states at effort level {level}", "%", [share], note, n=len(effort))


def _add_browser(report: Report, group: str, found: Beside) -> None:
    """What the browser showed, and how late."""
    report.add(group, "states shown by the browser", "1/s", [len(found.seen) / found.seconds], n=len(found.seen))
    apart = 1e3 * np.diff([t for t, _, _ in found.seen])
    report.add(group, "from one state shown to the next", "ms", apart.tolist())
    report.add(group, "the same, 95th percentile", "ms", [float(np.percentile(apart, 95))], n=len(apart))
    late = [1e3 * (t - published) for t, (published, _) in _published(found, [(t, v) for t, v, _ in found.seen])]
    _add_late(report, group, "states, from the bus to a frame drawn in the browser", late)
    pictures = [(t, state.frame) for t, (_, state) in _published(found, found.pictures)]
    late = [1e3 * (t - frame.stamp.t_wall_s) for t, frame in pictures if frame is not None]
    _add_late(report, group, "scope's pictures, from the camera to a frame drawn in the browser", late)
    lines = {t: line for t, _, line in found.seen}
    shown = _published(found, [(t, v) for t, v, _ in found.seen])
    slow = [WORDS[state.effort] in lines[t] for t, (_, state) in shown if state.effort]
    if slow:
        said = 100.0 * float(np.mean(slow))
        report.add(group, "eased states of which the browser's status line said so", "%", [said], n=len(slow))
    report.add(group, "scope's pictures shown", "1/s", [len(found.pictures) / found.seconds], n=len(found.pictures))
    report.add(group, "frames drawn by the browser", "1/s", [found.drawn / found.seconds], n=found.drawn)


def _add_late(report: Report, group: str, what: str, late_ms: list[float]) -> None:
    """How late something was: the middle, and the worst of the second half, which tells whether a queue grows."""
    report.add(group, what, "ms", late_ms)
    half = late_ms[len(late_ms) // 2 :]
    report.add(group, f"{what}, latest of the second half", "ms", [max(half, default=float("nan"))], n=len(half))


def _published(found: Beside, shown: list[tuple[float, int]]) -> list[tuple[float, tuple[float, NavigationState]]]:
    """When each version was shown, with when its state was published and the state.

    Of states in quick succession the noting thread may see the last one alone: the one noted before counts.
    """
    noted = sorted(found.states)
    return [(t, found.states[noted[bisect_right(noted, v) - 1]]) for t, v in shown if noted and v >= noted[0]]


@contextmanager
def _navigating(navigator: Navigator, frames: list[Frame], rate_hz: float) -> Iterator[None]:
    """Feed pictures at the camera's rate, forth and back, for as long as the block lasts."""
    end = threading.Event()

    def feed() -> None:
        for frame in at_rate(frames, rate_hz, FOREVER_S):
            if end.is_set():
                return
            navigator.take(frame)
            navigator.results()

    with navigator:
        for warm in frames[:15]:  # the first pictures of a process are slower
            navigator.take(warm)
            navigator.wait()
        thread = threading.Thread(target=feed)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()


@contextmanager
def _tab(url: str) -> Iterator[Any]:
    """The page, open in a headless browser."""
    from playwright.sync_api import sync_playwright

    program = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if program is None:
        sys.exit("There is no Chromium on this computer.")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=FLAGS)
        tab = browser.new_page(viewport={"width": 1300, "height": 900})
        tab.goto(url)
        tab.wait_for_selector("#strip button", timeout=1e3 * PATIENCE_S)
        yield tab
        browser.close()
