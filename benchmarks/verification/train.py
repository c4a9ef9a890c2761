"""Training: AdamW, one cycle of the learning rate, one seed; the same data, the same weights."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from benchmarks.verification.pictures import RIGHT, ROUNDS, WRONG, Lessons
from ursnav_torch.alignment.verification import VerificationNetwork, comparison_maps

BATCH, RATE, DECAY = 4, 3e-3, 1e-2


@dataclass(frozen=True, slots=True)
class Case:
    """The hypotheses of one picture after one round: maps (K, M, H, W) float16, scores (K,), verdicts (K,)."""

    maps: Tensor
    score: Tensor
    verdict: Tensor


def case(lessons: Lessons, row: int, rounds: int) -> Case:
    """One picture's hypotheses after a round."""
    drawn, score, verdict = lessons.hypotheses(row, rounds)
    maps = comparison_maps(lessons.seen(row), drawn, torch.from_numpy(lessons.compared))
    return Case(maps.half(), torch.from_numpy(score), torch.from_numpy(verdict))


def telling(taught: Sequence[Lessons]) -> list[list[Case]]:
    """Of every picture the rounds after which it has a right and a wrong hypothesis, of those that have any."""
    found = []
    for own in taught:
        for row in range(len(own)):
            tell = [
                (own.verdict[row, r] == RIGHT).any() and (own.verdict[row, r] == WRONG).any() for r in range(ROUNDS)
            ]
            found.append([case(own, row, r) for r in range(ROUNDS) if tell[r]])
    return [rounds for rounds in found if rounds]


def train(taught: Sequence[Lessons], epochs: int, seed: int) -> VerificationNetwork:
    """A network taught by every telling picture, after one of its rounds by chance, turned and mirrored by chance."""
    torch.manual_seed(seed)
    rng, network = np.random.default_rng(seed), VerificationNetwork()
    pictures = telling(taught)
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    steps = epochs * (len(pictures) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps + 1)
    for epoch in range(epochs):
        order, total = rng.permutation(len(pictures)), 0.0
        for first in range(0, len(order) - BATCH + 1, BATCH):
            cases = [pictures[i][rng.integers(len(pictures[i]))] for i in order[first : first + BATCH]]
            mean = torch.stack([loss(network, _turned(asked, rng)) for asked in cases]).mean()
            optimizer.zero_grad()
            mean.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
            total += float(mean.detach()) * BATCH
        print(f"epoch {epoch + 1} of {epochs}: {total / len(order):.3f}", file=sys.stderr, flush=True)
    return network.eval()


def loss(network: VerificationNetwork, asked: Case) -> Tensor:
    """Negative log-likelihood that one of the right hypotheses is the one; what is neither has no say."""
    odds = network(asked.maps.float(), asked.score).masked_fill(
        (asked.verdict != RIGHT) & (asked.verdict != WRONG), -1e9
    )
    return odds.logsumexp(0) - odds.masked_fill(asked.verdict != RIGHT, -1e9).logsumexp(0)


def first_is_right(network: VerificationNetwork | None, cases: Iterable[Case], most: int) -> list[bool]:
    """Whether the best of the first so many hypotheses names the right calyx; by score alone without a network."""
    found = []
    with torch.inference_mode():
        for asked in cases:
            odds = asked.score if network is None else network(asked.maps.float(), asked.score)
            found.append(bool(asked.verdict[int(odds[:most].argmax())] != WRONG))
    return found


def _turned(asked: Case, rng: np.random.Generator) -> Case:
    maps = torch.rot90(asked.maps, int(rng.integers(4)), (2, 3))
    return Case(maps.flip(3) if rng.random() < 0.5 else maps, asked.score, asked.verdict)
