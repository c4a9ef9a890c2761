"""The result of a segmentation as files: surface, label map, preview, calyces, landmarks."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ursnav_torch.columns import KNOWN_STONE_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress, check_output, no_progress, whole_folder, write_csv, write_image
from ursnav_torch.geometry import apply
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.tables import write_calyces, write_centerline
from ursnav_torch.segmentation.calcified import ScanStones, calcified_stones
from ursnav_torch.segmentation.labels import label_counts
from ursnav_torch.segmentation.load import CtKidney, SegmentationSettings, name_kidney, scan_lumen
from ursnav_torch.segmentation.markups import points_of, read_markups
from ursnav_torch.segmentation.preview import preview
from ursnav_torch.segmentation.scans import Scan, read_scan, write_scan


@dataclass(frozen=True, slots=True)
class BesideScan:
    """What there is beside a scan: what somebody marked, and the scan before contrast; None where there is none.

    Attributes:
        calyces, centerline: see `load_ct_kidney`.
        landmarks: 3D Slicer's .mrk.json with a point list, for `register`.
        unenhanced: scan of the same patient lying the same way, before contrast, in which stones are told.
    """

    calyces: Path | str | None = None
    centerline: Path | str | None = None
    landmarks: Path | str | None = None
    unenhanced: Path | str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SegmentedScan:
    """What `segment_scan` made: the kidney, and what the scan says of stones."""

    kidney: Kidney
    stones: ScanStones


def segment_scan(
    out: Path,
    path: Path | str,
    settings: SegmentationSettings | None = None,
    beside: BesideScan | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> SegmentedScan:
    """Segment a scan as `load_ct_kidney` does and write what it gave into a folder, whole or not at all.

    The folder holds ``lumen.stl`` (its header says the frame as 3D Slicer reads it), ``labels.nii.gz`` (1 in the lumen,
    on the scan's own grid), ``preview.png``, ``calyces.csv``, ``centerline.csv``, ``segmentation.json``, and
    ``landmarks.csv`` where landmarks were beside.

    Args:
        out: the folder to write.
        path, progress: see `load_ct_kidney`.
        settings: what is taken, and how.
        beside: what there is beside the scan.
        overwrite: whether ``out`` may be there already.

    Raises:
        InputError: ``out`` exists, or see `load_ct_kidney`.
    """
    settings, beside = settings or SegmentationSettings(), beside or BesideScan()
    check_output(out, overwrite)
    points = None if beside.landmarks is None else points_of(read_markups(beside.landmarks))
    if points is not None and not len(points[0]):
        raise InputError(f"{beside.landmarks} holds no point list; landmarks are placed as points in 3D Slicer.")
    plain = None if beside.unenhanced is None else read_scan(beside.unenhanced)
    if plain is not None and label_counts(plain):
        raise InputError(
            f"unenhanced={beside.unenhanced} is a label map; stones are told by density: give the CT before contrast."
        )
    found = scan_lumen(path, settings, progress)
    kidney = name_kidney(found, beside.calyces, beside.centerline, settings.calyces_unit)
    stones = calcified_stones(found, plain)
    with whole_folder(out, overwrite) as work:
        _write_all(found, kidney, work, settings.frame, stones.sentence)
        if stones.stones:
            _write_stones(work / "stones.csv", stones)
        if points is not None:
            _write_landmarks(work / "landmarks.csv", points[0], apply(found.T_kidney_lps, points[1]))
    return SegmentedScan(kidney, stones)


def _write_all(found: CtKidney, kidney: Kidney, work: Path, frame: str, of_stones: str) -> None:
    write_stl(work / "lumen.stl", kidney.mesh, frame)
    write_scan(_label_map(found), work / "labels.nii.gz")
    write_image(work / "preview.png", preview(found, kidney.calyces))
    write_calyces(work / "calyces.csv", kidney.calyces, kidney.pelvis_mm)
    write_centerline(work / "centerline.csv", kidney.centerline, [c.name for c in kidney.calyces])
    about: dict[str, Any] = {
        "source": found.scan.source,
        "frame": frame.upper(),
        "spacing_mm": np.round(found.scan.spacing_mm, 5).tolist(),
        **found.lumen.about,
        "surface_volume_ml": round(float(kidney.mesh.volume) / 1000, 3),
        "faces": len(kidney.mesh.faces),
        "stones": of_stones,
    }
    (work / "segmentation.json").write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def write_stl(path: Path, mesh: trimesh.Trimesh, frame: str) -> None:
    """Binary STL whose 80-byte header states the frame, ``SPACE=LPS`` or ``SPACE=RAS``, as 3D Slicer reads it."""
    data = bytearray(trimesh.exchange.stl.export_stl(mesh))
    data[:80] = f"ursnav_torch; SPACE={frame.upper()}".encode("ascii").ljust(80, b" ")
    path.write_bytes(data)


def _label_map(found: CtKidney) -> Scan:
    labels = np.zeros(found.scan.voxels.shape[::-1], np.uint8).transpose(2, 1, 0)
    labels[found.lumen.box] = found.lumen.mask
    return Scan(labels, found.scan.T_lps_voxel, found.scan.source)


def _write_stones(path: Path, found: ScanStones) -> None:
    """Known stones as `track` and `navigate` read them, named by size."""
    rows = [
        dict(zip(KNOWN_STONE_COLUMNS, (f"S{i}", *s.center_mm.round(3).tolist(), round(s.size_mm, 2)), strict=True))
        for i, s in enumerate(found.stones, start=1)
    ]
    write_csv(path, KNOWN_STONE_COLUMNS, rows)


def _write_landmarks(path: Path, names: tuple[str, ...], points: np.ndarray) -> None:
    """Landmarks as `register` wants them: the EM columns are blank, to be filled in by touching."""
    columns = ("name", "kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
    rows = [
        dict(zip(columns, (name, *point.tolist()), strict=False)) for name, point in zip(names, points, strict=True)
    ]
    write_csv(path, columns, rows)
