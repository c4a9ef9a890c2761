"""Lens files of other programs: what each calls the models, and where each counts pixels from."""

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from ursnav_torch.camera.fit import fitted_radial
from ursnav_torch.camera.lens import Camera
from ursnav_torch.errors import InputError

#: A lens file is a page of text.
_MOST_BYTES = 1_000_000
#: OpenCV's names for what its samples write, in small letters.
_MATRIX = ("camera_matrix", "cameramatrix", "k", "m1", "intrinsics", "intrinsic_matrix")
_DISTORTION = ("distortion_coefficients", "distortion_coeffs", "dist_coeffs", "distcoeffs", "distortion", "d", "d1")
#: Skew that rounding leaves, of the focal length.
_SKEW = 1e-3
#: COLMAP's models: where f (or fx, fy), cx, cy stand, and which of k1, k2, p1, p2, k3, k4, k5, k6 follow.
_COLMAP = {
    "SIMPLE_PINHOLE": (1, "rational", ()), "PINHOLE": (2, "rational", ()),
    "SIMPLE_RADIAL": (1, "rational", (0,)), "RADIAL": (1, "rational", (0, 1)),
    "OPENCV": (2, "rational", (0, 1, 2, 3)), "FULL_OPENCV": (2, "rational", (0, 1, 2, 3, 4, 5, 6, 7)),
    "OPENCV_FISHEYE": (2, "equidistant", (0, 1, 2, 3)), "SIMPLE_RADIAL_FISHEYE": (1, "equidistant", (0,)),
    "RADIAL_FISHEYE": (1, "equidistant", (0, 1)), "FOV": (2, "fov", (0,)),
}  # fmt: skip


def foreign_lens(path: Path, name: str | None, model: str | None) -> Camera:
    """The lens in a file of another program.

    Raises:
        InputError: missing, damaged or of no kind that is known; several cameras and none chosen.
    """
    text = _text(path)
    if path.suffix.lower() == ".txt":
        return _ocam(text, path) if _is_ocam(text) else _colmap(text, path, name)
    if path.suffix.lower() == ".xml" or "opencv-matrix" in text or text.startswith("%YAML:1.0"):
        return _opencv(text, path, model)
    data = _one_document(text, path)
    if not isinstance(data, Mapping):
        raise InputError(f"The camera file {path} holds no camera; expected ROS camera_info, Kalibr or OpenCV YAML.")
    if "camera_matrix" in data:
        return _ros(data, path)
    if (K := data.get("K", data.get("k"))) is not None and "width" in data:  # a message of ROS 1 or 2
        names = {"image_width": "width", "image_height": "height"}
        D = data.get("D", data.get("d", []))
        more = {new: data.get(old) for new, old in names.items()} | {"camera_matrix": K, "distortion_coefficients": D}
        return _ros(dict(data) | more, path)
    return _kalibr(data, path, name)


def _one_document(text: str, path: Path) -> Any:
    """What a YAML text holds, and ``ros2 topic echo`` ends with ``---``, again and again perhaps."""
    try:
        found = [data for data in yaml.safe_load_all(text) if data is not None]
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError(f"The camera file {path} is not readable YAML: {str(error).splitlines()[0]}.") from None
    lenses = [{k: v for k, v in data.items() if k != "header"} if isinstance(data, dict) else data for data in found]
    if any(lens != lenses[0] for lens in lenses):
        raise InputError(f"The camera file {path} holds {len(found)} documents that differ; leave the scope's alone.")
    return found[0] if found else None


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InputError(
                f"The camera file {path} has {path.stat().st_size} bytes; a calibration is a page of text."
            )
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"There is no camera file {path}.") from None
    except (OSError, UnicodeDecodeError):
        raise InputError(f"The camera file {path} is no text in UTF-8; save it as such.") from None


def _numbers(value: Any, what: str, path: Path, count: int | None = None) -> list[float]:
    try:
        found = [float(v) for v in np.ravel(np.asarray(value, float))]
    except (TypeError, ValueError):
        found = [math.nan]
    if (count is not None and len(found) != count) or not all(map(math.isfinite, found)):
        said = value.tolist() if isinstance(value, np.ndarray) else value
        raise InputError(f"The camera file {path}: {what} is {said!r}; expected {count or 'some'} numbers.")
    return found


