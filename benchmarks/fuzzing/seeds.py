"""Good files of every kind, made from the phantom, and the bad ones that were found before."""

import json
import os
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import trimesh

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.columns import EM_COLUMNS, LANDMARK_COLUMNS, MATCH_COLUMNS, TRACK_COLUMNS, TRUTH_COLUMNS
from ursnav_torch.devices import Frame, Note, Stamp
from ursnav_torch.devices.igtl.messages import Message, pack_message
from ursnav_torch.devices.trackers.ndi import NdiTool, pack_bx
from ursnav_torch.exports import LabeledMask, read_study, write_seg
from ursnav_torch.features import DefaultSettings
from ursnav_torch.files import write_csv, write_json
from ursnav_torch.kidney import make_phantom_kidney, write_calyces, write_centerline
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.segmentation import Scan, write_dicom
from ursnav_torch.session import Recorder
from ursnav_torch.vid import PlanSettings, build_vid, export_thesis, make_screen, pose_cells
from ursnav_torch.vid.screen import save_screen

#: Larger files of the corpus are left out: they only slow things down.
_LARGEST = 1 << 18


def make_seeds(folder: Path) -> None:
    """Fill a folder: files for readers of files, folders for readers of folders, ``*.wire`` for parsers of bytes."""
    kidney, lens = make_phantom_kidney(0, calyces=6), equidistant_camera(160.0, 32, 32)
    plan = PlanSettings(views_per_calyx=2, passage_views=2)
    vid = build_vid(kidney, lens, DefaultSettings(), RaycastRenderer, plan, folder / "vid", workers=1)
    export_thesis(vid, folder / "views")
    shutil.copy(folder / "vid" / "features.safetensors", folder / "features.safetensors")
    save_screen(folder / "screen.safetensors", replace(vid, screen=make_screen(vid.features, 4)))
    write_calyces(folder / "calyces.csv", kidney.calyces, kidney.pelvis_mm)
    write_centerline(folder / "centerline.csv", kidney.centerline, [c.name for c in kidney.calyces])
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=20.0)
    for ending in ("stl", "ply", "obj", "glb"):
        mesh.export(folder / f"mesh.{ending}")
    mesh.export(folder / "ascii.stl", file_type="stl_ascii")
    mesh.export(folder / "ascii.ply", encoding="ascii")
    _write_tables(folder, pose_cells(vid.T_kidney_camera))
    write_json(folder / "camera.json", lens.to_dict())
    write_json(folder / "registration.json", {"R": np.eye(3).tolist(), "t_mm": [1.0, 2.0, 3.0], "fre_mm": [0.1, 0.2]})
    point = {"label": "A", "position": [1.0, 2.0, 3.0], "positionStatus": "defined"}
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": [point, point]}
    write_json(folder / "points.mrk.json", {"markups": [markup, markup | {"type": "Curve"}]})
    _write_pictures(folder)
    _write_session(folder / "session")
    _write_scans(folder)
    _write_wire(folder)
    _copy_corpus(folder)


def _write_tables(folder: Path, poses: list[dict[str, float]]) -> None:
    n = range(6)
    write_csv(folder / "em.csv", ("frame", "t_s", *EM_COLUMNS), [
        {"frame": i, "t_s": i / 10, **dict(zip(EM_COLUMNS, (i, 2.0, 3.0, 0.0, 0.0, 1.0), strict=True))} for i in n
    ])  # fmt: skip
    write_csv(folder / "landmarks.csv", LANDMARK_COLUMNS, [
        dict(zip(LANDMARK_COLUMNS, (i, i * i, 1.0, i + 1, i * i, 2.0), strict=False)) for i in n
    ])  # fmt: skip
    write_csv(folder / "truth.csv", TRUTH_COLUMNS, [{"image": f"{i}.png", "calyx": "A"} | poses[i] for i in n])
    write_csv(folder / "matches.csv", MATCH_COLUMNS, [
        {"image": f"{i}.png", "calyx": "A", "view": i, "confidence": 0.9, "accepted": True} | poses[i] for i in n
    ])  # fmt: skip
    write_csv(folder / "track.csv", TRACK_COLUMNS, [
        {"frame": i, "t_s": i / 10, "calyx": "A", "state": "tracking"} | poses[i] for i in n
    ])  # fmt: skip
    fields = {"ProbeToTrackerTransform": "1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1", "ProbeToTrackerTransformStatus": "OK"}
    lines = [f"Seq_Frame{i:04d}_{k} = {v}\n" for i in n for k, v in (fields | {"Timestamp": str(i / 10)}).items()]
    (folder / "sequence.mha").write_text("NDims = 3\n" + "".join(lines) + "ElementDataFile = LOCAL\n")
    (folder / "script.csv").write_text("t_s,insertion,light_step,arm\n0,0.5,1,1\n1,0,0,0\n")


