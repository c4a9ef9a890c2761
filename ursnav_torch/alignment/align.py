"""Direct alignment: a drawing at a guessed pose, moved with its own depth until it lies on the picture.

Lucas and Kanade's method (Baker and Matthews, IJCV 56:221, 2004) on fields that brightness does not change, with the
mean of the drawing's and the picture's slopes (Benhimane and Malis, IROS 2004: second order without second
derivatives), Tukey's weights, and the light found along with the pose.
"""

from dataclasses import dataclass, field, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.alignment.fields import AlignGrid, Fields, Floats
from ursnav_torch.alignment.light import AT_CAMERA, MOST, SPREAD, STEP, gray_values, within_limits
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.rendering import RayScene

Array = NDArray[np.float64]

#: So many at a time: OpenCV filters no more than 128 planes at once, and a drawing under an unknown light has 18.
_AT_ONCE = 6
#: Fewer compared pixels than this say nothing.
LEAST_PIXELS = 150
_TUKEY = 5.0  # residuals beyond this many root mean squares do not count
_DAMPING = 1e-3
_LIGHT_PRIOR = 5e-4  # weight of the light's prior against one pixel
_LARGEST_TURN = np.radians(8.0)
_LEAST_GAIN = 0.2
_PROGRESS, _PATIENCE = 1e-3, 2  # an alignment ends after so many steps whose score is not better by this
_CONVERGED = np.array([0.02, 0.02, 0.02, 2e-3, 2e-3, 2e-3])  # mm and radians


@dataclass(frozen=True, slots=True)
class Aligned:
    """Where an alignment ended.

    Attributes:
        T_kidney_camera: (4, 4).
        light: (5,), see `align_light.AT_CAMERA`.
        score: mean correlation of the fields, 1 is perfect; -1 where the drawing shows too little.
        iterations: steps taken.
        drawing: what was moved there; None before any alignment.
    """

    T_kidney_camera: Array
    light: Array
    score: float
    iterations: int
    drawing: "Drawing | None" = None


@dataclass(frozen=True, slots=True)
class Drawing:
    """The kidney drawn from one pose, at the N pixels compared; or from B poses, with B before every shape.

    Attributes:
        T_kidney_camera, light: (4, 4) and (5,) it was drawn with.
        points: (3, N) wall points, camera frame.
        value: (3, N) fields.
        slope: (2, 3, N) their change per px.
        lit: (5, 3, N) their change with the light.
        motion: (6, 2, N) px by which a point's image moves with the point, see `AlignGrid.motion`.
        seen: (N,) 1.0 where there is a wall.
    """

    T_kidney_camera: Array
    light: Array
    points: Floats
    value: Floats
    slope: Floats
    lit: Floats
    motion: Floats
    seen: Floats

    def at(self, rows: list[int]) -> "Drawing":
        """Of B drawings in one those at some rows."""
        return Drawing(*(getattr(self, f.name)[rows] for f in fields(self)))

    def one(self, row: int) -> "Drawing":
        """Of B drawings in one that at a row."""
        return Drawing(*(getattr(self, f.name)[row] for f in fields(self)))

    def alone(self) -> "Drawing":
        """One drawing as B of them, B = 1."""
        return Drawing(*(getattr(self, f.name)[None] for f in fields(self)))


@dataclass(frozen=True, slots=True)
class _State:
    """From the drawing's camera to the picture's (4, 4), and the light's change (5,) since the drawing."""

    T_picture_drawing: Array
    light: Array

    def moved(self, step: Array) -> "_State":
        turn = transform_from(cv2.Rodrigues(step[3:6])[0], step[:3])
        return _State(turn @ self.T_picture_drawing, np.clip(self.light + step[6:], -MOST, MOST))


