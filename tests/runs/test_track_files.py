from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.columns import POSE_COLUMNS, TRACK_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.files import write_csv
from ursnav_torch.results import whole_set
from ursnav_torch.runs.track_files import Besides, Truth, read_track, read_truth, score_track
from ursnav_torch.vid import pose_cells


def at(*x_mm: float) -> np.ndarray:
    T = np.tile(np.eye(4), (len(x_mm), 1, 1))
    T[:, 0, 3] = x_mm
    return T


@pytest.fixture
def track(tmp_path: Path) -> Path:
    """Pictures 0, 1 and 3; the first is not tracked, the last is 7 mm off."""
    rows: list[dict[str, object]] = [{"frame": 0, "t_s": 0.0, "state": "searching"}]
    for frame, calyx, cells in zip((1, 3), ("A", ""), pose_cells(at(1.0, 10.0)), strict=True):
        rows.append({"frame": frame, "t_s": frame / 10, "state": "tracking", "calyx": calyx} | cells)
    write_csv(tmp_path / "track.csv", TRACK_COLUMNS, rows)
    return tmp_path / "track.csv"


def test_a_track_is_scored_picture_by_picture(track: Path, tmp_path: Path) -> None:
    cells = pose_cells(at(0.0, 1.0, 2.0, 3.0))
    rows = [{"calyx": name} | row for name, row in zip(("B", "A", "A", "B"), cells, strict=True)]
    write_csv(tmp_path / "truth.csv", ("calyx", *POSE_COLUMNS), rows)
    score = score_track(read_track(track), read_truth(tmp_path / "truth.csv"))
    assert score["pictures"] == 3 and score["right_calyx"] == pytest.approx(1 / 3, abs=1e-4)
    assert score["not_tracking"] == pytest.approx(1 / 3, abs=1e-4)
    assert score["position_mm"] == pytest.approx(3.5) and score["trajectory_error_mm"] == pytest.approx(
        np.sqrt(24.5), abs=1e-4
    )
    assert score["within_5_mm"] == pytest.approx(1 / 3, abs=1e-4) and score["within_10_mm"] == pytest.approx(
        2 / 3, abs=1e-4
    )


def test_without_calyces_none_is_scored_and_a_short_truth_is_refused(track: Path) -> None:
    found = read_track(track)
    assert score_track(found, Truth(at(0.0, 1.0, 2.0, 3.0), None))["right_calyx"] is None
    with pytest.raises(InputError, match="the truth has 3 rows"):
        score_track(found, Truth(at(0.0, 1.0, 2.0), None))


def test_only_known_poses_are_exported_in_meters(track: Path, tmp_path: Path) -> None:
    besides, out = Besides(None, tum=True), tmp_path / "again.csv"
    with whole_set((out, *besides.paths(out)), False, {}) as whole:
        whole.staged(out).write_bytes(track.read_bytes())
        assert besides.write(whole) == ("", True)
        whole.outcome = True
    assert not list(tmp_path.glob("*.score.json"))
    lines = [
        [float(v) for v in line.split()] for line in (tmp_path / "again.tum").read_text(encoding="utf-8").splitlines()
    ]
    np.testing.assert_allclose(lines, [[0.1, 0.001, 0, 0, 0, 0, 0, 1], [0.3, 0.01, 0, 0, 0, 0, 0, 1]])


def test_a_track_is_told_by_the_bytes_it_is_made_from(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.png").write_bytes(b"1")
    inputs = Besides(inputs=(tmp_path / "in", tmp_path / "nowhere"))
    before = inputs.fingerprints()
    assert [entry[:2] for entry in before] == [[str(tmp_path / "in" / "a.png"), 1], [str(tmp_path / "nowhere"), -1]]
    (tmp_path / "in" / "a.png").write_bytes(b"2")
    assert inputs.fingerprints() != before


def test_a_truth_that_is_too_short_costs_the_score_and_not_the_track(track: Path, tmp_path: Path) -> None:
    besides, out = Besides(Truth(at(0.0, 1.0), None), tum=True), tmp_path / "again.csv"
    with whole_set((out, *besides.paths(out)), False, {}) as whole:
        whole.staged(out).write_bytes(track.read_bytes())
        told, is_all = besides.write(whole)
        assert "not scored: The track goes to picture 3, but the truth has 2 rows" in told and not is_all
        whole.outcome = True
    assert out.read_bytes() == track.read_bytes() and (tmp_path / "again.tum").is_file()
    assert "2 rows" in (tmp_path / "again.score.json").read_text(encoding="utf-8")
