"""What the `calibrate_tip` runner does: a localized video and its EM log in, the sensor on the camera out."""

from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.calibration.hand_eye import TipCalibration, calibrate_tip
from ursnav_torch.em_log import EmFormat, read_em_samples
from ursnav_torch.errors import InputError
from ursnav_torch.records import read_json
from ursnav_torch.runs.track_files import read_track
from ursnav_torch.tracking.tracker import TRACKING


def tip_of_track(track: Path, em: Path, form: EmFormat | None = None) -> TipCalibration:
    """The calibration from the rows of `track` that are tracking, and the video's EM log.

    Raises:
        InputError, RegistrationError: a file cannot be used, or see `calibrate_tip`.
    """
    rows = read_track(track)
    T = rows.T_kidney_camera.copy()
    T[[state != TRACKING for state in rows.state]] = np.nan
    return calibrate_tip(T, rows.t_s, read_em_samples(em, form))


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
        "rms_mm": round(found.rms_mm, 3),
    }


def tip_summary(found: TipCalibration, offset_s: float = 0.0) -> str:
    """A few lines for people."""
    place = ", ".join(f"{v:.2f} ± {s:.2f}" for v, s in zip(found.offset_mm, found.offset_sd_mm, strict=True))
    lines = [
        f"{found.n} EM readings used; residual {found.rms_mm:.2f} mm (RMS)",
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
