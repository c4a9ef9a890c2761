"""How a scope is followed: one settings class a concern; lengths are mm at the kidney's scale 1."""

from dataclasses import dataclass, field

from ursnav_torch.errors import InputError
from ursnav_torch.search.pose_mean import NEAR_DEG, NEAR_MM
from ursnav_torch.tracking.certainty import TrackCertaintySettings
from ursnav_torch.tracking.motion import MotionSettings
from ursnav_torch.tracking.relocalization import RelocalizationSettings
from ursnav_torch.tracking.robot.odometry import OdometrySettings
from ursnav_torch.tracking.robot.tether import TetherSettings
from ursnav_torch.tracking.smooth import SmoothSettings


@dataclass(frozen=True, slots=True)
class ReadingSettings:
    """How a video's pictures are read, beside how the VID's features say.

    Attributes:
        learned: share of the wall network in their relief, see `features.DefaultSettings`; None: as the VID's
            features say. Without a network there, none is asked here.
    """

    learned: float | None = 0.0

    def __post_init__(self) -> None:
        if self.learned is not None and not 0 <= self.learned <= 1:
            raise InputError(
                f"learned={self.learned} must lie in 0..1, or be null: the wall network's share in a video's relief."
            )


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """The Bayesian filter over the VID's views.

    Attributes:
        likelihood_scale: a search score better by this is e times as probable.
        hypotheses: poses kept from picture to picture.
        best_fitting: of these, poses that fit best wherever they are, so that a lost filter finds back.
        same_place_mm, same_place_deg: hypotheses within both of the best are one place; their weighted mean is the
            pose.
        incumbent_share: probability of the track's own pose beside the views'.
        bridge_s: pictures that show nothing are bridged for this long, or longer where a robot tells of its motion.
        drift_mm_s: standard deviation of where the scope goes meanwhile; from few pictures bridged on the choosing
            flights, and not judged on others.
        every_s: a settled track, which the picture before bore out, is weighed against all views this often; between,
            its pose is aligned alone, and the hypotheses go along with it. 0, 0.25 and 0.5 s give a place in 94.1, 94.5
            and 94.0 % of the choosing flights' pictures, where regions of 10 mm by the weights before were places
            (`benchmarks.flights half=choosing vary=filter.every_s=0,0.5`).
    """

    likelihood_scale: float = 0.15
    hypotheses: int = 72
    best_fitting: int = 36
    same_place_mm: float = NEAR_MM
    same_place_deg: float = NEAR_DEG
    incumbent_share: float = 0.5
    bridge_s: float = 1.0
    drift_mm_s: float = 5.0
    every_s: float = 0.25

    def __post_init__(self) -> None:
        if not 0 < self.best_fitting < self.hypotheses or self.likelihood_scale <= 0 or not self.every_s >= 0:
            raise InputError(
                "Tracking needs 0 < best_fitting < hypotheses, likelihood_scale > 0 and every_s >= 0, got "
                f"{self.best_fitting}, {self.hypotheses}, {self.likelihood_scale} and {self.every_s}."
            )


