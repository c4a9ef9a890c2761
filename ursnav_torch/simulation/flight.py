"""Flights of the twin in simulated time: true poses at a camera's rate, beside what the robot reports of itself.

The pilot steers into one calyx after the other; the drive's plays, the shaft's buckling and the walls keep the tip
from doing all that the motors ask for, so that odometry drifts and lags as a real robot's does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.devices import JointRates, Joints, Limits, clamp_rates
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array, look_along, transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.scaling import scaled
from ursnav_torch.simulation.pilot import TwinPilot
from ursnav_torch.simulation.twin import Scope, Twin

#: Commands a second, as the session's control loop sends them.
COMMAND_HZ = 60
#: A flight that finds no way is cut off after so many simulated seconds.
_LONGEST_S = 240.0
#: Breaths a second of a ventilated patient; scope and kidney ride on them but for `FlightSettings.breathing_mm`.
_BREATH_HZ = 0.25


@dataclass(frozen=True, slots=True)
class FlightSettings:
    """How a flight is flown; mm at the kidney's scale 1.

    Attributes:
        speed_mm_s: the slider at full stick, going in.
        withdrawal: times that speed going out.
        turn_deg_s: the bend at full stick.
        pictures_per_s: rate of the camera.
        pictures: taken at most.
        stops: share of the time in which the operator lets go of the sticks.
        breathing_mm: amplitude by which the lumen slides past the scope as the patient breathes.
        roll_deg_s: slow wandering of the shaft's roll that no motor knows of.
        tremor_mm, tremor_deg: from picture to picture, of a held scope.
    """

    speed_mm_s: float = 6.0
    withdrawal: float = 1.5
    turn_deg_s: float = 60.0
    pictures_per_s: float = 10.0
    pictures: int = 160
    stops: float = 0.1
    breathing_mm: float = 0.0
    roll_deg_s: float = 3.0
    tremor_mm: float = 0.05
    tremor_deg: float = 0.4

    def __post_init__(self) -> None:
        if min(self.speed_mm_s, self.withdrawal, self.turn_deg_s, self.pictures_per_s, self.pictures) <= 0:
            raise InputError(f"A flight needs speeds, a rate and a number of pictures above 0, got {self}.")
        if not 0 <= self.stops < 1:
            raise InputError(f"stops={self.stops} is a share of the time; it must lie in 0..1, below 1.")


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """A flight, N pictures long.

    Attributes:
        t_s: (N,) when each picture is taken.
        T_kidney_camera: (N, 4, 4) true poses.
        odometry: (N, 3) what the robot reports then: insertion in mm, bends about x and y in radians.
    """

    t_s: Array
    T_kidney_camera: Array
    odometry: Array


class Room(Protocol):
    """What a scope feels of where it is: a `LumenDistance`, or one with stones in it."""

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        """(N,) distance in mm from points (N, 3), kidney frame, to the nearest obstacle; negative inside it."""
        ...


def fly(
    kidney: Kidney,
    lumen: Room,
    calyces: tuple[str, ...],
    settings: FlightSettings,
    rng: np.random.Generator,
    scope: Scope | None = None,
) -> Flight:
    """A flight from the pelvis into each of some calyces, and out again.

    Args:
        kidney, lumen: where, and clearances in it.
        calyces: names, in the order of the visits; those that cannot be entered are given up.
        settings: how it is flown.
        rng: draws stops, breathing, roll and tremor.
        scope: the scope with its plays; the twin's own when None.
    """
    settings = scaled(settings, kidney.scale)
    twin = Twin(lumen.clearance_mm, _no_picture, _start(kidney, rng), scope)
    flown = list(_flown(twin, kidney, calyces, settings, rng))[: settings.pictures]
    t_s, poses, joints = (np.array(part) for part in zip(*flown, strict=True))
    poses = _unsteady(poses, t_s, settings, kidney.scale, lumen.clearance_mm, rng)
    return Flight(t_s, poses, joints)


def _flown(
    twin: Twin, kidney: Kidney, calyces: tuple[str, ...], settings: FlightSettings, rng: np.random.Generator
) -> list[tuple[float, Array, Array]]:
    """Time, pose of the twin and reported joints at the camera's rate, until the pilot is done."""
    now, joints = 0.0, Joints()
    speed, bend = settings.speed_mm_s, np.radians(settings.turn_deg_s)
    limits = replace(
        Limits(),
        max_bend_rate_rad_s=float(bend),
        max_insertion_rate_mm_s=float(speed * max(settings.withdrawal, 1.0)),
    )
    pilot = TwinPilot(twin, kidney, calyces, clock=lambda: now)
    pilot.connect()
    twin.drive_with(lambda: twin.scope.drive.axes_mm(joints))
    rows: list[tuple[float, Array, Array]] = []
    due, held_until = 0.0, 0.0
    while now < _LONGEST_S and len(rows) < settings.pictures:
        hands = pilot.read()
        if hands.quit:
            break
        if now >= held_until and rng.random() < settings.stops / (1 - settings.stops) / COMMAND_HZ:
            held_until = now + float(rng.exponential(1.0))  # mean stop of 1 s
        if now >= held_until:
            push = hands.insertion * speed * (settings.withdrawal if hands.insertion < 0 else 1.0)
            rates = clamp_rates(
                JointRates(hands.bend_x * bend, hands.bend_y * bend, push), joints, limits, 1 / COMMAND_HZ
            )
            joints = Joints(
                joints.bend_x_rad + rates.bend_x_rad_s / COMMAND_HZ,
                joints.bend_y_rad + rates.bend_y_rad_s / COMMAND_HZ,
                joints.insertion_mm + rates.insertion_mm_s / COMMAND_HZ,
            )
        pose = twin.pose()
        if now >= due:
            due += 1 / settings.pictures_per_s
            rows.append((now, pose, np.array([joints.insertion_mm, joints.bend_x_rad, joints.bend_y_rad])))
        now += 1 / COMMAND_HZ
    return rows


