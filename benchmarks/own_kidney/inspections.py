"""Pictures of a scope that explores by itself: slow, close to walls, turned to what was not seen yet."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.exploring import noisy_truth
from benchmarks.exploring.sight import StoneSight
from benchmarks.exploring.twins import Anatomy, stone_in, tissue_of, twin_in
from benchmarks.shared.flights import Case, Flown
from ursnav_torch.autonomy import AutonomySettings, Explorer
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.navigation.rehearsal import PictureAnswer, Rehearsal
from ursnav_torch.simulation import SimulatedTime, Twin
from ursnav_torch.simulation.flight import Flight
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]

#: As the exploring suite is run with a tracker.
RATE_HZ = 7.5


def one_a_phantom(cases: Sequence[Case]) -> list[Case]:
    """Of three flights through each phantom one, the kinds of pictures in turn."""
    return [case for i, case in enumerate(cases) if i % 3 == i // 3 % 3]


def inspected(case: Case, vid: Vid, pictures: int, work: Path) -> Flown:
    """The first pictures of an exploration by true places with noise; drawn once, as a flight's are."""
    key = hashlib.sha256(repr((case, pictures, vid.folder.name, AutonomySettings())).encode()).hexdigest()[:8]
    folder = work / f"inspected_{case.name}_{key}"
    if not (folder / "flight.npz").exists():
        _draw(case, vid, pictures, folder)
    with np.load(folder / "flight.npz") as kept:
        return Flown(case, Flight(kept["t_s"], kept["T"], kept["odometry"]), np.zeros(len(kept["t_s"])), folder)


def _draw(case: Case, vid: Vid, pictures: int, folder: Path) -> None:
    known = Anatomy(vid.kidney, vid.lumen, vid.camera, vid.T_kidney_camera, vid)
    rng, clock = np.random.default_rng([case.seed, 21]), SimulatedTime()
    stone, blocked = stone_in(known, rng)
    explorer = Explorer(Coverage(vid.kidney, vid.camera, vid.lumen, vid.T_kidney_camera[::2]), vid.lumen)
    twin = twin_in(case, known, rng, clock, stone, tissue_of("breathing"))
    place = noisy_truth(rng, StoneSight(known, stone, blocked, np.random.default_rng([case.seed, 24])))
    t_s, poses, odometry = [], [], []
    folder.mkdir(parents=True, exist_ok=True)

    def locate(twin: Twin, now_s: float) -> PictureAnswer:
        joints = twin.scope.drive.joints(twin.axes_mm())
        cv2.imwrite(str(folder / f"{len(t_s):04d}.png"), twin.image())
        t_s.append(now_s)
        poses.append(twin.pose())
        odometry.append((joints.insertion_mm, joints.bend_x_rad, joints.bend_y_rad))
        return place(twin, now_s)

    Rehearsal(twin, explorer, locate, RATE_HZ, clock=clock).run(pictures / RATE_HZ)
    np.savez(folder / "flight.npz", t_s=np.array(t_s), T=np.array(poses), odometry=np.array(odometry))
