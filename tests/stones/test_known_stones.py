"""Stones of a scan beside those that were seen: found, not yet found, new; and in words and files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.columns import STONE_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.stones import (
    GONE,
    THERE,
    FoundStone,
    KnownStone,
    compare_stones,
    read_known_stones,
    stone_sentences,
    write_stones,
)
from ursnav_torch.tables import read_csv


def seen(number: int, at: np.ndarray, size: float, calyx: int = 0, state: str = THERE) -> FoundStone:
    return FoundStone(number, calyx, np.asarray(at, float), 0.01 * np.eye(3), size, 0.4, 7, 0.99, state, 3)


def test_each_known_stone_is_one_seen_at_most() -> None:
    known = [KnownStone("a", np.zeros(3), 5.0), KnownStone("b", np.array([30.0, 0, 0]), 4.0)]
    found = compare_stones([seen(1, [1, 0, 0], 5.5), seen(2, [0, 2.5, 0], 2.0), seen(3, [0, 60, 0], 3.0)], known)
    assert found.known == ("a", "", "") and [k.name for k in found.not_found] == ["b"]


def test_words_say_pole_size_and_what_is_gone(phantom: Kidney) -> None:
    name, pole = phantom.calyces[0].name, phantom.calyces[0].pole
    stones = [seen(1, [0, 0, 0], 6.1), seen(2, [9, 0, 0], 3.0), seen(3, [0, 9, 0], 4.0, -1, GONE)]
    words = " ".join(stone_sentences(compare_stones(stones, []), phantom))
    assert f"2 stones in the {pole} pole: 6.1 ± 0.4 mm in {name}, 3.0 ± 0.4 mm in {name}." in words
    assert "gone: 4.0 ± 0.4 mm." in words and f"above 2 mm: {name} 2." in words and "new" not in words
    assert stone_sentences(compare_stones([], []), phantom) == ["No stone seen."]


def test_fragments_are_counted_a_calyx_and_not_listed(phantom: Kidney, tmp_path: Path) -> None:
    name, other = (phantom.calyces[i].name for i in (0, 3))
    small = [seen(1, [0, 0, 0], 1.9), seen(3, [0, 9, 0], 1.4), seen(4, [0, 0, 9], 1.5, 3)]
    gone = seen(5, [0, 0, -9], 1.5, 3, GONE)
    fragments = [replace(s, is_fragment=True) for s in (*small, gone)]
    stones = compare_stones([fragments[0], seen(2, [9, 0, 0], 3.0), *fragments[1:]], [])
    assert [s.number for s in stones.seen] == [2] and [s.number for s in stones.fragments] == [1, 3, 4]
    assert stone_sentences(stones, phantom)[1:] == [
        f"Stones and fragments above 2 mm: {name} 1.",
        f"Fragments up to 2 mm: {name} 2, {other} 1.",
    ]
    larger = stone_sentences(stones, replace(phantom, scale=1.8))
    assert larger[1].startswith("Fragments up to 3.6 mm") and "above" not in " ".join(larger), "sizes are this kidney's"
    write_stones(tmp_path / "t.csv", stones, phantom)
    assert [row["stone"] for row in read_csv(tmp_path / "t.csv", STONE_COLUMNS, "stones")] == ["2"]


def test_a_small_stone_that_the_scan_showed_is_listed() -> None:
    small = replace(seen(1, [0.5, 0, 0], 1.6), is_fragment=True)
    stones = compare_stones([small], [KnownStone("a", np.zeros(3), 1.5)])
    assert [s.number for s in stones.seen] == [1] and stones.known == ("a",) and not stones.fragments


def test_the_table_holds_what_was_seen_and_what_was_not(phantom: Kidney, tmp_path: Path) -> None:
    stones = compare_stones([seen(1, [1, 2, 3], 6.1)], [KnownStone("far", np.array([99.0, 0, 0]), 4.0)])
    write_stones(tmp_path / "t.csv", stones, phantom)
    first, second = read_csv(tmp_path / "t.csv", STONE_COLUMNS, "stones")
    assert (first["calyx"], first["size_mm"], first["state"]) == (phantom.calyces[0].name, "6.1", THERE)
    assert (second["known"], second["state"], second["pictures"]) == ("far", "not found", "0")


def test_known_stones_have_names_and_sizes(tmp_path: Path) -> None:
    path = tmp_path / "known.csv"
    path.write_text("stone,x_mm,y_mm,z_mm,size_mm\n1,0,0,0,5\n1,4,0,0,5\n")
    with pytest.raises(InputError, match="line 3: stone '1' of 5 mm; every stone has a name of its own"):
        read_known_stones(path)
    path.write_text("stone,x_mm,y_mm,z_mm,size_mm\n1,0,0,0,0\n")
    with pytest.raises(InputError, match="a size above 0"):
        read_known_stones(path)