def _write_pictures(folder: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    for ending in (".png", ".jpg", ".bmp", ".tif"):
        (folder / f"picture{ending}").write_bytes(cv2.imencode(ending, image)[1].tobytes())
    (folder / "deep.png").write_bytes(cv2.imencode(".png", image.astype(np.uint16) * 250)[1].tobytes())
    (folder / "float.tiff").write_bytes(cv2.imencode(".tiff", image[..., 0].astype(np.float32))[1].tobytes())
    video = cv2.VideoWriter(str(folder / "video.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (32, 24))
    for _ in range(5):
        video.write(image)
    video.release()


def _write_session(folder: Path) -> None:
    image = np.zeros((16, 16), np.uint8)
    with Recorder(folder) as record:
        for i in range(3):
            record.write(Frame(Stamp(i, float(i), float(i)), image, None, "png", "x"))
            record.write(Note(Stamp(i, i + 0.5, i + 0.5), "info", "note"))


def _write_scans(folder: Path) -> None:
    try:
        import SimpleITK as sitk  # noqa: N813
    except ImportError:
        return
    scan = sitk.GetImageFromArray(np.random.default_rng(0).integers(-1000, 1000, (8, 9, 10)).astype(np.int16))
    scan.SetSpacing((0.7, 0.7, 1.0))
    for name in ("scan.nii", "scan.nii.gz", "scan.nrrd", "scan.mha"):
        sitk.WriteImage(scan, str(folder / name))
    _write_dicom(folder)


def _write_dicom(folder: Path) -> None:
    """A series of slices, and a segmentation of it."""
    scan = Scan(np.zeros((12, 10, 5), np.int16), np.eye(4), "scan")
    write_dicom(scan, folder / "series")
    try:
        import highdicom  # noqa: F401
    except ImportError:
        return
    mask = np.zeros((12, 10, 5), bool)
    mask[3:8, 2:7, 1:4] = True
    write_seg(folder / "lumen.seg.dcm", [LabeledMask("Lumen", mask)], read_study(folder / "series"), "lumen")


def _write_wire(folder: Path) -> None:
    content = np.eye(4)[:3].T.astype(">f4").tobytes()
    igtl = pack_message(Message("TRANSFORM", "tip", content, 1.0))
    seen = NdiTool(1, (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0), 0.1, 7)
    bx = pack_bx([seen, NdiTool(2, None, None, 0.0, 8)])
    parts = {"igtl": igtl, "igtl_body": igtl[58:], "transform": content, "ndi": bx, "ndi_body": bx[6:-2]}
    parts |= {"igtl_head": igtl[:58], "position": content[:28], "ints": struct.pack("<III3i", 0, 0, 3, 1, 2, 3)}
    parts["rosserial"] = bytes([0xFF, 0xFE, 0x02, 0x00, 0xFD, 0x0A, 0x00, 0x01, 0x02, 0xF2])
    for name, data in parts.items():
        (folder / f"{name}.wire").write_bytes(data)
    (folder / "line.wire").write_bytes(json.dumps({"kind": "note", "stamp": [0, 1.0, 2.0], "text": "x"}).encode())


def _copy_corpus(folder: Path) -> None:
    """Files that broke something before; ``URSNAV_CASES`` names the folder that holds ``fuzz/``."""
    cases = Path(os.environ.get("URSNAV_CASES", "")) / "fuzz"
    for path in sorted(cases.iterdir()) if "URSNAV_CASES" in os.environ and cases.is_dir() else ():
        if path.is_file() and path.stat().st_size <= _LARGEST:
            shutil.copy(path, folder / f"known_{path.name}")
