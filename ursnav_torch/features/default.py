"""The default features: the wall's relief, its edges and polar maps, alike on virtual and real pictures.

A drawn view's relief is what its light shows. A real picture's is that, blended with what the wall network reads in it,
which knows skin, wet spots and stones from walls (`features.network`): the former is sharper, the latter surer.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from kornia.geometry.transform import resize
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera, mask_text
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features.base import NO_EDGES, NO_MAPS, NOTHING_BEFORE, NOTHING_READ, EdgePoints, Features
from ursnav_torch.features.edges import edge_points, gradient, link, thin_gradient
from ursnav_torch.features.flatten import LocalPlane, MaskedBlur, blur, flat_of, local_contrast, remove_stripes
from ursnav_torch.features.foreground import ForegroundBody, find_bodies
from ursnav_torch.features.image import check_image, signal
from ursnav_torch.features.network import WallReader
from ursnav_torch.features.polar import polar_grid, polar_maps
from ursnav_torch.features.sampling import check_method, sample
from ursnav_torch.features.shading import RimShading
from ursnav_torch.threads import meanwhile

#: Smoothing, as a part of the picture's shorter side, beyond which structure counts as coarse.
COARSE = 0.024
#: Parts of the picture's shorter side around a stone or instrument that take no part in the surroundings of the wall
#: beside it, and that are not compared: set after few tries on six choosing inspections, of which `benchmarks.flights
#: half=choosing phantoms=12 inspections=450 views=150 around=2 odometry=true` prints what they give as they are.
_BESIDE, _UNCOMPARED = 0.016, 0.024


@dataclass(frozen=True, slots=True)
class DefaultSettings:
    """Settings of the default extractor; lengths are parts of the picture's shorter side.

    Attributes:
        points: edge points kept a picture.
        sampling: how they are chosen, see `features.sampling`.
        learned: share of the wall network in a real picture's relief; the rest is photometric, as a drawn view's is.
            0 asks no network. Chosen by ``python -m benchmarks.wall_network.share``.
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
    learned: float = 0.3
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
        if not 0 <= self.learned <= 1:
            raise InputError(f"learned={self.learned} must lie in 0..1: the wall network's share in the relief.")
        object.__setattr__(self, "edge_blurs", tuple(float(b) for b in self.edge_blurs))
        if not 4 <= self.min_points <= self.points or self.working_px < 32 or not 0 <= self.low <= self.high <= 100:
            raise InputError(
                "Features need 4 <= min_points <= points, working_px >= 32 and 0 <= low <= high <= 100; got "
                f"min_points={self.min_points}, points={self.points}, working_px={self.working_px}, "
                f"low={self.low}, high={self.high}."
            )


