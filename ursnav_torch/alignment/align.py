"""Direct alignment: a drawing at a guessed pose, moved with its own depth until it lies on the picture.

Lucas and Kanade's method (Baker and Matthews, IJCV 56:221, 2004) on fields that brightness does not change, with the
mean of the drawing's and the picture's slopes (Benhimane and Malis, IROS 2004: second order without second
derivatives), Tukey's weights, and the light and the water's glow found along with the pose.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.alignment.fields import AlignGrid, Fields, Floats
from ursnav_torch.alignment.gauss_newton import FIELDS, correlated, normal_equations, tukey
from ursnav_torch.alignment.light import AT_CAMERA, MOST, SPREAD, STEP, gray_values, within_limits
from ursnav_torch.geometry import inverse, transform_from, turned_by
from ursnav_torch.rendering import RayScene
from ursnav_torch.threads import meanwhile

Array = NDArray[np.float64]

#: So many at a time, whose planes stay in the second-level cache.
_AT_ONCE = 6
#: Fewer compared pixels than this say nothing.
LEAST_PIXELS = 150
_DAMPING = 1e-3
_CLEAR = 1e-4  # least spread of the water's glow
_LIGHT_PRIOR = 5e-4  # weight of the light's prior against one pixel
_LARGEST_TURN = np.radians(8.0)
_PROGRESS = 1e-3  # an alignment ends after some steps whose score is not better by this:
_LAST_PATIENCE, _PATIENCE = 2, 1  # so many, in the last and in one that another follows
_CONVERGED = np.array([0.02, 0.02, 0.02, 2e-3, 2e-3, 2e-3])  # mm and radians


@dataclass(frozen=True, slots=True)
class Water:
    """What the water before the wall is like.

    Attributes:
        spread: of its glow, picture value (standard deviation); 0 is clear water.
        mm: within so many two thirds of its glow come about.
    """

    spread: float
    mm: float


@dataclass(frozen=True, slots=True)
class Aligned:
    """Where an alignment ended.

    Attributes:
        T_kidney_camera: (4, 4).
        light: (6,), see `light.AT_CAMERA`.
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
        T_kidney_camera, light: (4, 4) and (6,) it was drawn with.
        points: (3, N) wall points, camera frame.
        value: (3, N) fields.
        slope: (2, 3, N) their change per px.
        lit: (L, 3, N) their change with the last L numbers of the light: 6, or 1 where the lamp is known.
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

    def at(self, rows: NDArray[np.bool_]) -> "Drawing":
        """Of B drawings in one some (B,)."""
        return Drawing(*(getattr(self, f.name)[rows] for f in fields(self)))

    def one(self, row: int) -> "Drawing":
        """Of B drawings in one that at a row."""
        return Drawing(*(getattr(self, f.name)[row] for f in fields(self)))

    def alone(self) -> "Drawing":
        """One drawing as B of them, B = 1."""
        return Drawing(*(getattr(self, f.name)[None] for f in fields(self)))


class _Ways:
    """B alignments on their way: where each is, the best it has been at, and how long it has not got better.

    Attributes:
        T: (B, 4, 4) from the drawing's camera to the picture's.
        light: (B, 6) the light's change since the drawing.
        best_T, best_light, best_score: where the score was highest, and that.
        taken: (B,) steps taken.
    """

    def __init__(self, count: int) -> None:
        self.T, self.light = np.repeat(np.eye(4)[None], count, 0), np.zeros((count, len(AT_CAMERA)))
        self.best_T, self.best_light, self.best_score = self.T.copy(), self.light.copy(), np.full(count, -1.0)
        self.taken, self._stalled = np.zeros(count, int), np.zeros(count, int)

    def go(self, going: NDArray[np.int64], found: "_Step", iterations: int, patience: int) -> NDArray[np.bool_]:
        """Take in what was found where some of them (G,) are, and go on by a step, unless there is none or no use.

        Returns:
            (G,) which of them go on.
        """
        gained = found.score > self.best_score[going] + _PROGRESS
        self._stalled[going] = np.where(gained, 0, self._stalled[going] + 1)
        better = found.score > self.best_score[going]
        at = going[better]
        self.best_T[at], self.best_light[at], self.best_score[at] = self.T[at], self.light[at], found.score[better]
        small = (np.abs(found.step[:, :6]) < _CONVERGED).all(1)
        on: NDArray[np.bool_] = (
            found.possible & ~small & (self.taken[going] < iterations) & (self._stalled[going] < patience)
        )
        at, step = going[on], found.step[on]
        turn = transform_from(turned_by(step[:, 3:6]), step[:, :3])
        self.T[at], self.light[at] = turn @ self.T[at], np.clip(self.light[at] + step[:, 6:], -MOST, MOST)
        self.taken[at] += 1
        return on


