"""Which files of a folder are the slices of one DICOM series, whole and in order."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError

Array = NDArray[np.float64]

_MODALITY, _DESCRIPTION, _SYNTAX = "0008|0060", "0008|103e", "0002|0010"
_POSITION, _ORIENTATION = "0020|0032", "0020|0037"
#: Transfer syntaxes whose pixels are stored as they are, so that a file's length tells whether it is whole.
_UNCOMPRESSED = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2", "")


@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    path: str
    size: tuple[int, ...]
    position: Array
    orientation: Array
    short: bool


def series_files(sitk: ModuleType, folder: Path, series: str | None, largest_voxels: int) -> tuple[str, ...]:
    """The slices of the one series in a folder, from the first to the last along its axis.

    Raises:
        InputError: no series, several and none chosen, or one that has gaps, double slices, slices of different
            sizes or directions, a tilted gantry, damaged files or too many voxels.
    """
    files = _files_of(sitk, folder, series)
    if len(files) < 3:
        raise InputError(f"The series in {folder} has {len(files)} slices; a scan has many. Copy the whole series.")
    slices = [_read_slice(sitk, file) for file in files]
    _check_alike(slices, folder)
    slices = _in_order(slices, folder)
    size = (*slices[0].size[:2], len(slices))
    voxels = int(np.prod(size, dtype=object))
    if voxels > largest_voxels:
        raise InputError(
            f"{folder} holds {voxels / 1e6:.0f} million voxels; at most {largest_voxels / 1e6:.0f} are read."
        )
    damaged = [Path(s.path).name for s in slices if s.short]
    if damaged:
        raise InputError(
            f"{len(damaged)} slices in {folder} are truncated, {damaged[0]} the first; copy the series again."
        )
    return tuple(s.path for s in slices)


def _files_of(sitk: ModuleType, folder: Path, series: str | None) -> tuple[str, ...]:
    reader = sitk.ImageSeriesReader
    found = {uid: reader.GetGDCMSeriesFileNames(str(folder), uid) for uid in reader.GetGDCMSeriesIDs(str(folder))}
    if not found:
        raise InputError(f"{folder} holds no DICOM series. Give the folder that directly contains the slices.")
    _check_damaged(folder, {name for names in found.values() for name in names})
    if series is not None and series not in found:
        raise InputError(f"{folder} has no series {series}; it has {_listed(sitk, found)}.")
    if series is None and len(found) > 1:
        raise InputError(
            f"{folder} holds {len(found)} series: {_listed(sitk, found)}. Choose one with kidney.series=UID."
        )
    return tuple(found[series or next(iter(found))])


def _check_damaged(folder: Path, readable: set[str]) -> None:
    """Refuse DICOM files that no series claims: truncated slices would be left out without a word."""
    for path in sorted(folder.iterdir()):
        if path.is_file() and path.name.upper() != "DICOMDIR" and str(path) not in readable:
            with path.open("rb") as file:
                if file.read(132)[128:] == b"DICM":
                    raise InputError(f"{path} is a damaged DICOM file, truncated perhaps; copy the series again.")


def _listed(sitk: ModuleType, found: dict[str, tuple[str, ...]]) -> str:
    texts = []
    for uid, files in found.items():
        tags = _tags(sitk, files[0])
        about = " ".join(filter(None, (_tag(tags, _MODALITY), repr(_tag(tags, _DESCRIPTION)))))
        texts.append(f"{uid} ({about}, {len(files)} slices)")
    return "; ".join(texts)


def _tags(sitk: ModuleType, file: str) -> Any:
    reader = sitk.ImageFileReader()
    reader.SetFileName(file)
    try:
        reader.ReadImageInformation()
    except RuntimeError:
        raise InputError(f"{file} is damaged or no DICOM slice; copy the series again.") from None
    return reader


def _tag(tags: Any, key: str) -> str:
    return str(tags.GetMetaData(key)).strip(" \0") if tags.HasMetaDataKey(key) else ""


def _read_slice(sitk: ModuleType, file: str) -> _Slice:
    tags = _tags(sitk, file)
    try:
        position = np.array(_tag(tags, _POSITION).split("\\"), float).reshape(3)
        orientation = np.array(_tag(tags, _ORIENTATION).split("\\"), float).reshape(2, 3)
    except ValueError:
        raise InputError(
            f"{file} does not say where its slice lies (ImagePositionPatient, ImageOrientationPatient); export the "
            "series again as CT slices."
        ) from None
    size = tags.GetSize()
    stored = 1 if tags.GetPixelID() in (sitk.sitkUInt8, sitk.sitkInt8) else 2
    whole = int(np.prod(size, dtype=object)) * stored
    short = _tag(tags, _SYNTAX) in _UNCOMPRESSED and Path(file).stat().st_size < whole
    return _Slice(file, tuple(size), position, orientation, short)


def _check_alike(slices: list[_Slice], folder: Path) -> None:
    sizes = Counter(s.size for s in slices)
    directions = Counter(tuple(np.round(s.orientation, 3).ravel().tolist()) for s in slices)
    if len(sizes) > 1 or len(directions) > 1:
        texts = ", ".join(f"{n} of {' x '.join(map(str, size[:2]))}" for size, n in sizes.most_common())
        raise InputError(
            f"{folder} mixes slices of {len(sizes)} sizes ({texts}) and {len(directions)} directions in one series, "
            "perhaps with a localizer or a reconstruction. Leave only the axial slices there."
        )


def _in_order(slices: list[_Slice], folder: Path) -> list[_Slice]:
    """Sorted along the normal, checked for gaps, doubles and tilt."""
    along = np.cross(*slices[0].orientation)
    slices = sorted(slices, key=lambda s: float(s.position @ along))
    at = np.array([s.position for s in slices])
    height = at @ along
    steps = np.diff(height)
    step = float(np.median(steps))
    if step <= 0 or steps.min() < 0.1 * step:
        raise InputError(
            f"{folder} has {int(np.sum(steps < max(0.1 * step, 1e-3)))} pairs of slices at the same place: several "
            "phases or reconstructions in one series. Leave only the slices of one there."
        )
    gaps = np.flatnonzero(np.abs(steps - step) > 0.05 * step + 0.02)
    if len(gaps):
        first = gaps[0]
        missing = int(np.sum(np.maximum(np.rint(steps[gaps] / step) - 1, 0)))
        raise InputError(
            f"{folder} lacks slices: {missing or 'some'} missing, the first after {Path(slices[first].path).name} at "
            f"{height[first]:.1f} mm, where the step is {steps[first]:.2f} mm in place of {step:.2f} mm. Copy the "
            "whole series again."
        )
    aside = at - at[0] - np.outer(height - height[0], along)
    if np.linalg.norm(aside, axis=1).max() > max(0.01 * (height[-1] - height[0]), 0.5):
        raise InputError(
            f"{folder} was scanned with a tilted gantry (its slices shift to the side); resample it to a straight grid."
        )
    return slices