class DefaultExtractor:
    """See `Extractor`; one lens, one set of settings.

    Args:
        settings: as the virtual pictures are read.
        camera: the lens.
        learned: the wall network's share in real pictures, where it is another than the settings say. What lies
            before the wall is left out all the same, unless the settings ask no network.
    """

    def __init__(self, settings: DefaultSettings, camera: Camera, learned: float | None = None) -> None:
        self.settings, self.camera = settings, camera
        self._learned = settings.learned if learned is None else learned
        shrink = min(1.0, settings.working_px / min(camera.width, camera.height))
        self.working_camera = camera.resized(round(camera.width * shrink), round(camera.height * shrink))
        self._unit = float(min(self.working_camera.width, self.working_camera.height))
        self._mask = torch.from_numpy(camera.pixel_rays()[1]).float()
        inside = torch.from_numpy(self.working_camera.pixel_rays()[1]).float()
        self._small_mask = (blur(inside, 1.0) > 0.99).float()
        rim = settings.contour_blur * self._unit * 2 + 1
        self._contour_mask = blur(self._small_mask, rim) > 0.97
        self._around = LocalPlane(self._small_mask, settings.relief_reach * self._unit)
        self._shading = RimShading(self.working_camera, self._small_mask)
        blurs = {*settings.edge_blurs, settings.contour_blur, COARSE}
        self._blurs = {share: MaskedBlur(self._small_mask, share * self._unit) for share in blurs}
        self._first_blur = MaskedBlur(self._small_mask, max(settings.relief_blur * self._unit, 0.5))
        self._probes = spread_pixels(self._mask)
        self._polar = polar_grid(self.working_camera)
        self._partial = False  # whether pictures show less than the views, which are drawn through the whole lens
        self._network = WallReader(self.working_camera, self._small_mask) if settings.learned else None

    @property
    def lens_mask(self) -> Tensor:
        """(h, w) 1.0 where the reduced picture is to be trusted."""
        return self._small_mask

    def extract(
        self, image: NDArray[np.uint8], virtual: bool = False, edges: bool = True, bare: bool = False
    ) -> Features:
        """See `Extractor.extract`; without ``edges`` nobody looks for edge points, nor refuses a picture with few.

        ``bare`` features are what a track reads of every picture: the relief, and what lies before the wall, whose
        surroundings it is no part of. Their maps come from `with_relief` where somebody searches by them; contrast and
        grain nobody asks, nor, where the network has no share in the relief, what else it reads.
        """
        check_image(image, self.camera)
        gray = signal(image)
        refuse_blank(gray.flatten()[self._probes])
        reading = None
        if not virtual and self._network is not None:
            network, relief_too = self._network, not bare or self._learned > 0
            reading = meanwhile(lambda: network.read(image) if relief_too else (NOTHING_READ, network.before(image)))
        log_image = self._small_log(gray)
        detail = self._around.detail(log_image)
        if not virtual:  # a drawn view's lamp is in the lens
            detail = detail - self._shading(detail)
        variance = self._around.variance(detail)
        relief, valid = flat_of(detail, variance, self._small_mask), self._small_mask
        contrast = grain = 0.0
        if not virtual and not bare:  # a drawn view's are of no interest
            of_coarse = self._around.variance(self._around.detail(self._blurs[COARSE](log_image)))
            contrast = local_contrast(of_coarse, self._small_mask)
            grain = local_contrast(variance, self._small_mask) - contrast
        bodies: tuple[ForegroundBody, ...] = ()
        read = NOTHING_READ
        if reading is not None:
            read, before = reading()
            hidden = before.amax(0)
            bodies = find_bodies(before, self._small_mask, self.camera.width / self.working_camera.width)
            valid = self._small_mask * (1 - hidden)
            if bodies and bare:
                relief, valid = self._beside(hidden, log_image)
            if read.numel():
                relief = blend(relief, read[0], self._small_mask, self._learned)
        fields = relief[None] if bare else self._fields(relief)
        found, edge_image = NO_EDGES, np.zeros(image.shape[:2], bool)
        if edges:
            found, edge_image = self._edge_points(relief, valid)
        maps = NO_MAPS if bare else polar_maps(fields, self._polar)[0]
        if not bodies and not self._partial:
            valid = NOTHING_BEFORE
        return Features(found, maps, edge_image, fields, contrast, grain, valid, bodies, read)

    def _beside(self, hidden: Tensor, log_image: Tensor) -> tuple[Tensor, Tensor]:
        """The relief (h, w) of the wall beside bodies, which are no part of its surroundings, and what of it is valid.

        Args:
            hidden: (h, w) how probably something lies before the wall.
            log_image: (h, w).
        """
        wall = self._small_mask * (_widened(hidden, _BESIDE * self._unit) < 0.5)
        around = LocalPlane(wall, self._around.sigma_px, torch.float32)
        with_shading = around.detail(log_image)
        detail = with_shading - self._shading(with_shading) * wall
        return flat_of(detail, around.variance(detail), wall), wall * (1 - _widened(hidden, _UNCOMPARED * self._unit))

    def _small_log(self, gray: Tensor) -> Tensor:
        """The log of a gray picture (H, W), without stripes, at the working size (h, w), smoothed."""
        log_image = remove_stripes(torch.log(gray + 8), self._mask)
        size = (self.working_camera.height, self.working_camera.width)
        rows, columns = (_shrinking(*sides) for sides in zip(log_image.shape, size, strict=True))
        return self._first_blur(rows @ log_image @ columns.T)

    def _edge_points(self, relief: Tensor, valid: Tensor) -> tuple[EdgePoints, NDArray[np.bool_]]:
        """Edge points of a relief (h, w) where it is valid (h, w), and all edges at the picture's size (H, W).

        Raises:
            FeatureError: too few of them.
        """
        s = self.settings
        ridge, across = self._ridges(relief)
        ridge = ridge * self._contour_mask * valid
        edges = self._edges(ridge)
        scale = (self.camera.width / self.working_camera.width, self.camera.height / self.working_camera.height)
        found = edge_points(edges, across, ridge, scale)
        if len(found) < s.min_points:
            raise FeatureError(
                f"The picture has {len(found)} edge points; at least {s.min_points} are needed to match it."
            )
        keep = sample(found.points.numpy(), s.points, s.sampling, found.weight.numpy())
        full = np.repeat(np.repeat(edges, max(1, round(scale[1])), 0), max(1, round(scale[0])), 1)
        return found.subset(torch.as_tensor(keep)), full

    def _ridges(self, relief: Tensor) -> tuple[Tensor, Tensor]:
        """Strength (h, w) of the edges of a relief (h, w), 0 off the ridges, and what they run across (2, h, w)."""
        smoothing = self.settings.contour_blur
        return thin_gradient(relief, smoothing * self._unit), self._slope(relief, smoothing)

    def through(self, scene: NDArray[np.bool_]) -> "DefaultExtractor":
        """The extractor of the same lens where it shows the scene in a part (H, W) alone, see `features.static`.

        Raises:
            InputError: the part has another size than the lens.
        """
        narrow = replace(self.camera, mask=mask_text(self.camera.pixel_rays()[1] & scene))
        extractor = type(self)(self.settings, narrow, self._learned)
        extractor._partial = True
        return extractor

    def with_relief(self, features: Features, relief: Tensor) -> Features:
        """Features under another relief (h, w), say a corrected one: fields and maps follow it, edge points stay."""
        fields = self._fields(relief)
        return replace(features, fields=fields, maps=polar_maps(fields, self._polar)[0])

    def _fields(self, relief: Tensor) -> Tensor:
        """The relief and its gradients at every scale (C, h, w)."""
        slopes = [self._slope(relief, blurred) * self._small_mask for blurred in self.settings.edge_blurs]
        return torch.cat([relief[None], *slopes])

    def _slope(self, relief: Tensor, blurred: float) -> Tensor:
        return gradient(self._blurs[blurred](relief))

    def _edges(self, ridge: Tensor) -> NDArray[np.bool_]:
        strength = ridge.numpy()
        on = strength[strength > 1e-4]
        if len(on) < self.settings.min_points:
            return np.zeros(strength.shape, bool)
        low, high = np.percentile(on, (self.settings.low, self.settings.high))
        return link(ridge, float(low), float(high), max(2, round(self.settings.min_length * self._unit)))


