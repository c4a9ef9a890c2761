"""A running session with its page, a browser, and a tab on the page: one of each a file."""

import threading
from contextlib import contextmanager
from functools import partial

import pytest
from browsing import PATIENCE_S, Tab, chromium

from ursnav_torch.devices import RobotLight
from ursnav_torch.navigation import Navigator, run_navigation
from ursnav_torch.page import web_page
from ursnav_torch.session import build_rig
from ursnav_torch.simulation import SimulatedGrblRobot, TwinCamera, TwinPilot, World, make_twin
from ursnav_torch.tracking.tracker import Tracker


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


@pytest.fixture(scope="module")
def browser():
    """One Chromium a file."""
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def tab(browser, page):
    return Tab(browser, page.url)
