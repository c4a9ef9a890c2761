"""The best pose without a starting guess, and how well the data determine it: the next best pose, and a jackknife."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.errors import RegistrationError
from ursnav_torch.geometry import Array
from ursnav_torch.registration.search import MisfitOf, Poses, distinct, refine, search_rotations

#: Rotations refined on a few samples, and poses among them refined on all.
_STARTS, _FINALISTS = 300, 32
#: Poses that place the kidney this far apart, mm RMS, are different answers.
_APART_MM = 5.0
#: Parts that the jackknife leaves out in turn.
PARTS = 8
#: The next best answer must cost this much more. Parts of the test kidneys' paths that pass are right to 4 mm over the
#: kidney (`python -m benchmarks.registration cuts=true`).
LEAST_GAP = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Samples to be laid into a kidney.

    Attributes:
        samples: (N, 3) positions, EM frame.
        part: (N,) which of the jackknife's parts each sample belongs to; samples that err together belong together.
        misfit: cost of poses on all samples.
        coarse_samples: (K, 3) a few positions, EM frame.
        coarse_misfit: cost of poses on ``coarse_count`` samples.
        search_cost: cost (A, K) of positions (A, K, 3) in the kidney frame.
        anchors_mm: (A, 3) places near one of which the most central sample must lie, kidney frame.
    """

    samples: Tensor
    part: Tensor
    misfit: MisfitOf
    coarse_samples: Tensor
    coarse_misfit: MisfitOf
    coarse_count: int
    search_cost: Callable[[Tensor], Tensor]
    anchors_mm: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The best pose and its rivals.

    Attributes:
        R: (3, 3) and t_mm: (3,) of the transform from the EM to the kidney frame.
        center_mm: (3,) mean of the samples, kidney frame.
        covariance: (6, 6) jackknife covariance of a small rotation (rad) about the center and shift (mm).
        cost: of the best pose, summed over the samples.
        gap: by how much the next best distinct answer costs more; infinite where there is none.
        rival_mm: how far, RMS, that answer places the kidney from the best one.
    """

    R: Array
    t_mm: Array
    center_mm: Array
    covariance: Array
    cost: float
    gap: float
    rival_mm: float


def solve(problem: Problem) -> Solution:
    """Search all rotations, refine the best, and ask how well the samples determine the answer."""
    answers, cost = _answers(problem)
    best, gap, rival = answers.pick(torch.tensor([0])), np.inf, 0.0
    if len(cost) > 1:
        probe = _probe(problem)
        shift = answers.apply(probe)[1] - answers.apply(probe)[0]
        gap, rival = float(cost[1] - cost[0]), float(shift.square().sum(-1).mean().sqrt())
    U, _, Vh = np.linalg.svd(best.R[0].double().numpy())
    center, mean = best.t[0].double().numpy(), best.center.double().numpy()
    R = U @ Vh
    return Solution(R, center - R @ mean, center, _jackknife(best, problem), float(cost[0]), gap, rival)


def refuse_unless_determined(solution: Solution, tre_mm: float, most_mm: float, what: str) -> None:
    """Refuse a pose that the samples (``what``, in words) do not determine.

    Raises:
        RegistrationError: another pose explains them nearly as well, or the error ``tre_mm`` (expected root mean square
            over the kidney) is larger than ``most_mm``.
    """
    if solution.gap < LEAST_GAP:
        raise RegistrationError(
            f"The {what} leave the registration open: another pose, {solution.rival_mm:.0f} mm away, explains them "
            f"nearly as well (it costs {solution.gap:.1f} more; {LEAST_GAP:g} are asked for). {_MORE}"
        )
    if tre_mm > most_mm:
        raise RegistrationError(
            f"The {what} determine the registration only to {tre_mm:.1f} mm over the kidney; {most_mm:g} mm is the "
            f"most accepted (max_error_mm). {_MORE}"
        )


def refuse_if_mirrored_fits(solution: Solution, mirrored: Problem, what: str) -> None:
    """Refuse a pose of samples (``what``, in words) that would fit better if they were mirrored.

    Raises:
        RegistrationError: they would.
    """
    better = solution.cost - float(_answers(mirrored)[1][0])
    if better > LEAST_GAP:
        raise RegistrationError(
            f"Mirrored, the {what} would fit this kidney better (by {better:.0f}). Is it the kidney of the other side, "
            "or are the EM data left-handed (one axis to be flipped)?"
        )


_MORE = "Reach more calyces, of both poles, or touch landmarks."


def _answers(problem: Problem) -> tuple[Poses, Tensor]:
    """Distinct refined poses about the samples' mean, best first, and their costs."""
    center, probe = problem.samples.mean(0), _probe(problem)
    starts = search_rotations(problem.search_cost, problem.coarse_samples, problem.anchors_mm, _STARTS)
    coarse, found = refine(starts, problem.coarse_misfit, torch.ones(problem.coarse_count), 12)
    rows = distinct(coarse, found.cost.mean(-1), probe, 0.75 * _APART_MM)[:_FINALISTS]
    finalists, found = refine(coarse.pick(rows).about(center), problem.misfit, torch.ones(len(problem.samples)), 30)
    cost = found.cost.sum(-1)
    rows = distinct(finalists, cost, probe, _APART_MM)
    return finalists.pick(rows), cost[rows]


def _probe(problem: Problem) -> Tensor:
    """(6, 3) a cross about the samples' mean, as large as the kidney (root mean square radius of its anchors)."""
    radius = (problem.anchors_mm - problem.anchors_mm.mean(0)).square().sum(-1).mean().sqrt()
    return problem.samples.mean(0) + radius * torch.cat([torch.eye(3), -torch.eye(3)])


def _jackknife(best: Poses, problem: Problem) -> Array:
    """(6, 6) covariance from the scatter of the answers without each part of the samples (Tukey's jackknife)."""
    without = (problem.part != torch.arange(PARTS)[:, None]).float()
    poses, _ = refine(best.pick(torch.zeros(PARTS, dtype=torch.long)), problem.misfit, without, 15)
    turn = (poses.R @ best.R.mT - best.R @ poses.R.mT) / 2
    rotation = torch.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], dim=1)
    return (PARTS - 1) * np.cov(torch.cat([rotation, poses.t - best.t], dim=1).double().numpy().T, bias=True)
