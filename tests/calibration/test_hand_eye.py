"""The sensor on the camera is found from a drive, with an uncertainty that holds; a poor motion is refused."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.hand_eye import sensor_on_camera, simulated_drive, supplied
from ursnav_torch.calibration.hand_eye import calibrate_tip
from ursnav_torch.columns import POSE_COLUMNS, TRACK_COLUMNS
from ursnav_torch.devices import Stamp, TrackerSample
from ursnav_torch.errors import RegistrationError
from ursnav_torch.geometry import quaternion_from_transform
from ursnav_torch.runs.calibrate_tip import read_tip
from ursnav_torch.session import Recorder, Result


def angle_of(R: np.ndarray) -> float:
    """Of a turn, degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_place_axis_and_clock_are_found(seed: int) -> None:
    T, t_s, samples, offset, axis, ahead = simulated_drive(seed)
    found = calibrate_tip(T, t_s, samples)
    assert np.linalg.norm(found.offset_mm - offset) < 0.5
    assert np.degrees(np.arccos(found.axis @ axis)) < 1.0
    assert found.R_camera_sensor is not None
    assert angle_of(found.R_camera_sensor.T @ sensor_on_camera(axis)) < 1.0
    five = calibrate_tip(T, t_s, replace(samples, quaternion=None))
    assert five.R_camera_sensor is None
    np.testing.assert_array_equal(five.offset_mm, found.offset_mm)
    assert abs(found.em_offset_s - ahead) < 0.010
    assert np.all(np.abs(found.offset_mm - offset) < 4 * found.offset_sd_mm)


def test_poses_that_are_missing_and_readings_that_are_not_visible_are_left_out() -> None:
    T, t_s, samples, offset, *_ = simulated_drive(3)
    T[100:180] = np.nan
    samples.position_mm[400:900] = np.nan
    assert np.linalg.norm(calibrate_tip(T, t_s, samples).offset_mm - offset) < 1.0


@pytest.mark.parametrize("seed", [0, 4])
def test_a_track_that_goes_astray_for_some_seconds_does_not_draw_the_place_along(seed: int) -> None:
    T, t_s, samples, offset, *_ = simulated_drive(seed)
    ahead = T.copy()
    for first in range(50, 1200, 300):
        ahead[first : first + 30, :3, 3] += 8 * T[first, :3, 2]
    found = calibrate_tip(ahead, t_s, samples)
    assert 120 <= found.astray <= 200 and found.n > 1000
    assert np.linalg.norm(found.offset_mm - calibrate_tip(T, t_s, samples).offset_mm) < 0.15
    assert np.linalg.norm(found.offset_mm - offset) < 0.6


def test_logs_of_another_size_and_logs_that_fit_only_in_part_are_refused() -> None:
    T, t_s, samples, *_ = simulated_drive(2)
    for factor in (0.1, 10.0):
        with pytest.raises(RegistrationError, match=r"not of one motion.*another unit \(em_unit=mm, cm or m\)"):
            calibrate_tip(T, t_s, replace(samples, position_mm=samples.position_mm * factor))
    half = np.arange(len(samples.position_mm))[:, None] < len(samples.position_mm) * 0.65
    frozen = np.where(half, samples.position_mm, samples.position_mm[int(half.sum())])
    with pytest.raises(RegistrationError, match=r"\d+ of \d+ pictures do not agree.*mirrored.*stand still"):
        calibrate_tip(T, t_s, replace(samples, position_mm=frozen))


def test_a_motion_that_does_not_tell_is_refused() -> None:
    T, t_s, samples, *_ = simulated_drive(0)
    still = T.copy()
    still[:, :3, :3] = T[0, :3, :3]  # moves, never turns: the place cannot be told from the registration
    moved = replace(samples, position_mm=np.interp(samples.t_s, t_s, T[:, 0, 3])[:, None] * [1.0, 0, 0])
    with pytest.raises(RegistrationError, match=r"does not determine .*bends to all sides"):
        calibrate_tip(still, t_s, moved)
    with pytest.raises(RegistrationError, match="at least 40 of each are needed"):
        calibrate_tip(T[:20], t_s[:20], samples)
    with pytest.raises(RegistrationError, match="has no times"):
        calibrate_tip(T, t_s, replace(samples, t_s=None))


