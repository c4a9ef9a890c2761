"""The plan of a procedural collecting system: which tubes and cups it has, drawn from a seed. Anatomical mm.

The frame is the right kidney's with the pelvis at the origin: x lateral, y anterior, z superior. Where the ranges come
from:

* number and places of minor calyces: computed tomography of 492 kidneys (J. Endourol. 2018, doi 10.1089/end.2018.0218):
  mostly 7 or 8, one at the top, one at the bottom, and between them levels with an anterior and a posterior one; pelvis
  divided in two in 42 %. Textbooks give 4 to 18.
* minor calyces that open straight into the pelvis in 8 % of 100 specimens, two major calyces as the commonest
  pattern: Anjana et al., Indian J. Urol. 33:36, 2017.
* infundibula: length 12 +- 6.5 mm, width 4.3 +- 1.7 mm in urograms of 60 lower poles (iasj.net article 89547); width
  7.5 +- 2.9 mm and lower infundibulopelvic angle 76 +- 15 degrees in 52 systems by CT (doi 10.1089/end.2009.0262);
  thresholds of 30 mm, 5 mm and 70 degrees after Elbahnasy et al., J. Urol. 159, 1998.
* ureter: 4.4 mm wide (1.5 to 8) in CT of 170 patients (doi 10.1186/s12301-020-00021-0).
* compound papillae: mostly at the poles (Eur. Urol., papillary morphology in adult human kidneys; textbooks).

Depth and width of the cups and the reach of the sinus are not tabled anywhere we know; they are set to what casts and
CT show (cups 6 to 11 mm wide, tips some 50 to 65 mm apart from pole to pole).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Tube:
    """A bent tube.

    Attributes:
        points_mm: (K, 3) its middle line, densely sampled.
        radius_mm: (K,) mean radius along it.
        lobes: (2,) amplitude of the second and third harmonic of its outline, relative to the radius.
        phases: (2,) their angles in radians.
        twist: radians by which the outline turns from one end to the other.
        flat_end: whether it ends in a plane across (the cut ureter) and not in a dome.
    """

    points_mm: Array
    radius_mm: Array
    lobes: Array
    phases: Array
    twist: float
    flat_end: bool = False


@dataclass(frozen=True, slots=True)
class Cup:
    """The end of a minor calyx: a widening cup with one papilla, or two, pushed into it.

    Attributes:
        base_mm: (3,) middle of its mouth.
        axes: (3, 3) rows: long side, short side, and the axis from the mouth to the papilla.
        radii_mm: (2,) half widths along the two sides.
        neck_mm: radius at the mouth.
        depth_mm: from the mouth to the fornix.
        papillae: (P, 4) offset along the two sides, radius at the foot, height.
    """

    base_mm: Array
    axes: Array
    radii_mm: Array
    neck_mm: float
    depth_mm: float
    papillae: Array


@dataclass(frozen=True, slots=True)
class Plan:
    """All tubes and cups; the pelvis' half axes (3,) along x, y, z, mm."""

    pelvis_mm: Array
    tubes: tuple[Tube, ...]
    cups: tuple[Cup, ...]


def draw_plan(rng: np.random.Generator, calyces: int) -> Plan:
    """A plan with ``calyces`` minor calyces."""
    pelvis = np.array([rng.uniform(7, 11), rng.uniform(3.2, 5.5), rng.uniform(6, 10)])
    tips, outward = _sinus(rng, calyces)
    tubes = [_ureter(rng, pelvis)]
    cups = []
    for group in _groups(rng, tips):
        major = _major(rng, pelvis, tips[group])
        tubes.append(major)
        far = group[np.linalg.norm(tips[group], axis=1).argmax()]
        for c in group:
            start = _branching(rng, major, last=c == far)
            cup = _cup(rng, tips[c], outward[c], start, polar=abs(tips[c, 2]) > 18)
            tubes.append(_minor(rng, start, cup))
            cups.append(cup)
    return Plan(pelvis, tuple(tubes), tuple(cups))


