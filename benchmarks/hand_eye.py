"""Is the sensor's place on the camera found, and the clocks' offset, with the uncertainty that is told?

    python -m benchmarks.hand_eye [data=DIR]

20 simulated drives, each with its own sensor, registration, offset and a track whose errors go on from picture to
picture; and, with data=, the supplied videos' true poses and EM logs.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ursnav_torch.calibration.hand_eye import TipCalibration, calibrate_tip
from ursnav_torch.em_log import EmSamples, read_em_samples
from ursnav_torch.geometry import Array, apply, look_along, transform_from

#: Pictures a second, readings a second, seconds of a drive.
_FPS, _EM_HZ, _LONG_S = 10.0, 40.0, 120.0


def simulated_drive(seed: int) -> tuple[Array, Array, EmSamples, Array, Array, float]:
    """A tracked drive, its times, its log, and the truth: sensor's place, its axis, the clocks' offset."""
    rng = np.random.default_rng(seed)
    offset, axis = rng.uniform([-2, -2, -6], [2, 2, -2]), rng.normal([0, 0, 3], 1, 3)
    axis, ahead = axis / np.linalg.norm(axis), float(rng.uniform(-1, 1))
    T_em_kidney = transform_from(Rotation.random(random_state=seed).as_matrix(), rng.uniform(-200, 200, 3))
    waves = rng.uniform(0.03, 0.25, (6, 3)), rng.uniform(0, 6.28, (6, 3)), rng.normal(0, 1, (6, 3))

    def pose(t: Array) -> Array:
        motion = np.einsum("tkc,kc->tkc", np.sin(6.28 * waves[0] * t[:, None, None] + waves[1]), waves[2])
        place, aim = 12 * motion[:, :3].sum(1) / 2, motion[:, 3:].sum(1) * [0, 0.5, 0.5] + [1.5, 0, 0]
        return look_along(place, aim, motion[:, 5, 2] * 0.5)

    t_s, clock = np.arange(0, _LONG_S, 1 / _FPS), np.arange(0, _LONG_S, 1 / _EM_HZ)
    T, T_read = pose(t_s), pose(clock)
    sensor = apply(T_read, np.broadcast_to(offset, (len(clock), 3)))
    position = apply(T_em_kidney, sensor) + rng.normal(0, 0.7 / np.sqrt(3), sensor.shape)
    heading = T_read[:, :3, :3] @ axis @ T_em_kidney[:3, :3].T + rng.normal(0, np.radians(0.6), (len(clock), 3))
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    return _tracked(T, rng), t_s, EmSamples(position, heading, clock + ahead), offset, axis, ahead


def _tracked(T: Array, rng: np.random.Generator) -> Array:
    """Poses with a track's errors: about 0.8 mm and 3 degrees, going on over a second."""
    errors = np.zeros((len(T), 6))
    for i in range(1, len(T)):
        errors[i] = 0.9 * errors[i - 1] + rng.normal(0, 1, 6) * np.sqrt(1 - 0.81)
    found = T.copy()
    found[:, :3, 3] += errors[:, :3] * 0.8 / np.sqrt(3)
    found[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(errors[:, 3:] * np.radians(3) / np.sqrt(3)).as_matrix()
    return found


def simulated() -> list[list[float]]:
    """Of 20 drives: the misses in mm, degrees and ms, and the place's and offset's misses in standard deviations."""
    rows = []
    for seed in range(20):
        T, t_s, samples, offset, axis, ahead = simulated_drive(seed)
        found = calibrate_tip(T, t_s, samples)
        miss, late = found.offset_mm - offset, found.em_offset_s - ahead
        angle = np.degrees(np.arccos(np.clip(found.axis @ axis, -1, 1)))
        sigmas = float(np.sqrt(np.mean((miss / found.offset_sd_mm) ** 2)))
        rows.append([float(np.linalg.norm(miss)), angle, abs(late) * 1e3, sigmas, abs(late) / found.em_offset_sd_s])
    return rows


def supplied(data: Path) -> list[tuple[str, TipCalibration, Array]]:
    """The videos that have an EM log, by their true poses, and the sensor's true place."""
    from ursnav_torch.tables import read_csv
    from ursnav_torch.vid import poses_from_rows

    found = []
    for about in sorted(data.glob("*/video.json")):
        T = poses_from_rows(read_csv(about.parent / "video_truth.csv", ("image",), "truth"))
        truth = json.loads(about.read_text(encoding="utf-8"))
        samples = read_em_samples(about.parent / "video_em.csv")
        calibration = calibrate_tip(T, np.arange(len(T)) / truth["fps"], samples)
        found.append((about.parent.name, calibration, np.array(truth["sensor_offset_camera_mm"])))
    return found


def main() -> None:
    """Print the table."""
    rows = np.array(simulated())
    print("simulated drive: place mm, axis deg, time ms, place and time in standard deviations")
    mean_square = np.sqrt(np.mean(rows**2, axis=0))  # in standard deviations about 1 where the uncertainty holds
    for name, row in (("median", np.median(rows, axis=0)), ("rms", mean_square), ("largest", rows.max(axis=0))):
        print(f"{name:8s} {row[0]:6.2f} {row[1]:6.2f} {row[2]:6.1f} {row[3]:6.2f} {row[4]:6.2f}")
    folder = next((Path(a.removeprefix("data=")) for a in sys.argv[1:] if a.startswith("data=")), None)
    for name, found, truth in supplied(folder) if folder else ():
        miss = np.linalg.norm(found.offset_mm - truth)
        print(f"{name}: {miss:.2f} mm off, {1e3 * found.em_offset_s:.1f} ms")


if __name__ == "__main__":
    main()