def _unsteady(
    poses: Array,
    t_s: Array,
    settings: FlightSettings,
    unit: float,
    clearance_mm: Callable[[Array], Array],
    rng: np.random.Generator,
) -> Array:
    """Poses with what no motor did: breathing, a wandering roll, a hand's tremor; kept off the walls."""
    count = len(t_s)
    step = settings.roll_deg_s / settings.pictures_per_s**0.5
    roll = np.cumsum(rng.normal(0, np.radians(step), count))
    along = rng.standard_normal(3)
    breath = np.sin(2 * np.pi * _BREATH_HZ * t_s + rng.uniform(0, 2 * np.pi)) * settings.breathing_mm
    moved = breath[:, None] * along / np.linalg.norm(along) + rng.normal(0, settings.tremor_mm, (count, 3))
    place = poses[:, :3, 3]
    room = clearance_mm(place + moved)
    moved = np.where((room < np.minimum(clearance_mm(place), 0.6 * unit))[:, None], 0.25 * moved, moved)
    turn = rng.normal(0, np.radians(settings.tremor_deg), (count, 3))
    turn[:, 2] += roll
    return poses @ _shifted(poses, moved, Rotation.from_rotvec(turn).as_matrix())


def _shifted(poses: Array, moved: Array, R: Array) -> Array:
    """Transforms (N, 4, 4) in the cameras' frames that move by ``moved`` (N, 3), kidney frame, and turn by R."""
    return transform_from(R, np.einsum("nji,nj->ni", poses[:, :3, :3], moved))


def _start(kidney: Kidney, rng: np.random.Generator) -> Array:
    """The tip at the root of the centerline, looking to the middle of the calyces, at any roll."""
    start = kidney.centerline.points_mm[0]
    return look_along(start, kidney.tips_mm.mean(axis=0) - start, float(rng.uniform(-np.pi, np.pi)))


def _no_picture(T_kidney_camera: Array) -> NDArray[np.uint8]:
    """The twin's picture: flights are drawn afterwards."""
    return np.zeros((1, 1), np.uint8)