@dataclass(slots=True)
class _Way:
    """An alignment on its way: where it is, the best it has been at, and whether it has ended."""

    state: _State = field(default_factory=lambda: _State(np.eye(4), np.zeros(len(AT_CAMERA))))
    best: _State = field(default_factory=lambda: _State(np.eye(4), np.zeros(len(AT_CAMERA))))
    best_score: float = -1.0
    taken: int = 0
    stalled: int = 0
    ended: bool = False

    def go(self, score: float, step: Array | None, iterations: int) -> None:
        """Take in the score here, and go on by a step (6 + 5,), unless there is none or no use."""
        self.stalled = 0 if score > self.best_score + _PROGRESS else self.stalled + 1
        if score > self.best_score:
            self.best, self.best_score = self.state, score
        if step is None or self.taken == iterations or self.stalled == _PATIENCE or _is_small(step):
            self.ended = True
            return
        self.state, self.taken = self.state.moved(step), self.taken + 1


def _is_small(step: Array) -> bool:
    return bool(np.all(np.abs(step[:6]) < _CONVERGED))


class Aligner:
    """Aligns drawings of one kidney with pictures through one lens, several at a time.

    Numbers of many alignments lie in one array each, so that every step is one pass through all of them.

    Args:
        scene: the lumen, kidney frame, mm; grids of several sizes may share it.
        grid: the small picture.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """

    def __init__(self, scene: RayScene, grid: AlignGrid, unit_mm: float = 1.0) -> None:
        self.grid, self._scene = grid, scene
        self._longest_step = 1.5 * unit_mm
        rays, self._inside = grid.camera.pixel_rays()
        self._rays = rays[self._inside].astype(np.float32)

    def align(
        self,
        picture: Fields,
        T_kidney_camera: Array,
        light: Array = AT_CAMERA,
        iterations: int = 8,
        light_known: bool = False,
    ) -> list[Aligned]:
        """The poses near each of some (B, 4, 4) from which their drawings lie best on a picture.

        Args:
            picture: the fields.
            T_kidney_camera: (B, 4, 4) where the alignments start.
            light: (5,) or (B, 5) in which the kidney is drawn.
            iterations: steps at most.
            light_known: keep to that light.
        """
        count = len(T_kidney_camera)
        lights = np.array(np.broadcast_to(light, (count, len(AT_CAMERA))), float)
        if count > _AT_ONCE:
            parts = (slice(i, i + _AT_ONCE) for i in range(0, count, _AT_ONCE))
            return [
                end
                for part in parts
                for end in self.align(picture, T_kidney_camera[part], lights[part], iterations, light_known)
            ]
        if not count:
            return []
        drawings = self._drawn(np.asarray(T_kidney_camera, float), lights, light_known)
        ways = [_Way() for _ in range(count)]
        going, left = list(range(count)), drawings
        while going:
            scores, steps = self._step(picture, left, [ways[i].state for i in going])
            for i, score, step in zip(going, scores, steps, strict=True):
                ways[i].go(float(score), step, iterations)
            on = [row for row, i in enumerate(going) if not ways[i].ended]
            left = left if len(on) == len(going) else left.at(on)
            going = [going[row] for row in on]
        return [self._ended(drawings, i, way) for i, way in enumerate(ways)]

    @staticmethod
    def _ended(drawings: Drawing, i: int, way: "_Way") -> Aligned:
        """Where the i-th of some alignments ended."""
        own, best = drawings.one(i), way.best
        T = own.T_kidney_camera @ inverse(best.T_picture_drawing)
        return Aligned(T, within_limits(own.light + best.light), way.best_score, way.taken, own)

    def score(self, picture: Fields, drawing: Drawing, T_kidney_camera: Array, light: Array) -> float:
        """How well one drawing, moved to a pose nearby (4, 4) and a light (5,), lies on a picture."""
        moved = _State(inverse(T_kidney_camera) @ drawing.T_kidney_camera, light - drawing.light)
        return float(self._step(picture, drawing.alone(), [moved])[0][0])

    def draw(self, T_kidney_camera: Array, light: Array, light_known: bool = False) -> Drawing:
        """The kidney from a pose (4, 4) under a light (5,), and how it would change under another."""
        return self._drawn(T_kidney_camera[None], np.asarray(light, float)[None], light_known).one(0)

    def look(self, T_kidney_camera: Array, light: Array) -> tuple[Floats, Floats]:
        """The relief (H, W), at the grid's size, that a picture from a pose (4, 4) under a light (5,) would have, and
        the wall's distance (H, W) in mm, inf without a wall."""
        gray, distance = self._lit(T_kidney_camera[None], np.asarray(light, float)[None, None])
        return self.grid.relief(gray[:, :, 0])[..., 0], distance[0]

    def _drawn(self, T_kidney_camera: Array, light: Array, light_known: bool) -> Drawing:
        """The kidney from B poses (B, 4, 4), each under its light (B, 5): one `Drawing` with B before every shape."""
        grid, change = self.grid, np.zeros((1, len(AT_CAMERA)))
        if not light_known:
            change = np.concatenate([change, np.diag(STEP)])
        gray, distance = self._lit(T_kidney_camera, light[:, None] + change)
        value, slope = grid.of_drawings(gray)
        distance = distance[:, grid.compared]
        seen = np.isfinite(distance)
        distance[~seen] = 1.0
        motion = np.repeat(grid.motion[None], len(distance), 0)
        motion[:, :3] /= distance[:, None, None]
        lit = (value[:, 1:] - value[:, :1]) / STEP.astype(np.float32)[: value.shape[1] - 1, None, None]
        points = grid.rays * distance[:, None]
        return Drawing(T_kidney_camera, light, points, value[:, 0], slope, lit, motion, seen.astype(np.float32))

    def _lit(self, T_kidney_camera: Array, lights: Array) -> tuple[Floats, Floats]:
        """Gray values (H, W, B, M) from B poses under M lights each (B, M, 5), and the wall's distance (B, H, W), inf
        without a wall."""
        R = T_kidney_camera[:, :3, :3].astype(np.float32)
        count, rays = len(R), len(self._rays)
        toward = (self._rays @ R.transpose(0, 2, 1)).reshape(-1, 3)
        depths, normals = self._scene.cast(np.repeat(T_kidney_camera[:, :3, 3], rays, 0), toward)
        depth = depths.reshape(count, rays)
        distance = np.full((count, *self._inside.shape), np.inf, np.float32)
        distance[:, self._inside] = depth
        gray = np.zeros((*self._inside.shape, count, lights.shape[1]), np.float32)
        for b, facing in enumerate(normals.reshape(count, rays, 3)):
            hit = np.isfinite(depth[b])
            shaded = gray_values(self._rays[hit] * depth[b, hit, None], -facing[hit] @ R[b], lights[b])
            gray[np.isfinite(distance[b]), b] = shaded
        return gray, distance

    def _step(self, picture: Fields, drawing: Drawing, states: list["_State"]) -> tuple[Array, list[Array | None]]:
        """Scores (B,) of states, and the step (6 + 5,) from each to a better one; None where too little is seen."""
        T = np.stack([state.T_picture_drawing for state in states]).astype(np.float32)
        light = np.stack([state.light for state in states])
        points = T[:, :3, :3] @ drawing.points + T[:, :3, 3:]
        value, slope, weight = self.grid.sample(picture, self.grid.camera.pixels(points.transpose(1, 0, 2)))
        good = drawing.seen * weight
        count = np.maximum(good.sum(1), 1e-3)
        seen, seen_size = _standard(value, good, count)
        drawn = drawing.value
        if drawing.lit.shape[1]:
            drawn = drawn + np.einsum("bl,blcn->bcn", light.astype(np.float32), drawing.lit)
        drawn, drawn_size = _standard(drawn, good, count)
        correlation = ((seen * drawn) @ good[..., None])[..., 0] / count[:, None]
        gain = np.maximum(correlation, np.float32(_LEAST_GAIN))[..., None]
        residual: Floats = seen - gain * drawn
        gradient = 0.5 * (slope / seen_size[:, None] + drawing.slope * (gain / drawn_size)[:, None])
        lit = drawing.lit * (-gain / drawn_size)[:, None]
        robust = _tukey(residual, good, count)
        normal, slant = _normal_equations(drawing.motion, gradient, lit, robust, residual)
        enough = count >= LEAST_PIXELS
        steps = [
            self._solved(normal[b], slant[b], float(count[b]), drawing.light[b] + light[b]) if enough[b] else None
            for b in range(len(states))
        ]
        return np.where(enough, correlation.mean(1), -1.0), steps

    def _solved(self, normal: Array, slant: Array, count: float, light: Array) -> Array:
        """The step (6 + 5,) that normal equations (6 + L, 6 + L) and (6 + L,) ask for, L 5 or 0, from a light (5,)."""
        normal = normal + np.diag(_DAMPING * np.diag(normal) + 1e-9)
        step = np.zeros(6 + len(light))
        if len(slant) > 6:
            prior = _LIGHT_PRIOR * count / SPREAD**2
            normal[np.arange(6, 11), np.arange(6, 11)] += prior
            slant = slant + np.concatenate([np.zeros(6), prior * (light - AT_CAMERA)])
        step[: len(slant)] = -np.linalg.solve(normal, slant)
        return self._limited(step)

    def _limited(self, step: Array) -> Array:
        """A step shortened to what one linearization can be trusted with."""
        far, turned = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:6]))
        return step * min(1.0, self._longest_step / max(far, 1e-12), _LARGEST_TURN / max(turned, 1e-12))


