"""What a large VID holds besides, written and read: nothing is read from tables of text, nothing changed unnoticed."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import LocalCompute, PlanSettings, Vid, build, build_vid, load_vid, make_screen, save_vid
from ursnav_torch.vid.screen import load_screen


@pytest.fixture
def folder(vid: Vid, tmp_path: Path) -> Path:
    """The small VID stored with a screen."""
    folder = shutil.copytree(vid.folder, tmp_path / "vid")
    save_vid(replace(vid, screen=make_screen(vid.features, 32)), folder)
    return folder


def test_comes_back_as_it_was(folder: Path, vid: Vid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ursnav_torch.vid.store.read_csv", lambda *_: pytest.fail("views.csv was read"))
    back, made = load_vid(folder), make_screen(vid.features, 32)
    assert back.screen is not None and made is not None
    assert torch.equal(back.screen.table, made.table) and torch.equal(back.screen.basis.vectors, made.basis.vectors)
    assert back.screen.table.dtype == torch.float16 and len(back.screen.basis) == 32
    np.testing.assert_array_equal(back.T_kidney_camera, vid.T_kidney_camera)
    np.testing.assert_array_equal(back.calyx, vid.calyx)
    assert not back.screen.proven.any()
    back.screen.prove(back.features, np.arange(len(vid)), folder)
    assert back.screen.proven.all()


def test_changed_features_are_found_view_by_view(folder: Path) -> None:
    path = folder / "features.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 64  # of the last view's last field
    path.write_bytes(data)
    changed = load_vid(folder)
    assert changed.screen is not None
    with pytest.raises(InputError, match=r"The features of view \d+ of the VID .* were changed"):
        changed.screen.prove(changed.features, np.arange(len(changed)), folder)
    assert changed.screen.proven.sum() < len(changed)


def test_a_changed_or_missing_screen_is_refused(folder: Path) -> None:
    path = folder / "screen.safetensors"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"screen\.safetensors was changed after the VID was built"):
        load_vid(folder)
    path.unlink()
    with pytest.raises(InputError, match=r"lacks screen\.safetensors"):
        load_vid(folder)


def test_arrays_that_do_not_fit_are_refused(folder: Path) -> None:
    path = folder / "screen.safetensors"
    data = {name: tensor.clone() for name, tensor in load_file(str(path)).items()}
    for changed in ({"calyx": data["calyx"][1:]}, {"table": data["table"].float()}, {"sectors": torch.zeros(0)}):
        save_file(data | changed, str(path))
        with pytest.raises(InputError, match="which do not fit; build the VID again"):
            load_screen(path)
    path.write_bytes(b"no such file")
    with pytest.raises(InputError, match=r"screen\.safetensors is damaged"):
        load_screen(path)


def test_features_without_maps_have_no_screen(vid: Vid) -> None:
    assert make_screen(replace(vid.features, maps=torch.zeros(len(vid), 0, 0, 0, dtype=torch.float16))) is None


@pytest.mark.parametrize(("limit", "screened"), [(20, True), (100, False)])
def test_a_build_makes_one_from_a_size_on(
    phantom: Kidney, lens: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, screened: bool
) -> None:
    monkeypatch.setattr(build, "SCREEN_FROM", limit)
    plan = PlanSettings(views_per_calyx=3, passage_views=3)
    make = partial(RaycastRenderer)
    vid = build_vid(phantom, lens, DefaultSettings(), make, plan, tmp_path / "vid", compute=LocalCompute(1))
    assert (vid.screen is not None) == screened == (tmp_path / "vid" / "screen.safetensors").exists()
