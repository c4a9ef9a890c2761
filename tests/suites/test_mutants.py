"""The mutation benchmark: its plan is checked against the code, and faults go into a copy alone."""

from pathlib import Path

import pytest

from benchmarks.mutants import PLAN, ROOT, Mutant, plant, read_plan
from ursnav_torch.errors import InputError

ENTRY = """
[[mutant]]
name = "{name}"
file = "room/deciding.py"
old = "{old}"
new = "return b"
tests = ["{tests}"]
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "ursnav_torch" / "room").mkdir(parents=True)
    (tmp_path / "ursnav_torch" / "room" / "deciding.py").write_text("def f(a, b):\n    return a\n\n# twice\n# twice\n")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").touch()
    return tmp_path


def planned(root: Path, *entries: dict[str, str]) -> Path:
    path = root / "plan.toml"
    plain = {"name": "wrong way", "old": "return a", "tests": "tests/test_it.py::test_f"}
    path.write_text("".join(ENTRY.format(**plain | entry) for entry in entries))
    return path


def test_a_fault_is_planted_in_the_copy_and_marked_as_newer(root: Path) -> None:
    (mutant,) = read_plan(planned(root, {}), root)
    assert mutant == Mutant(
        "wrong way", "room/deciding.py", "return a", "return b", ("tests/test_it.py::test_f",)
    ) and mutant.room == "room"  # fmt: skip
    file = root / "ursnav_torch" / "room" / "deciding.py"
    before = file.stat().st_mtime
    plant(mutant, root)
    assert (
        file.read_text(encoding="utf-8").startswith("def f(a, b):\n    return b\n")
        and file.stat().st_mtime > before + 1e5
    )


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ({"old": "return c"}, "wrong way: 'return c' stands 0 times in room/deciding.py"),
        ({"old": "# twice"}, "wrong way: '# twice' stands 2 times"),
        ({"tests": "tests/test_gone.py"}, "wrong way: there is no tests/test_gone.py"),
    ],
)
def test_a_plan_that_no_longer_meets_the_code_is_refused_by_name(root: Path, entry: dict[str, str], says: str) -> None:
    with pytest.raises(InputError) as refused:
        read_plan(planned(root, {"name": "another"}, entry), root)
    assert says in str(refused.value) and "another" not in str(refused.value)


def test_all_that_is_wrong_is_named_at_once(root: Path) -> None:
    with pytest.raises(InputError) as refused:
        read_plan(planned(root, {"old": "gone"}, {}, {"name": "other", "old": "lost"}), root)
    assert all(word in str(refused.value) for word in ("'gone'", "'lost'", "wrong way: named twice"))


def test_the_plan_meets_the_code_and_covers_the_rooms_that_decide() -> None:
    plan = read_plan(PLAN, ROOT)
    rooms = {"matching", "search", "alignment", "localization", "tracking", "exploration", "navigation", "devices"}
    assert len(plan) >= 40 and rooms <= {m.room for m in plan}
    assert all(m.old != m.new and m.tests for m in plan)
