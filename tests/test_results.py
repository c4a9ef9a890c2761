"""Results of several files appear as one: killed at any of its steps, the same call ends in the same bytes."""

import os
from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.files import whole_folder
from ursnav_torch.results import check_set, whole_set

STEPS = ("replace", "rename", "unlink", "rmdir", "mkdir")


def _make(folder: Path, overwrite: bool = False, text: str = "new") -> object:
    """A set of a file and a folder; what it says of itself."""
    paths = (folder / "rows.csv", folder / "page")
    with whole_set(paths, overwrite, {"text": text}) as whole:
        if whole.outcome is None:
            whole.staged(paths[0]).write_text(text)
            whole.staged(paths[1]).mkdir()
            (whole.staged(paths[1]) / "index.html").write_text(text)
            whole.outcome = text
    return whole.outcome


def _die_at(step: int) -> None:
    """Make this process die, as of SIGKILL, at its n-th change of a folder."""
    left = [step]

    def dying(change):  # type: ignore[no-untyped-def]
        def call(*args, **options):  # type: ignore[no-untyped-def]
            if left[0] == 0:
                os._exit(9)
            left[0] -= 1
            return change(*args, **options)

        return call

    for name in STEPS:
        setattr(os, name, dying(getattr(os, name)))


def _killed(step: int, work, *args: object) -> bool:  # type: ignore[no-untyped-def]
    """Whether ``work`` in another process died at its n-th step, rather than ended."""
    child = os.fork()
    if child == 0:
        _die_at(step)
        try:
            work(*args)
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def _files(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): p.read_text(encoding="utf-8")
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.parametrize("overwrite", [False, True])
def test_killed_at_any_step_the_same_call_ends_it(tmp_path: Path, overwrite: bool) -> None:
    step = 0
    while True:
        folder = tmp_path / str(step)
        folder.mkdir()
        if overwrite:
            _make(folder, text="old")
        if not _killed(step, _make, folder, overwrite):
            break
        seen = _files(folder)
        if (folder / "rows.csv").exists() and seen["rows.csv"] == "new":
            assert seen["page/index.html"] == "new", "where the rows stand, all stands"
        whole = "rows.csv" in seen and not any(name.startswith("rows.csv.partial/") for name in seen)
        if whole and not overwrite:
            with pytest.raises(InputError, match="exists already"):
                check_set((folder / "rows.csv", folder / "page"), overwrite)
        else:
            check_set((folder / "rows.csv", folder / "page"), overwrite)
            assert _make(folder, overwrite) == "new"
        left = {name: text for name, text in _files(folder).items() if not name.endswith(".lock")}
        assert left == {"rows.csv": "new", "page/index.html": "new"}, f"step {step}"
        step += 1
    assert step >= 8


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_a_folder_that_replaces_another_is_made_again_after_a_kill(tmp_path: Path) -> None:
    def make(folder: Path, text: str) -> None:
        with whole_folder(folder / "out", overwrite=True) as work:
            (work / "a").write_text(text)

    for step in range(20):
        folder = tmp_path / str(step)
        folder.mkdir()
        make(folder, "old")
        if not _killed(step, make, folder, "new"):
            assert step >= 4
            return
        make(folder, "new")
        assert _files(folder) == {"out/a": "new"}, f"step {step}"
    pytest.fail("it never ended")


def test_results_that_did_not_appear_are_not_given_to_another_call(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("ursnav_torch.results._finish", lambda whole: None)
    _make(tmp_path)
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"exists already"):
        _make(tmp_path, text="of other pictures")
    assert _files(tmp_path) == {"page/index.html": "new", "rows.csv": "new"}, "the finished ones have appeared first"


def test_a_list_that_names_other_places_moves_nothing(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("ursnav_torch.results._finish", lambda whole: None)
    _make(tmp_path)
    monkeypatch.undo()
    said = r"rows\.csv\.partial holds the finished results of a run that was killed, .*page among them"
    with pytest.raises(InputError, match=said), whole_set((tmp_path / "rows.csv",), False, {}):
        pytest.fail("not this set")
    assert not (tmp_path / "rows.csv").exists()


def test_an_error_leaves_nothing_unless_there_is_something_to_resume(tmp_path: Path) -> None:
    for resume in (False, True):
        with pytest.raises(RuntimeError), whole_set((tmp_path / "a.csv",), False, {}, resume) as whole:
            (whole.folder / "journal").write_text("1")
            raise RuntimeError
        assert [p.name for p in tmp_path.iterdir()] == (["a.csv.partial"] if resume else [])
