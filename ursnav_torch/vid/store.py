"""A VID on disk: plain files that any tool can read; `vid.json` says what they are and proves they are whole."""

import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ursnav_torch.camera import camera_from_dict
from ursnav_torch.columns import POSE_COLUMNS, VIEW_COLUMNS
from ursnav_torch.errors import InputError, UrsnavError
from ursnav_torch.features import settings_from_dict, settings_to_dict
from ursnav_torch.files import write_csv
from ursnav_torch.geometry import quaternion_from_transform, transform_from_quaternion
from ursnav_torch.inputs import MOST_TEXT_BYTES, read_regular
from ursnav_torch.kidney import Kidney, read_calyces, read_centerline, write_calyces, write_centerline
from ursnav_torch.records import read_json
from ursnav_torch.tables import Row, number, read_csv
from ursnav_torch.vid.base import Vid, image_name
from ursnav_torch.vid.draw import check_features, load_features, save_features
from ursnav_torch.vid.lumen_file import load_lumen, save_lumen
from ursnav_torch.vid.screen import load_screen, save_screen

#: Another format has features that are no longer comparable, or lacks what a VID holds now.
FORMAT = 3
_FEATURES = "features.safetensors"
_FILES = ("kidney.stl", "calyces.csv", "centerline.csv", "lumen.safetensors", "views.csv", _FEATURES)
#: Checksums of the pictures, as ``sha256sum -c`` reads them: under `vid.json`'s own, and each checked when it is read.
_PICTURES = "images.sha256"
#: What a large VID holds besides: then features are proven view by view, and not as a whole when it is opened.
_SCREEN = "screen.safetensors"


def save_vid(vid: Vid, folder: Path) -> None:
    """Write everything but the pictures of ``vid``, which lie there, into ``folder``, `vid.json` last."""
    calyces = [c.name for c in vid.kidney.calyces]
    vid.kidney.mesh.export(folder / "kidney.stl")
    write_calyces(folder / "calyces.csv", vid.kidney.calyces, vid.kidney.pelvis_mm)
    write_centerline(folder / "centerline.csv", vid.kidney.centerline, calyces)
    write_csv(folder / "views.csv", VIEW_COLUMNS, view_rows(vid))
    save_features(folder / _FEATURES, vid.features)
    save_lumen(folder / "lumen.safetensors", vid.lumen)
    if vid.screen is not None:
        save_screen(folder / _SCREEN, vid)
    names = [f"images/{image_name(view)}" for view in range(len(vid))]
    (folder / _PICTURES).write_text("".join(f"{_sha256(folder / name)}  {name}\n" for name in names), encoding="utf-8")
    write_description(folder, describe(vid))


def describe(vid: Vid) -> dict[str, Any]:
    """What `vid.json` says, before the files' checksums."""
    return {
        "format": FORMAT,
        "package_version": package_version(),
        "views": len(vid),
        "camera": vid.camera.to_dict(),
        "kidney": {"source": vid.kidney.source, "scale": vid.kidney.scale},
        "features": settings_to_dict(vid.settings),
        "calibration": vid.calibration,
    }


def write_description(folder: Path, description: dict[str, Any]) -> None:
    """Write `vid.json` with the sha256 of every file and of its own content.

    The features' is checked at every start, too: 0.5 GB/s or more, a fraction of what reading them takes. Not so those
    of a screened VID, see `vid.screen`.
    """
    names = [*_FILES, *(name for name in (_PICTURES, _SCREEN) if (folder / name).exists())]
    description = description | {"sha256": {name: _sha256(folder / name) for name in names}}
    description["checksum"] = _checksum(description)
    text = json.dumps(description, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "vid.json").write_text(text + "\n", encoding="utf-8")


def load_vid(path: str | Path) -> Vid:
    """Open a VID folder, proven whole by its checksums; features are memory-mapped, pictures proven when they are read.

    Raises:
        InputError: not a VID, half-written, changed after it was built, or of another format version.
    """
    folder = Path(path)
    description = _read_description(folder)
    kidney = _load_kidney(folder, description)
    camera = camera_from_dict(description["camera"], f"{folder / 'vid.json'}")
    screen = None
    if _SCREEN in description["sha256"]:
        screen, T, calyx = load_screen(folder / _SCREEN)
    else:
        rows = read_csv(folder / "views.csv", VIEW_COLUMNS, "views")
        T, calyx = poses_from_rows(rows), _calyx_of_rows(rows, kidney, folder / "views.csv")
    settings = settings_from_dict(description["features"])
    features = load_features(folder / _FEATURES)
    check_features(features, len(T), settings.points, f"{folder / _FEATURES}")
    lumen = load_lumen(folder / "lumen.safetensors", kidney)
    sums = _picture_sums(folder / _PICTURES, len(T)) if _PICTURES in description["sha256"] else ()
    learned = description.get("calibration")
    return Vid(kidney, camera, settings, T, calyx, features, folder, lumen, learned, sums, screen)


