"""A small U-Net that reads a picture as its virtual view: the wall's relief without skin, and what lies before it.

A vessel, a wet spot or a shadow is relief to any operator that sees intensities alone; a network that has seen many
skins on known walls tells them apart. It predicts, for each pixel, the relief that the same wall has under the
virtual camera's own light (what `flatten` makes of the drawn view), how sure it is of that (Kendall and Gal, NeurIPS
2017), the wall's log depth, and the odds of a stone, an instrument and clutter.

Its weights lie beside it and are made by ``python -m benchmarks.wall_network``.
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load as load_weights
from torch import Tensor, nn
from torch.nn import functional

from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import large_stones, may_be_large

#: Sides of a picture are padded to a multiple of this many px: cells of 4 px are halved in size twice.
MULTIPLE = 16
#: Shorter side in px of the pictures it has learned from.
NATIVE_PX = 128
#: What lies before the wall, in the order of the network's odds.
FOREGROUND = ("stone", "instrument", "clutter")
WEIGHTS = "wall_network.safetensors"
#: Px of the picture, each way, that the network sees as one.
CELL = 4
_WIDTHS = (32, 64, 96)
_BEFORE_WIDTH = 24  # of the branch that tells what lies before the wall
_HUES = 3  # channels of `hues`
#: Share of the working size at which pictures that a stone may fill are looked at once more: it is then as small as
#: those it has learned from.
_SMALLER = 0.625
#: A stone may fill a picture of which the coarsest channels have this logit or more, and whose blue against green
#: spreads over this many log units or more. Set by hand on phantoms; ``python -m benchmarks.wall_network.filled`` tells
#: what they keep.
FILLED, _SPREAD = -2.0, 0.1
_THUMB, _DARK = 32, 6  # px of a picture whose hues are looked at, and gray values that show none
_LEAST_HUE, _MOST_HUE = 0.05, 5.0  # a hue's usual size is at least, and its ratio to it at most, so much
_MEAN_LOG = 4.3  # of a picture's log values, about


@dataclass(frozen=True, slots=True)
class WallReading:
    """What the network says of N pictures (H, W), all but the relief once a cell, (h, w) = (H / 4, W / 4).

    Attributes:
        relief: (N, H, W) as `features.flatten.flatten` would give it for the drawn view.
        log_variance: (N, h, w) of the relief.
        log_depth: (N, h, w) log of the wall's distance, less an unknown constant.
        depth_log_variance: (N, h, w) of that.
        odds: (N, 3, h, w) logits of `FOREGROUND`.
        filled: (N,) logits of a stone that fills much of the picture.
    """

    relief: Tensor
    log_variance: Tensor
    log_depth: Tensor
    depth_log_variance: Tensor
    odds: Tensor
    filled: Tensor


class WallNetwork(nn.Module):
    """The U-Net, 0.3 million weights; pictures (N, 3, H, W) and rays (N, 3, H, W) in, `WallReading` out.

    It works at a quarter of the picture's size: 4 x 4 px go in at once, and the relief's come out as channels (Shi et
    al., CVPR 2016), which is what makes it fast enough for a camera on one core. What lies before the wall is told
    by a branch of its own, which sees the finest channels beside the last ones, and how each pixel's hue differs from
    the wall's: it is taught after the rest, from pictures most of which show stones and instruments, before all of it
    is taught on together. Whether a stone may fill much of a picture is told by the mean of its coarsest channels.
    """

    def __init__(self) -> None:
        super().__init__()
        a, b, c = _WIDTHS
        self.down1 = nn.Sequential(_Block(6, a, size=CELL, stride=CELL), _Block(a, a))
        self.down2 = nn.Sequential(_Block(a, b, stride=2), _Block(b, b))
        self.down3 = nn.Sequential(_Block(b, c, stride=2), _Block(c, c))
        self.whole = nn.Linear(c, c)
        self.up2 = nn.Sequential(_Block(c + b, b, size=1), _Block(b, b))
        self.up1 = nn.Sequential(_Block(b + a, a, size=1), _Block(a, a))
        self.head = nn.Conv2d(a, CELL * CELL + 3, 3, padding=1)
        self.before = _Before(2 * a + _HUES * CELL * CELL)
        self.filled = nn.Linear(c, 1)

    def forward(self, picture_bgr: Tensor, rays: Tensor) -> WallReading:
        """Read pictures (N, 3, H, W), 0 to 255, with unit rays' x and y and the lens's mask (N, 3, H, W)."""
        last, odds, mean = self.channels(picture_bgr, rays)
        y, cells = self.head(last), CELL * CELL
        relief = functional.pixel_shuffle(y[:, :cells], CELL)[:, 0]
        return WallReading(relief, y[:, cells], y[:, cells + 1], y[:, cells + 2], odds, self.filled(mean)[:, 0])

    def channels(self, picture_bgr: Tensor, rays: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The last channels (N, C, h, w), from which the wall is read, `WallReading.odds`, and the coarsest channels'
        means (N, C'); arguments as above."""
        log_image = (torch.log(picture_bgr + 8) - _MEAN_LOG) * rays[:, 2:]
        x = torch.cat([log_image, rays], 1).contiguous(memory_format=torch.channels_last)
        fine = self.down1(x)
        middle = self.down2(fine)
        coarse = self.down3(middle)
        mean = coarse.mean((2, 3))
        coarse = coarse + functional.silu(self.whole(mean))[..., None, None]
        last = self.up1(_beside(self.up2(_beside(coarse, middle)), fine))
        return last, self.before(torch.cat([last, fine, _cells(hues(log_image, rays[:, 2]))], 1)), mean


