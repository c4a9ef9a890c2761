"""What was found, for other programs: 3D Slicer, DICOM archives, Foxglove.

Each format is one file. Patient coordinates are LPS, mm, wherever a format does not say otherwise; a program that the
extras ``dicom`` and ``mcap`` do not bring is not needed to import this.
"""

from ursnav_torch.exports.capture import write_capture
from ursnav_torch.exports.fiducials import write_fiducials
from ursnav_torch.exports.frame import lps_from_kidney
from ursnav_torch.exports.inspected import inspected_wall
from ursnav_torch.exports.mcap import write_mcap
from ursnav_torch.exports.seg import LabeledMask, mask_of_mesh, write_seg
from ursnav_torch.exports.slicer import calyx_markup, path_markups, point_markup, write_markups, write_tfm
from ursnav_torch.exports.study import Study, read_study

__all__ = [
    "LabeledMask",
    "Study",
    "calyx_markup",
    "inspected_wall",
    "lps_from_kidney",
    "mask_of_mesh",
    "path_markups",
    "point_markup",
    "read_study",
    "write_capture",
    "write_fiducials",
    "write_markups",
    "write_mcap",
    "write_seg",
    "write_tfm",
]
