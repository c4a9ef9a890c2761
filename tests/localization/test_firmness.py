"""How firmly a pose says which calyx it observes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import angle_between, transform_from
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx
from ursnav_torch.localization.firmness import _moves, label_shares
from ursnav_torch.vid import Vid


def turned_to(T: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """A pose (4, 4) at the same place that looks along an axis (3,)."""
    R, _ = Rotation.align_vectors(axis[None], T[None, :3, 2])
    return transform_from(R.as_matrix() @ T[:3, :3], T[:3, 3])


def ways_to(T: np.ndarray, kidney: Kidney, calyces: np.ndarray) -> np.ndarray:
    ways = kidney.tips_mm[calyces] - T[:3, 3]
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def between(vid: Vid) -> tuple[np.ndarray, np.ndarray]:
    """A view from which two tips are near, and those two."""
    far = vid.lumen.to_calyces(vid.T_kidney_camera[:, :3, 3])
    apart = [
        angle_between(*ways_to(T, vid.kidney, f.argsort()[:2])) for T, f in zip(vid.T_kidney_camera, far, strict=True)
    ]
    fits = (np.sort(far, 1)[:, 1] < 12.0) & (np.array(apart) > np.radians(40))
    row = int(np.flatnonzero(fits)[0])
    return vid.T_kidney_camera[row], far[row].argsort()[:2]


def test_a_pose_on_the_border_of_two_calyces_is_half_of_each(vid: Vid, between: tuple[np.ndarray, np.ndarray]) -> None:
    T, pair = between
    ways = ways_to(T, vid.kidney, pair)
    on_it = label_shares(turned_to(T, ways.sum(0)), vid.kidney, vid.lumen)
    assert on_it[pair].sum() > 0.9 and on_it[pair].min() > 0.3
    beside = label_shares(turned_to(T, ways[0]), vid.kidney, vid.lumen)
    assert beside[pair[0]] > 0.95


def test_shares_are_of_the_label_of_the_pose_and_always_the_same(vid: Vid) -> None:
    T = vid.T_kidney_camera[::12]
    shares = np.array([label_shares(one, vid.kidney, vid.lumen) for one in T])
    np.testing.assert_allclose(shares.sum(1), 1.0)
    own = observed_calyx(T, vid.kidney, vid.lumen)
    assert np.mean(shares.argmax(1) == own % shares.shape[1]) > 0.7
    np.testing.assert_array_equal(shares[0], label_shares(T[0], vid.kidney, vid.lumen))


def test_errors_grow_with_the_kidney(vid: Vid, between: tuple[np.ndarray, np.ndarray]) -> None:
    large, T = vid.kidney.scaled(2.0), between[0].copy()
    T[:3, 3] *= 2.0
    shares = label_shares(T, large, LumenDistance.from_kidney(large))
    np.testing.assert_allclose(shares, label_shares(between[0], vid.kidney, vid.lumen), atol=0.1)
    small, grown = _moves(1.0), _moves(2.0)
    np.testing.assert_allclose(grown[:, :3, 3], 2.0 * small[:, :3, 3])
    np.testing.assert_array_equal(grown[:, :3, :3], small[:, :3, :3])
