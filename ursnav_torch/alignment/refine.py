"""From the nearest views to the true pose: the best few aligned with the picture and verified, the best kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.alignment.align import Aligned, Aligner, Drawing, Water
from ursnav_torch.alignment.fields import AlignGrid, Floats
from ursnav_torch.alignment.light import AT_CAMERA
from ursnav_torch.alignment.verification import Verifier
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings, Features
from ursnav_torch.geometry import check_rigid
from ursnav_torch.rendering import RayScene
from ursnav_torch.scaling import scaled
from ursnav_torch.search.pose_mean import are_near
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
#: What is known of poses (K, 4, 4) before they are looked at, in units of the score (K,).
Prior = Callable[[Array], Array]

#: A hypothesis whose score is this much below the best one's is given up; and one whose log-odds are, once verified.
MARGIN, LOG_ODDS_MARGIN = 0.05, 4.0
#: Log-odds that a score of 1 is worth before a network has learned, see `alignment.verification`.
LOG_ODDS_OF_SCORE = 20.0


@dataclass(frozen=True, slots=True)
class RefinementSettings:
    """How poses are refined.

    Attributes:
        hypotheses: candidates that are tried; after every round the better half goes on, or fewer.
        at_first: so many of them are tried first, and the others only where none of these has a score of ``enough``.
        enough: such a score, on the coarser grid, is right: of learned phantoms' pictures with one (38 %) no other
            hypothesis was, ``python -m benchmarks.verification``.
        iterations: steps of one alignment at most.
        coarse_px: shorter side of the drawings of the first round, which reaches farther.
        fine_px: shorter side of the drawings of the other rounds.
        fine_rounds: how many of those there are; each draws the kidney from where the last one ended.
        clearance_mm: the camera stays this far from the wall (times the kidney's scale).
        verify: whether hypotheses are ranked by a network that compares them with the picture, see
            `alignment.verification`, where the picture was read; else by the score alone.
        water_spread: how far the glow of the water before the wall is from none, picture value (standard deviation). Of
            poses aligned in murk the median is 0.95, 0.56 and 0.29 mm off, with 0 it is 1.14, 0.73 and 0.43 (in vivo
            like, phantom, simulation); 0.1 to 0.8 do as well, and in clear water all are alike (``python -m
            benchmarks.murk half=choosing pictures=30 vary=water_spread=0.1,0.2,0.8``).
        water_mm: within so many mm of water, whatever the kidney's scale, two thirds of its glow come about; 5 and 20
            are no better (the same with ``vary=water_mm=5,20``).
    """

    hypotheses: int = 6
    iterations: int = 8
    coarse_px: int = 40
    fine_px: int = 62
    fine_rounds: int = 2
    clearance_mm: float = 0.5
    at_first: int = 3
    enough: float = 0.7
    verify: bool = True
    water_spread: float = 0.4
    water_mm: float = 10.0

    def __post_init__(self) -> None:
        sizes, counts = (
            (self.coarse_px, self.fine_px),
            (self.hypotheses, self.at_first, self.iterations, self.fine_rounds),
        )
        lengths_fit = self.clearance_mm >= 0 and self.water_spread >= 0 and self.water_mm > 0
        if min(counts) < 1 or min(sizes) < 24 or not lengths_fit:
            raise InputError(
                "Refinement needs hypotheses, at_first, iterations and fine_rounds >= 1, coarse_px, fine_px >= 24, "
                f"clearance_mm, water_spread >= 0 and water_mm > 0; got {self}."
            )


@dataclass(frozen=True, slots=True)
class Expectation:
    """What is known before a picture is looked at.

    Attributes:
        light: (6,) where the light was found before, if it was.
        light_known: keep to that lamp; the water's glow is found all the same.
        prior: added to the scores (K,) of poses (K, 4, 4) where they are ranked; none when None.
        same_mm, same_deg: of hypotheses that end within both of each other the first round leaves the best alone.
    """

    light: Array | None = None
    light_known: bool = False
    prior: Prior | None = None
    same_mm: float = 0.0
    same_deg: float = 0.0


#: Nothing is known of a still.
NOTHING_KNOWN = Expectation()


@dataclass(frozen=True, slots=True)
class Refined:
    """A refined pose.

    Attributes:
        T_kidney_camera: (4, 4).
        score: mean correlation of picture and drawing, 1 is perfect; -1 where they could not be compared.
        hypothesis: index of the candidate it came from.
        iterations: steps taken in all, over all hypotheses.
        light: (6,) the light found, see `light.AT_CAMERA`; a start for the next picture of the same scope.
        drawing: the kidney drawn close to that pose, at the finer size.
        T_start: (4, 4) the candidate that it came from.
        tried: (H, 4, 4) every hypothesis after the coarse round, best first; ``tried_scores`` (H,) theirs, on the
            coarser grid, and ``tried_log_odds`` (H,) of their being the one, up to a constant, 0 without a network.
        verified: whether a network told which hypothesis it is, and not the score alone.
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
    tried_log_odds: Array
    verified: bool = False


class Refiner:
    """Refines poses in one VID.

    Args:
        vid: its kidney, lens and extractor settings are used, its views are not.
        settings: how much work is done.

    Attributes:
        finest: draws and aligns on the finer grid.

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
        scene, water = RayScene(vid.kidney.mesh), Water(self.settings.water_spread, self.settings.water_mm)
        self._coarsest, self.finest = (
            Aligner(scene, AlignGrid(vid.camera, size, vid.settings), water, vid.kidney.scale)
            for size in (self.settings.coarse_px, self.settings.fine_px)
        )
        self._verifier = Verifier(self.finest, vid.kidney.scale) if self.settings.verify else None

    def refine(self, features: Features, candidates: Sequence[Array], expected: Expectation = NOTHING_KNOWN) -> Refined:
        """The best pose near one of the candidates.

        Args:
            features: of the picture.
            candidates: T_kidney_camera (4, 4) each, best first.
            expected: what is known before.

        Raises:
            InputError: no candidate, or one that is no rigid transform.
        """
        tried, known = candidates[: self.settings.hypotheses], expected.light_known
        first = self.settings.at_first
        coarse = self.coarsely(features, tried[:first], expected.light, known)
        if len(tried) > first and max(state.score for state in coarse) < self.settings.enough:
            coarse += self.coarsely(features, tried[first:], expected.light, known)
        odds = self._log_odds(features, coarse)
        numbered = _apart(list(enumerate(coarse)), expected)
        chosen = None if odds is None else odds[[i for i, _ in numbered]]
        states = _better_half(numbered, chosen, expected.prior)
        taken = sum(state.iterations for state in coarse)
        for left in reversed(range(self.settings.fine_rounds)):
            fine = self.finely(features, [state for _, state in states], known, last=not left)
            taken += sum(state.iterations for state in fine)
            numbered = [(i, state) for (i, _), state in zip(states, fine, strict=True)]
            states = _better_half(numbered, self._log_odds(features, fine), expected.prior)
        i, best = states[0]
        assert best.drawing is not None
        scores = np.array([state.score for state in coarse])
        ends = np.argsort(-scores, kind="stable")
        poses = np.stack([coarse[end].T_kidney_camera for end in ends])
        log_odds = np.zeros(len(coarse)) if odds is None else odds
        found = (best.T_kidney_camera, best.score, i, taken, best.light, best.drawing)
        return Refined(*found, np.asarray(tried[i], float), poses, scores[ends], log_odds[ends], odds is not None)

    def _log_odds(self, features: Features, states: Sequence[Aligned]) -> Array | None:
        """Log-odds (K,) of hypotheses, up to a constant; None where they are not verified."""
        if self._verifier is None or not features.read.numel():
            return None
        return self._verifier.log_odds(features, states) if len(states) > 1 else np.zeros(1)

    def coarsely(
        self, features: Features, candidates: Sequence[Array], light: Array | None = None, light_known: bool = False
    ) -> list[Aligned]:
        """The first round: every candidate (4, 4) aligned on the coarser grid; arguments and errors as of `refine`."""
        if not len(candidates):
            raise InputError("Refinement needs at least one candidate pose, got none.")
        start = AT_CAMERA if light is None else np.asarray(light, float)
        states = [Aligned(check_rigid(T, "a candidate"), start, -1.0, 0) for T in candidates]
        return self._round(self._coarsest, features, states, light_known, last=False)

    def finely(
        self, features: Features, states: Sequence[Aligned], light_known: bool = False, last: bool = True
    ) -> list[Aligned]:
        """Another round, and maybe the last: every one aligned again, from where it ended, on the finer grid."""
        return self._round(self.finest, features, states, light_known, last)

    def score(self, features: Features, refined: Refined) -> float:
        """How well a refined pose fits features other than those it was found with, as `Refined.score` has it."""
        with torch.inference_mode():
            picture = self.finest.grid.of_picture(features)
        return self.finest.score(picture, refined.drawing, refined.T_kidney_camera, refined.light)

    def relief(self, refined: Refined) -> Floats:
        """The relief (H, W), on the finer grid, of the drawing that a refined pose and its light give."""
        return self.finest.look(refined.T_kidney_camera, refined.light)[0]

    def _round(
        self, aligner: Aligner, features: Features, states: Sequence[Aligned], light_known: bool, last: bool
    ) -> list[Aligned]:
        """Every one aligned, held back on its way as far as the wall demands."""
        with torch.inference_mode():
            picture = aligner.grid.of_picture(features)
        starts = np.stack([state.T_kidney_camera for state in states])
        lights, iterations = np.stack([state.light for state in states]), self.settings.iterations
        ends = aligner.align(picture, starts, lights, iterations, light_known, last)
        return [
            replace(end, T_kidney_camera=self._kept_inside(end.T_kidney_camera, start))
            for end, start in zip(ends, starts, strict=True)
        ]

    def _kept_inside(self, T_new: Array, T_old: Array) -> Array:
        """``T_new``, or as much of the way there from ``T_old`` as keeps the camera clear of the wall."""
        shares = np.array([1.0, 0.75, 0.5, 0.25, 0.0])
        positions = T_old[:3, 3] + shares[:, None] * (T_new[:3, 3] - T_old[:3, 3])
        room = self._lumen.clearance_mm(positions)
        held = T_new.copy()
        held[:3, 3] = positions[int(np.argmax(room >= min(self._clearance, room[-1])))]
        return held


def _apart(states: list[tuple[int, Aligned]], expected: Expectation) -> list[tuple[int, Aligned]]:
    """Numbered hypotheses without those that ended where a better aligned one did."""
    if expected.same_mm <= 0:
        return states
    kept: list[tuple[int, Aligned]] = []
    for i, state in sorted(states, key=lambda numbered: -numbered[1].score):
        ends = np.array([other.T_kidney_camera for _, other in kept]).reshape(-1, 4, 4)
        if not are_near(ends, state.T_kidney_camera, expected.same_mm, expected.same_deg).any():
            kept.append((i, state))
    return kept


def _better_half(
    states: list[tuple[int, Aligned]], log_odds: Array | None, prior: Prior | None
) -> list[tuple[int, Aligned]]:
    """The better half of numbered hypotheses, best first, without those far below the best: by log-odds (K,) where
    they were verified, else by score."""
    worth, margin, unit = np.array([state.score for _, state in states]), MARGIN, 1.0
    if log_odds is not None:
        worth, margin, unit = log_odds, LOG_ODDS_MARGIN, LOG_ODDS_OF_SCORE
    if prior is not None:
        worth = worth + unit * prior(np.stack([state.T_kidney_camera for _, state in states]))
    ranked = [i for i in np.argsort(-worth, kind="stable") if worth[i] >= worth.max() - margin]
    return [states[i] for i in ranked[: (len(states) + 1) // 2]]
