"""The pages in a browser without WebGL: the longest words fit, and where no kidney is drawn the pane says so."""

from dataclasses import replace

import pytest
from browsing import BROWSED, CUT_OFF, Tab, chromium, eventually

from ursnav_torch.navigation import NavigationState, Navigator
from ursnav_torch.page import ExplorePage, PageServer
from ursnav_torch.page.live import state_values
from ursnav_torch.page.pictures import PagePictures, jpeg
from ursnav_torch.page.scene import kidney_bytes
from ursnav_torch.tracking.tracker import Tracker

pytestmark = BROWSED

#: All remarks at once, and what is usual on a slow machine.
LONGEST = (
    "In calyx A or B, fairly sure. 3 of 6 inspected. Next: D, 132 mm, pull back 112 mm. 13 stones found. "
    "No new picture. The robot is stopped. By itself: approaching: D. Slow machine: refining and searching less."
)
USUAL = "In calyx C, sure. 3 of 6 inspected. Next: D, 32 mm, bend right. Slow machine: refining and searching less."
SMALL = "document.getElementById('status').classList.contains('small')"
UNDRAWN = "The kidney is not drawn: this browser has no WebGL."


@pytest.fixture(scope="module")
def browser():
    with chromium("--no-sandbox", "--disable-gpu", "--disable-software-rasterizer") as browser:
        yield browser


@pytest.fixture(scope="module", params=[False, True], ids=["live", "record"])
def shown(request, vid, browser):
    """A tab on a page that nothing runs behind, and a function that shows a state with other words there."""
    kidney, pictures, record = vid.kidney, PagePictures(vid), request.param
    patch_of_face = Navigator(Tracker(vid)).patch_of_face
    resources = {"/kidney.bin": ("application/octet-stream", lambda: kidney_bytes(kidney, patch_of_face))}
    resources |= {f"/calyx/{i}.jpg": ("image/jpeg", lambda: jpeg(pictures.thumbnail(0))) for i in range(6)}
    server = PageServer("live.html", {}, resources, ("127.0.0.1", 0))
    names = [calyx.name for calyx in kidney.calyces]
    controls = dict.fromkeys(("robot", "drive", "by_itself", "pilot"), not record)
    server.publish("about", **controls, duration_s=5000.0 if record else None, calyces=names)
    server.publish("replay", playing=False, at_s=4321.5)
    row = {"calyx": "B", "size": 16.1, "sd": 0.6, "state": "there", "known": "", "at": kidney.pelvis_mm.tolist()}
    server.publish("stones", stones=[row | {"number": i + 1} for i in range(9)])
    tab, version = Tab(browser, server.url), iter(range(1000))

    def show(status):
        state = NavigationState(
            version=next(version), robot="stopped", autonomy="approaching: D", calyx="A", status=status
        )
        late = replace(state.latency, **dict.fromkeys(("total_s", "waiting_s", "features_s", "tracking_s"), 1.234))
        values = state_values(replace(state, T_kidney_camera=vid.T_kidney_camera[3], latency=late), 12.3)
        whole = [
            [name, "", verdict, 1.0] for name, verdict in zip(names, 3 * ["inspected", "out of reach"], strict=True)
        ]
        server.publish("state", **values | {"coverage": whole, "by_hand": True, "notice": "No picture since 2.0 s."})
        tab.wait(lambda text: text == status)

    yield tab, show
    assert (tab.errors, tab.foreign) == ([], [])
    tab.tab.close()
    server.stop()


@pytest.mark.parametrize("size", [(1280, 720), (1300, 900), (1920, 1080)])
def test_the_longest_words_are_not_cut_off(shown, size):
    tab, show = shown
    tab.tab.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    tops = []
    for status in ("Searching for the place.", USUAL, LONGEST):
        show(status)
        assert tab.tab.evaluate(CUT_OFF) == []
        tops.append(tab.tab.locator("#status").bounding_box())
    letters = "parseFloat(getComputedStyle(document.getElementById('status')).fontSize)"
    small = tab.tab.evaluate(letters)
    show(USUAL)
    assert tab.tab.evaluate(letters) >= 0.029 * size[1] > small, "only what would not fit is small"
    assert tops[0] == tops[1] == tops[2], "a second line moves nothing"


def test_words_that_stay_fit_a_window_of_another_size(shown):
    tab, show = shown
    tab.tab.set_viewport_size({"width": 1920, "height": 720})
    show(LONGEST)
    assert not tab.tab.evaluate(SMALL)
    tab.tab.set_viewport_size({"width": 1000, "height": 720})
    eventually(lambda: tab.tab.evaluate(SMALL))


def test_the_pane_says_that_no_kidney_is_drawn_and_the_rest_goes_on(shown):
    tab, show = shown
    eventually(lambda: tab.text("kidney").startswith(UNDRAWN))
    show("In calyx A, sure.")
    assert tab.tab.locator("[data-shows=cloud]").is_disabled()
    for key in ("c", "+", "ArrowLeft"):  # what would turn the kidney
        tab.tab.keyboard.press(key)
    assert tab.tab.locator("[data-shows=cloud]").get_attribute("aria-pressed") == "false"
    tab.tab.keyboard.press("e")
    assert tab.tab.locator("[data-shows=edges]").get_attribute("aria-pressed") == "false"
    tab.tab.keyboard.press("e")


def test_exploring_by_hand_goes_on_without_the_kidneys_drawing(vid, browser, tmp_path):
    page = ExplorePage(vid, tmp_path / "kept", port=0)
    try:
        tab = Tab(browser, page.url)
        eventually(lambda: tab.text("kidney").startswith(UNDRAWN))
        tab.press("go")
        tab.wait(lambda text: text.startswith("Calyx A."))
        assert tab.tab.locator("#picking").is_disabled() and tab.errors == []
        tab.tab.close()
    finally:
        page.close()
