"""Enhanced multi-frame DICOM: all slices of a scan in one file, each with its own place (PS3.3, A.38 and C.7.6.16)."""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation.scans.dicom import is_whole, read_tags
from ursnav_torch.segmentation.scans.scan import Scan, transform_of_voxels

Array = NDArray[np.float64]

#: Frames may lie off an even, straight stack by this share of the step between them.
_UNEVEN = 0.05


def is_multiframe(path: Path) -> bool:
    """Whether a DICOM file holds several frames with a place each."""
    tags = read_tags(path)
    return "PerFrameFunctionalGroupsSequence" in tags and int(tags.get("NumberOfFrames", 1)) > 1


def read_multiframe(sitk: ModuleType, path: Path, largest_voxels: int) -> Scan:
    """The scan in an enhanced multi-frame CT file.

    Raises:
        InputError: it is damaged or too large, says no place, or its frames are no even stack of slices (several
            phases, say).
    """
    tags = read_tags(path)
    frames, rows, columns = (int(tags.get(name, 0)) for name in ("NumberOfFrames", "Rows", "Columns"))
    if frames * rows * columns > largest_voxels:
        raise InputError(f"{path} declares {columns} x {rows} x {frames} voxels; at most {largest_voxels} are read.")
    if not is_whole(path):
        raise InputError(f"{path} ends before its data do: it is truncated. Copy or export it again.")
    groups = _frame_groups(tags, path)
    T, order = _grid(groups, path)
    try:
        image = sitk.ReadImage(str(path))
    except RuntimeError:
        raise InputError(f"{path} cannot be read: its pixels are damaged or of an unknown compression.") from None
    values = sitk.GetArrayFromImage(image).reshape(frames, rows, columns)
    slope, intercept = _rescale(groups)
    own = _rescale(groups[:1])  # what the reader applied to all frames
    values = ((values - own[1][0]) / own[0][0] * slope[:, None, None] + intercept[:, None, None])[order]
    whole = np.clip(np.rint(values), -32768, 32767).astype(np.int16)
    return Scan(whole.transpose(2, 1, 0), T, path.name)


def multiframe_grid(tags: Any, path: Path) -> tuple[tuple[int, int, int], Array]:
    """Voxels along x, y, z and ``T_lps_voxel`` (4, 4) of a multi-frame file, from its tags.

    Raises:
        InputError: it says no place, or its frames are no even stack.
    """
    T, _ = _grid(_frame_groups(tags, path), path)
    return (int(tags.Columns), int(tags.Rows), int(tags.NumberOfFrames)), T


def _grid(groups: list[dict[str, Any]], path: Path) -> tuple[Array, NDArray[np.int64]]:
    """``T_lps_voxel`` (4, 4), and the frames' order along it."""
    position, direction, spacing = _geometry(groups, path)
    order, step = _stack(position, direction[:, 2], path)
    return transform_of_voxels((*spacing, step), direction, position[order[0]], path.name), order


def _frame_groups(tags: Any, path: Path) -> list[dict[str, Any]]:
    """Of every frame, its functional groups: the shared ones, and its own in front of them."""
    try:
        shared = tags.SharedFunctionalGroupsSequence[0] if "SharedFunctionalGroupsSequence" in tags else {}
        own = tags.PerFrameFunctionalGroupsSequence
        names = ("PlanePositionSequence", "PlaneOrientationSequence", "PixelMeasuresSequence",
                 "PixelValueTransformationSequence")  # fmt: skip
        return [{name: (frame.get(name) or shared.get(name) or [None])[0] for name in names} for frame in own]
    except (AttributeError, IndexError, TypeError):
        raise InputError(f"{path} says nothing of its frames' places; export the scan as single CT slices.") from None


def _geometry(groups: list[dict[str, Any]], path: Path) -> tuple[Array, Array, Array]:
    """Positions (N, 3), direction cosines (3, 3) and distances of columns and rows (2,), LPS, mm."""
    try:
        position = np.array([g["PlanePositionSequence"].ImagePositionPatient for g in groups], float)
        axes = np.array([g["PlaneOrientationSequence"].ImageOrientationPatient for g in groups], float)
        spacing = np.array([g["PixelMeasuresSequence"].PixelSpacing for g in groups], float)
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            f"{path} does not say where its frames lie or how large their pixels are; export the scan as single CT "
            "slices."
        ) from None
    if np.ptp(axes, axis=0).max() > 1e-3 or np.ptp(spacing, axis=0).max() > 1e-3:
        raise InputError(f"{path} mixes frames of several directions or pixel sizes; export one reconstruction alone.")
    x, y = axes[0].reshape(2, 3)
    return position, np.column_stack([x, y, np.cross(x, y)]), spacing[0][::-1]


def _stack(position: Array, along: Array, path: Path) -> tuple[NDArray[np.int64], float]:
    """The frames' order along the normal, and the step between them."""
    height = position @ along
    order = np.argsort(height, kind="stable")
    steps = np.diff(height[order])
    step = float(np.median(steps))
    if step <= 0 or steps.min() < 0.1 * step:
        raise InputError(
            f"{path} has several frames at the same place (phases or reconstructions in one file); export one alone."
        )
    aside = position[order] - position[order[0]] - np.outer(height[order] - height[order[0]], along)
    if np.abs(steps - step).max() > _UNEVEN * step + 0.02 or np.linalg.norm(aside, axis=1).max() > 0.5:
        raise InputError(f"{path} is no even, straight stack: frames are missing or shifted. Export it again.")
    return order, step


def _rescale(groups: list[dict[str, Any]]) -> tuple[Array, Array]:
    found = [g["PixelValueTransformationSequence"] for g in groups]
    slope = np.array([1.0 if f is None else float(f.RescaleSlope) for f in found])
    return slope, np.array([0.0 if f is None else float(f.RescaleIntercept) for f in found])
