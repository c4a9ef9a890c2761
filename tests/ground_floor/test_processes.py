"""Work shared with child processes gives what it gives in one, in the same order."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

import ursnav_torch
from ursnav_torch.errors import InputError, UrsnavError
from ursnav_torch.processes import _IMPORTED_ONCE, busy_children, in_order, spare_children


class Halver:
    """Halves numbers, as tensors; refuses odd ones."""

    def __call__(self, number: int) -> torch.Tensor:
        if number % 2:
            raise InputError(f"{number} is odd")
        return torch.tensor([number // 2])


def test_results_come_in_the_order_of_the_tasks_whoever_did_them() -> None:
    asked = []

    def numbers():
        for number in range(0, 80, 2):
            asked.append(number)
            yield number

    shared = in_order(Halver, numbers(), children=1)
    assert int(next(shared)) == 0 and len(asked) < 20, "tasks are made as they are needed, not all before"
    assert [int(v) for v in shared] == [int(v) for v in in_order(Halver, range(2, 80, 2), children=0)]


@pytest.mark.parametrize("children", [0, 1])
def test_an_error_is_the_callers(children: int) -> None:
    with pytest.raises(InputError, match="3 is odd"):
        list(in_order(Halver, [2, 3, 4], children))


def test_a_child_that_dies_is_said_to_have() -> None:
    with pytest.raises(UrsnavError, match=r"ended before its time.*workers=1"):
        list(in_order(Dier, [1], children=1))


class Dier:
    def __call__(self, number: int) -> int:
        import os

        os._exit(3)


def test_one_core_is_kept_for_the_process_that_asks() -> None:
    assert (spare_children(4), spare_children(1)) == (3, 0) and spare_children() >= 0
    assert (busy_children(4), busy_children(1)) == (4, 0), "and none where it has little to do"


def test_pickle_is_in_no_other_file_of_the_package() -> None:
    """SECURITY.md: only work for children of our own goes that way; no file and no message is ever unpickled."""
    texts = {p.name: p.read_text("utf-8") for p in Path(ursnav_torch.__file__).parent.rglob("*.py")}
    library = re.compile(r"(import|from) (pickle|dill|joblib|shelve|marshal)|torch\.load\(|allow_pickle=True")
    assert [name for name, text in texts.items() if library.search(text)] == ["processes.py"]


@pytest.mark.parametrize("name", _IMPORTED_ONCE)
def test_what_children_have_imported_is_there(name: str) -> None:
    """A server of children passes over what it cannot import, and every child would take seconds again."""
    assert find_spec(name) is not None
