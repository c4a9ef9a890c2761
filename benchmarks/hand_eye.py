"""Is the sensor's place on the camera found, and the clocks' offset, with the uncertainty that is told?

    python -m benchmarks.hand_eye [data=DIR [work=DIR]] [seconds=240] [first=0] [astray=0.06]

20 simulated sessions from the seed ``first`` on, each with its own sensor, registration, offset and a track whose
errors go on from picture to picture, or with ``astray`` leave the place by up to 15 mm for that part of the time; with
data=, the supplied videos' true poses and EM logs; and with work=, too, their tracks without EM (``track
offline=true`` in a VID of the default size; VIDs and tracks stay there: some 20 minutes at first). How well a session
can tell is a matter of its length: weighted as well as can be, errors of 0.8 mm and 3 degrees that last a second leave
1.5 times as much after two minutes as after four (``seconds=120``).
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.shared.kidneys import vid_of
from benchmarks.shared.results import Report, overrides
from ursnav_torch.calibration.hand_eye import TipCalibration, calibrate_tip
from ursnav_torch.em_log import EmSamples, read_em_samples
from ursnav_torch.geometry import Array, apply, look_along, transform_from

#: Pictures a second, readings a second.
_FPS, _EM_HZ = 10.0, 40.0
#: As long as `calibrate_tip` asks for; sessions that no choice saw begin at 0, choices were made on those from 100 on.
SETTINGS: dict[str, Any] = {"data": "", "seconds": 240.0, "first": 0, "astray": 0.0, "work": "", "out": ""}
_SESSIONS = 20


def simulated_drive(seed: int, seconds: float = 120.0) -> tuple[Array, Array, EmSamples, Array, Array, float]:
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

    t_s, clock = np.arange(0, seconds, 1 / _FPS), np.arange(0, seconds, 1 / _EM_HZ)
    T, T_read = pose(t_s), pose(clock)
    sensor = apply(T_read, np.broadcast_to(offset, (len(clock), 3)))
    position = apply(T_em_kidney, sensor) + rng.normal(0, 0.7 / np.sqrt(3), sensor.shape)
    heading = T_read[:, :3, :3] @ axis @ T_em_kidney[:3, :3].T + rng.normal(0, np.radians(0.6), (len(clock), 3))
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    tracked = _tracked(T, rng)
    shaken = Rotation.from_rotvec(rng.normal(0, np.radians(0.6), (len(clock), 3)))
    turned = Rotation.from_matrix(T_em_kidney[:3, :3] @ T_read[:, :3, :3] @ sensor_on_camera(axis)) * shaken
    samples = EmSamples(position, heading, clock + ahead, quaternion=turned.as_quat())
    return tracked, t_s, samples, offset, axis, ahead


def sensor_on_camera(axis: Array) -> Array:
    """(3, 3) orientation of a simulated sensor with six degrees of freedom: its z along ``axis`` (3,)."""
    return np.asarray(Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0].as_matrix())


def _tracked(T: Array, rng: np.random.Generator) -> Array:
    """Poses with a track's errors: about 0.8 mm and 3 degrees, going on over a second."""
    errors = np.zeros((len(T), 6))
    for i in range(1, len(T)):
        errors[i] = 0.9 * errors[i - 1] + rng.normal(0, 1, 6) * np.sqrt(1 - 0.81)
    found = T.copy()
    found[:, :3, 3] += errors[:, :3] * 0.8 / np.sqrt(3)
    found[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(errors[:, 3:] * np.radians(3) / np.sqrt(3)).as_matrix()
    return found


def _gone_astray(T: Array, rng: np.random.Generator, share: float) -> Array:
    """Poses (N, 4, 4) of which a share, some seconds at a time, is off by 2.5 to 15 mm and some degrees."""
    found, count = T.copy(), 0
    while count < share * len(T):
        first, length = int(rng.integers(0, len(T))), int(rng.integers(5, 40))
        away = rng.normal(0, 1, 3)
        ahead = T[first, :3, 2] if rng.random() < 0.5 else away / np.linalg.norm(away)
        found[first : first + length, :3, 3] += ahead * rng.uniform(2.5, 15)
        turn = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix()
        found[first : first + length, :3, :3] = found[first : first + length, :3, :3] @ turn
        count += length
    return found


def simulated(first: int, seconds: float, astray: float = 0.0) -> Array:
    """Misses in mm, degrees and ms, and the place's and offset's in standard deviations, of every session (20, 6).

    The last is a sensor's orientation, of six degrees of freedom, in degrees.
    """
    rows = []
    for seed in range(first, first + _SESSIONS):
        T, t_s, samples, offset, axis, ahead = simulated_drive(seed, seconds)
        T = _gone_astray(T, np.random.default_rng(seed), astray)
        found = calibrate_tip(T, t_s, samples)
        miss, late = found.offset_mm - offset, found.em_offset_s - ahead
        angle = np.degrees(np.arccos(np.clip(found.axis @ axis, -1, 1)))
        sigmas = float(np.sqrt(np.mean((miss / found.offset_sd_mm) ** 2)))
        assert found.R_camera_sensor is not None
        turned = Rotation.from_matrix(found.R_camera_sensor.T @ sensor_on_camera(axis)).magnitude()
        rows.append([
            float(np.linalg.norm(miss)), angle, abs(late) * 1e3, sigmas, abs(late) / found.em_offset_sd_s,
            np.degrees(turned),
        ])  # fmt: skip
    return np.array(rows)


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


def supplied_tracks(data: Path, work: Path) -> list[tuple[str, TipCalibration, Array]]:
    """The same videos, by their tracks without EM instead of their true poses."""
    from ursnav_torch.runs.calibrate_tip import tip_of_track

    found = []
    for about in sorted(data.glob("*/video.json")):
        name, track = about.parent.name, work / f"{about.parent.name}_track.csv"
        if not track.exists():
            vid_of(data, name, work)
            call = [sys.executable, "-m", "ursnav_torch.track", f"vid={work / (name + '_default')}"]
            subprocess.run([*call, f"source={about.with_suffix('.mp4')}", f"out={track}", "offline=true"], check=True)
        truth = json.loads(about.read_text(encoding="utf-8"))["sensor_offset_camera_mm"]
        found.append((name, tip_of_track(track, about.parent / "video_em.csv"), np.array(truth)))
    return found


def main(arguments: list[str]) -> None:
    """Print and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    report = Report("hand_eye", settings | {"data": "", "work": ""})
    rows = simulated(int(settings["first"]), float(settings["seconds"]), float(settings["astray"]))
    for name, unit, column in (
        ("place", "mm", 0), ("axis", "deg", 1), ("clocks", "ms", 2), ("orientation, 6 DoF", "deg", 5),
    ):  # fmt: skip
        report.add("sessions", name, unit, rows[:, column].tolist())
        report.add("worst of the sessions", name, unit, [float(rows[:, column].max())], n=len(rows))
    for name, column in (("place", 3), ("clocks", 4)):
        spread = float(np.sqrt(np.mean(rows[:, column] ** 2)))
        report.add("root mean square miss in standard deviations told", name, "sd", [spread], "1 is right", len(rows))
    data, work = Path(settings["data"]), Path(settings["work"])
    groups = {"supplied, true poses": supplied(data)} if settings["data"] else {}
    if settings["data"] and settings["work"]:
        groups["supplied, tracked without EM"] = supplied_tracks(data, work)
    for group, calibrations in groups.items():
        for name, found, truth in calibrations:
            note = f"clocks {1e3 * found.em_offset_s:.1f} ms apart, which are one; {found.n} pictures, "
            note += f"{found.astray} left out; {np.round(found.offset_mm - truth, 2).tolist()} mm"
            report.add(group, name, "mm", [float(np.linalg.norm(found.offset_mm - truth))], note)
    report.finish(settings["out"])


if __name__ == "__main__":
    main(sys.argv[1:])
