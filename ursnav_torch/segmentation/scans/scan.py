"""A scan in memory: voxels and where they lie in the patient. Patient axes are DICOM's: LPS, in mm."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import apply

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A CT scan or a label map.

    Attributes:
        voxels: (X, Y, Z) values, Hounsfield units in a CT; the first axis is the row of a slice.
        T_lps_voxel: (4, 4) voxel indices (x, y, z) to patient coordinates in mm; not rigid: it holds the spacing,
            and a mirrored axis where the file has one.
        source: file or folder, for people to read.
        names: name of each label, where the file tells (3D Slicer's .seg.nrrd).
    """

    voxels: NDArray[Any]
    T_lps_voxel: Array
    source: str
    names: dict[str, int] = field(default_factory=dict)

    @property
    def spacing_mm(self) -> Array:
        """(3,) distances between neighboring voxels."""
        return np.linalg.norm(self.T_lps_voxel[:3, :3], axis=0)

    def to_voxel(self, points_lps: ArrayLike) -> Array:
        """Voxel coordinates (..., 3) of points (..., 3) in mm."""
        return apply(np.linalg.inv(self.T_lps_voxel), points_lps)

    def to_lps(self, voxel: ArrayLike) -> Array:
        """Points (..., 3) in mm of voxel coordinates (..., 3)."""
        return apply(self.T_lps_voxel, voxel)

    def part(self, box: tuple[slice, slice, slice]) -> "Scan":
        """The scan in a box of voxels, at its place in the patient; the voxels are not copied."""
        T = self.T_lps_voxel.copy()
        T[:3, 3] = self.to_lps([s.start or 0 for s in box])
        return Scan(self.voxels[box], T, self.source, self.names)


def transform_of_voxels(spacing_mm: ArrayLike, direction: ArrayLike, origin_lps: ArrayLike, source: str) -> Array:
    """``T_lps_voxel`` (4, 4) from spacing (3,), direction cosines (3, 3; a column an axis) and the first voxel's place.

    Raises:
        InputError: spacing or direction that no scan has.
    """
    spacing, R = np.asarray(spacing_mm, float), np.asarray(direction, float).reshape(3, 3)
    if not np.all(np.isfinite(spacing)) or spacing.min() < 0.05 or spacing.max() > 10:
        raise InputError(
            f"{source} has voxels of {np.round(spacing, 4).tolist()} mm; accepted are 0.05 to 10 mm. Its header "
            "lacks the spacing or states it in another unit: export the scan again, in mm."
        )
    check_straight(R, source)
    if not np.isfinite(origin_lps).all():
        raise InputError(f"{source} states {np.asarray(origin_lps).tolist()} mm for its first voxel; export it again.")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R * spacing, origin_lps
    return T


def check_straight(R: Array, source: str) -> None:
    """Refuse direction cosines (3, 3), a column an axis, that are not at right angles.

    Raises:
        InputError: they are not.
    """
    if not np.abs(R.T @ R - np.eye(3)).max() <= 1e-3:
        raise InputError(
            f"The axes of {source} are not at right angles (a sheared or tilted scan). Resample it to a straight "
            "grid, e.g. in 3D Slicer with 'Resample Image', and give that."
        )


def spread_box(low: ArrayLike, high: ArrayLike, shape: tuple[int, ...]) -> tuple[slice, slice, slice]:
    """Voxels from ``low`` (3,) to ``high`` (3,), both included, within a grid of ``shape``."""
    first = np.clip(np.floor(low), 0, np.array(shape) - 1).astype(int)
    last = np.clip(np.ceil(high), 0, np.array(shape) - 1).astype(int) + 1
    x, y, z = (slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
    return x, y, z
