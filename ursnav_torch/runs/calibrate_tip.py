"""What the `calibrate_tip` runner does: a localized video and its EM log, or a session, in; the sensor's place out."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.calibration.hand_eye import TipCalibration, calibrate_tip
from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.devices import TrackerSample
from ursnav_torch.em_log import EmFormat, EmSamples, check_clock, check_pace, read_em_samples
from ursnav_torch.errors import InputError, naming
from ursnav_torch.geometry import Array, transform_from_quaternion
from ursnav_torch.records import read_json
from ursnav_torch.runs.track_files import read_track
from ursnav_torch.session import Replay
from ursnav_torch.tracking.tracker import TRACKING

#: In less than this a scope's tip moves by less than its sensor errs, s.
_AT_ONCE_S = 0.01


def tip_of_track(track: Path, em: Path, form: EmFormat | None = None) -> TipCalibration:
    """The calibration from the rows of `track` that are tracking, and the video's EM log.

    Raises:
        InputError, RegistrationError: a file cannot be used, or see `calibrate_tip`.
    """
    rows = read_track(track)
    T = rows.T_kidney_camera.copy()
    T[[state != TRACKING for state in rows.state]] = np.nan
    samples = read_em_samples(em, form)
    check_clock(samples)
    if form is None or form.time_unit is None:
        check_pace(samples)
    with naming(f"{track} and {em}"):
        return calibrate_tip(T, rows.t_s, samples)


def tip_of_session(record: Path) -> TipCalibration:
    """The calibration from a session that `navigate` recorded: its accepted poses and its tracker's samples.

    The offset is that between the two devices as this machine heard them.

    Raises:
        InputError, RegistrationError: there is no record, it has no poses or no samples, or see `calibrate_tip`.
    """
    replay = Replay(record)
    rows = [r.row for r in replay.results() if r.row.get("accepted") and r.row.get("x_mm") is not None]
    readings = replay.readings()
    for found, what in ((rows, "localized pictures: record with `navigate`"), (readings, "samples of an EM tracker")):
        if not found:
            raise InputError(f"The session {record} holds no {what}.")
    values = np.array([[float(row[name]) for name in POSE_COLUMNS] for row in rows])
    T = transform_from_quaternion(values[:, :3], values[:, 3:])
    with naming(record):
        return calibrate_tip(T, np.array([float(row["t_s"]) for row in rows]), _samples(readings, str(record)))


def _samples(readings: list[TrackerSample], source: str) -> EmSamples:
    """Recorded samples as a log; NaN where nothing was seen."""

    def table(name: str, width: int) -> Array:
        values = [getattr(reading, name) for reading in readings]
        return np.array([[np.nan] * width if value is None else value for value in values], float)

    turned = table("quaternion_xyzw", 4)
    return EmSamples(
        table("position_mm", 3), table("axis", 3), np.array([reading.stamp.t_mono_s for reading in readings]),
        quaternion=turned if np.isfinite(turned).any() else None, source=source,
    )  # fmt: skip


def tip_report(found: TipCalibration, offset_s: float = 0.0) -> dict[str, Any]:
    """The tip JSON, plain data; ``offset_s`` was taken off the log's clock before."""
    return {
        "sensor_offset_mm": np.round(found.offset_mm, 4).tolist(),
        "sensor_offset_sd_mm": np.round(found.offset_sd_mm, 4).tolist(),
        "axis": None if np.isnan(found.axis).any() else np.round(found.axis, 5).tolist(),
        "axis_sd_deg": None if np.isnan(found.axis_sd_deg) else round(found.axis_sd_deg, 3),
        "R_camera_sensor": None if found.R_camera_sensor is None else found.R_camera_sensor.tolist(),
        "em_offset_s": round(found.em_offset_s + offset_s, 4),
        "em_offset_sd_s": round(found.em_offset_sd_s, 4),
        "R": found.T_kidney_em[:3, :3].tolist(),
        "t_mm": found.T_kidney_em[:3, 3].tolist(),
        "readings": found.n,
        "astray": found.astray,
        "rms_mm": round(found.rms_mm, 3),
    }


def tip_summary(found: TipCalibration, offset_s: float = 0.0) -> str:
    """A few lines for people."""
    place = ", ".join(f"{v:.2f} ± {s:.2f}" for v, s in zip(found.offset_mm, found.offset_sd_mm, strict=True))
    lines = [
        f"{found.n + found.astray} of {found.posed} pictures with a pose have an EM reading (by time); {found.astray} "
        f"whose poses are far off were left out; residual {found.rms_mm:.2f} mm (RMS)",
        f"sensor in the camera frame: {place} mm",
        f"EM clock ahead of the pictures' by {found.em_offset_s + offset_s:.3f} ± {found.em_offset_sd_s:.3f} s",
    ]
    if np.isfinite(found.axis).all():
        lines.insert(2, f"its axis: {np.round(found.axis, 3).tolist()} ± {found.axis_sd_deg:.1f} degrees")
    return "\n".join(lines)


def read_tip(path: Path) -> tuple[list[float], float]:
    """Sensor's place (3,) mm in the camera frame and clocks' offset in s, of a file by `calibrate_tip`.

    Raises:
        InputError: it is no such file.
    """
    data = read_json(path, "tip calibration")
    try:
        place, offset = [float(v) for v in data["sensor_offset_mm"]], float(data["em_offset_s"])
    except (KeyError, TypeError, ValueError):
        place, offset = [], 0.0
    if len(place) != 3 or not np.isfinite([*place, offset]).all():
        raise InputError(f"{path} is no tip calibration: expected sensor_offset_mm and em_offset_s, see calibrate_tip.")
    return place, offset


def live_place(path: Path) -> list[float]:
    """Sensor's place (3,) mm in the camera frame, for a live session; warns where a clocks' offset is not applied.

    Raises:
        InputError: it is no file by `calibrate_tip`.
    """
    place, offset_s = read_tip(path)
    if abs(offset_s) > _AT_ONCE_S:
        warnings.warn(
            f"{path} tells of an EM clock {offset_s:.3f} s ahead of the pictures'; navigate takes the sensor's place "
            "from it, but pairs a picture with the newest reading before it and does not apply the clocks' offset.",
            stacklevel=2,
        )
    return place
