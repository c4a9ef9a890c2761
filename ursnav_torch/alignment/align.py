"""Direct alignment: a drawing at a guessed pose, moved with its own depth until it lies on the picture.

Lucas and Kanade's method (Baker and Matthews, IJCV 56:221, 2004) on fields that brightness does not change, with the
mean of the drawing's and the picture's slopes (Benhimane and Malis, IROS 2004: second order without second
derivatives), Tukey's weights, and the light found along with the pose.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.alignment.fields import AlignGrid, Fields, Floats
from ursnav_torch.alignment.light import AT_CAMERA, MOST, SPREAD, STEP, gray_values, within_limits
from ursnav_torch.geometry import inverse, transform_from
from ursnav_torch.rendering import RayScene

Array = NDArray[np.float64]

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
    """The kidney drawn from one pose, at the N pixels compared.

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


@dataclass(frozen=True, slots=True)
class _State:
    """From the drawing's camera to the picture's (4, 4), and the light's change (5,) since the drawing."""

    T_picture_drawing: Array
    light: Array

    def moved(self, step: Array) -> "_State":
        turn = transform_from(cv2.Rodrigues(step[3:6])[0], step[:3])
        return _State(turn @ self.T_picture_drawing, np.clip(self.light + step[6:], -MOST, MOST))


class Aligner:
    """Aligns drawings of one kidney with pictures through one lens.

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
    ) -> Aligned:
        """The pose near ``T_kidney_camera`` (4, 4) from which the drawing lies best on a picture."""
        drawing = self.draw(T_kidney_camera, light, light_known)
        state = best = _State(np.eye(4), np.zeros(len(light)))
        best_score, taken, stalled = -1.0, 0, 0
        while True:
            score, step = self._step(picture, drawing, state)
            stalled = 0 if score > best_score + _PROGRESS else stalled + 1
            if score > best_score:
                best, best_score = state, score
            if step is None or taken == iterations or stalled == _PATIENCE or np.all(np.abs(step[:6]) < _CONVERGED):
                break
            state, taken = state.moved(step), taken + 1
        T = T_kidney_camera @ inverse(best.T_picture_drawing)
        return Aligned(T, within_limits(light + best.light), best_score, taken, drawing)

    def score(self, picture: Fields, drawing: Drawing, T_kidney_camera: Array, light: Array) -> float:
        """How well a drawing, moved to a pose nearby (4, 4) and a light (5,), lies on a picture."""
        moved = _State(inverse(T_kidney_camera) @ drawing.T_kidney_camera, light - drawing.light)
        return self._step(picture, drawing, moved)[0]

    def draw(self, T_kidney_camera: Array, light: Array, light_known: bool = False) -> Drawing:
        """The kidney from a pose (4, 4) under a light (5,), and how it would change under another."""
        grid = self.grid
        lights = light[None] if light_known else np.concatenate([light[None], light + np.diag(STEP)])
        gray, distance = self._lit(T_kidney_camera, lights)
        value, slope = grid.of_drawings(gray)
        distance = distance[grid.compared]
        seen = np.isfinite(distance)
        distance[~seen] = 1.0
        motion = grid.motion.copy()
        motion[:3] /= distance
        lit = (value[1:] - value[:1]) / STEP.astype(np.float32)[: len(value) - 1, None, None]
        return Drawing(
            T_kidney_camera, light, grid.rays * distance, value[0], slope, lit, motion, seen.astype(np.float32)
        )

    def look(self, T_kidney_camera: Array, light: Array) -> tuple[Floats, Floats]:
        """The relief (H, W), at the grid's size, that a picture from a pose (4, 4) under a light (5,) would have, and
        the wall's distance (H, W) in mm, inf without a wall."""
        gray, distance = self._lit(T_kidney_camera, light[None])
        return self.grid.relief(gray)[..., 0], distance

    def _lit(self, T_kidney_camera: Array, lights: Array) -> tuple[Floats, Floats]:
        """Gray values (H, W, M) under M lights (M, 5), and the wall's distance (H, W), inf without a wall."""
        R = T_kidney_camera[:3, :3].astype(np.float32)
        depth, normals = self._scene.cast(T_kidney_camera[:3, 3], self._rays @ R.T)
        hit = np.isfinite(depth)
        distance = np.full(self._inside.shape, np.inf, np.float32)
        distance[self._inside] = depth
        gray = np.zeros((*self._inside.shape, len(lights)), np.float32)
        gray[np.isfinite(distance)] = gray_values(self._rays[hit] * depth[hit, None], -normals[hit] @ R, lights)
        return gray, distance

    def _step(self, picture: Fields, drawing: Drawing, state: _State) -> tuple[float, Array | None]:
        """Score of a state, and the step (6 + 5,) to a better one; None where too little is seen."""
        T = state.T_picture_drawing
        R, t = T[:3, :3].astype(np.float32), T[:3, 3:].astype(np.float32)
        value, slope, weight = self.grid.sample(picture, self.grid.camera.pixels(R @ drawing.points + t))
        good = drawing.seen * weight
        count = float(good.sum())
        if count < LEAST_PIXELS:
            return -1.0, None
        seen, seen_size = _standard(value, good)
        drawn = drawing.value
        if len(drawing.lit):
            drawn = drawn + np.tensordot(state.light.astype(np.float32), drawing.lit, 1)
        drawn, drawn_size = _standard(drawn, good)
        correlation = (seen * drawn) @ good / count
        gain = np.maximum(correlation, _LEAST_GAIN)[:, None].astype(np.float32)
        residual: Floats = seen - gain * drawn
        robust = _tukey(residual, good, count)
        gradient = 0.5 * (slope / seen_size + drawing.slope * (gain / drawn_size))
        lit = drawing.lit * (-gain / drawn_size)
        normal, slant = _normal_equations(drawing.motion, gradient, lit, robust, residual)
        normal += np.diag(_DAMPING * np.diag(normal) + 1e-9)
        if len(drawing.lit):
            prior = _LIGHT_PRIOR * count / SPREAD**2
            normal[np.arange(6, 11), np.arange(6, 11)] += prior
            slant[6:] += prior * (drawing.light + state.light - AT_CAMERA)
        step = np.zeros(6 + len(state.light))
        step[: len(slant)] = -np.linalg.solve(normal, slant)
        return float(correlation.mean()), self._limited(step)

    def _limited(self, step: Array) -> Array:
        """A step shortened to what one linearization can be trusted with."""
        far, turned = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:6]))
        return step * min(1.0, self._longest_step / max(far, 1e-12), _LARGEST_TURN / max(turned, 1e-12))


