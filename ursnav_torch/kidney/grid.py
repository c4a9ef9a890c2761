"""The lumen as a grid of voxels with the signed distance to its wall: what paths and distances are computed on."""

from dataclasses import dataclass, field

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Half of the 26 neighbors of a voxel; the other half are their opposites.
_HALF_NEIGHBORS = [d for d in np.ndindex(3, 3, 3) if d > (1, 1, 1)]


@dataclass(frozen=True, slots=True, eq=False)
class VoxelGrid:
    """A grid over the lumen, without the steps between its voxels.

    Attributes:
        wall_mm: (X, Y, Z) distance of every voxel's center to the wall, positive inside; exact inside and
            within two voxels outside.
        origin_mm: (3,) center of voxel (0, 0, 0), kidney frame.
        voxel_mm: edge length of a voxel.
        index: (X, Y, Z) number of each voxel inside the lumen, -1 outside.
        centers_mm: (V, 3) centers of the voxels inside, in the order of ``index``.
    """

    wall_mm: Array
    origin_mm: Array
    voxel_mm: float
    index: IntArray
    centers_mm: Array
    _trees: list[cKDTree] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def from_inside(cls, inside: NDArray[np.bool_], wall_mm: Array, origin_mm: Array, voxel_mm: float) -> "VoxelGrid":
        """From which voxels (X, Y, Z) lie inside, and the other attributes."""
        return cls(wall_mm, origin_mm, voxel_mm, _numbered(inside), origin_mm + voxel_mm * np.argwhere(inside))

    @property
    def radius_mm(self) -> Array:
        """(V,) distance from the center of each voxel inside to the wall."""
        return self.wall_mm[self.index >= 0]

    def clearance_mm(self, points_mm: ArrayLike) -> Array:
        """(N,) distance to the wall of points (N, 3), negative outside.

        Interpolated: good to a tenth of a voxel near the wall, and up to half a voxel too small along the middle line.
        """
        at = (np.asarray(points_mm, float).reshape(-1, 3) - self.origin_mm) / self.voxel_mm
        return ndimage.map_coordinates(self.wall_mm, at.T, order=1, mode="nearest")

    def nearest(self, points_mm: ArrayLike) -> IntArray:
        """(N,) number of the voxel inside whose center is nearest to each point (N, 3)."""
        points = np.asarray(points_mm, float).reshape(-1, 3)
        at = np.rint((points - self.origin_mm) / self.voxel_mm).astype(int)
        voxel = self.index[tuple(np.clip(at, 0, np.array(self.index.shape) - 1).T)]
        out = (voxel < 0) | np.any((at < 0) | (at >= self.index.shape), axis=1)
        if out.any():
            voxel[out] = self._tree().query(points[out])[1]
        return voxel

    def _tree(self) -> cKDTree:
        """Finds centers near a place; made when a place outside is first asked for, and kept."""
        if not self._trees:
            self._trees.append(cKDTree(self.centers_mm))
        return self._trees[0]


@dataclass(frozen=True, slots=True, eq=False)
class LumenGrid(VoxelGrid):
    """A grid over the lumen on which ways can be found.

    Attributes:
        graph: (V, V) symmetric sparse lengths in mm between each voxel inside and its up to 26 neighbors.
    """

    graph: csr_array

    @classmethod
    def from_mesh(cls, mesh: trimesh.Trimesh, voxel_mm: float) -> "LumenGrid":
        """Grid over a closed mesh (mm, normals outward) with voxels of ``voxel_mm``."""
        origin = mesh.vertices.min(axis=0) - 2.5 * voxel_mm
        shape = np.ceil((mesh.vertices.max(axis=0) - origin) / voxel_mm + 2.5).astype(int) + 1
        inside = fill((mesh.triangles - origin) / voxel_mm, shape)
        near = ndimage.binary_dilation(inside, iterations=2)
        wall = -ndimage.distance_transform_edt(~inside) * voxel_mm
        exact = distance_to_surface(mesh, origin + voxel_mm * np.argwhere(near), edge_mm=1.5 * voxel_mm)
        wall[near] = np.where(inside[near], exact, -exact)
        index = _numbered(inside)
        return cls(wall, origin, voxel_mm, index, origin + voxel_mm * np.argwhere(inside), _graph(index, voxel_mm))


def _numbered(inside: NDArray[np.bool_]) -> IntArray:
    """(X, Y, Z) number of each voxel inside, in the order of `numpy.argwhere`, -1 outside."""
    index = np.full(inside.shape, -1)
    index[inside] = np.arange(inside.sum())
    return index


def distance_to_surface(mesh: trimesh.Trimesh, points_mm: ArrayLike, edge_mm: float) -> Array:
    """(N,) unsigned distance in mm of points (N, 3) to a mesh.

    Exact to the few triangles next to a point once the mesh is divided into edges of at most ``edge_mm``.
    """
    points = np.asarray(points_mm, float).reshape(-1, 3)
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=edge_mm, max_iter=30)
    triangles = vertices[faces]
    candidates = cKDTree(triangles.mean(axis=1)).query(points, k=min(6, len(faces)))[1].reshape(len(points), -1)
    best = np.full(len(points), np.inf)
    for column in candidates.T:
        on = trimesh.triangles.closest_point(triangles[column], points)
        best = np.minimum(best, np.linalg.norm(on - points, axis=1))
    return best


def _graph(index: IntArray, voxel_mm: float) -> csr_array:
    i, j, length = [], [], []
    for step in np.array(_HALF_NEIGHBORS) - 1:
        low, high = np.maximum(-step, 0), np.maximum(step, 0)
        a = index[tuple(slice(x, n - y) for x, y, n in zip(low, high, index.shape, strict=True))]
        b = index[tuple(slice(y, n - x) for x, y, n in zip(low, high, index.shape, strict=True))]
        both = (a >= 0) & (b >= 0)
        i.append(a[both])
        j.append(b[both])
        length.append(np.full(both.sum(), voxel_mm * np.linalg.norm(step)))
    rows, columns, values = np.concatenate(i), np.concatenate(j), np.concatenate(length)
    half = csr_array((values, (rows, columns)), shape=(index.max() + 1,) * 2)
    return (half + half.T).tocsr()


def fill(triangles: Array, shape: IntArray) -> NDArray[np.bool_]:
    """Voxel centers inside a closed surface (F, 3, 3) in voxel units: crossings counted along z, column by column."""
    triangles = np.add(triangles, (1.234e-5, 2.345e-5, 0.0))  # so that no vertex or edge lies exactly on a column
    low = np.ceil(triangles[..., :2].min(axis=1)).astype(int)
    size = np.maximum(np.floor(triangles[..., :2].max(axis=1)).astype(int) - low + 1, 0)
    count = size.prod(axis=1)
    face = np.repeat(np.arange(len(triangles)), count)
    k = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    column = low[face] + np.stack([k // size[face, 1], k % size[face, 1]], axis=1)
    corner = triangles[face]
    to = corner[..., :2] - column[:, None]
    area = np.stack([_cross(to[:, (v + 1) % 3], to[:, (v + 2) % 3]) for v in range(3)], axis=1)
    hit = np.all(area > 0, axis=1) | np.all(area < 0, axis=1)
    z = np.sum(area[hit] * corner[hit, :, 2], axis=1) / area[hit].sum(axis=1)
    crossings = np.zeros(shape, np.int32)
    np.add.at(crossings, (*column[hit].T, np.ceil(z).astype(int)), 1)
    return (np.cumsum(crossings, axis=2) % 2).astype(bool)


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
