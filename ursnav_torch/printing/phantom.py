"""From a kidney to two printable halves with pins and landmarks."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress, no_progress
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.printing.cut import Cut, find_cut
from ursnav_torch.printing.shell import outer_surface, pelvis_exit, ureter_end
from ursnav_torch.printing.solid import manifold3d, mesh_of, rod, solid_of

Array = NDArray[np.float64]

#: Pins and the lugs that carry them, mm; play is what a pin's hole is wider by, all around.
_PIN_MM, _PIN_LONG_MM, _PLAY_MM, _LUG_MM, _LUG_LONG_MM = 1.5, 4.0, 0.1, 3.6, 6.0
_PINS = 3
#: Lugs sit where the outside is this steep to the plane (cosine), this deep in the wall, mm.
_STEEP, _LUG_IN_MM = 0.35, 1.6
#: Knobs with a dimple for the EM probe's tip, mm.
_KNOB_MM, _DIMPLE_MM, _DIMPLE_DEEP_MM = 2.6, 1.0, 1.2
_LANDMARKS = 8
#: Triangles may be joined where that moves the outer surface by less, mm.
_LIGHTER_MM = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PrintedPhantom:
    """A phantom to print; all in the kidney frame times the scale, mm.

    Attributes:
        kidney: at the printed size.
        shell: what the halves make together.
        halves: two closed meshes; the first has the pins, the second their holes.
        cut: the plane between them.
        landmarks_mm: (L, 3) bottoms of the dimples.
        pins_mm: (P, 3) middles of the pins, on the plane.
        wall_mm: as asked.
        mouth: a point in the middle of the opening (3,), the direction out (3,) and the opening's radius.
    """

    kidney: Kidney
    shell: trimesh.Trimesh
    halves: tuple[trimesh.Trimesh, trimesh.Trimesh]
    cut: Cut
    landmarks_mm: Array
    pins_mm: Array
    wall_mm: float
    mouth: tuple[Array, Array, float]


def make_printed_phantom(
    kidney: Kidney, scale: float = 1.8, wall_mm: float = 2.0, progress: Progress = no_progress
) -> PrintedPhantom:
    """Two printable halves of a kidney.

    Args:
        kidney: at any scale.
        scale: of the print, times anatomy; the thesis printed at 1.8.
        wall_mm: thickness around the lumen.
        progress: how far it is.

    Raises:
        InputError: a value is out of range, the lumen is no solid, or no plane parts it fairly.
        MissingExtraError: manifold3d is not installed.
    """
    if not 0.5 <= scale <= 5:
        raise InputError(f"scale is {scale}; accepted are 0.5 to 5 times anatomy.")
    if not 0.5 <= wall_mm <= 10:
        raise InputError(f"wall_mm is {wall_mm}; accepted are 0.5 to 10 mm, and printers want 1 mm or more.")
    manifold3d()
    large = kidney.scaled(scale / kidney.scale)
    with progress(4, "steps of the print") as advance:
        lumen = solid_of(large.mesh, kidney.source)
        outer = solid_of(outer_surface(large.mesh, wall_mm), kidney.source).simplify(_LIGHTER_MM)
        advance(1)
        cut = find_cut(large, wall_mm, outer)
        advance(1)
        pins = _pin_places(outer, cut)
        lugs = [_along(pin, cut.normal, _LUG_LONG_MM, _LUG_MM) for pin in pins]
        mouth = _mouth(large)
        landmarks, knobs, dimples = _landmarks(mesh_of(outer), cut, pins, mouth)
        drill = rod(mouth[0], mouth[0] + mouth[1] * (wall_mm + 6 * scale), mouth[2])
        shell = _sum(outer, [*lugs, *knobs]) - _sum(lumen, [*dimples, drill])
        advance(1)
        halves = _halves(shell, cut, pins)
        advance(1)
    return PrintedPhantom(large, mesh_of(shell), halves, cut, landmarks, pins, wall_mm, mouth)


def _sum(first: Any, others: list[Any]) -> Any:
    total = first
    for other in others:
        total = total + other
    return total


def _largest(solid: Any) -> Any:
    """The largest piece: a boolean operation can leave crumbs where surfaces touch."""
    return max(solid.decompose(), key=lambda piece: piece.volume())


def _along(middle: Array, normal: Array, length: float, radius: float) -> Any:
    return rod(middle - normal * length / 2, middle + normal * length / 2, radius)


def _mouth(kidney: Kidney) -> tuple[Array, Array, float]:
    """Where the wall is opened for the scope: at the ureter's end, a little narrower, or opposite to the calyces."""
    end = ureter_end(kidney)
    if end is None:
        warnings.warn(f"{kidney.source} shows no ureter: it is opened opposite to the calyces.", stacklevel=3)
        return pelvis_exit(kidney)
    point, out, radius = end
    return point, out, 0.9 * radius