@dataclass(frozen=True, slots=True)
class ChallengerSettings:
    """The incumbent pose, and when a challenger takes over from it (hysteresis); scores are the alignment's.

    Attributes:
        starts: poses that the incumbent is tried to go on from.
        usual_drop, enough_above: a settled track goes on without a look at the filter where its alignment scores no
            more than this below its mean of late, and at least this. Neither decides much: drops of 0.03, 0.08 and 0.15
            and least scores of 0.4, 0.5 and 0.65 give a place in 94.4 to 94.6 %, 0.1 to 0.9 % of these too far off
            (`benchmarks.flights half=choosing vary=challenger.usual_drop=0.03,0.15`, and so on; places as for every_s).
        depth_step_mm: step in depth that is tried; other poses tried are half as far apart at least.
        reacquire_below: after an alignment that scores less, the track is looked for anew among all hypotheses.
        leap_above: where a robot told of the motion, a pose elsewhere that is aligned worse than this is not believed:
            0.45, 0.55 and 0.65 leave 0.4, 0.4 and 2.0 % of the choosing flights' places more than 3 mm off, before the
            shaft's way in was remembered (`benchmarks.flights half=choosing odometry=true
            vary=challenger.leap_above=0.45,0.65`).
        challenge_below: while alignments score less, a place that fits well is aligned beside the incumbent; and one
            that the robot tells the scope was not driven to is believed by new evidence alone.
        score_step: a challenger whose alignment scores better by this gains a full step.
        prior_weight: score an alignment is held back by for every e-fold that motion makes its pose less probable,
            up to ``score_step``.
        max_step: a single picture counts for no more steps than this.
        takeover_evidence: so many steps, and the challenger becomes the incumbent.
        slip_drop: a track aligned worse than of late by this has slipped: near a wall and in a fast turn alignment
            reaches a millimeter, and no further.
        catches: poses drawn around where it was before that are tried then.
        catch_mm, catch_deg: standard deviations that they are drawn with, more from picture to picture of a slip.
        coast_below, coast_s: where a robot told of the motion, an alignment more than a place away from where that
            leads, and that scores less, is not believed at once: for so long the pose is where motion leads, and no
            place; the same where it is near but turned, and scores less than ``challenge_below``. Six choosing
            inspections have a place in 97.3 % of the pictures, 95.1 % without, 0.7 and 0.4 % of these too far off
            (`benchmarks.flights half=choosing phantoms=12 inspections=450 views=150 around=2 odometry=true
            vary=challenger.coast_s=0`), before positions' errors were learned from 24 flights. ``coast_below`` was set
            beside it after few tries, not varied by a command.
        persist_s: alignments that were not believed, but follow each other for so long as the robot moved, each with a
            score of ``leap_above``, are: the tip has been let go, or the track had slipped before. 0.25, 0.5 and 100 s
            give a place in 99.1, 99.2 and 97.7 % of the choosing flights' pictures, 0.5, 0.5 and 0.3 % of these too far
            off, and in 98.5, 98.5 and 98.4 % of six choosing inspections', 1.3, 1.4 and 1.4 % too far off
            (`benchmarks.flights half=choosing phantoms=16 odometry=true vary=challenger.persist_s=0.5,100`, and with
            ``phantoms=12 inspections=450 views=150 around=2`` the inspections).
    """

    starts: int = 5
    usual_drop: float = 0.08
    enough_above: float = 0.5
    depth_step_mm: float = 2.0
    reacquire_below: float = 0.35
    leap_above: float = 0.45
    challenge_below: float = 0.65
    score_step: float = 0.1
    prior_weight: float = 0.01
    max_step: float = 2.0
    takeover_evidence: float = 3.0
    slip_drop: float = 0.15
    catches: int = 8
    catch_mm: float = 1.2
    catch_deg: float = 6.0
    coast_below: float = 0.8
    coast_s: float = 1.0
    persist_s: float = 0.25

    def __post_init__(self) -> None:
        if self.starts < 1 or self.catches < 0 or min(self.score_step, self.prior_weight, self.takeover_evidence) <= 0:
            raise InputError(
                "A challenger needs starts >= 1, catches >= 0, score_step, prior_weight and takeover_evidence > 0; got "
                f"{self.starts}, {self.catches}, {self.score_step}, {self.prior_weight} and {self.takeover_evidence}."
            )


