"""What CONTRIBUTING.md shows is true: its files are written to a package of their own, and its tests are run."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
#: ``(language, path or blank, code)`` of every block.
BLOCKS = re.findall(r"^```(python|jinja)(?: (\S+))?\n(.*?)^```$", TEXT, re.M | re.S)
FILES = {path: code for _, path, code in BLOCKS if path}
TESTS = [code for language, path, code in BLOCKS if language == "python" and not path]


@pytest.fixture
def my_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for path, code in FILES.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(code, encoding="utf-8")
    (tmp_path / "my_lab" / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [name for name in sys.modules if name.split(".")[0] == "my_lab"]:
        monkeypatch.delitem(sys.modules, name)
    return tmp_path


@pytest.mark.parametrize("number", range(len(TESTS)))
def test_an_example_holds_what_it_says(my_lab: Path, number: int) -> None:
    exec(compile(TESTS[number], f"CONTRIBUTING.md, test {number + 1}", "exec"), {})


def test_there_is_an_example_for_every_kind_of_addition() -> None:
    assert re.findall(r"^### … (.*)$", TEXT, re.M) == ["a cue", "a tracker", "a robot", "a report"]
    assert len(TESTS) == 4 and all(path.startswith("my_lab/") for path in FILES)


def test_the_map_names_every_room_and_no_other() -> None:
    table = TEXT[TEXT.index("| place |") : TEXT.index("## How to add")]
    named = set(re.findall(r"`(\w+)/`", table))
    rooms = {path.parent.name for path in ROOT.glob("ursnav_torch/*/__init__.py")}
    inner = {path.parent.name for path in ROOT.glob("ursnav_torch/*/*/__init__.py")}
    assert rooms <= named <= rooms | inner
