"""How sure a track's answer is: the calyces that its hypotheses leave, and how far off its pose may be."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import rotation_angle
from ursnav_torch.localization.certainty import LEVELS
from ursnav_torch.localization.learned import PositionErrors, TrackWeights, packaged_models
from ursnav_torch.tracking.motion import Hypotheses
from ursnav_torch.tracking.relocalization import Relocated

Array = NDArray[np.float64]
#: Added to a spread before its logarithm is taken, mm and degrees: hypotheses are no finer.
_FINEST_MM, _FINEST_DEG = 0.1, 1.0
#: Radius, in standard deviations of an axis, within which two of three points of a Gaussian in space are (chi, 3).
_RADIUS_SD = 1.88
#: Before anything was learned: a twentieth of the hypotheses' probability keeps a calyx in the set, and errors fall
#: from about 1 mm and 6 degrees at a score of 0.4 to a third of that at 0.9.
_UNLEARNED_POSITION = PositionErrors((0.9, -2.2, 0.1), 1.84)
UNLEARNED = TrackWeights((0.05,) * len(LEVELS), _UNLEARNED_POSITION, _UNLEARNED_POSITION, (2.7, -2.2, 0.1))


@dataclass(frozen=True, slots=True)
class TrackCertaintySettings:
    """Which calyces a track leaves, and when it is at a place.

    Attributes:
        set_probability: with which they hold the right one.
        largest_mm: a region that holds the position with 90 % and reaches farther than this from the pose is no place.
            Where a place more than 3 mm off counts as 3.3 that are missing, 3, 4, 5 and 6 mm are worth 94.9, 95.4, 94.3
            and 93.9 % of the choosing flights' poses without a robot's word, and 97.6, 97.9, 97.8 and 97.8 % with it,
            each phantom's errors told by the others' weights (`benchmarks.flights phantoms=16 half=choosing fit=true`).
    """

    set_probability: float = 0.95
    largest_mm: float = 4.0

    def __post_init__(self) -> None:
        if not self.largest_mm > 0:
            raise InputError(f"Expected largest_mm > 0, got {self.largest_mm}.")
        if not 0 < self.set_probability < 1:
            raise InputError(f"Expected 0 < set_probability < 1, got {self.set_probability}.")


@dataclass(frozen=True, slots=True)
class TrackEvidence:
    """What the filter and the alignment say of one answer.

    Attributes:
        calyx: the answer, -1 for none.
        share: (C + 1,) of the probability that hypotheses give every calyx, and none.
        score: of the alignment.
        spread_mm, spread_deg: root mean square distance and turn of the hypotheses from the pose; mm at scale 1.
    """

    calyx: int
    share: Array
    score: float
    spread_mm: float
    spread_deg: float

    def error_numbers(self) -> tuple[Array, Array]:
        """What errors in position and in direction are told from, (3,) each."""
        away, turned = np.log(self.spread_mm + _FINEST_MM), np.log(self.spread_deg + _FINEST_DEG)
        return np.array([1.0, self.score, away]), np.array([1.0, self.score, turned])


@dataclass(frozen=True, slots=True)
class TrackCertainty:
    """How sure one answer is.

    Attributes:
        calyces: those that it may be, the answer first, -1 for none.
        position_sd_mm, direction_sd_deg: two of three errors are within these.
        evidence: what they were computed from.
        region_sd: standard deviations within which nine of ten positions are.
    """

    calyces: tuple[int, ...]
    position_sd_mm: float
    direction_sd_deg: float
    evidence: TrackEvidence
    region_sd: float

    @property
    def region_mm(self) -> float:
        """Radius of the region about the pose that holds the position with 90 %."""
        return self.region_sd * self.position_sd_mm

    def sensed(self, sigma_mm: float) -> "TrackCertainty":
        """The same with a sensor's word on the position, an axis's standard deviation of which is ``sigma_mm``."""
        within = _RADIUS_SD * sigma_mm
        return replace(self, position_sd_mm=float(1 / np.hypot(1 / self.position_sd_mm, 1 / within)))

    def relocated(self, T: Array, found: Relocated) -> "TrackCertainty":
        """The same of a pose (4, 4) whose picture was surely found by itself: errors are those of where, and how far
        the pose is from there."""
        apart = float(np.linalg.norm(found.T_kidney_camera[:3, 3] - T[:3, 3]))
        return replace(self, position_sd_mm=min(self.position_sd_mm, float(np.hypot(found.position_sd_mm, apart))))

    def later(self, mm: float, deg: float) -> "TrackCertainty":
        """The same after a motion that nobody saw, by its standard deviations."""
        position, direction = float(np.hypot(self.position_sd_mm, mm)), float(np.hypot(self.direction_sd_deg, deg))
        return replace(self, position_sd_mm=position, direction_sd_deg=direction)

    def of(self, calyx: int) -> "TrackCertainty":
        """The same of another answer."""
        return replace(self, calyces=(calyx, *(c for c in self.calyces if c != calyx)))


def track_weights() -> TrackWeights:
    """How evidence is read, as the package learned it."""
    packaged = packaged_models()
    return UNLEARNED if packaged is None or packaged.track is None else packaged.track


def track_evidence(
    hypotheses: Hypotheses, observed: NDArray[np.int64], calyx: int, T: Array, score: float, scale: float
) -> TrackEvidence:
    """Evidence of one answer.

    Args:
        hypotheses: (M) of the filter.
        observed: (M,) calyx that is observed from each, -1 for none.
        calyx: of the answer, which counts half.
        T: (4, 4) the answer.
        score: of its alignment.
        scale: the kidney's.
    """
    count = hypotheses.to_tips_mm.shape[1]
    share = 0.5 * np.bincount(observed % (count + 1), hypotheses.weight, minlength=count + 1).astype(float)
    share[calyx] += 0.5
    away = np.sum((hypotheses.T_kidney_camera[:, :3, 3] - T[:3, 3]) ** 2, axis=1)
    turned = np.degrees(rotation_angle(hypotheses.T_kidney_camera, T)) ** 2
    mm, deg = (float(np.sqrt(hypotheses.weight @ square)) for square in (away, turned))
    return TrackEvidence(calyx, share, score, mm / scale, deg)


def track_certainty(
    evidence: TrackEvidence, weights: TrackWeights, errors: PositionErrors, set_probability: float, scale: float
) -> TrackCertainty:
    """How sure an answer is; ``errors`` are the weights' with a robot's word or without, ``scale`` is the kidney's."""
    share, calyx = evidence.share, evidence.calyx
    row = int(np.searchsorted(LEVELS, set_probability - 1e-9))
    least = weights.least_share[row] if row < len(LEVELS) else 0.0
    order = [int(i) if i < len(share) - 1 else -1 for i in np.argsort(-share, kind="stable")]
    calyces = (calyx, *(c for c in order if c != calyx and share[c] >= least))
    away, turned = evidence.error_numbers()
    mm, deg = float(np.exp(away @ np.array(errors.weights))), float(np.exp(turned @ np.array(weights.direction)))
    return TrackCertainty(calyces, mm * scale, min(deg, 180.0), evidence, errors.region_sd)


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
    return TrackCertainty((calyx, *left), mm, deg, ways[0].evidence, ways[0].region_sd)
