"""Boards of circles are found where they are drawn; mirrored boards are told."""

import numpy as np
import pytest

from ursnav_torch.calibration import Board, board_picture, calibrate_camera, find_corners
from ursnav_torch.calibration.board import circle_places
from ursnav_torch.errors import InputError


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
@pytest.mark.parametrize("bright", [False, True])
def test_circles_are_found_where_they_are_drawn(kind: str, bright: bool) -> None:
    board = Board(kind, 4, 11, 2.0)
    picture = board_picture(board, 10)
    found = find_corners(255 - picture if bright else picture, board)
    assert found is not None and len(found.pixels) == 44
    np.testing.assert_allclose(found.board_mm, circle_places(board))
    steps = np.linalg.lstsq(np.column_stack([found.board_mm[:, :2], np.ones(44)]), found.pixels, rcond=None)
    assert np.abs(steps[1]).max() < 10  # px squared over 44 centers: a grid, whichever way round
    assert np.linalg.norm(steps[0][0]) == pytest.approx(10, rel=0.02)


def test_a_mirrored_board_is_told() -> None:
    board = Board("charuco", 7, 5, 4.0, 3.0)
    flipped = np.ascontiguousarray(board_picture(board, 25)[:, ::-1])
    with pytest.raises(InputError, match="shows the board mirrored: switch mirroring off"):
        calibrate_camera({f"{n}.png": flipped for n in range(4)}, board)


def test_another_lens_model_is_refused() -> None:
    with pytest.raises(InputError, match="Unknown lens model 'ocam'; known are equidistant, plumb_bob"):
        calibrate_camera({}, Board(), "ocam")
