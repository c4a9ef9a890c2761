"""Light: how a wall's distance and slope become gray values.

``flat`` is the thesis's VID (§3.4, no light source: every wall equally bright, shape shows only through a
constant directional term); ``headlight`` is a point light at or beside the camera, as a scope has.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError

Floats = NDArray[np.floating]


class Light(Protocol):
    """Turns geometry into gray values."""

    def shade(self, points_mm: Floats, normals: Floats) -> Floats:
        """Gray values (N,) in 0..1 of wall points (N, 3) with unit normals (N, 3), both in the camera frame."""
        ...


@dataclass(frozen=True, slots=True)
class FlatLight:
    """Light from everywhere: brightness depends on the wall's slope to the viewing ray alone, not on distance."""

    ambient: float = 0.35

    def shade(self, points_mm: Floats, normals: Floats) -> Floats:
        """See `Light.shade`."""
        toward = -np.sum(points_mm * normals, axis=-1) / np.maximum(np.linalg.norm(points_mm, axis=-1), 1e-9)
        return self.ambient + (1 - self.ambient) * np.clip(toward, 0, 1)


@dataclass(frozen=True, slots=True)
class HeadLight:
    """A point light with inverse-square fall-off, gamma and automatic exposure.

    Args:
        offset_mm: where the light sits in the camera frame.
        gamma: gray = radiance ** (1 / gamma).
        exposure_percentile: the percentile of gray values that auto-exposure brings to ``exposure_level``.
        exposure_level: gray level in 0..1 of that percentile.
        reach_mm: radiance is ``1 / (distance² + reach_mm²)``; the extent of the light keeps near walls finite.
        ambient: share of light scattered by the wall all around, which fills what the light cannot reach.
    """

    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gamma: float = 2.2
    exposure_percentile: float = 90.0
    exposure_level: float = 0.8
    reach_mm: float = 4.0
    ambient: float = 0.02
    _offset: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.gamma <= 0 or not 0 < self.exposure_percentile <= 100 or len(self.offset_mm) != 3:
            raise InputError(
                f"The headlight needs gamma > 0, exposure_percentile in (0, 100] and three offsets in mm; got "
                f"gamma={self.gamma}, exposure_percentile={self.exposure_percentile}, offset_mm={self.offset_mm}."
            )
        object.__setattr__(self, "_offset", np.asarray(self.offset_mm, float))

    def shade(self, points_mm: Floats, normals: Floats) -> Floats:
        """See `Light.shade`."""
        if len(points_mm) == 0:
            return np.zeros(0)
        x, y, z = (at - place for at, place in zip(self._offset, points_mm.T, strict=True))  # axis by axis is faster
        square = x * x + y * y + z * z
        cosine = (x * normals[:, 0] + y * normals[:, 1] + z * normals[:, 2]) / np.sqrt(np.maximum(square, 1e-12))
        radiance = (np.clip(cosine, 0, 1) + self.ambient) / (square + self.reach_mm**2)
        reference = percentile(radiance, self.exposure_percentile)
        gray = self.exposure_level * (radiance / max(float(reference), 1e-12)) ** (1 / self.gamma)
        return np.clip(gray, 0, 1)


def percentile(values: Floats, q: float) -> Floats:
    """`numpy.percentile` over the last axis (..., N) of finite numbers, without its look for others."""
    place = q / 100 * (values.shape[-1] - 1)
    low = int(place)
    high = min(low + 1, values.shape[-1] - 1)
    ordered = np.partition(values, (low, high), axis=-1)
    return np.asarray(ordered[..., low] + (place - low) * (ordered[..., high] - ordered[..., low]))
