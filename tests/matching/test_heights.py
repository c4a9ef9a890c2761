import numpy as np
import pytest
import torch
from torch import Tensor

from ursnav_torch.errors import ShapeError
from ursnav_torch.matching.heights import contour_heights

TURN = torch.linspace(0, 2 * torch.pi, 61)[:60]


def outline(bend: float = 0.0) -> tuple[Tensor, Tensor]:
    """A bumpy closed outline (1, 60, 2) and its tangents (1, 60)."""
    radius = 40 + 9 * torch.cos(3 * TURN + bend * TURN.sin()) + 5 * torch.sin(2 * TURN)
    points = radius[:, None] * torch.stack([TURN.cos(), TURN.sin()], 1)
    step = points.roll(-1, 0) - points.roll(1, 0)
    return points[None], torch.atan2(step[:, 1], step[:, 0])[None]


def test_heights_by_hand() -> None:
    points, tangents = outline()
    found = contour_heights(points, tangents)[0]
    assert found.shape == (60, 11) and found.dtype == torch.float32

    def height(i: int, place: int) -> float:
        angle = tangents[0, i].item()
        along = np.cos(angle), np.sin(angle)
        way = (points[0, (i + place) % 60] - points[0, i]).numpy()
        return float(along[0] * way[1] - along[1] * way[0])

    means = np.array([[np.mean([height(i, 3 + 5 * k + j) for j in range(5)]) for k in range(11)] for i in range(60)])
    weights = 1 / np.minimum(np.arange(11) + 0.5, 10.5 - np.arange(11))
    wanted = means / np.abs(means).max(0) * np.sqrt(weights / weights.sum())
    np.testing.assert_allclose(found.numpy(), wanted, atol=1e-5)


def test_neither_place_nor_roll_nor_size_counts() -> None:
    points, tangents = outline()
    angle = 0.7
    turn = torch.tensor([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], dtype=torch.float32)
    moved = contour_heights(3.0 * points @ turn.T + 100, tangents + angle)
    torch.testing.assert_close(moved, contour_heights(points, tangents), atol=1e-4, rtol=0)


def test_another_start_only_renumbers() -> None:
    points, tangents = outline()
    there = contour_heights(points.roll(-7, 1), tangents.roll(-7, 1))
    torch.testing.assert_close(there, contour_heights(points, tangents).roll(-7, 1))


def test_the_more_it_bends_the_farther_it_is() -> None:
    straight = contour_heights(*outline())
    apart = [float((contour_heights(*outline(bend)) - straight).norm(dim=2).mean()) for bend in (0.1, 0.3, 0.6)]
    assert 0 < apart[0] < apart[1] < apart[2]


def test_no_outlines_and_what_it_refuses() -> None:
    assert contour_heights(torch.zeros(0, 60, 2), torch.zeros(0, 60)).shape == (0, 60, 11)
    assert not contour_heights(torch.zeros(1, 60, 2), torch.zeros(1, 60)).any()  # all points at one place
    with pytest.raises(ShapeError, match="P > 5"):
        contour_heights(torch.zeros(1, 5, 2), torch.zeros(1, 5))
    with pytest.raises(ShapeError, match=r"tangents \(V, P\)"):
        contour_heights(torch.zeros(1, 60, 2), torch.zeros(60))
