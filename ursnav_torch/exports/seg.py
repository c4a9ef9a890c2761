"""DICOM segmentations (SEG): masks on the CT's own grid, in its frame of reference, beside the series they are of."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.exports.study import Study, highdicom
from ursnav_torch.files import whole_file
from ursnav_torch.geometry import Array, apply
from ursnav_torch.kidney.grid import fill
from ursnav_torch.vid.store import package_version

#: Who made the objects, as DICOM wants it said.
MANUFACTURER = "ursnav_torch"
#: Of a kidney DICOM would want to know the side, which nobody said.
BODY_PART = "ABDOMEN"
#: Far behind those that scanners give, so that none is used twice in a study.
SERIES_NUMBERS = {"lumen": 9101, "inspected": 9102, "fiducials": 9103, "pictures": 9104}
#: SNOMED's words that are nearest: value, scheme, meaning. What of it a segment is, its label says.
_CATEGORY, _TYPE = ("123037004", "SCT", "Anatomical Structure"), ("25990002", "SCT", "Renal pelvis")


@dataclass(frozen=True, slots=True, eq=False)
class LabeledMask:
    """One segment.

    Attributes:
        label: its name, for people.
        mask: (X, Y, Z) bool on the study's grid.
        color_rgb: 0 to 255 each, of its display.
    """

    label: str
    mask: NDArray[np.bool_]
    color_rgb: tuple[int, int, int] = (230, 200, 90)


def mask_of_mesh(mesh_lps: trimesh.Trimesh, study: Study) -> NDArray[np.bool_]:
    """(X, Y, Z) which voxels' centers lie inside a closed surface in LPS, mm.

    Raises:
        InputError: the surface lies outside the study's grid, in part or as a whole: it is of another patient, or its
            coordinates are not what they are said to be.
    """
    triangles = apply(np.linalg.inv(study.T_lps_voxel), mesh_lps.triangles.reshape(-1, 3)).reshape(-1, 3, 3)
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    if np.any(low < -0.5) or np.any(high > np.array(study.shape) - 0.5):
        box = " to ".join(str(np.round(corner, 1).tolist()) for corner in mesh_lps.bounds)
        raise InputError(
            f"The kidney does not lie within the scan: in LPS it goes from {box} mm. Is frame= right, and is scan= the "
            "series that it was segmented from?"
        )
    first = np.floor(low).astype(int) - 1
    inside = fill(triangles - first, np.ceil(high).astype(int) - first + 2)
    mask = np.zeros(study.shape, bool)
    start, end = np.maximum(first, 0), np.minimum(first + inside.shape, study.shape)
    there = tuple(slice(a, b) for a, b in zip(start, end, strict=True))
    mask[there] = inside[tuple(slice(a - f, b - f) for a, b, f in zip(start, end, first, strict=True))]
    return mask


def write_seg(path: Path, segments: Sequence[LabeledMask], study: Study, kind: str, overwrite: bool = True) -> None:
    """Write a binary DICOM SEG.

    Args:
        path: the file.
        segments: at least one, none empty.
        study: what they are segments of.
        kind: ``lumen`` or ``inspected``: its series.
        overwrite: replace what stands there.

    Raises:
        InputError: a segment is empty, or is on another grid.
        MissingExtraError: the extra ``dicom`` is not installed.
    """
    hd = highdicom()
    for segment in segments:
        if segment.mask.shape != study.shape:
            raise InputError(
                f"{segment.label!r} has {' x '.join(map(str, segment.mask.shape))} voxels, the scan "
                f"{' x '.join(map(str, study.shape))}; it is of another scan."
            )
        if not segment.mask.any():
            raise InputError(f"{segment.label!r} has no voxel, so that there is nothing to be written.")
    planes = np.stack([segment.mask.transpose(2, 1, 0) for segment in segments], axis=-1).astype(np.uint8)
    volume = hd.Volume(planes, _affine(study), "PATIENT", study.frame_of_reference,
                       channels={"SegmentNumber": list(range(1, len(segments) + 1))})  # fmt: skip
    data = hd.seg.Segmentation(
        source_images=study.sources,
        pixel_array=volume,
        segmentation_type="BINARY",
        segment_descriptions=[_description(hd, i + 1, segment) for i, segment in enumerate(segments)],
        series_description=f"ursnav {kind}",
        content_label=kind.upper(),
        **object_of(hd, kind),
    )
    save(data, path, overwrite)


def object_of(hd: Any, kind: str, number: int = 1, series: str = "") -> dict[str, Any]:
    """What every object says of itself: its UIDs, its number in its series, and which program made it."""
    return {
        "series_instance_uid": series or str(hd.UID()),
        "series_number": SERIES_NUMBERS[kind],
        "sop_instance_uid": str(hd.UID()),
        "instance_number": number,
        "manufacturer": MANUFACTURER,
        "manufacturer_model_name": MANUFACTURER,
        "software_versions": package_version(),
        "device_serial_number": "none",
    }


def save(data: Any, path: Path, overwrite: bool) -> None:
    """Write a data set as a DICOM file, whole or not at all."""
    with whole_file(path, overwrite) as partial:
        data.save_as(partial, enforce_file_format=True)


def _affine(study: Study) -> Array:
    """Indices (plane, row, column) to LPS, (4, 4)."""
    return study.T_lps_voxel[:, [2, 1, 0, 3]]


def _description(hd: Any, number: int, segment: LabeledMask) -> Any:
    coded = hd.sr.CodedConcept
    algorithm = hd.AlgorithmIdentificationSequence(
        name=MANUFACTURER,
        family=coded("123104", "DCM", "Morphological Operations"),
        version=package_version(),
    )
    return hd.seg.SegmentDescription(
        segment_number=number,
        segment_label=segment.label,
        segmented_property_category=coded(*_CATEGORY),
        segmented_property_type=coded(*_TYPE),
        algorithm_type="SEMIAUTOMATIC",
        algorithm_identification=algorithm,
        display_color=hd.color.CIELabColor.from_rgb(*segment.color_rgb),
    )