def _normal_equations(
    motion: Floats, gradient: Floats, lit: Floats, weight: Floats, residual: Floats
) -> tuple[Array, Array]:
    """J W J^T (B, 6 + L, 6 + L) and J W r (B, 6 + L) for the rows ``gradient . motion`` and ``lit`` of J.

    A field's row is the field's gradient (2, 3, N) times the motion of its pixels (6, 2, N), which all fields share,
    so fields are summed before they are multiplied out.
    """
    x, y = motion[:, :, 0], motion[:, :, 1]
    weighted = gradient * weight[:, None]
    xx, yy = (weighted * gradient).sum(2).swapaxes(0, 1)
    xy = (weighted[:, 0] * gradient[:, 1]).sum(1)
    bx, by = (weighted * residual[:, None]).sum(2).swapaxes(0, 1)[..., None]
    across, down = x.swapaxes(1, 2), y.swapaxes(1, 2)
    normal = (x * xx[:, None] + y * xy[:, None]) @ across + (x * xy[:, None] + y * yy[:, None]) @ down
    slant = (x @ bx + y @ by)[..., 0]
    if lit.shape[1]:
        at_x, at_y = np.einsum("bacn,bkcn->abnk", weighted, lit)
        beside, flat = x @ at_x + y @ at_y, lit.reshape(*lit.shape[:2], -1)
        own = (lit * weight[:, None]).reshape(flat.shape)
        normal = np.block([[normal, beside], [beside.swapaxes(1, 2), own @ flat.swapaxes(1, 2)]])
        slant = np.concatenate([slant, (own @ residual.reshape(len(residual), -1, 1))[..., 0]], 1)
    return normal.astype(float), slant.astype(float)


def _standard(field: Floats, good: Floats, count: Floats) -> tuple[Floats, Floats]:
    """Fields (B, 3, N) with mean 0 and size 1 over the pixels that count (B, N), and their size (B, 3, 1) before."""
    each, counted = good[..., None], count[:, None, None]
    centered = field - (field @ each) / counted
    size = np.sqrt((np.square(centered) @ each) / counted) + np.float32(1e-6)
    return centered / size, size


def _tukey(residual: Floats, good: Floats, count: Floats) -> Floats:
    """Tukey's biweights (B, 3, N) of residuals (B, 3, N), zero where ``good`` (B, N) is."""
    square = np.square(residual)
    size = np.float32(_TUKEY**2) * (square @ good[..., None]) / count[:, None, None] + np.float32(1e-6)
    return np.square(1 - np.minimum(square / size, 1)) * good[:, None]
