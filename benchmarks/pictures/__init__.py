"""The README's pictures: a screenshot of the page and a short loop, made in headless Chromium from a phantom's flight.

    python -m benchmarks.pictures                      # docs/navigation.png and docs/navigation.webp
    python -m benchmarks.pictures vid=my_vid shots=20 out=/tmp/pictures

Needs a Chromium on this computer and the extra dev. The flight is drawn with the thesis's simulated camera faults,
navigated picture by picture, and the page is photographed along the way.
"""

import io
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from benchmarks.navigation import SETTINGS as FLIGHT
from benchmarks.navigation import phantom_vid, record_flight
from benchmarks.shared.results import overrides
from ursnav_torch.navigation import Governor, Navigator, run_navigation
from ursnav_torch.page import LivePage, web_page
from ursnav_torch.session import Replay, SessionControls
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import load_vid

SETTINGS = {"vid": "", "shots": 14, "pictures_a_shot": 26, "width": 960, "quality": 55, "out": "docs"}
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
LARGEST_BYTES = 2_000_000


def main(arguments: list[str]) -> None:
    """Make the pictures."""
    settings = overrides(SETTINGS, arguments)
    torch.set_num_threads(1)
    flight = FLIGHT | {"flight_s": settings["shots"] * settings["pictures_a_shot"] / FLIGHT["rate_hz"]}
    with tempfile.TemporaryDirectory() as folder:
        vid = load_vid(settings["vid"]) if settings["vid"] else phantom_vid(flight, Path(folder) / "vid")
        record_flight(vid, Path(folder) / "record", flight)
        navigator = Navigator(Tracker(vid), governor=Governor(budget_s=60.0))  # a photograph may take its time
        shots: list[Image.Image] = []

        @contextmanager
        def page_of(navigator: Navigator, controls: SessionControls) -> Iterator[None]:
            with web_page(navigator, controls, port=0) as page:
                controls.player.pause()
                photographer = threading.Thread(target=_photograph, args=(page, settings, shots))
                photographer.start()
                yield
                photographer.join()

        run_navigation(navigator, Replay(Path(folder) / "record", speed=0), page=page_of)
    for path in _write(shots, settings):
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def _photograph(page: LivePage, settings: dict[str, Any], shots: list[Image.Image]) -> None:
    """Let the record go on a little, and take a picture of the page, again and again; then end the session."""
    from playwright.sync_api import sync_playwright

    player, navigator = page.controls.player, page.navigator
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            tab = browser.new_page(viewport={"width": 1280, "height": 720})
            tab.goto(page.url)
            tab.wait_for_selector("#strip button")
            time.sleep(3.0)
            for _ in range(settings["shots"]):
                located = navigator.located + settings["pictures_a_shot"]
                for _ in range(settings["pictures_a_shot"]):
                    player.step()
                until = time.monotonic() + 20
                while navigator.located < located and time.monotonic() < until:
                    time.sleep(0.02)
                tab.wait_for_timeout(2000)  # the wall is painted once a second
                shots.append(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
            browser.close()
    finally:
        player.stop()


def _write(shots: list[Image.Image], settings: dict[str, Any]) -> list[Path]:
    """The last screenshot as PNG, and all of them as a loop that stays below 2 MB."""
    out = Path(settings["out"])
    out.mkdir(parents=True, exist_ok=True)
    still, loop = out / "navigation.png", out / "navigation.webp"
    shots[-1].quantize(128).save(still, optimize=True)
    size = settings["width"], round(settings["width"] * shots[0].height / shots[0].width)
    small = [shot.resize(size, Image.Resampling.LANCZOS) for shot in shots]
    for quality in range(settings["quality"], 10, -10):
        small[0].save(loop, save_all=True, append_images=small[1:], duration=250, loop=0, quality=quality, method=4)
        if loop.stat().st_size < LARGEST_BYTES:
            break
    return [still, loop]
