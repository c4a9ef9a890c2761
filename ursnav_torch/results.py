"""Results of several files: they appear as one, and a run that was killed while they appeared is ended by the next.

Everything lies in the work folder until all of it is whole; then a list of what goes where is written there, and what
follows is only renaming. Whoever comes later and finds that list renames what is left: forward, never back.
"""

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ursnav_torch.disk import disk_errors
from ursnav_torch.errors import InputError
from ursnav_torch.files import check_output, check_output_file, commit, remove_aside
from ursnav_torch.locks import locked, partial_path

_LIST = "publish.json"


@dataclass(slots=True)
class WholeSet:
    """A set of results in the making.

    Attributes:
        paths: the results; the work folder is named after the first.
        folder: the work folder, for what else a run has to remember.
        outcome: plain data that tells of the results; a run that sets it has finished. Where it is there from the
            start, a run before had finished the very same work, and nothing is left to do.
    """

    paths: tuple[Path, ...]
    folder: Path
    outcome: Any = None

    def staged(self, path: Path) -> Path:
        """Where that which becomes ``path`` is written."""
        return self.folder / f"{self.paths.index(path)}_{path.name}"


def check_set(paths: Sequence[Path], overwrite: bool) -> None:
    """`check_output` for every result of a set (the first is a file), before the work.

    Where a run was killed while its results appeared, those that have appeared are no hindrance.

    Raises:
        InputError: see `check_output`.
    """
    if not (partial_path(paths[0]) / _LIST).is_file():
        check_output_file(paths[0], overwrite)
        for path in paths[1:]:
            check_output(path, overwrite)


@contextmanager
def whole_set(
    paths: Sequence[Path], overwrite: bool, work: Mapping[str, Any], resume: bool = False
) -> Iterator[WholeSet]:
    """Yield a `WholeSet`; its results appear when the block ends without an error and its outcome is known.

    Args:
        paths: files and folders to be made.
        overwrite: replace what stands there.
        work: plain data that changes when the work does, inputs and settings.
        resume: keep what an interrupted run left in the work folder, and leave it there after an error.

    Raises:
        InputError: see `check_output`; another process writes one of them; the disk is full or read-only.
    """
    check_set(paths, overwrite)
    whole = WholeSet(tuple(paths), partial_path(paths[0]))
    plain = json.loads(json.dumps(work))
    with disk_errors(*paths), locked(*paths):
        finished = _finish(whole)
        if finished is not None and finished["work"] == plain:
            whole.outcome = finished["outcome"]
            yield whole
            return
        check_set(paths, overwrite)
        _open(whole.folder, resume)
        try:
            yield whole
            if whole.outcome is not None:
                _publish(whole, plain)
        except BaseException:
            if not resume and not (whole.folder / _LIST).exists():
                shutil.rmtree(whole.folder, ignore_errors=True)
            raise


def _open(folder: Path, resume: bool) -> None:
    if folder.is_file():
        folder.unlink()
    if not resume:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)


def _publish(whole: WholeSet, work: Any) -> None:
    moves = {whole.staged(path).name: str(path) for path in whole.paths if whole.staged(path).exists()}
    draft = whole.folder / (_LIST + ".new")
    draft.write_text(json.dumps({"work": work, "outcome": whole.outcome, "moves": moves}), encoding="utf-8")
    os.replace(draft, whole.folder / _LIST)
    _finish(whole)


def _finish(whole: WholeSet) -> dict[str, Any] | None:
    """Rename what a finished run had not renamed yet and remove its work folder; what its list says, if there is one.

    Raises:
        InputError: the list has results that are not among the set's.
    """
    folder = whole.folder
    try:
        told: dict[str, Any] = json.loads((folder / _LIST).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    foreign = [path for path in told["moves"].values() if path not in map(str, whole.paths)]
    if foreign:
        raise InputError(
            f"{folder} holds the finished results of a run that was killed, {foreign[0]} among them. Give that run's "
            f"command again, and they get their names; or remove {folder}."
        )
    for name, path in reversed(told["moves"].items()):  # the first last: where it stands, all stand
        if (folder / name).exists():
            commit(folder / name, Path(path))
        remove_aside(Path(path))
    for left in folder.iterdir():
        if left.name != _LIST:
            shutil.rmtree(left) if left.is_dir() else left.unlink()
    (folder / _LIST).unlink()
    folder.rmdir()
    return told
