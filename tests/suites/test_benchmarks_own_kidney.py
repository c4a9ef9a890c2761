"""The own-kidney suite on flights made of numbers: what is believed, and when the mirrored picture counts."""

import numpy as np

from benchmarks.own_kidney import Flight, add_beliefs, verdicts
from benchmarks.shared.results import Report
from ursnav_torch.tracking.settings import OwnKidneySettings


def flown(own: bool, score: float, decoy: float, pictures: int = 40) -> Flight:
    """Pictures that all score alike, and so do their mirror images."""
    return Flight(own, np.arange(pictures) / 10, np.tile([score, 0.0, 1.2, decoy], (pictures, 1)))


def test_a_wrong_kidney_that_fits_as_well_is_told_by_its_mirror_image() -> None:
    """In murky pictures a right one scores as little as a wrong one in clear ones."""
    flights = [flown(True, 0.55, 0.4), flown(False, 0.55, 0.55), flown(False, 0.4, 0.4)]
    for weights, right, wrong in (((3.4, -8.0), 90, 0), ((0.0, 0.0), 90, 45)):
        report = Report("own_kidney", {})
        add_beliefs(report, "as tried", flights, OwnKidneySettings(doubt_weights=weights))
        own, other = report.rows
        assert own.median > right and own.note == "0 of 1 end lost"
        assert other.median == 0 if not wrong else other.median > wrong
        assert other.note == f"{2 if not wrong else 1} of 2 end lost" and other.n == 80


def test_the_decoy_counts_in_doubt_alone_and_a_verdict_stands() -> None:
    right, settings = flown(True, 0.9, 0.4), OwnKidneySettings()
    said = verdicts(right, settings)
    assert said[0] is True and said[-1] is True
    worse = right.evidence.copy()
    worse[5:, 3] = 5.0  # in a track that is believed nobody looks in the mirror
    worse[30:] = np.nan
    assert verdicts(Flight(True, right.t_s, worse), settings) == said
    worse[:, 3] = 5.0
    assert True not in verdicts(Flight(True, right.t_s, worse), settings)
