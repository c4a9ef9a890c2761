"""DICOM segmentations read back by highdicom, the library's own way."""

from pathlib import Path

import numpy as np

from ursnav_torch.segmentation import Scan
from ursnav_torch.segmentation.scans import transform_of_voxels


def read_seg(path: Path) -> tuple[Scan, ...]:
    """The segments as label maps of 0 and 1 on the file's own grid, each named by ``source``."""
    from highdicom.seg import segread

    data = segread(path)
    volume = data.get_volume(rescale_fractional=False)
    labels = [data.get_segment_description(n).SegmentLabel for n in data.segment_numbers]
    affine = volume.affine[:, [2, 1, 0, 3]]
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    T = transform_of_voxels(spacing, affine[:3, :3] / spacing, affine[:3, 3], str(path))
    planes = volume.array.transpose(2, 1, 0, 3).astype(np.int16)
    return tuple(Scan(planes[..., i], T, label) for i, label in enumerate(labels))
