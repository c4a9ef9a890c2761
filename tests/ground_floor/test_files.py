import csv
from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.files import (
    check_output,
    commit,
    partial_path,
    whole_file,
    write_csv,
    write_json,
)


def test_an_existing_result_is_refused_unless_told_otherwise(tmp_path: Path) -> None:
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    (tmp_path / "empty").mkdir()
    for name in ("there.csv", "full"):
        with pytest.raises(InputError, match=r"exists already.*overwrite=true"):
            check_output(tmp_path / name, overwrite=False)
        check_output(tmp_path / name, overwrite=True)
    check_output(tmp_path / "empty", overwrite=False)
    check_output(tmp_path / "new" / "deep" / "x.csv", overwrite=False)
    with pytest.raises(InputError, match="cannot be made"):
        check_output(tmp_path / "there.csv" / "x", overwrite=False)


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "result.csv"
    path.write_text("old")
    with pytest.raises(RuntimeError), whole_file(path) as partial:
        partial.write_text("half")
        assert path.read_text(encoding="utf-8") == "old" and partial == tmp_path / "result.csv.partial"
        raise RuntimeError
    assert path.read_text(encoding="utf-8") == "old" and not partial.exists()
    with whole_file(path) as partial:
        partial.write_text("new")
    assert path.read_text(encoding="utf-8") == "new" and not partial.exists()


def test_a_file_never_replaces_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        write_json(tmp_path, {}, overwrite=True)


@pytest.mark.parametrize("before", ["nothing", "folder", "file"])
def test_a_folder_takes_its_name_in_one_step(tmp_path: Path, before: str) -> None:
    path, partial = tmp_path / "vid", partial_path(tmp_path / "vid")
    partial.mkdir()
    (partial / "new").touch()
    if before == "file":
        path.touch()
    if before == "folder":
        path.mkdir()
        (path / "old").touch()
    commit(partial, path)
    assert [p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*"))] == ["vid", "vid/new"]


def test_cells_are_blank_true_or_plain_decimals(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "rows.csv"
    rows = [
        {"a": None, "b": True, "c": 1 / 3, "d": 'say "x", y'},
        {"a": float("nan"), "b": False, "c": 2.0, "d": "ä\nö"},
        {"c": -1e-9, "further": 1},
    ]
    write_csv(path, ["a", "b", "c", "d"], rows)
    assert path.read_text(encoding="utf-8").splitlines()[1] == ',true,0.333333,"say ""x"", y"'
    with path.open(newline="", encoding="utf-8") as file:
        back = list(csv.reader(file))
    assert back[2] == ["", "false", "2", "ä\nö"]
    assert float(back[3][2]) == 0


def test_numpy_values_are_written_like_pythons(tmp_path: Path) -> None:
    np = pytest.importorskip("numpy")
    write_csv(tmp_path / "x.csv", ["a", "b", "c"], [{"a": np.float64(0.1), "b": np.bool_(True), "c": np.float32(0.1)}])
    assert (tmp_path / "x.csv").read_text(encoding="utf-8") == "a,b,c\n0.1,true,0.1\n"


def test_json_refuses_what_json_does_not_know(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "x.json", {"a": float("nan")})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "x.json", {"ä": 1})
    assert "ä" in (tmp_path / "x.json").read_text(encoding="utf-8")
