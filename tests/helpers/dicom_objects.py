"""DICOM objects that lie beside scans, or hold them in another way."""

from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.segmentation import Scan

SR, PRESENTATION = "1.2.840.10008.5.1.4.1.1.88.67", "1.2.840.10008.5.1.4.1.1.11.1"
SECONDARY, ENHANCED = "1.2.840.10008.5.1.4.1.1.7", "1.2.840.10008.5.1.4.1.1.2.1"


def _data(kind: str, modality: str, series: str) -> Any:
    import pydicom
    from pydicom.dataset import FileDataset, FileMetaDataset

    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = kind, f"{series}.7"
    meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    data = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    data.SOPClassUID, data.SOPInstanceUID, data.Modality = kind, f"{series}.7", modality
    data.StudyInstanceUID, data.SeriesInstanceUID = "1.2.3", series
    return data


def report(path: Path) -> None:
    data = _data(SR, "SR", "1.2.3.90")
    data.ValueType, data.ContinuityOfContent = "CONTAINER", "SEPARATE"
    data.save_as(path, enforce_file_format=True)


def presentation_state(path: Path) -> None:
    data = _data(PRESENTATION, "PR", "1.2.3.91")
    data.ContentLabel = "WINDOW"
    data.save_as(path, enforce_file_format=True)


def secondary_capture(path: Path) -> None:
    data = _data(SECONDARY, "OT", "1.2.3.92")
    data.SeriesDescription = "dose page"
    _pixels(data, np.zeros((8, 8), np.uint8))
    data.save_as(path, enforce_file_format=True)


def enhanced_ct(path: Path, scan: Scan, frames: list[int]) -> None:
    """The slices ``frames`` of a scan in one file; every second one with a rescaling of its own."""
    from pydicom.dataset import Dataset
    from pydicom.sequence import Sequence

    data = _data(ENHANCED, "CT", "1.2.3.93")
    cosines = (scan.T_lps_voxel[:3, :3] / scan.spacing_mm).T
    x, y, z = scan.spacing_mm.tolist()
    shared, orientation, measures = Dataset(), Dataset(), Dataset()
    orientation.ImageOrientationPatient = [*cosines[0].tolist(), *cosines[1].tolist()]
    measures.PixelSpacing, measures.SliceThickness = [y, x], z
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = Sequence([orientation]), Sequence([measures])
    data.SharedFunctionalGroupsSequence = Sequence([shared])
    groups, planes = [], []
    for number, k in enumerate(frames):
        slope, intercept = (1.0, -1024.0) if number % 2 == 0 else (0.5, -2000.0)
        group, position, values = Dataset(), Dataset(), Dataset()
        position.ImagePositionPatient = scan.to_lps([0, 0, k]).tolist()
        values.RescaleSlope, values.RescaleIntercept, values.RescaleType = slope, intercept, "HU"
        group.PlanePositionSequence, group.PixelValueTransformationSequence = Sequence([position]), Sequence([values])
        groups.append(group)
        planes.append((scan.voxels[:, :, k].T.astype(float) - intercept) / slope)
    data.PerFrameFunctionalGroupsSequence = Sequence(groups)
    data.NumberOfFrames = len(frames)
    _pixels(data, np.stack(planes).astype(np.uint16))
    data.save_as(path, enforce_file_format=True)


def _pixels(data: Any, values: np.ndarray) -> None:
    data.Rows, data.Columns = values.shape[-2:]
    data.SamplesPerPixel, data.PhotometricInterpretation, data.PixelRepresentation = 1, "MONOCHROME2", 0
    bits = values.dtype.itemsize * 8
    data.BitsAllocated, data.BitsStored, data.HighBit = bits, bits, bits - 1
    data.PixelData = values.tobytes()
