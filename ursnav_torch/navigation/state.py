"""What navigation knows at one moment, frozen, for whoever looks at it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.devices import Frame
from ursnav_torch.exploration.coverage import CalyxCoverage
from ursnav_torch.exploration.route import Route
from ursnav_torch.features import EdgePoints
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.stones import NO_STONES, StoneList
from ursnav_torch.tracking.tracker import SEARCHING

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Latency:
    """Where the time from a picture to its pose went, seconds.

    Attributes:
        waiting_s: for a stage to be free, from the picture's capture on.
        features_s: extracting features.
        tracking_s: matching, refinement and filter.
        total_s: from capture until the pose was on the bus.
        painting_s: coverage and route, which go on beside and hold nobody up; of the last picture painted.
    """

    waiting_s: float = 0.0
    features_s: float = 0.0
    tracking_s: float = 0.0
    total_s: float = 0.0
    painting_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Guidance:
    """What was seen and where to go, as of the last picture painted.

    Attributes:
        place: name of the branch that the scope is in: ``pelvis``, ``infundibulum to A, B`` or ``calyx A``.
        coverage: the verdict on every calyx.
        seen: (P,) which patches of the wall were seen.
        route: the way to the calyx chosen, else to the nearest that was not inspected; None when all were.
        turn: the next move along it, in words.
        chosen: name of the calyx that the operator asked for; blank when navigation proposes one.
        stones: those that pictures showed so far, beside the known ones.
    """

    place: str = ""
    coverage: tuple[CalyxCoverage, ...] = ()
    seen: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    route: Route | None = None
    turn: str = ""
    chosen: str = ""
    stones: StoneList = NO_STONES


@dataclass(frozen=True, slots=True, eq=False)
class NavigationState:
    """Everything that observers show.

    Attributes:
        version: rises by one with every state.
        frame: the picture that the pose belongs to.
        edges: the picture's edge points; None where it showed too few, or nobody draws them.
        tracking: ``tracking``, ``searching`` or ``lost``.
        T_kidney_camera: (4, 4), or None unless tracking.
        seen_s: when the last picture was taken that showed where the scope is; later poses are only expected.
        calyx: name of the calyx observed; blank for none.
        calyces: names of those that it may be, the observed one first.
        confidence: probability that this is right.
        position_sd_mm: two of three errors in position are within this; None unless tracking.
        slack_mm: play of the robot's slider, learned; None without a robot.
        places: (K, 4) x, y, z in the kidney frame and probability of the likeliest hypotheses.
        bodies: stones and instruments found in the picture.
        guidance: coverage and route.
        path_mm: (N, 3) where the scope has been, kidney frame; a jump of the track is one long step.
        latency: of this picture.
        effort: 0 for all that tracking can do; more when a slow machine makes it spend less, see `effort.WORDS`.
        stale: no picture has been located for a while; the pose is old.
        robot: ``disarmed``, ``armed``, ``stopped``, or blank without a robot.
        autonomy: what exploring by itself is doing and why, in words; blank without it.
        notice: the last warning of a device.
        status: all of it in one line of plain words.
        ended: nothing will follow.
    """

    version: int = 0
    frame: Frame | None = None
    edges: EdgePoints | None = None
    tracking: str = SEARCHING
    T_kidney_camera: Array | None = None
    seen_s: float = -np.inf
    calyx: str = ""
    calyces: tuple[str, ...] = ()
    confidence: float = 0.0
    position_sd_mm: float | None = None
    slack_mm: float | None = None
    places: Array = field(default_factory=lambda: np.zeros((0, 4)))
    bodies: tuple[ForegroundBody, ...] = ()
    guidance: Guidance = field(default_factory=Guidance)
    path_mm: Array = field(default_factory=lambda: np.zeros((0, 3)))
    latency: Latency = field(default_factory=Latency)
    effort: int = 0
    stale: bool = False
    robot: str = ""
    autonomy: str = ""
    notice: str = ""
    status: str = ""
    ended: bool = False
