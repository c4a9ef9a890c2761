"""Steering: from a pose and a way to rates of bend and insertion. Image-based visual servoing on the localized pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.autonomy.free_space import FreeSpace
from ursnav_torch.autonomy.perception import Perception, Wish
from ursnav_torch.autonomy.settings import AutonomySettings
from ursnav_torch.exploration.route import along
from ursnav_torch.geometry import inverse
from ursnav_torch.kidney import Kidney
from ursnav_torch.kinematics import Segment, turn_towards

Array = NDArray[np.float64]

#: Cosine of the angle to the way from which on the scope does not advance but only turn: 41 degrees.
_ASKEW = 0.75
#: In a neck narrower than the clearance asked for, this part of its radius is kept.
_NECK_SHARE = 0.6
#: Where less is kept, as in a neck, it goes on until this many times of it: 0.9 of the neck's radius.
_NECK_TOUCH = 1.5
#: A wall whose normal is within 45 degrees of the axis faces the scope; along another it goes on at this part of speed.
_FACING, _CREEP = 0.7, 0.25
#: An axis within this angle of where it shall look is left, as a tip trembles that follows places that are not sharp.
#: Set, not varied, as what follows.
_LEEWAY_RAD = 0.08
#: Where the lumen is narrower than this many times the clearance asked for, a straight line to the goal must be free.
_NARROW = 2.0
#: Parts of the look-ahead that are tried, farthest first, for a straight line that no wall is in the way of.
_AHEADS = (1.0, 0.75, 0.5, 0.3)
#: Steps of a bend to a goal, none larger than this.
_TURNS, _LARGEST_TURN_RAD = 8, 0.5
#: Where a straight line is asked for walls.
_SHARES = np.linspace(0.0, 1.0, 13)
#: A tip bent otherwise by more than this than it was on the way in is not drawn back but bent; set, not varied.
_BENT_RAD = 0.2
#: A tip bent otherwise than on the way in is bent so while it is drawn back; by this or more, at this part of speed.
#: Set, not varied.
_ASIDE_RAD, _PULLED = 1.0, 0.2
#: How far the tip bends as it looks about: 25 degrees.
_SWEEP_RAD = 0.44
#: How far along the optical axis clearance is looked up, mm at scale 1.
_LOOK_MM = 1.0


class Way:
    """The way in along the centerline, from its root to a calyx's tip.

    Attributes:
        calyx: index of the calyx.
        points_mm, radius_mm: (K, 3) and (K,), of the centerline.
        along_mm: (K,) length of the way up to each.
    """

    def __init__(self, kidney: Kidney, calyx: int) -> None:
        path = kidney.centerline.path_to(calyx)
        self.calyx, self._path = calyx, path
        self.points_mm, self.radius_mm = kidney.centerline.points_mm[path], kidney.centerline.radius_mm[path]
        self.along_mm = along(self.points_mm)

    @property
    def length_mm(self) -> float:
        """From root to tip."""
        return float(self.along_mm[-1])

    def shared_mm(self, other: "Way") -> float:
        """How far two ways are one."""
        count = min(len(self._path), len(other._path))
        apart = np.flatnonzero(self._path[:count] != other._path[:count])
        return float(self.along_mm[(int(apart[0]) if len(apart) else count) - 1])

    def place_mm(self, position_mm: Array) -> float:
        """How far along the way a place (3,) is."""
        return self._nearest(position_mm)[0]

    def away_mm(self, position_mm: Array) -> float:
        """How far beside the way a place (3,) is."""
        return self._nearest(position_mm)[1]

    def _nearest(self, position_mm: Array) -> tuple[float, float]:
        """Of the way's point nearest to a place (3,): how far along it is, and how far off."""
        steps = np.diff(self.points_mm, axis=0)
        length = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
        share = np.clip(np.einsum("ij,ij->i", position_mm - self.points_mm[:-1], steps) / length**2, 0, 1)
        away = np.linalg.norm(self.points_mm[:-1] + share[:, None] * steps - position_mm, axis=1)
        nearest = int(away.argmin())
        return float(self.along_mm[nearest] + share[nearest] * length[nearest]), float(away[nearest])

    def point_at(self, mm: float) -> Array:
        """(3,) the point so far along the way, its end beyond it."""
        return np.array([np.interp(mm, self.along_mm, self.points_mm[:, i]) for i in range(3)])

    def radius_at(self, mm: float) -> float:
        """The lumen's radius there, mm."""
        return float(np.interp(mm, self.along_mm, self.radius_mm))


