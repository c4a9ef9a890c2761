"""Which of the lumen's outermost voxels are wall that was inspected."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ursnav_torch.errors import InputError
from ursnav_torch.exports.seg import LabeledMask
from ursnav_torch.exports.study import Study
from ursnav_torch.geometry import Array, apply

_GREEN, _RED = (60, 170, 90), (200, 70, 60)


def inspected_wall(
    lumen: NDArray[np.bool_], patches_lps: Array, seen: Sequence[int], study: Study
) -> tuple[LabeledMask, ...]:
    """The wall in two segments, seen and not; one where the other is empty.

    A voxel is wall when it is lumen and has a neighbor across a face that is not. It is as its nearest patch is.

    Args:
        lumen: (X, Y, Z) on the study's grid.
        patches_lps: (P, 3) middle of every patch of the wall, LPS, mm.
        seen: which of them were seen.
        study: the CT.

    Raises:
        InputError: ``seen`` names patches that are not there.
    """
    if len(seen) and (min(seen) < 0 or max(seen) >= len(patches_lps)):
        raise InputError(
            f"The coverage names patch {max(seen)} of a wall that has {len(patches_lps)}; it is of another kidney."
        )
    voxels = np.argwhere(lumen & ~ndimage.binary_erosion(lumen))
    nearest = cKDTree(patches_lps).query(apply(study.T_lps_voxel, voxels.astype(float)))[1]
    is_seen = np.isin(nearest, np.asarray(seen, int))
    segments = []
    for label, of, color in (("Inspected wall", is_seen, _GREEN), ("Wall not inspected", ~is_seen, _RED)):
        mask = np.zeros_like(lumen)
        mask[tuple(voxels[of].T)] = True
        if of.any():
            segments.append(LabeledMask(label, mask, color))
    return tuple(segments)
