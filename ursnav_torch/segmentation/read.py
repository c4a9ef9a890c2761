"""Scans from files: NIfTI, NRRD and the like, or a folder of DICOM slices; checked before anything large is read."""

import gzip
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.segmentation.dicom import series_files
from ursnav_torch.segmentation.scan import Scan, transform_of_voxels

_FORMATS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
#: A scan of 512 x 512 x 600 has 157 million voxels; beyond this a file is not read.
LARGEST_VOXELS = 1_000_000_000


def read_scan_here(path: Path | str, series: str | None = None, largest_voxels: int = LARGEST_VOXELS) -> Scan:
    """What `read_scan` does, in this process, which a damaged file may kill.

    Args:
        path: file or folder.
        series: UID of the series to take where a folder holds several.
        largest_voxels: files that declare more are refused before memory is taken for them.

    Raises:
        InputError: missing, damaged, incomplete, too large, or not one scan in three dimensions.
        MissingExtraError: SimpleITK is not installed.
    """
    sitk = simple_itk()
    path = Path(path)
    if path.is_dir():
        return _read(sitk, series_files(sitk, path, series, largest_voxels), path.name)
    if not path.is_file():
        raise InputError(f"There is no scan {path}. Check kidney.path: a folder of DICOM slices, or a file.")
    if not path.name.lower().endswith(_FORMATS):
        raise InputError(
            f"{path} is no format of scans that can be read; accepted: {', '.join(_FORMATS)}, or the folder that "
            "holds the DICOM slices."
        )
    _check_file(sitk, path, largest_voxels)
    return _read(sitk, str(path), path.name)


def simple_itk() -> ModuleType:
    """SimpleITK, without its warnings on standard error.

    Raises:
        MissingExtraError: it is not installed.
    """
    sitk = import_extra("SimpleITK", "ct", "kidney=ct")
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    return sitk


def _check_file(sitk: ModuleType, path: Path, largest_voxels: int) -> None:
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise InputError(f"{path} cannot be read as a scan: {_reason(error)}. Export or copy it again.") from None
    size = reader.GetSize()
    if len([n for n in size if n > 1]) != 3 or reader.GetNumberOfComponents() != 1:
        raise InputError(
            f"{path} has the size {' x '.join(map(str, size))} with {reader.GetNumberOfComponents()} values a voxel; "
            "one scan in three dimensions is needed. Of a scan over time take one phase; of a segmentation with "
            "overlapping segments export one as a label map."
        )
    check_size(size, path, largest_voxels)
    if path.name.lower().endswith((".nii", ".nii.gz")):
        bits = 8 * sitk.Image(1, 1, reader.GetPixelID()).GetSizeOfPixelComponent()
        _check_length(path, int(np.prod(size, dtype=object)) * bits // 8)


def check_size(size: tuple[int, ...], path: Path, largest_voxels: int) -> None:
    """Refuse a declared size beyond the limit.

    Raises:
        InputError: too many voxels.
    """
    voxels = int(np.prod(size, dtype=object))
    if voxels > largest_voxels:
        raise InputError(
            f"{path} declares {' x '.join(map(str, size))} voxels, {voxels / 1e6:.0f} million; at most "
            f"{largest_voxels / 1e6:.0f} million are read. If it is really that large, crop it around the kidney."
        )


def _check_length(path: Path, data_bytes: int) -> None:
    """Refuse a NIfTI file that ends before its data do: its reader would fill the rest with anything."""
    short = InputError(f"{path} ends before its data do: it is truncated. Copy or export it again.")
    if path.suffix != ".gz":
        if path.stat().st_size < data_bytes:
            raise short
        return
    left = data_bytes
    try:
        with gzip.open(path) as file:
            while left > 0:
                chunk = file.read(min(left, 1 << 24))
                if not chunk:
                    raise short
                left -= len(chunk)
    except (EOFError, OSError, zlib.error):
        raise short from None


def _read(sitk: ModuleType, files: str | tuple[str, ...], source: str) -> Scan:
    try:
        image = sitk.ReadImage(files)
    except RuntimeError as error:
        raise InputError(f"{source} cannot be read as a scan: {_reason(error)}. Export or copy it again.") from None
    names = _label_names(image)
    T = transform_of_voxels(image.GetSpacing()[:3], _direction(image), image.GetOrigin()[:3], source)
    return Scan(_voxels(sitk, image), T, source, names)


def _direction(image: Any) -> NDArray[np.float64]:
    dimension = image.GetDimension()
    return np.reshape(image.GetDirection(), (dimension, dimension))[:3, :3]


def _voxels(sitk: ModuleType, image: Any) -> NDArray[np.int16]:
    """(X, Y, Z) in 16 bits; rounded where the file has fractions of Hounsfield units."""
    values = sitk.GetArrayViewFromImage(image)
    while values.ndim > 3:
        values = values[0]
    small = np.empty(values.shape, np.int16)
    for k, slice_ in enumerate(values):
        whole = np.rint(np.nan_to_num(slice_, nan=-1024.0)) if values.dtype.kind == "f" else slice_
        small[k] = whole if values.dtype == np.int16 else np.clip(whole, -32768, 32767)
    return small.transpose(2, 1, 0)


def _label_names(image: Any) -> dict[str, int]:
    """Names of the labels as 3D Slicer writes them into .seg.nrrd."""
    names: dict[str, int] = {}
    for key in image.GetMetaDataKeys():
        if key.startswith("Segment") and key.endswith("_LabelValue"):
            name = key.removesuffix("_LabelValue") + "_Name"
            if image.HasMetaDataKey(name):
                names[image.GetMetaData(name)] = int(image.GetMetaData(key))
    return names


def _reason(error: RuntimeError) -> str:
    lines = [line.strip() for line in str(error).splitlines() if "ERROR" in line or "[nrrd]" in line]
    return (lines[-1].rpartition("ERROR: ")[2] if lines else "unknown reason").rstrip(".")
