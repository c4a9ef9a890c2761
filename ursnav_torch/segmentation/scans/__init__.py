"""Scans in and out of files, with where they lie in the patient; what a header does not say is asked for."""

from ursnav_torch.segmentation.scans.apart import read_scan
from ursnav_torch.segmentation.scans.export import write_dicom, write_scan
from ursnav_torch.segmentation.scans.headers import ScanHeader
from ursnav_torch.segmentation.scans.scan import Scan, spread_box, transform_of_voxels

__all__ = ["Scan", "ScanHeader", "read_scan", "spread_box", "transform_of_voxels", "write_dicom", "write_scan"]