def _pin_places(outer: Any, cut: Cut) -> Array:
    """(P, 3) on the plane, just outside the body and far from each other, where the body goes on on both sides."""
    mesh = mesh_of(outer)
    segments, face = trimesh.intersections.mesh_plane(mesh, cut.normal, cut.normal * cut.offset_mm, return_faces=True)
    points, normals = segments.mean(axis=1), mesh.face_normals[face]
    slant = np.abs(normals @ cut.normal)
    steep = slant <= max(_STEEP, float(np.quantile(slant, 0.2)))
    outward = normals - np.outer(normals @ cut.normal, cut.normal)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    places = (points + outward * (_LUG_MM - _LUG_IN_MM))[steep]
    chosen = [int(np.linalg.norm(places - places.mean(axis=0), axis=1).argmax())]
    for _ in range(_PINS - 1):
        apart = np.linalg.norm(places[:, None] - places[chosen], axis=-1).min(axis=1)
        chosen.append(int(apart.argmax()))
    return places[chosen]


def _landmarks(
    outer: trimesh.Trimesh, cut: Cut, pins: Array, mouth: tuple[Array, Array, float]
) -> tuple[Array, list[Any], list[Any]]:
    """Bottoms of the dimples (L, 3), spread over the outside, with the knobs and the dimples themselves."""
    m = manifold3d()
    points, face = trimesh.sample.sample_surface(outer, 4000, seed=0)
    points, normals = np.asarray(points), outer.face_normals[face]
    free = np.abs(points @ cut.normal - cut.offset_mm) > 1.5 * _LUG_MM
    free &= np.linalg.norm(points[:, None] - pins, axis=-1).min(axis=1) > 3 * _LUG_MM
    free &= np.linalg.norm(points - mouth[0], axis=1) > 3 * mouth[2] + 2 * _KNOB_MM
    rays = outer.ray.intersects_any(points + 0.05 * normals, normals)
    points, normals = points[free & ~rays], normals[free & ~rays]
    chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
    while len(chosen) < _LANDMARKS:
        chosen.append(int(np.linalg.norm(points[:, None] - points[chosen], axis=-1).min(axis=1).argmax()))
    knobs, dimples, bottoms = [], [], []
    for at, out in zip(points[chosen], normals[chosen], strict=True):
        top = at + out * _KNOB_MM
        bottom = top - out * _DIMPLE_DEEP_MM
        knobs.append(m.Manifold.sphere(_KNOB_MM, 32).translate(at.tolist()))
        dimples.append(rod(bottom, top + out, 0.01, _DIMPLE_MM * (1 + 1 / _DIMPLE_DEEP_MM)))
        bottoms.append(bottom)
    return np.array(bottoms), knobs, dimples


def _halves(shell: Any, cut: Cut, pins: Array) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Split at the plane; the first half, on the normal's side, gets the pins, the second their holes."""
    first, second = (_largest(part) for part in shell.split_by_plane(cut.normal.tolist(), cut.offset_mm))
    for pin in pins:
        base, tip = pin + 0.4 * _PIN_LONG_MM * cut.normal, pin - 0.5 * _PIN_LONG_MM * cut.normal
        first = first + rod(base, tip, _PIN_MM)
        second = second - rod(base, tip - _PLAY_MM * cut.normal, _PIN_MM + _PLAY_MM)
    return mesh_of(first), mesh_of(second)
