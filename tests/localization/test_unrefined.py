"""What the search alone answers: refinement, which would hide its errors, is off."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import rotation_angle, transform_from
from ursnav_torch.localization import LocalizationSettings, Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import SearchSettings
from ursnav_torch.vid import Vid

VIEWS = (3, 14, 27, 41, 62)


@pytest.fixture(scope="module")
def nearest(vid: Vid) -> Localizer:
    return Localizer(vid, settings=LocalizationSettings(refine=False))


def turned(T_kidney_camera: np.ndarray, rotvec_deg: list[float]) -> np.ndarray:
    """The camera turned on the spot, about its own axes."""
    return T_kidney_camera @ transform_from(Rotation.from_rotvec(np.radians(rotvec_deg)).as_matrix(), np.zeros(3))


@pytest.mark.parametrize("rotvec_deg", [[8.0, 0, 0], [-8.0, 0, 0], [0, 8.0, 0], [6.0, -6.0, 0], [5.0, 5.0, 60.0]])
def test_convention_a_tilted_scope_is_found_tilted(
    nearest: Localizer, renderer: RaycastRenderer, rotvec_deg: list[float]
) -> None:
    """The sign of the tilt, end to end: transposed, the error would be twice the tilt."""
    off = []
    for view in VIEWS:
        truth = turned(nearest.vid.T_kidney_camera[view], rotvec_deg)
        found = nearest.locate(renderer.render(truth).image)
        assert found.view == view
        off.append(np.degrees(rotation_angle(found.candidates[0].T_kidney_camera, truth)))
    assert np.median(off) < 4.5 and np.max(off) < 7.0


def test_the_answers_pose_is_the_mean_of_the_near_best_views(nearest: Localizer, renderer: RaycastRenderer) -> None:
    for view in VIEWS[:3]:
        truth = turned(nearest.vid.T_kidney_camera[view], [3.0, -4.0, 20.0])
        found = nearest.locate(renderer.render(truth).image)
        assert np.linalg.norm(found.T_kidney_camera[:3, 3] - truth[:3, 3]) < 1.0
        assert np.degrees(rotation_angle(found.T_kidney_camera, truth)) < 5.0


def test_each_distance_is_a_weighted_mean_of_relief_directions_and_shape(vid: Vid, picture: np.ndarray) -> None:
    """Distances with all three are those without shape, and those of shape alone, as the weights have it."""
    unrefined, plain = LocalizationSettings(refine=False, keep=16), SearchSettings(finalists=16)

    def distances(**weights: float) -> dict[int, float]:
        found = Localizer(vid, settings=unrefined, search=replace(plain, **weights)).locate(picture)
        return {c.view: c.distance for c in found.candidates}

    maps = distances(shape_weight=0.0)
    shape = distances(relief_weight=1e-6, direction_weight=2e-6, shape_weight=1.0)
    mixed, more = distances(), distances(shape_weight=9.0)
    views = sorted(set(maps) & set(shape) & set(mixed) & set(more))
    assert len(views) == 16  # the maps alone choose them
    d, s = np.array([maps[v] for v in views]), np.array([shape[v] for v in views])
    np.testing.assert_allclose([mixed[v] for v in views], 0.6 * d + 0.4 * s, atol=2e-3)
    np.testing.assert_allclose([more[v] for v in views], 0.25 * d + 0.75 * s, atol=2e-3)
    assert np.ptp(s) > 0.05  # and shape does tell views apart
