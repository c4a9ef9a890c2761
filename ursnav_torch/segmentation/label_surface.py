"""From a field on the scan's voxels to a closed surface in the patient: subvoxel, smooth, of the same volume, light."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import marching_cubes

from ursnav_torch.extras import import_extra
from ursnav_torch.geometry import apply
from ursnav_torch.segmentation.lumen import Lumen

Array = NDArray[np.float64]

#: The field is refined to voxels of at most this; thicker ones would show as steps.
_FINE_MM = 0.6
#: Taubin's filter: shrinking and growing in turn, so that noise goes and size stays.
_SHRINK, _GROW, _ROUNDS = 0.5, 0.53, 8
#: Decimation may move the surface by this at most, mm.
_COARSEST_MM = 0.2


def lumen_surface(lumen: Lumen, faces: int) -> trimesh.Trimesh:
    """The lumen's surface in patient coordinates (LPS, mm), normals outward, of at most about ``faces`` triangles.

    Decimation stops before it would move the surface by more than 0.2 mm.
    """
    field, T_voxel_fine = _refined(lumen)
    vertices, triangles, *_ = marching_cubes(np.pad(field, 1, constant_values=field.min()), 0.0)
    # All is done along the scan's own axes: however it lies in the patient, the triangles are the same.
    T_along_voxel = np.diag([*lumen.part.spacing_mm, 1.0])
    mesh = trimesh.Trimesh(apply(T_along_voxel @ T_voxel_fine, vertices.astype(float) - 1), triangles, process=True)
    if mesh.volume < 0:
        mesh.invert()
    mesh = _lighter(_smoothed(mesh), faces)
    mesh.apply_transform(lumen.part.T_lps_voxel @ np.linalg.inv(T_along_voxel))
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _refined(lumen: Lumen) -> tuple[NDArray[np.float32], Array]:
    """The field on finer voxels, and fine voxel indices to those of the part (4, 4).

    The level of a label map's blurred field is set so that it encloses as much as the label does.
    """
    times = np.ceil(lumen.part.spacing_mm / _FINE_MM).astype(int)
    shape = np.array(lumen.field.shape)
    fine_shape = (shape - 1) * times + 1
    fine = np.asarray(ndimage.zoom(lumen.field, fine_shape / shape, order=3, mode="nearest", grid_mode=False))
    if lumen.binary:
        wanted = min(int(lumen.mask.sum()) * int(times.prod()), fine.size - 1)
        fine = fine - np.partition(fine.ravel(), fine.size - wanted)[fine.size - wanted]
    labels, count = ndimage.label(fine > 0)
    if count > 1 and not lumen.binary:  # one piece on the scan's voxels, so what comes off is an overshoot
        largest = np.bincount(labels.ravel())[1:].argmax() + 1
        fine = np.where((labels > 0) & (labels != largest), -0.01, fine)
    T = np.diag([*(1 / times), 1.0])
    return fine.astype(np.float32), T


def _smoothed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Taubin's filter, then an even shift along the normals that gives the volume back exactly enough."""
    volume = mesh.volume
    trimesh.smoothing.filter_taubin(mesh, lamb=_SHRINK, nu=_GROW, iterations=_ROUNDS)
    return keep_volume(mesh, volume)


def keep_volume(mesh: trimesh.Trimesh, volume: float) -> trimesh.Trimesh:
    """The mesh with its vertices moved evenly along their normals until it holds ``volume`` (mm3) to 0.1 %."""
    for _ in range(4):
        miss = (volume - mesh.volume) / mesh.area
        if abs(volume - mesh.volume) < 1e-3 * volume:
            break
        mesh.vertices = mesh.vertices + miss * mesh.vertex_normals
    return mesh


def _lighter(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """Fewer triangles: the tolerance is raised until there are few enough."""
    if len(mesh.faces) <= faces:
        return mesh
    manifold3d = import_extra("manifold3d", "ct", "Decimation of the surface")
    solid = manifold3d.Manifold(manifold3d.Mesh64(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.uint64)))
    if solid.is_empty():
        return mesh
    volume = mesh.volume
    for tolerance in np.geomspace(0.005, _COARSEST_MM, 8):
        light = solid.simplify(float(tolerance))
        if light.num_tri() <= faces:
            break
    data = light.to_mesh64()
    lighter = trimesh.Trimesh(data.vert_properties[:, :3], data.tri_verts.astype(np.int64), process=True)
    return keep_volume(lighter, volume) if lighter.is_watertight else mesh
