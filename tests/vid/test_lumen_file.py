"""Distances along the lumen are found once, stored in the VID, and taken from there by all."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.localization import Localizer
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import Vid, load_vid
from ursnav_torch.vid.lumen_file import load_lumen, save_lumen


def test_a_vid_keeps_what_was_found(vid: Vid, phantom_lumen: LumenDistance) -> None:
    T = vid.T_kidney_camera
    np.testing.assert_allclose(
        vid.lumen.to_calyces(T[:, :3, 3]), phantom_lumen.to_calyces(T[:, :3, 3]), rtol=0, atol=1e-4
    )
    np.testing.assert_allclose(
        vid.lumen.clearance_mm(T[:, :3, 3]), phantom_lumen.clearance_mm(T[:, :3, 3]), rtol=0, atol=1e-4
    )
    np.testing.assert_array_equal(observed_calyx(T, vid.kidney, vid.lumen), vid.calyx)


def test_opening_locating_and_tracking_find_no_distances_again(vid: Vid, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(*given: object) -> None:
        raise AssertionError("the VID holds them")

    monkeypatch.setattr(LumenDistance, "from_kidney", again)
    opened = load_vid(vid.folder)
    Localizer(opened)
    Tracker(opened)


def test_damage_is_told(vid: Vid, phantom: Kidney, tmp_path: Path) -> None:
    path = tmp_path / "lumen.safetensors"
    save_lumen(path, vid.lumen)
    assert load_lumen(path, phantom).corner.shape == vid.lumen.corner.shape
    arrays = load_file(str(path))
    save_file(arrays | {"corner": arrays["corner"][:-1]}, str(path))
    with pytest.raises(InputError, match=r"do not fit 6 calyces and .* voxels; build the VID again"):
        load_lumen(path, phantom)
    save_file({k: v for k, v in arrays.items() if k != "wall_mm"}, str(path))
    with pytest.raises(InputError, match=r"is damaged .*wall_mm"):
        load_lumen(path, phantom)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="is damaged"):
        load_lumen(path, phantom)


def test_altered_distances_are_refused(vid: Vid, tmp_path: Path) -> None:
    shutil.copytree(vid.folder, tmp_path / "vid")
    path = tmp_path / "vid" / "lumen.safetensors"
    arrays = load_file(str(path))
    save_file(arrays | {"beyond_mm": arrays["beyond_mm"] + 1}, str(path))
    with pytest.raises(InputError, match=r"lumen\.safetensors was changed after the VID was built"):
        load_vid(tmp_path / "vid")
