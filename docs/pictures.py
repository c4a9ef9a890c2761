"""Makes the pictures of the tour: python docs/pictures.py [DEMO]

DEMO is what ``ursnav demo out=DEMO`` and ``ursnav demo live out=DEMO`` made (``ursnav_demo`` when not given). Chromium
shows the pages, without a graphics card.
"""

import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ursnav_torch.localization import LEARNED_FROM, Localizer, simulated_queries
from ursnav_torch.navigation import Governor, Navigator, run_navigation
from ursnav_torch.navigation.flight_record import NEVER_LATE_S
from ursnav_torch.page import ExplorePage, web_page
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.reports import draw_edges, draw_overview
from ursnav_torch.reports.session import write_session_report
from ursnav_torch.session import Replay
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import PlanSettings, Vid, load_vid

OUT = Path(__file__).parent / "tour"
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
#: Side of a picture in a sheet, and the gap between two, px.
SIDE_PX, GAP_PX = 240, 8
GREEN, ORANGE = (60, 230, 60), (40, 160, 255)
#: Seconds that a page has to draw itself.
SETTLE_S = 12.0


def main(demo: Path) -> None:
    """Make all ten."""
    OUT.mkdir(exist_ok=True)
    vid = load_vid(demo.with_name(demo.name + "_vid"))
    drawn(vid)
    session = demo.with_name(demo.name + "_live") / "session"
    with browser() as open_tab:
        shown(open_tab, "6_gallery", (demo / "report" / "index.html").absolute().as_uri(), 3.0)
        report = write_session_report(vid, Replay(session, speed=0), session.parent / "report.html")
        shown(open_tab, "9_report", report.absolute().as_uri(), 3.0)
        on_record(open_tab, vid, session)
        explore = ExplorePage(vid, None, port=0)
        explore.go_to(vid.kidney.calyces[2].name)
        shown(open_tab, "10_explore", explore.url, SETTLE_S)
        explore.close()


def drawn(vid: Vid) -> None:
    """The pictures that need no browser."""
    kept("1_kidney", sheet([draw_overview(vid.kidney, 480, side).picture for side in (False, True)], 480))
    rows = [int(np.flatnonzero(vid.calyx == i)[k]) for i in range(3) for k in (2, 12, 30, 50)]
    kept("2_views", sheet([vid.read_picture(row) for row in rows], SIDE_PX, columns=4))
    plan = PlanSettings(views_per_calyx=8, passage_views=0, seed=11)
    queries = list(simulated_queries(vid, RaycastRenderer, plan, np.random.default_rng(11), LEARNED_FROM))
    kept("3_pictures", sheet([q.image for q in queries[4:12]], SIDE_PX, columns=4))
    localizer = Localizer(vid)
    query = queries[1]
    location = localizer.locate(query.image)
    relief = location.features.fields[0].numpy()
    gray = np.clip(127 + 90 * relief / max(float(np.abs(relief).max()), 1e-9), 0, 255).astype(np.uint8)
    edges = draw_edges(query.image, location.features.edges, GREEN)
    kept("4_features", sheet([query.image, gray, edges], SIDE_PX + 80))
    views = [vid.read_picture(c.view) for c in location.candidates[:3]]
    place = draw_overview(vid.kidney, 480).with_camera(location.T_kidney_camera, vid.camera.fov_deg or 90.0)
    kept("5_match", sheet([edges, *views, place], SIDE_PX))


def on_record(open_tab: Callable[[str], Any], vid: Vid, session: Path) -> None:
    """The live page on a record whose every picture is followed, at two moments."""
    found, ready = [], threading.Event()

    @contextmanager
    def page(navigator: Any, controls: Any) -> Iterator[None]:
        with web_page(navigator, controls, port=0) as live:
            found.append(live)
            ready.set()
            yield

    navigator = Navigator(Tracker(vid), governor=Governor(NEVER_LATE_S))
    thread = threading.Thread(target=partial(run_navigation, navigator, Replay(session, speed=0), page=page))
    thread.start()
    ready.wait(60)
    player = found[0].controls.player
    player.pause()
    tab = open_tab(found[0].url)
    tab.wait_for_selector("#strip button")
    whole_s = player.duration_s
    for name, share in (("7_live", 0.45), ("8_replay", 0.8)):
        player.play()
        while player.position_s < share * whole_s:
            tab.wait_for_timeout(100)
        player.pause()
        tab.wait_for_timeout(1e3 * SETTLE_S)
        tab.screenshot(path=OUT / f"{name}.png")
    tab.close()
    player.stop()
    thread.join()
    for name in ("7_live", "8_replay"):
        as_webp(name)


@contextmanager
def browser() -> Iterator[Callable[[str], Any]]:
    """What opens a page in headless Chromium."""
    from playwright.sync_api import sync_playwright

    program = next(found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name)))
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=program, args=FLAGS)

        def open_tab(url: str) -> Any:
            tab = chromium.new_page(viewport={"width": 1280, "height": 720})
            tab.set_default_timeout(180e3)
            tab.goto(url)
            return tab

        yield open_tab
        chromium.close()


def shown(open_tab: Callable[[str], Any], name: str, url: str, seconds: float) -> None:
    """A page as it looks after some seconds."""
    tab = open_tab(url)
    tab.wait_for_timeout(1e3 * seconds)
    tab.screenshot(path=OUT / f"{name}.png")
    tab.close()
    as_webp(name)


def sheet(pictures: list[np.ndarray], side_px: int, columns: int = 0) -> np.ndarray:
    """Pictures side by side, in rows of some columns (0: one row)."""
    columns = columns or len(pictures)
    colored = [p if p.ndim == 3 else cv2.cvtColor(p, cv2.COLOR_GRAY2BGR) for p in pictures]
    tiles = [cv2.resize(p, (side_px, side_px), interpolation=cv2.INTER_AREA) for p in colored]
    tiles = [cv2.copyMakeBorder(t, 0, GAP_PX, 0, GAP_PX, cv2.BORDER_CONSTANT, value=(255, 255, 255)) for t in tiles]
    return np.vstack([np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)])


def kept(name: str, picture: np.ndarray) -> None:
    """Write a picture to the tour's folder."""
    cv2.imwrite(str(OUT / f"{name}.webp"), picture, [cv2.IMWRITE_WEBP_QUALITY, 80])


def as_webp(name: str) -> None:
    """Keep a screenshot smaller."""
    png = OUT / f"{name}.png"
    kept(name, cv2.imread(str(png)))
    png.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "ursnav_demo"))