@dataclass(frozen=True, slots=True)
class OwnKidneySettings:
    """The sequential probability ratio test whether pictures show the VID's kidney (Wald 1945).

    Attributes:
        weights: constant, and weights of a `KidneyEvidence`'s score and fit, in the log-odds that a picture shows the
            VID's kidney and not another: logistic regression over the choosing flights and inspections, each in its own
            and in another phantom's VID (``python -m benchmarks.own_kidney work=DIR``).
        doubt_weights: the same where the picture was mirrored, too: constant, score, fit and the decoy's score. Half of
            it is what the score's lead over the decoy's says alone, as how high a right kidney's scores are was learned
            from drawings (seen on videos that others drew; set), and 0.5 in every picture for a right VID being
            likelier: with 1, 2.6 % of the flights' pictures are believed in another's VID, with less none.
        independent: share of this that counts, as pictures that follow each other say much the same; chosen together
            with ``max_llr_against``: of phantoms left out a right kidney's flights and inspections are believed in 99.3
            and 99.7 % of the pictures, and another's in 0 and 3.6 %. If all of it counts, and a picture may speak
            against a kidney by 1, these are 99.7, 93.0, 0.6 and 3.9 % (all printed by the same command).
        doubt_below: the mirrored picture is asked while the sum is below this, so that a settled track costs no more.
        sensor_gate_sd, sensor_llr: a sensor's reading that the pose meets within so many standard deviations speaks for
            this kidney, and one that it misses against it, by no more than ``sensor_llr``; the alignment's own noise is
            among them.
        relocated_llr: log-likelihood ratio that a picture located anew, and surely, adds to what ``independent`` is a
            share of. When all of it counted, at 1, 1.5 and 2, there were 0, 0.3 and 2.9 % of the choosing flights'
            pictures believed in another's VID (`benchmarks.flights half=choosing other=true
            vary=own_kidney.relocated_llr=1,1.5`); not varied since.
        max_llr_for, max_llr_against: the most that what a single picture shows speaks for and against this kidney.
        accept_above, reject_below: the sum of the log-odds from which on a track is believed, and below which it is
            given up. At 1, 1.5 and 2 a right kidney's flights are believed in 99.7, 99.3 and 98.5 % of the pictures,
            another's inspections in 4.3, 3.6 and 3.5 % (`benchmarks.own_kidney`).
        after_leap: the sum falls to this where the track is found where a robot tells that the scope was not driven,
            nor its shaft's way leads: a picture or two short of ``accept_above``.
        max_sum, min_sum: the sum stays between them: a long good track outlasts a bad stretch.
        frame_s: time between pictures that these numbers are stated for.
    """

    weights: tuple[float, float, float] = (-6.6, 16.8, -2.9)
    doubt_weights: tuple[float, float, float, float] = (-2.7, 17.6, -0.3, -13.7)
    independent: float = 0.3
    doubt_below: float = 3.0
    sensor_gate_sd: float = 3.0
    sensor_llr: float = 1.0
    relocated_llr: float = 1.0
    max_llr_for: float = 2.0
    max_llr_against: float = 0.3
    accept_above: float = 1.5
    reject_below: float = -4.0
    after_leap: float = 1.0
    max_sum: float = 20.0
    min_sum: float = -6.0
    frame_s: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", tuple(float(w) for w in self.weights))
        object.__setattr__(self, "doubt_weights", tuple(float(w) for w in self.doubt_weights))
        if len(self.weights) != 3 or len(self.doubt_weights) != 4:
            raise InputError(
                "The own-kidney test has 3 weights, and 4 in doubt, got "
                f"{len(self.weights)} and {len(self.doubt_weights)}."
            )
        bounds = (self.min_sum, self.reject_below, self.accept_above, self.max_sum)
        if list(bounds) != sorted(bounds) or not self.reject_below < 0 < self.accept_above or self.frame_s <= 0:
            raise InputError(
                "The own-kidney test needs min_sum <= reject_below < 0 < accept_above <= max_sum and frame_s > 0, got "
                f"{bounds} and {self.frame_s}."
            )


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """How a scope is followed, see each part."""

    reading: ReadingSettings = field(default_factory=ReadingSettings)
    filter: FilterSettings = field(default_factory=FilterSettings)
    challenger: ChallengerSettings = field(default_factory=ChallengerSettings)
    own_kidney: OwnKidneySettings = field(default_factory=OwnKidneySettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    smoothing: SmoothSettings = field(default_factory=SmoothSettings)
    certainty: TrackCertaintySettings = field(default_factory=TrackCertaintySettings)
    odometry: OdometrySettings = field(default_factory=OdometrySettings)
    tether: TetherSettings = field(default_factory=TetherSettings)
    relocalization: RelocalizationSettings = field(default_factory=RelocalizationSettings)
