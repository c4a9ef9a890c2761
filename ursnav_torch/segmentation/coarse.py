"""The scan at about 2 mm: where contrast lies amid enhanced renal tissue, so where a collecting system may be."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress
from ursnav_torch.segmentation.scans.scan import Scan

Array = NDArray[np.float64]

_VOXEL_MM = 2.0
#: Hounsfield units: soft tissue, renal tissue that took up contrast, and contrast in the lumen.
SOFT_HU, TISSUE_HU, CONTRAST_HU = (-200, 200), (95, 330), 250
#: Renal tissue is thicker than this, the blurred edges of bone are thinner; and a kidney has more of it than a rib.
_THICK_MM, _TISSUE_ML = 4.0, 30.0
_AROUND_MM = 10.0
#: Nearer to the middle of the body lies the spine.
_SPINE_MM = 28.0
_SEEDS = 4
#: Two places that may be collecting systems are at least this far apart.
_APART_MM = 40.0


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """A scan of about 2 mm.

    Attributes:
        scan: it, float32.
        tissue: (X, Y, Z) bool, large thick parts with the density of enhanced renal tissue.
        middle_lps: x of the middle of the body.
    """

    scan: Scan
    tissue: NDArray[np.bool_]
    middle_lps: float


def coarse_scan(scan: Scan, progress: Progress) -> Coarse:
    """Average the scan to about 2 mm.

    Raises:
        InputError: it shows no body.
    """
    block = np.maximum(np.rint(_VOXEL_MM / scan.spacing_mm), 1).astype(int)
    with progress(scan.voxels.shape[2], "slices searched") as advance:
        values = _pooled(scan.voxels, block, advance)
    scaled = np.eye(4)
    scaled[:3, :3] = np.diag(block)
    scaled[:3, 3] = (block - 1) / 2
    small = Scan(values, scan.T_lps_voxel @ scaled, scan.source)
    body = (values > SOFT_HU[0]) & (values < 2000)
    soft = body & (values < SOFT_HU[1])
    if soft.mean() < 0.005 or np.ptp(values) < 100:
        raise InputError(
            f"{scan.source} shows no body: values from {values.min():.0f} to {values.max():.0f} HU, "
            f"{100 * soft.mean():.1f} % of it soft tissue. Is it a CT in Hounsfield units, and the right series?"
        )
    x = small.to_lps(np.argwhere(soft))[:, 0]
    tissue = (values > TISSUE_HU[0]) & (values < TISSUE_HU[1])
    tissue = ndimage.binary_opening(tissue, iterations=max(1, round(_THICK_MM / 2 / _VOXEL_MM)))
    labels = ndimage.label(tissue)[0]
    volume = np.bincount(labels.ravel()) * abs(np.linalg.det(small.T_lps_voxel[:3, :3])) / 1000
    tissue &= volume[labels] > _TISSUE_ML
    return Coarse(small, tissue, float((np.percentile(x, 1) + np.percentile(x, 99)) / 2))


def likely_seeds(coarse: Coarse, side: str) -> Array:
    """(K, 3) places on one side with much contrast and much renal tissue around, the likeliest first, LPS, mm."""
    scan = coarse.scan
    sigma = _AROUND_MM / scan.spacing_mm
    contrast = scan.voxels > CONTRAST_HU
    near = [ndimage.gaussian_filter(m.astype(np.float32), sigma) for m in (contrast, coarse.tissue)]
    x = lps_axis(scan, 0) - coarse.middle_lps
    off_middle = x > _SPINE_MM if side == "left" else x < -_SPINE_MM
    score = near[0] * near[1] * (off_middle & contrast)
    seeds: list[Array] = []
    for voxel in np.argwhere(score > 1e-5)[np.argsort(-score[score > 1e-5], kind="stable")]:
        at = scan.to_lps(voxel)
        if all(np.linalg.norm(at - s) > _APART_MM for s in seeds):
            seeds.append(at)
        if len(seeds) == _SEEDS:
            break
    return np.array(seeds).reshape(-1, 3)


def lowest_tissue_lps(coarse: Coarse, seed_lps: Array) -> float:
    """z of the lower end of the kidney around a seed (3,); the ureter leaves the picture there."""
    scan = coarse.scan
    labels = ndimage.label(coarse.tissue)[0]
    at = np.rint(scan.to_voxel(seed_lps)).astype(int)
    reach = np.rint(30.0 / scan.spacing_mm).astype(int)
    around = labels[tuple(slice(max(a - r, 0), a + r + 1) for a, r in zip(at, reach, strict=True))]
    sizes = np.bincount(around.ravel(), minlength=2)
    sizes[0] = 0
    if sizes.max() == 0:
        return -np.inf
    kidney = np.argwhere(labels == sizes.argmax())
    points = scan.to_lps(kidney)
    points = points[np.linalg.norm(points - seed_lps, axis=1) < 80.0]
    return float(points[:, 2].min())


def lps_axis(scan: Scan, axis: int) -> Array:
    """(X, Y, Z) one patient coordinate of every voxel, mm."""
    row = scan.T_lps_voxel[axis]
    x, y, z = (row[k] * np.arange(n) for k, n in enumerate(scan.voxels.shape))
    return np.asarray(x[:, None, None] + y[None, :, None] + z[None, None, :] + row[3])


def _pooled(voxels: NDArray[Any], block: NDArray[np.int64], advance: Callable[[int], None]) -> NDArray[np.float32]:
    """Means over blocks of voxels, a few slices at a time."""
    shape = np.maximum(np.array(voxels.shape) // block, 1)
    nx, ny = shape[0] * block[0], shape[1] * block[1]
    pooled = np.empty(shape, np.float32)
    for k in range(shape[2]):
        slab = voxels[:nx, :ny, k * block[2] : (k + 1) * block[2]].transpose(2, 1, 0)
        mean = slab.sum(axis=0, dtype=np.int32).astype(np.float32) / slab.shape[0]
        mean = np.add.reduceat(mean, np.arange(0, ny, block[1]), axis=0)
        pooled[:, :, k] = np.add.reduceat(mean, np.arange(0, nx, block[0]), axis=1).T / (block[0] * block[1])
        advance(int(block[2]))
    return pooled
