"""The slices of a DICOM series: of one scan, in order, without gaps; and what is said where they leave doubts."""

import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError

Array = NDArray[np.float64]

#: Slices are reconstructed from overlapping to with gaps: steps of these parts of their thickness.
_THICKNESS = 0.15, 1.6
#: What says where a slice lies: tags, and how many numbers each has.
_PLACE = {"ImagePositionPatient": 3, "ImageOrientationPatient": 6, "PixelSpacing": 2}
_WORDS = {
    "ImagePositionPatient": "where its slice lies", "ImageOrientationPatient": "how its slice lies",
    "PixelSpacing": "how large its pixels are", "RescaleSlope": "how its numbers are scaled",
}  # fmt: skip
#: Words for Hounsfield units: "unspecified" is what a CT without a word on them gets from some programs.
_HOUNSFIELD = ("", "HU", "US")
#: Directions are at right angles and of length 1 but for rounding.
_ROUNDED = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Slice:
    """What a slice says of itself.

    Attributes:
        path: its file. size: columns and rows.
        position: (3,) mm of its first pixel, LPS. orientation: (2, 3) directions of its rows and columns.
        spacing: (2,) mm. thickness: mm, or None.
        whose: patient, study and frame of reference, which are one in a scan. modality: CT, MR, ...
        has_units: whether it says how its numbers become Hounsfield units. unit: what it calls them, "" for nothing.
        uid: its own.
    """

    path: str
    size: tuple[int, ...]
    position: Array
    orientation: Array
    spacing: Array
    thickness: float | None
    whose: tuple[str, str, str]
    modality: str
    has_units: bool
    unit: str
    uid: str


def read_slice(file: str, tags: Any) -> Slice:
    """A file's slice, from its data set.

    Raises:
        InputError: it does not say where it lies or how large its pixels are.
    """
    position, orientation, spacing = (_stated(tags, name, count, file) for name, count in _PLACE.items())
    orientation = orientation.reshape(2, 3)
    if spacing.min() <= 0:
        raise InputError(f"{file} has pixels of {spacing.tolist()} mm (PixelSpacing); export the series again.")
    slope = float(_stated(tags, "RescaleSlope", 1, file)[0]) if "RescaleSlope" in tags else 1.0
    if slope == 0:
        raise InputError(f"{file} scales its numbers by {slope:g} (RescaleSlope); export the series again.")
    if np.abs(orientation @ orientation.T - np.eye(2)).max() > _ROUNDED:
        raise InputError(
            f"{file}: its rows and columns run along {orientation.tolist()}, which are not at right angles and of "
            "length 1 (ImageOrientationPatient); export the series again."
        )
    if tags.get("PhotometricInterpretation") == "MONOCHROME1":
        raise InputError(
            f"{file} shows high numbers dark (MONOCHROME1), which CT slices do not: is it a picture of a screen, or "
            "inverted? Export the series again as CT slices."
        )
    names = ("PatientID", "StudyInstanceUID", "FrameOfReferenceUID")
    try:
        thickness = float(tags.get("SliceThickness"))
    except (TypeError, ValueError):
        thickness = None
    return Slice(
        file,
        (int(tags.get("Columns", 0)), int(tags.get("Rows", 0))),
        position,
        orientation,
        spacing,
        thickness if thickness and np.isfinite(thickness) else None,
        tuple(str(tags.get(name, "")) for name in names),  # type: ignore[arg-type]
        str(tags.get("Modality", "")),
        "RescaleIntercept" in tags,
        str(tags.get("RescaleType", "") or "").strip().upper(),
        str(tags.get("SOPInstanceUID", "")),
    )


def _stated(tags: Any, name: str, count: int, file: str) -> Array:
    """The finite numbers of a tag.

    Raises:
        InputError: it is missing, or they are none.
    """
    try:
        found = np.array(tags[name].value, float).reshape(count)
    except (KeyError, TypeError, ValueError):
        found = np.full(count, np.nan)
    if not np.isfinite(found).all():
        raise InputError(
            f"{file} does not say {_WORDS[name]} ({name} is {tags.get(name, 'missing')}); export the series again as "
            "CT slices."
        )
    return found


