"""The map of stones: sightings of a track's pictures associated over time, merged when met again, and judged.

Data association by the assignment of least cost within a gate (Blackman, Multiple-Target Tracking, 1986); each
candidate is confirmed, and called gone, by a sequential probability ratio with bounds (Wald 1945; Sittler's track
score): a picture that shows it where it is expected speaks for it, one that does not speaks against it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import Array, angle_between, apply, inverse
from ursnav_torch.kidney import Kidney, LumenDistance, branch_calyx
from ursnav_torch.scaling import scaled
from ursnav_torch.stones.ball import contact_depth_mm
from ursnav_torch.stones.candidate import StoneCandidate
from ursnav_torch.stones.settings import StoneMapSettings
from ursnav_torch.stones.sighting import ConeOfSight, StoneSighting

#: States of a stone that is told.
THERE, GONE = "there", "gone"
#: A stone within this distance of a calyx's tip along the lumen, on its branch, lies in that calyx, mm at scale 1.
IN_CALYX_MM = 14.0
#: Pictures that show two candidates beside each other keep them two.
_APART = 2
#: Either the apparent radius of a sighting or its depth by contact must be as expected, within this factor.
_FACTOR = 1.7
#: A wall nearer to a line of sight than this may hide what lies behind it, or not, mm at scale 1.
_GRAZES_MM = 0.3
_SAMPLES = 24


@dataclass(frozen=True, slots=True, eq=False)
class FoundStone:
    """A stone that pictures told of.

    Attributes:
        number: from 1, in the order in which they were told.
        calyx: index of the calyx in which it lies, -1 for none.
        center_mm: (3,) kidney frame.
        covariance_mm2: (3, 3) of that.
        size_mm, size_sd_mm: longest diameter and its standard deviation.
        pictures: in which it was seen.
        confidence: probability that there is such a stone.
        state: ``there`` or ``gone``: seen before, and no more where it should be.
        frame: number of the picture that shows it best.
        is_fragment: whether it is too small for a stone.
    """

    number: int
    calyx: int
    center_mm: Array
    covariance_mm2: Array
    size_mm: float
    size_sd_mm: float
    pictures: int
    confidence: float
    state: str
    frame: int
    is_fragment: bool = False

    @property
    def position_sd_mm(self) -> float:
        """Standard deviation of the place along the worst axis, mm."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance_mm2)[-1]))


