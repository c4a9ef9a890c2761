"""A calyx's name is checked where it comes to be, so that no file and no list reads it as something else."""

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Calyx


@pytest.mark.parametrize(
    "name", ["pelvis", "Pelvis", "NONE", "", " A", "A ", "a|b", "../x", "a\\b", ".x", "a\nb", "x" * 41]
)
def test_a_name_that_means_something_else_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="A calyx cannot be called"):
        Calyx(name, np.zeros(3))


@pytest.mark.parametrize("name", ["A", "oberer Kelch, ä", "upper-1", "1", '"x"', "<b>"])
def test_other_names_are_the_users_own(name: str) -> None:
    assert Calyx(name, np.zeros(3)).name == name
