"""The suite of real frames says what a folder lacks, and how far off a pose is."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import real


def test_a_folder_that_lacks_files_is_refused_by_their_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lumen.stl").touch()
    assert real.main([f"data={tmp_path}"]) == 1
    assert "lacks calyces.csv, camera.json, poses.csv, truth.csv, frames" in capsys.readouterr().err


def test_how_far_off_a_pose_is() -> None:
    T = np.eye(4)
    T[0, 3] = 3.0
    assert real.off(T, np.eye(4)) == (3.0, 0.0)