def read_wall(picture_bgr: Tensor, rays: Tensor, network: WallNetwork | None = None) -> WallReading:
    """What the network, the package's own by default, says of pictures (N, 3, H, W) of any size, see `WallNetwork`."""
    return (network or packaged_network())(_whole_cells(picture_bgr), _whole_cells(rays))


def _whole_cells(x: Tensor) -> Tensor:
    """Pictures (N, C, H, W) with as much around them, as it is outside the lens, as the network needs."""
    height, width = x.shape[-2:]
    return functional.pad(x, (0, -width % MULTIPLE, 0, -height % MULTIPLE))


class WallReader:
    """Reads pictures of one lens, at the working size of an extractor.

    Args:
        working_camera: the lens at that size.
        mask: (h, w) 1.0 where the reduced picture is to be trusted.
    """

    def __init__(self, working_camera: Camera, mask: Tensor) -> None:
        width, height = self._size = working_camera.width, working_camera.height
        self._mask, self._rays = mask, lens_rays(working_camera)
        smaller = working_camera.resized(round(_SMALLER * width), round(_SMALLER * height))
        self._smaller, self._smaller_rays = (smaller.width, smaller.height), lens_rays(smaller)

    def read(self, image: NDArray[np.uint8]) -> tuple[Tensor, Tensor]:
        """`Features.read` (5, h, w) of a picture (H, W) or (H, W, 3), and probabilities (2, h, w) of a stone or an
        instrument before the wall; clutter is small, and the relief knows of it."""
        found = read_wall(_resized(image, self._size), self._rays[None])
        odds = found.odds.sigmoid()
        of_cells = torch.stack([found.log_variance, found.log_depth, found.depth_log_variance, 1 - odds.amax(1)], 1)
        cells = _pixels(torch.cat([of_cells, found.odds[:, :2]], 1)[0], self._size)
        width, height = self._size
        relief = found.relief[:, :height, :width] * self._mask
        return torch.cat([relief, cells[:4]]), self._with_large(image, cells[4:].sigmoid(), found.filled)

    def before(self, image: NDArray[np.uint8]) -> Tensor:
        """The probabilities (2, h, w) alone that `read` gives."""
        return self._with_large(image, *_before(image, self._size, self._rays))

    def again(self, image: NDArray[np.uint8]) -> Tensor:
        """The probabilities (h, w) of large stones, 0 elsewhere, that a smaller picture tells, as they fill much of
        it."""
        smaller, _ = _before(image, self._smaller, self._smaller_rays)
        grown = functional.interpolate(smaller[None], self._mask.shape, mode="bilinear")
        return large_stones(grown[0, 0], self._mask)

    def _with_large(self, image: NDArray[np.uint8], before: Tensor, filled: Tensor) -> Tensor:
        """The probabilities (2, h, w), and those of large stones where there may be any."""
        if not may_be_large(before[0], self._mask) and not (float(filled) >= FILLED and has_hues(image)):
            return before
        return torch.stack([torch.maximum(before[0], self.again(image)), before[1]])


