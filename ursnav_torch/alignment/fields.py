"""What pictures are aligned on: the relief and its softly normalized gradient, small, and how a pose moves them."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import DefaultSettings, Features, LocalPlane

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

#: Smoothing before the gradient, as a part of the picture's shorter side.
GRADIENT_BLUR = 0.012
#: A gradient of this share of the picture's median counts half.
GRADIENT_SOFTNESS = 0.9
_RIM = 4.0  # gradient blurs between the picture's edge and what is compared
_FLOOR, _MOST = 0.02, 3.0  # as `features.flatten` has them


@dataclass(frozen=True, slots=True)
class Fields:
    """Fields of one picture: relief, then the gradient's x and y.

    Attributes:
        value: (3, H, W).
        slope_x, slope_y: (3, H, W) change per px.
        weight: (H, W) 0 to 1, how much each pixel counts.
    """

    value: Floats
    slope_x: Floats
    slope_y: Floats
    weight: Floats


class AlignGrid:
    """A small picture of a lens: which of its pixels count, where they look, and how they move with the camera.

    Args:
        camera: the VID's lens.
        size_px: shorter side of the small picture.
        settings: of the extractor; reliefs of drawings are computed as it computes those of pictures.

    Attributes:
        camera: the lens at this size.
        mask: (H, W) 1.0 inside the picture.
        compared: (H, W) bool, the N pixels compared.
        rays: (3, N) their unit rays.
        motion: (6, 2, N) px in x and y by which the image of a wall point at distance 1 on each ray moves when the
            point moves along x, y, z, and when it turns about x, y, z around the camera.
    """

    def __init__(self, camera: Camera, size_px: int, settings: DefaultSettings) -> None:
        shrink = min(1.0, size_px / min(camera.width, camera.height))
        self.camera = camera.resized(round(camera.width * shrink), round(camera.height * shrink))
        self._unit, self._settings = float(min(self.camera.width, self.camera.height)), settings
        rays, inside = self.camera.pixel_rays()
        self.mask = (_blur(inside.astype(np.float32), 1.0) > 0.99).astype(np.float32)
        self.compared = _blur(self.mask, max(1.0, _RIM / 2 * GRADIENT_BLUR * self._unit)) > 0.97
        self._counted = self.compared.astype(np.float32)
        self.rays = np.ascontiguousarray(rays[self.compared].T, np.float32)
        self.motion = _motion(self.camera, rays[self.compared]).astype(np.float32)
        self._shares: dict[float, Floats] = {}
        self._reach = settings.relief_reach * self._unit
        around = LocalPlane(torch.from_numpy(self.mask), self._reach)
        self._columns, self._weights = (
            v.numpy().transpose(1, 2, 0)[..., None] for v in (around.columns, around.weights)
        )

    def of_picture(self, features: Features) -> Fields:
        """Fields of a picture from its relief, weighted by how much of each pixel is valid."""
        relief = self.small(features.fields[0])
        value = self._fields((relief * self.mask)[..., None])[..., 0]
        weight = self._counted * self.small(features.valid) if features.valid.numel() else self._counted
        planes, x, y = (np.ascontiguousarray(field.transpose(2, 0, 1)) for field in (value, *_slopes(value)))
        return Fields(planes, x, y, weight)

    def small(self, image: Tensor) -> Floats:
        """A picture (..., h, w) at the extractor's working size at this one (..., H, W)."""
        size = (self.camera.height, self.camera.width)
        planes = image.reshape(1, -1, *image.shape[-2:])
        small = torch.nn.functional.interpolate(planes, size, mode="bilinear", antialias=True)
        return np.asarray(small.reshape(*image.shape[:-2], *size).numpy(), np.float32)

    def of_drawings(self, gray: Floats) -> tuple[Floats, Floats]:
        """Fields (B, M, 3, N) of drawings (H, W, B, M) in gray values 0 to 255, and slopes (B, 2, 3, N) of the first of
        each M."""
        height, width, poses, lights = gray.shape
        value = self._fields(self.relief(gray.reshape(height, width, -1)), lights)
        first = np.ascontiguousarray(value[..., ::lights])  # (H, W, 3, B)
        along = np.stack(_slopes(first.reshape(height, width, -1)))[:, self.compared]  # (2, N, 3 B)
        slope = along.reshape(2, -1, 3, poses).transpose(3, 0, 2, 1)
        inside = value[self.compared].reshape(-1, 3, poses, lights)
        return np.ascontiguousarray(inside.transpose(2, 3, 1, 0)), np.ascontiguousarray(slope)

    def relief(self, gray: Floats) -> Floats:
        """Relief (H, W, M) of drawings (H, W, M) in gray values: `features.flatten.flatten` on small pictures."""
        mask = self.mask[..., None]
        log_image = self._masked_blur(np.log(gray + 8), max(self._settings.relief_blur * self._unit, 0.5))
        detail = (log_image - self._planes(log_image)) * mask
        contrast = np.sqrt(self._masked_blur(detail * detail, self._reach) + np.float32(_FLOOR**2))
        return np.clip(detail / contrast, -_MOST, _MOST) * mask

    def sample(self, fields: Fields, pixels: Floats) -> tuple[Floats, Floats, Floats]:
        """Values (B, 3, N) and slopes (B, 2, 3, N) of a picture at places (2, B, N) px, and how much each counts
        (B, N)."""
        x, y = pixels
        parts = np.empty((3, 3, *x.shape), np.float32)
        for part, of in zip(parts, (fields.value, fields.slope_x, fields.slope_y), strict=True):
            for row, plane in zip(part, of, strict=True):  # rows that lie together are what is fast afterwards
                cv2.remap(plane, x, y, cv2.INTER_LINEAR, row, cv2.BORDER_REPLICATE)
        weight = cv2.remap(fields.weight, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        by_place = np.moveaxis(parts, 2, 0)
        return by_place[:, 0], by_place[:, 1:], np.asarray(weight, np.float32)

    def _fields(self, relief: Floats, lights: int = 1) -> Floats:
        """Relief and softly normalized gradient (H, W, 3, M) of reliefs (H, W, M); the first of every so many lights
        sets their softness."""
        x, y = _slopes(self._masked_blur(relief, GRADIENT_BLUR * self._unit))
        strength = (x * x + y * y) * self.mask[..., None]
        middle = np.median(strength[self.compared][:, ::lights], axis=0)
        half = np.repeat(GRADIENT_SOFTNESS * np.sqrt(middle) + np.float32(1e-6), lights).astype(np.float32)
        share = self.mask[..., None] / np.sqrt(strength + half * half)
        return np.stack([relief, x * share, y * share], axis=2)

    def _planes(self, x: Floats) -> Floats:
        """Planes through the surroundings (H, W, M) of (H, W, M), as `features.LocalPlane`."""
        products = x[:, :, None] * self._columns
        return (_blur(products.reshape(*x.shape[:2], -1), self._reach).reshape(products.shape) * self._weights).sum(2)

    def _masked_blur(self, x: Floats, sigma_px: float) -> Floats:
        """Gaussian mean of (H, W, M) over the pixels inside, as `features.flatten.masked_blur`."""
        if sigma_px not in self._shares:
            share = np.maximum(_blur(self.mask, sigma_px), np.float32(1e-3))[..., None]
            self._shares[sigma_px] = np.asarray(1 / share, np.float32)
        return _blur(x * self.mask[..., None], sigma_px) * self._shares[sigma_px]


def _blur(x: Floats, sigma_px: float) -> Floats:
    """Gaussian blur of (H, W) or (H, W, M) with zeros beyond the border, as `features.flatten.blur`."""
    size = 2 * max(1, round(3 * sigma_px)) + 1
    return cv2.GaussianBlur(x, (size, size), sigma_px, borderType=cv2.BORDER_CONSTANT).reshape(x.shape)


def _slopes(x: Floats) -> tuple[Floats, Floats]:
    """Sobel slopes per px in x and y of (H, W, M)."""
    dx = cv2.Sobel(x, -1, 1, 0, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    dy = cv2.Sobel(x, -1, 0, 1, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    return dx.reshape(x.shape), dy.reshape(x.shape)


def _motion(camera: Camera, rays: Array, step: float = 1e-4) -> Array:
    """(6, 2, N), see `AlignGrid.motion`; central differences of the lens's own projection."""
    moves = np.concatenate([np.broadcast_to(np.eye(3), (len(rays), 3, 3)), np.cross(np.eye(3), rays[:, None])], axis=1)
    ahead, back = (camera.project(rays[:, None] + sign * step * moves)[0] for sign in (1, -1))
    return (ahead - back).transpose(1, 2, 0) / (2 * step)
