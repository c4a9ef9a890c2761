"""The thesis's features (§3.5.1), step by step: what everything else is compared with."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from kornia.color import bgr_to_grayscale
from kornia.enhance import equalize
from kornia.filters import gaussian_blur2d
from numpy.typing import NDArray
from skimage.filters import threshold_otsu
from skimage.morphology import remove_small_objects, skeletonize
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features.base import NO_MAPS, Features
from ursnav_torch.features.default import refuse_blank, spread_pixels
from ursnav_torch.features.edges import edge_points, gradient
from ursnav_torch.features.image import check_image
from ursnav_torch.features.sampling import check_method, sample


@dataclass(frozen=True, slots=True)
class ThesisSettings:
    """Settings of the thesis's extractor; what it does not print is marked *ours*.

    Attributes:
        points: points kept a picture (*ours*; the thesis keeps all, and pays with the square of their number).
        sampling: how they are chosen, see `features.sampling`.
        blur_px: standard deviation of the Gaussian (*ours*).
        stripe_rows: vertical frequencies from this many cycles a picture on are zeroed where nothing changes
            along the row (*ours*).
        min_area_px: smaller groups of edge pixels are dropped (*ours*).
        prune_px: skeleton branches up to this length are dropped (*ours*).
        rim_px: edges this near to the round rim of the picture belong to the lens (*ours*).
        min_points: a picture with fewer edge points is refused.
    """

    points: int = 200
    sampling: str = "farthest"
    blur_px: float = 1.1
    stripe_rows: int = 12
    min_area_px: int = 20
    prune_px: int = 6
    rim_px: int = 6
    min_points: int = 10

    def __post_init__(self) -> None:
        check_method(self.sampling)
        if not 4 <= self.min_points <= self.points or self.blur_px <= 0 or self.stripe_rows < 1:
            raise InputError(
                "The thesis's features need 4 <= min_points <= points, blur_px > 0 and stripe_rows >= 1; got "
                f"{self.min_points}, {self.points}, {self.blur_px} and {self.stripe_rows}."
            )


class ThesisExtractor:
    """See `Extractor`. Virtual pictures skip the preprocessing, as in the thesis."""

    def __init__(self, settings: ThesisSettings, camera: Camera) -> None:
        self.settings, self.camera, self.working_camera = settings, camera, camera
        self._mask = camera.pixel_rays()[1]
        self._probes = spread_pixels(torch.from_numpy(self._mask))
        size = 2 * settings.rim_px + 1
        framed = np.pad(self._mask.astype(np.uint8), 1)
        self._inner = cv2.erode(framed, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))[1:-1, 1:-1] > 0

    def extract(self, image: NDArray[np.uint8], virtual: bool = False) -> Features:
        """See `Extractor.extract`."""
        check_image(image, self.camera)
        gray = grayscale(image)
        refuse_blank((gray * 255).flatten()[self._probes])
        if not virtual:
            gray = equalize(remove_stripes(gray, self.settings.stripe_rows))
            gray = gaussian_blur2d(gray[None, None], (13, 13), (self.settings.blur_px, self.settings.blur_px))[0, 0]
        edges = self._edges(gray)
        thin = prune(
            skeletonize(cv2.dilate(edges.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0), self.settings.prune_px
        )
        slope = gradient(gray)
        found = edge_points(thin, slope, slope.norm(dim=0), (1.0, 1.0))
        if len(found) < self.settings.min_points:
            raise FeatureError(
                f"The picture has {len(found)} edge points; at least {self.settings.min_points} are needed to match it."
            )
        keep = sample(found.points.numpy(), self.settings.points, self.settings.sampling)
        return Features(found.subset(torch.as_tensor(keep)), NO_MAPS, thin, NO_MAPS)

    def _edges(self, gray: Tensor) -> NDArray[np.bool_]:
        """OpenCV's Canny, as the thesis has it, with the Otsu threshold and a third of it, less rim and small groups.

        Its thresholds are for the sum of the two slopes; kornia's, for their root mean square, find too few edges here.
        """
        levels = (gray.numpy() * 255).round().astype(np.uint8)
        high = float(threshold_otsu(levels[self._mask]))
        edges = (cv2.Canny(levels, high / 3, high) > 0) & self._inner
        return np.asarray(remove_small_objects(edges, max_size=self.settings.min_area_px - 1, connectivity=2), bool)


def grayscale(image: NDArray[np.uint8]) -> Tensor:
    """Gray (H, W) in 0..1 of a picture (H, W) or (H, W, 3) blue, green, red."""
    x = torch.from_numpy(np.ascontiguousarray(image)).float() / 255
    return x if x.ndim == 2 else bgr_to_grayscale(x.permute(2, 0, 1)[None])[0, 0]


def remove_stripes(gray: Tensor, rows: int) -> Tensor:
    """Zero the vertical frequencies from ``rows`` cycles on where the horizontal one is zero (thesis §3.5.1).

    ``gray`` is (H, W) in 0..1, and so is what is given back.
    """
    spectrum = torch.fft.rfft2(gray)
    spectrum[rows : -rows + 1, 0] = 0
    return torch.fft.irfft2(spectrum, s=gray.shape).clamp(0, 1)


def prune(skeleton: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """A skeleton (H, W) without branches up to ``length`` px: ends are worn off, then the rest grows back along it."""
    worn, ends = skeleton.copy(), []
    for _ in range(length):
        end = worn & (_neighbors(worn) <= 1)
        worn &= ~end
        ends.append(end)
    tips = worn & (_neighbors(worn) <= 1)
    for end in reversed(ends):
        tips = (cv2.dilate(tips.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & end
        worn |= tips
    return worn


def _neighbors(skeleton: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number of skeleton pixels among each pixel's eight neighbors."""
    x = skeleton.astype(np.float32)
    return np.rint(cv2.boxFilter(x, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT) - x).astype(int)
