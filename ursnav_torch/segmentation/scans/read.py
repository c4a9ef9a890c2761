"""Scans from files: NIfTI, NRRD and the like, or DICOM; checked before anything large is read."""

import re
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.segmentation.scans.dicom import is_dicom, series_files
from ursnav_torch.segmentation.scans.headers import Said, ScanHeader, check_said, voxel_geometry
from ursnav_torch.segmentation.scans.meta_data import check_meta_data
from ursnav_torch.segmentation.scans.multiframe import is_multiframe, read_multiframe
from ursnav_torch.segmentation.scans.nifti import check_nifti_length, check_nifti_packing, nifti_said
from ursnav_torch.segmentation.scans.scan import Scan, transform_of_voxels
from ursnav_torch.segmentation.scans.text_headers import meta_said, nrrd_said

_FORMATS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
#: A scan of 512 x 512 x 600 has 157 million voxels; beyond this a file is not read.
LARGEST_VOXELS = 1_000_000_000
#: DICOM says spacing, orientation and unit, or it is refused before it comes here.
_DICOM_SAID = Said(True, True, 1.0)


def read_scan_here(
    path: Path | str,
    series: str | None = None,
    largest_voxels: int = LARGEST_VOXELS,
    header: ScanHeader | None = None,
) -> Scan:
    """What `read_scan` does, in this process, which a damaged file may kill.

    Args:
        path: file or folder.
        series: UID of the series to take where a folder holds several.
        largest_voxels: files that declare more are refused before memory is taken for them.
        header: the user's word on the geometry, in place of the file's.

    Raises:
        InputError: missing, damaged, incomplete, too large, not one scan in three dimensions, or its header does not
            say the geometry and ``header`` does not, either.
        MissingExtraError: SimpleITK is not installed.
    """
    sitk, path, header = simple_itk(), Path(path), header or ScanHeader()
    if path.is_dir():
        files = series_files(sitk, path, series, largest_voxels)
        if len(files) == 1:
            return read_multiframe(sitk, Path(files[0]), largest_voxels)
        return _read(sitk, files, path.name, _DICOM_SAID, header)
    if not path.is_file():
        raise InputError(f"There is no scan {path}. Check kidney.path: a folder of DICOM slices, or a file.")
    if path.name.lower().endswith(_FORMATS):
        _check_name(path)
        said = _said(path)
        check_said(said, header, str(path))
        _check_file(sitk, path, largest_voxels)
        _check_data(path)
        for note in said.notes:
            warnings.warn(f"{note}.", stacklevel=2)
        return _read(sitk, str(path), path.name, said, header)
    if is_dicom(path) and is_multiframe(path):
        return read_multiframe(sitk, path, largest_voxels)
    if path.name.upper() == "DICOMDIR":
        raise InputError(f"{path} is the list of a disc's files; give the folder that holds the slices of the series.")
    if is_dicom(path):
        raise InputError(f"{path} is a single DICOM slice; give the folder that holds all slices of the series.")
    raise InputError(
        f"{path} is no format of scans that can be read; accepted: {', '.join(_FORMATS)}, a DICOM file with many "
        "slices, or the folder that holds the DICOM slices."
    )


def dicom_files_here(folder: Path, series: str | None = None) -> tuple[str, ...]:
    """The files of the one DICOM series in a folder, from the first slice to the last, checked as `read_scan` does.

    Raises:
        InputError: see `series_files`.
        MissingExtraError: SimpleITK is not installed.
    """
    return series_files(simple_itk(), folder, series, LARGEST_VOXELS)


def simple_itk() -> ModuleType:
    """SimpleITK, without its warnings on standard error.

    Raises:
        MissingExtraError: it is not installed.
    """
    sitk = import_extra("SimpleITK", "ct", "kidney=ct")
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    return sitk