def check_alike(slices: list[Slice], folder: Path) -> None:
    """Refuse slices that are not of one scan.

    Raises:
        InputError: they differ in size, direction, pixel size, patient, study or frame of reference.
    """
    sizes = Counter(s.size for s in slices)
    directions = Counter(_rounded(s) for s in slices)
    if len(sizes) > 1 or len(directions) > 1:
        texts = ", ".join(f"{n} of {' x '.join(map(str, size[:2]))}" for size, n in sizes.most_common())
        usual = sizes.most_common(1)[0][0], directions.most_common(1)[0][0]
        odd = next(s for s in slices if (s.size, _rounded(s)) != usual)
        raise InputError(
            f"{folder} mixes slices of {len(sizes)} sizes ({texts}) and {len(directions)} directions in one series, "
            f"perhaps with a localizer or a reconstruction ({Path(odd.path).name} is unlike most). Leave only the "
            "axial slices there."
        )
    other = next((s for s in slices if not np.allclose(s.spacing, slices[0].spacing, rtol=1e-3)), None)
    if other is not None:
        raise InputError(
            f"{folder} mixes pixel sizes: {slices[0].spacing.tolist()} mm in {Path(slices[0].path).name}, "
            f"{other.spacing.tolist()} mm in {Path(other.path).name}. Leave the slices of one reconstruction there."
        )
    for i, what in enumerate(("patients", "studies", "frames of reference")):
        found = sorted({s.whose[i] for s in slices})
        if len(found) > 1:
            raise InputError(
                f"{folder} mixes slices of {len(found)} {what} ({', '.join(map(repr, found[:3]))}) in one series. "
                "Leave those of one scan there, or export the series again."
            )


def _rounded(one: Slice) -> tuple[float, ...]:
    return tuple(np.round(one.orientation, 3).ravel().tolist())


def in_order(slices: list[Slice], folder: Path) -> list[Slice]:
    """Sorted along the normal.

    Raises:
        InputError: there are gaps, two slices at one place, or a tilt.
    """
    along = np.cross(*slices[0].orientation)
    slices = sorted(slices, key=lambda s: float(s.position @ along))
    at = np.array([s.position for s in slices])
    height = at @ along
    steps = np.diff(height)
    step = float(np.median(steps))
    if step <= 0 or steps.min() < 0.1 * step:
        same = np.flatnonzero(steps < max(0.1 * step, 1e-3))
        _check_copies([(slices[i], slices[i + 1]) for i in same], folder)
        raise InputError(
            f"{folder} has {len(same)} pairs of slices at the same place: several "
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


def _check_copies(pairs: list[tuple[Slice, Slice]], folder: Path) -> None:
    """Refuse slices that are there twice as such, by their own UID."""
    if pairs and all(a.uid == b.uid and a.uid for a, b in pairs):
        first, second = (Path(s.path).name for s in pairs[0])
        raise InputError(
            f"{folder} has {len(pairs)} slices twice, copies of one another ({first} and {second} the first; one "
            "SOPInstanceUID). Delete one of each."
        )


def say_doubts(slices: list[Slice], folder: Path) -> None:
    """Say what a scan in order leaves open: numbers that may be no Hounsfield units, a thickness unlike the step."""
    if slices[0].modality not in ("CT", "", "SEG"):
        warnings.warn(
            f"{folder} is {slices[0].modality}, not CT: what is lumen is told by Hounsfield units; give a label map.",
            stacklevel=4,
        )
    elif not all(s.has_units for s in slices):
        warnings.warn(
            f"{folder} does not say how its numbers become Hounsfield units (RescaleIntercept): they are taken for "
            "such. If air is near 0 in it and not near -1000, export it again.",
            stacklevel=4,
        )
    elif odd := next((s.unit for s in slices if s.unit not in _HOUNSFIELD), None):
        warnings.warn(
            f"{folder} calls its numbers {odd!r} (RescaleType), not HU: they are taken for Hounsfield units. If air is "
            "not near -1000 in it, export it again.",
            stacklevel=4,
        )
    step = float(np.linalg.norm(slices[-1].position - slices[0].position)) / (len(slices) - 1)
    thick = slices[0].thickness
    if thick is not None and not _THICKNESS[0] * thick <= step <= _THICKNESS[1] * thick:
        warnings.warn(
            f"{folder}: its slices are {thick:g} mm thick and {step:.3g} mm apart: are slices missing between them, or "
            "are their places in another unit?",
            stacklevel=4,
        )
