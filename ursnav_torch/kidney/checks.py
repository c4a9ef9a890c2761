"""Is a mesh the lumen of a collecting system, closed and in mm? Mends what can be mended, refuses the rest."""

import warnings
from collections.abc import Mapping

import networkx as nx
import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ursnav_torch.errors import InputError

#: Pieces beside the largest are crumbs of the segmentation while they hold no more than this share of the volume.
_CRUMBS = 0.03
#: Vertices closer than this are one, mm: programs that write a triangle at a time round each corner anew.
_WELD_MM = 1e-3
#: Plausible diagonals of a collecting system, mm at scale 1.
_DIAGONAL_MM = (25.0, 250.0)
#: A lumen holds some mL, distended to some tens at most; a kidney has 100 to 250 mL.
_LARGEST_ML = 90.0
#: No place in a collecting system is farther from the wall than this, short of gross hydronephrosis.
_LARGEST_RADIUS_MM = 16.0

#: What to do where a file turns out to be in another unit than mm, by that unit.
_SCALE_ADVICE = {"meters": "set kidney.scale=1000", "centimeters": "set kidney.scale=10"}


def check_lumen(
    mesh: trimesh.Trimesh, name: str, scale: float, unit_advice: Mapping[str, str] | None = None
) -> trimesh.Trimesh:
    """The mesh (mm, already scaled) as one closed piece with normals outward.

    Vertices within 1 um are welded; crumbs of up to 3 % of the volume in total are dropped and an inside-out mesh is
    turned, each with a warning.

    Raises:
        InputError: no faces; not in mm; open; several pieces; a volume that no lumen has.
    """
    _check_usable(mesh, name)
    _check_size(mesh, name, scale, unit_advice or _SCALE_ADVICE)
    mesh = _welded(mesh)
    _check_usable(mesh, name)
    mesh = _one_piece(mesh, name)
    _check_closed(mesh, name)
    if mesh.volume < 0:
        warnings.warn(f"{name} was inside-out (its normals pointed into the lumen); it was turned.", stacklevel=3)
        mesh.invert()
    if mesh.volume > _LARGEST_ML * 1000 * scale**3:
        raise _solid(name, f"holds {mesh.volume / 1000:.0f} mL")
    return mesh


def check_radius(radius_mm: float, name: str, scale: float) -> None:
    """Refuse a lumen whose largest inscribed sphere is one of a whole kidney.

    Raises:
        InputError: the radius is beyond 16 mm at scale 1.
    """
    if radius_mm > _LARGEST_RADIUS_MM * scale:
        raise _solid(name, f"has room for a ball of {radius_mm:.0f} mm radius")


def _solid(name: str, found: str) -> InputError:
    return InputError(
        f"{name} {found}, which fits a whole kidney and not its lumen: a collecting system holds 3 to 30 mL and is "
        "nowhere wider than 30 mm. Give the inner surface of pelvis and calyces; if the model was enlarged, bring it "
        "back to anatomy by a kidney.scale below 1."
    )


def _check_size(mesh: trimesh.Trimesh, name: str, scale: float, advice: Mapping[str, str]) -> None:
    low, high = (x * scale for x in _DIAGONAL_MM)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if low <= diagonal <= high:
        return
    found = (
        f"{name} measures {diagonal:.3g} mm from corner to corner; a collecting system has {low:.0f} to {high:.0f} mm"
    )
    for factor, unit in ((1000, "meters"), (10, "centimeters")):
        if low <= diagonal * factor <= high:
            raise InputError(
                f"{found}. The file seems to be in {unit}: {advice[unit]}, or export it in mm, as is "
                "needed where it is in inches."
            )
    raise InputError(
        f"{found} at scale {scale:g}. Export the lumen in mm, or set kidney.scale to what brings it to anatomy."
    )


def _check_usable(mesh: trimesh.Trimesh, name: str) -> None:
    if len(wrong := np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1))):
        raise InputError(
            f"{name} has {len(wrong)} corners that are no place, corner {wrong[0] + 1} at "
            f"{mesh.vertices[wrong[0]].tolist()} the first; export it again."
        )
    if len(mesh.faces) == 0:
        raise InputError(f"{name} has no usable triangles; export the lumen as a triangle mesh (STL, PLY, OBJ or GLB).")


def _welded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with its near vertices made one, and without the triangles that this leaves flat or double."""
    count = len(mesh.vertices)
    pairs = cKDTree(mesh.vertices).query_pairs(_WELD_MM, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    merged = connected_components(graph, directed=False)[1]
    _, first = np.unique(merged, return_index=True)
    mesh = trimesh.Trimesh(mesh.vertices[first], merged[mesh.faces], process=False)
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def _one_piece(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    edges = mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(len(mesh.vertices),) * 2)
    count, piece = connected_components(graph, directed=False)
    if count == 1:
        return mesh
    pieces = [
        mesh.submesh([np.flatnonzero(piece[mesh.faces[:, 0]] == p)], append=True, repair=False) for p in range(count)
    ]
    sizes = np.array([abs(p.volume) for p in pieces])
    order = np.argsort(-sizes, kind="stable")
    total = max(float(sizes.sum()), 1e-12)
    if total - sizes[order[0]] > _CRUMBS * total:
        listed = ", ".join(f"{v / 1000:.2f} mL" for v in sizes[order][:8] if v > 0.001 * total)
        raise InputError(
            f"{name} consists of {count} pieces ({listed}), and those beside the largest hold "
            f"{1 - sizes[order[0]] / total:.1%} of the volume; up to {_CRUMBS:.0%} are dropped as crumbs. One "
            "connected lumen is needed: join or delete pieces in the segmentation. If one is a shell around the other "
            "(organ and cavity), keep the inner one."
        )
    listed = "; ".join(f"{v:.2g} mm3 at {np.round(pieces[p].bounds.mean(axis=0), 1).tolist()}"
                       for p, v in zip(order[1:6], sizes[order[1:6]], strict=True))  # fmt: skip
    more = f" and {count - 6} smaller ones" if count > 6 else ""
    warnings.warn(
        f"{name}: {count - 1} crumbs beside the lumen, {1 - sizes[order[0]] / total:.2%} of the volume, were dropped: "
        f"{listed}{more}.",
        stacklevel=4,
    )
    return pieces[int(order[0])]


def _check_closed(mesh: trimesh.Trimesh, name: str) -> None:
    if not mesh.is_watertight:
        edges, uses = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
        open_edges = edges[uses == 1]
        holes = nx.number_connected_components(nx.from_edgelist(open_edges.tolist()))
        raise InputError(
            f"{name} is not closed: {len(open_edges)} boundary edges around {holes} holes and {np.sum(uses > 2)} edges "
            "with more than two triangles. Close it (fill holes, make it manifold) in the program that made it."
        )
    if not mesh.is_winding_consistent:
        mesh.fix_normals()
        warnings.warn(f"{name}: some triangles faced the other way; they were turned.", stacklevel=4)
