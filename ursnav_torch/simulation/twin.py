"""The digital twin: a cable-driven scope in a lumen, with slack in its drive, walls in its way and an EM sensor.

The twin knows the truth; devices see it only through their own channels: motors by the controller's steps, the
picture through a renderer, the EM sensor with noise and distortion in a frame of its own.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.devices import Drive
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array, check_rigid, inverse
from ursnav_torch.simulation.em_field import EmField
from ursnav_torch.simulation.ndi_unit import SensorReading

LARGEST_STEP_MM, LARGEST_BEND_RAD = 0.2, 0.02
SHARES = np.linspace(0.0, 1.0, 33)


@dataclass(frozen=True, slots=True)
class Scope:
    """A simulated scope.

    Args:
        drive: cables, slider and segment.
        keep_off_mm: how near the tip's center may come to a wall; less than half a scope's diameter, as infundibula
            stretch and the lumen was drawn at rest.
        backlash: width of the drive's plays, for cable x, cable y and slider, in mm of the axis.
        compression_mm: how far the shaft gives way before pushing against a wall moves nothing any more.
        friction: a shaft that is pushed round a bend of the tip buckles: of what is pushed, 1 - exp(-friction x bend)
            goes into a loop in the pelvis (the belt equation, Euler and Eytelwein), and comes out of it first as it
            is pulled; 0 for none.
        loop_mm: what such a loop takes at most; no published figure found.

    Raises:
        InputError: the distance is not positive, a play, the compression, friction or loop is negative.
    """

    drive: Drive = field(default_factory=Drive)
    keep_off_mm: float = 0.6
    backlash: tuple[float, float, float] = (0.06, 0.06, 0.2)
    compression_mm: float = 2.0
    friction: float = 0.0
    loop_mm: float = 6.0

    def __post_init__(self) -> None:
        if not self.keep_off_mm > 0 or min(self.backlash) < 0 or self.compression_mm < 0:
            raise InputError(
                f"A scope needs keep_off_mm > 0, backlash and compression_mm >= 0; got {self.keep_off_mm}, "
                f"{self.backlash}, {self.compression_mm}."
            )
        if self.friction < 0 or self.loop_mm < 0:
            raise InputError(f"A scope needs friction and loop_mm >= 0; got {self.friction} and {self.loop_mm}.")


@dataclass(frozen=True, slots=True)
class Mark:
    """A place on the way in: how deep the shaft was, the tip's pose (4, 4) and its bend (2,)."""

    insertion_mm: float
    T_kidney_tip: Array
    bend: Array


class Hysteresis:
    """Backlash with rounded corners: the mean of plays of 0.2, 0.6 and 1 times half the width (Prandtl-Ishlinskii)."""

    def __init__(self, width: ArrayLike) -> None:
        self._reach = np.asarray(width, float)[:, None] / 2 * np.array([0.2, 0.6, 1.0])
        self._plays = np.zeros_like(self._reach)

    def __call__(self, motors: Array) -> Array:
        """Output (3,) for motor positions (3,); depends on where they came from."""
        self._plays = np.clip(self._plays, motors[:, None] - self._reach, motors[:, None] + self._reach)
        return self._plays.mean(axis=1)


