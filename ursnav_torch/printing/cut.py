"""The plane that parts a phantom in two: through as few calyces as possible, both parts in one piece and of fair size.

The seam shows in pictures (thesis §3.2.2), so what counts as a calyx here is the part of the lumen from which it is
observed: its own branch, up to 14 mm from the tip (at scale 1).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import hemisphere
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.lumen import OBSERVED_WITHIN_MM

Array = NDArray[np.float64]

#: Directions that are tried.
_DIRECTIONS = 400
#: Each part has at least this share of the volume.
SMALLEST_SHARE = 0.2
#: Calyces may be grazed by this much, mm at scale 1.
GRAZE_MM = 0.3
_VOXEL_MM = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A plane ``normal @ p == offset_mm`` in the kidney frame.

    Attributes:
        normal: (3,) unit vector.
        offset_mm: distance of the plane from the origin along it.
        crossed: indices of the calyces that it crosses.
    """

    normal: Array
    offset_mm: float
    crossed: tuple[int, ...]


def calyx_regions(kidney: Kidney) -> tuple[Array, ...]:
    """For every calyx the lumen from which it is observed: points (V, 3) on a grid."""
    grid = LumenGrid.from_mesh(kidney.mesh, _VOXEL_MM * kidney.scale)
    tree = kidney.centerline
    along = tree.from_root_mm()
    node = cKDTree(tree.points_mm).query(grid.centers_mm)[1]
    regions = []
    for calyx in range(len(kidney.calyces)):
        length = along[kidney.centerline.path_to(calyx)[-1]]
        own = (tree.calyx == calyx) & (length - along <= OBSERVED_WITHIN_MM * kidney.scale)
        regions.append(np.vstack([grid.centers_mm[own[node]], kidney.calyces[calyx].tip_mm]))
    return tuple(regions)


def find_cut(kidney: Kidney, wall_mm: float, solid: Any = None) -> Cut:
    """The best plane for a phantom with walls of ``wall_mm``; ``solid``, its outside, is split to be sure.

    Raises:
        InputError: no plane leaves two connected parts of fair size.
    """
    body = Body.of(kidney, wall_mm)
    for cut in candidate_cuts(kidney, body):
        if body.parts_are_whole(cut) and (solid is None or _splits_in_two(solid, cut)):
            return cut
    raise InputError(
        f"No plane parts {kidney.source} into two connected pieces of at least {100 * SMALLEST_SHARE:.0f} % each."
    )


def _splits_in_two(solid: Any, cut: Cut) -> bool:
    parts = solid.split_by_plane(cut.normal.tolist(), cut.offset_mm)
    return all(len(part.decompose()) == 1 for part in parts)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """The phantom as voxels: lumen and wall.

    Attributes:
        solid: (X, Y, Z) bool.
        origin_mm: (3,) of voxel (0, 0, 0).
        voxel_mm: its edge.
        points_mm: (V, 3) centers of the solid voxels.
    """

    solid: NDArray[np.bool_]
    origin_mm: Array
    voxel_mm: float
    points_mm: Array

    @classmethod
    def of(cls, kidney: Kidney, wall_mm: float) -> "Body":
        """The body of a kidney with walls of ``wall_mm``."""
        voxel = _VOXEL_MM * kidney.scale
        grid = LumenGrid.from_mesh(kidney.mesh, voxel)
        pad = int(np.ceil(wall_mm / voxel)) + 1
        solid = ndimage.distance_transform_edt(~np.pad(grid.index >= 0, pad)) * voxel < wall_mm
        origin = grid.origin_mm - pad * voxel
        return cls(solid, origin, voxel, origin + voxel * np.argwhere(solid))

    def parts_are_whole(self, cut: Cut) -> bool:
        """Whether either side of a plane is one piece, crumbs of less than 0.5 % aside."""
        side = np.zeros(self.solid.shape, bool)
        side[self.solid] = self.points_mm @ cut.normal > cut.offset_mm
        for part in (side, self.solid & ~side):
            sizes = np.bincount(ndimage.label(part, np.ones((3, 3, 3)))[0].ravel())[1:]
            if not len(sizes) or sizes.max() < 0.995 * sizes.sum():
                return False
        return True


def candidate_cuts(kidney: Kidney, body: Body) -> Iterator[Cut]:
    """Planes that leave both parts large enough, those through the fewest calyces and the least of the body first."""
    regions, graze = calyx_regions(kidney), GRAZE_MM * kidney.scale
    found = []
    for normal in hemisphere(_DIRECTIONS):
        spans = np.array([[(p @ normal).min() + graze, (p @ normal).max() - graze] for p in regions])
        heights = np.sort(body.points_mm @ normal)
        low, high = np.quantile(heights, [SMALLEST_SHARE, 1 - SMALLEST_SHARE])
        for offset in _between(np.append(spans.ravel(), [low, high]), low, high):
            crossed = np.flatnonzero((spans[:, 0] < offset) & (offset < spans[:, 1]))
            within = np.searchsorted(heights, [offset - body.voxel_mm / 2, offset + body.voxel_mm / 2])
            found.append((len(crossed), int(np.diff(within)[0]), tuple(normal), offset, tuple(crossed.tolist())))
    for _, _, normal, offset, crossed_ in sorted(found):
        yield Cut(np.array(normal), float(offset), crossed_)


def _between(bounds: Array, low: float, high: float) -> Array:
    """Middles between neighboring bounds from ``low`` to ``high``: between them the count cannot change."""
    at = np.unique(bounds[(bounds >= low) & (bounds <= high)])
    return (at[:-1] + at[1:]) / 2
