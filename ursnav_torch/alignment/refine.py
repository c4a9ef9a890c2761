"""From the nearest views to the true pose: the best few aligned with the picture, the best kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.alignment.align import Aligned, Aligner, Drawing
from ursnav_torch.alignment.fields import AlignGrid, Fields, Floats
from ursnav_torch.alignment.light import AT_CAMERA
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings, Features
from ursnav_torch.geometry import check_rigid
from ursnav_torch.rendering import RayScene
from ursnav_torch.scaling import scaled
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
#: What is known of poses (K, 4, 4) before they are looked at, in units of the score (K,).
Prior = Callable[[Array], Array]

#: A hypothesis whose score is this much below the best one's is given up.
MARGIN = 0.05


@dataclass(frozen=True, slots=True)
class RefinementSettings:
    """How poses are refined.

    Attributes:
        hypotheses: candidates that are tried; after every round the better half goes on, or fewer.
        iterations: steps of one alignment at most.
        coarse_px: shorter side of the drawings of the first round, which reaches farther.
        fine_px: shorter side of the drawings of the other rounds.
        fine_rounds: how many of those there are; each draws the kidney from where the last one ended.
        clearance_mm: the camera stays this far from the wall (times the kidney's scale).
    """

    hypotheses: int = 3
    iterations: int = 8
    coarse_px: int = 40
    fine_px: int = 62
    fine_rounds: int = 2
    clearance_mm: float = 0.5

    def __post_init__(self) -> None:
        sizes = (self.coarse_px, self.fine_px)
        if min(self.hypotheses, self.iterations, self.fine_rounds) < 1 or min(sizes) < 24 or not self.clearance_mm >= 0:
            raise InputError(
                "Refinement needs hypotheses, iterations and fine_rounds >= 1, coarse_px and fine_px >= 24 and "
                f"clearance_mm >= 0; got {self}."
            )


@dataclass(frozen=True, slots=True)
class Refined:
    """A refined pose.

    Attributes:
        T_kidney_camera: (4, 4).
        score: mean correlation of picture and drawing, 1 is perfect; -1 where they could not be compared.
        hypothesis: index of the candidate it came from.
        iterations: steps taken in all, over all hypotheses.
        light: (5,) the light found, see `align_light.AT_CAMERA`; a start for the next picture of the same scope.
        drawing: the kidney drawn close to that pose, at the finer size.
        T_start: (4, 4) the candidate that it came from.
        tried: (H, 4, 4) every hypothesis after the coarse round, best first; ``tried_scores`` (H,) theirs, on the
            coarser grid.
    """

    T_kidney_camera: Array
    score: float
    hypothesis: int
    iterations: int
    light: Array
    drawing: Drawing
    T_start: Array
    tried: Array
    tried_scores: Array


class Refiner:
    """Refines poses in one VID.

    Args:
        vid: its kidney, lens and extractor settings are used, its views are not.
        settings: how much work is done.

    Raises:
        InputError: the VID's features have no relief to align.
    """

    def __init__(self, vid: Vid, settings: RefinementSettings | None = None) -> None:
        if not isinstance(vid.settings, DefaultSettings):
            raise InputError(
                "Refinement aligns reliefs, which this VID's features do not have; build it with features=default, "
                "or match without refinement."
            )
        self.settings = settings or RefinementSettings()
        self._lumen = vid.lumen
        self._clearance = scaled(self.settings, vid.kidney.scale).clearance_mm
        scene = RayScene(vid.kidney.mesh)
        self._aligners = [
            Aligner(scene, AlignGrid(vid.camera, size, vid.settings), vid.kidney.scale)
            for size in (self.settings.coarse_px, self.settings.fine_px)
        ]

    def refine(
        self,
        features: Features,
        candidates: Sequence[Array],
        light: Array | None = None,
        light_known: bool = False,
        prior: Prior | None = None,
    ) -> Refined:
        """The best pose near one of the candidates.

        Args:
            features: of the picture.
            candidates: T_kidney_camera (4, 4) each, best first.
            light: where the light was found before, if it was.
            light_known: keep to that light.
            prior: added to the scores (K,) of poses (K, 4, 4) where they are ranked; none when None.

        Raises:
            InputError: no candidate, or one that is no rigid transform.
        """
        if not len(candidates):
            raise InputError("Refinement needs at least one candidate pose, got none.")
        start = AT_CAMERA if light is None else np.asarray(light, float)
        tried = candidates[: self.settings.hypotheses]
        states = [(i, Aligned(check_rigid(T, "a candidate"), start, -1.0, 0)) for i, T in enumerate(tried)]
        taken, after_coarse = 0, states
        coarse, fine = self._aligners
        for aligner, rounds in ((coarse, 1), (fine, self.settings.fine_rounds)):
            with torch.inference_mode():
                picture = aligner.grid.of_picture(features)
            for _ in range(rounds):
                states = [(i, self._once(aligner, picture, state, light_known)) for i, state in states]
                taken += sum(state.iterations for _, state in states)
                after_coarse = states if aligner is coarse else after_coarse
                states = _better_half(states, prior)
        i, best = states[0]
        assert best.drawing is not None
        ends = sorted((state for _, state in after_coarse), key=lambda state: -state.score)
        poses, scores = np.stack([end.T_kidney_camera for end in ends]), np.array([end.score for end in ends])
        found = (best.T_kidney_camera, best.score, i, taken, best.light, best.drawing)
        return Refined(*found, np.asarray(tried[i], float), poses, scores)

    def score(self, features: Features, refined: Refined) -> float:
        """How well a refined pose fits features other than those it was found with, as `Refined.score` has it."""
        aligner = self._aligners[-1]
        with torch.inference_mode():
            picture = aligner.grid.of_picture(features)
        return aligner.score(picture, refined.drawing, refined.T_kidney_camera, refined.light)

    def relief(self, refined: Refined) -> Floats:
        """The relief (H, W), on the finer grid, of the drawing that a refined pose and its light give."""
        return self._aligners[-1].relief(refined.T_kidney_camera, refined.light)

    def _once(self, aligner: Aligner, picture: Fields, old: Aligned, light_known: bool) -> Aligned:
        """One alignment, held back on its way as far as the wall demands."""
        new = aligner.align(picture, old.T_kidney_camera, old.light, self.settings.iterations, light_known)
        return replace(new, T_kidney_camera=self._kept_inside(new.T_kidney_camera, old.T_kidney_camera))

    def _kept_inside(self, T_new: Array, T_old: Array) -> Array:
        """``T_new``, or as much of the way there from ``T_old`` as keeps the camera clear of the wall."""
        shares = np.array([1.0, 0.75, 0.5, 0.25, 0.0])
        positions = T_old[:3, 3] + shares[:, None] * (T_new[:3, 3] - T_old[:3, 3])
        room = self._lumen.clearance_mm(positions)
        held = T_new.copy()
        held[:3, 3] = positions[int(np.argmax(room >= min(self._clearance, room[-1])))]
        return held


def _better_half(states: list[tuple[int, Aligned]], prior: Prior | None) -> list[tuple[int, Aligned]]:
    """The better half of numbered hypotheses, best first, without those `MARGIN` below the best."""
    worth = np.array([state.score for _, state in states])
    if prior is not None:
        worth = worth + prior(np.stack([state.T_kidney_camera for _, state in states]))
    ranked = [i for i in np.argsort(-worth, kind="stable") if worth[i] >= worth.max() - MARGIN]
    return [states[i] for i in ranked[: (len(states) + 1) // 2]]
