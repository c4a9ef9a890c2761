"""The twin as a Gymnasium environment, so that others can train and compare ways to explore a kidney (extra ``gym``).

env = ScopeEnv(load_vid("my_vid"))
seen, _ = env.reset(seed=1)
seen, reward, done, cut, facts = env.step([0.0, 0.2, 1.0])
"""

from contextlib import ExitStack
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ursnav_torch.devices import JointRates, Limits
from ursnav_torch.exploration.coverage import INSPECTED, OUT_OF_REACH, REACH_STRIDE, Coverage
from ursnav_torch.extras import import_extra
from ursnav_torch.geometry import look_along
from ursnav_torch.rendering import RaycastRenderer, Renderer
from ursnav_torch.rendering.sensor import SensorFaults, Stone, simulate_labeled
from ursnav_torch.simulation.stepped import SimulatedTime, SteppedRobot
from ursnav_torch.simulation.stones import ObstructedLumen, lay_stones
from ursnav_torch.simulation.tissue import Tissue, TissueSettings
from ursnav_torch.simulation.twin import Scope
from ursnav_torch.simulation.world import World, clean, operated_twin
from ursnav_torch.vid import Vid

gymnasium = import_extra("gymnasium", "gym", "The twin as an environment")

Array = NDArray[np.float64]
Observation = dict[str, NDArray[Any]]
Reset = tuple[Observation, dict[str, Any]]

#: Simulated seconds a step, in cycles of control of 0.02 s.
CYCLES, CYCLE_S = 3, 0.02
#: What a mm of compression of the shaft costs in a step, against 1 for a calyx's whole wall.
PRESSED_COSTS = 0.01


