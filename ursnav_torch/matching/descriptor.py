"""Log-polar shape contexts, batched.

Belongie, Malik, Puzicha: Shape matching and object recognition using shape contexts, PAMI 2002, section 3.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from ursnav_torch.errors import InputError, ShapeError
from ursnav_torch.matching.neighbors import (
    ahead,
    differences,
    padded_far,
    pair_bins,
    repeated,
    sets_at_a_time,
    slices,
)
from ursnav_torch.threads import map_chunks

#: What one thread takes at once, in pieces whose pairs fit the cache: its memory is made once for all of them.
_PARTS = 16


@dataclass(frozen=True, slots=True)
class ShapeContext:
    """How a point sees its neighbors.

    Attributes:
        radial_bins: rings; the innermost reaches from 0 to `r_inner`, the others are even in log radius.
        angular_bins: sectors of a ring.
        r_inner: outer edge of the innermost ring, in units of `scale`.
        r_outer: outer edge of the outermost ring, in units of `scale`; neighbors farther away are not counted.
        scale: px a unit. A number holds for every set; "database" is the mean distance between two points of a
            set, averaged over the database; "own" is each set's own mean distance (invariant to scale, but
            fooled by missing edges).
        frame: "absolute" measures angles from the image's x axis, "tangent" from the edge's own direction, for
            an unknown roll.
    """

    radial_bins: int = 5
    angular_bins: int = 12
    r_inner: float = 0.1
    r_outer: float = 1.0
    scale: float | Literal["database", "own"] = "database"
    frame: Literal["absolute", "tangent"] = "absolute"

    def __post_init__(self) -> None:
        if self.radial_bins < 2 or self.angular_bins < 1:
            raise InputError(
                f"A shape context needs at least 2 radial bins and 1 angular bin, "
                f"got {self.radial_bins} and {self.angular_bins}."
            )
        if not 0 < self.r_inner < self.r_outer:
            raise InputError(f"Expected 0 < r_inner < r_outer, got {self.r_inner} and {self.r_outer}.")
        if self.frame not in ("absolute", "tangent"):
            raise InputError(f"frame is {self.frame!r}; accepted are 'absolute' and 'tangent'.")
        named = self.scale in ("database", "own")
        if not named and (isinstance(self.scale, str) or not 0 < self.scale < math.inf):
            raise InputError(f"scale is {self.scale!r}; accepted are a number of px, 'database' and 'own'.")

    @property
    def size(self) -> int:
        """Numbers a point, D."""
        return self.radial_bins * self.angular_bins

    def radii(self) -> Tensor:
        """Outer edges of the rings (radial_bins,) in units of `scale`."""
        log_inner, log_outer = math.log10(self.r_inner), math.log10(self.r_outer)
        return torch.logspace(log_inner, log_outer, self.radial_bins, dtype=torch.float64)


def mean_distances(points: Tensor, mask: Tensor) -> Tensor:
    """Mean distance between two points of each set (B,) in px; nan for sets with fewer than two points."""
    out, width, whole = torch.empty(len(points)), points.shape[1], bool(mask.all())

    def work(part: slice) -> None:
        for some in slices(part, width):
            x, y = differences(points[some].float())
            distance = x.mul_(x).addcmul_(y, y).sqrt_()
            if repeated(width):
                distance[:, -1] /= 2
            counts = mask[some].float()
            if not whole:
                distance.mul_(ahead(counts)).mul_(counts[:, None])
            count = counts.sum(1)
            out[some] = distance.sum((1, 2)) * 2 / (count * (count - 1))

    map_chunks(work, len(points), _PARTS * sets_at_a_time(width), float(10 * len(points) * width**2))
    return out


def fix_scale(settings: ShapeContext, points: Tensor, mask: Tensor) -> ShapeContext:
    """`settings` with the scale "database" replaced by the number of px that these sets (B, P, 2) give."""
    if settings.scale != "database":
        return settings
    scales = mean_distances(points, mask)
    scales = scales[torch.isfinite(scales) & (scales > 0)]
    return replace(settings, scale=float(scales.double().mean()) if len(scales) else 1.0)


def describe(
    points: Tensor,
    mask: Tensor,
    settings: ShapeContext,
    tangents: Tensor | None = None,
    weights: Tensor | None = None,
) -> Tensor:
    """Shape contexts of every point.

    A neighbor at the point's very place has no direction and is not counted. A point with no neighbor in reach
    gets an even histogram. Bins are turned by a quarter of a sector (half of one in the tangent frame), so that
    neither level, upright nor diagonal pixel edges, nor the tangent itself, lie on a border between two bins.

    Args:
        points: (B, P, 2) px, x right, y down.
        mask: (B, P) bool, true where there is a point.
        settings: bins, radii, scale and frame.
        tangents: (B, P) direction of the edge in radians, x towards y; needed in the tangent frame.
        weights: (B, P) how much a point counts as somebody's neighbor, >= 0; 1 where left out.

    Returns:
        (B, P, D) float32 histograms that sum to 1, all zero where the mask is false.

    Raises:
        ShapeError: shapes do not fit together.
        InputError: the tangent frame without tangents, or the scale is still "database".
    """
    _check(points, mask, settings, tangents, weights)
    width = points.shape[1]
    out = torch.empty(*mask.shape, settings.size)
    unit = padded_far((points / _scales(settings, points, mask)[:, None, None]).float(), mask)
    phase = _phase(settings, tangents)
    counts = None if weights is None else weights.float()

    def work(part: slice) -> None:
        bins = pair_bins(part.stop - part.start, width, settings.radii(), settings.angular_bins)
        for some in slices(part, width):
            turned = phase[some] if isinstance(phase, Tensor) else phase
            own = bins.count(unit[some], turned, None if counts is None else counts[some])
            out[some] = own.flatten(2)

    map_chunks(work, len(points), _PARTS * sets_at_a_time(width), float(100 * len(points) * width**2))
    sums = out.sum(2, keepdim=True)
    out.div_(sums.clamp_min(1e-30))
    alone = sums[..., 0] <= 0
    if bool(alone.any()):
        out[alone] = 1 / settings.size
    return out if bool(mask.all()) else out.mul_(mask[:, :, None])


def _check(
    points: Tensor, mask: Tensor, settings: ShapeContext, tangents: Tensor | None, weights: Tensor | None
) -> None:
    if points.ndim != 3 or points.shape[2] != 2 or mask.shape != points.shape[:2]:
        raise ShapeError(
            f"Expected points (B, P, 2) and mask (B, P), got {tuple(points.shape)} and {tuple(mask.shape)}."
        )
    for name, rows in (("tangents", tangents), ("weights", weights)):
        if rows is not None and rows.shape != mask.shape:
            raise ShapeError(f"{name} must have shape {tuple(mask.shape)}, got {tuple(rows.shape)}.")
    if settings.frame == "tangent" and tangents is None:
        raise InputError("The tangent frame needs the edge direction of every point; give `tangents` (B, P).")
    if settings.scale == "database":
        raise InputError("scale is 'database', but there is none here; call fix_scale() with the database first.")


def _scales(settings: ShapeContext, points: Tensor, mask: Tensor) -> Tensor:
    """Px a unit for each set (B,)."""
    if settings.scale != "own":
        return torch.full((len(points),), float(settings.scale))
    scales = mean_distances(points, mask)
    return torch.where(torch.isfinite(scales) & (scales > 0), scales, torch.ones(()))


def _phase(settings: ShapeContext, tangents: Tensor | None) -> Tensor | float:
    """Sectors, (B, P) or the same for all, by which directions are turned before they are rounded down to one."""
    if settings.frame == "absolute" or tangents is None:
        return 0.25
    return 0.5 - tangents.float() * (settings.angular_bins / math.tau)
