"""DICOM Secondary Capture: pictures of a report, kept with the patient's study."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exports.seg import BODY_PART, MANUFACTURER, object_of, save
from ursnav_torch.exports.study import Study, highdicom


def write_capture(
    folder: Path, pictures: Sequence[tuple[str, NDArray[np.uint8]]], study: Study, overwrite: bool = True
) -> list[Path]:
    """Write pictures as one series of Secondary Capture objects that names the CT's frame of reference.

    A picture of a report has no place in the patient, so that none is stated.

    Args:
        folder: where ``capture_0001.dcm`` and so on are written.
        pictures: name and uint8 (H, W) gray or (H, W, 3) in OpenCV's order blue, green, red.
        study: whose they are.
        overwrite: replace what stands there.

    Raises:
        MissingExtraError: the extra ``dicom`` is not installed.
    """
    hd = highdicom()
    series, paths = str(hd.UID()), []
    for number, (name, picture) in enumerate(pictures, 1):
        about = object_of(hd, "pictures", number, series)
        gray = picture.ndim == 2
        data = hd.sc.SCImage.from_ref_dataset(
            study.sources[0],
            pixel_array=np.ascontiguousarray(picture if gray else picture[..., ::-1]),
            photometric_interpretation="MONOCHROME2" if gray else "RGB",
            bits_allocated=8,
            coordinate_system="PATIENT",
            patient_orientation=("L", "P"),
            transfer_syntax_uid="1.2.840.10008.1.2.1",
            series_description="ursnav pictures",
            **{key: about[key] for key in ("series_instance_uid", "series_number", "sop_instance_uid",
                                           "instance_number", "manufacturer", "manufacturer_model_name",
                                           "software_versions", "device_serial_number")},
        )  # fmt: skip
        data.PatientOrientation = None  # it is asked for, but a picture of a page has none
        data.BodyPartExamined = BODY_PART
        data.FrameOfReferenceUID, data.PositionReferenceIndicator = study.frame_of_reference, ""
        data.SecondaryCaptureDeviceManufacturer = MANUFACTURER
        data.ImageComments = name[:10240]
        path = folder / f"capture_{number:04d}.dcm"
        save(data, path, overwrite)
        paths.append(path)
    return paths
