"""The own-kidney suite on sequences made of numbers: what is fitted, what is believed, when the mirror counts."""

from pathlib import Path

import numpy as np

from benchmarks.own_kidney import FLIGHT, INSPECTION, Seen, add_beliefs, verdicts
from benchmarks.own_kidney.inspections import RATE_HZ, inspected
from benchmarks.own_kidney.weights import PRIOR, fitted
from benchmarks.shared.flights import CHOOSING, Case
from benchmarks.shared.results import Report
from ursnav_torch.tracking.settings import OwnKidneySettings
from ursnav_torch.vid import Vid


def flown(own: bool, score: float, decoy: float, pictures: int = 40, kind: str = FLIGHT) -> Seen:
    """Pictures that all score alike, and so do their mirror images."""
    return Seen(kind, "a", own, np.arange(pictures) / 10, np.tile([score, 1.2, decoy], (pictures, 1)))


def test_a_wrong_kidney_that_fits_as_well_is_told_by_its_mirror_image() -> None:
    """In murky pictures a right one scores as little as a wrong one in clear ones."""
    flights = [flown(True, 0.65, 0.4), flown(False, 0.65, 0.65), flown(False, 0.4, 0.4)]
    for decoy, right, wrong in ((-17.2, 85, 0), (0.0, 85, 40)):
        report = Report("own_kidney", {})
        settings = OwnKidneySettings(doubt_weights=(-1.4 if decoy else -9.0, 17.2, 0.0, decoy))
        add_beliefs(report, "as tried", [(one, settings) for one in flights])
        own, _, other, given_up = report.rows
        assert own.median > right and own.note == "0 of 1 end lost"
        assert other.median == 0 if not wrong else other.median > wrong
        assert other.note == f"{2 if not wrong else 1} of 2 end lost" and other.n == 80
        assert given_up.median <= 100 - other.median


def test_kinds_are_told_apart() -> None:
    report = Report("own_kidney", {})
    seen = [flown(True, 0.9, 0.4), flown(True, 0.2, 0.4, kind=INSPECTION)]
    add_beliefs(report, "as set", [(one, OwnKidneySettings()) for one in seen])
    assert [(r.name.split(":")[0], r.median > 60) for r in report.rows] == [
        (FLIGHT, True), (FLIGHT, False), (INSPECTION, False), (INSPECTION, True)
    ]  # fmt: skip


def test_the_decoy_counts_in_doubt_alone_and_a_verdict_stands() -> None:
    right, settings = flown(True, 0.9, 0.4), OwnKidneySettings()
    said = verdicts(right, settings)
    assert said[0] is True and said[-1] is True
    worse = right.evidence.copy()
    worse[5:, 2] = 5.0  # in a track that is believed nobody looks in the mirror
    worse[30:] = np.nan
    assert verdicts(Seen(FLIGHT, "a", True, right.t_s, worse), settings) == said
    worse[:, 2] = 5.0
    assert True not in verdicts(Seen(FLIGHT, "a", True, right.t_s, worse), settings)


def test_weights_are_those_that_made_the_evidence() -> None:
    rng = np.random.default_rng(3)
    evidence = np.column_stack(
        [rng.uniform(0.2, 1, 20_000), rng.uniform(0.8, 2, 20_000), rng.uniform(0.2, 0.9, 20_000)]
    )
    odds = -1.0 + 14.0 * (evidence[:, 0] - evidence[:, 2])
    own = rng.random(20_000) < 1 / (1 + np.exp(-odds))
    shares = np.mean(own), np.mean(~own)
    found = fitted([evidence[own]], [evidence[~own]], OwnKidneySettings())
    want = np.array([PRIOR - 1.0 - np.log(shares[0] / shares[1]), 14.0, 0.0, -14.0])  # both sides count alike
    np.testing.assert_allclose(found.doubt_weights, want, rtol=0.2, atol=0.5)
    assert found.weights[1] > 4 and len(found.weights) == 3


def test_sequences_count_alike_and_pictures_not_asked_do_not_count() -> None:
    rng = np.random.default_rng(4)

    def some(n: int, score: float) -> np.ndarray:
        return np.column_stack([rng.normal(score, 0.15, n), rng.normal(1.2, 0.1, n), rng.normal(0.5, 0.1, n)])

    own, other = [some(60, 0.8), some(60, 0.7)], [some(60, 0.5), some(60, 0.55)]
    gaps = np.full((25, 3), np.nan)
    plain = fitted(own, other, OwnKidneySettings())
    assert fitted([np.concatenate([e, gaps]) for e in own], other, OwnKidneySettings()) == plain
    assert fitted([np.tile(own[0], (9, 1)), own[1]], other, OwnKidneySettings()) == plain


def test_an_inspection_is_drawn_once_with_what_the_robot_reports(vid: Vid, tmp_path: Path) -> None:
    case = Case("a", 3, CHOOSING, "thesis_simulation", 0.0, 1)
    seen = inspected(case, vid, 5, tmp_path)
    first = seen.folder / "0000.png"
    drawn, count = first.stat().st_mtime_ns, len(seen.flight.t_s)
    assert 5 <= count <= 6 and len(list(seen.folder.glob("*.png"))) == count
    assert seen.flight.T_kidney_camera.shape == (count, 4, 4) and seen.flight.odometry.shape == (count, 3)
    np.testing.assert_allclose(np.diff(seen.flight.t_s), 1 / RATE_HZ, atol=0.03)
    assert min(image.std() for image in seen.images()) > 1
    again = inspected(case, vid, 5, tmp_path)
    assert again.folder == seen.folder and first.stat().st_mtime_ns == drawn
    np.testing.assert_array_equal(again.flight.T_kidney_camera, seen.flight.T_kidney_camera)


def test_in_doubt_a_share_of_the_evidence_is_the_lead_alone_and_a_right_kidney_is_likelier() -> None:
    rng = np.random.default_rng(5)
    own, other = (
        [np.column_stack([rng.normal(s, 0.15, 80), rng.normal(1.2, 0.1, 80), rng.normal(0.5, 0.1, 80)])]
        for s in (0.8, 0.5)
    )
    free, lead, half = (
        np.array(fitted(own, other, OwnKidneySettings(), relative, 0.0).doubt_weights) for relative in (0.0, 1.0, 0.5)
    )
    assert lead[2] == 0 and lead[1] == -lead[3] > 0 and free[2] != 0
    np.testing.assert_allclose(half, (free + lead) / 2, atol=0.06)
    likelier = fitted(own, other, OwnKidneySettings(), 0.0, 0.7).doubt_weights
    np.testing.assert_allclose(np.array(likelier) - free, [0.7, 0, 0, 0], atol=1e-9)