class StoneMap:
    """Stones of one kidney, as pictures with poses come in.

    Args:
        kidney, lumen: where.
        working_camera: the lens at the size of the bodies' masks.
        settings: see there.
    """

    def __init__(
        self, kidney: Kidney, lumen: LumenDistance, working_camera: Camera, settings: StoneMapSettings | None = None
    ) -> None:
        self.kidney, self.lumen = kidney, lumen
        self.settings = scaled(settings or StoneMapSettings(), kidney.scale)
        self._cone = ConeOfSight(working_camera)
        self._candidates: list[StoneCandidate] = []
        self._keys, self._told, self._last_s = 0, 0, -np.inf

    def add(
        self,
        T_kidney_camera: Array,
        bodies: Iterable[ForegroundBody],
        t_s: float,
        frame: int = 0,
        sd: tuple[float, float] = (0.2, 0.02),
    ) -> None:
        """Take in a picture.

        Args:
            T_kidney_camera: (4, 4) where it was taken.
            bodies: what lies before the wall in it.
            t_s: when it was taken.
            frame: its number.
            sd: standard deviations of the pose: position in mm, direction in radians.
        """
        weight = float(np.clip((t_s - self._last_s) / self.settings.independent_s, 0.0, 1.0))
        self._last_s = t_s
        T, seen = np.asarray(T_kidney_camera, float), self._cone.sightings(bodies)
        cost = self._costs(T, seen, sd)
        rows, columns = linear_sum_assignment(np.minimum(cost, 1e3))
        pairs = [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if cost[r, c] < 1]
        met, taken = [], set[int]()
        for row, column in pairs:
            self._candidates[column].see(T, seen[row], sd, frame, weight)
            met.append(self._candidates[column])
            taken.add(row)
        for index, candidate in enumerate(self._candidates):
            if candidate not in met and not (cost[:, index] < 1).any() and self._is_expected(candidate, T):
                candidate.weigh(-self.settings.miss * weight)
        met += [self._begin(T, seen[row], sd, frame) for row in range(len(seen)) if row not in taken]
        for candidate in met:
            candidate.settle(self.lumen.clearance_mm)
        for a, b in combinations(met, 2):
            a.apart[b.key], b.apart[a.key] = a.apart.get(b.key, 0) + 1, b.apart.get(a.key, 0) + 1
        self._merge(met)
        self._judge()

    def stones(self) -> tuple[FoundStone, ...]:
        """The stones that are told, in the order in which they were; fragments are none."""
        return tuple(stone for stone in self.told() if not stone.is_fragment)

    def told(self) -> tuple[FoundStone, ...]:
        """Stones and fragments that are told, in the order in which they were."""
        s, found = self.settings, []
        for c in sorted((c for c in self._candidates if c.number), key=lambda c: c.number):
            c.settle(self.lumen.clearance_mm, at_once=True)
            size, size_sd = c.size_mm()
            if size < s.speck_mm or not c.is_told:
                continue
            state = GONE if c.log_odds <= s.gone else THERE
            confidence = float(1 / (1 + np.exp(-c.best_odds)))
            found.append(
                FoundStone(c.number, self.calyx_of(c.ball.center_mm), c.ball.center_mm, c.ball.covariance[:3, :3],
                           size, size_sd, c.pictures, confidence, state, c.best_frame, not c.is_stone(size, size_sd))
            )  # fmt: skip
        return tuple(found)

    def balls_mm(self) -> Array:
        """(S, 4) x, y, z and radius of the stones that are told and there, as they were last computed."""
        there = [c for c in self._candidates if c.is_told and c.log_odds > self.settings.gone]
        return np.array([[*c.ball.center_mm, c.ball.radius_mm] for c in there]).reshape(-1, 4)

    def best_frames(self) -> set[int]:
        """Numbers of the pictures that show the candidates best."""
        return {c.best_frame for c in self._candidates}

    def calyx_of(self, center_mm: Array) -> int:
        """Index of the calyx in which a place (3,) lies, -1 for none."""
        return int(branch_calyx(center_mm[None], self.kidney, self.lumen, IN_CALYX_MM * self.kidney.scale)[0])

    def _costs(self, T: Array, seen: Sequence[StoneSighting], sd: tuple[float, float]) -> Array:
        """(N, K) of each sighting and candidate; 1 and more: not the same."""
        cost = np.full((len(seen), len(self._candidates)), np.inf)
        for k, candidate in enumerate(self._candidates):
            way = candidate.ball.center_mm - T[:3, 3]
            distance = float(np.linalg.norm(way))
            if (
                distance > 1.3 * self.settings.farthest_mm
                or not len(seen)
                or not self._in_sight(candidate, T, -_GRAZES_MM)
            ):
                continue
            half = float(np.arcsin(np.clip(candidate.ball.radius_mm / distance, 0, 1)))
            doubt = np.hypot(sd[1], min(np.hypot(sd[0], candidate.ball.position_sd_mm), 2.0) / distance)
            for n, s in enumerate(seen):
                ray = T[:3, :3] @ s.ray
                gate = self.settings.gate * max(half, s.half_angle) + 2 * doubt
                cost[n, k] = float(angle_between(ray, way)) / gate
                if s.is_whole and cost[n, k] < 1 and abs(np.log(max(half, 1e-3) / s.half_angle)) > np.log(_FACTOR):
                    if abs(np.log(self._contact(T, s) / distance)) > np.log(_FACTOR):
                        cost[n, k] = np.inf
        return cost

    def _contact(self, T: Array, seen: StoneSighting) -> float:
        return contact_depth_mm(
            T[:3, 3], T[:3, :3] @ seen.ray, seen.half_angle, self.lumen.clearance_mm, self.settings.farthest_mm
        )

    def _begin(self, T: Array, seen: StoneSighting, sd: tuple[float, float], frame: int) -> StoneCandidate:
        self._keys += 1
        candidate = StoneCandidate(self._keys, self.settings)
        candidate.see(T, seen, sd, frame, 1.0)
        self._candidates.append(candidate)
        return candidate

    def _in_sight(self, candidate: StoneCandidate, T: Array, room_mm: float) -> bool:
        """Whether the way from the lens to the candidate's near side is farther than ``room_mm`` from any wall."""
        way = candidate.ball.center_mm - T[:3, 3]
        near = max(1 - candidate.ball.radius_mm / max(float(np.linalg.norm(way)), 1e-3), 0.1)
        points = T[:3, 3] + np.linspace(0, near, _SAMPLES)[:, None] * way
        return bool((self.lumen.clearance_mm(points)[1:] > room_mm * self.kidney.scale).all())

    def _is_expected(self, candidate: StoneCandidate, T: Array) -> bool:
        """Whether a picture from ``T`` should show a candidate: all of it in the picture, large, nothing before it."""
        at = apply(inverse(T), candidate.ball.center_mm)
        distance = float(np.linalg.norm(at))
        if distance <= candidate.ball.radius_mm or distance > self.settings.farthest_mm:
            return False
        half = float(np.arcsin(candidate.ball.radius_mm / distance))
        if half < np.sqrt(self.settings.expected_share * self._cone.solid_angle / np.pi):
            return False
        side = np.cross(at, [0.0, 1.0, 0.0] if abs(at[1]) < 0.9 * distance else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        up = np.cross(at / distance, side)
        rim = at + candidate.ball.radius_mm * np.array([side, -side, up, -up])
        return bool(self._cone.camera.project(rim)[1].all()) and self._in_sight(candidate, T, _GRAZES_MM)

    def _merge(self, met: Sequence[StoneCandidate]) -> None:
        """Join candidates that turned out to be at one place."""
        for a in met:
            for b in [c for c in self._candidates if c is not a]:
                if a not in self._candidates or b not in self._candidates:
                    continue
                gap = float(np.linalg.norm(a.ball.center_mm - b.ball.center_mm))
                reach = a.ball.radius_mm + b.ball.radius_mm
                beside = a.apart.get(b.key, 0) >= _APART
                if gap < (0.5 if beside else 0.8) * reach:
                    first, second = (a, b) if a.pictures >= b.pictures else (b, a)
                    first.take_over(second)
                    first.settle(self.lumen.clearance_mm, at_once=True)
                    self._candidates.remove(second)

    def _judge(self) -> None:
        """Tell those that are sure enough, forget those that are sure to be none."""
        s = self.settings
        for c in self._candidates:
            if not c.number and c.log_odds >= s.least:
                self._told += 1
                c.number = self._told
        self._candidates = [c for c in self._candidates if c.number or c.log_odds > s.gone]
