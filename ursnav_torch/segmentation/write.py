"""The result of a segmentation as files: surface, label map, preview, calyces, landmarks."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.files import Progress, check_output, no_progress, whole_folder, write_csv, write_image
from ursnav_torch.geometry import apply
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.tables import write_calyces, write_centerline
from ursnav_torch.segmentation.load import CtKidney, SegmentationSettings, name_kidney, scan_lumen
from ursnav_torch.segmentation.markups import points_of, read_markups
from ursnav_torch.segmentation.preview import preview
from ursnav_torch.segmentation.scans import Scan, write_scan


@dataclass(frozen=True, slots=True)
class MarkedByHand:
    """What somebody marked beforehand; None where nobody did.

    Attributes:
        calyces, centerline: see `load_ct_kidney`.
        landmarks: 3D Slicer's .mrk.json with a point list, for `register`.
    """

    calyces: Path | str | None = None
    centerline: Path | str | None = None
    landmarks: Path | str | None = None


def segment_scan(
    out: Path,
    path: Path | str,
    settings: SegmentationSettings | None = None,
    marked: MarkedByHand | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Kidney:
    """Segment a scan as `load_ct_kidney` does and write what it gave into a folder, whole or not at all.

    The folder holds ``lumen.stl`` (its header says the frame as 3D Slicer reads it), ``labels.nii.gz`` (1 in the lumen,
    on the scan's own grid), ``preview.png``, ``calyces.csv``, ``centerline.csv``, ``segmentation.json``, and
    ``landmarks.csv`` where landmarks were marked.

    Args:
        out: the folder to write.
        path, progress: see `load_ct_kidney`.
        settings: what is taken, and how.
        marked: what was marked by hand.
        overwrite: whether ``out`` may be there already.

    Raises:
        InputError: ``out`` exists, or see `load_ct_kidney`.
    """
    settings, marked = settings or SegmentationSettings(), marked or MarkedByHand()
    check_output(out, overwrite)
    points = None if marked.landmarks is None else points_of(read_markups(marked.landmarks))
    if points is not None and not len(points[0]):
        raise InputError(f"{marked.landmarks} holds no point list; landmarks are placed as points in 3D Slicer.")
    found = scan_lumen(path, settings, progress)
    kidney = name_kidney(found, marked.calyces, marked.centerline)
    with whole_folder(out, overwrite) as work:
        _write_all(found, kidney, work, settings.frame)
        if points is not None:
            _write_landmarks(work / "landmarks.csv", points[0], apply(found.T_kidney_lps, points[1]))
    return kidney


def _write_all(found: CtKidney, kidney: Kidney, work: Path, frame: str) -> None:
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


def _write_landmarks(path: Path, names: tuple[str, ...], points: np.ndarray) -> None:
    """Landmarks as `register` wants them: the EM columns are blank, to be filled in by touching."""
    columns = ("name", "kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
    rows = [
        dict(zip(columns, (name, *point.tolist()), strict=False)) for name, point in zip(names, points, strict=True)
    ]
    write_csv(path, columns, rows)
