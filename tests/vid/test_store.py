"""A VID proves itself whole when it is loaded: nothing in it can be changed without a word."""

import json
import os
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file, save_file

from ursnav_torch.errors import InputError
from ursnav_torch.vid import Vid, load_vid
from ursnav_torch.vid.draw import save_features
from ursnav_torch.vid.store import write_description


@pytest.fixture
def folder(vid: Vid, tmp_path: Path) -> Path:
    """A copy of the small VID, to be damaged."""
    return shutil.copytree(vid.folder, tmp_path / "vid", ignore=shutil.ignore_patterns("images"))


def _seal(folder: Path) -> None:
    """Recompute every checksum, as somebody would who wants to be believed."""
    description = json.loads((folder / "vid.json").read_text(encoding="utf-8"))
    write_description(folder, {k: v for k, v in description.items() if k not in ("sha256", "checksum")})


@pytest.mark.parametrize("seed", range(8))
def test_a_flipped_bit_of_the_features_is_refused(folder: Path, seed: int) -> None:
    path = folder / "features.safetensors"
    data = bytearray(path.read_bytes())
    at = int(np.random.default_rng(seed).integers(len(data)))
    data[at] ^= 1 << seed % 8
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"features\.safetensors was changed after the VID was built"):
        load_vid(folder)


@pytest.mark.parametrize("kind", ["swapped", "halved"])
def test_features_of_other_rows_are_refused(folder: Path, kind: str) -> None:
    path = folder / "features.safetensors"
    data = {k: v.clone() for k, v in load_file(str(path)).items()}
    rows = [1, 0, *range(2, len(data["points"]))] if kind == "swapped" else list(range(len(data["points"]) // 2))
    save_file({k: v[rows].contiguous() for k, v in data.items()}, str(path))
    with pytest.raises(InputError, match="was changed"):
        load_vid(folder)


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("points", lambda t: t[:-1]),
        ("mask", lambda t: t[:, :-1]),
        ("weight", lambda t: t.double()),
        ("maps", lambda t: t[:, 0]),
    ],
)
def test_features_that_do_not_fit_the_views_are_refused_even_under_a_right_checksum(folder, field, change) -> None:
    path = folder / "features.safetensors"
    data = {k: v.clone() for k, v in load_file(str(path)).items()}
    data[field] = change(data[field]).contiguous()
    save_file(data, str(path))
    _seal(folder)
    with pytest.raises(InputError, match=rf"features\.safetensors: {field} is .*expected"):
        load_vid(folder)


def test_views_of_a_calyx_that_the_kidney_lacks_are_refused(folder: Path) -> None:
    path = folder / "views.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[1].split(",")
    path.write_text("\n".join([lines[0], ",".join([cells[0], "elsewhere", *cells[2:]]), *lines[2:]]) + "\n")
    _seal(folder)
    with pytest.raises(InputError, match="names the calyces elsewhere; the kidney's are"):
        load_vid(folder)


@pytest.mark.parametrize("about", [None, [], {"scale": None, "source": "x"}, {"scale": "a"}])
def test_a_description_without_its_kidney_is_refused(folder: Path, about: object) -> None:
    description = json.loads((folder / "vid.json").read_text(encoding="utf-8"))
    description = {k: v for k, v in description.items() if k not in ("sha256", "checksum")}
    write_description(folder, description | {"kidney": about})
    with pytest.raises(InputError, match="does not describe its kidney"):
        load_vid(folder)


@pytest.mark.parametrize("mask", [0o022, 0o027, 0o077])
def test_the_features_are_readable_by_whom_the_umask_lets_read(vid: Vid, tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        save_features(tmp_path / "f.safetensors", vid.features)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "f.safetensors").stat().st_mode) == 0o666 & ~mask


def test_a_picture_is_proven_when_it_is_read(vid: Vid, tmp_path: Path) -> None:
    folder = shutil.copytree(vid.folder, tmp_path / "vid")
    path = folder / "images" / "000003.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    loaded = load_vid(folder)  # opening does not read the pictures
    np.testing.assert_array_equal(loaded.read_picture(2), vid.read_picture(2))
    with pytest.raises(InputError, match=r"000003\.png was changed after the VID was built"):
        loaded.read_picture(3)
    shutil.copy(folder / "images" / "000002.png", path)  # a whole picture in the place of another
    with pytest.raises(InputError, match="was changed"):
        list(loaded.pictures())


def test_the_pictures_checksums_are_under_the_vids_own(folder: Path) -> None:
    path = folder / "images.sha256"
    (one, first), (other, second), *rest = [line.split("  ") for line in path.read_text(encoding="utf-8").splitlines()]
    exchanged = [(other, first), (one, second), *rest]  # every picture is named, in order
    path.write_text("".join(f"{digest}  {name}\n" for digest, name in exchanged), encoding="utf-8")
    with pytest.raises(InputError, match=r"images\.sha256 was changed after the VID was built"):
        load_vid(folder)


@pytest.mark.parametrize("change", ["exchanged", "fewer", "gone"])
def test_every_picture_is_under_a_checksum(folder: Path, change: str) -> None:
    path = folder / "images.sha256"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join(lines[1:] if change == "fewer" else [lines[1], lines[0], *lines[2:]]), encoding="utf-8")
    if change == "gone":
        path.unlink()
    with pytest.raises(InputError, match=r"images\.sha256"):
        load_vid(folder)
    if change != "gone":
        _seal(folder)
        with pytest.raises(InputError, match="does not list the pictures of"):
            load_vid(folder)


def test_pictures_that_are_under_no_checksum_are_not_shown(folder: Path) -> None:
    (folder / "images.sha256").unlink()
    _seal(folder)
    with pytest.raises(InputError, match="not under its checksums; build the VID again"):
        load_vid(folder).read_picture(0)
