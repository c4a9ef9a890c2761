"""What the page of `match` says: right, wrong and unsure, in words, filters and colors."""

import re

import jinja2
import numpy as np
import pytest

from ursnav_torch.reports.html import inline_picture, render_page
from ursnav_torch.reports.match_words import answer_words, filters_of, summary_words


def row(image: str, calyx: str = "B", accepted: bool = True, error: str = "", calyces: str = "B|C") -> dict:
    return {
        "image": image,
        "calyx": calyx,
        "accepted": accepted,
        "confidence": 0.97,
        "error": error,
        "calyces": calyces,
    }


ROWS = [
    (row("right.png"), "B", "yes", "sure right", "B or C"),
    (row("wrong.png"), "<A>", "no", "sure wrong", "B or C, wrong: it is <A>"),
    (row("lucky.png", accepted=False), "B", "unsure", "unsure right", "unsure, perhaps B or C"),
    (row("none.png", calyx="", calyces="none"), "B", "no", "sure wrong", "no calyx (passage), wrong: it is B"),
    (row("passage.png", calyx="", calyces=""), "", "yes", "sure right", "no calyx (passage)"),
    (row("unknown.png"), None, "yes", "sure", "B or C"),
    (row("black.png", error="all black"), "B", "no", "failed", "not located"),
]


@pytest.mark.parametrize(("cells", "truth", "tone", "states", "answer"), ROWS)
def test_an_answer_in_words(cells: dict, truth: str | None, tone: str, states: str, answer: str) -> None:
    found = answer_words(cells, truth)
    assert (found["tone"], found["states"], found["answer"]) == (tone, states, answer)
    assert found["calyces"] == cells["calyces"].replace("|", ", ")


def test_the_summary_counts_what_is_sure_and_what_is_right() -> None:
    said = summary_words([answer_words(cells, truth) for cells, truth, *_ in ROWS])
    assert said == (
        "5 are named surely, 1 with doubt, 1 could not be located. "
        "Of 6 whose calyx is known 3 are right; of the 4 sure ones 2."
    )
    assert "known" not in summary_words([answer_words(row("a"), None)])


def test_filters_offer_what_there_is_and_count_it() -> None:
    groups = {"": "passage", "A": "c0", "B": "c1"}
    entries = [answer_words(c, t) | {"group": groups[c["calyx"]]} for c, t, *_ in ROWS if not c["error"]]
    state, calyx = filters_of(entries, groups)
    assert {c["label"]: c["count"] for c in state["choices"]} == {
        "all": 6, "sure": 5, "unsure": 1, "right": 3, "wrong": 2,
    }  # fmt: skip
    assert [(c["value"], c["label"], c["count"]) for c in calyx["choices"]] == [
        ("", "all", 6), ("passage", "none", 2), ("c1", "B", 4),
    ]  # fmt: skip


def page(entries: list[dict]) -> str:
    filters = filters_of(entries, {"B": "c1"})
    return render_page(
        "matches.html.j2", title="T", summary="S", filters=filters, entries=entries, has_truth=True, has_sets=True
    )  # fmt: skip


def test_wrong_is_red_in_gallery_table_and_headline_and_names_are_escaped() -> None:
    entry = answer_words(row("<script>.png"), "<A>") | {"group": "c1", "figures": [], "others": []}
    text = page([entry])
    assert text.count('class="no"') == 3 and "yes" not in re.findall(r'class="(yes|no)"', text)
    assert "color: inherit" not in text, "the gallery shows the answer's color, too"
    assert "<script>" not in text and "&lt;script&gt;.png" in text and "wrong: it is &lt;A&gt;" in text
    assert text.index('class="gallery"') < text.index("<table>") < text.index("<article")


def test_a_name_that_a_template_needs_and_nobody_gave_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="is undefined"):
        render_page("matches.html.j2", title="T")


def test_pictures_lie_in_their_address() -> None:
    assert inline_picture(np.zeros((8, 8), np.uint8)).startswith("data:image/jpeg;base64,/9j/")
    assert inline_picture(b"\x89PNG\r\n").startswith("data:image/png;base64,iVBO")
