"""What a segmentation is: a field around the lumen, positive inside, in a box of the scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ursnav_torch.segmentation.scans.scan import Scan

#: Faces, edges and corners of a voxel count as connected.
TOUCHING = np.ones((3, 3, 3), bool)


@dataclass(frozen=True, slots=True, eq=False)
class Lumen:
    """The segmented collecting system.

    Attributes:
        part: the scan around it.
        box: where that part lies in the whole scan, voxels.
        mask: (X, Y, Z) bool, the voxels of the lumen in ``part``, one piece without holes.
        field: (X, Y, Z) float32, positive inside, zero on the wall.
        binary: whether ``field`` comes from a label map, so that its steps are to be smoothed away.
        about: how it was found: threshold, label, volume; plain data.
    """

    part: Scan
    box: tuple[slice, slice, slice]
    mask: NDArray[np.bool_]
    field: NDArray[np.float32]
    binary: bool
    about: dict[str, object]


def largest_piece(mask: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], float]:
    """The largest connected piece (X, Y, Z) of a mask (X, Y, Z), and its share of the whole."""
    labels, count = ndimage.label(mask, TOUCHING)
    if count <= 1:
        return mask, 1.0
    sizes = np.bincount(labels.ravel())[1:]
    return labels == sizes.argmax() + 1, float(sizes.max() / sizes.sum())