class Twin:
    """A scope in a lumen; moves when its motors have moved. Threads may share it.

    Bending swings the tip as the segment's curve says, until it touches a wall; pushing drives it on along that
    curve, the shaft following where the tip leads; pulling withdraws it the way it came. Only the tip's center
    feels walls: tissue gives way to the flanks of a real scope, too.

    Args:
        clearance_mm: distance (N,) to the wall at points (N, 3), kidney frame, negative outside.
        render: picture uint8 of a camera at ``T_kidney_camera`` (4, 4), as bright as a full LED makes it.
        T_kidney_start: pose (4, 4) of the tip with straight and withdrawn joints.
        scope: the scope.
        em: the EM tracker's world.
        breathing: by how much (3,) mm, kidney frame, the scope is off its place in the kidney now; None for not at all.

    Raises:
        InputError: the start lies nearer to a wall than the tip may come.
    """

    def __init__(
        self,
        clearance_mm: Callable[[Array], Array],
        render: Callable[[Array], NDArray[np.uint8]],
        T_kidney_start: ArrayLike,
        scope: Scope | None = None,
        em: EmField | None = None,
        breathing: Callable[[], Array] | None = None,
    ) -> None:
        self.scope, self.em = scope or Scope(), em or EmField()
        self._clearance, self._render, self._breathing = clearance_mm, render, breathing
        self._segment = self.scope.drive.segment
        start = check_rigid(T_kidney_start, "T_kidney_start")
        room = float(clearance_mm(start[None, :3, 3])[0])
        if room < self.scope.keep_off_mm:
            raise InputError(
                f"The scope starts {room:.1f} mm from the wall but must keep off {self.scope.keep_off_mm} mm; "
                "choose a start in the open, for example the root of the centerline."
            )
        self._trail = [Mark(0.0, start, np.zeros(2))]
        self._T_kidney_tip, self._bend = start, np.zeros(2)
        self._insertion, self._shift, self._pressed, self._loop = 0.0, 0.0, 0.0, 0.0
        self._hysteresis = Hysteresis(self.scope.backlash)
        self._last_axes = np.zeros(3)
        self._axes: Callable[[], Array] = lambda: np.zeros(3)
        self._light: Callable[[], float] = lambda: 1.0
        self._lock = threading.RLock()

    def drive_with(self, axes_mm: Callable[[], Array], light: Callable[[], float] | None = None) -> None:
        """Connect a simulated controller: axis positions (3,) in mm (cables, slider) and the LED's level 0..1."""
        with self._lock:
            self._axes, self._light = axes_mm, light or self._light

    def axes_mm(self) -> Array:
        """Where the controller's axes are now, (3,) mm: what the robot could report."""
        with self._lock:
            return np.asarray(self._axes(), float)

    @property
    def undisturbed(self) -> Array:
        """Where (4, 4) the scope took the tip at the last look, but for breathing."""
        return self._T_kidney_tip

    @property
    def bend(self) -> Array:
        """The true bend (2,) in radians, which slack and walls keep from what the motors ask for."""
        return self._bend.copy()

    @property
    def insertion_mm(self) -> float:
        """How far the shaft has truly gone in."""
        return self._insertion

    @property
    def loop_mm(self) -> float:
        """What of the shaft that was pushed lies in a loop, as it buckled."""
        return self._loop

    @property
    def pressed_mm(self) -> float:
        """How far the shaft is compressed, as it pushes against a wall (negative: as it is pulled)."""
        return self._pressed

    def pose(self) -> Array:
        """The true ``T_kidney_camera`` (4, 4) now."""
        with self._lock:
            self._follow(np.asarray(self._axes(), float))
            return self._T_kidney_tip if self._breathing is None else self._moved(self._breathing())

    def _moved(self, offset_mm: Array) -> Array:
        """The tip's pose, moved by (3,) mm or as far as walls allow: where it is tight, they carry it along."""
        T = self._T_kidney_tip.copy()
        places = T[:3, 3] + SHARES[:, None] * offset_mm
        room = self._clearance(places)
        free = room >= min(self.scope.keep_off_mm, float(room[0]))
        T[:3, 3] = places[-1 if free.all() else max(int(free.argmin()) - 1, 0)]
        return T

    def image(self) -> NDArray[np.uint8]:
        """The picture from where the camera is now, dimmed by the LED's level."""
        image, level = self._render(self.pose()), self._light()
        return image if level >= 1.0 else np.rint(image * level ** (1 / 2.2)).astype(np.uint8)

    def sensor(self) -> SensorReading:
        """The EM sensor's reading in the EM frame, with noise and distortion."""
        return self.em.read(self.pose())

    def _follow(self, axes: Array) -> None:
        """Let the scope follow its motors in steps that are small against the anatomy."""
        change = np.abs(axes - self._last_axes)
        bend_step = LARGEST_BEND_RAD * self._segment.cable_radius_mm
        steps = int(np.ceil(max(change[:2].max() / bend_step, change[2] / LARGEST_STEP_MM)))
        for n in range(steps):
            out = self._hysteresis(self._last_axes + (axes - self._last_axes) * ((n + 1) / steps))
            self._bend = self._segment.bend_from_pulls(out[:2])
            self._T_kidney_tip = self._swing()
            self._insert_to(float(out[2]))
        self._last_axes = axes

    def _swing(self) -> Array:
        """The tip's pose at the present bend: where the segment carries it, or as far that way as walls allow."""
        mark = self._trail[-1]
        T = (
            mark.T_kidney_tip
            @ inverse(self._segment.point_transform(mark.bend))
            @ self._segment.point_transform(self._bend)
        )
        start, way = mark.T_kidney_tip[:3, 3], T[:3, 3] - mark.T_kidney_tip[:3, 3]
        free = self._clearance(start + SHARES[:, None] * way) >= self.scope.keep_off_mm
        if not free.all():
            T[:3, 3] = start + SHARES[max(int(free.argmin()) - 1, 0)] * way
        return T

    def _insert_to(self, slider_mm: float) -> None:
        """Push or pull the shaft; a blocked one is compressed a little, then slips in the slider's grip."""
        missing = self._buckled(slider_mm - self._shift - self._insertion - self._loop)
        step = float(np.clip(missing, -LARGEST_STEP_MM, LARGEST_STEP_MM))
        moved = self._push(step) if step > 0 else self._pull(step)
        self._insertion += moved
        left = missing - moved
        self._pressed = float(np.clip(left, -self.scope.compression_mm, self.scope.compression_mm))
        self._shift += left - self._pressed

    def _buckled(self, missing: float) -> float:
        """What is left of a push once a bent shaft has buckled, and of a pull once its loop is straight again."""
        lost = max(missing, -self._loop)
        if missing > 0:
            share = 1 - np.exp(-self.scope.friction * float(np.hypot(*self._bend)))
            lost = min(float(share) * missing, self.scope.loop_mm - self._loop)
        self._loop += lost
        return missing - lost

    def _push(self, step: float) -> float:
        """Advance on the present curve, as the shaft follows where the tip leads; returns the way made."""
        length = self._segment.length_mm
        ahead = inverse(self._segment.point_transform(self._bend)) @ self._segment.point_transform(
            self._bend, length + step
        )
        T = self._slide(self._T_kidney_tip @ ahead, step)
        if float(self._clearance(T[None, :3, 3])[0]) < self.scope.keep_off_mm:
            return 0.0
        self._T_kidney_tip = T
        self._trail.append(Mark(self._insertion + step, T, self._bend.copy()))
        return step

    def _slide(self, T: Array, step: float) -> Array:
        """A tip that meets a wall at a slant is led along it: shifted aside by no more than it advances."""
        p = T[:3, 3]
        missing = self.scope.keep_off_mm - float(self._clearance(p[None])[0])
        if missing <= 0:
            return T
        offsets = 0.3 * np.concatenate([np.eye(3), -np.eye(3)])
        around = self._clearance(p + offsets)
        inwards = (around[:3] - around[3:]) / 0.6
        aside = inwards - (inwards @ T[:3, 2]) * T[:3, 2]
        lean = float(np.linalg.norm(aside))
        if lean > 0.3:  # else the wall is nearly head-on
            T = T.copy()
            T[:3, 3] += aside / lean * min((missing + 1e-3) / lean, step)
        return T

    def _pull(self, step: float) -> float:
        """Withdraw the way that the tip came; returns the way made, which is negative."""
        insertion = max(self._insertion + step, 0.0)
        while len(self._trail) > 1 and self._trail[-1].insertion_mm > insertion:
            self._trail.pop()
        self._T_kidney_tip = self._swing()
        return insertion - self._insertion
