"""Ways to steer a scope in the environment: what it sees in, three sticks out."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.autonomy import Explorer, Perception, Permission
from ursnav_torch.exploration.coverage import REACH_STRIDE, Coverage
from ursnav_torch.geometry import transform_from
from ursnav_torch.navigation.autopilot import sticks_of
from ursnav_torch.simulation import TwinPilot
from ursnav_torch.simulation.environment import CYCLE_S, CYCLES, Observation, ScopeEnv

Array = NDArray[np.float64]

STILL = np.zeros(3)
#: Noise of places that stand for a tracker's: mm and degrees, each axis.
NOISE_MM, NOISE_DEG = 0.3, 1.5
#: How much of its sticks a drifting hand keeps from step to step.
_KEPT = 0.95


class Policy(Protocol):
    """What a leaderboard compares.

    Attributes:
        done: whether it wants to end.
        looks: whether it looks at pictures; who does not say so gets them.
    """

    done: bool
    looks: bool

    def begin(self, env: ScopeEnv, seed: int) -> None:
        """An episode begins."""

    def act(self, seen: Observation, facts: dict[str, Any]) -> Array:
        """Three stick deflections (3,) for what is seen, and the facts of the step before, empty at first."""


class Drifting:
    """Sticks that wander at random: the floor."""

    done, looks = False, False

    def begin(self, env: ScopeEnv, seed: int) -> None:
        """Draw from the seed."""
        self._rng, self._sticks = np.random.default_rng([seed, 31]), STILL

    def act(self, seen: Observation, facts: dict[str, Any]) -> Array:
        """Nearly what it did before."""
        self._sticks = np.clip(_KEPT * self._sticks + self._rng.normal(0, 0.3, 3), -1, 1)
        return self._sticks


class Scripted:
    """Into one calyx after the other in the order of their names, and all the way back; it knows the true place."""

    done, looks = False, False

    def begin(self, env: ScopeEnv, seed: int) -> None:
        """A pilot for this episode's scope."""
        self._pilot = TwinPilot(env.twin, env.vid.kidney, clock=lambda: env.now_s)
        self._pilot.connect()

    def act(self, seen: Observation, facts: dict[str, Any]) -> Array:
        """What the pilot's hands do."""
        hands = self._pilot.read()
        self.done = hands.quit
        return np.array([hands.bend_x, hands.bend_y, hands.insertion])


class Exploring:
    """This package's explorer, by places that are 0.3 mm and 1.5 degrees off on each axis."""

    done, looks = False, False

    def begin(self, env: ScopeEnv, seed: int) -> None:
        """An explorer that has seen nothing yet."""
        vid = env.vid
        self._coverage = Coverage(vid.kidney, vid.camera, vid.lumen, vid.T_kidney_camera[::REACH_STRIDE])
        self._explorer = Explorer(self._coverage, vid.lumen)
        self._rng, self._env = np.random.default_rng([seed, 32]), env

    def act(self, seen: Observation, facts: dict[str, Any]) -> Array:
        """What the explorer wishes for."""
        if not facts:
            return STILL
        turn = Rotation.from_rotvec(self._rng.normal(0, np.radians(NOISE_DEG), 3)).as_matrix()
        T = facts["T_kidney_camera"] @ transform_from(turn, self._rng.normal(0, NOISE_MM, 3))
        self._coverage.add(T, CYCLES * CYCLE_S)
        now_s, joints = self._env.now_s, seen["joints"]
        told = Perception(now_s, T, now_s, (), NOISE_MM * 3**0.5, joints[:2], float(joints[2]))
        wish = self._explorer.step(told, Permission(held=True, armed=True))
        self.done = self._explorer.finished
        return np.array(sticks_of(wish, self._env.robot.limits))
