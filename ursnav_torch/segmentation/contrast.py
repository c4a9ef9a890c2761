"""The lumen from an excretory-phase scan: connected growth through the contrast, then half of its height as the wall.

A fixed threshold moves the wall with the amount of contrast. Here growth at a low threshold only says what belongs
together; the wall lies where the density is halfway between the contrast inside and what is around, both taken nearby.
"""

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress
from ursnav_torch.segmentation.coarse import TISSUE_HU, Coarse, coarse_scan, likely_seeds, lowest_tissue_lps, lps_axis
from ursnav_torch.segmentation.lumen import TOUCHING, Lumen, largest_piece
from ursnav_torch.segmentation.scans.scan import Scan, spread_box

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Thresholds of growth that are tried in turn, Hounsfield units.
_THRESHOLDS = (240.0, 300.0, 380.0, 500.0, 700.0)
#: Growth stays within this of its seed, along each axis.
_REACH_MM = 60.0
#: Volumes that a contrast-filled collecting system has, mL.
_VOLUME_ML = (0.4, 70.0)
#: Share of its surroundings that is renal tissue; that of bone is less.
_TISSUE_SHARE = 0.15
_PEAK_MM, _NEARBY_MM = 2.5, 2.5
#: Levels of the field for the wall, lowered where the lumen would fall apart. Half height, blurred by sigma, lies
#: sigma^2 / (2 r) inside a tube of radius r: 0.05 mm for a calyx in a usual scan, which the first level gives back.
_LEVELS = (-0.08, -0.2, -0.3, -0.45)
_WHOLE = 0.985


def lumen_of_contrast(
    scan: Scan, side: str | None, seed_lps: ArrayLike | None, threshold_hu: float | None, progress: Progress
) -> Lumen:
    """The contrast-filled collecting system around a seed (3,), or found by itself on one side of the body.

    Raises:
        InputError: no body, no contrast, a seed outside the contrast, growth into bone, or two kidneys and no side.
    """
    coarse = coarse_scan(scan, progress)
    thresholds = _THRESHOLDS if threshold_hu is None else (float(threshold_hu),)
    if seed_lps is not None:
        return _from_seed(scan, coarse, np.asarray(seed_lps, float), thresholds)
    found: dict[str, Lumen] = {}
    for which in ("left", "right") if side is None else (side,):
        lumen = _on_side(scan, coarse, which, thresholds)
        if lumen is not None:
            found[which] = lumen
    if not found:
        raise InputError(_nothing(coarse, side))
    if len(found) > 1:
        texts = " and ".join(f"{which} {lumen.about['volume_ml']} mL" for which, lumen in found.items())
        raise InputError(
            f"{scan.source} shows two collecting systems: {texts}. Choose with kidney.side=left or kidney.side=right."
        )
    return next(iter(found.values()))


def _nothing(coarse: Coarse, side: str | None) -> str:
    where = f"on the {side} side of" if side else "in"
    tissue = float(coarse.tissue.sum() * abs(np.linalg.det(coarse.scan.T_lps_voxel[:3, :3])) / 1000)
    return (
        f"No contrast-filled collecting system was found {where} {coarse.scan.source}: it needs a lumen denser than "
        f"{_THRESHOLDS[0]:.0f} HU amid renal tissue ({tissue:.0f} mL of tissue of {TISSUE_HU[0]} to {TISSUE_HU[1]} HU "
        "there). Give the excretory phase (some 8 to 15 minutes after injection), a point in the lumen by "
        "kidney.seed_mm=[x,y,z] (LPS), or a label map."
    )


def _on_side(scan: Scan, coarse: Coarse, side: str, thresholds: tuple[float, ...]) -> Lumen | None:
    for seed in likely_seeds(coarse, side):
        for threshold in thresholds:
            grown = _grow(scan, coarse, seed, threshold)
            if grown is not None and not grown.fault:
                return _lumen(scan, grown, threshold, seed)
    return None


def _from_seed(scan: Scan, coarse: Coarse, seed: Array, thresholds: tuple[float, ...]) -> Lumen:
    if seed.shape != (3,) or not np.all(np.isfinite(seed)):
        raise InputError(f"kidney.seed_mm must be a point [x, y, z] in mm (LPS), got {seed.tolist()}.")
    at = scan.to_voxel(seed)
    if np.any(at < -0.5) or np.any(at > np.array(scan.voxels.shape) - 0.5):
        corners = scan.to_lps(np.array([[0, 0, 0], np.array(scan.voxels.shape) - 1]))
        raise InputError(
            f"kidney.seed_mm={seed.tolist()} lies outside {scan.source}, which reaches from "
            f"{np.round(corners.min(axis=0), 1).tolist()} to {np.round(corners.max(axis=0), 1).tolist()} (LPS, mm). "
            "Points read in RAS need the signs of x and y changed."
        )
    faults = []
    for threshold in thresholds:
        grown = _grow(scan, coarse, seed, threshold)
        if grown is None:
            break
        if not grown.fault or (len(thresholds) == 1 and grown.fault != "too large"):
            return _lumen(scan, grown, threshold, seed)
        faults.append(f"{grown.fault} ({grown.volume_ml:.1f} mL) at {threshold:.0f} HU")
    if faults:
        raise InputError(
            f"What grows from kidney.seed_mm={seed.tolist()} is no collecting system: {', '.join(faults)}. It may be "
            "bone. Pick another point, set kidney.threshold_hu (with it growth is taken as it is), or give a label map."
        )
    raise InputError(
        f"kidney.seed_mm={seed.tolist()} is not in contrast: {_brightest(scan, seed):.0f} HU is the most within 4 mm, "
        f"{thresholds[0]:.0f} HU are needed. Pick a point in the filled pelvis, or lower kidney.threshold_hu."
    )


