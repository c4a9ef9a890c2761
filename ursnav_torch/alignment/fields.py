"""What pictures are aligned on: the relief and its softly normalized gradient, small, and how a pose moves them."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import DefaultSettings, Features, LocalPlane
from ursnav_torch.features.flatten import blur

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
        together: slopes and values as OpenCV samples them fastest, (H, W, 4), (H, W, 4) and (H, W).
    """

    value: Floats
    slope_x: Floats
    slope_y: Floats
    weight: Floats
    together: tuple[Floats, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        planes = (*self.slope_x, *self.slope_y, *self.value)
        object.__setattr__(self, "together", tuple(cv2.merge(planes[i : i + 4]) for i in range(0, len(planes), 4)))


class AlignGrid:
    """A small picture of a lens: which of its pixels count, where they look, and how they move with the camera.

    Args:
        camera: the VID's lens.
        size_px: shorter side of the small picture.
        settings: of the extractor; reliefs of drawings are computed as it computes those of pictures.

    Attributes:
        camera: the lens at this size.
        mask: (H, W) 1.0 inside the picture.
        compared: (H, W) bool, the N pixels compared; ``places`` (N,) where they are in the flat picture.
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
        self._counted, self.places = self.compared.astype(np.float32), np.flatnonzero(self.compared)
        self.rays = np.ascontiguousarray(rays[self.compared].T, np.float32)
        self.motion = _motion(self.camera, rays[self.compared]).astype(np.float32)
        self._shares: dict[float, Floats] = {}
        self._reach = settings.relief_reach * self._unit
        around = LocalPlane(torch.from_numpy(self.mask), self._reach)
        self._columns, self._weights = around.columns.numpy(), around.weights.numpy()
        self._last: tuple[Features, Fields] | None = None

    def of_picture(self, features: Features) -> Fields:
        """Fields of a picture from its relief, weighted by how much of each pixel is valid.

        The last picture's are kept: a track aligns several poses with it, one after the other.
        """
        last = self._last
        if last is None or last[0] is not features:
            self._last = last = features, self._of_picture(features)
        return last[1]

    def _of_picture(self, features: Features) -> Fields:
        relief = (self.small(features.fields[0]) * self.mask)[None]
        x, y = self._gradient(relief)
        half = _softness(_strength(x, y).reshape(1, -1).take(self.places, 1))
        value = np.concatenate([relief, *self._normalized(x, y, half)])
        weight = self._counted * self.small(features.valid) if features.valid.numel() else self._counted
        return Fields(value, *_slopes(value), weight)

    def small(self, image: Tensor) -> Floats:
        """A picture (..., h, w) at the extractor's working size at this one (..., H, W)."""
        rows, columns = (
            _shrinking(*sizes) for sizes in zip(image.shape[-2:], (self.camera.height, self.camera.width), strict=True)
        )
        return np.asarray((rows @ image @ columns.T).numpy(), np.float32)

    def of_drawings(self, gray: Floats) -> tuple[Floats, Floats]:
        """Fields (B, M, 3, N) of drawings (B, M, H, W) in gray values 0 to 255, and slopes (B, 2, 3, N) of the first of
        each M, whose strength sets how soft the gradients of all are."""
        poses, lights, height, width = gray.shape
        relief = self.relief(gray.reshape(-1, height, width))
        x, y = self._gradient(relief)
        value = np.stack([part.reshape(len(part), -1).take(self.places, 1) for part in (relief, x, y)], 1)
        strength = _strength(value[:, 1], value[:, 2])
        half = _softness(strength[::lights])
        value[:, 1:] /= np.sqrt(strength + np.square(np.repeat(half, lights))[:, None])[:, None]
        first = np.stack([relief[::lights], *self._normalized(x[::lights], y[::lights], half)], 1)  # (B, 3, H, W)
        slopes = [part.reshape(poses, 3, -1).take(self.places, 2) for part in _slopes(first)]
        return value.reshape(poses, lights, 3, -1), np.stack(slopes, 1)

    def relief(self, gray: Floats) -> Floats:
        """Relief (M, H, W) of drawings (M, H, W) in gray values: `features.flatten.flatten` on small pictures."""
        log_image = self._masked_blur(np.log(gray + np.float32(8)), max(self._settings.relief_blur * self._unit, 0.5))
        detail = (log_image - self._planes(log_image)) * self.mask
        contrast = self._masked_blur(np.square(detail), self._reach)
        contrast += np.float32(_FLOOR**2)
        detail /= np.sqrt(contrast, out=contrast)
        return np.clip(detail, -_MOST, _MOST, out=detail)

    def sample(self, fields: Fields, pixels: Floats, out: Floats) -> Floats:
        """A picture at places (2, B, N) px: slopes in x and in y, then values, all into ``out`` (B, 9, N); and how much
        each place counts (B, N)."""
        x, y = pixels
        row = 0
        for some in fields.together:
            parts = cv2.remap(some, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for part in cv2.split(parts):
                out[:, row] = part
                row += 1
        weight = cv2.remap(fields.weight, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(weight, np.float32)

    def _gradient(self, relief: Floats) -> tuple[Floats, Floats]:
        """Slopes in x and in y, (M, H, W) each, of smoothed reliefs (M, H, W)."""
        return _slopes(self._masked_blur(relief, GRADIENT_BLUR * self._unit))

    def _normalized(self, x: Floats, y: Floats, half: Floats) -> tuple[Floats, Floats]:
        """Gradients (M, H, W) softly normalized: at strengths of ``half`` (M,) they are at half their length."""
        share = self.mask / np.sqrt(_strength(x, y) * self.mask + np.square(half)[:, None, None])
        return x * share, y * share

    def _planes(self, x: Floats) -> Floats:
        """Planes through the surroundings (M, H, W) of (M, H, W), as `features.LocalPlane`."""
        return np.einsum("mkhw,khw->mhw", _blur(x[:, None] * self._columns, self._reach), self._weights)

    def _masked_blur(self, x: Floats, sigma_px: float) -> Floats:
        """Gaussian mean of (M, H, W) over the pixels inside, as `features.flatten.masked_blur`."""
        if sigma_px not in self._shares:
            self._shares[sigma_px] = np.asarray(1 / np.maximum(_blur(self.mask, sigma_px), 1e-3), np.float32)
        found = _blur(x * self.mask, sigma_px)
        found *= self._shares[sigma_px]
        return found


@lru_cache(maxsize=16)
def _shrinking(here: int, there: int) -> Tensor:
    """The matrix (there, here) that shrinks a column of pixels, as torch does with antialiasing."""
    each = torch.eye(here)[None, None]
    return torch.nn.functional.interpolate(each, (there, here), mode="bilinear", antialias=True)[0, 0]


def _strength(x: Floats, y: Floats) -> Floats:
    """Squared strength of gradients."""
    return np.square(x) + np.square(y)


def _softness(strength: Floats) -> Floats:
    """(M,) strength of gradients that counts half, from squared strengths (M, N)."""
    return np.asarray(GRADIENT_SOFTNESS * np.sqrt(np.median(strength, axis=1)) + 1e-6, np.float32)


def _blur(x: Floats, sigma_px: float) -> Floats:
    """`features.flatten.blur` of arrays (..., H, W)."""
    return np.asarray(blur(torch.from_numpy(x), sigma_px).numpy())


def _slopes(x: Floats) -> tuple[Floats, Floats]:
    """Sobel slopes per px in x and y of planes (..., H, W), one above the other: first and last rows are neighbors',
    but no lens shows anything there."""
    tall = x.reshape(-1, x.shape[-1])
    dx = cv2.Sobel(tall, -1, 1, 0, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    dy = cv2.Sobel(tall, -1, 0, 1, scale=1 / 8, borderType=cv2.BORDER_REPLICATE)
    return dx.reshape(x.shape), dy.reshape(x.shape)


def _motion(camera: Camera, rays: Array, step: float = 1e-4) -> Array:
    """(6, 2, N), see `AlignGrid.motion`; central differences of the lens's own projection."""
    moves = np.concatenate([np.broadcast_to(np.eye(3), (len(rays), 3, 3)), np.cross(np.eye(3), rays[:, None])], axis=1)
    ahead, back = (camera.project(rays[:, None] + sign * step * moves)[0] for sign in (1, -1))
    return (ahead - back).transpose(1, 2, 0) / (2 * step)