def _check_name(path: Path) -> None:
    """Refuse a packed NIfTI whose name its reader does not take for one."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    if packed and path.suffix.lower() == ".nii":
        raise InputError(f"{path} is packed by gzip, which its name does not say: rename it to {path.name}.gz.")


def _said(path: Path) -> Said:
    if _is_nifti(path):
        return nifti_said(path)
    return nrrd_said(path) if path.suffix.lower() in (".nrrd", ".nhdr") else meta_said(path)


def _is_nifti(path: Path) -> bool:
    return path.name.lower().endswith((".nii", ".nii.gz"))


def _check_data(path: Path) -> None:
    """Refuse data that are not whole, of formats whose readers would fill in the rest (NRRD's own does not)."""
    if _is_nifti(path):
        check_nifti_length(path)
    elif path.suffix.lower() in (".mha", ".mhd"):
        check_meta_data(path)


def _check_file(sitk: ModuleType, path: Path, largest_voxels: int) -> None:
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        if _is_nifti(path):
            check_nifti_packing(path)  # its reader does not say why
        raise InputError(f"{path} cannot be read as a scan: {_reason(error)}. Export or copy it again.") from None
    size = reader.GetSize()
    if len([n for n in size if n > 1]) != 3 or reader.GetNumberOfComponents() != 1:
        raise InputError(
            f"{path} has the size {' x '.join(map(str, size))} with {reader.GetNumberOfComponents()} values a voxel; "
            "one scan in three dimensions is needed. Of a scan over time take one phase; of a segmentation with "
            "overlapping segments export one as a label map."
        )
    check_size(size, path, largest_voxels)


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


def _read(sitk: ModuleType, files: str | tuple[str, ...], source: str, said: Said, header: ScanHeader) -> Scan:
    try:
        image = sitk.ReadImage(files)
    except RuntimeError as error:
        raise InputError(f"{source} cannot be read as a scan: {_reason(error)}. Export or copy it again.") from None
    names = _label_names(image, source)
    spacing, direction, origin = voxel_geometry(
        np.array(image.GetSpacing()[:3]), _direction(image), np.array(image.GetOrigin()[:3]), said, header
    )
    voxels = _voxels(sitk, image, source, said.added)
    return Scan(voxels, transform_of_voxels(spacing, direction, origin, source), source, names)


def _direction(image: Any) -> NDArray[np.float64]:
    dimension = image.GetDimension()
    return np.reshape(image.GetDirection(), (dimension, dimension))[:3, :3]


def _voxels(sitk: ModuleType, image: Any, source: str, added: float) -> NDArray[np.int16]:
    """(X, Y, Z) in 16 bits; rounded where the file has fractions of Hounsfield units."""
    values = sitk.GetArrayViewFromImage(image)
    while values.ndim > 3:
        values = values[0]
    if added:
        values = values.astype(np.float64) - added
    _check_shares(values, source)
    _say_beyond(values, source)
    return small_voxels(values)


def small_voxels(values: NDArray[Any]) -> NDArray[np.int16]:
    """(X, Y, Z) in 16 bits of slices (Z, Y, X)."""
    small = np.empty(values.shape, np.int16)
    for k, slice_ in enumerate(values):
        whole = np.rint(np.nan_to_num(slice_, nan=-1024.0)) if values.dtype.kind == "f" else slice_
        small[k] = whole if values.dtype == np.int16 else np.clip(whole, -32768, 32767)
    return small.transpose(2, 1, 0)


def _say_beyond(values: NDArray[Any], source: str) -> None:
    """Say numbers that 16 bits do not hold, and voxels that are no numbers."""
    if values.dtype.kind == "f" and (none := int(np.isnan(values).sum())):
        warnings.warn(f"{source}: {none} voxels are no numbers (NaN); they are taken for air.", stacklevel=2)
    low, high = np.nanmin(values), np.nanmax(values)
    if low < -32768 or high > 32767:
        warnings.warn(
            f"{source} holds numbers from {low:g} to {high:g}; CT numbers and labels lie within -32768 and 32767, and "
            "what is beyond is set to these. Is it scaled otherwise?",
            stacklevel=2,
        )


def _check_shares(values: NDArray[Any], source: str) -> None:
    """Refuse a map of probabilities: rounding it would be a threshold that nobody chose."""
    if values.dtype.kind != "f" or not (np.nanmin(values) >= 0 and np.nanmax(values) <= 1):
        return
    if any(np.any((plane > 0.01) & (plane < 0.99)) for plane in values):
        raise InputError(
            f"{source} holds fractions from 0 to 1, a map of probabilities and no label map: apply a threshold (such "
            "as 0.5) in the program that made it, and export whole labels."
        )


def _label_names(image: Any, source: str) -> dict[str, int]:
    """Names of the labels as 3D Slicer writes them into .seg.nrrd."""
    names: dict[str, int] = {}
    for key in image.GetMetaDataKeys():
        if key.startswith("Segment") and key.endswith("_LabelValue"):
            name = key.removesuffix("_LabelValue") + "_Name"
            if image.HasMetaDataKey(name):
                names[image.GetMetaData(name)] = _label(image.GetMetaData(key), key, source)
    return names


def _label(text: str, key: str, source: str) -> int:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if value != round(value, 0) or not 0 <= value < 1 << 15:
        raise InputError(f"{source}: {key} is {text!r}, expected a whole number; save the segmentation again.")
    return int(value)


def _reason(error: RuntimeError) -> str:
    lines = [line.strip() for line in str(error).splitlines() if "ERROR" in line or "[nrrd]" in line]
    text = lines[-1].rpartition("ERROR: ")[2] if lines else "unknown reason"
    return re.sub(r"\w+\(0x[0-9a-f]+\): |\[nrrd\] \w+: ", "", text).rstrip(".")