def _normal_equations(
    motion: Floats, gradient: Floats, lit: Floats, weight: Floats, residual: Floats
) -> tuple[Array, Array]:
    """J W J^T (6 + L, 6 + L) and J W r (6 + L,) for the rows ``gradient . motion`` and ``lit`` of J.

    A field's row is the field's gradient (2, 3, N) times the motion of its pixels (6, 2, N), which all fields share,
    so fields are summed before they are multiplied out.
    """
    x, y = motion[:, 0], motion[:, 1]
    weighted = gradient * weight
    xx, yy = (weighted * gradient).sum(1)
    xy = (weighted[0] * gradient[1]).sum(0)
    bx, by = (weighted * residual).sum(1)
    normal = (x * xx + y * xy) @ x.T + (x * xy + y * yy) @ y.T
    slant = x @ bx + y @ by
    if len(lit):
        at_x, at_y = np.einsum("acn,kcn->akn", weighted, lit)
        beside, flat = x @ at_x.T + y @ at_y.T, lit.reshape(len(lit), -1)
        own = (lit * weight).reshape(flat.shape)
        normal = np.block([[normal, beside], [beside.T, own @ flat.T]])
        slant = np.concatenate([slant, own @ residual.reshape(-1)])
    return normal.astype(float), slant.astype(float)


def _standard(field: Floats, good: Floats) -> tuple[Floats, Floats]:
    """Fields (3, N) with mean 0 and size 1 over the pixels that count (N,), and their size (3, 1) before."""
    count = good.sum()
    centered = field - (field @ good / count)[:, None]
    size = np.sqrt(np.square(centered) @ good / count)[:, None] + np.float32(1e-6)
    return centered / size, size


def _tukey(residual: Floats, good: Floats, count: float) -> Floats:
    """Tukey's biweights (3, N) of residuals (3, N), zero where ``good`` (N,) is."""
    square = np.square(residual)
    size = _TUKEY**2 * (square @ good / np.float32(count))[:, None] + np.float32(1e-6)
    return np.square(1 - np.minimum(square / size, 1)) * good
