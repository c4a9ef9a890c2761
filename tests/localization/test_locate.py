"""Where a picture was taken, and the conventions of the answer."""

from dataclasses import replace

import numpy as np
import pytest

from ursnav_torch.alignment import Refiner
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.geometry import angle_between, look_along, rotation_angle, transform_from
from ursnav_torch.localization import LocalizationSettings, Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid


@pytest.fixture(scope="module")
def localizer(vid: Vid) -> Localizer:
    return Localizer(vid)


def rolled(T_kidney_camera: np.ndarray, degrees: float) -> np.ndarray:
    """The camera turned about its own optical axis, x towards y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return T_kidney_camera @ transform_from([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.zeros(3))


def test_convention_rolling_is_look_alongs_roll() -> None:
    np.testing.assert_allclose(
        rolled(look_along([1, 2, 3], [1, 1, 0]), 40), look_along([1, 2, 3], [1, 1, 0], np.radians(40)), atol=1e-12
    )


@pytest.mark.parametrize("view", [3, 27])
@pytest.mark.parametrize("roll_deg", [40.0, -100.0, 180.0])
def test_convention_a_rolled_scope_is_found_rolled(
    localizer: Localizer, renderer: RaycastRenderer, view: int, roll_deg: float
) -> None:
    """The sign of the roll, end to end: the view drawn with the camera rolled by +40 degrees is found at +40."""
    truth = rolled(localizer.vid.T_kidney_camera[view], roll_deg)
    found = localizer.locate(renderer.render(truth).image)
    assert found.view == view
    assert np.degrees(rotation_angle(truth, found.T_kidney_camera)) < 2
    np.testing.assert_allclose(found.T_kidney_camera[:3, 3], truth[:3, 3], atol=0.5)


def test_a_view_is_found_where_it_stands(localizer: Localizer, vid: Vid, picture: np.ndarray) -> None:
    found = localizer.locate(picture)
    assert found.view == 3 == found.candidates[0].view and found.calyx == vid.calyx[3]
    assert found.calyx_name == vid.calyx_name(found.calyx)
    assert found.distance == found.candidates[0].distance and 0 <= found.confidence <= 1
    assert len({c.view for c in found.candidates}) == len(found.candidates) == 5
    assert found.accepted == (found.confidence >= localizer.threshold)
    assert np.linalg.norm(found.T_kidney_camera[:3, 3] - vid.T_kidney_camera[3][:3, 3]) < 0.5
    assert np.degrees(rotation_angle(found.T_kidney_camera, vid.T_kidney_camera[3])) < 2


def test_pictures_between_the_views_are_found_near(localizer: Localizer, vid: Vid, renderer: RaycastRenderer) -> None:
    """Half a millimeter aside, tilted by 4 degrees and rolled: in the right calyx, within millimeters and degrees."""
    rng = np.random.default_rng(0)
    right, off_mm, off_deg = [], [], []
    for view in (2, 14, 26, 38, 50, 62):
        T = vid.T_kidney_camera[view]
        at, axis = T[:3, 3] + rng.normal(0, 0.3, 3), T[:3, 2] + rng.normal(0, 0.05, 3)
        truth = look_along(at, axis, rng.uniform(-np.pi, np.pi))
        found = localizer.locate(renderer.render(truth).image)
        right.append(found.calyx == vid.calyx[view])
        off_mm.append(np.linalg.norm(found.T_kidney_camera[:3, 3] - at))
        off_deg.append(np.degrees(angle_between(found.T_kidney_camera[:3, 2], axis)))
    assert np.mean(right) >= 5 / 6 and np.median(off_mm) < 3 and np.median(off_deg) < 10


def test_a_refined_pose_that_fits_badly_is_met_halfway_by_the_views_own(vid: Vid, picture: np.ndarray) -> None:
    def pose(**settings: float) -> np.ndarray:
        return Localizer(vid, settings=LocalizationSettings(**settings)).locate(picture).T_kidney_camera[:3, 3]

    views, sure = pose(refine=False), pose(min_score_to_override_calyx=-1.0, min_score_to_replace_mean=-1.0)
    assert not np.allclose(views, sure)
    neither = {"min_score_to_override_calyx": 1.1, "min_score_to_replace_mean": 1.1}
    for doubtful in (pose(min_score_to_replace_mean=1.1), pose(**neither)):
        np.testing.assert_allclose(doubtful, (views + sure) / 2, atol=1e-6)


def test_a_refined_pose_that_contradicts_the_votes_must_fit_better(
    vid: Vid, picture: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Localizer(vid, settings=LocalizationSettings(refine=False)).locate(picture)
    other = next(i for i, calyx in enumerate(vid.calyx.tolist()) if calyx not in (plain.calyx, -1))
    asked = Localizer(vid)
    features, refiner = asked.features(picture), Refiner(vid)
    there = int(vid.calyx[other])
    for score, verified, calyx in ((0.69, False, plain.calyx), (0.71, False, there), (0.5, True, there)):
        # on either side of 0.6 + 0.1; where the network compared them, it has the last word
        elsewhere = replace(refiner.refine(features, [vid.T_kidney_camera[other]]), score=score, verified=verified)
        elsewhere = replace(elsewhere, T_kidney_camera=vid.T_kidney_camera[other])
        monkeypatch.setattr(Refiner, "refine", lambda self, *given, elsewhere=elsewhere: elsewhere)
        found = asked.locate(picture)
        assert found.calyx == calyx
        away = np.linalg.norm(found.T_kidney_camera[:3, 3] - vid.T_kidney_camera[other, :3, 3])
        assert (away < 1e-6) == (calyx != plain.calyx)  # far from each other, the one or the other, nothing between
        monkeypatch.undo()


def test_neither_color_nor_exposure_matters(localizer: Localizer, picture: np.ndarray) -> None:
    straight = localizer.locate(picture)
    red = np.dstack([picture * 0.2, picture * 0.3, picture * 0.8]).astype(np.uint8)
    for other in (red, (picture * 0.5).astype(np.uint8), np.dstack([picture] * 3)):
        assert localizer.locate(other).view == straight.view


def test_the_same_picture_gives_the_same_answer(localizer: Localizer, picture: np.ndarray) -> None:
    first, again = localizer.locate(picture), localizer.locate(picture)
    assert [c.view for c in first.candidates] == [c.view for c in again.candidates]
    np.testing.assert_allclose(first.T_kidney_camera, again.T_kidney_camera, atol=1e-6)


def test_refusals(localizer: Localizer, picture: np.ndarray) -> None:
    with pytest.raises(FeatureError, match="all black"):
        localizer.locate(np.zeros_like(picture))
    with pytest.raises(FeatureError, match="all white"):
        localizer.locate(np.full_like(picture, 255))
    with pytest.raises(InputError, match="1 x 1 px, but the lens is 96 x 96"):
        localizer.locate(picture[:1, :1])
    with pytest.raises(InputError, match="uint8"):
        localizer.locate(picture.astype(float))  # type: ignore[arg-type]
