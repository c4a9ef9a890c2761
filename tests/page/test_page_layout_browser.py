"""Where everything is on the live page, in a real browser: nothing overlaps, is cut off, or moves."""

import numpy as np
import pytest
from browsing import BROWSED, CUT_OFF, eventually, serious

pytestmark = BROWSED


@pytest.mark.parametrize("size", [(1280, 720), (1000, 900), (1920, 1080)])
def test_the_whole_kidney_is_in_the_middle_of_its_pane_and_fills_it(tab, vid, size):
    tab.tab.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    tab.tab.wait_for_timeout(500)
    pane, shown = tab.tab.locator("#kidney").bounding_box(), np.array(tab.screen(vid.kidney.mesh.vertices))
    low, high = (
        shown.min(0) - [pane["x"], pane["y"]],
        [pane["x"] + pane["width"], pane["y"] + pane["height"]] - shown.max(0),
    )
    margins, sides = np.stack([low, high]), np.array([pane["width"], pane["height"]])
    assert (margins > 0.02 * sides).all() and (margins.min(0) < 0.15 * sides).any()
    tab.tab.set_viewport_size({"width": 1300, "height": 900})


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)])
def test_the_scopes_picture_is_large_and_no_texts_overlap_or_are_cut_off(tab, size):
    width, height = size
    tab.tab.set_viewport_size({"width": width, "height": height})
    tab.tab.wait_for_timeout(500)
    box = tab.tab.locator(".scope").bounding_box()
    assert box["height"] >= 0.55 * height and abs(box["width"] - box["height"]) < 2
    texts = tab.tab.evaluate(TEXT_BOXES)
    assert len(texts) > 25
    for i, (name, *a) in enumerate(texts):
        assert a[0] >= -1 and a[1] >= -1 and a[2] <= width + 1, f"{name} is cut off by the page"
        for other, *b in texts[i + 1 :]:
            apart = a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1
            assert apart, f"{name!r} and {other!r} overlap"
    assert tab.tab.evaluate(CUT_OFF) == []
    assert tab.tab.evaluate(COVERED) == []
    tab.tab.set_viewport_size({"width": 1300, "height": 900})


#: What lies over a calyx's picture in the strip.
COVERED = """() => [...document.querySelectorAll("#strip li")].flatMap((item) => {
  const a = item.querySelector("img").getBoundingClientRect();
  return [...item.querySelectorAll("b, span")].filter((e) => {
    const b = e.getBoundingClientRect();
    return b.left < a.right - 1 && a.left < b.right - 1 && b.top < a.bottom - 1 && a.top < b.bottom - 1;
  }).map((e) => e.textContent);
})"""


#: Every text that is shown, with the box of what is visible of it: left, top, right, bottom.
TEXT_BOXES = """() => {
  const found = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const node = walk.currentNode, element = node.parentElement;
    if (!node.textContent.trim() || !element.checkVisibility() || element.closest("script, option")) continue;
    const range = document.createRange(); range.selectNodeContents(node);
    let { left, top, right, bottom } = range.getBoundingClientRect();
    for (let e = element; e; e = e.parentElement) if (getComputedStyle(e).overflow !== "visible") {
      const b = e.getBoundingClientRect();
      left = Math.max(left, b.left); top = Math.max(top, b.top);
      right = Math.min(right, b.right); bottom = Math.min(bottom, b.bottom);
    }
    if (right > left && bottom > top) found.push([node.textContent.trim(), left, top, right, bottom]);
  }
  return found;
}"""


def test_axe_finds_nothing_serious_on_the_live_page(tab, page, browser):
    with tab.elsewhere():
        assert serious(page.url, browser) == []


def test_nothing_moves_while_the_words_change(tab):
    tab.tab.reload()
    tab.tab.wait_for_selector("#strip button")
    tab.tab.evaluate(
        "window.shift = 0; new PerformanceObserver((l) => l.getEntries().forEach((e) => { window.shift += e.value; }))"
        ".observe({ type: 'layout-shift', buffered: true })"
    )
    seen = set()
    for _ in range(20):
        seen.add(tuple(tab.tab.locator("#end").bounding_box().values()))
        tab.tab.wait_for_timeout(200)
    assert len(seen) == 1 and tab.tab.evaluate("window.shift") <= 0.01


#: Where everything is that has a place of its own: left, top, width, height. A tag is as wide as its words.
BOXES = """() => [...document.querySelectorAll("button, h2, canvas, ul, nav, .keep, summary")]
  .filter((e) => e.checkVisibility()).map((e) => { const b = e.getBoundingClientRect();
    return [b.x, b.y, b.width, b.height]; })"""


def test_stones_are_listed_and_drawn_and_move_nothing(tab, page):
    lines = tab.tab.locator("#stones li")
    assert lines.all_inner_texts() == ["none yet"]
    places = tab.tab.evaluate(BOXES)
    row = {
        "calyx": "B",
        "size": 6.1,
        "sd": 0.6,
        "state": "there",
        "known": "",
        "at": page.navigator.vid.kidney.pelvis_mm.tolist(),
    }
    rows = [row | {"number": i + 1} for i in range(9)]
    rows[1] |= {"state": "gone", "calyx": "a calyx with quite a long name", "known": "S1"}
    page.server.publish("stones", stones=rows)
    eventually(lambda: lines.count() == 9)
    assert lines.nth(0).inner_text() == "1 · B · 6.1 ± 0.6 mm · there" and "gone · S1" in lines.nth(1).inner_text()
    eventually(lambda: tab.tab.get_attribute("#kidney canvas", "data-stones") == "9")
    assert len(places) > 25 and tab.tab.evaluate(BOXES) == places, "the list is as high with nine stones as with none"
    page.server.publish("stones", stones=[])
    eventually(lambda: lines.all_inner_texts() == ["none yet"])
    assert tab.errors == []
