"""How sure a track's answer is: the calyces that its hypotheses leave, and how far off its pose may be."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import rotation_angle
from ursnav_torch.tracking.motion import Hypotheses

Array = NDArray[np.float64]
#: Added to a spread before its logarithm is taken, mm and degrees: hypotheses are no finer.
_FINEST_MM, _FINEST_DEG = 0.1, 1.0


@dataclass(frozen=True, slots=True)
class CertaintySettings:
    """How hypotheses are read as certainty; ``python -m benchmarks.certainty`` chose the numbers on flights through
    phantoms and judges them on others.

    Attributes:
        least_share: of the hypotheses' probability, from which on a calyx may be the one observed.
        position, direction: constant, and weights of the alignment's score and of the logarithm of the hypotheses'
            spread, in the logarithm of what two of three errors are within, mm and degrees at the kidney's scale 1.
    """

    least_share: float = 0.05
    position: tuple[float, float, float] = (0.9, -2.2, 0.25)
    direction: tuple[float, float, float] = (2.2, -2.0, 0.25)

    def __post_init__(self) -> None:
        for name in ("position", "direction"):
            object.__setattr__(self, name, tuple(float(w) for w in getattr(self, name)))
        if not 0 < self.least_share < 1 or len(self.position) != 3 or len(self.direction) != 3:
            raise InputError(
                "A track's certainty needs 0 < least_share < 1 and 3 weights each of position and direction, got "
                f"{self.least_share}, {self.position} and {self.direction}."
            )


@dataclass(frozen=True, slots=True)
class TrackCertainty:
    """How sure one answer is.

    Attributes:
        calyces: those that it may be, the answer first, -1 for none.
        position_sd_mm, direction_sd_deg: two of three errors are within these.
    """

    calyces: tuple[int, ...]
    position_sd_mm: float
    direction_sd_deg: float

    def later(self, mm: float, deg: float) -> "TrackCertainty":
        """The same after a motion that nobody saw, by its standard deviations."""
        position, direction = float(np.hypot(self.position_sd_mm, mm)), float(np.hypot(self.direction_sd_deg, deg))
        return TrackCertainty(self.calyces, position, direction)

    def of(self, calyx: int) -> "TrackCertainty":
        """The same of another answer."""
        return replace(self, calyces=(calyx, *(c for c in self.calyces if c != calyx)))


def track_certainty(
    calyx: int, share: Array, score: float, spread: tuple[float, float], settings: CertaintySettings, scale: float
) -> TrackCertainty:
    """How sure an answer is.

    Args:
        calyx: the answer, -1 for none.
        share: (C + 1,) of the probability that hypotheses give every calyx, and none; see `calyx_shares`.
        score: of the alignment.
        spread: of the hypotheses, mm and degrees, see `spread_of`.
        settings: how these are read.
        scale: the kidney's.
    """
    count = len(share) - 1
    order = [int(i) if i < count else -1 for i in np.argsort(-share, kind="stable")]
    calyces = (calyx, *(c for c in order if c != calyx and share[c] >= settings.least_share))
    mm, deg = (
        float(np.exp(np.dot(weights, numbers)))
        for weights, numbers in zip(
            (settings.position, settings.direction), error_numbers(score, spread, scale), strict=True
        )
    )
    return TrackCertainty(calyces, mm * scale, min(deg, 180.0))


def error_numbers(score: float, spread: tuple[float, float], scale: float) -> tuple[Array, Array]:
    """What errors in position and in direction are told from, (3,) each."""
    away, turned = np.log(spread[0] / scale + _FINEST_MM), np.log(spread[1] + _FINEST_DEG)
    return np.array([1.0, score, away]), np.array([1.0, score, turned])


def calyx_shares(hypotheses: Hypotheses, observed: NDArray[np.int64], calyx: int, count: int) -> Array:
    """(C + 1,) of the probability for every one of ``count`` calyces, the last for none.

    Args:
        hypotheses: (M) of the filter.
        observed: (M,) calyx that is observed from each, -1 for none.
        calyx: the calyx of the track's own pose, which counts half.
        count: how many calyces there are, C.
    """
    share = 0.5 * np.bincount(observed % (count + 1), hypotheses.weight, minlength=count + 1).astype(float)
    share[calyx] += 0.5
    return np.asarray(share)


def spread_of(hypotheses: Hypotheses, T: Array) -> tuple[float, float]:
    """Root mean square distance, mm, and turn, degrees, of hypotheses from a pose (4, 4)."""
    away = np.sum((hypotheses.T_kidney_camera[:, :3, 3] - T[:3, 3]) ** 2, axis=1)
    turned = np.degrees(rotation_angle(hypotheses.T_kidney_camera, T)) ** 2
    weight = hypotheses.weight
    return float(np.sqrt(weight @ away)), float(np.sqrt(weight @ turned))


def joined_certainty(ways: Sequence[TrackCertainty], calyx: int) -> TrackCertainty | None:
    """Of an answer joined from one or two ways through a video: the calyces that all leave, and the smallest errors.

    Args:
        ways: of the answers that are believed; None is known of none.
        calyx: the joined answer.
    """
    if not ways:
        return None
    left = [c for c in ways[0].calyces if c != calyx and all(c in way.calyces for way in ways)]
    mm, deg = (min(getattr(way, name) for way in ways) for name in ("position_sd_mm", "direction_sd_deg"))
    return TrackCertainty((calyx, *left), mm, deg)
