import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Calyx, Kidney
from ursnav_torch.kidney.naming import letter, name_calyces, with_poles


def test_letters_go_on_after_z() -> None:
    assert [letter(i) for i in (0, 1, 25, 26, 27, 52)] == ["A", "B", "Z", "AA", "AB", "BA"]


def test_neighbors_on_the_tree_get_neighboring_letters(phantom: Kidney) -> None:
    """Every subtree holds letters in a row."""
    tree = phantom.centerline
    below: list[set[int]] = [set() for _ in tree.parent]
    for c in range(len(phantom.calyces)):
        for node in tree.path_to(c):
            below[node].add(c)
    assert all(max(b) - min(b) == len(b) - 1 for b in below)
    assert [c.name for c in phantom.calyces] == [letter(i) for i in range(len(phantom.calyces))]


def test_names_do_not_depend_on_the_order_of_the_tips(phantom: Kidney) -> None:
    named = name_calyces(phantom.centerline, phantom.tips_mm)
    np.testing.assert_array_equal([c.tip_mm for c in named], phantom.tips_mm)


def test_poles_are_thirds_along_superior_and_given_ones_stay() -> None:
    heights = [0.0, 2.9, 5.0, 9.0]
    calyces = tuple(Calyx(str(h), np.array([1.0, -h, 0.0]), "mid" if h == 0 else "") for h in heights)
    assert [c.pole for c in with_poles(calyces, [0, -2, 0])] == ["mid", "lower", "mid", "upper"]


@pytest.mark.parametrize("superior", [[0, 0, 0], [1, 0], [np.nan, 0, 1]])
def test_superior_must_be_a_direction(superior: list[float]) -> None:
    with pytest.raises(InputError, match=r"kidney.superior must be a direction"):
        with_poles((Calyx("A", np.zeros(3)),), superior)
