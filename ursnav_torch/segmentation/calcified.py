"""Stones of a scan: calcified voxels in and at the collecting system, where they can be told from contrast.

Connected components above a threshold of attenuation; size by full width at half maximum, as a scanner's blur moves
neither side of it. In the excretory phase contrast hides stones that are not denser: none is then told, and it is said.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ursnav_torch.geometry import apply, hemisphere
from ursnav_torch.segmentation.load import CtKidney
from ursnav_torch.segmentation.lumen import TOUCHING
from ursnav_torch.segmentation.scans import Scan
from ursnav_torch.segmentation.scans.scan import spread_box

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Without contrast nothing in a kidney is denser than this but stones and calcified vessels; uric acid is said to have
#: 200 to 450 HU. A usual figure, chosen on no scans: look at what was found.
_LEAST_HU = 300.0
#: Contrast within this of its median may be thicker in one place than in another; and so many standard deviations.
_CONTRAST_HU, _CONTRAST_SD = 300.0, 5.0
#: Stones of calcium are said to be denser than this, likewise; where contrast asks for a higher threshold, even they
#: cannot be told.
_CALCIUM_HU = 900.0
#: A stone lies in the lumen or at most so far outside: contrast does not flow round a stone that fills its calyx.
_NEAR_MM = 3.0
#: Longest diameters: what is smaller is not told from noise in a usual scan, what is larger is bone or the lumen.
_SIZE_MM = (1.5, 45.0)
#: Two voxels of 0.7 x 0.7 x 1 mm; one alone is noise.
_LEAST_MM3 = 1.0
#: Around the lumen, and the grid on which a stone is measured.
_MARGIN_MM, _FINE_MM = 8.0, 0.3
_DIRECTIONS = 200


@dataclass(frozen=True, slots=True, eq=False)
class CalcifiedStone:
    """A stone of a scan: its middle (3,) in the kidney frame, its longest diameter, and its peak attenuation."""

    center_mm: Array
    size_mm: float
    peak_hu: float


@dataclass(frozen=True, slots=True, eq=False)
class ScanStones:
    """What a scan says of stones.

    Attributes:
        stones: the largest first.
        could_tell: whether stones can be told in it at all.
        sentence: for people to read.
    """

    stones: tuple[CalcifiedStone, ...]
    could_tell: bool
    sentence: str


def calcified_stones(found: CtKidney, unenhanced: Scan | None = None) -> ScanStones:
    """The stones in and at a segmented collecting system.

    Args:
        found: the collecting system, and the scan that it was taken from.
        unenhanced: a scan before contrast, in the same patient coordinates; None looks at ``found``'s own.
    """
    if unenhanced is None and found.lumen.binary:
        return ScanStones(
            (), False, "Stones were not looked for: a label map has no densities. Give the scan before contrast with "
            "unenhanced=."
        )  # fmt: skip
    scan = unenhanced or found.scan
    part = _around_lumen(scan, found)
    if part is None:
        return ScanStones((), False, f"Stones were not looked for: {scan.source} does not show this kidney.")
    outside = _mm_outside(part, found)
    inside = part.voxels[outside <= 0].astype(float)
    if not len(inside):
        return ScanStones((), False, f"Stones were not looked for: {scan.source} is too coarse for this lumen.")
    level, threshold = _threshold(inside)
    if threshold > _CALCIUM_HU:
        return ScanStones(
            (), False, f"Stones cannot be told in {scan.source}: the lumen is filled with {level:.0f} HU, as dense as "
            "stones are: contrast, or one stone that fills it. Give the scan before contrast with unenhanced=."
        )  # fmt: skip
    stones = _components(part, outside, level, threshold, found.T_kidney_lps)
    return ScanStones(stones, True, _sentence(stones, threshold))


def _sentence(stones: tuple[CalcifiedStone, ...], threshold: float) -> str:
    sizes = ", ".join(f"{s.size_mm:.1f} mm" for s in stones)
    count = f"{len(stones)} stone{'' if len(stones) == 1 else 's'} in the scan: {sizes}" if stones else "No stone seen"
    return f"{count}; what is less dense than {threshold:.0f} HU, or smaller than {_SIZE_MM[0]:g} mm, is not told."


def _around_lumen(scan: Scan, found: CtKidney) -> Scan | None:
    """The part of a scan around the lumen; None where it is not all there."""
    inside = np.argwhere(found.lumen.mask)
    at = scan.to_voxel(found.lumen.part.to_lps(inside))
    low, high = at.min(axis=0), at.max(axis=0)
    if (low < -1).any() or (high > np.array(scan.voxels.shape)).any():
        return None
    margin = _MARGIN_MM / scan.spacing_mm
    return scan.part(spread_box(low - margin, high + margin, scan.voxels.shape))


def _mm_outside(part: Scan, found: CtKidney) -> NDArray[np.float32]:
    """How far outside the lumen the voxels of a part (X, Y, Z) lie, mm; 0 inside, infinite beyond where it is known."""
    lumen = found.lumen
    away = ndimage.distance_transform_edt(~lumen.mask, sampling=lumen.part.spacing_mm).astype(np.float32)
    T = np.linalg.inv(lumen.part.T_lps_voxel) @ part.T_lps_voxel
    return np.asarray(
        ndimage.affine_transform(
            away, T[:3, :3], T[:3, 3], output_shape=part.voxels.shape, order=0, mode="constant", cval=np.inf
        ),
        np.float32,
    )


def _threshold(inside: Array) -> tuple[float, float]:
    """What the lumen's urine has, HU, and the threshold above which a voxel is calcified."""
    level, upper = np.percentile(inside, (50, 75))
    sd = (upper - level) / 0.6745
    return float(level), float(max(_LEAST_HU, level + max(_CONTRAST_HU, _CONTRAST_SD * sd)))


