"""Shapes drawn in code: silhouettes in classes, curves as an endoscope sees them, and what a query loses.

Nothing here is fitted to any method: the silhouettes are symbols of the font that ships with Matplotlib and
jointed creatures, bent, sheared, roughened, bitten, mirrored and turned.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Symbols of DejaVu Sans with an outline worth telling apart.
SYMBOLS = "☂☎✂✈✌♞♜♛♝♟☮☯⚓⚔⚖⚙⚛⚜★☘♣♠♥♪♫☁☀☠☢✄✐✒✞✡❄❤➤➳✎ABEFGHJKLMNRSTVWXYZ2345679&?%§¥€Ω"
_SIDE = 256


def silhouettes(
    classes: int = 70, instances: int = 20, seed: int = 0, upright: bool = False
) -> list[tuple[str, Image]]:
    """Binary images (256, 256), white on black, with names ``class-number`` as MPEG-7 CE-Shape-1 has them.

    They are mirrored and turned at random, or `upright`: neither.
    """
    out = []
    for c in range(classes):
        rng = np.random.default_rng([seed, c])
        creature = _Creature(rng) if c % 2 else None
        symbol = SYMBOLS[(c // 2 * 7 + seed) % len(SYMBOLS)]
        for k in range(instances):
            rng = np.random.default_rng([seed, c, k])
            base = creature.draw(rng) if creature else _symbol(symbol)
            out.append((f"shape{c}-{k + 1}", _deform(base, rng, upright)))
    return out


class _Creature:
    """A body with limbs: a class fixes their number, place and size, an instance their angles."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.body = rng.uniform([35, 15], [60, 40])
        self.limbs = rng.integers(2, 7)
        self.roots = np.sort(rng.uniform(0, math.tau, self.limbs))
        self.lengths = rng.uniform(20, 75, (self.limbs, 2))
        self.widths = rng.uniform(5, 16, self.limbs)
        self.turns = rng.uniform(-0.9, 0.9, (self.limbs, 2))
        self.heads = rng.uniform(0, 24, self.limbs) * (rng.random(self.limbs) < 0.5)

    def draw(self, rng: np.random.Generator) -> Image:
        """One instance (256, 256), every joint within some 10 degrees of the class's angle."""
        image = np.zeros((_SIDE, _SIDE), np.uint8)
        center = np.array([_SIDE / 2, _SIDE / 2])
        axes = self.body * rng.uniform(0.8, 1.2, 2)
        cv2.ellipse(image, _px(center), _px(axes), 0, 0, 360, 255, -1)
        for root, lengths, width, turns, head in zip(
            self.roots, self.lengths, self.widths, self.turns, self.heads, strict=True
        ):
            place, angle = center + 0.8 * axes * [math.cos(root), math.sin(root)], root
            for length, turn in zip(lengths, turns, strict=True):
                angle += turn + rng.normal(0, 0.2)
                tip = place + length * rng.uniform(0.75, 1.25) * np.array([math.cos(angle), math.sin(angle)])
                cv2.line(image, _px(place), _px(tip), 255, int(width * rng.uniform(0.8, 1.2)))
                place = tip
            cv2.circle(image, _px(place), int(head * rng.uniform(0.8, 1.2)), 255, -1)
        return image


def _symbol(symbol: str) -> Image:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    path = TextPath((0, 0), symbol, size=100, prop=FontProperties(family="DejaVu Sans"))
    polygons = [p for p in path.to_polygons() if len(p) > 3]
    points = np.vstack(polygons)
    low, high = points.min(0), points.max(0)
    scale = 150 / max(high - low)
    image = np.zeros((_SIDE, _SIDE), np.uint8)
    for polygon in polygons:
        p = (polygon - (low + high) / 2) * [scale, -scale] + _SIDE / 2
        cv2.fillPoly(image, [np.round(p).astype(np.int32)], 255)
    return cv2.morphologyEx(image, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))


def _deform(image: Image, rng: np.random.Generator, upright: bool) -> Image:
    """Bend, shear, roughen, bite or bulge, mirror, turn and scale a silhouette."""
    grid = np.stack(np.meshgrid(np.arange(_SIDE), np.arange(_SIDE)), -1).astype(float)
    centered = (grid - _SIDE / 2) / rng.uniform(0.6, 0.95)
    angle, side = (0.0, 1.0) if upright else (rng.uniform(0, math.tau), rng.choice([-1.0, 1.0]))
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    shear = np.eye(2) + rng.normal(0, 0.1, (2, 2))
    mirror = np.diag([side, 1.0])
    source = centered @ (mirror @ turn @ shear)
    source[..., 1] += rng.normal(0, 0.001) * source[..., 0] ** 2
    for cells, amount in ((5, 7.0), (12, 2.0), (32, 0.9)):
        noise = cv2.resize(rng.normal(size=(cells, cells, 2)), (_SIDE, _SIDE), interpolation=cv2.INTER_CUBIC)
        source += amount * rng.uniform(0.3, 1.4) * noise / noise.std()
    warped = (source + _SIDE / 2).astype(np.float32)
    out = cv2.remap(image, warped[..., 0], warped[..., 1], cv2.INTER_LINEAR)
    out = ((out > 127) * 255).astype(np.uint8)
    if rng.random() < 0.3:
        edge = np.argwhere(cv2.morphologyEx(out, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)))
        y, x = edge[rng.integers(len(edge))]
        cv2.circle(out, (int(x), int(y)), int(rng.uniform(4, 14)), int(rng.choice([0, 255])), -1)
    return _largest(out)


