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


def test_dots_that_stand_wider_than_their_rows_are_told_apart() -> None:
    board = Board("asymmetric_circles", 3, 11, 1.0, column_mm=3.0)
    places = circle_places(board)
    np.testing.assert_allclose(places[1] - places[0], [3.0, 0, 0])
    np.testing.assert_allclose(places[3] - places[0], [1.5, 1.0, 0])
    found = find_corners(board_picture(board, 20), board)
    assert found is not None
    steps = np.linalg.lstsq(np.column_stack([found.board_mm[:, :2], np.ones(33)]), found.pixels, rcond=None)
    assert np.abs(steps[1]).max() < 10
    with pytest.raises(InputError, match=r"column_mm=-1 .*positive distance of circles in a row"):
        Board("circles", 4, 5, 2.0, column_mm=-1)
    with pytest.raises(InputError, match="on a board of kind charuco"):
        Board(column_mm=3.0)
