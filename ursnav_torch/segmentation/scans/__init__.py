"""Scans in and out of files, with where they lie in the patient; what a header does not say is asked for."""

from ursnav_torch.segmentation.scans.apart import dicom_files, read_scan
from ursnav_torch.segmentation.scans.dicom import read_tags
from ursnav_torch.segmentation.scans.export import write_dicom, write_scan
from ursnav_torch.segmentation.scans.headers import ScanHeader
from ursnav_torch.segmentation.scans.multiframe import multiframe_grid
from ursnav_torch.segmentation.scans.scan import Scan, spread_box, transform_of_voxels

__all__ = [
    "Scan",
    "ScanHeader",
    "dicom_files",
    "multiframe_grid",
    "read_scan",
    "read_tags",
    "spread_box",
    "transform_of_voxels",
    "write_dicom",
    "write_scan",
]