def _largest(image: Image) -> Image:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(image)
    biggest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if count > 1 else 0
    return ((labels == biggest) * 255).astype(np.uint8)


def _px(point: Floats) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def closed_curves(count: int, points: int, seed: int = 0) -> Floats:
    """Smooth closed curves (count, points, 2) px in a picture of 250 x 250, all different, evenly by angle."""
    rng = np.random.default_rng(seed)
    t = np.arange(points) * math.tau / points + rng.uniform(0, math.tau, (count, 1))
    radius = np.full((count, points), 60.0)
    for k in range(2, 9):
        radius += rng.normal(0, 25 / k, (count, 1)) * np.cos(k * t + rng.uniform(0, math.tau, (count, 1)))
    radius = np.clip(radius, 10, 115)
    return 125 + radius[..., None] * np.stack([np.cos(t), np.sin(t)], -1)


def edge_views(count: int, points: int, seed: int = 0) -> Floats:
    """Edge maps (count, points, 2) px as an endoscope sees them in a picture of 250 x 250, all different.

    Each holds two to five closed or open, bent and dented curves of different size, `points` points evenly by
    length.
    """
    parts = [_some_views(min(1000, count - i), points, [seed, i]) for i in range(0, count, 1000)]
    return np.concatenate(parts) if parts else np.empty((0, points, 2))


def _some_views(count: int, points: int, seed: list[int], most: int = 5, steps: int = 120) -> Floats:
    rng = np.random.default_rng(seed)
    each = (count, most, 1)
    span = np.where(rng.random(each) < 0.5, 1.0, rng.uniform(0.3, 0.8, each))
    t = np.linspace(0, 1, steps) * math.tau * span
    radius = np.ones_like(t)
    for k in range(2, 8):
        radius += rng.normal(0, 0.45 / k, each) * np.cos(k * t + rng.uniform(0, math.tau, each))
    radius *= rng.uniform(15, 70, each)
    x, y = radius * np.cos(t), radius * np.sin(t) * rng.uniform(0.4, 1, each)
    angle = rng.uniform(0, math.tau, each)
    turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], -1)
    lines = np.clip(turned + rng.uniform(60, 190, (count, most, 1, 2)), 2, 248)
    drawn = np.arange(most) < rng.integers(2, most + 1, (count, 1))
    start, step = lines[:, :, :-1].reshape(count, -1, 2), np.diff(lines, axis=2).reshape(count, -1, 2)
    length = np.linalg.norm(step, axis=2) * np.repeat(drawn, steps - 1, 1)
    return np.stack([_evenly(*view, points) for view in zip(start, step, length, strict=True)])


def _evenly(start: Floats, step: Floats, length: Floats, points: int) -> Floats:
    """Points (points, 2) evenly along segments from `start` (n, 2) by `step` (n, 2), `length` (n,) of each used."""
    ends = np.cumsum(length)
    at = (np.arange(points) + 0.5) * ends[-1] / points
    k = np.searchsorted(ends, at)
    return start[k] + ((at - ends[k] + length[k]) / length[k])[:, None] * step[k]


def observe(view: Floats, rng: np.random.Generator, keep: float = 1.0, clutter: int = 0) -> Floats:
    """The same view seen again: turned up to 5 degrees about the picture's middle, scaled up to 5 %, blurred
    by noise of 1 % of its size, a connected share `keep` of its points left, and clutter points added."""
    angle, scale = math.radians(rng.uniform(-5, 5)), rng.uniform(0.95, 1.05)
    turn = scale * np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    seen = (view - 125) @ turn + 125 + rng.normal(0, 0.01 * np.ptp(view, axis=0).max(), view.shape)
    count = round(keep * len(view))
    start = rng.integers(len(view))
    kept = seen[(start + np.arange(count)) % len(view)]
    noise = rng.uniform(view.min(0) - 10, view.max(0) + 10, (clutter, 2))
    return rng.permutation(np.vstack([kept, noise]))
