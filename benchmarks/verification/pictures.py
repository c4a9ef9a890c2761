"""What verification learns from: hypotheses of simulated pictures, aligned, and which of them are right."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.certainty.population import kinds
from benchmarks.shared.phantoms import phantom_vid
from ursnav_torch.alignment import Refiner
from ursnav_torch.alignment.align import Aligned
from ursnav_torch.alignment.verification import Drawn, ReadPicture, VerificationNetwork, Verifier, seen_on
from ursnav_torch.errors import FeatureError
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import make_phantom_kidney, observed_calyx
from ursnav_torch.localization import Localizer, Query, simulated_queries
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import PlanSettings, Vid

#: Hypotheses of a picture, and rounds of alignment after which they are compared: the coarse one, and a fine one.
HYPOTHESES, ROUNDS = 6, 2
#: A hypothesis that names the right calyx and is farther off than this is neither right nor wrong.
RIGHT_MM, RIGHT_DEG = 4.0, 25.0
WRONG, NEITHER, RIGHT = -1, 0, 1
#: Calyces of the phantoms, in turn.
CALYCES = (7, 9, 6, 8, 10, 7)
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lessons:
    """P pictures of one phantom, `ROUNDS` and `HYPOTHESES` of each, at the N pixels compared of a grid.

    Attributes:
        compared: (H, W) bool.
        relief, weight: (P, N) and read: (P, 5, N), see `ReadPicture`; float16.
        drawn: (P, rounds, K, 2, N) relief and distance, see `Drawn`; float16.
        score: (P, rounds, K) of alignment; nan where there are fewer hypotheses.
        verdict: (P, rounds, K) `WRONG`, `NEITHER` or `RIGHT`.
        kind: (P,) of picture.
    """

    compared: NDArray[np.bool_]
    relief: NDArray[np.float16]
    weight: NDArray[np.float16]
    read: NDArray[np.float16]
    drawn: NDArray[np.float16]
    score: NDArray[np.float32]
    verdict: NDArray[np.int8]
    kind: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.kind)

    def seen(self, row: int) -> ReadPicture:
        """One picture."""
        return ReadPicture(*(self._planes(part[row]) for part in (self.relief, self.read, self.weight)))

    def hypotheses(self, row: int, rounds: int) -> tuple[Drawn, NDArray[np.float32], NDArray[np.int8]]:
        """One picture's hypotheses after a round, their scores (K,) and verdicts (K,)."""
        there = np.isfinite(self.score[row, rounds])
        planes = self._planes(self.drawn[row, rounds, there])
        return Drawn(planes[:, 0], planes[:, 1]), self.score[row, rounds, there], self.verdict[row, rounds, there]

    def _planes(self, values: NDArray[np.float16]) -> torch.Tensor:
        planes = np.zeros((*values.shape[:-1], *self.compared.shape), np.float32)
        planes[..., self.compared] = values
        return torch.from_numpy(planes)


def lessons(seed: int, pictures: int, views: int, work: Path) -> Lessons:
    """The lessons of one phantom, ``pictures`` of every kind, made where the folder does not hold them."""
    path = work / f"verification_{seed}_{views}_{pictures}.npz"
    if not path.exists():
        made = _made(seed, pictures, views, work)
        partial = path.with_name(path.stem + ".partial.npz")
        np.savez(partial, **{name: getattr(made, name) for name in Lessons.__slots__})
        os.replace(partial, path)
    with np.load(path) as kept:
        return Lessons(**{name: kept[name] for name in Lessons.__slots__})


def _made(seed: int, pictures: int, views: int, work: Path) -> Lessons:
    kidney = make_phantom_kidney(seed, calyces=CALYCES[seed % len(CALYCES)])
    vid = phantom_vid(kidney, PlanSettings(views, views), work / f"verification_vid_{seed}_{views}")
    each = round(pictures * len(kinds()) / (len(kidney.calyces) + 1)) + 1
    plan = replace(PlanSettings(), views_per_calyx=each, passage_views=each, around=0.0, roll_deg=180.0, seed=seed + 1)
    rng = np.random.default_rng(seed)
    names = [str(name) for name in rng.permutation(list(kinds()))]
    queries = simulated_queries(vid, RaycastRenderer, plan, rng, {name: kinds()[name] for name in names})
    return gathered(vid, queries)


def gathered(vid: Vid, queries: Iterator[Query]) -> Lessons:
    """Lessons of pictures."""
    localizer, refiner = Localizer(vid), Refiner(vid)
    grid = refiner.finest.grid
    verifier, rows = Verifier(refiner.finest, vid.kidney.scale, VerificationNetwork()), []
    for query in queries:
        with torch.inference_mode(), one_thread_an_operation():
            try:
                features = localizer.features(query.image)
            except FeatureError:
                continue
            starts = localizer.starts(localizer.search.rank(features), HYPOTHESES)
            states = refiner.coarsely(features, starts)
            found = [_compared(verifier, vid, states, query, grid.compared)]
            found.append(_compared(verifier, vid, refiner.finely(features, states), query, grid.compared))
            seen = seen_on(grid, features)
        parts = [part.numpy()[..., grid.compared].astype(np.float16) for part in (seen.relief, seen.weight, seen.read)]
        rows.append((*parts, *(np.stack(part) for part in zip(*found, strict=True)), query.preset))
    return Lessons(grid.compared, *(np.stack(part) for part in zip(*rows, strict=True)))


def _compared(
    verifier: Verifier, vid: Vid, states: list[Aligned], query: Query, compared: NDArray[np.bool_]
) -> tuple[NDArray[np.float16], NDArray[np.float32], NDArray[np.int8]]:
    """Drawings (K, 2, N), scores (K,) and verdicts (K,)."""
    T = np.stack([state.T_kidney_camera for state in states])
    mm = np.linalg.norm(T[:, :3, 3] - query.T_kidney_camera[:3, 3], axis=1) / vid.kidney.scale
    deg = np.degrees(angle_between(T[:, :3, 2], query.T_kidney_camera[None, :3, 2]))
    named = observed_calyx(T, vid.kidney, vid.lumen) == query.calyx
    count, drawn = len(states), verifier.drawn(states)
    planes = np.zeros((HYPOTHESES, 2, int(compared.sum())), np.float16)
    planes[:count] = torch.stack([drawn.relief, drawn.distance], 1).numpy()[..., compared]
    score, verdict = np.full(HYPOTHESES, np.nan, np.float32), np.zeros(HYPOTHESES, np.int8)
    score[:count] = [state.score for state in states]
    verdict[:count] = np.where(named, np.where((mm < RIGHT_MM) & (deg < RIGHT_DEG), RIGHT, NEITHER), WRONG)
    return planes, score, verdict
