"""The lumen from a label map that any segmentation program made."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation.lumen import TOUCHING, Lumen
from ursnav_torch.segmentation.scans.scan import Scan, spread_box

#: A file with at most this many values, none negative, is a label map.
_MOST_LABELS = 64
_MARGIN_VOXELS = 4
#: Blur of the distance to the wall, in voxels: it takes the steps off and moves no flat wall.
_BLUR_VOXELS = 0.7
#: Pieces below this share of the whole are specks.
_SPECK = 0.01


def label_counts(scan: Scan) -> dict[int, int]:
    """Voxels of every label, or nothing where the values are those of a CT."""
    counts = np.zeros(1 << 16, np.int64)
    for plane in scan.voxels.transpose(2, 1, 0):
        if plane.min() < 0:
            return {}
        counts += np.bincount(plane.ravel(), minlength=1 << 16)
    present = np.flatnonzero(counts)
    if len(present) > _MOST_LABELS:
        return {}
    return {int(value): int(counts[value]) for value in present}


def lumen_of_label(scan: Scan, counts: dict[int, int], label: int | str | None, side: str | None) -> Lumen:
    """The lumen that one label marks; ``side`` chooses where it marks both kidneys.

    Raises:
        InputError: there is no such label, or none was chosen and there are several, or none at all.
    """
    value = _chosen(scan, counts, label)
    low, high = _extent(scan.voxels, value)
    box = spread_box(low - _MARGIN_VOXELS, high + _MARGIN_VOXELS, scan.voxels.shape)
    part = scan.part(box)
    mask = ndimage.binary_fill_holes(part.voxels == value)
    mask = _without_specks(_on_side(mask, part, scan, side))
    volume = float(mask.sum() * abs(np.linalg.det(part.T_lps_voxel[:3, :3])) / 1000)
    about: dict[str, object] = {"label": value, "volume_ml": round(volume, 3)}
    return Lumen(part, box, mask, _smooth_distance(mask, part), True, about)


def _chosen(scan: Scan, counts: dict[int, int], label: int | str | None) -> int:
    names = {value: name for name, value in scan.names.items()}
    present = [value for value in counts if value != 0]
    listed = ", ".join(f"{v} ({names[v]})" if v in names else str(v) for v in present) or "none"
    if not present:
        raise InputError(f"{scan.source} is empty: no voxel carries a label. Export the segmentation again.")
    if label is None and len(present) > 1:
        raise InputError(f"{scan.source} has several labels: {listed}. Choose the lumen's with kidney.label=.")
    value = present[0] if label is None else scan.names.get(str(label), label)
    if not str(value).lstrip("-").isdecimal() or int(value) not in present:
        raise InputError(
            f"{scan.source} has no label {label!r}; it has {listed}. Choose the one that marks the lumen of pelvis "
            "and calyces."
        )
    return int(value)


def _extent(voxels: NDArray[Any], value: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last voxel (3,) of a label along each axis."""
    hit = voxels == value
    along = [np.flatnonzero(hit.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    return np.array([a[0] for a in along]), np.array([a[-1] for a in along])


def _on_side(mask: NDArray[np.bool_], part: Scan, whole: Scan, side: str | None) -> NDArray[np.bool_]:
    """The pieces left or right of the scan's middle; all without a side."""
    if side is None:
        return mask
    labels, count = ndimage.label(mask, TOUCHING)
    centers = part.to_lps(np.array(ndimage.center_of_mass(mask, labels, range(1, count + 1))))
    middle = whole.to_lps((np.array(whole.voxels.shape) - 1) / 2)
    there = [i + 1 for i, c in enumerate(centers) if (c[0] > middle[0]) == (side == "left")]
    if not there:
        raise InputError(f"The label has no voxel on the {side} side of {whole.source}; leave out kidney.side.")
    return np.isin(labels, there)


def _without_specks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    labels, count = ndimage.label(mask, TOUCHING)
    if count <= 1:
        return mask
    sizes = np.bincount(labels.ravel())[1:]
    return np.isin(labels, np.flatnonzero(sizes >= _SPECK * sizes.sum()) + 1)


def _smooth_distance(mask: NDArray[np.bool_], part: Scan) -> NDArray[np.float32]:
    """Distance to the wall in mm, positive inside, its steps blurred away."""
    spacing = part.spacing_mm
    inside, outside = (ndimage.distance_transform_edt(m, sampling=spacing) for m in (mask, ~mask))
    half = spacing.min() / 2
    distance = np.where(mask, inside - half, half - outside)
    sigma = _BLUR_VOXELS * spacing.max() / spacing
    return np.asarray(ndimage.gaussian_filter(distance, np.minimum(sigma, 1.5)), np.float32)