@dataclass(frozen=True, slots=True)
class Steering:
    """Steers a scope in one kidney; all lengths in mm of this kidney.

    Attributes:
        space: what is free of walls and stones.
        segment: the scope's bending tip.
        settings: how carefully.
    """

    space: FreeSpace
    segment: Segment
    settings: AutonomySettings

    def advance(self, seen: Perception, T: Array, way: Way) -> Wish:
        """From a pose (4, 4) turn towards the way ahead, and go on while it lies ahead and the wall is not near."""
        at = way.place_mm(T[:3, 3])
        goal = self.goal(T, way)
        cosine = self._cosine(T, goal)
        speed = self.settings.advance_mm_s * max(0.0, (cosine - _ASKEW) / (1 - _ASKEW))
        kept = self._kept_mm(way, at + _LOOK_MM * self.space.scale)
        return Wish(self.turn(seen, T, goal), speed * self.sureness(seen) * self.freedom(T, kept))

    def retreat(self, seen: Perception, T: Array, way: Way, to: Array | None = None) -> Wish:
        """From a pose (4, 4) pull back along a way, bent as the scope was on the way in, at some joints (3,).

        Without them keep looking where the way leads. To bend otherwise than on the way in is a way of the tip, too.
        """
        if to is not None:
            bend = to[:2] - np.asarray(seen.bend_rad)
            ready = max(_PULLED, 1 - float(np.hypot(*bend)) / _ASIDE_RAD)
            return Wish(self.settings.turn_per_s * bend, -self.settings.retreat_mm_s * self.sureness(seen) * ready)
        goal = way.point_at(min(way.place_mm(T[:3, 3]) + self.settings.ahead_mm, way.length_mm))
        return Wish(self.turn(seen, T, goal), -self.settings.retreat_mm_s * self.sureness(seen))

    def withdraw(self, seen: Perception, to: Array) -> Wish:
        """Without a place back to some joints (3,): bend as it was there, and only then pull the shaft."""
        bend = to[:2] - np.asarray(seen.bend_rad)
        ready = max(0.0, 1 - float(np.hypot(*bend)) / _BENT_RAD)
        pull = self.settings.withdraw_mm_s * ready if seen.insertion_mm > to[2] else 0.0
        return Wish(self.settings.turn_per_s * bend, -pull)

    def sweep(self, seen: Perception, phase_rad: float) -> Wish:
        """Look about without a place: bend round a circle, and leave the shaft where it is."""
        goal = _SWEEP_RAD * np.array([np.cos(phase_rad), np.sin(phase_rad)])
        return Wish(np.clip(goal - np.asarray(seen.bend_rad), -_SWEEP_RAD, _SWEEP_RAD))

    def goal(self, T: Array, way: Way) -> Array:
        """(3,) the point of a way to steer for from a pose (4, 4); in a neck, nearer until a straight line is free."""
        place, at, ahead = T[:3, 3], way.place_mm(T[:3, 3]), self.settings.ahead_mm
        if way.radius_at(at) > _NARROW * self.settings.clearance_mm:
            return way.point_at(at + ahead)
        goals = np.stack([way.point_at(at + ahead * part) for part in _AHEADS])
        room = self._room_mm(place + _SHARES[:, None, None] * (goals - place)).min(axis=0)
        needed = np.array([self._kept_mm(way, at + ahead * part) for part in _AHEADS])
        free = room >= np.minimum(needed, float(self.space.clearance_mm(place[None])[0]))
        return np.asarray(goals[int(free.argmax()) if free.any() else -1])

    def can_turn_into(self, seen: Perception, T: Array, way: Way) -> bool:
        """Whether from a pose (4, 4) the tip can bend towards a way, and then nothing stands before it."""
        goal = self.goal(T, way)
        bend = np.asarray(seen.bend_rad, float)
        base, turned = T @ inverse(self.segment.point_transform(bend)), T
        for _ in range(_TURNS):
            turn = turn_towards((goal - turned[:3, 3]) @ turned[:3, :3])
            change = self.segment.bend_for_turn(bend, turn)
            bend = bend + change * min(1.0, _LARGEST_TURN_RAD / max(float(np.hypot(*change)), 1e-9))
            turned = base @ self.segment.point_transform(bend)
        place, there = T[:3, 3], turned[:3, 3]
        passed = (goal - place) @ (goal - there) < 0
        if passed or np.hypot(*bend) > self.segment.max_bend_rad or self._cosine(turned, goal) < _ASKEW:
            return False
        lines = np.concatenate([place + _SHARES[:, None] * (there - place), there + _SHARES[:, None] * (goal - there)])
        return bool(self._room_mm(lines).min() >= self._kept_mm(way, way.place_mm(goal)))

    def _kept_mm(self, way: Way, at_mm: float) -> float:
        """How far the wall is kept off at a place of a way."""
        return min(self.settings.clearance_mm, _NECK_SHARE * way.radius_at(at_mm))

    def _room_mm(self, points_mm: Array) -> Array:
        """Distances (...) to the nearest wall or stone of points (..., 3)."""
        return self.space.clearance_mm(points_mm.reshape(-1, 3)).reshape(points_mm.shape[:-1])

    def turn(self, seen: Perception, T: Array, goal_mm: Array) -> Array:
        """Bend rates (2,) that bring the optical axis of a pose (4, 4) towards a point (3,)."""
        turn = turn_towards((goal_mm - T[:3, 3]) @ T[:3, :3])
        turn = turn * max(0.0, 1 - _LEEWAY_RAD / max(float(np.hypot(*turn)), 1e-9))
        return self.settings.turn_per_s * self.segment.bend_for_turn(seen.bend_rad, turn)

    def sureness(self, seen: Perception) -> float:
        """Speed by certainty: 1 where the place is sure, 0.15 where it is in doubt."""
        s = self.settings
        if seen.position_sd_mm is None:
            return 1.0
        doubt = (seen.position_sd_mm - s.sure_sd_mm) / (s.doubtful_sd_mm - s.sure_sd_mm)
        return float(np.clip(1.0 - doubt, 0.15, 1.0))

    def freedom(self, T: Array, kept_mm: float) -> float:
        """Speed by clearance at a pose (4, 4): 1 where the wall ahead is twice as far off as it is kept, else less.

        Nothing of it is left where that wall is near and faces the scope; along a wall at a slant it creeps on.
        """
        step = _LOOK_MM * self.space.scale
        ahead = T[:3, 3] + T[:3, 2] * step
        here, there = self.space.clearance_mm(np.stack([T[:3, 3], ahead]))
        if there >= here:  # whoever gets away from the wall may
            return 1.0
        facing = (here - there) / step  # the cosine of the angle between the axis and the wall's normal
        if there <= min(self.settings.touch_mm, _NECK_TOUCH * kept_mm):
            return 0.0
        least = _CREEP if facing < _FACING else 0.0
        return float(np.clip((there - kept_mm) / max(kept_mm, 1e-9), least, 1.0))

    @staticmethod
    def _cosine(T: Array, goal_mm: Array) -> float:
        way = goal_mm - T[:3, 3]
        return float(way @ T[:3, 2] / max(float(np.linalg.norm(way)), 1e-9))