def view_rows(vid: Vid) -> list[dict[str, Any]]:
    """Rows of `views.csv`."""
    poses = pose_cells(vid.T_kidney_camera)
    return [
        {"view": i, "calyx": vid.calyx_name(int(c)), **pose}
        for i, (c, pose) in enumerate(zip(vid.calyx, poses, strict=True))
    ]


def pose_cells(T: np.ndarray) -> list[dict[str, float]]:
    """The seven pose columns of transforms (N, 4, 4)."""
    values = np.concatenate([T[:, :3, 3], quaternion_from_transform(T)], axis=1)
    return [dict(zip(POSE_COLUMNS, row, strict=True)) for row in values.tolist()]


def poses_from_rows(rows: Sequence[Row]) -> np.ndarray:
    """Transforms (N, 4, 4) from CSV rows with the seven pose columns.

    Raises:
        InputError: a cell is not a number; the message names its line.
    """
    values = np.array([[number(row, c) for c in POSE_COLUMNS] for row in rows])
    return transform_from_quaternion(values[:, :3], values[:, 3:])


def package_version() -> str:
    """The installed version, "0" in a bare checkout."""
    try:
        return version("ursnav-torch")
    except PackageNotFoundError:
        return "0"


def _read_description(folder: Path) -> dict[str, Any]:
    if not folder.exists():
        raise InputError(
            f"There is no VID folder {folder}; build one with python -m ursnav_torch.build_vid out={folder}."
        )
    path = folder / "vid.json"
    if folder.name.endswith(".partial") or (folder.is_dir() and not path.exists()):
        raise InputError(
            f"{folder} is not a finished VID (it has no vid.json): call build_vid again as before, and it goes on "
            "from where it stopped."
        )
    try:
        description = read_json(path, "VID's description")
    except InputError as error:
        raise InputError(f"{path} is not the description of a VID: {error} Build the VID again.") from None
    try:
        format_, files = description["format"], description["sha256"]
        whole = isinstance(files, dict) and description["checksum"] == _checksum(description)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path} is not the description of a VID: its format, sha256 or checksum is missing. Build the VID again."
        ) from None
    if format_ != FORMAT:
        raise InputError(f"{folder} has VID format {format_}, this version reads {FORMAT}; build it again.")
    if not whole:
        raise InputError(
            f"{path} was changed after the VID was built, so it no longer fits its features; build it again."
        )
    for name in [*_FILES, *(name for name in (_PICTURES, _SCREEN) if name in files)]:
        if not (folder / name).exists():
            raise InputError(f"The VID {folder} lacks {name}; copy it again or build it again.")
        if name == _FEATURES and _SCREEN in files:
            continue
        if _sha256(folder / name) != files.get(name):
            raise InputError(f"{folder / name} was changed after the VID was built; build the VID again.")
    return dict(description)


def _picture_sums(path: Path, views: int) -> tuple[str, ...]:
    """The sha256 of every view's picture, by number."""
    lines = read_regular(path, "list of checksums", MOST_TEXT_BYTES).decode("ascii", "replace").splitlines()
    found = [line.partition("  ") for line in lines]
    if [name for _, _, name in found] != [f"images/{image_name(view)}" for view in range(views)]:
        raise InputError(f"{path} does not list the pictures of {views} views, in order; build the VID again.")
    return tuple(digest for digest, _, _ in found)


def _calyx_of_rows(rows: list[Row], kidney: Kidney, path: Path) -> np.ndarray:
    """(V,) index of each view's calyx, -1 for none."""
    index = {c.name: i for i, c in enumerate(kidney.calyces)} | {"": -1}
    unknown = sorted({row["calyx"] for row in rows} - set(index))
    if unknown:
        raise InputError(
            f"{path} names the calyces {', '.join(unknown)}; the kidney's are "
            f"{', '.join(name for name in index if name)}. Build the VID again."
        )
    return np.array([index[row["calyx"]] for row in rows], np.int64)


def _load_kidney(folder: Path, description: dict[str, Any]) -> Kidney:
    calyces, pelvis = read_calyces(folder / "calyces.csv")
    try:
        mesh = trimesh.load_mesh(folder / "kidney.stl")
        centerline = read_centerline(folder / "centerline.csv", [c.name for c in calyces])
    except (ValueError, KeyError, IndexError) as error:
        if isinstance(error, UrsnavError):
            raise
        raise InputError(f"The kidney of the VID {folder} cannot be read: {error}.") from None
    if pelvis is None:
        pelvis = centerline.points_mm[0]
    try:
        scale, source = float(description["kidney"]["scale"]), str(description["kidney"]["source"])
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{folder / 'vid.json'} does not describe its kidney (scale, a number, and source); build the VID again."
        ) from None
    return Kidney(mesh, calyces, centerline, pelvis, scale, source)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _checksum(description: dict[str, Any]) -> str:
    content = {key: value for key, value in description.items() if key != "checksum"}
    return hashlib.sha256(json.dumps(content, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
