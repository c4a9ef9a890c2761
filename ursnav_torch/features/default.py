"""The default features: relief edges and polar maps, the same on virtual and real pictures."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from kornia.geometry.transform import resize
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features.base import NO_EDGES, EdgePoints, Features
from ursnav_torch.features.edges import edge_points, gradient, link, thin_gradient
from ursnav_torch.features.flatten import LocalPlane, blur, flatten, local_contrast, masked_blur, remove_stripes
from ursnav_torch.features.image import check_image, signal
from ursnav_torch.features.polar import polar_grid, polar_maps
from ursnav_torch.features.sampling import check_method, sample

#: Smoothing, as a part of the picture's shorter side, beyond which structure counts as coarse.
COARSE = 0.024


@dataclass(frozen=True, slots=True)
class DefaultSettings:
    """Settings of the default extractor; lengths are parts of the picture's shorter side.

    Attributes:
        points: edge points kept a picture.
        sampling: how they are chosen, see `features.sampling`.
        working_px: shorter side of the reduced picture on which everything is computed.
        relief_reach: reach of the surroundings that are subtracted from the log picture.
        relief_blur, edge_blurs: smoothing of the relief map, and of the gradient maps (one pair of channels each).
        contour_blur: smoothing before Canny.
        low, high: Canny's thresholds as percentiles of the thinned gradient's ridges.
        min_length: shortest edge kept.
        min_points: a picture with fewer edge points is refused.
    """

    points: int = 100
    sampling: str = "farthest"
    working_px: int = 125
    relief_reach: float = 0.048
    relief_blur: float = 0.008
    edge_blurs: tuple[float, ...] = (0.012, 0.024)
    contour_blur: float = 0.012
    low: float = 50.0
    high: float = 80.0
    min_length: float = 0.06
    min_points: int = 10

    def __post_init__(self) -> None:
        check_method(self.sampling)
        object.__setattr__(self, "edge_blurs", tuple(float(b) for b in self.edge_blurs))
        if not 4 <= self.min_points <= self.points or self.working_px < 32 or not 0 <= self.low <= self.high <= 100:
            raise InputError(
                "Features need 4 <= min_points <= points, working_px >= 32 and 0 <= low <= high <= 100; got "
                f"min_points={self.min_points}, points={self.points}, working_px={self.working_px}, "
                f"low={self.low}, high={self.high}."
            )


class DefaultExtractor:
    """See `Extractor`; one lens, one set of settings."""

    def __init__(self, settings: DefaultSettings, camera: Camera) -> None:
        self.settings, self.camera = settings, camera
        shrink = min(1.0, settings.working_px / min(camera.width, camera.height))
        self.working_camera = camera.resized(round(camera.width * shrink), round(camera.height * shrink))
        self._unit = float(min(self.working_camera.width, self.working_camera.height))
        self._mask = torch.from_numpy(camera.pixel_rays()[1]).float()
        inside = torch.from_numpy(self.working_camera.pixel_rays()[1]).float()
        self._small_mask = (blur(inside, 1.0) > 0.99).float()
        rim = settings.contour_blur * self._unit * 2 + 1
        self._contour_mask = blur(self._small_mask, rim) > 0.97
        self._around = LocalPlane(self._small_mask, settings.relief_reach * self._unit)
        self._polar = polar_grid(self.working_camera)

    def extract(self, image: NDArray[np.uint8], virtual: bool = False, edges: bool = True) -> Features:
        """See `Extractor.extract`; ``virtual`` makes no difference here.

        Without ``edges`` nobody looks for edge points, a third of the work, nor refuses a picture that has few.
        """
        check_image(image, self.camera)
        gray = signal(image)
        refuse_blank(gray, self._mask)
        log_image = remove_stripes(torch.log(gray + 8), self._mask)
        small = resize(log_image[None, None], (self.working_camera.height, self.working_camera.width), antialias=True)[
            0, 0
        ]
        s, unit, mask, around = self.settings, self._unit, self._small_mask, self._around
        small = masked_blur(small, mask, max(s.relief_blur * unit, 0.5))
        relief = flatten(small, mask, around)
        contrast = local_contrast(masked_blur(small, mask, COARSE * unit), mask, around)
        grain = local_contrast(small, mask, around) - contrast
        fields = self._fields(relief)
        maps = polar_maps(fields, self._polar)[0]
        found, edge_image = self._edge_points(relief) if edges else (NO_EDGES, np.zeros(image.shape[:2], bool))
        return Features(found, maps, edge_image, fields, contrast, grain)

    def with_relief(self, features: Features, relief: Tensor) -> Features:
        """Features under another relief (h, w), say a corrected one: fields and maps follow it, edge points stay."""
        fields = self._fields(relief)
        return replace(features, fields=fields, maps=polar_maps(fields, self._polar)[0])

    def _edge_points(self, relief: Tensor) -> tuple[EdgePoints, NDArray[np.bool_]]:
        """Edge points of a relief (h, w), sampled, and all edges at the picture's size (H, W).

        Raises:
            FeatureError: too few of them.
        """
        s = self.settings
        ridge = thin_gradient(relief, s.contour_blur * self._unit) * self._contour_mask
        edges = self._edges(ridge)
        scale = (self.camera.width / self.working_camera.width, self.camera.height / self.working_camera.height)
        found = edge_points(edges, self._slope(relief, s.contour_blur), ridge, scale)
        if len(found) < s.min_points:
            raise FeatureError(
                f"The picture has {len(found)} edge points; at least {s.min_points} are needed to match it."
            )
        keep = sample(found.points.numpy(), s.points, s.sampling, found.weight.numpy())
        full = np.repeat(np.repeat(edges, max(1, round(scale[1])), 0), max(1, round(scale[0])), 1)
        return found.subset(torch.as_tensor(keep)), full

    def _fields(self, relief: Tensor) -> Tensor:
        """The relief and its gradients at every scale (C, h, w)."""
        slopes = [self._slope(relief, blurred) * self._small_mask for blurred in self.settings.edge_blurs]
        return torch.cat([relief[None], *slopes])

    def _slope(self, relief: Tensor, blurred: float) -> Tensor:
        return gradient(masked_blur(relief, self._small_mask, blurred * self._unit))

    def _edges(self, ridge: Tensor) -> NDArray[np.bool_]:
        on = ridge[ridge > 1e-4]
        if len(on) < self.settings.min_points:
            return np.zeros(tuple(ridge.shape), bool)
        low, high = torch.quantile(on, torch.tensor([self.settings.low, self.settings.high]) / 100).tolist()
        return link(ridge, low, high, max(2, round(self.settings.min_length * self._unit)))


def refuse_blank(gray: Tensor, mask: Tensor) -> None:
    """Refuse a picture (H, W) without contrast inside the mask (H, W).

    Raises:
        FeatureError: all black, all white, or one gray.
    """
    inside = gray[mask > 0]
    low, high = torch.quantile(inside[:: max(1, len(inside) // 4096)], torch.tensor([0.02, 0.98])).tolist()
    if high - low < 4:
        what = "black" if high < 16 else "white" if low > 250 else "one gray"
        raise FeatureError(
            f"The picture is all {what} (gray values {low:.0f} to {high:.0f}): there is nothing to match."
        )
