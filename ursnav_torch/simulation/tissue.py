"""What an operation does to the kidney and to what the scope sees of it: breath, irrigation, bleeding; from a seed.

Each is switched on by itself. Where a figure is published it is used and named; where we know of none, the range is
wide on purpose, so that what holds over it does not hang on a guess.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array

#: Bleedings are drawn for so long; an operation is shorter.
_LONGEST_S = 7200.0
#: A bleeding reaches its peak in this part of the time in which irrigation then washes it out.
_ONSET = 0.15
#: Blue, green and red of blood in a scope's light, as it fills the picture.
_BLOOD_BGR = np.array([18.0, 14.0, 96.0])
#: Wall that moves by less than this is not drawn anew, mm at scale 1.
_REDRAWN_MM = 0.25

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class TissueSettings:
    """What is drawn for one operation; mm at the kidney's scale 1. A pair is a range, but for ``breathing_mm``.

    Attributes:
        breathes, swells, bleeds, buckles: what is switched on.
        breathing_mm: mean and standard deviation of the way that the kidney's surface makes with a breath: 4 +- 2 mm,
            as the twin was asked for. The whole kidney moves by more (Langen and Jones, Int. J. Radiat. Oncol. 50:265,
            2001), but the scope lies in it.
        slips: part of that way by which the scope does not follow; no published figure found, wide on purpose.
        breaths_per_min: of a ventilated patient; usual settings.
        swelling_mm: how far irrigation moves the wall outwards in the end; no published figure found, wide on purpose.
        swelling_s: time constant of filling; no published figure found, wide on purpose.
        bleedings_per_min: episodes; no published figure found, wide on purpose.
        bleeding_peak: part of the picture's light that an episode takes at its worst; no published figure found.
        bleeding_s: in which irrigation washes it out; no published figure found, wide on purpose.
        friction: of the shaft, by which it buckles as it is pushed, see `Scope`; no published figure found, wide on
            purpose.
    """

    breathes: bool = True
    swells: bool = True
    bleeds: bool = True
    buckles: bool = True
    breathing_mm: Span = (4.0, 2.0)
    slips: Span = (0.1, 0.6)
    breaths_per_min: Span = (10.0, 20.0)
    swelling_mm: Span = (0.2, 1.5)
    swelling_s: Span = (15.0, 120.0)
    bleedings_per_min: Span = (0.2, 2.0)
    bleeding_peak: Span = (0.3, 0.95)
    bleeding_s: Span = (2.0, 15.0)
    friction: Span = (0.05, 0.4)

    def __post_init__(self) -> None:
        spans = (self.slips, self.breaths_per_min, self.swelling_mm, self.swelling_s, self.bleedings_per_min,
                 self.bleeding_peak, self.bleeding_s, self.friction)  # fmt: skip
        if any(not 0 <= low <= high for low, high in spans) or min(self.breathing_mm) < 0:
            raise InputError(f"Ranges of tissue go from low to high and begin at 0 or more, got {self}.")
        if min(self.breaths_per_min[0], self.swelling_s[0], self.bleeding_s[0]) <= 0 or self.bleeding_peak[1] > 1:
            raise InputError(f"Tissue needs times and rates of breath above 0 and bleeding_peak up to 1, got {self}.")


#: Tissue that does nothing.
CALM = TissueSettings(breathes=False, swells=False, bleeds=False, buckles=False)


class Tissue:
    """One operation's disturbances as functions of time.

    Args:
        settings: what there is.
        rng: draws this operation's.
        scale: the kidney's.

    Attributes:
        friction: of the shaft, for `Scope`; 0 where it does not buckle.
    """

    def __init__(self, settings: TissueSettings, rng: np.random.Generator, scale: float = 1.0) -> None:
        s = self.settings = settings
        way = max(float(rng.normal(*s.breathing_mm)), 0.0) * float(rng.uniform(*s.slips))
        direction = rng.standard_normal(3)
        self._breath = scale * way * direction / np.linalg.norm(direction) * s.breathes
        self._period_s, self._power = 60 / float(rng.uniform(*s.breaths_per_min)), int(rng.integers(1, 4))
        self._swollen_mm = scale * float(rng.uniform(*s.swelling_mm)) * s.swells
        self._filling_s = float(rng.uniform(*s.swelling_s))
        gaps = rng.exponential(60 / max(float(rng.uniform(*s.bleedings_per_min)), 1e-9), 400)
        begins = np.cumsum(gaps)
        self._begins_s = begins[begins < _LONGEST_S * s.bleeds]
        self._peaks = rng.uniform(*s.bleeding_peak, len(begins))[: len(self._begins_s)]
        self._washed_s = rng.uniform(*s.bleeding_s, len(begins))[: len(self._begins_s)]
        self.friction = float(rng.uniform(*s.friction)) * s.buckles
        self._scale = scale

    def breath_mm(self, t_s: float) -> Array:
        """(3,) mm, kidney frame: by how much the scope is off its place in the kidney.

        The way goes as an even power of a cosine, which stays longer at the end of expiration (Lujan et al.,
        Med. Phys. 26:715, 1999).
        """
        return self._breath * (np.cos(np.pi * t_s / self._period_s) ** (2 * self._power) - 0.5)

    def swollen_mm(self, t_s: float) -> float:
        """How far the wall lies outwards of where it was, mm."""
        return self._swollen_mm * float(1 - np.exp(-max(t_s, 0.0) / self._filling_s))

    def redrawn_mm(self, t_s: float) -> float:
        """The same in steps, so that a kidney need not be drawn anew for every picture."""
        step = _REDRAWN_MM * self._scale
        return step * round(self.swollen_mm(t_s) / step)

    def blood(self, t_s: float) -> float:
        """Part of the picture's light that blood takes, 0 to 1; episodes that meet take the more of both."""
        since = t_s - self._begins_s
        on = since >= 0
        if not on.any():
            return 0.0
        risen = np.clip(since[on] / (_ONSET * self._washed_s[on]), 0.0, 1.0)
        washed = np.exp(-np.maximum(since[on] - _ONSET * self._washed_s[on], 0.0) / (self._washed_s[on] / 3))
        return float((self._peaks[on] * risen * washed).max())

    def clearance(self, clearance_mm: Callable[[Array], Array], clock: Callable[[], float]) -> Callable[[Array], Array]:
        """Distances (N,) of points (N, 3) to the wall as it is now, from those to the wall as it was, mm."""
        if not self.settings.swells:
            return clearance_mm
        return lambda points_mm: clearance_mm(points_mm) + self.swollen_mm(clock())

    def picture(self, image: NDArray[np.uint8], t_s: float) -> NDArray[np.uint8]:
        """A picture (H, W) or (H, W, 3) through the blood of now."""
        share = self.blood(t_s)
        if share < 0.01:
            return image
        veil = _BLOOD_BGR if image.ndim == 3 else _BLOOD_BGR.mean()
        return np.rint((1 - share) * image + share * veil).astype(np.uint8)


def draw_tissue(settings: TissueSettings | None, seed: int | list[int], scale: float = 1.0) -> Tissue:
    """The tissue of a seed; without settings it is calm."""
    return Tissue(settings or CALM, np.random.default_rng(seed), scale)
