"""Two stages: the coarse one passes on what the exact one would choose, and only what was proven is compared."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.features import Features
from ursnav_torch.geometry import transform_from
from ursnav_torch.localization import Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import SearchSettings, ViewSearch
from ursnav_torch.search.screening import ScreenedViews
from ursnav_torch.vid import Vid, make_screen

#: Of the small VID's views, 16 are passed on by the coarse stage and 8 by the exact scan.
FEW = SearchSettings(scan_finalists=8, finalists=8)


@pytest.fixture(scope="module")
def screened(vid: Vid) -> Vid:
    return replace(vid, screen=make_screen(vid.features))


def seen(vid: Vid, renderer: RaycastRenderer, view: int, roll_deg: float = 0.0) -> Features:
    R = Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    T = vid.T_kidney_camera[view] @ transform_from(R, np.zeros(3))
    return vid.extractor().extract(renderer.render(T).image, virtual=True)


@pytest.mark.parametrize(("view", "roll_deg"), [(3, 0.0), (27, 100.0), (50, -35.0)])
def test_finds_what_the_exhaustive_search_finds(
    vid: Vid, screened: Vid, renderer: RaycastRenderer, view: int, roll_deg: float
) -> None:
    features = seen(vid, renderer, view, roll_deg)
    found, expected = ViewSearch(screened, FEW).rank(features), ViewSearch(vid, FEW).rank(features)
    assert found.views[0] == expected.views[0] == view and len(found) == 8
    same = [(i, list(expected.views).index(v)) for i, v in enumerate(found.views) if v in expected.views]
    assert len(same) >= 6
    for i, j in same:
        np.testing.assert_allclose(found.score[i], expected.score[j], atol=1e-4)
        np.testing.assert_allclose(found.T_kidney_camera[i], expected.T_kidney_camera[j], atol=1e-3)


def test_coarse_scores_are_about_the_exact_ones(vid: Vid, screened: Vid, renderer: RaycastRenderer) -> None:
    features = seen(vid, renderer, 12, 70.0)
    settings = SearchSettings(relief_weight=0.5)
    coarse = ScreenedViews(screened, settings).scores(features.maps).numpy()
    exact = ViewSearch(vid, settings).everywhere(features).score
    assert np.corrcoef(coarse, exact)[0, 1] > 0.95 and np.abs(coarse - exact).max() < 0.25 * settings.map_weight
    assert coarse.argmax() == exact.argmax() == 12


def test_a_picture_with_a_body_before_the_wall_is_screened_by_what_is_wall(
    vid: Vid, screened: Vid, renderer: RaycastRenderer
) -> None:
    whole = seen(vid, renderer, 27)
    valid = torch.ones(whole.fields.shape[1:])
    valid[:20] = 0
    found = ViewSearch(screened, FEW).rank(replace(whole, valid=valid))
    assert found.views[0] == 27


def test_a_video_s_scan_of_all_views_is_exact(vid: Vid, screened: Vid, renderer: RaycastRenderer) -> None:
    features = seen(vid, renderer, 5)
    found, expected = (ViewSearch(v, FEW).everywhere(features) for v in (screened, vid))
    np.testing.assert_array_equal(found.score, expected.score)


def test_a_localizer_answers_with_it(vid: Vid, screened: Vid, renderer: RaycastRenderer) -> None:
    image = renderer.render(vid.T_kidney_camera[40]).image
    found, expected = Localizer(screened).locate(image), Localizer(vid).locate(image)
    assert (found.view, found.calyx_name) == (expected.view, expected.calyx_name)
    np.testing.assert_allclose(found.T_kidney_camera, expected.T_kidney_camera, atol=1e-3)


def test_features_that_were_changed_are_refused_when_they_are_read(vid: Vid, renderer: RaycastRenderer) -> None:
    features, maps = seen(vid, renderer, 27), vid.features.maps.clone()
    changed = replace(vid, features=replace(vid.features, maps=maps), screen=make_screen(vid.features))
    assert changed.screen is not None
    changed.screen.proven[:] = False
    assert ViewSearch(changed, FEW).rank(features).views[0] == 27
    assert 8 <= int(changed.screen.proven.sum()) <= 16  # nobody reads the others
    maps[27, 0, 0, 0] += 0.5
    changed.screen.proven[:] = False
    with pytest.raises(InputError, match=r"The features of view 27 of the VID .* were changed after it was built"):
        ViewSearch(changed, FEW).rank(features)
