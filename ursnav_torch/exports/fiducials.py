"""DICOM Spatial Fiducials (PS3.3, A.40 and C.21.2): named points in the CT's frame of reference."""

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ursnav_torch.errors import InputError
from ursnav_torch.exports.seg import BODY_PART, object_of, save
from ursnav_torch.exports.study import Study, highdicom
from ursnav_torch.extras import import_extra
from ursnav_torch.segmentation import Markup

_SPATIAL_FIDUCIALS = "1.2.840.10008.5.1.4.1.1.66.2"
#: A fiducial's identifier holds so many characters (value representation SH); the whole name is its description.
_SHORT = 16
#: What is copied from the CT: whose it is, and of which study.
_SHARED = ("PatientID", "PatientName", "PatientBirthDate", "PatientSex", "StudyInstanceUID", "StudyID", "StudyDate",
           "StudyTime", "AccessionNumber", "ReferringPhysicianName")  # fmt: skip


def write_fiducials(path: Path, lists: Mapping[str, Markup], study: Study, overwrite: bool = True) -> None:
    """Write point lists as one Spatial Fiducials object, a fiducial set a list.

    Args:
        path: the file.
        lists: points in LPS, mm, by what they are: calyces, landmarks.
        study: the CT whose frame of reference they are in.
        overwrite: replace what stands there.

    Raises:
        InputError: there is no point.
        MissingExtraError: the extra ``dicom`` is not installed.
    """
    if not any(len(markup.points_lps) for markup in lists.values()):
        raise InputError("There is no point that could be written as a fiducial.")
    data = _empty(study)
    data.FiducialSetSequence = [_set(markup, study) for markup in lists.values() if len(markup.points_lps)]
    data.ContentDescription = ", ".join(lists)[:64]
    save(data, path, overwrite)


def _empty(study: Study) -> Any:
    """A Spatial Fiducials object without fiducials."""
    pydicom, hd = import_extra("pydicom", "dicom", "Writing DICOM"), highdicom()
    dataset = import_extra("pydicom.dataset", "dicom", "Writing DICOM")
    about, now, first = object_of(hd, "fiducials"), datetime.datetime.now(), study.sources[0]
    meta = dataset.FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = _SPATIAL_FIDUCIALS, about["sop_instance_uid"]
    meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    data = dataset.FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    data.SpecificCharacterSet = "ISO_IR 192"
    for name in _SHARED:
        setattr(data, name, first.get(name, ""))
    data.SOPClassUID, data.SOPInstanceUID, data.Modality = _SPATIAL_FIDUCIALS, about["sop_instance_uid"], "FID"
    data.SeriesInstanceUID, data.SeriesNumber = about["series_instance_uid"], about["series_number"]
    data.SeriesDescription, data.BodyPartExamined = "ursnav fiducials", BODY_PART
    data.Manufacturer, data.ManufacturerModelName = about["manufacturer"], about["manufacturer_model_name"]
    data.SoftwareVersions, data.DeviceSerialNumber = about["software_versions"], about["device_serial_number"]
    data.InstanceNumber, data.ContentLabel = about["instance_number"], "FIDUCIALS"
    data.ContentDate, data.ContentTime = now.strftime("%Y%m%d"), now.strftime("%H%M%S")
    data.InstanceCreationDate, data.InstanceCreationTime = data.ContentDate, data.ContentTime
    data.ContentCreatorName = ""
    return data


def _set(markup: Markup, study: Study) -> Any:
    data = import_extra("pydicom.dataset", "dicom", "Writing DICOM").Dataset()
    data.FrameOfReferenceUID = study.frame_of_reference
    names = list(markup.names)
    data.FiducialSequence = [
        _fiducial(name, _identifier(name, names[:i]), point)
        for i, (name, point) in enumerate(zip(names, markup.points_lps.tolist(), strict=True))
    ]
    return data


def _identifier(name: str, before: Sequence[str]) -> str:
    """A name short enough, and no other's among those before it."""
    short = name[:_SHORT]
    return short if all(short != other[:_SHORT] for other in before) else f"{len(before) + 1}"


def _fiducial(name: str, identifier: str, point_lps: list[float]) -> Any:
    data = import_extra("pydicom.dataset", "dicom", "Writing DICOM").Dataset()
    data.FiducialIdentifier, data.FiducialDescription = identifier or "point", name or "point"
    data.ShapeType, data.NumberOfContourPoints = "POINT", 1
    data.ContourData = [f"{v:.6g}" for v in point_lps]
    return data