def _components(
    part: Scan, outside: NDArray[np.float32], level: float, threshold: float, T_kidney_lps: Array
) -> tuple[CalcifiedStone, ...]:
    """Connected calcified voxels within limits of place and size; those that go on beyond the part are bone."""
    labels, _ = ndimage.label(part.voxels > threshold, TOUCHING)
    voxel_mm3 = float(np.prod(part.spacing_mm))
    stones = []
    for index, box in enumerate(ndimage.find_objects(labels), start=1):
        here = labels[box] == index
        on_edge = any(s.start == 0 or s.stop == n for s, n in zip(box, labels.shape, strict=True))
        if on_edge or here.sum() * voxel_mm3 < _LEAST_MM3 or outside[box][here].min() > _NEAR_MM:
            continue
        stone = _measured(part, box, labels == index, level, T_kidney_lps)
        if _SIZE_MM[0] <= stone.size_mm <= _SIZE_MM[1]:
            stones.append(stone)
    return tuple(sorted(stones, key=lambda s: -s.size_mm))


def _measured(part: Scan, box: tuple[slice, ...], component: Mask, level: float, T_kidney_lps: Array) -> CalcifiedStone:
    """Middle and longest diameter of a component at half of its height above the urine, on a finer grid."""
    low = np.array([s.start for s in box]) - 3
    high = np.array([s.stop for s in box]) + 2
    peak = float(np.percentile(part.voxels[component], 90))
    steps = np.maximum(np.rint(part.spacing_mm / _FINE_MM), 1)
    axes = [np.arange(a, b + 1e-9, 1 / n) for a, b, n in zip(low, high, steps, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"))
    values = ndimage.map_coordinates(part.voxels.astype(np.float32), grid, order=1, mode="nearest")
    labels, _ = ndimage.label(values > (peak + level) / 2, TOUCHING)
    own = ndimage.map_coordinates(component.astype(np.uint8), grid, order=0) > 0
    counts = np.bincount(labels[own & (labels > 0)])
    points = part.to_lps(np.moveaxis(grid, 0, -1)[labels == int(counts.argmax())])
    extent = float(np.ptp(points @ hemisphere(_DIRECTIONS).T, axis=0).max())
    size = extent + _FINE_MM / 2  # from the middles of the outermost points to where half height is crossed
    return CalcifiedStone(apply(T_kidney_lps, points.mean(axis=0)), size, peak)
