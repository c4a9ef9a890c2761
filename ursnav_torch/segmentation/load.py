"""``kidney=ct``: from a scan to a kidney."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress, no_progress
from ursnav_torch.geometry import T_RAS_LPS, apply
from ursnav_torch.kidney.anatomy import Calyx, Kidney
from ursnav_torch.kidney.build import build_kidney
from ursnav_torch.kidney.checks import check_lumen
from ursnav_torch.kidney.tables import check_given, read_calyces
from ursnav_torch.segmentation.contrast import lumen_of_contrast
from ursnav_torch.segmentation.curves import with_curves
from ursnav_torch.segmentation.label_surface import lumen_surface
from ursnav_torch.segmentation.labels import label_counts, lumen_of_label
from ursnav_torch.segmentation.lumen import Lumen
from ursnav_torch.segmentation.markups import calyces_from_markups, curves_of, read_markups
from ursnav_torch.segmentation.scans import Scan, ScanHeader, read_scan

Array = NDArray[np.float64]

#: What to do where a scan turns out to be in another unit than mm, by that unit.
_UNIT_ADVICE = {"meters": "set kidney.header.unit=m", "centimeters": "set kidney.header.unit=cm"}


@dataclass(frozen=True, slots=True, eq=False)
class CtKidney:
    """What a scan gave.

    Attributes:
        scan: the whole scan.
        lumen: the segmented part of it.
        mesh: the lumen's checked surface in the kidney frame.
        T_kidney_lps: (4, 4) patient coordinates to the kidney frame: the identity, or RAS <- LPS.
    """

    scan: Scan
    lumen: Lumen
    mesh: trimesh.Trimesh
    T_kidney_lps: Array


@dataclass(frozen=True, slots=True, eq=False)
class SegmentationSettings:
    """What of a scan is taken, and how its surface is made.

    Attributes:
        series: UID of the DICOM series where the folder holds several.
        label: number or name of the lumen's label in a label map; None takes the only one there, and segments a CT.
        side: "left" or "right" of the patient, where both kidneys are to be seen.
        seed_mm: (3,) a point in the contrast, LPS; None finds it.
        threshold_hu: density above which contrast is grown; None tries from 240 HU on.
        frame: of the kidney: "lps" or "ras".
        faces: triangles of the surface, at most; more are kept where fewer would move it by more than 0.2 mm.
        header: spacing, orientation or unit where the file's own header lacks them or is wrong.
        calyces_unit: of the lengths in a CSV of calyces, where its columns do not say it, or say it wrong.
    """

    series: str | None = None
    label: int | str | None = None
    side: str | None = None
    seed_mm: ArrayLike | None = None
    threshold_hu: float | None = None
    frame: str = "lps"
    faces: int = 60_000
    header: ScanHeader | None = None
    calyces_unit: str | None = None

    def __post_init__(self) -> None:
        if self.side not in (None, "left", "right"):
            raise InputError(f"kidney.side is {self.side!r}; accepted are left, right and null.")
        if self.frame not in ("lps", "ras"):
            raise InputError(f"kidney.frame is {self.frame!r}; accepted are lps and ras.")
        if self.faces < 1000:
            raise InputError(f"kidney.faces is {self.faces}; at least 1000 triangles are needed to show calyces.")


def load_ct_kidney(
    path: Path | str,
    calyces: Path | str | None = None,
    centerline: Path | str | None = None,
    progress: Progress = no_progress,
    **settings: Any,
) -> Kidney:
    """A kidney from a CT urography or from a label map of one.

    The kidney frame is the patient's: LPS, or RAS where asked for; the head is at +z, so poles are named.

    Args:
        path: folder of DICOM slices, or NIfTI, NRRD, MetaImage.
        calyces: CSV as for `load_mesh_kidney` (kidney frame), or Slicer's .mrk.json; None finds and names them.
        centerline: Slicer's .mrk.json with a curve a calyx, from the pelvis to its tip; None finds it.
        progress: how far the search is.
        settings: those of `SegmentationSettings`.

    Raises:
        InputError: see `read_scan`, `lumen_of_label`, `lumen_of_contrast`, `check_lumen` and `build_kidney`.
        MissingExtraError: the extra ``ct`` is not installed.
    """
    chosen = SegmentationSettings(**settings)
    return name_kidney(scan_lumen(path, chosen, progress), calyces, centerline, chosen.calyces_unit)


def scan_lumen(
    path: Path | str, settings: SegmentationSettings | None = None, progress: Progress = no_progress
) -> CtKidney:
    """The first half of `load_ct_kidney`: the scan, its lumen and the checked surface."""
    s = settings or SegmentationSettings()
    with progress(1, "scans read") as advance:
        scan = read_scan(path, s.series, header=s.header)
        advance(1)
    counts = label_counts(scan)
    if s.label is not None and not counts:
        raise InputError(f"{scan.source} is a CT and no label map; leave out kidney.label, or give the label map.")
    if counts and (s.label is not None or len(counts) > 1):
        lumen = lumen_of_label(scan, counts, s.label, s.side)
    else:
        lumen = lumen_of_contrast(scan, s.side, s.seed_mm, s.threshold_hu, progress)
    T = np.eye(4) if s.frame == "lps" else T_RAS_LPS
    mesh = lumen_surface(lumen, s.faces)
    mesh.apply_transform(T)
    return CtKidney(scan, lumen, check_lumen(mesh, scan.source, 1.0, _UNIT_ADVICE), T)


def name_kidney(
    found: CtKidney,
    calyces: Path | str | None,
    centerline: Path | str | None = None,
    calyces_unit: str | None = None,
) -> Kidney:
    """The second half: calyces named or found, and the centerline."""
    given: tuple[Calyx, ...] | None = None
    pelvis: Array | None = None
    if calyces is not None and str(calyces).lower().endswith(".json"):
        given, pelvis = calyces_from_markups(read_markups(calyces), found.T_kidney_lps, str(calyces))
    elif calyces is not None:
        given, pelvis = read_calyces(calyces, calyces_unit)
    if given is not None and calyces_unit is None:
        check_given(given, found.mesh.bounds, str(calyces))
    kidney = build_kidney(found.mesh, found.scan.source, 1.0, given, pelvis, (0.0, 0.0, 1.0))
    if centerline is None:
        return kidney
    curves = [apply(found.T_kidney_lps, curve) for curve in curves_of(read_markups(centerline))]
    return with_curves(kidney, curves, str(centerline))
