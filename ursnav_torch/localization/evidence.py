"""What a picture, its hypotheses and its alignment say of the answer: the numbers that certainty is computed from."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.alignment import Refined
from ursnav_torch.alignment.curvature import unit_noise_sd
from ursnav_torch.features import Features
from ursnav_torch.geometry import rotation_angle
from ursnav_torch.search import Ranking

Array = NDArray[np.float64]
Calyces = NDArray[np.int64]

#: Width of the vote among near-best views: distances this much apart count 1 to e.
VOTE_WIDTH = 0.012
#: A calyx no nearer than this behind the best, in distance or aligned score, is out of the race.
FARTHEST = 0.15
#: What the picture looks like, wherever it was taken.
LOOKS = ("contrast", "grain", "flat", "strength", "tails", "sharpness")
#: Numbers of an answer; those from ``score`` on are the alignment's.
NUMBERS = ("distance", "margin", "vote", "spread_mm", "spread_deg", *LOOKS,
           "score", "agrees", "lead", "curvature_mm", "curvature_deg", "moved_mm", "firm",
           "verified")  # fmt: skip
#: Numbers of each calyx; those from ``refined`` on are the alignment's.
CALYX_NUMBERS = ("vote", "behind", "refined", "refined_score", "aligned_behind", "firm", "verified")
REFINED_NUMBERS, REFINED_CALYX_NUMBERS = 8, 5
#: Shares of labels and probabilities count no nearer to 0 and 1 than this.
_LEAST_SHARE = 0.005


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of one picture.

    Attributes:
        answer: index of the calyx answered, -1 for none.
        numbers: (N,) the first N of `NUMBERS`; lengths in mm at the kidney's scale 1.
        calyces: (C + 1, F) the first F of `CALYX_NUMBERS` of every calyx, the last row of none.
    """

    answer: int
    numbers: Array
    calyces: Array


@dataclass(frozen=True, slots=True)
class Vote:
    """What near-best views vote for.

    Attributes:
        calyx: index with the most votes, -1 for none.
        share: (C + 1,) of the votes, each view voting with exp(-distance / VOTE_WIDTH); the last for none.
        best: (C + 1,) distance of each one's best view, inf without one.
    """

    calyx: int
    share: Array
    best: Array


def vote(distance: Array, calyx: Calyces, count: int) -> Vote:
    """The vote of views with distances (K,) ascending, from which the picture observes calyces (K,), of ``count``."""
    row = calyx % (count + 1)
    share = np.bincount(row, vote_weight(distance, float(distance[0])), minlength=count + 1)
    best = np.full(count + 1, np.inf)
    np.minimum.at(best, row, distance)
    most = int(share.argmax())
    return Vote(most if most < count else -1, share / share.sum(), best)


def vote_weight(distance: Array, best: float) -> Array:
    """What views at distances (K,) count beside one at the distance ``best``: 1 to e for every `VOTE_WIDTH`."""
    return np.exp((best - distance) / VOTE_WIDTH)


def nearest_evidence(ranking: Ranking, said: Vote, features: Features, scale: float) -> Evidence:
    """Evidence of the nearest views alone; ``scale`` is the kidney's."""
    row = said.calyx % len(said.share)
    share, own = float(np.clip(said.share[row], 1e-4, 1 - 1e-4)), float(said.best[row])
    margin = min(float(np.delete(said.best, row).min(initial=np.inf)) - own, FARTHEST)
    mm, deg = _spread(ranking)
    numbers = [own, margin, math.log(share / (1 - share)), math.log(mm / scale + 0.05), math.log(deg + 0.5)]
    behind = np.minimum(said.best - said.best.min(), FARTHEST)
    calyces = np.column_stack([np.log(said.share + 1e-3), behind])
    return Evidence(said.calyx, np.array(numbers + looks(features)), calyces)


def refined_evidence(
    nearest: Evidence, refined: Refined, observed: Calyces, answer: int, firm: Array, scale: float
) -> Evidence:
    """Evidence with the alignment's added.

    Args:
        nearest: see `nearest_evidence`.
        refined: the refined pose.
        observed: (1 + H,) the calyx that the refined pose observes, and each of ``refined.tried``.
        answer: what is answered in the end.
        firm: (C + 1,) share of the poses around the answer's that observe each calyx, see `firmness.label_shares`.
        scale: the kidney's.
    """
    calyx, tried = int(observed[0]), observed[1:]
    count = len(nearest.calyces)
    aligned = np.full(count, -np.inf)
    np.maximum.at(aligned, tried % count, refined.tried_scores)
    behind = np.minimum(aligned.max() - aligned, FARTHEST)
    own = np.zeros(count)
    own[calyx % count] = 1.0
    lead = float(np.delete(behind, calyx % count).min(initial=FARTHEST) - behind[calyx % count])
    mm, turn = unit_noise_sd(refined.drawing)
    moved = float(np.linalg.norm(refined.T_kidney_camera[:3, 3] - refined.T_start[:3, 3])) / scale
    odds = np.exp(refined.tried_log_odds - refined.tried_log_odds.max())
    verified = np.bincount(tried % count, odds / odds.sum(), minlength=count)
    share, told = (np.clip(p, _LEAST_SHARE, 1 - _LEAST_SHARE) for p in (firm, verified))
    of_answer = [float(np.log(p / (1 - p))[answer % count]) for p in (share, told)]
    numbers = [refined.score, float(calyx == nearest.answer), lead, math.log(mm / scale + 1e-6),
               math.log(turn + 1e-6), math.log(moved + 0.1), *of_answer]  # fmt: skip
    of_calyces = (own, own * (refined.score - 0.6), behind, np.log(share), np.log(told))
    calyces = np.column_stack([nearest.calyces, *of_calyces])
    return Evidence(answer, np.append(nearest.numbers, numbers), calyces)


def looks(features: Features) -> list[float]:
    """`LOOKS` of a picture: its contrast and grain, the share without relief, and the relief's size, tails and
    sharpness (log of its finest slopes to its coarsest)."""
    fields = features.fields.numpy().astype(float)
    if not fields.size:
        return [features.contrast, features.grain, 0.0, 0.0, 0.0, 0.0]
    relief = fields[0][fields[0] != 0]
    size = float(np.sqrt(np.mean(relief**2))) + 1e-6 if relief.size else 1e-6
    tails = float(np.mean(np.minimum(np.abs(relief) / size, 10.0) ** 3)) if relief.size else 0.0
    fine, coarse = (float(np.sqrt(np.mean(fields[rows] ** 2))) + 1e-6 for rows in (slice(1, 3), slice(-2, None)))
    flat = 1.0 - relief.size / fields[0].size
    return [features.contrast, features.grain, flat, math.log(size), math.log(tails + 1e-3), math.log(fine / coarse)]


def _spread(ranking: Ranking) -> tuple[float, float]:
    """Root mean square distance, mm, and turn, degrees, of the hypotheses from the best, weighted by their votes."""
    T, weight = ranking.T_kidney_camera, vote_weight(ranking.distance, float(ranking.distance[0]))
    away = np.sum((T[:, :3, 3] - T[0, :3, 3]) ** 2, axis=1)
    turned = np.degrees(rotation_angle(T, T[0])) ** 2
    return float(np.sqrt(np.average(away, weights=weight))), float(np.sqrt(np.average(turned, weights=weight)))
