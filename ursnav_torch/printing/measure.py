"""What a print is worth, measured on its finished triangles."""

from dataclasses import asdict, dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.kidney.grid import distance_to_surface
from ursnav_torch.printing.phantom import PrintedPhantom
from ursnav_torch.printing.solid import mesh_of, solid_of

Array = NDArray[np.float64]

_SAMPLES = 20_000
#: Nearer to the lumen than this a point of the shell is on it, mm.
_ON_LUMEN_MM = 0.1
_EDGE_MM = 0.5
#: The farthest samples are measured again, exactly.
_LOOKED_AT_AGAIN = 200


@dataclass(frozen=True, slots=True)
class PrintCheck:
    """Measures of a printed phantom.

    Attributes:
        watertight: both halves are closed and of one piece.
        thinnest_wall_mm: least distance between inside and outside, the ureter's mouth aside.
        thinnest_septum_mm: least wall between two places of the lumen; anatomy, which the print keeps.
        union_mm: how far the shell's surface is from that of the two halves joined, at most.
        volume_ml: of material in both halves.
    """

    watertight: bool
    thinnest_wall_mm: float
    thinnest_septum_mm: float
    union_mm: float
    volume_ml: float

    def to_dict(self) -> dict[str, float | bool]:
        """Rounded plain data."""
        return {k: v if isinstance(v, bool) else round(v, 3) for k, v in asdict(self).items()}


def check_print(phantom: PrintedPhantom) -> PrintCheck:
    """Measure a printed phantom on samples of its surfaces."""
    halves = phantom.halves
    whole = all(h.is_watertight and h.volume > 0 and h.body_count == 1 for h in halves)
    joined = mesh_of(solid_of(halves[0], "half") + solid_of(halves[1], "half"))
    union = _deviation(phantom.shell, joined)
    return PrintCheck(
        bool(whole),
        _thinnest_wall(phantom),
        _thinnest_septum(phantom.kidney.mesh, 4 * phantom.wall_mm),
        union,
        float(sum(h.volume for h in halves) / 1000),
    )


def _deviation(of: trimesh.Trimesh, to: trimesh.Trimesh) -> float:
    """The largest distance of samples of a surface to another; exact where the quick measure says far."""
    points = _samples(of)
    distance = distance_to_surface(to, points, _EDGE_MM)
    far = np.argsort(-distance)[:_LOOKED_AT_AGAIN]
    exact = trimesh.proximity.closest_point(to, points[far])[1]
    return float(max(exact.max(), np.delete(distance, far).max()))


def _samples(mesh: trimesh.Trimesh) -> Array:
    return np.asarray(trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)[0])


def _thinnest_wall(phantom: PrintedPhantom) -> float:
    """Between the parts of the shell's surface that lie on the lumen and those that do not, both ways."""
    shell, lumen = phantom.shell, phantom.kidney.mesh
    on_lumen = distance_to_surface(lumen, shell.triangles_center, _EDGE_MM) < _ON_LUMEN_MM
    inner, outer = (shell.submesh([np.flatnonzero(w)], append=True, repair=False) for w in (on_lumen, ~on_lumen))
    away = [_off_mouth(phantom, _samples(mesh)) for mesh in (inner, outer)]
    outer = outer.submesh([np.flatnonzero(_is_off_mouth(phantom, outer.triangles_center))], append=True, repair=False)
    return float(
        min(
            distance_to_surface(outer, away[0], _EDGE_MM).min(),
            distance_to_surface(lumen, away[1], _EDGE_MM).min(),
        )
    )


def _off_mouth(phantom: PrintedPhantom, points: Array) -> Array:
    return points[_is_off_mouth(phantom, points)]


def _is_off_mouth(phantom: PrintedPhantom, points: Array) -> NDArray[np.bool_]:
    at, out, radius = phantom.mouth
    along = (points - at) @ out
    aside = np.linalg.norm(points - at - along[:, None] * out, axis=1)
    return (along < -phantom.wall_mm) | (aside > radius + 0.5) | (along > 20 * phantom.wall_mm)


def _thinnest_septum(lumen: trimesh.Trimesh, farthest_mm: float) -> float:
    """Along normals from the lumen outward to the lumen again."""
    points, face = trimesh.sample.sample_surface(lumen, _SAMPLES, seed=0)
    normals = lumen.face_normals[face]
    start = np.asarray(points) + 1e-3 * normals
    hits, ray, _ = lumen.ray.intersects_location(start, normals, multiple_hits=False)
    length = np.linalg.norm(hits - start[ray], axis=1)
    return float(min(length.min(initial=farthest_mm), farthest_mm))