def _sinus(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Where the papillae stand (n, 3) around the renal sinus, from top to bottom, and which way out is (n, 3)."""
    half = np.array([rng.uniform(19, 25), rng.uniform(13, 17), rng.uniform(25, 31)])
    levels = 2 + (n - 2 + 1) // 2
    height = np.linspace(1, -1, levels) * np.radians(rng.uniform(68, 80))
    paired = (
        rng.permutation(np.repeat([2, 1], [n - levels, 2 * levels - n - 2])) if n > levels else np.ones(levels - 2, int)
    )
    members = np.concatenate([[1], paired, [1]])
    elevation, azimuth = [], []
    for level, count in zip(height, members, strict=True):
        front = rng.choice([-1, 1])
        for k in range(count):
            side = front * (-1) ** k
            spread = rng.uniform(35, 68) if count == 2 else rng.uniform(0, 30)
            elevation.append(level + np.radians(rng.normal(0, 5)))
            azimuth.append(side * np.radians(spread))
    b, a = np.array(elevation), np.array(azimuth)
    unit = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], axis=1)
    outward = unit / half
    tips = unit * half * rng.uniform(0.88, 1.08, (n, 1)) + [rng.uniform(-1, 3), 0, 0]
    return tips, outward / np.linalg.norm(outward, axis=1, keepdims=True)


def _groups(rng: np.random.Generator, tips: Array) -> list[NDArray[np.int64]]:
    """Indices of the calyces that share a major calyx, from top to bottom: two groups or three."""
    count = 2 if rng.random() < 0.55 or len(tips) < 7 else 3
    cuts = np.linspace(0, len(tips), count + 1)[1:-1] + rng.uniform(-0.7, 0.7, count - 1)
    return np.split(np.arange(len(tips)), np.rint(cuts).astype(int))


def _major(rng: np.random.Generator, pelvis: Array, tips: Array) -> Tube:
    to = tips.mean(axis=0)
    start = to / np.linalg.norm(to / pelvis) * 0.45
    end = to * rng.uniform(0.5, 0.66) + rng.normal(0, 1.0, 3)
    bend = np.cross(to, rng.normal(0, 1, 3))
    line = _bezier(start, start + (end - start) / 3, end - (end - start) / 3 + bend / np.linalg.norm(bend) * 2.5, end)
    radius = rng.uniform(2.6, 3.6) + np.linspace(0.8, 0, len(line)) + np.linspace(0, rng.uniform(-0.6, 0.3), len(line))
    return _tube(rng, line, radius)


def _branching(rng: np.random.Generator, major: Tube, last: bool) -> Array:
    if last:
        return major.points_mm[-1]
    along = rng.uniform(-0.35, 0.0) if rng.random() < 0.08 else rng.uniform(0.6, 1.0)
    return major.points_mm[int(max(along, 0.0) * (len(major.points_mm) - 1))]


def _cup(rng: np.random.Generator, tip: Array, outward: Array, start: Array, polar: bool) -> Cup:
    way = (tip - start) / np.linalg.norm(tip - start)
    axis = 0.5 * outward + 0.5 * way + rng.normal(0, 0.12, 3)
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, rng.normal(0, 1, 3))
    side /= np.linalg.norm(side)
    compound = rng.random() < (0.4 if polar else 0.08)
    short = rng.uniform(2.9, 4.0)
    long = short * (rng.uniform(1.45, 1.75) if compound else rng.uniform(1.0, 1.35))
    depth = rng.uniform(3.6, 5.6)
    foot, height = short - rng.uniform(0.9, 1.3), depth * rng.uniform(0.4, 0.75)
    at = [-0.5 * foot - 0.35, 0.5 * foot + 0.35] if compound else [rng.normal(0, 0.2)]
    papillae = [[x * (1.5 if compound else 1), rng.normal(0, 0.25), foot * rng.uniform(0.9, 1.05), height] for x in at]
    neck = float(np.clip(rng.normal(2.0, 0.4), 1.4, 2.8))
    axes = np.stack([side, np.cross(axis, side), axis])
    return Cup(tip - axis * depth, axes, np.array([long, short]), neck, depth, np.array(papillae))


def _minor(rng: np.random.Generator, start: Array, cup: Cup) -> Tube:
    reach = np.linalg.norm(cup.base_mm - start)
    line = _bezier(
        start,
        start + (cup.base_mm - start) * 0.3 + rng.normal(0, 0.08, 3) * reach,
        cup.base_mm - cup.axes[2] * reach * 0.4,
        cup.base_mm,
    )
    waist = np.sin(np.linspace(0, np.pi, len(line))) * rng.uniform(0.0, 0.45)
    radius = np.linspace(cup.neck_mm + rng.uniform(0.1, 0.7), cup.neck_mm, len(line)) - waist
    return _tube(rng, line, np.maximum(radius, 1.3))


def _ureter(rng: np.random.Generator, pelvis: Array) -> Tube:
    """The funnel of the pelvis and the first 1 to 2 cm of ureter, towards the midline and the feet, cut across."""
    start = np.array([-0.2, 0.0, -0.1]) * pelvis
    end = start + rng.uniform(20, 30) * _unit([-1.0, rng.uniform(-0.3, 0.3), rng.uniform(-1.2, -0.5)])
    line = _bezier(start, start + [-9, 0, 0], end + [3, 0, 7], end)
    funnel = np.clip(1 - np.linspace(0, 2.2, len(line)), 0, 1) ** 1.5
    width = rng.uniform(1.7, 2.3)
    return _tube(rng, line, width + funnel * (0.75 * pelvis[1:].min() - width), flat_end=True)


def _tube(rng: np.random.Generator, line: Array, radius: Array, flat_end: bool = False) -> Tube:
    lobes = np.array([rng.uniform(0.05, 0.25), rng.uniform(0.0, 0.12)])
    return Tube(line, radius, lobes, rng.uniform(0, 2 * np.pi, 2), rng.uniform(-1.5, 1.5), flat_end)


def _bezier(*control: Array) -> Array:
    """(K, 3) points of a cubic curve, about 0.3 mm apart."""
    p = np.array(control, float)
    count = max(int(np.linalg.norm(np.diff(p, axis=0), axis=1).sum() / 0.3), 12)
    t = np.linspace(0, 1, count)[:, None]
    return (1 - t) ** 3 * p[0] + 3 * t * (1 - t) ** 2 * p[1] + 3 * t**2 * (1 - t) * p[2] + t**3 * p[3]


def _unit(v: list[float]) -> Array:
    return np.array(v) / np.linalg.norm(v)
