"""Lenses from files: camera JSON, ROS and Kalibr YAML, OpenCV YAML and XML, COLMAP and OCamCalib text."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ursnav_torch.camera.formats import foreign_lens
from ursnav_torch.camera.lens import KEYS, Camera, mask_text
from ursnav_torch.camera.sense import check_sense
from ursnav_torch.errors import InputError
from ursnav_torch.files import is_file
from ursnav_torch.records import read_json, to_record

#: Calibrations of MATLAB, numpy and COLMAP that are no text.
_OTHERS_FILES = (".mat", ".npz", ".npy", ".bin", ".pkl", ".h5")
#: No lens has a number beyond this, px or radians; larger ones overflow what is computed from them.
_LARGEST = 1_000_000_000
#: Where OpenCV's word for a matrix stands, if it does, bytes.
_MOST_BYTES = 100_000
#: What others call the distortion, or what no model here has: passing it over would draw another lens.
_OTHERS_WORDS = ("distortion", "distortion_coefficients", "distortion_coeffs", "dist_coeffs", "dist_coeff", "dist", "D",
                 "d", "skew", "p1", "p2", "k1", "k2", "k3", "xi", "alpha")  # fmt: skip


def load_camera(
    path: str | Path,
    crop: Sequence[int] | None = None,
    resize: Sequence[int] | None = None,
    name: str | int | None = None,
    model: str | None = None,
    fov_deg: float | None = None,
) -> Camera:
    """Read a lens: camera JSON (`Camera`'s fields; ``mask`` names a PNG beside it), or a file of another program.

    Args:
        path: JSON; ROS camera_info, Kalibr or OpenCV YAML; OpenCV XML; COLMAP's cameras.txt or OCamCalib's
            calib_results.txt.
        crop: [x, y, w, h] of the pictures in the calibrated one, px.
        resize: [w, h] that pictures were scaled to, after the crop.
        name: which camera, where a file holds several.
        model: ``plumb_bob`` or ``equidistant`` where a file does not say what its four coefficients are.
        fov_deg: full angle of the image circle, where the file does not say it; farther out the lens need not be one.

    Raises:
        InputError: missing, damaged, of no kind that is known, or no lens that can be (see `check_sense`).
    """
    path = Path(path)
    if path.suffix.lower() in (".yaml", ".yml", ".xml", ".txt") or _is_opencv(path):
        lens = foreign_lens(path, None if name is None else str(name), model)
    else:
        if path.suffix.lower() in _OTHERS_FILES:
            raise InputError(
                f"The camera file {path} is of a kind that is not read; write the lens as camera JSON, as YAML (ROS, "
                "Kalibr, OpenCV), XML (OpenCV) or text (COLMAP's cameras.txt, OCamCalib's calib_results.txt)."
            )
        data = read_json(path, "camera")
        lens = camera_from_dict(_with_mask(data, path), str(path))
    if fov_deg is not None:
        lens = replace(lens, fov_deg=float(fov_deg))
    check_sense(lens, str(path))
    if crop is not None:
        lens = lens.cropped(*_whole_numbers(crop, 4, "camera.crop=[x,y,w,h]"))
    return lens if resize is None else lens.resized(*_whole_numbers(resize, 2, "camera.resize=[w,h]"))


def camera_from_dict(data: Mapping[str, Any], where: str) -> Camera:
    """A `Camera` from the camera JSON's plain data; ``where`` names its origin in errors.

    Raises:
        InputError: a key is missing or of the wrong kind, or there is no such lens.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"{where} does not hold a camera: expected an object with {', '.join(KEYS)}.")
    missing = [key for key in KEYS if key not in data]
    if missing:
        raise InputError(f"The camera in {where} lacks {', '.join(missing)}; needed are {', '.join(KEYS)}.")
    if ignored := [key for key in _OTHERS_WORDS if np.any(np.ravel(np.asarray(data.get(key) or 0, object)) != 0)]:
        raise InputError(
            f"The camera in {where} has {', '.join(ignored)}, which camera JSON has not: write distortion as k (see "
            "the model's coefficients; model=rational takes k1, k2, p1, p2, k3, k4, k5, k6)."
        )
    for key, value in data.items():
        if any(isinstance(v, int) and abs(v) > _LARGEST for v in (value if isinstance(value, list) else [value])):
            raise InputError(f"The camera in {where} has a {key} beyond {_LARGEST:.0e}, which no lens has.")
    known = {key: _whole(value) for key, value in data.items() if value is not None}
    if known.get("model") == "pinhole" and not known.get("k"):
        known.pop("k", None)
    return to_record(known, Camera, f"The camera in {where}")


def _is_opencv(path: Path) -> bool:
    """Whether a JSON file is one that OpenCV's FileStorage wrote."""
    return path.suffix.lower() == ".json" and is_file(path) and b'"opencv-matrix"' in path.read_bytes()[:_MOST_BYTES]


def _with_mask(data: Any, path: Path) -> Any:
    """The data with the mask's own bytes in place of its file's name."""
    mask = data.get("mask") if isinstance(data, Mapping) else None
    if not isinstance(mask, str) or mask.startswith("data:"):
        return data
    file = path.parent / mask
    image = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_GRAYSCALE) if is_file(file) else None
    if image is None:
        raise InputError(f"The camera in {path} names the mask {mask!r}; there is no such picture beside it ({file}).")
    return {**data, "mask": mask_text(image > 127)}


def _whole_numbers(values: Sequence[int], count: int, what: str) -> list[int]:
    if len(values) != count or any(v != int(v) for v in values):
        raise InputError(f"{what} takes {count} whole numbers in px, got {list(values)}.")
    return [int(v) for v in values]


def _whole(value: Any) -> Any:
    """250 for 250.0: some calibration tools write every number as a float."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