class _Grown:
    """A connected piece of contrast in a box of the scan."""

    __slots__ = ("box", "fault", "mask", "volume_ml")

    def __init__(self, box: tuple[slice, slice, slice], mask: Mask, volume_ml: float, fault: str) -> None:
        self.box, self.mask, self.volume_ml, self.fault = box, mask, volume_ml, fault


def _around(scan: Scan, seed: Array, reach_mm: float) -> tuple[slice, slice, slice]:
    at, reach = scan.to_voxel(seed), reach_mm / scan.spacing_mm
    return spread_box(at - reach, at + reach, scan.voxels.shape)


def _brightest(scan: Scan, seed: Array) -> float:
    return float(scan.part(_around(scan, seed, 4.0)).voxels.max())


def _grow(scan: Scan, coarse: Coarse, seed: Array, threshold: float) -> _Grown | None:
    """The piece at a threshold that is nearest to the seed, within 4 mm, above the kidney's lower end."""
    box = _around(scan, seed, _REACH_MM)
    part = scan.part(box)
    dense = part.voxels > threshold
    dense &= lps_axis(part, 2) > lowest_tissue_lps(coarse, seed)
    labels, _ = ndimage.label(dense, TOUCHING)
    near = _around(part, seed, 4.0)
    here = labels[near]
    if not here.any():
        return None
    piece = int(np.bincount(here[here > 0]).argmax())
    mask = labels == piece
    volume = float(mask.sum() * abs(np.linalg.det(part.T_lps_voxel[:3, :3])) / 1000)
    if volume > _VOLUME_ML[1]:
        return _Grown(box, mask, volume, "too large")
    share = _tissue_share(part, mask, coarse)
    fault = "too small" if volume < _VOLUME_ML[0] else "no renal tissue" if share < _TISSUE_SHARE else ""
    return _Grown(box, mask, volume, fault)


def _tissue_share(part: Scan, mask: Mask, coarse: Coarse) -> float:
    """Share of what lies about 3 mm around a piece that is renal tissue."""
    steps = max(1, round(float(3.0 / part.spacing_mm.mean())))
    inner = ndimage.binary_dilation(mask, iterations=steps)
    rim = part.to_lps(np.argwhere(ndimage.binary_dilation(inner) & ~inner))
    at = np.rint(coarse.scan.to_voxel(rim)).astype(int)
    at = np.clip(at, 0, np.array(coarse.tissue.shape) - 1)
    return float(coarse.tissue[tuple(at.T)].mean()) if len(rim) else 0.0


def _lumen(scan: Scan, grown: _Grown, threshold: float, seed: Array) -> Lumen:
    """The wall at half height around what has grown."""
    inside = np.argwhere(grown.mask)
    start = np.array([s.start for s in grown.box])
    margin = np.ceil(6.0 / scan.spacing_mm)
    box = spread_box(inside.min(axis=0) + start - margin, inside.max(axis=0) + start + margin, scan.voxels.shape)
    part = scan.part(box)
    mask = np.zeros(part.voxels.shape, bool)
    mask[tuple((inside + start - [s.start for s in box]).T)] = True
    field, contrast = _half_height(part, mask)
    for level in _LEVELS:
        whole, share = largest_piece(field > level)
        if share > _WHOLE:
            break
    else:
        warnings.warn(
            f"Parts of the contrast ({100 * (1 - share):.0f} %) are not connected with the rest and were left out: a "
            "neck is too narrow for the scan's resolution. Check the preview; a label map can bridge it.",
            stacklevel=2,
        )
    filled = ndimage.binary_fill_holes(whole)
    field = np.where(filled, np.maximum(field - level, 0.02), np.minimum(field - level, -0.02))
    volume = float(filled.sum() * abs(np.linalg.det(part.T_lps_voxel[:3, :3])) / 1000)
    about: dict[str, object] = {
        "threshold_hu": threshold,
        "contrast_hu": round(contrast),
        "seed_lps_mm": np.round(seed, 2).tolist(),
        "volume_ml": round(volume, 3),
    }
    return Lumen(part, box, filled, field.astype(np.float32), False, about)


def _half_height(part: Scan, mask: Mask) -> tuple[NDArray[np.float32], float]:
    """How far the density is above the middle between lumen and surroundings nearby; and the lumen's density."""
    values = part.voxels.astype(np.float32)
    voxels = np.maximum(np.rint(_PEAK_MM / part.spacing_mm), 1).astype(int)
    calm = ndimage.gaussian_filter(values, 0.5)
    peak = ndimage.maximum_filter(np.where(mask, calm, -1024), size=tuple(2 * voxels + 1))
    reached = peak > -1024
    near = _NEARBY_MM / part.spacing_mm
    peak = _local_mean(peak, reached, near / 2)
    edge = ndimage.binary_dilation(mask, TOUCHING)
    bright = values > np.where(reached, peak, np.inf) * 0.75
    around = _local_mean(values, ~edge & ~bright, near)
    height = np.maximum(peak - around, 50.0) / 2
    field = (values - (peak + around) / 2) / height
    return np.where(ndimage.binary_dilation(edge, TOUCHING), field, -1.0), float(np.median(values[mask]))


def _local_mean(values: NDArray[np.float32], where: Mask, sigma: Array) -> NDArray[np.float32]:
    """Mean of the values where ``where`` is true, weighted by nearness."""
    weight = ndimage.gaussian_filter(where.astype(np.float32), sigma)
    total = ndimage.gaussian_filter(np.where(where, values, 0).astype(np.float32), sigma)
    return total / np.maximum(weight, 1e-6)
