"""A calibrated lens: pixels <-> rays, cropped and resized.

Pixel centers lie at whole numbers: the center of the top-left pixel is (0, 0). Camera axes are OpenCV's
(x right, y down, z forward).
"""

import base64
import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.camera.models import MODELS, equidistant_offsets, fold_angle, radial
from ursnav_torch.errors import InputError

_MASK_HEAD = "data:image/png;base64,"


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated lens.

    Args:
        model: ``equidistant`` (Kannala and Brandt's fisheye, may see more than 180 degrees), ``pinhole``, ``rational``
            (a pinhole with Brown and Conrady's distortion), ``ocam`` (OCamCalib's polynomial) or ``double_sphere``.
        width, height: image size in px.
        fx, fy, cx, cy: focal lengths and principal point in px.
        k: the model's coefficients, see `models`; none for a pinhole.
        fov_deg: full angle of the image circle; rays beyond half of it are outside the picture.
            Without it the whole sensor counts.
        mask: where the scope's picture is, as PNG in a data URL (`mask_text`); None: everywhere.

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
    k: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    fov_deg: float | None = None
    mask: str | None = None

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"Unknown lens model {self.model!r}; known are {', '.join(MODELS)}.")
        if self.width < 8 or self.height < 8:
            raise InputError(f"The image size is {self.width} x {self.height} px; at least 8 x 8 is needed.")
        numbers, model = (self.fx, self.fy, self.cx, self.cy, *self.k), MODELS[self.model]
        if not all(math.isfinite(v) for v in numbers) or min(self.fx, self.fy) <= 0:
            raise InputError(
                f"The lens needs finite fx, fy > 0, cx, cy and k; got fx={self.fx}, fy={self.fy}, cx={self.cx}, "
                f"cy={self.cy}, k={list(self.k)}."
            )
        if self.model == "pinhole" and any(self.k):
            raise InputError("A pinhole lens takes no k: model=rational has distortion, model=equidistant a fisheye's.")
        if len(self.k) not in model.coefficients:
            raise InputError(
                f"The lens model {self.model} takes {model.coefficients.start} coefficients k ({model.words}), got "
                f"{len(self.k)}: {list(self.k)}."
            )
        limit = 180.0 if self.model in ("pinhole", "rational") else 360.0
        if self.fov_deg is not None and not 0 < self.fov_deg < limit:
            raise InputError(f"fov_deg={self.fov_deg} must lie between 0 and {limit:g} for {self.model}.")
        if self.mask is not None:
            self.mask_image()

    def project(self, points_camera: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Pixels (..., 2) of camera-frame points (..., 3), and which of them lie inside the picture (...)."""
        p = np.asarray(points_camera, float)
        angle = np.arctan2(np.hypot(p[..., 0], p[..., 1]), p[..., 2])
        offsets, ok = MODELS[self.model].project(self.k, p)
        pixels = offsets * [self.fx, self.fy] + [self.cx, self.cy]
        return pixels, ok & self._on_sensor(pixels) & (angle <= self._theta_max())

    def pixels(self, points_camera: NDArray[np.float32]) -> NDArray[np.float32]:
        """Pixels (2, ...) of camera-frame points (3, ...), wherever they lie: `project` for who asks many times."""
        if self.model == "equidistant":
            found = equidistant_offsets(self.k, points_camera)
        else:
            offsets, _ = MODELS[self.model].project(self.k, np.moveaxis(points_camera, 0, -1))  # type: ignore[arg-type]
            found = np.ascontiguousarray(np.moveaxis(offsets, -1, 0), np.float32)
        for row, focal, center in zip(found, (self.fx, self.fy), (self.cx, self.cy), strict=True):
            row *= np.float32(focal)
            row += np.float32(center)
        return found

    def rays(self, pixels: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Unit viewing directions (..., 3) in the camera frame of pixels (..., 2), and which are in the picture."""
        q = np.asarray(pixels, float)
        directions, ok = MODELS[self.model].unproject(self.k, (q - [self.cx, self.cy]) / [self.fx, self.fy])
        angle = np.arctan2(np.hypot(directions[..., 0], directions[..., 1]), directions[..., 2])
        return directions, ok & self._on_sensor(q) & (angle <= self._theta_max())

    def pixel_rays(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Directions (H, W, 3) of every pixel and the round or full picture mask (H, W)."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        directions, inside = self.rays(np.stack([u, v], axis=-1))
        mask = self.mask_image()
        return directions, inside if mask is None else inside & mask

    def mask_image(self) -> NDArray[np.bool_] | None:
        """(H, W) where the scope's picture is; None: everywhere.

        Raises:
            InputError: the mask is no picture, or of another size than the lens.
        """
        if self.mask is None:
            return None
        try:
            data = np.frombuffer(base64.b64decode(self.mask.removeprefix(_MASK_HEAD), validate=True), np.uint8)
            image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
        except (ValueError, cv2.error):
            image = None
        if image is None:
            raise InputError("The lens's mask is no PNG in base64; in a camera JSON name the PNG file beside it.")
        if image.shape != (self.height, self.width):
            raise InputError(
                f"The lens's mask is {image.shape[1]} x {image.shape[0]} px, the lens {self.width} x {self.height}."
            )
        if not (image > 127).any():
            raise InputError("The lens's mask is black all over; white is where the scope's picture is.")
        return np.asarray(image > 127)

    def resized(self, width: int, height: int) -> "Camera":
        """The same lens on a picture resized to ``width`` x ``height`` px."""
        sx, sy = width / self.width, height / self.height
        mask = self.mask_image()
        small = None if mask is None else cv2.resize(mask.astype(np.uint8), (width, height)) > 0
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5, mask=None if small is None else mask_text(small),
        )  # fmt: skip

    def cropped(self, x: int, y: int, width: int, height: int) -> "Camera":
        """The same lens on a part of its picture, whose top-left pixel was (``x``, ``y``).

        Raises:
            InputError: the part is not inside the picture.
        """
        if x < 0 or y < 0 or x + width > self.width or y + height > self.height:
            raise InputError(
                f"The crop [{x}, {y}, {width}, {height}] (x, y, w, h) is not inside the lens's {self.width} x "
                f"{self.height} px."
            )
        mask = self.mask_image()
        part = None if mask is None else mask_text(mask[y : y + height, x : x + width])
        return replace(self, width=width, height=height, cx=self.cx - x, cy=self.cy - y, mask=part)

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
        data: dict[str, Any] = {name: getattr(self, name) for name in KEYS}
        optional = {"fov_deg": self.fov_deg, "mask": self.mask}
        return data | {"k": list(self.k)} | {name: value for name, value in optional.items() if value is not None}

    def fold(self) -> float:
        """The angle (radians) up to which a fisheye's radius rises; pi for other models, which say where they end."""
        return fold_angle(self.k) if self.model == "equidistant" else math.pi

    def radius_px(self, angle: float) -> float:
        """The distance from the center, px, of what is seen at an angle (radians) to the axis, of a fisheye."""
        return float(radial(np.array(angle), self.k)) * math.sqrt(self.fx * self.fy)

    def farthest_px(self) -> float:
        """The distance of the farthest pixel from the principal point, px."""
        return math.hypot(max(self.cx, self.width - 1 - self.cx), max(self.cy, self.height - 1 - self.cy))

    def _on_sensor(self, pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
        u, v = pixels[..., 0], pixels[..., 1]
        inside = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        return np.asarray(inside)

    def _theta_max(self) -> float:
        return math.pi if self.fov_deg is None else math.radians(self.fov_deg) / 2 + 1e-9


#: What every camera JSON holds.
KEYS = ("model", "width", "height", "fx", "fy", "cx", "cy")


def mask_text(mask: NDArray[np.bool_]) -> str:
    """A mask (H, W) as `Camera` carries it."""
    png = cv2.imencode(".png", np.where(mask, 255, 0).astype(np.uint8))[1]
    return _MASK_HEAD + base64.b64encode(png.tobytes()).decode("ascii")


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


def _extent(width: int, height: int, across: str) -> float:
    if across not in ("width", "diagonal"):
        raise InputError(f"across={across!r} must be 'width' or 'diagonal'.")
    return float(width if across == "width" else math.hypot(width, height))
