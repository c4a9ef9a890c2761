"""Camera calibration: pictures of a printed board, charuco or chessboard, become an equidistant fisheye `Camera`."""

from ursnav_torch.calibration.board import BOARDS, Board, Corners, board_picture, find_corners, save_board
from ursnav_torch.calibration.calibration_report import calibration_files, save_calibration, summary
from ursnav_torch.calibration.solve import Calibration, calibrate_camera

__all__ = [
    "BOARDS",
    "Board",
    "Calibration",
    "Corners",
    "board_picture",
    "calibrate_camera",
    "calibration_files",
    "find_corners",
    "save_board",
    "save_calibration",
    "summary",
]
