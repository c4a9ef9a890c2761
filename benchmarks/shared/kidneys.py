"""Kidneys with pictures of known pose, as `data/README.md` of the test data describes them, and their VIDs."""

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import load_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings, Settings, read_image
from ursnav_torch.kidney import load_mesh_kidney
from ursnav_torch.localization import learn_confidence
from ursnav_torch.rendering import HeadLight, Light, RaycastRenderer
from ursnav_torch.tables import read_csv
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid, poses_from_rows

STYLES = ("simulation", "phantom", "invivo")


@dataclass(frozen=True, slots=True)
class Still:
    """One picture of known pose.

    Attributes:
        kidney, style, name: where it is.
        image: uint8, blue green red.
        calyx: name of the true calyx.
        T_kidney_camera: (4, 4) true pose.
    """

    kidney: str
    style: str
    name: str
    image: NDArray[np.uint8]
    calyx: str
    T_kidney_camera: NDArray[np.float64]


def data_folder(given: str) -> Path:
    """The folder of kidneys: as given, else URSNAV_DATA.

    Raises:
        InputError: neither names a folder with kidneys.
    """
    folder = Path(given or os.environ.get("URSNAV_DATA", "")).expanduser()
    if not (given or os.environ.get("URSNAV_DATA")) or not list(folder.glob("*/lumen.stl")):
        raise InputError(
            f"No kidneys in {str(folder)!r}: give data=DIR (or set URSNAV_DATA), a folder with one folder a kidney "
            "that holds lumen.stl, calyces.csv, camera.json and pictures with truth.csv."
        )
    return folder


def kidneys_with(folder: Path, *styles: str) -> list[str]:
    """Names of the kidneys that have pictures of all these styles; other anatomy may lie beside them."""
    return sorted(
        p.parent.name
        for p in folder.glob("*/lumen.stl")
        if all((p.parent / style / "truth.csv").is_file() for style in styles)
    )


def stills(folder: Path, kidney: str, style: str) -> list[Still]:
    """All pictures of one style of one kidney."""
    path = folder / kidney / style / "truth.csv"
    rows = read_csv(path, ("image", "calyx"), "truth")
    poses = poses_from_rows(rows)
    return [
        Still(kidney, style, r["image"], read_image(path.parent / r["image"]), r["calyx"], T)
        for r, T in zip(rows, poses, strict=True)
    ]


def vid_of(
    folder: Path,
    kidney: str,
    work: Path,
    name: str = "default",
    *,
    settings: Settings | None = None,
    plan: PlanSettings | None = None,
    light: Light | None = None,
    calibrate: bool = True,
) -> Vid:
    """The VID of one kidney, labels given; built in ``work`` once and then kept there."""
    out = work / f"{kidney}_{name}"
    if (out / "vid.json").exists():
        return load_vid(out)
    make_renderer, plan = partial(RaycastRenderer, light=light or HeadLight()), plan or PlanSettings()
    base = folder / kidney
    return build_vid(
        load_mesh_kidney(base / "lumen.stl", calyces=base / "calyces.csv"),
        load_camera(base / "camera.json"),
        settings or DefaultSettings(),
        make_renderer,
        plan,
        out,
        learn=partial(learn_confidence, make_renderer=make_renderer, plan=plan) if calibrate else None,
    )