@dataclass(frozen=True, slots=True)
class _Step:
    """What B alignments find where they are.

    Attributes:
        score: (B,) of each, -1 where too little is seen.
        step: (B, 6 + 6) from there to a better place.
        possible: (B,) whether enough is seen for one.
    """

    score: Array
    step: Array
    possible: NDArray[np.bool_]


class Aligner:
    """Aligns drawings of one kidney with pictures through one lens, several at a time.

    Numbers of many alignments lie in one array each, so that every step is one pass through all of them.

    Args:
        scene: the lumen, kidney frame, mm; grids of several sizes may share it.
        grid: the small picture.
        water: before the wall.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """

    def __init__(self, scene: RayScene, grid: AlignGrid, water: Water, unit_mm: float = 1.0) -> None:
        self.grid, self._scene, self._water_mm = grid, scene, water.mm
        self._spread = np.append(SPREAD, max(water.spread, _CLEAR))
        self._longest_step = 1.5 * unit_mm
        rays, self._inside = grid.camera.pixel_rays()
        self._rays = np.ascontiguousarray(rays[self._inside].T, np.float32)  # (3, R)
        self._walls: dict[bytes, tuple[Floats, Floats]] = {}

    def align(
        self,
        picture: Fields,
        T_kidney_camera: Array,
        light: Array = AT_CAMERA,
        iterations: int = 8,
        light_known: bool = False,
        last: bool = True,
    ) -> list[Aligned]:
        """The poses near each of some (B, 4, 4) from which their drawings lie best on a picture.

        Args:
            picture: the fields.
            T_kidney_camera: (B, 4, 4) where the alignments start.
            light: (6,) or (B, 6) in which the kidney is drawn.
            iterations: steps at most.
            light_known: keep to that lamp; the water's glow is found all the same.
            last: no other follows, which would make good for what a step too few has left.
        """
        count = len(T_kidney_camera)
        lights = np.array(np.broadcast_to(light, (count, len(AT_CAMERA))), float)
        if count > _AT_ONCE:
            parts = (slice(i, i + _AT_ONCE) for i in range(0, count, _AT_ONCE))
            return [
                end
                for part in parts
                for end in self.align(picture, T_kidney_camera[part], lights[part], iterations, light_known, last)
            ]
        if not count:
            return []
        drawings = self._drawn(np.asarray(T_kidney_camera, float), lights, light_known)
        ways, going, left = _Ways(count), np.arange(count), drawings
        while len(going):
            found = self._step(picture, left, ways.T[going], ways.light[going])
            on = ways.go(going, found, iterations, _LAST_PATIENCE if last else _PATIENCE)
            left = left if on.all() else left.at(on)
            going = going[on]
        T = drawings.T_kidney_camera @ inverse(ways.best_T)
        light = within_limits(drawings.light + ways.best_light)
        return [
            Aligned(T[i], light[i], float(ways.best_score[i]), int(ways.taken[i]), drawings.one(i))
            for i in range(count)
        ]

    def score(self, picture: Fields, drawing: Drawing, T_kidney_camera: Array, light: Array) -> float:
        """How well one drawing, moved to a pose nearby (4, 4) and a light (6,), lies on a picture."""
        moved = inverse(T_kidney_camera) @ drawing.T_kidney_camera
        return float(self._step(picture, drawing.alone(), moved[None], (light - drawing.light)[None]).score[0])

    def draw(self, T_kidney_camera: Array, light: Array, light_known: bool = False) -> Drawing:
        """The kidney from a pose (4, 4) under a light (6,), and how it would change under another."""
        return self._drawn(T_kidney_camera[None], np.asarray(light, float)[None], light_known).one(0)

    def look(self, T_kidney_camera: Array, light: Array) -> tuple[Floats, Floats]:
        """The relief (H, W), at the grid's size, that a picture from a pose (4, 4) under a light (6,) would have, and
        the wall's distance (H, W) in mm, inf without a wall."""
        reliefs, distances = self.looks(T_kidney_camera[None], np.asarray(light, float)[None])
        return reliefs[0], distances[0]

    def looks(self, T_kidney_camera: Array, lights: Array) -> tuple[Floats, Floats]:
        """`look` from K poses (K, 4, 4), each under its light (K, 6): reliefs and distances (K, H, W)."""
        gray, distance = self._lit(T_kidney_camera, lights[:, None])
        return self.grid.relief(gray[:, 0]), distance

    def _drawn(self, T_kidney_camera: Array, light: Array, light_known: bool) -> Drawing:
        """The kidney from B poses (B, 4, 4), each under its light (B, 6): one `Drawing` with B before every shape."""
        grid, changed = self.grid, np.diag(STEP)[-1 if light_known else 0 :]
        change = np.concatenate([np.zeros((1, len(AT_CAMERA))), changed])
        gray, distance = self._lit(T_kidney_camera, light[:, None] + change)
        value, slope = grid.of_drawings(gray)
        distance = distance.reshape(len(distance), -1).take(grid.places, 1)
        seen = np.isfinite(distance)
        distance[~seen] = 1.0
        motion = np.repeat(grid.motion[None], len(distance), 0)
        motion[:, :3] /= distance[:, None, None]
        lit = (value[:, 1:] - value[:, :1]) / STEP.astype(np.float32)[-len(changed) :, None, None]
        points = grid.rays * distance[:, None]
        return Drawing(T_kidney_camera, light, points, value[:, 0], slope, lit, motion, seen.astype(np.float32))

    def _lit(self, T_kidney_camera: Array, lights: Array) -> tuple[Floats, Floats]:
        """Gray values (B, M, H, W) from B poses under M lights each (B, M, 6), and the wall's distance (B, H, W), inf
        without a wall."""
        depth, normals = self._wall(T_kidney_camera)
        count, rays = depth.shape
        points, hit = self._rays * depth[:, None], np.isfinite(depth)
        if hit.all():
            shaded = gray_values(points, normals, lights, self._water_mm)
        else:
            shaded = np.zeros((count, lights.shape[1], rays), np.float32)
            for b, wall in enumerate(hit):
                shaded[b][:, wall] = gray_values(points[b][:, wall], normals[b][:, wall], lights[b], self._water_mm)
        distance = np.full((count, *self._inside.shape), np.inf, np.float32)
        distance[:, self._inside] = depth
        gray = np.zeros((count, lights.shape[1], *self._inside.shape), np.float32)
        gray[:, :, self._inside] = shaded
        return gray, distance

    def _wall(self, T_kidney_camera: Array) -> tuple[Floats, Floats]:
        """Distances (B, R) from B poses (B, 4, 4) along the grid's rays, inf without a wall, and the wall's normals
        (B, 3, R), of unit length, camera frame.

        The last poses' are kept: who verified hypotheses where they ended aligns the best of them from there.
        """
        poses, known = [T.tobytes() for T in T_kidney_camera], self._walls
        new = [i for i, pose in enumerate(poses) if pose not in known]
        if new:
            cast = zip(*self._cast(T_kidney_camera[new]), strict=True)
            known = known | dict(zip((poses[i] for i in new), cast, strict=True))
        self._walls = kept = {pose: known[pose] for pose in poses}
        depth, normals = zip(*(kept[pose] for pose in poses), strict=True)
        return np.stack(depth), np.stack(normals)

    def _cast(self, T_kidney_camera: Array) -> tuple[Floats, Floats]:
        """`_wall` of poses that are not known."""
        R, t = T_kidney_camera[:, :3, :3].astype(np.float32), T_kidney_camera[:, :3, 3].astype(np.float32)
        count, rays = len(R), self._rays.shape[1]
        toward = (self._rays.T @ R.swapaxes(1, 2)).reshape(-1, 3)
        origins, half = np.repeat(t, rays, 0), len(toward) // 2
        rest = meanwhile(lambda: self._scene.cast(origins[half:], toward[half:]))
        depths, facing = map(np.concatenate, zip(self._scene.cast(origins[:half], toward[:half]), rest(), strict=True))
        return depths.reshape(count, rays), -R.swapaxes(1, 2) @ facing.T.reshape(3, count, rays).swapaxes(0, 1)

    def _step(self, picture: Fields, drawing: Drawing, T_picture_drawing: Array, light: Array) -> _Step:
        """What B drawings find where they lie on a picture when moved (B, 4, 4), and lit otherwise by (B, 6)."""
        T, pixels = T_picture_drawing.astype(np.float32), drawing.seen.shape[1]
        points = T[:, :3, :3] @ drawing.points
        points += T[:, :3, 3:]
        # The picture's slopes and values, the drawing's values, ones.
        rows = np.empty((len(T), 4 * FIELDS + 1, pixels), np.float32)
        good = self.grid.sample(picture, self.grid.camera.pixels(points.transpose(1, 0, 2)), rows[:, : 3 * FIELDS])
        good *= drawing.seen
        rows[:, 3 * FIELDS : -1], rows[:, -1] = drawing.value, 1
        changed = light[:, -drawing.lit.shape[1] :].astype(np.float32)
        rows[:, 3 * FIELDS : -1] += np.einsum("bl,blcn->bcn", changed, drawing.lit)
        fields = rows[:, 2 * FIELDS :]
        count, correlation, a, b, c = correlated(fields, good)
        residual = fields[:, :FIELDS] * a
        residual -= fields[:, FIELDS:-1] * b
        residual += c
        gradient = rows[:, : 2 * FIELDS].reshape(len(T), 2, FIELDS, pixels)
        gradient *= (a / 2)[:, None]
        gradient += drawing.slope * (b / 2)[:, None]
        robust = tukey(residual, good, count)
        normal, slant = normal_equations(drawing.motion, gradient, drawing.lit, b, robust, residual)
        enough = count >= LEAST_PIXELS
        step = self._solved(normal, slant, count, drawing.light + light)
        return _Step(np.where(enough, correlation.sum(1) / FIELDS, -1.0), step, enough)

    def _solved(self, normal: Array, slant: Array, count: Floats, light: Array) -> Array:
        """The steps (B, 6 + 6) that normal equations (B, 6 + L, 6 + L) and (B, 6 + L) ask for, see `Drawing.lit`, from
        lights (B, 6)."""
        free = slice(6 - slant.shape[1], None)  # of the light's numbers the last L
        diagonal = np.einsum("bii->bi", normal)  # a view: what is written there is written to the matrices
        diagonal *= 1 + _DAMPING
        diagonal += 1e-9
        step = np.zeros((len(slant), 6 + len(AT_CAMERA)))
        prior = _LIGHT_PRIOR * count[:, None] / self._spread[free] ** 2
        diagonal[:, 6:] += prior
        slant[:, 6:] += prior * (light - AT_CAMERA)[:, free]
        solved = -np.linalg.solve(normal, slant[..., None])[..., 0]
        step[:, :6], step[:, free] = solved[:, :6], solved[:, 6:]
        return self._limited(step)

    def _limited(self, step: Array) -> Array:
        """Steps (..., 6 + 6) shortened to what one linearization can be trusted with."""
        square = np.square(step)
        far, turned = square[..., :3].sum(-1) / self._longest_step**2, square[..., 3:6].sum(-1) / _LARGEST_TURN**2
        return np.asarray(step / np.sqrt(np.maximum(np.maximum(far, turned), 1.0))[..., None])
