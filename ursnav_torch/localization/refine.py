"""From the nearest views to the true pose: the best few aligned with the picture, the best kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings, Features
from ursnav_torch.geometry import check_rigid
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.localization.align import Aligned, Aligner
from ursnav_torch.localization.align_fields import AlignGrid
from ursnav_torch.localization.align_light import AT_CAMERA
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RefinementSettings:
    """How poses are refined.

    Attributes:
        hypotheses: candidates that are tried; after every round the better half goes on.
        rounds: drawings that the winner is aligned with, one after the other.
        iterations: steps an alignment at most.
        size_px: shorter side of the drawings.
        clearance_mm: the camera stays this far from the wall (times the kidney's scale).
    """

    hypotheses: int = 3
    rounds: int = 4
    iterations: int = 5
    size_px: int = 62
    clearance_mm: float = 0.5

    def __post_init__(self) -> None:
        if min(self.hypotheses, self.rounds, self.iterations) < 1 or self.size_px < 32 or not self.clearance_mm >= 0:
            raise InputError(
                "Refinement needs hypotheses, rounds and iterations >= 1, size_px >= 32 and clearance_mm >= 0; "
                f"got {self}."
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
    """

    T_kidney_camera: Array
    score: float
    hypothesis: int
    iterations: int
    light: Array


class Refiner:
    """Refines poses in one VID.

    Args:
        vid: its kidney, lens and extractor settings are used, its views are not.
        settings: how much work is done.
        lumen: of the kidney, where it is known already; computed when None.

    Raises:
        InputError: the VID's features have no relief to align.
    """

    def __init__(
        self, vid: Vid, settings: RefinementSettings | None = None, lumen: LumenDistance | None = None
    ) -> None:
        if not isinstance(vid.settings, DefaultSettings):
            raise InputError(
                "Refinement aligns reliefs, which this VID's features do not have; build it with features=default, "
                "or match without refinement."
            )
        self.settings = settings or RefinementSettings()
        self._lumen = lumen or LumenDistance.from_kidney(vid.kidney)
        self._clearance = self.settings.clearance_mm * vid.kidney.scale
        self._grid = AlignGrid(vid.camera, self.settings.size_px, vid.settings)
        self._aligner = Aligner(vid.kidney.mesh, self._grid, vid.kidney.scale)

    def refine(self, features: Features, candidates: Sequence[Array], light: Array | None = None) -> Refined:
        """The best pose near one of the candidates.

        Args:
            features: of the picture.
            candidates: T_kidney_camera (4, 4) each, best first.
            light: where the light was found before, if it was.

        Raises:
            InputError: no candidate, or one that is no rigid transform.
        """
        if not len(candidates):
            raise InputError("Refinement needs at least one candidate pose, got none.")
        start = AT_CAMERA if light is None else np.asarray(light, float)
        s = self.settings
        with torch.inference_mode():
            picture = self._grid.of_picture(features.fields[0])
            states = [
                (i, Aligned(check_rigid(T, "a candidate"), start, -1.0, 0))
                for i, T in enumerate(candidates[: s.hypotheses])
            ]
            taken = 0
            for _ in range(s.rounds):
                tried = [
                    (i, self._aligner.align(picture, a.T_kidney_camera, a.light, s.iterations), a) for i, a in states
                ]
                taken += sum(new.iterations for _, new, _ in tried)
                states = [(i, self._kept_inside(new, old)) for i, new, old in tried]
                states.sort(key=lambda state: -state[1].score)
                states = states[: (len(states) + 1) // 2]
        i, best = states[0]
        return Refined(best.T_kidney_camera, best.score, i, taken, best.light)

    def _kept_inside(self, new: Aligned, old: Aligned) -> Aligned:
        """``new``, held back on its way from ``old`` as far as the wall demands."""
        T, start = new.T_kidney_camera, old.T_kidney_camera[:3, 3]
        least = min(self._clearance, float(self._lumen.clearance_mm(start)[0]))
        for share in (1.0, 0.75, 0.5, 0.25, 0.0):
            position = start + share * (T[:3, 3] - start)
            if share == 0 or float(self._lumen.clearance_mm(position)[0]) >= least:
                break
        held = T.copy()
        held[:3, 3] = position
        return Aligned(held, new.light, new.score, new.iterations)
