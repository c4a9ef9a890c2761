"""What locating a picture gives."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.alignment import Refined
from ursnav_torch.features import Features
from ursnav_torch.localization.evidence import Evidence
from ursnav_torch.search import Ranking

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One view that fits.

    Attributes:
        view: index into the VID.
        distance: lower is nearer, 0 is a perfect fit.
        T_kidney_camera: (4, 4), the view's pose turned by the roll found.
    """

    view: int
    distance: float
    T_kidney_camera: Array


@dataclass(frozen=True, slots=True)
class Location:
    """Where a picture was taken.

    Attributes:
        calyx: index of the calyx observed, -1 for none (pelvis, infundibulum).
        calyx_name: its name, blank for none.
        T_kidney_camera: (4, 4).
        view: the best view.
        distance: its distance.
        confidence: calibrated probability that ``calyx`` is right; nan where none was learned with these settings.
        accepted: false when the system would rather say "unsure".
        calyces: names of the smallest set that holds the right calyx with the probability asked for, ``none`` in it
            when the picture may show no calyx, the answer first; empty where nothing was learned.
        position_sd_mm, direction_sd_deg: two of three errors are within these; nan where nothing was learned.
        novelty: how unlike anything learned from the picture looks, see `Certainty`; nan likewise.
        candidates: the best views, best first.
        features: what was seen in the picture.
        seconds: from picture to pose.
    """

    calyx: int
    calyx_name: str
    T_kidney_camera: Array
    view: int
    distance: float
    confidence: float
    accepted: bool
    calyces: tuple[str, ...]
    position_sd_mm: float
    direction_sd_deg: float
    novelty: float
    candidates: tuple[Candidate, ...]
    features: Features
    seconds: float


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a picture's features say.

    Attributes:
        ranking: the nearest views, and the picture's pose as each of them has it.
        calyces: (K,) calyx observed from there, -1 for none.
        calyx: the answer.
        voted: the calyx that the nearest views vote for.
        nearest: what the nearest views alone say of ``voted``.
        evidence: what certainty of ``calyx`` is computed from; with the alignment's numbers where there was one.
        refined: the refined pose, None where refinement is off.
        believed: whether its drawing fits well enough to say which place it is.
    """

    ranking: Ranking
    calyces: NDArray[np.int64]
    calyx: int
    voted: int
    nearest: Evidence
    evidence: Evidence
    refined: Refined | None
    believed: bool
