"""Lens models: pinhole and equidistant fisheye, pixels <-> rays.

Pixel centers lie at whole numbers: the center of the top-left pixel is (0, 0). Camera axes are OpenCV's
(x right, y down, z forward). The fisheye is OpenCV's (Kannala-Brandt):
``r = f * theta * (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.records import read_json, to_record

MODELS = ("equidistant", "pinhole")


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated lens.

    Args:
        model: ``equidistant`` (fisheye, may see more than 180 degrees) or ``pinhole``.
        width, height: image size in px.
        fx, fy, cx, cy: focal lengths and principal point in px.
        k: k1..k4 of the equidistant model; must be zero for a pinhole.
        fov_deg: full angle of the image circle; rays beyond half of it are outside the picture.
            Without it the whole sensor counts.

    Raises:
        InputError: a value is out of range.
    """

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    fov_deg: float | None = None

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"Unknown lens model {self.model!r}; known are {', '.join(MODELS)}.")
        if self.width < 8 or self.height < 8:
            raise InputError(f"The image size is {self.width} x {self.height} px; at least 8 x 8 is needed.")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.k)
        if len(self.k) != 4 or not all(math.isfinite(v) for v in numbers) or min(self.fx, self.fy) <= 0:
            raise InputError(
                f"The lens needs finite fx, fy > 0, cx, cy and four k; got fx={self.fx}, fy={self.fy}, "
                f"cx={self.cx}, cy={self.cy}, k={list(self.k)}."
            )
        if self.model == "pinhole" and any(self.k):
            raise InputError("A pinhole lens takes no k: undistort the images first, or use model=equidistant.")
        limit = 180.0 if self.model == "pinhole" else 360.0
        if self.fov_deg is not None and not 0 < self.fov_deg < limit:
            raise InputError(f"fov_deg={self.fov_deg} must lie between 0 and {limit:g} for {self.model}.")

    def project(self, points_camera: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Pixels (..., 2) of camera-frame points (..., 3), and which of them lie inside the picture (...)."""
        p = np.asarray(points_camera, float)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        r = np.hypot(x, y)
        theta = np.arctan2(r, z)
        if self.model == "pinhole":
            ok = z > 1e-9
            scale = 1 / np.where(ok, z, 1.0)
        else:
            ok = (r > 0) | (z > 0)
            scale = self._distort(theta) / np.maximum(r, 1e-12)  # on the axis x and y are nothing, too
        pixels = np.empty((*x.shape, 2))
        u, v = pixels[..., 0], pixels[..., 1]
        u[...], v[...] = self.fx * x * scale + self.cx, self.fy * y * scale + self.cy
        inside = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        return pixels, ok & inside & (theta <= self._theta_max())

    def rays(self, pixels: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Unit viewing directions (..., 3) in the camera frame of pixels (..., 2), and which are in the picture."""
        q = np.asarray(pixels, float)
        x, y = (q[..., 0] - self.cx) / self.fx, (q[..., 1] - self.cy) / self.fy
        r = np.hypot(x, y)
        theta = np.arctan(r) if self.model == "pinhole" else self._undistort(r)
        sin_by_r = np.where(r > 1e-12, np.sin(theta) / np.where(r > 1e-12, r, 1.0), 1.0)
        directions = np.stack([x * sin_by_r, y * sin_by_r, np.cos(theta)], axis=-1)
        u, v = q[..., 0], q[..., 1]
        inside = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        return directions, inside & (theta <= self._theta_max())

    def pixel_rays(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Directions (H, W, 3) of every pixel and the round or full picture mask (H, W)."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.rays(np.stack([u, v], axis=-1))

    def resized(self, width: int, height: int) -> "Camera":
        """The same lens on a picture resized to ``width`` x ``height`` px."""
        sx, sy = width / self.width, height / self.height
        return Camera(
            self.model, width, height, self.fx * sx, self.fy * sy,
            (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5, self.k, self.fov_deg,
        )  # fmt: skip

    def same_lens(self, other: "Camera", tolerance_px: float = 0.5) -> bool:
        """Whether both lenses have the same size and put every ray within ``tolerance_px``."""
        if (self.width, self.height) != (other.width, other.height):
            return False
        theta = np.linspace(0, min(self._theta_max(), other._theta_max(), math.radians(89)), 16)
        for phi in np.linspace(0, 2 * np.pi, 8, endpoint=False):
            ray = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
            a, inside_a = self.project(ray)
            b, inside_b = other.project(ray)
            both = inside_a & inside_b
            if np.any(np.abs(a - b)[both] > tolerance_px):
                return False
        return True

    def to_dict(self) -> dict[str, Any]:
        """Plain data in the camera JSON's words."""
        data: dict[str, Any] = {name: getattr(self, name) for name in _KEYS}
        return data | {"k": list(self.k)} | ({} if self.fov_deg is None else {"fov_deg": self.fov_deg})

    def _theta_max(self) -> float:
        return math.pi if self.fov_deg is None else math.radians(self.fov_deg) / 2 + 1e-9

    def _distort(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        if not any(self.k):
            return theta
        t2 = theta * theta
        k1, k2, k3, k4 = self.k
        return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))

    def _undistort(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        if not any(self.k):
            return np.minimum(r, math.pi)
        theta = np.clip(r, 0, math.pi)
        k1, k2, k3, k4 = self.k
        for _ in range(12):  # Newton; the polynomial is monotonic over any usable field of view
            t2 = theta * theta
            slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
            theta = np.clip(theta - (self._distort(theta) - r) / np.where(slope > 0.05, slope, 0.05), 0, math.pi)
        return theta


_KEYS = ("model", "width", "height", "fx", "fy", "cx", "cy")


def equidistant_camera(fov_deg: float = 160.0, width: int = 250, height: int = 250, across: str = "width") -> Camera:
    """An ideal fisheye whose field of view ``fov_deg`` spans the image's ``across`` (``width`` or ``diagonal``)."""
    f = _extent(width, height, across) / math.radians(fov_deg)
    return Camera("equidistant", width, height, f, f, (width - 1) / 2, (height - 1) / 2, fov_deg=fov_deg)


def pinhole_camera(fov_deg: float = 90.0, width: int = 250, height: int = 250, across: str = "width") -> Camera:
    """An ideal pinhole whose field of view ``fov_deg`` spans the image's ``across`` (``width`` or ``diagonal``).

    Raises:
        InputError: 180 degrees or more, which no pinhole can see.
    """
    if not 0 < fov_deg < 180:
        raise InputError(f"fov_deg={fov_deg} is beyond a pinhole (0 to 180 degrees); use camera=equidistant.")
    f = _extent(width, height, across) / 2 / math.tan(math.radians(fov_deg) / 2)
    return Camera("pinhole", width, height, f, f, (width - 1) / 2, (height - 1) / 2)


def load_camera(path: str | Path) -> Camera:
    """Read a camera JSON (model, width, height, fx, fy, cx, cy, optional k and fov_deg; others are passed over).

    Raises:
        InputError: missing, not JSON, or a key is missing or of the wrong kind.
    """
    return camera_from_dict(read_json(Path(path), "camera"), str(path))


def camera_from_dict(data: Mapping[str, Any], where: str) -> Camera:
    """A `Camera` from the camera JSON's plain data; ``where`` names its origin in errors.

    Raises:
        InputError: a key is missing or of the wrong kind, or there is no such lens.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"{where} does not hold a camera: expected an object with {', '.join(_KEYS)}.")
    missing = [key for key in _KEYS if key not in data]
    if missing:
        raise InputError(f"The camera in {where} lacks {', '.join(missing)}; needed are {', '.join(_KEYS)}.")
    known = {key: _whole(value) for key, value in data.items() if value is not None}
    return to_record(known, Camera, f"The camera in {where}")


def _whole(value: Any) -> Any:
    """250 for 250.0: some calibration tools write every number as a float."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _extent(width: int, height: int, across: str) -> float:
    if across not in ("width", "diagonal"):
        raise InputError(f"across={across!r} must be 'width' or 'diagonal'.")
    return float(width if across == "width" else math.hypot(width, height))
