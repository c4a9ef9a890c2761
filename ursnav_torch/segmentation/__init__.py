"""``kidney=ct``: a CT urography, or a label map of one, becomes a collecting system.

Scans are read with where they lie in the patient (LPS), the lumen is taken from a label or grown through the contrast,
its surface is meshed, and from there on it is a kidney like any other. Needs the extra ``ct``.
"""

from ursnav_torch.segmentation.calcified import CalcifiedStone, ScanStones, calcified_stones
from ursnav_torch.segmentation.label_surface import lumen_surface
from ursnav_torch.segmentation.load import CtKidney, SegmentationSettings, load_ct_kidney, name_kidney, scan_lumen
from ursnav_torch.segmentation.lumen import Lumen
from ursnav_torch.segmentation.markups import Markup, calyces_from_markups, curves_of, points_of, read_markups
from ursnav_torch.segmentation.scans import Scan, ScanHeader, read_scan, write_dicom, write_scan
from ursnav_torch.segmentation.synthetic import Patient, place_kidney, synthetic_ct
from ursnav_torch.segmentation.write import BesideScan, SegmentedScan, segment_scan, write_stl

__all__ = [
    "BesideScan",
    "CalcifiedStone",
    "CtKidney",
    "Lumen",
    "Markup",
    "Patient",
    "Scan",
    "ScanHeader",
    "ScanStones",
    "SegmentationSettings",
    "SegmentedScan",
    "calcified_stones",
    "calyces_from_markups",
    "curves_of",
    "load_ct_kidney",
    "lumen_surface",
    "name_kidney",
    "place_kidney",
    "points_of",
    "read_markups",
    "read_scan",
    "scan_lumen",
    "segment_scan",
    "synthetic_ct",
    "write_dicom",
    "write_scan",
    "write_stl",
]
