"""Which calyces are taken for which, and within what distance that ends."""

import numpy as np
import pytest

from ursnav_torch.localization.ambiguity import LookAlikes, find_look_alikes


def found() -> LookAlikes:
    """Ten pictures of A, of which the three farthest are taken for B; two of B, one of no calyx, one of nothing."""
    shown = np.array([0] * 10 + [1, 1, -1, -2])
    answered = np.array([0] * 7 + [1] * 3 + [1, -1, 0, 1])
    far = np.array([*np.arange(1.0, 11.0), 2.0, 3.0, np.nan, np.nan])
    return find_look_alikes(shown, answered, far, 2)


def test_rows_are_what_is_shown_and_columns_what_is_answered() -> None:
    assert found().counts.tolist() == [[7, 3, 0], [0, 1, 1], [1, 0, 0]]  # nothing is passed over, no calyx is last


def test_within_the_distance_no_picture_was_taken_for_the_other() -> None:
    within = found().within_mm
    assert within[0, 1] == 8.0 and np.isnan(within[1, 0]) and np.isnan(within[0, 0])


def test_a_sentence_says_so_and_survives_the_file() -> None:
    again = LookAlikes.from_dict(found().to_dict())
    assert again.sentences(["A", "B"]) == [
        "A is taken for B in 3 of 10 simulated pictures (30%); within 8 mm of A's tip in none: approach it."
    ]


def test_few_confusions_are_not_worth_a_sentence_and_those_at_any_distance_say_so() -> None:
    shown, far = np.zeros(40, int), np.arange(40.0)
    one = find_look_alikes(shown, np.where(np.arange(40) == 39, 1, 0), far, 2)
    assert one.counts[0, 1] == 1 and one.sentences(["A", "B"]) == []
    near = find_look_alikes(shown, np.where(np.arange(40) % 4 == 0, 1, 0), far, 2)
    assert near.sentences(["A", "B"])[0].endswith("no distance settles it: look at it from several places.")
    assert near.to_dict()["within_mm"][0][1] is None


def test_the_worst_comes_first() -> None:
    shown = np.array([0] * 10 + [1] * 10)
    answered = np.array([1] * 2 + [0] * 8 + [0] * 6 + [1] * 4)
    texts = find_look_alikes(shown, answered, np.arange(20.0), 2).sentences(["A", "B"])
    assert [text[:18] for text in texts] == ["B is taken for A i", "A is taken for B i"]
    assert pytest.approx(0.6) == find_look_alikes(shown, answered, np.arange(20.0), 2).counts[1, 0] / 10