def has_hues(image: NDArray[np.uint8]) -> bool:
    """Whether a picture (H, W) or (H, W, 3) has more than one hue, as wall and stone have; a gray one may have."""
    if image.ndim == 2:
        return True
    small = cv2.resize(image, (_THUMB, _THUMB), interpolation=cv2.INTER_AREA).reshape(-1, 3).astype(np.float32)
    log = np.log(small[small.max(1) > _DARK] + 8)
    against = np.sort(log[:, 0] - log[:, 1])
    if not len(against):
        return False
    low, high = against[len(against) // 20], against[-1 - len(against) // 20]
    return bool(low == high or high - low >= _SPREAD)


def _before(image: NDArray[np.uint8], size: tuple[int, int], rays: Tensor) -> tuple[Tensor, Tensor]:
    """Probabilities (2, h, w) of a stone or an instrument in a picture (H, W) or (H, W, 3) read at a size (w, h), and
    the logit (1,) of a stone that fills much of it."""
    network = packaged_network()
    _, odds, mean = network.channels(_whole_cells(_resized(image, size)), _whole_cells(rays[None]))
    return _pixels(odds[0, :2], size).sigmoid(), network.filled(mean)[:, 0]


def _resized(image: NDArray[np.uint8], size: tuple[int, int]) -> Tensor:
    """A picture (H, W) or (H, W, 3) as (1, 3, h, w) of a size (w, h)."""
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    color = np.repeat(small[..., None], 3, 2) if small.ndim == 2 else small
    return torch.from_numpy(np.ascontiguousarray(color)).permute(2, 0, 1)[None].float()


def _pixels(cells: Tensor, size: tuple[int, int]) -> Tensor:
    """Channels (C, H / 4, W / 4) of cells as pixels (C, h, w) of a size (w, h), between cells interpolated."""
    rows, columns = (_growing(n) for n in cells.shape[-2:])
    return rows[: size[1]] @ cells @ columns[: size[0]].T


@lru_cache(maxsize=8)
def _growing(cells: int) -> Tensor:
    """The matrix (`CELL` n, n) that interpolates between a column of cells, as torch does."""
    each = torch.eye(cells)[None, None]
    return functional.interpolate(each, (CELL * cells, cells), mode="bilinear", align_corners=False)[0, 0]


def lens_rays(camera: Camera) -> Tensor:
    """The network's second input (3, H, W): x and y of the unit rays and the mask, zero outside."""
    rays, inside = camera.pixel_rays()
    mask = torch.from_numpy(inside).float()
    return torch.stack([*(torch.from_numpy(rays[..., axis]).float() * mask for axis in (0, 1)), mask])


@lru_cache(maxsize=1)
def packaged_network() -> WallNetwork:
    """The network with the weights that lie in the package, batch norms folded into the convolutions before them."""
    network = WallNetwork()
    data = resources.files("ursnav_torch.features").joinpath(WEIGHTS).read_bytes()
    network.load_state_dict({name: value.float() for name, value in load_weights(data).items()})
    return fold(network.eval().requires_grad_(False))


def fold(network: WallNetwork) -> WallNetwork:
    """The same function with each batch norm folded into the convolution before it, in place."""
    for block in [m for m in network.modules() if isinstance(m, _Block)]:
        block.convolution = nn.utils.fusion.fuse_conv_bn_eval(block.convolution, block.norm)
        block.norm = nn.Identity()  # type: ignore[assignment]
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


class _Block(nn.Module):
    """Convolution, batch norm, SiLU."""

    def __init__(self, channels: int, out: int, size: int = 3, stride: int = 1) -> None:
        super().__init__()
        padding = 0 if size == stride else size // 2
        self.convolution = nn.Conv2d(channels, out, size, stride, padding, bias=False)
        self.norm = nn.BatchNorm2d(out)

    def forward(self, x: Tensor) -> Tensor:
        """The block's answer (N, out, h, w)."""
        return functional.silu(self.norm(self.convolution(x)), inplace=True)


class _Before(nn.Module):
    """Convolutions that reach farther and farther: logits of `FOREGROUND`."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.each = nn.Conv2d(channels, _BEFORE_WIDTH, 1)
        self.near = nn.Conv2d(_BEFORE_WIDTH, _BEFORE_WIDTH, 3, padding=1)
        self.around = nn.Conv2d(_BEFORE_WIDTH, _BEFORE_WIDTH, 3, padding=2, dilation=2)
        self.far = nn.Conv2d(_BEFORE_WIDTH, _BEFORE_WIDTH, 3, padding=4, dilation=4)
        self.told = nn.Conv2d(_BEFORE_WIDTH, len(FOREGROUND), 1)

    def forward(self, x: Tensor) -> Tensor:
        """Logits (N, 3, h, w)."""
        y = functional.silu(self.each(x))
        for layer in (self.near, self.around, self.far):
            y = y + functional.silu(layer(y))
        return self.told(y)


def hues(log_image: Tensor, inside: Tensor) -> Tensor:
    """How hues (N, 3, H, W) differ from the picture's own, of log pictures (N, 3, H, W) within masks (N, H, W).

    Blue and red against green, less their medians, and the length of both in units of their usual size: what has
    another color than most of the picture is hardly wall, whatever the light. All are 0 in gray pictures.
    """
    inside = inside[:, None]
    against = log_image[:, ::2] - log_image[:, 1:2]
    off = (against - _median(against, inside)) * inside
    length = off.square().sum(1, keepdim=True).sqrt()
    return torch.cat([2 * off, (length / (_median(length, inside) + _LEAST_HUE)).clamp_max(_MOST_HUE)], 1)


def _median(x: Tensor, inside: Tensor) -> Tensor:
    """Medians (N, C, 1, 1) of (N, C, H, W) over every other row and column of masks (N, 1, H, W), 0 of nothing."""
    some, found = x[..., ::2, ::2].flatten(2).numpy(), np.zeros(x.shape[:2], np.float32)
    for i, mask in enumerate(inside[:, 0, ::2, ::2].flatten(1).numpy()):
        places = np.flatnonzero(mask > 0)
        if len(places):
            middle = (len(places) - 1) // 2  # of an even number the lower, as torch's, which takes four times as long
            found[i] = np.partition(some[i].take(places, 1), middle, 1)[:, middle]
    return torch.from_numpy(found)[..., None, None]


def _cells(x: Tensor) -> Tensor:
    """The pixels (N, C, H, W) of every cell as channels; torch's own way does not take no pictures."""
    n, channels, height, width = x.shape
    shape = (height // CELL, width // CELL)
    apart = x.reshape(n, channels, shape[0], CELL, shape[1], CELL).permute(0, 2, 4, 1, 3, 5)
    return apart.reshape(n, *shape, channels * CELL * CELL).permute(0, 3, 1, 2)  # channels last in memory


def _beside(coarse: Tensor, fine: Tensor) -> Tensor:
    """Coarse channels at the size of fine ones, before them."""
    return torch.cat(
        [functional.interpolate(coarse, size=fine.shape[-2:], mode="bilinear", align_corners=False), fine], 1
    )
