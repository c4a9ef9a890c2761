import cv2
import numpy as np
import pytest
import torch
from skimage.filters import apply_hysteresis_threshold
from skimage.measure import label

from ursnav_torch.features.edges import edge_points, link, thin_gradient


def relief(seed: int, size: tuple[int, int] = (61, 83)) -> torch.Tensor:
    """Smooth structure with flat parts, as outside a lens."""
    noise = np.random.default_rng(seed).normal(size=size).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    smooth[:, :12] = 0
    return torch.from_numpy(10 * smooth)


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_alike_across_a_step_one_is_the_ridge(turned: bool) -> None:
    step = torch.zeros(20, 20)
    step[:, 10:] = 1.0
    thin = thin_gradient(step.T.contiguous() if turned else step, 1e-3)
    columns = (thin if not turned else thin.T)[2:-2].nonzero()[:, 1]
    assert columns.unique().tolist() == [9]


def test_edges_are_linked_as_scikit_image_does() -> None:
    ridge = thin_gradient(relief(3), 1.2)
    low, high = np.quantile(ridge[ridge > 0], (0.4, 0.8))
    strong = apply_hysteresis_threshold(ridge.numpy(), low, high)
    groups = label(strong, connectivity=2)
    expected = (np.bincount(groups.ravel()) >= 8)[groups] & strong
    found = link(ridge, float(low), float(high), 8)
    assert 0 < expected.sum() < strong.sum() and (found == expected).all()
    assert not link(ridge, 1e9, 1e9, 1).any()


def test_no_edges_give_no_points() -> None:
    found = edge_points(np.zeros((5, 6), bool), torch.zeros(2, 5, 6), torch.zeros(5, 6), (2.0, 2.0))
    assert found.points.shape == (0, 2) and found.direction.shape == found.weight.shape == (0,)
