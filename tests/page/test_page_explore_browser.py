"""The page to fly through a kidney by hand, in a real browser."""

import time

import cv2
import numpy as np
from browsing import BROWSED, PATIENCE_S, Tab, serious

from ursnav_torch.kidney import read_calyces
from ursnav_torch.page import ExplorePage
from ursnav_torch.vid import read_views

pytestmark = BROWSED


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
