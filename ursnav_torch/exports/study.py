"""The DICOM series that the kidney was segmented from: whose it is, where its voxels lie, what refers to it."""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.geometry import Array
from ursnav_torch.segmentation.scans import dicom_files, multiframe_grid, read_tags, transform_of_voxels

#: Attributes that every object of a patient must have, blank where the CT has none (DICOM type 2).
_MAY_BE_BLANK = ("PatientID", "PatientName", "PatientBirthDate", "PatientSex", "AccessionNumber", "StudyID",
                 "StudyDate", "StudyTime", "ReferringPhysicianName")  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """The CT series that exported objects belong to.

    Attributes:
        sources: the series' data sets without pixels, from the first slice to the last; or the one multi-frame file's.
        frame_of_reference: its UID, which every exported object shares.
        shape: (3,) voxels along x, y, z.
        T_lps_voxel: (4, 4) voxel indices (x, y, z) to LPS, mm.
    """

    sources: tuple[Any, ...]
    frame_of_reference: str
    shape: tuple[int, int, int]
    T_lps_voxel: Array


def highdicom() -> ModuleType:
    """The library that writes DICOM objects.

    Raises:
        MissingExtraError: it is not installed.
    """
    import_extra("highdicom.seg", "dicom", "Writing DICOM")
    import_extra("highdicom.sc", "dicom", "Writing DICOM")
    return import_extra("highdicom", "dicom", "Writing DICOM")


def read_study(folder: Path, series: str | None = None) -> Study:
    """What a folder's series says of itself; no pixels are read.

    Args:
        folder: of the slices.
        series: its UID where there are several.

    Raises:
        InputError: as `read_scan` does, or the series has no frame of reference that others could share.
        MissingExtraError: the extra ``dicom`` is not installed.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; scan= takes the folder of the DICOM series that was segmented.")
    files = dicom_files(folder, series)
    sources = tuple(read_tags(file) for file in files)
    first = sources[0]
    for name in ("FrameOfReferenceUID", "StudyInstanceUID", "SOPInstanceUID"):
        if not str(first.get(name, "")):
            raise InputError(
                f"The series in {folder} has no {name}, so that nothing can be said to belong to it; export it again "
                "from the archive as it is there."
            )
    for data in sources:
        for name in _MAY_BE_BLANK:
            if name not in data:
                setattr(data, name, "")
    shape, T = multiframe_grid(first, Path(files[0])) if len(sources) == 1 else _grid(sources, folder)
    return Study(sources, str(first.FrameOfReferenceUID), shape, T)


def _grid(sources: tuple[Any, ...], folder: Path) -> tuple[tuple[int, int, int], Array]:
    """Size and ``T_lps_voxel`` of single slices in order."""
    first, last = sources[0], sources[-1]
    x, y = np.array(first.ImageOrientationPatient, float).reshape(2, 3)
    start, end = (np.array(data.ImagePositionPatient, float) for data in (first, last))
    step = float(np.linalg.norm(end - start)) / (len(sources) - 1)
    row, column = (float(v) for v in first.PixelSpacing)
    R = np.column_stack([x, y, (end - start) / (step * (len(sources) - 1))])
    T = transform_of_voxels((column, row, step), R, start, str(folder))
    return (int(first.Columns), int(first.Rows), len(sources)), T
