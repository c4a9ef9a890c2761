"""The suite that sorts wrong answers by their cause, on stills whose cause is made."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.causes import ALIGNMENT, RANKING, RIGHT, SEARCH, UNREAD, Near, cause, main, tell
from benchmarks.causes.choices import DEFAULT, choices
from benchmarks.shared.kidneys import Still
from benchmarks.shared.results import Report
from ursnav_torch.alignment import RefinementSettings, Refiner
from ursnav_torch.errors import InputError
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid

NEAR = Near(4.0, 25.0)


@pytest.fixture(scope="module")
def localizer(vid: Vid) -> Localizer:
    return Localizer(vid)


@pytest.fixture(scope="module")
def refiner(vid: Vid) -> Refiner:
    return Refiner(vid)


def still(vid: Vid, renderer: RaycastRenderer, shown: int, told: int) -> Still:
    """A picture of one view, said to be of another."""
    name, T = vid.calyx_name(int(vid.calyx[told])), vid.T_kidney_camera[told]
    return Still("phantom", "drawn", "0.png", renderer.render(vid.T_kidney_camera[shown]).image, name, T)


def views(vid: Vid) -> tuple[int, int]:
    """A view of each of two calyces."""
    return int(np.flatnonzero(vid.calyx == 1)[0]), int(np.flatnonzero(vid.calyx == 4)[0])


def test_a_still_that_is_named_rightly_is_right(
    vid: Vid, renderer: RaycastRenderer, localizer: Localizer, refiner: Refiner
) -> None:
    a, _ = views(vid)
    assert cause(localizer, refiner, still(vid, renderer, a, a), NEAR) == (RIGHT, True)


def test_a_picture_of_another_place_is_one_that_the_search_missed_and_the_truth_is_not_preferred(
    vid: Vid, renderer: RaycastRenderer, localizer: Localizer, refiner: Refiner
) -> None:
    a, b = views(vid)
    far = Near(1.0, 5.0)
    assert cause(localizer, refiner, still(vid, renderer, a, b), far) == (SEARCH, False)
    told, _ = cause(localizer, refiner, still(vid, renderer, a, b), Near(1000.0, 181.0))
    assert told == RANKING, "a start counts as near the truth wherever it is, and the answer fits better"


def test_a_blank_picture_is_unread(vid: Vid, renderer: RaycastRenderer, localizer: Localizer, refiner: Refiner) -> None:
    a, _ = views(vid)
    blank = still(vid, renderer, a, a)
    white = Still("phantom", "drawn", "0.png", np.full_like(blank.image, 250), blank.calyx, blank.T_kidney_camera)
    assert cause(localizer, refiner, white, NEAR) == (UNREAD, False)


def test_every_cause_has_its_row() -> None:
    report = Report("causes", {})
    tell(report, "kidney", [(RIGHT, True), (SEARCH, True), (SEARCH, False), (ALIGNMENT, True)])
    shares = {row.name: row.median for row in report.rows}
    assert shares == {RIGHT: 25.0, UNREAD: 0.0, SEARCH: 50.0, ALIGNMENT: 25.0, RANKING: 0.0}
    notes = {row.name: row.note for row in report.rows}
    assert notes[SEARCH] == "2/4, in 1 of them the true pose would be preferred to the answer"


def test_settings_are_varied_one_at_a_time() -> None:
    assert choices("")[DEFAULT].alignment == RefinementSettings()
    varied = choices("coarse_px=40,52")
    assert [choice.alignment for choice in varied.values()] == [RefinementSettings(coarse_px=n) for n in (40, 52)]
    assert choices("pnp_starts=3")["pnp_starts=3"].localization.pnp_starts == 3
    assert not choices("verify=false")["verify=false"].alignment.verify


@pytest.mark.parametrize(
    ("vary", "message"),
    [("nothing=3", "is no setting of"), ("coarse_px", "NAME=VALUE"), ("coarse_px=x", "no value of")],
)
def test_a_setting_that_is_none_is_refused(vary: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        choices(vary)


def test_settings_are_not_chosen_by_given_kidneys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"work={tmp_path}", "vary=coarse_px=40,52"]) != 0
    assert "phantoms are what they are chosen by" in capsys.readouterr().err


def test_phantoms_give_a_table_for_every_value(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "causes.json"
    arguments = ["phantoms=1", "pictures=1", "views=6", "vary=hypotheses=1,2", f"out={out}"]
    assert main([f"work={tmp_path}", *arguments]) == 0
    printed = capsys.readouterr().out
    assert all(words in printed for words in ("phantoms, hypotheses=1", "phantoms, hypotheses=2", "right, wide wall"))
