"""Which calyces look alike from where the scope can stand: known before the operation, from simulated pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: A pair is worth a sentence from this share of a calyx's pictures on, and from this many pictures.
WORTH_SAYING, AT_LEAST = 0.08, 2


@dataclass(frozen=True, slots=True)
class LookAlikes:
    """Answers to simulated pictures of every calyx.

    Attributes:
        counts: (C + 1, C + 1) pictures of the row's calyx that were taken for the column's; the last row and column
            are "no calyx" (the passages).
        within_mm: (C, C) a distance from the row's tip, along the lumen, within which none of its pictures was taken
            for the column's; nan where there is none such.
    """

    counts: NDArray[np.int64]
    within_mm: NDArray[np.float64]

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        within = [[None if np.isnan(v) else float(v) for v in row] for row in self.within_mm]
        return {"counts": self.counts.tolist(), "within_mm": within}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "LookAlikes":
        """The inverse of `to_dict`."""
        within = [[np.nan if v is None else float(v) for v in row] for row in data["within_mm"]]
        return cls(np.array(data["counts"], np.int64), np.array(within))

    def sentences(self, names: Sequence[str]) -> list[str]:
        """What a surgeon should know, the worst first; ``names`` (C) of the calyces."""
        found = []
        for a in range(len(names)):
            total = int(self.counts[a].sum())
            for b in range(len(names)):
                count = int(self.counts[a, b])
                if a != b and count >= AT_LEAST and count >= WORTH_SAYING * total:
                    found.append((count / total, self._sentence(names, a, b, total)))
        return [text for _, text in sorted(found, reverse=True)]

    def _sentence(self, names: Sequence[str], a: int, b: int, total: int) -> str:
        count, within = int(self.counts[a, b]), self.within_mm[a, b]
        text = f"{names[a]} is taken for {names[b]} in {count} of {total} simulated pictures ({count / total:.0%})"
        if np.isnan(within):
            return text + "; no distance settles it: look at it from several places."
        return text + f"; within {within:.0f} mm of {names[a]}'s tip in none: approach it."


def find_look_alikes(
    shown: NDArray[np.int64], answered: NDArray[np.int64], far_mm: NDArray[np.float64], calyces: int
) -> LookAlikes:
    """Count who was taken for whom.

    Args:
        shown: (N,) calyx each picture shows, -1 for none; -2 (pictures of nothing) are passed over.
        answered: (N,) calyx answered, -1 for none.
        far_mm: (N,) distance along the lumen from the shown calyx's tip; nan for none.
        calyces: how many there are, C.
    """
    counts = np.zeros((calyces + 1, calyces + 1), np.int64)
    real = shown >= -1
    np.add.at(counts, (shown[real] % (calyces + 1), answered[real] % (calyces + 1)), 1)
    within = np.full((calyces, calyces), np.nan)
    for a in range(calyces):
        for b in range(calyces):
            wrong = far_mm[(shown == a) & (answered == b)]
            nearer = far_mm[(shown == a)] < wrong.min(initial=np.inf)
            if a != b and len(wrong) and nearer.sum() >= 3:
                within[a, b] = np.floor(wrong.min())
    return LookAlikes(counts, within)
