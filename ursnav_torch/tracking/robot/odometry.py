"""The camera's motion from what the robot reports of itself: kinematics behind plays of unknown width, learned.

Cables and slider have play, and a shaft buckles before its tip follows, so that a reported step may move nothing
(hysteresis: 68-70 % of it is compensable, 1.7 mm remain, PMID 41761634). Each axis has a bank of plays of different
widths (multiple-model estimation, Blom and Bar-Shalom, IEEE TAC 33:780, 1988); what the pictures show decides which
of them is believed, and how far they disagree is what odometry does not know.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.kinematics import Segment
from ursnav_torch.scaling import NO_ANATOMY

Array = NDArray[np.float64]
#: Standard deviations of steps that are seen: mm, and degrees.
_SEEN_MM, _SEEN_DEG = 0.15, 1.0
#: A step that no play explains (a wall stopped it) counts against each by no more than this, squared deviations.
_MOST_OFF = 9.0
#: The bend stays within this about either axis, radians.
_LARGEST_BEND = 2.1
#: Turns seen and told before either counts: so much stands for no roll, square radians.
_NO_ROLL = 0.025


@dataclass(frozen=True, slots=True)
class OdometryReading:
    """What the robot says of its joints at one time: insertion in mm, bends about x and y in radians."""

    insertion_mm: float
    bend_x_rad: float = 0.0
    bend_y_rad: float = 0.0

    def joints(self) -> Array:
        """(3,) insertion, bend x, bend y."""
        return np.array([self.insertion_mm, self.bend_x_rad, self.bend_y_rad])


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """How far the robot's word is believed.

    Attributes:
        insertion_plays_mm, bend_plays_deg: widths of the plays in the banks.
        insertion_mm_s, bend_deg_s: standard deviation of the motion that no motor asked for: breathing, a hand; mm at
            the kidney's scale 1.
        insertion_share, bend_share: of a reported step, that may go astray: buckling, walls.
        memory_s: what the pictures showed longer ago counts for less.
        length_mm: of the bending segment, from tip to base.

    Plays and segment are the robot's own: a larger kidney does not enlarge them.
    """

    insertion_plays_mm: tuple[float, ...] = field(default=(0.0, 0.5, 1.0, 2.0, 3.5), metadata=NO_ANATOMY)
    bend_plays_deg: tuple[float, ...] = (0.0, 3.0, 6.0, 12.0, 20.0)
    insertion_mm_s: float = 2.0
    bend_deg_s: float = 10.0
    insertion_share: float = 0.35
    bend_share: float = 0.35
    memory_s: float = 10.0
    length_mm: float = field(default=20.0, metadata=NO_ANATOMY)

    def __post_init__(self) -> None:
        for name in ("insertion_plays_mm", "bend_plays_deg"):  # lists, where a configuration gives them
            object.__setattr__(self, name, tuple(float(width) for width in getattr(self, name)))
        if min(self.insertion_mm_s, self.bend_deg_s, self.memory_s, self.length_mm) <= 0:
            raise InputError(f"Odometry needs standard deviations, times and a length above 0, got {self}.")
        if min(*self.insertion_plays_mm, *self.bend_plays_deg) < 0:
            raise InputError(f"A play's width must not be below 0, got {self}.")


@dataclass(frozen=True, slots=True)
class Carried:
    """How the camera was carried from one time to a later one.

    Attributes:
        T_before_now: (4, 4) the later pose in the frame of the earlier one.
        sd_mm, sd_rad: standard deviations of its place, along the axis where it is least sure, and of its turn.
        seconds: between the two.
    """

    T_before_now: Array
    sd_mm: float
    sd_rad: float
    seconds: float

    def then(self, later: "Carried") -> "Carried":
        """This motion, and another after it; what either does not know adds up as if it were alike (a drift does)."""
        T = self.T_before_now @ later.T_before_now
        R = Rotation.from_matrix(T[:3, :3]).as_matrix()  # without the rounding errors that products gather
        return Carried(
            transform_from(R, T[:3, 3]),
            self.sd_mm + later.sd_mm,
            self.sd_rad + later.sd_rad,
            self.seconds + later.seconds,
        )


#: Not carried at all.
STILL = Carried(np.eye(4), 0.0, 0.0, 0.0)


class PlayBank:
    """Plays of several widths behind one axis, and how probable each is.

    Args:
        widths: (M,) of the plays, in the axis's unit.
        noise: standard deviation of a step that is seen, in that unit.
    """

    def __init__(self, widths: ArrayLike, noise: float) -> None:
        self._half = np.asarray(widths, float) / 2
        self._noise = noise
        self._log_weight = np.zeros(len(self._half))
        self._last = np.zeros(len(self._half))
        self._at: Array | None = None

    def step(self, motor: float) -> tuple[float, float]:
        """Mean and standard deviation of the output's step, after the motor has come to a position."""
        before = np.full(len(self._half), motor) if self._at is None else self._at
        self._at = np.clip(before, motor - self._half, motor + self._half)
        self._last = self._at - before
        weight = self.weight()
        mean = float(weight @ self._last)
        return mean, float(np.sqrt(weight @ (self._last - mean) ** 2))

    def width(self) -> float:
        """The play's expected width."""
        return float(2 * self.weight() @ self._half)

    def weight(self) -> Array:
        """(M,) probabilities."""
        w = np.exp(self._log_weight - self._log_weight.max())
        return w / w.sum()

    def learn(self, seen: float, sd: float, keep: float) -> None:
        """Take in the step that was seen to follow the last `step`, known within ``sd``; what was is kept in part."""
        off = (self._last - seen) / np.hypot(sd, self._noise)
        self._log_weight = keep * self._log_weight - 0.5 * np.minimum(off**2, _MOST_OFF)