def _size(width: Any, height: Any, path: Path) -> tuple[int, int]:
    w, h = _numbers([width, height], "the picture's width and height", path, 2)
    if w != int(w) or h != int(h) or min(w, h) < 8:
        raise InputError(f"The camera file {path} says its pictures are {w:g} x {h:g} px; at least 8 x 8 are needed.")
    return int(w), int(h)


def _intrinsics(K: list[float], path: Path) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a camera matrix by rows.

    Raises:
        InputError: it stands by columns (MATLAB's), its pixels are skewed, or it is no camera matrix.
    """
    fx, skew, cx, below, fy, cy, *last = K
    if last[:2] != [0, 0] and (cx, cy) == (0, 0):
        raise InputError(f"The camera file {path}: its camera matrix stands by columns, as MATLAB's do; transpose it.")
    if below != 0 or last != [0, 0, 1]:
        raise InputError(f"The camera file {path}: {K} is no camera matrix; expected fx, 0, cx, 0, fy, cy, 0, 0, 1.")
    if abs(skew) > _SKEW * abs(fx):
        raise InputError(
            f"The camera file {path}: its pixels are skewed by {skew:g}, which is not understood; calibrate without."
        )
    return fx, fy, cx, cy


def _lens(model: str, size: tuple[int, int], f: tuple[float, ...], k: list[float], path: Path) -> Camera:
    """A lens of a model by its name in these files; ``f`` is fx, fy, cx, cy."""
    fx, fy, cx, cy = f
    if min(fx, fy) <= 0:
        raise InputError(f"The camera file {path} has the focal lengths {fx:g} and {fy:g} px: it was not calibrated.")
    if model in ("none", "") and any(k):
        raise InputError(
            f"The camera file {path} has the distortion coefficients {k} and names no model for them "
            "(plumb_bob, radtan, rational_polynomial, equidistant, ...): name it there."
        )
    if model in ("plumb_bob", "rational_polynomial", "radtan", "rational", "pinhole", "none", ""):
        if len(k) > 8 and any(k[8:]):
            raise InputError(
                f"The lens in {path} has {len(k)} distortion coefficients; thin prism and tilt are not understood. "
                "Calibrate without them (5 or 8 coefficients)."
            )
        k = (k + [0.0] * 8)[:8]
        return (
            Camera("rational", *size, fx, fy, cx, cy, tuple(k)) if any(k) else Camera("pinhole", *size, fx, fy, cx, cy)
        )
    if model in ("equidistant", "fisheye", "kannala_brandt"):
        if len(k) > 4:
            raise InputError(f"The lens in {path} is a fisheye with {len(k)} coefficients; expected up to four.")
        return Camera("equidistant", *size, fx, fy, cx, cy, tuple((k + [0.0] * 4)[:4]))
    if model == "fov":
        w = k[0]

        def radius(angle: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.arctan(2 * np.tan(np.minimum(angle, 1.55)) * math.tan(w / 2)) / w

        center = 2 * math.tan(w / 2) / w  # the radius's rise on the axis: ours is 1
        f0, rim = math.sqrt(fx * fy) * center, math.hypot(max(cx, size[0] - 1 - cx), max(cy, size[1] - 1 - cy))
        fitted = fitted_radial(lambda a: radius(a) / center, f0, rim, str(path))
        return Camera("equidistant", *size, fx * center, fy * center, cx, cy, fitted)
    raise InputError(
        f"The lens model {model!r} in {path} is not understood; known are plumb_bob (radtan), rational_polynomial, "
        "equidistant (fisheye), fov, double sphere (ds), omni without distortion, and OCamCalib."
    )


def _ros(data: Mapping[str, Any], path: Path) -> Camera:
    """camera_info as ROS's camera_calibration writes it."""
    size = _size(data.get("image_width"), data.get("image_height"), path)
    f = _intrinsics(_numbers(_entry(data["camera_matrix"]), "camera_matrix", path, 9), path)
    if "distortion_coefficients" not in data:
        _say_no_distortion(path, 4)
    k = _numbers(_entry(data.get("distortion_coefficients", [])), "distortion_coefficients", path)
    roi = data.get("roi") or {}
    part = [roi.get(c) or full for c, full in zip(("width", "height"), size, strict=True)] != list(size)
    if (
        part
        or any(roi.get(c) for c in ("x_offset", "y_offset"))
        or any((data.get(c) or 0) > 1 for c in ("binning_x", "binning_y"))
    ):
        raise InputError(
            f"The camera file {path} has a roi ({dict(roi)}) or binning ({data.get('binning_x', 0)} x "
            f"{data.get('binning_y', 0)}): take both out of it, and say the cut by camera.crop=[x,y,w,h] and "
            "camera.resize=[w,h]."
        )
    return _lens(str(data.get("distortion_model") or "none"), size, f, k, path)


def _say_no_distortion(path: Path, stacklevel: int) -> None:
    warnings.warn(f"{path} says nothing of distortion: it is taken for a lens without any.", stacklevel=stacklevel + 1)


def _entry(value: Any) -> Any:
    return value.get("data") if isinstance(value, Mapping) else value


def _kalibr(data: Mapping[str, Any], path: Path, name: str | None) -> Camera:
    """A camchain of Kalibr."""
    cameras = {str(k): v for k, v in data.items() if isinstance(v, Mapping) and "intrinsics" in v}
    if not cameras and "intrinsics" in data:
        cameras = {"cam0": data}
    camera = _chosen(cameras, path, name)
    model, distortion = str(camera.get("camera_model", "pinhole")), str(camera.get("distortion_model") or "none")
    resolution = _numbers(camera.get("resolution"), "resolution", path, 2)
    size, k = (
        _size(resolution[0], resolution[1], path),
        _numbers(camera.get("distortion_coeffs", []), "distortion_coeffs", path),
    )
    values = camera["intrinsics"]
    if model == "pinhole":
        fx, fy, cx, cy = _numbers(values, "intrinsics", path, 4)
        return _lens(distortion, size, (fx, fy, cx, cy), k, path)
    if any(k):
        raise InputError(f"The lens in {path} is {model} with distortion {distortion}, which is not understood.")
    if model == "ds":
        xi, alpha, fx, fy, cx, cy = _numbers(values, "intrinsics", path, 6)
        if not (0 <= alpha <= 1 and -1 < xi <= 1):
            raise InputError(
                f"The camera file {path}: a double sphere has xi between -1 and 1 and alpha between 0 and 1, got "
                f"{xi:g} and {alpha:g}; are they exchanged? Kalibr writes xi, alpha, fx, fy, cx, cy."
            )
        return _double_sphere(size, (fx, fy, cx, cy), xi, alpha)
    if model == "omni":
        xi, fx, fy, cx, cy = _numbers(values, "intrinsics", path, 5)
        return _double_sphere(size, (fx, fy, cx, cy), xi, 0.0)
    return _lens(model, size, (1.0, 1.0, 0.0, 0.0), k, path)


def _double_sphere(size: tuple[int, int], f: tuple[float, ...], xi: float, alpha: float) -> Camera:
    fx, fy, cx, cy = f
    return Camera("double_sphere", *size, fx, fy, cx, cy, (xi, alpha))


def _chosen(cameras: Mapping[str, Any], path: Path, name: str | None) -> Any:
    if not cameras:
        raise InputError(
            f"The camera file {path} holds no camera that is understood: expected ROS camera_info (camera_matrix), "
            "Kalibr (intrinsics), OpenCV FileStorage, COLMAP's cameras.txt or OCamCalib's calib_results.txt."
        )
    if name is None and len(cameras) > 1:
        raise InputError(f"{path} holds the cameras {', '.join(cameras)}; choose one with camera.name=.")
    if name is not None and name not in cameras:
        raise InputError(f"{path} has no camera {name!r}; it has {', '.join(cameras)}.")
    return cameras[name or next(iter(cameras))]


def _opencv(text: str, path: Path, model: str | None) -> Camera:
    """What OpenCV's FileStorage wrote, YAML or XML."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        nodes = {key.lower(): storage.getNode(key) for key in storage.root().keys()}
    except (cv2.error, SystemError):
        raise InputError(f"The camera file {path} is not readable as OpenCV's YAML or XML.") from None
    matrix = next((nodes[key].mat() for key in _MATRIX if key in nodes), None)
    if matrix is None or matrix.shape != (3, 3):
        raise InputError(
            f"The camera file {path} has no camera_matrix of 3 x 3; it has {', '.join(nodes) or 'nothing'}."
        )
    if "image_width" not in nodes or "image_height" not in nodes:
        raise InputError(f"The camera file {path} does not say its pictures' size; add image_width and image_height.")
    if "m1" in nodes and "m2" in nodes:
        raise InputError(f"{path} holds the two cameras M1 and M2; write the scope's alone to a file of its own.")
    size = _size(nodes["image_width"].real(), nodes["image_height"].real(), path)
    if not any(key in nodes for key in _DISTORTION):
        _say_no_distortion(path, 5)
    values = next((nodes[key].mat() for key in _DISTORTION if key in nodes), None)
    k = [] if values is None else _numbers(values, "distortion_coefficients", path)
    fisheye = "fisheye_model" in nodes and nodes["fisheye_model"].real() == 1
    if model is None and len(k) == 4 and any(k) and "fisheye_model" not in nodes:
        raise InputError(
            f"The camera file {path} has four distortion coefficients and does not say of which model: say "
            "camera.model=equidistant (cv::fisheye: k1,k2,k3,k4) or camera.model=plumb_bob (k1,k2,p1,p2)."
        )
    chosen = model or ("equidistant" if fisheye else "plumb_bob")
    return _lens(chosen, size, _intrinsics(_numbers(matrix, "camera_matrix", path, 9), path), k, path)


def _colmap(text: str, path: Path, name: str | None) -> Camera:
    """COLMAP's cameras.txt; its pixel centers lie at halves."""
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    cameras = {words[0]: words for words in lines if len(words) > 4 and words[1].isupper()}
    words = _chosen(cameras, path, name)
    if words[1] not in _COLMAP:
        raise InputError(f"The lens model {words[1]} in {path} is not understood; known are {', '.join(_COLMAP)}.")
    focals, model, places = _COLMAP[words[1]]
    size = _size(words[2], words[3], path)
    values = _numbers(words[4:], f"the parameters of {words[1]}", path, focals + 2 + len(places))
    f = (values[0], values[focals - 1], values[focals] - 0.5, values[focals + 1] - 0.5)
    k = [0.0] * (max(places) + 1 if places else 0)
    for place, value in zip(places, values[focals + 2 :], strict=True):
        k[place] = value
    return _lens(model, size, f, k, path)


def _is_ocam(text: str) -> bool:
    return "polynomial coefficients for the DIRECT mapping" in text


def _ocam(text: str, path: Path) -> Camera:
    """OCamCalib's calib_results.txt; rows come first, from 0."""
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(rows) < 5:
        raise InputError(f"The camera file {path} is cut off: it has {len(rows)} of the 5 lines of OCamCalib.")
    direct = _numbers(rows[0][1:], "the polynomial", path, int(_numbers(rows[0][:1], "its length", path, 1)[0]))
    cy, cx = _numbers(rows[2], "the center", path, 2)
    c, d, e = _numbers(rows[3], "the affine parameters", path, 3)
    height, width = _numbers(rows[4], "the picture's size", path, 2)
    if not direct or direct[0] >= 0:
        raise InputError(f"The camera file {path}: the polynomial begins with {direct[:1]}; expected a number below 0.")
    focal = -direct[0]
    k = (c, d, e, *(a * focal ** (n - 1) for n, a in enumerate(direct)))
    return Camera("ocam", *_size(width, height, path), focal, focal, cx, cy, k)
