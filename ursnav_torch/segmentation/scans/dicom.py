"""Which files of a folder are the slices of one DICOM series, whole and in order; reports beside them are no slices."""

import warnings
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.segmentation.scans.slices import check_alike, in_order, read_slice, say_doubts

#: Item, and end of the sequence, of encapsulated pixels (DICOM PS3.5, annex A.4).
_ITEM, _END = b"\xfe\xff\x00\xe0", b"\xfe\xff\xdd\xe0"
_UNKNOWN_LENGTH = 0xFFFFFFFF
_DEFLATED = "1.2.840.10008.1.2.1.99"
#: A series of fewer slices is no scan.
_FEWEST_SLICES = 3


def is_dicom(path: Path) -> bool:
    """Whether a file has DICOM's mark behind its preamble."""
    with path.open("rb") as file:
        return file.read(132)[128:] == b"DICM"


def series_files(sitk: ModuleType, folder: Path, series: str | None, largest_voxels: int) -> tuple[str, ...]:
    """The slices of the one series in a folder, from the first to the last along its axis; or its one multi-frame file.

    Reports, presentation states and the like are passed over, and so, with a warning, are series of one or two pictures
    beside a scan.

    Raises:
        InputError: no series, several and none chosen, or one that has gaps, double slices, slices of different
            sizes or directions, a tilted gantry, damaged files or too many voxels.
    """
    files = _files_of(sitk, folder, series)
    if len(files) == 1 and _frames(read_tags(files[0])) >= _FEWEST_SLICES:
        return files
    if len(files) < _FEWEST_SLICES:
        raise InputError(f"The series in {folder} has {len(files)} slices; a scan has many. Copy the whole series.")
    slices = [read_slice(file, read_tags(file)) for file in files]
    check_alike(slices, folder)
    slices = in_order(slices, folder)
    say_doubts(slices, folder)
    voxels = int(np.prod(slices[0].size, dtype=object)) * len(slices)
    if voxels > largest_voxels:
        raise InputError(
            f"{folder} holds {voxels / 1e6:.0f} million voxels; at most {largest_voxels / 1e6:.0f} are read."
        )
    damaged = [Path(s.path).name for s in slices if not is_whole(s.path)]
    if damaged:
        raise InputError(
            f"{len(damaged)} slices in {folder} are truncated, {damaged[0]} the first; copy the series again."
        )
    return tuple(s.path for s in slices)


def read_tags(file: str | Path) -> Any:
    """The data set of a DICOM file without its pixels.

    Raises:
        InputError: it is damaged or no such file.
    """
    pydicom = import_extra("pydicom", "ct", "kidney=ct")
    try:
        with warnings.catch_warnings():  # values against the standard are the sender's affair
            warnings.simplefilter("ignore")
            return pydicom.dcmread(file, stop_before_pixels=True, force=True)
    except Exception:  # its parsers raise whatever a damaged file makes them stumble over
        raise InputError(f"{file} is damaged or no DICOM slice; copy the series again.") from None


def is_whole(file: str | Path) -> bool:
    """Whether a file's pixels go to their stated end: by their length, or by the mark behind compressed ones."""
    pydicom = import_extra("pydicom", "ct", "kidney=ct")
    path = Path(file)
    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tags = pydicom.dcmread(stream, stop_before_pixels=True, force=True)
        meta = getattr(tags, "file_meta", {})
        if meta.get("TransferSyntaxUID") == _DEFLATED:
            return True
        order = "little" if tags.original_encoding[1] is not False else "big"
        head = stream.read(8)
        if len(head) < 8:
            return False
        length = int.from_bytes(head[4:8], order)  # type: ignore[arg-type]
        if not tags.original_encoding[0]:  # an explicit type stands before the length
            length = int.from_bytes(stream.read(4), order)  # type: ignore[arg-type]
        if length != _UNKNOWN_LENGTH:
            left = path.stat().st_size - stream.tell()
            return left >= length >= _least_bytes(tags)
        return _has_end(stream)


def _least_bytes(tags: Any) -> int:
    pixels = int(tags.get("Rows", 0)) * int(tags.get("Columns", 0)) * _frames(tags)
    return pixels * int(tags.get("SamplesPerPixel", 1)) * int(tags.get("BitsAllocated", 16)) // 8


def _has_end(stream: BinaryIO) -> bool:
    """Whether the items of encapsulated pixels are followed by their end."""
    while True:
        head = stream.read(8)
        if head[:4] == _END:
            return True
        if len(head) < 8 or head[:4] != _ITEM:
            return False
        length = int.from_bytes(head[4:], "little")
        if len(stream.read(length)) < length:
            return False


def _frames(tags: Any) -> int:
    try:
        return max(int(tags.get("NumberOfFrames", 1) or 1), 1)
    except (TypeError, ValueError):
        return 1


def _files_of(sitk: ModuleType, folder: Path, series: str | None) -> tuple[str, ...]:
    reader = sitk.ImageSeriesReader
    found = {uid: reader.GetGDCMSeriesFileNames(str(folder), uid) for uid in reader.GetGDCMSeriesIDs(str(folder))}
    _check_damaged(folder, {name for names in found.values() for name in names})
    found = {uid: names for uid, names in found.items() if _has_pictures(names[0])}
    if not found:
        raise InputError(f"{folder} holds no DICOM series. Give the folder that directly contains the slices.")
    if series is not None and series not in found:
        raise InputError(f"{folder} has no series {series}; it has {_listed(found)}.")
    scans = {uid: names for uid, names in found.items() if _slices(names) >= _FEWEST_SLICES}
    if series is None and len(scans) == 1 and len(found) > 1:
        aside = {uid: names for uid, names in found.items() if uid not in scans}
        warnings.warn(f"{folder}: passed over beside the scan: {_listed(aside)}.", stacklevel=4)
        found = scans
    if series is None and len(found) > 1:
        raise InputError(f"{folder} holds {len(found)} series: {_listed(found)}. Choose one with kidney.series=UID.")
    return tuple(found[series or next(iter(found))])


def _has_pictures(file: str) -> bool:
    tags = read_tags(file)
    return "Rows" in tags and "Columns" in tags


def _slices(names: tuple[str, ...]) -> int:
    return len(names) if len(names) > 1 else _frames(read_tags(names[0]))


def _check_damaged(folder: Path, readable: set[str]) -> None:
    """Refuse slices that no series claims: truncated ones would be left out without a word.

    Reports, presentation states and other objects without rows of pixels are no slices.
    """
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.name.upper() == "DICOMDIR" or str(path) in readable or not is_dicom(path):
            continue
        tags = read_tags(path)
        if "SOPClassUID" not in tags or "Rows" in tags or str(tags.get("Modality", "")) in ("CT", "MR", "PT"):
            raise InputError(f"{path} is a damaged DICOM file, truncated perhaps; copy the series again.")


def _listed(found: dict[str, tuple[str, ...]]) -> str:
    texts = []
    for uid, files in found.items():
        tags = read_tags(files[0])
        about = f"{tags.get('Modality', '')} {str(tags.get('SeriesDescription', '')).strip()!r}".strip()
        texts.append(f"{uid} ({about}, {_slices(files)} slices)")
    return "; ".join(texts)