class Odometry:
    """Motion of the camera from the joints that a robot reports.

    Args:
        settings: see `OdometrySettings`, lengths of anatomy in mm of this kidney.

    Attributes:
        segment: that bends the tip.
        insertion: plays of the slider.
        bend: (2,) of the segment, as far as the plays let the motors through.
        inserted_mm: how deep the shaft is, as told last, and whether it was ``pushed`` to get there.
    """

    def __init__(self, settings: OdometrySettings | None = None) -> None:
        self.settings = settings or OdometrySettings()
        self.segment = Segment(length_mm=self.settings.length_mm)
        self.reset()

    def reset(self) -> None:
        """Forget the plays and the camera's roll against the cables."""
        s = self.settings
        self.insertion = PlayBank(s.insertion_plays_mm, _SEEN_MM)
        self.bends = [PlayBank(np.radians(s.bend_plays_deg), np.radians(_SEEN_DEG)) for _ in range(2)]
        self.bend = np.zeros(2)
        self.inserted_mm, self.pushed = 0.0, False
        self._mixed = complex(_NO_ROLL)  # turns seen against turns told: their angle is the camera's roll
        self._pending: tuple[float, Array] | None = None

    def carried(self, reading: OdometryReading, seconds: float) -> Carried:
        """The camera's mean motion over the seconds before a reading; the first one tells of none."""
        s, dt = self.settings, max(seconds, 1e-3)
        self.pushed, self.inserted_mm = reading.insertion_mm > self.inserted_mm, reading.insertion_mm
        advance, unsure = self.insertion.step(reading.insertion_mm)
        steps = [bank.step(b) for bank, b in zip(self.bends, reading.joints()[1:], strict=True)]
        turned, turn_unsure = (np.array(x) for x in zip(*steps, strict=True))
        straight = self._stepped(turned, advance)
        self._pending = (advance, turned)
        self.bend = np.clip(self.bend + turned, -_LARGEST_BEND, _LARGEST_BEND)
        roll = transform_from(Rotation.from_rotvec([0, 0, self.roll()]).as_matrix(), np.zeros(3))
        along = np.hypot(s.insertion_mm_s * dt, np.hypot(unsure, s.insertion_share * advance))
        swing = np.hypot(np.radians(s.bend_deg_s) * dt, np.hypot(turn_unsure, s.bend_share * turned).max())
        aside = np.hypot(along, swing * self.segment.length_mm / 2)
        return Carried(roll @ straight @ inverse(roll), float(aside), float(swing), dt)

    def learn(self, T_before_now: Array, position_sd_mm: float, turn_sd: float, seconds: float) -> None:
        """Compare the step (4, 4) that pictures showed with what the last reading told."""
        if self._pending is None:
            return
        keep = float(np.exp(-seconds / self.settings.memory_s))
        turn = Rotation.from_matrix(T_before_now[:3, :3]).as_rotvec()
        advance, told = self._pending
        self._pending = None
        c, s = np.cos(self.roll()), np.sin(self.roll())
        seen = np.array([c * turn[0] + s * turn[1], c * turn[1] - s * turn[0]])
        self.insertion.learn(float(T_before_now[2, 3]), position_sd_mm, keep)
        for bank, value in zip(self.bends, seen, strict=True):
            bank.learn(float(value), turn_sd, keep)
        straight = Rotation.from_matrix(self._stepped(told, advance)[:3, :3]).as_rotvec()
        self._mixed = keep * self._mixed + complex(*turn[:2]) * complex(straight[0], -straight[1])

    def roll(self) -> float:
        """Angle of the camera's x axis against the cables', as far as turns have shown it."""
        return float(np.angle(self._mixed))

    def _stepped(self, turned: Array, advance: float) -> Array:
        """(4, 4) how the tip goes in its own frame: the bend swings it, the push drives it along its curve."""
        length, bend = self.segment.length_mm, self.bend
        after = bend + turned
        swing = inverse(self.segment.point_transform(bend)) @ self.segment.point_transform(after)
        ahead = inverse(self.segment.point_transform(after)) @ self.segment.point_transform(after, length + advance)
        return np.asarray(swing @ ahead, float)
