"""Dense pose verification: which of several aligned hypotheses a picture was taken from, told by a small network.

The correlation that alignment climbs weighs every pixel alike, a faint fold as much as the edge of a calyx, and a
hypothesis that is wrong climbs it, too. Here the view is drawn again from where each hypothesis ended and compared
with the picture pixel by pixel (Taira et al., InLoc, CVPR 2018), by a network that has seen which agreements and which
contradictions tell right hypotheses from wrong ones: it knows how much a drawn edge juts out, and how sure the wall
network was of what it read there. It compares only hypotheses of one picture (a conditional logit, McFadden 1974).

Its weights lie beside it and are made by ``python -m benchmarks.verification``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load as load_weights
from torch import Tensor, nn
from torch.nn import functional

from ursnav_torch.alignment.align import Aligned, Aligner
from ursnav_torch.alignment.fields import AlignGrid
from ursnav_torch.features import Features
from ursnav_torch.features.flatten import masked_blur

Array = NDArray[np.float64]

WEIGHTS = "verification.safetensors"
#: Maps that the network sees of each hypothesis, see `comparison_maps`.
MAPS = 15
_WIDTH = 16
_WEIGHT_MAP = 5  # its row among the maps
#: What is finer than this share of the picture's shorter side is detail of the depth.
_DETAIL = 0.048
_NEAREST_MM = 0.3
_SCORE_WEIGHT, _GAIN = 20.0, 10.0  # what the score counts before anything is learned; how fast the network learns


@dataclass(frozen=True, slots=True)
class ReadPicture:
    """A picture on an alignment grid (H, W).

    Attributes:
        relief: (H, W) as it is aligned.
        read: (5, H, W) see `Features.read`.
        weight: (H, W) how much each pixel counts.
    """

    relief: Tensor
    read: Tensor
    weight: Tensor


@dataclass(frozen=True, slots=True)
class Drawn:
    """K hypotheses drawn on the same grid.

    Attributes:
        relief: (K, H, W).
        distance: (K, H, W) mm at the kidney's scale 1, of the wall; inf where there is none.
    """

    relief: Tensor
    distance: Tensor


class VerificationNetwork(nn.Module):
    """Three convolutions and a mean over what is valid: 5 thousand weights."""

    def __init__(self) -> None:
        super().__init__()
        self.each = nn.Conv2d(MAPS, _WIDTH, 1)
        self.near = nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1, stride=2)
        self.around = nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1)
        self.drop = nn.Dropout(0.1)
        self.sum = nn.Linear(_WIDTH, 1, bias=False)
        self.score = nn.Parameter(torch.tensor(_SCORE_WEIGHT))
        nn.init.zeros_(self.sum.weight)

    def forward(self, maps: Tensor, score: Tensor) -> Tensor:
        """Log-odds (K,), up to a constant, of maps (K, `MAPS`, H, W) and scores (K,) of alignment."""
        weight = functional.avg_pool2d(maps[:, _WEIGHT_MAP, None], 2, ceil_mode=True)
        y = functional.silu(self.each(maps))
        y = functional.silu(self.around(functional.silu(self.near(y))))
        mean = (y * weight).sum((2, 3)) / weight.sum((2, 3)).clamp_min(1)
        return _GAIN * self.sum(self.drop(mean))[:, 0] + self.score * score


class Verifier:
    """Verifies hypotheses in one kidney, seen through one lens.

    Args:
        aligner: draws them, at the size at which they are compared.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
        network: the package's own when None.
    """

    def __init__(self, aligner: Aligner, unit_mm: float = 1.0, network: VerificationNetwork | None = None) -> None:
        self._aligner, self._unit_mm = aligner, unit_mm
        self._network = network or packaged_verification()

    def log_odds(self, features: Features, hypotheses: Sequence[Aligned]) -> Array:
        """(K,) log-odds, up to a constant, that each hypothesis is where a picture was taken from.

        Args:
            features: of the picture, with what the wall network read.
            hypotheses: of that picture, aligned to the same degree.
        """
        grid = self._aligner.grid
        with torch.inference_mode():
            maps = comparison_maps(seen_on(grid, features), self.drawn(hypotheses), torch.from_numpy(grid.compared))
            odds = self._network(maps, torch.tensor([h.score for h in hypotheses]))
        return np.asarray(odds.numpy(), float)

    def drawn(self, hypotheses: Sequence[Aligned]) -> Drawn:
        """Hypotheses drawn from where they ended, in the light found."""
        T, lights = np.stack([h.T_kidney_camera for h in hypotheses]), np.stack([h.light for h in hypotheses])
        relief, distance = map(torch.from_numpy, self._aligner.looks(T, lights))
        return Drawn(relief, distance / self._unit_mm)


def seen_on(grid: AlignGrid, features: Features) -> ReadPicture:
    """A picture on a grid."""
    picture = grid.of_picture(features)
    relief, weight = (torch.from_numpy(part) for part in (picture.value[0], picture.weight))
    return ReadPicture(relief, torch.from_numpy(grid.small(features.read)), weight)


def comparison_maps(seen: ReadPicture, drawn: Drawn, compared: Tensor) -> Tensor:
    """Maps (K, `MAPS`, H, W): the picture, each drawing, and how they agree, where they are compared (H, W).

    Of the picture: the relief as it is aligned and as it was read, how unsure relief and depth are, how much a pixel
    counts, detail of the depth. Of the drawing: relief, detail of the depth, how much the wall juts out. Of both:
    products of the reliefs, of their gradients and of the details, and by how much the log depths differ.
    """
    mask = compared.float()
    relief_variance, log_depth, depth_variance, clear = seen.read[1:]
    weight = seen.weight * clear * mask
    count = weight.sum().clamp_min(1)

    def standard(x: Tensor) -> Tensor:
        size = (x.square() * weight).sum((-2, -1), keepdim=True) / count
        return x * mask / (size + 1e-6).sqrt()

    def detail(x: Tensor) -> Tensor:
        return (x - masked_blur(x, mask, _DETAIL * min(mask.shape))) * mask

    aligned, read, relief = standard(seen.relief), standard(seen.read[0]), standard(drawn.relief)
    depth = torch.where(torch.isfinite(drawn.distance), drawn.distance.clamp_min(_NEAREST_MM).log(), 0.0) * mask
    log_depth = log_depth * mask
    off = depth - log_depth
    off = (off - (off * weight).sum((-2, -1), keepdim=True) / count) * mask
    fine_seen, fine_drawn = 4 * detail(log_depth), 4 * detail(depth)
    jut = (4 * torch.hypot(*_slopes(depth)) * mask).clamp_max(3)
    of_picture = [aligned, read, (relief_variance + 1) * mask, (depth_variance + 2) * mask, weight, fine_seen]
    a, b, sure, sure_depth, counts, fine = (x.expand_as(relief) for x in of_picture)
    return torch.stack([
        relief, a, b, sure, sure_depth, counts, fine_drawn, fine, jut, off.clamp(-2, 2), relief * a, relief * b,
        _along(relief, aligned), _along(relief, read), fine_drawn * fine,
    ], 1)  # fmt: skip


def _slopes(x: Tensor) -> tuple[Tensor, Tensor]:
    """Central differences of (..., H, W) per px in x and y, 0 at the border."""
    along, down = torch.zeros_like(x), torch.zeros_like(x)
    along[..., 1:-1] = (x[..., 2:] - x[..., :-2]) / 2
    down[..., 1:-1, :] = (x[..., 2:, :] - x[..., :-2, :]) / 2
    return along, down


def _along(drawn: Tensor, seen: Tensor) -> Tensor:
    """How much gradients of (K, H, W) and (H, W) point the same way, softly normalized."""
    (ax, ay), (bx, by) = _slopes(drawn), _slopes(seen)
    return (ax * bx + ay * by) / (torch.hypot(ax, ay) * torch.hypot(bx, by) + 0.05).sqrt()


@lru_cache(maxsize=1)
def packaged_verification() -> VerificationNetwork:
    """The network with the weights that lie in the package."""
    network = VerificationNetwork()
    data = resources.files("ursnav_torch.alignment").joinpath(WEIGHTS).read_bytes()
    network.load_state_dict({name: value.float() for name, value in load_weights(data).items()})
    return network.eval().requires_grad_(False)