def _widened(share: Tensor, px: float) -> Tensor:
    """The greatest of an image (h, w) within so many px in rows and columns."""
    reach = round(px)
    return torch.nn.functional.max_pool2d(share[None], 2 * reach + 1, 1, reach)[0]


def blend(photometric: Tensor, learned: Tensor, mask: Tensor, share: float) -> Tensor:
    """Two reliefs (h, w) mixed at the contrast of the first within a mask (h, w); ``share`` is the second's.

    The network's is fainter where it is unsure, everywhere by the same factor for this purpose.
    """
    contrast, read = ((x * mask).square().sum().sqrt().clamp_min(1e-6) for x in (photometric, learned))
    return (1 - share) * photometric + share * contrast / read * learned


@lru_cache(maxsize=16)
def _shrinking(here: int, there: int) -> Tensor:
    """The matrix (there, here) by which kornia resizes a column of pixels, blurred before where it shrinks."""
    return resize(torch.eye(here)[None, None], (there, here), antialias=True)[0, 0]


def spread_pixels(mask: Tensor) -> Tensor:
    """About 4,096 of the pixels where a mask (H, W) is not 0, evenly spread: their places (N,) in the flat picture."""
    inside = mask.flatten().nonzero().flatten()
    return inside[:: max(1, len(inside) // 4096)]


def refuse_blank(values: Tensor) -> None:
    """Refuse a picture without contrast, by gray values (N,) from all over it.

    Raises:
        FeatureError: all black, all white, or one gray.
    """
    low, high = np.quantile(values.numpy(), (0.02, 0.98))
    if high - low < 4:
        what = "black" if high < 16 else "white" if low > 250 else "one gray"
        raise FeatureError(
            f"The picture is all {what} (gray values {low:.0f} to {high:.0f}): there is nothing to match."
        )