def test_the_supplied_videos_agree_with_what_is_known_of_them(data: Path) -> None:
    for name, found, truth in supplied(data):
        assert np.linalg.norm(found.offset_mm - truth) < 0.7, name
        assert abs(found.em_offset_s) < 0.010, name


def test_the_runner_writes_what_track_takes(run: Callable[..., Any], tmp_path: Path) -> None:
    T, t_s, samples, offset, _, ahead = simulated_drive(1)
    values = np.concatenate([T[:, :3, 3], quaternion_from_transform(T)], axis=1)
    with (tmp_path / "track.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, TRACK_COLUMNS)
        writer.writeheader()
        for i, row in enumerate(values.tolist()):
            writer.writerow(
                {"frame": i, "t_s": t_s[i], "state": "tracking"} | dict(zip(POSE_COLUMNS, row, strict=True))
            )
    assert samples.t_s is not None
    table = np.column_stack([samples.t_s, samples.position_mm, samples.axis])
    np.savetxt(tmp_path / "em.csv", table, "%.6f", ",", header="t_s,x_mm,y_mm,z_mm,dx,dy,dz", comments="")
    files = [f"track={tmp_path / 'track.csv'}", f"em={tmp_path / 'em.csv'}", f"out={tmp_path / 'tip.json'}"]
    done = run("calibrate_tip", *files)
    assert done.code == 0, done.err
    assert "sensor in the camera frame" in done.out
    assert "1199 of 1200 pictures with a pose have an EM reading (by time)" in done.out
    place, late = read_tip(tmp_path / "tip.json")
    np.testing.assert_allclose(place, offset, atol=0.5)
    assert abs(late - ahead) < 0.01
    assert "track takes the place and the clocks' offset, navigate the place alone" in done.out
    assert run("calibrate_tip", *files).code == 1  # it is there already


def test_a_recorded_session_tells_the_same(run: Callable[..., Any], tmp_path: Path) -> None:
    T, t_s, samples, offset, _, ahead = simulated_drive(1)
    values = np.concatenate([T[:, :3, 3], quaternion_from_transform(T)], axis=1)
    assert samples.t_s is not None
    with Recorder(tmp_path / "drive") as recorder:
        for i, row in enumerate(values.tolist()):
            pose = dict(zip(POSE_COLUMNS, row, strict=True))
            stamp = Stamp(i, float(t_s[i]) + 0.2, 1e9)  # told later than the picture was taken
            recorder.write(Result(stamp, i, {"t_s": float(t_s[i]), "accepted": i % 7 > 0} | pose))
        for i, (t, p, a) in enumerate(zip(samples.t_s, samples.position_mm, samples.axis, strict=True)):
            seen = i % 9 > 0
            at, along = (tuple(v.tolist()) if seen else None for v in (p, a))
            recorder.write(TrackerSample(Stamp(i, float(t), 1e9), seen, at, along))
    done = run("calibrate_tip", f"record={tmp_path / 'drive'}", f"out={tmp_path / 'tip.json'}")
    assert done.code == 0, done.err
    place, late = read_tip(tmp_path / "tip.json")
    np.testing.assert_allclose(place, offset, atol=0.5)
    assert abs(late - ahead) < 0.015


def test_what_a_session_lacks_is_said(run: Callable[..., Any], tmp_path: Path) -> None:
    with Recorder(tmp_path / "empty") as recorder:
        recorder.write(Result(Stamp(0, 0.0, 0.0), 0, {"accepted": False}))
    done = run("calibrate_tip", f"record={tmp_path / 'empty'}", "out=tip.json")
    assert done.code == 1 and "holds no localized pictures: record with `navigate`" in done.err
    both = run("calibrate_tip", f"record={tmp_path / 'empty'}", "em=em.csv", "out=tip.json")
    assert both.code == 1 and "takes track=FILE.csv and em=FILE, or record=FOLDER" in both.err
    assert run("calibrate_tip", f"record={tmp_path / 'nowhere'}", "out=tip.json").code == 1
