"""The course of a track: its pose, smoothed, and whether an alignment far from where motion leads is believed.

Where a robot tells of the motion a single such picture is not: the track coasts on the robot's word for a while, or
until pictures agree with each other for long enough.
"""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.search.pose_mean import are_near
from ursnav_torch.tracking.robot.odometry import Carried
from ursnav_torch.tracking.sensor import SensorReading
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.tracking.smooth import PoseFilter

Array = NDArray[np.float64]


class Course:
    """Where one track goes.

    Args:
        settings: of the track; lengths in mm of this kidney.
    """

    def __init__(self, settings: TrackSettings) -> None:
        self._settings, self._smooth = settings, PoseFilter(settings.smoothing)
        self.reset()

    def reset(self) -> None:
        """Forget it."""
        self._smooth.reset()
        self._coasts_s: float | None = None  # since when alignments are not believed
        self._elsewhere: Array | None = None  # the last alignment that was not believed,
        self._elsewhere_s, self._carried = 0.0, np.eye(4)  # when that was, the robot's word on the motion since,
        self._persists_s = 0.0  # and since when such alignments have followed each other

    @property
    def coasts(self) -> bool:
        """Whether the pose is where motion leads, as alignments are not believed."""
        return self._coasts_s is not None

    def pose(self) -> Array | None:
        """(4, 4), as of the last time that was asked about; None before the first."""
        return None if self._smooth.belief is None else self._smooth.pose()

    def predict(self, t_s: float, carried: Carried | None = None) -> Array | None:
        """See `PoseFilter.predict`."""
        if carried is not None:
            self._carried = self._carried @ carried.T_before_now
        return self._smooth.predict(t_s, carried)

    def follow(
        self,
        T: Array,
        score: float,
        t_s: float,
        sensor: SensorReading | None,
        told: tuple[Array, ...],
        reached: bool = True,
    ) -> tuple[Array, bool]:
        """The smoothed pose (4, 4) after an alignment, and whether it leapt to where the scope was not driven.

        An alignment far from where the motion leads begins a new course. Where a robot told of the motion, and of no
        other place (4, 4) that is near, it is less believed: for a while the track coasts, see `ChallengerSettings`.

        Args:
            T: (4, 4) the refined pose.
            score: how well it is aligned.
            t_s: when the picture was taken.
            sensor: the EM reading, if there is one.
            told: see `Weighed`; empty where no robot told.
            reached: whether the robot can have brought the scope there, see `Tether`; else the track coasts, too.
        """
        expected, leapt = self._smooth.predict(t_s), False
        if expected is not None and not self._near(expected[None], T)[0]:
            s = self._settings.challenger
            foreseen = not told or bool(self._near(np.array(told), T).any())
            if not foreseen and self._goes_on_coasting(expected, T, score, t_s, reached):
                return self._measured(expected, sensor), False
            if score < (s.reacquire_below if foreseen else s.leap_above):
                return expected, False
            self._smooth.reset()
            leapt = not foreseen and score < s.challenge_below and not self._persists(t_s)
        self._coasts_s = self._elsewhere = None
        return self._measured(self._smooth.update(T, t_s, score), sensor), leapt

    def _measured(self, T: Array, sensor: SensorReading | None) -> Array:
        """The pose (4, 4) of now, with the EM reading if there is one."""
        at = None if sensor is None else sensor.camera_at(T)
        if sensor is None or at is None:
            return T
        self._smooth.measure(at, sensor.sigma_mm)
        return self._smooth.pose()

    def _goes_on_coasting(self, expected: Array, T: Array, score: float, t_s: float, reached: bool) -> bool:
        """Whether an alignment that no robot foresaw is out of its reach, too bad, or too new, to be followed."""
        s, near_mm = self._settings.challenger, self._settings.filter.same_place_mm
        away = float(np.linalg.norm(T[:3, 3] - expected[:3, 3])) > near_mm
        if reached and score >= (s.coast_below if away else s.challenge_below):
            return False
        self._coasts_s = t_s if self._coasts_s is None else self._coasts_s
        if score < s.leap_above or not self._follows(T, t_s):
            self._persists_s = t_s
        self._elsewhere, self._elsewhere_s, self._carried = T, t_s, np.eye(4)
        return not reached or (t_s - self._coasts_s < s.coast_s and not self._persists(t_s))

    def _follows(self, T: Array, t_s: float) -> bool:
        """Whether an alignment (4, 4) is where the robot moved on from the last that was not believed, not long ago."""
        is_new = t_s - self._elsewhere_s <= self._settings.challenger.persist_s
        return (
            self._elsewhere is not None and is_new and bool(self._near((self._elsewhere @ self._carried)[None], T)[0])
        )

    def _persists(self, t_s: float) -> bool:
        """Whether alignments that were not believed have followed each other for long enough to be."""
        return self._elsewhere is not None and t_s - self._persists_s >= self._settings.challenger.persist_s

    def _near(self, T_a: Array, T_b: Array) -> NDArray[np.bool_]:
        """Which poses (K, 4, 4) are one place with another."""
        s = self._settings.filter
        return are_near(T_a, T_b, s.same_place_mm, s.same_place_deg)
