"""The plan of a phantom: which tubes and cups it has, drawn at random. Anatomical mm.

Where the ranges come from:

* number and places of minor calyces: CT of 492 kidneys (J. Endourol. 2018, doi 10.1089/end.2018.0218): mostly 8 or 7;
  one at the top, one at the bottom, levels with an anterior and a posterior one between; pelvis divided in two in 42 %.
  Textbooks give 4 to 18.
* two major calyces as the commonest pattern, minor calyces that open straight into the pelvis in 8 % of 100
  specimens: Anjana et al., Indian J. Urol. 33:36, 2017.
* infundibula: length 12 +- 6.5 mm, width 4.3 +- 1.7 mm in urograms of 60 lower poles (iasj.net article 89547); width
  7.5 +- 2.9 mm and angle to the pelvis 76 +- 15 degrees in 52 systems by CT (doi 10.1089/end.2009.0262).
* ureter: 4.4 mm wide (1.5 to 8) in CT of 170 patients (doi 10.1186/s12301-020-00021-0).
* compound papillae: mostly at the poles (textbooks).

Depth and width of the cups and the reach of the sinus are tabled nowhere we know; they are set to what casts and CT
show (cups 5 to 11 mm wide, 50 to 65 mm from pole to pole).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.kidney.phantom.shapes import Cup, Outline, Papilla, PhantomPlan, Tube
from ursnav_torch.kidney.phantom.sinus import draw_papillae

Array = NDArray[np.float64]

#: Share of minor calyces that open straight into the pelvis.
_STRAIGHT = 0.08


def draw_plan(rng: np.random.Generator, calyces: int) -> PhantomPlan:
    """A plan with ``calyces`` minor calyces; its parts may touch (see `PhantomPlan.gap_mm`)."""
    pelvis = np.array([rng.uniform(7, 11), rng.uniform(3.2, 5.0), rng.uniform(6, 10)])
    papillae, outward = draw_papillae(rng, calyces)
    distance = np.linalg.norm(papillae[:, None] - papillae, axis=-1) + 1e3 * np.eye(calyces)
    room = np.maximum(distance.min(axis=1) / 2 - 0.8, 2.4)
    majors, minors, cups = [], [], []
    for group in _groups(rng, calyces):
        major = _major(rng, pelvis, papillae[group])
        majors.append(major)
        farthest = group[np.linalg.norm(papillae[group], axis=1).argmax()]
        for c in group:
            start = major.points_mm[-1] if c == farthest else _branching(rng, major)
            polar = abs(papillae[c, 2]) > 18
            cup = _cup(rng, papillae[c], outward[c], start, room[c], polar)
            minors.append(_minor(rng, start, cup))
            cups.append(cup)
    return PhantomPlan(pelvis, _ureter(rng, pelvis), tuple(majors), tuple(minors), tuple(cups))


def _groups(rng: np.random.Generator, calyces: int) -> list[NDArray[np.int64]]:
    """Indices of the calyces that share a major calyx, from top to bottom: two groups or three."""
    count = 2 if rng.random() < 0.55 or calyces < 7 else 3
    cuts = np.linspace(0, calyces, count + 1)[1:-1] + rng.uniform(-0.7, 0.7, count - 1)
    return np.split(np.arange(calyces), np.rint(cuts).astype(int))


def _major(rng: np.random.Generator, pelvis: Array, papillae: Array) -> Tube:
    to = papillae.mean(axis=0)
    start = to / np.linalg.norm(to / pelvis) * 0.45
    end = to * rng.uniform(0.5, 0.66) + rng.normal(0, 1.0, 3)
    third = (end - start) / 3
    bend = 2.5 * _unit(np.cross(to, rng.normal(0, 1, 3)))
    line = _bezier(start, start + third, end - third + bend, end)
    taper = np.linspace(0.8, rng.uniform(-0.6, 0.3), len(line))
    return _tube(rng, line, rng.uniform(2.5, 3.5) + taper)


def _branching(rng: np.random.Generator, major: Tube) -> Array:
    """Where a minor calyx leaves: along the outer part of its major calyx, or straight from the pelvis."""
    along = 0.0 if rng.random() < _STRAIGHT else rng.uniform(0.6, 1.0)
    return major.points_mm[int(along * (len(major.points_mm) - 1))]


def _cup(rng: np.random.Generator, end: Array, outward: Array, start: Array, room: float, polar: bool) -> Cup:
    axis = _unit(0.5 * outward + 0.5 * _unit(end - start) + rng.normal(0, 0.12, 3))
    side = _unit(np.cross(axis, rng.normal(0, 1, 3)))
    compound = room > 4.2 and rng.random() < (0.45 if polar else 0.1)
    short = min(rng.uniform(2.7, 3.9), room)
    long = min(short * (rng.uniform(1.4, 1.75) if compound else rng.uniform(1.0, 1.4)), max(room, short))
    depth = rng.uniform(3.4, 5.4)
    outline = Outline(np.array([0.0, rng.uniform(0.0, 0.1)]), rng.uniform(0, 2 * np.pi, 2))
    papillae = _papillae(rng, short, long, depth, compound)
    neck = float(np.clip(rng.normal(2.0, 0.4), 1.4, 0.85 * short))
    axes = np.stack([side, np.cross(axis, side), axis])
    return Cup(end - axis * depth, axes, np.array([long, short]), outline, neck, depth, papillae)


def _papillae(rng: np.random.Generator, short: float, long: float, depth: float, compound: bool) -> tuple[Papilla, ...]:
    foot = short - rng.uniform(0.7, 1.2)
    places = [-0.5 * long, 0.5 * long] if compound else [0.0]
    return tuple(
        Papilla(
            np.array([x, 0.0]) + rng.normal(0, 0.3, 2),
            foot * rng.uniform(0.8 if compound else 0.9, 1.05),
            depth * rng.uniform(0.2, 0.65),
            rng.normal(0, 0.12, 2),
        )
        for x in places
    )


def _minor(rng: np.random.Generator, start: Array, cup: Cup) -> Tube:
    way = cup.base_mm - start
    reach = float(np.linalg.norm(way))
    out = start + 0.3 * way + rng.normal(0, 0.08, 3) * reach
    line = _bezier(start, out, cup.base_mm - cup.axes[2] * reach * 0.4, cup.base_mm)
    waist = np.sin(np.linspace(0, np.pi, len(line))) * rng.uniform(0.0, 0.45)
    radius = np.linspace(cup.neck_mm + rng.uniform(0.1, 0.7), cup.neck_mm, len(line)) - waist
    return _tube(rng, line, np.maximum(radius, 1.3))


def _ureter(rng: np.random.Generator, pelvis: Array) -> Tube:
    """The funnel of the pelvis and the first 1 to 2 cm of ureter, towards the midline and the feet, cut across."""
    start = np.array([-0.2, 0.0, -0.1]) * pelvis
    towards = np.array([-1.0, rng.uniform(-0.3, 0.3), rng.uniform(-1.2, -0.5)])
    end = start + rng.uniform(20, 30) * _unit(towards)
    line = _bezier(start, np.add(start, (-9, 0, 0)), np.add(end, (3, 0, 7)), end)
    funnel = np.clip(1 - np.linspace(0, 2.2, len(line)), 0, 1) ** 1.5
    width = rng.uniform(1.7, 2.3)
    return _tube(rng, line, width + funnel * (0.75 * pelvis[1:].min() - width), flat_end=True)


def _tube(rng: np.random.Generator, line: Array, radius: Array, flat_end: bool = False) -> Tube:
    lobes = np.array([rng.uniform(0.05, 0.25), rng.uniform(0.0, 0.12)])
    outline = Outline(lobes, rng.uniform(0, 2 * np.pi, 2))
    return Tube(line, radius, outline, rng.uniform(-1.5, 1.5), flat_end)


def _bezier(*control: ArrayLike) -> Array:
    """(K, 3) points of a cubic curve, about 0.3 mm apart."""
    p = np.array(control, float)
    count = max(int(np.linalg.norm(np.diff(p, axis=0), axis=1).sum() / 0.3), 12)
    t = np.linspace(0, 1, count)[:, None]
    return (1 - t) ** 3 * p[0] + 3 * t * (1 - t) ** 2 * p[1] + 3 * t**2 * (1 - t) * p[2] + t**3 * p[3]


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)
