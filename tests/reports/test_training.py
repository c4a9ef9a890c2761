"""What a trainee's session is read beside."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.exploration.coverage import GLIMPSED, INSPECTED, OUT_OF_REACH, UNSEEN, CalyxCoverage
from ursnav_torch.reports.training import (
    TrainingFigures,
    as_told,
    calyx_training,
    count_visits,
    training_figures,
    training_rows,
)


def covered(calyx: str, verdict: str) -> CalyxCoverage:
    return CalyxCoverage(calyx, "", verdict, 0.5, 1.0, 80.0)


def test_a_calyx_out_of_reach_was_not_missed() -> None:
    calyces = [covered("A", INSPECTED), covered("B", UNSEEN), covered("C", OUT_OF_REACH)]
    rows = {row["name"]: row["value"] for row in training_rows(TrainingFigures(calyces=calyces), 0.0, 0.0, 1.0)}
    assert rows["calyces inspected"] == "1 of 2 in reach" and rows["missed calyces"] == "B"
    rows = {row["name"]: row["value"] for row in training_rows(TrainingFigures(calyces=calyces[:1]), 0.0, 0.0, 1.0)}
    assert rows["missed calyces"] == "none"


def test_a_visit_is_neither_a_glance_nor_a_blink() -> None:
    names = ["A"] * 10 + [""] * 5 + ["A"] * 5 + ["B"] * 3 + [""] * 15 + ["A"] * 10 + ["C"] * 6
    assert count_visits(0.1 * np.arange(len(names)), names) == {"A": 2, "C": 1}
    assert count_visits(np.zeros(0), []) == {}


class Painting:
    """A coverage in which A is glimpsed at the second picture and inspected at the sixth, and B never."""

    def __init__(self) -> None:
        self.added: list[float] = []
        self.sd_mm: list[float | None] = []

    def add(self, T: np.ndarray, seconds: float, position_sd_mm: float | None = None) -> None:
        self.added.append(seconds)
        self.sd_mm.append(position_sd_mm)

    def calyces(self) -> list[CalyxCoverage]:
        count = len(self.added)
        verdict = INSPECTED if count >= 6 else GLIMPSED if count >= 2 else UNSEEN
        return [covered("A", verdict), covered("B", UNSEEN)]


def test_time_to_inspect_goes_from_first_sight_and_only_what_counts_is_painted() -> None:
    T = np.repeat(np.eye(4)[None], 10, axis=0)
    T[3] = np.nan
    painting = Painting()
    t_s = np.arange(10.0)
    found = training_figures(painting, t_s, ["A"] * 10, T, np.full(10, 0.2))  # type: ignore[arg-type]
    assert painting.added == [0.2] * 9
    assert found.inspected_s == {"A": 5.0} and found.missed == ["B"], "from the second picture to the seventh"
    assert calyx_training(found, "A") == {"visits": 1, "inspected": "5.0 s"}
    assert calyx_training(found, "B") == {"visits": 0, "inspected": ""}


def test_wall_counts_by_how_far_off_the_place_may_have_been() -> None:
    painting, T = Painting(), np.repeat(np.eye(4)[None], 3, axis=0)
    told = np.array([0.2, np.nan, 1.4])
    training_figures(painting, np.arange(3.0), ["A"] * 3, T, np.full(3, 0.2), told)  # type: ignore[arg-type]
    assert painting.sd_mm == [0.2, None, 1.4]


def test_an_inspection_that_ends_between_two_looks_at_the_wall_is_counted() -> None:
    t_s, T = 0.1 * np.arange(6.0), np.repeat(np.eye(4)[None], 6, axis=0)
    found = training_figures(Painting(), t_s, ["A"] * 6, T, np.full(6, 0.1))  # type: ignore[arg-type]
    assert found.inspected_s == {"A": pytest.approx(0.2)}, "seen at the look after 0.3 s, inspected at the end"


@pytest.mark.parametrize(
    ("path_mm", "scale", "words"),
    [
        (800.0, 1.0, "800 mm: shorter than experts'"),
        (1164.0, 1.0, "1164 mm: as experts'"),
        (1500.0, 1.0, "1500 mm: between experts' and novices'"),
        (2182.0, 1.0, "2182 mm: as novices'"),
        (3000.0, 1.0, "3000 mm: longer than novices'"),
        (1800.0, 1.8, "1800 mm (1000 mm at scale 1): as experts'"),
    ],
)
def test_a_path_is_read_beside_published_ones_of_a_kidney_as_large_as_life(path_mm, scale, words) -> None:
    row = training_rows(TrainingFigures(), path_mm, 4.0, scale)[0]
    assert (row["value"], row["novices"], row["experts"]) == (words, "2182 ± 613 mm", "1164 ± 290 mm")


def test_the_path_of_half_a_kidney_is_not_read_beside_those_of_whole_ones() -> None:
    half = replace(TrainingFigures(), calyces=[covered("A", INSPECTED), covered("B", UNSEEN)])
    assert training_rows(half, 85.0, 4.0, 1.0)[0]["value"] == "85 mm: not of a whole kidney"


def test_visits_that_are_not_the_first_are_said() -> None:
    figures = replace(TrainingFigures(), visits={"A": 3, "B": 1}, inspected_s={"A": 8.0, "B": 4.0})
    rows = {row["name"]: row["value"] for row in training_rows(figures, 0.0, 3.25, 1.0)}
    assert rows["visits"] == "4 in 2 calyces, 2 of them again"
    assert rows["from first sight of a calyx to inspected"] == "6.0 s, median of 2"
    assert rows["speed while moving, median"] == "3.2 mm/s"


def test_verdicts_are_those_that_navigation_told_as_it_went_on() -> None:
    """It knows of stones before the wall; painting the poses again does not."""
    painted = TrainingFigures(
        {"A": 1}, {"A": 0.5, "B": 1.0},
        [CalyxCoverage(name, "", "inspected", 0.9, 1.0, 50.0) for name in "ABC"],
    )  # fmt: skip
    told = [
        (2.0, {"A": ["glimpsed", 0.2], "B": ["unseen", 0.0]}),
        (5.0, {"A": ["inspected", 0.8], "B": ["glimpsed", 0.3]}),
    ]
    found = as_told(painted, told)
    assert [(c.verdict, c.share) for c in found.calyces] == [("inspected", 0.8), ("glimpsed", 0.3), ("inspected", 0.9)]
    assert found.inspected_s == {"A": 3.0} and found.visits == {"A": 1} and found.missed == ["B"]
    assert as_told(painted, []) is painted