class ScopeEnv(gymnasium.Env):  # type: ignore[name-defined]
    """A ureteroscope to be steered through one kidney.

    An action is three stick deflections, -1 to 1: bend about x, bend about y, insertion. They pass the same limits as
    an operator's. A step is 0.06 s. An observation has ``picture`` (H, W), ``joints`` (3,) as the robot reports them in
    radians and mm, and ``seen`` (C,), the share of each calyx's wall that was seen. The reward is what a step added to
    ``seen``, less what pushing against a wall or a stone costs. The end is that every calyx in reach is inspected.
    What a policy tells of stones is to be judged by the ``stones`` among the facts of `reset` and `step`.

    Args:
        vid: kidney, lens, and the views that tell what is within reach.
        seconds: an episode is cut off after so much simulated time.
        tissue: what an operation does to kidney and scope; without it, it only breathes.
        stones: so many lie on the wall, where the seed puts them, as `StoneSettings` draws them; they stop the scope,
            and pictures show them.
        pictures: whether observations have them; without, nothing is drawn and a step is quicker.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": round(1 / (CYCLES * CYCLE_S))}  # noqa: RUF012

    def __init__(
        self,
        vid: Vid,
        seconds: float = 300.0,
        tissue: TissueSettings | None = None,
        stones: int = 0,
        pictures: bool = True,
    ) -> None:
        self.vid, self._longest_s, self._count, self._pictures = vid, seconds, stones, pictures
        self._stones: tuple[Stone, ...] = ()
        self._tissue = tissue or TissueSettings(swells=False, bleeds=False, buckles=False)
        self.render_mode = "rgb_array"
        self._renderer = RaycastRenderer(vid.kidney.mesh, vid.camera)
        self._clean = Coverage(vid.kidney, vid.camera, vid.lumen, vid.T_kidney_camera[::REACH_STRIDE])
        box, count = gymnasium.spaces.Box, len(vid.kidney.calyces)
        reach = np.array([Limits().max_bend_rad] * 2 + [Limits().max_insertion_mm]) + 1.0  # and what a report rounds
        self.action_space = box(-1.0, 1.0, (3,), np.float64)
        spaces = {"joints": box(-reach, reach, (3,), np.float64), "seen": box(0.0, 1.0, (count,), np.float64)}
        if pictures:
            spaces["picture"] = box(0, 255, (vid.camera.height, vid.camera.width), np.uint8)
        self.observation_space = gymnasium.spaces.Dict(spaces)
        self._clock, self._episode = SimulatedTime(), ExitStack()

    @property
    def now_s(self) -> float:
        """Simulated time since the episode began."""
        return self._clock.now_s

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin anew, withdrawn in the pelvis; the seed draws roll, plays, tissue and stones."""
        super().reset(seed=seed)
        self.close()
        rng, kidney = self.np_random, self.vid.kidney
        self._clock, self.coverage = SimulatedTime(), self._clean
        self.coverage.seen_s[:] = 0.0
        start = kidney.centerline.points_mm[0]
        plays = (*rng.uniform(0.05, 0.15, 2), rng.uniform(0.2, 1.0))
        T_kidney_start = look_along(start, kidney.tips_mm.mean(axis=0) - start, float(rng.uniform(-np.pi, np.pi)))
        tissue = Tissue(self._tissue, rng, kidney.scale)
        self._stones = lay_stones(kidney, self.vid.lumen, self._count, rng)
        draw = self._with_stones if self._stones else clean
        self.twin = operated_twin(self._world(), T_kidney_start, Scope(backlash=plays), tissue, draw=draw)
        self.robot = self._episode.enter_context(SteppedRobot(self._clock, self.twin.scope.drive))
        self.robot.arm()
        self.twin.drive_with(self.robot.axes_mm)
        self._shares = np.zeros(len(kidney.calyces))
        return self._observed(), {"stones": self._stones}

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move for 0.06 s by stick deflections (3,): observation, reward, ended, cut off, facts."""
        sticks, limits = np.clip(np.asarray(action, float), -1.0, 1.0), self.robot.limits
        turn = sticks[:2] * limits.max_bend_rate_rad_s
        wanted = JointRates(float(turn[0]), float(turn[1]), float(sticks[2] * limits.max_insertion_rate_mm_s))
        before, pressed = self._shares.sum(), 0.0
        for _ in range(CYCLES):
            self.robot.command(wanted, dead_man=True)
            self._clock.now_s += CYCLE_S
            T = self.twin.pose()
            pressed = max(pressed, self.twin.pressed_mm)
        self.robot.read()
        self.coverage.add(T, CYCLES * CYCLE_S)
        calyces = self.coverage.calyces()
        self._shares = np.array([c.share for c in calyces])
        done = all(c.verdict in (INSPECTED, OUT_OF_REACH) for c in calyces)
        reward = float(self._shares.sum() - before) - PRESSED_COSTS * pressed
        verdicts = {c.calyx: c.verdict for c in calyces}
        facts = {"T_kidney_camera": T, "pressed_mm": pressed, "verdicts": verdicts, "stones": self._stones}
        return self._observed(), reward, done, self.now_s >= self._longest_s, facts

    def render(self) -> NDArray[np.uint8]:
        """The scope's picture (H, W, 3)."""
        return np.repeat(self.twin.image()[..., None], 3, axis=2)

    def close(self) -> None:
        """Disconnect the robot of the episode, if one was begun; `reset` begins another."""
        self._episode.close()

    def _world(self) -> World:
        camera = self.vid.camera
        lumen = ObstructedLumen(self.vid.lumen, self._stones) if self._stones else self.vid.lumen
        return World(self.vid.kidney, self._renderer, lumen, lambda mesh: RaycastRenderer(mesh, camera), self._clock)

    def _with_stones(self, renderer: Renderer, T: Array) -> NDArray[np.uint8]:
        """A picture (H, W) that shows the stones."""
        faults = SensorFaults()
        seen = simulate_labeled(renderer.render(T), renderer.camera, T, faults, self.np_random, self._stones)
        return np.asarray(cv2.cvtColor(seen.image, cv2.COLOR_BGR2GRAY), np.uint8)

    def _observed(self) -> Observation:
        at = self.robot.reported
        joints = np.array([at.bend_x_rad, at.bend_y_rad, at.insertion_mm])
        seen = {"joints": joints, "seen": self._shares.copy()}
        return seen | {"picture": self.twin.image()} if self._pictures else seen
