"""The printed board: how it is drawn, and where its corners lie in a picture. Pixel centers at whole numbers."""

import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.files import whole_file

BOARDS = ("charuco", "chessboard", "circles", "asymmetric_circles")
#: Pictures are enlarged to at least this width before corners are sought: a scope's 250 px are few for a marker.
DETECTION_WIDTH_PX = 700
MIN_CORNERS = 6
_CIRCLES = ("circles", "asymmetric_circles")
_PRINT_PX_PER_MM = 600 / 25.4
#: Dots of up to so many px are sought, first OpenCV's own limit: a larger one takes the lit disc for a dot beside it.
_MOST_BLOB_PX = (5000.0, 100_000.0)
#: Where the grain hides a dot, it is looked for in the picture blurred by so much, px.
_BLURS_PX = (0.0, 1.5, 3.0)


@dataclass(frozen=True, slots=True)
class Board:
    """A flat printed board.

    Args:
        kind: ``charuco`` (chessboard with markers; may be partly out of the picture), ``chessboard``, ``circles`` (dots
            in rows and columns) or ``asymmetric_circles`` (every second row shifted by half a step).
        columns, rows: squares across and down; of circles, dots in a row, and rows.
        square_mm: side of a square; from a row of circles to the next.
        marker_mm: side of a charuco marker.
        dictionary: charuco marker dictionary, OpenCV's name without ``DICT_``.
        column_mm: from a circle to the next in its row; None: as rows are apart, or twice that where rows are shifted.

    Raises:
        InputError: a value is out of range.
    """

    kind: str = "charuco"
    columns: int = 7
    rows: int = 5
    square_mm: float = 4.0
    marker_mm: float = 3.0
    dictionary: str = "4X4_50"
    column_mm: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in BOARDS:
            raise InputError(f"Unknown board {self.kind!r}; known are {', '.join(BOARDS)}.")
        if self.columns < 3 or self.rows < 3:
            raise InputError(f"The board has {self.columns} x {self.rows} squares; at least 3 x 3 are needed.")
        if self.square_mm <= 0 or (self.kind == "charuco" and not 0 < self.marker_mm < self.square_mm):
            raise InputError(
                f"Squares of {self.square_mm} mm and markers of {self.marker_mm} mm do not make a board; measure the "
                "print: both positive, the marker smaller than its square."
            )
        if self.column_mm is not None and not (self.column_mm > 0 and self.kind in _CIRCLES):
            raise InputError(
                f"column_mm={self.column_mm:g} on a board of kind {self.kind}: it is the positive distance of circles "
                f"in a row, of {' or '.join(_CIRCLES)} only."
            )
        if self.kind == "charuco":
            _dictionary(self)

    @property
    def across_mm(self) -> float:
        """From a circle to the next in its row, mm."""
        return self.column_mm or self.square_mm * (2 if self.kind == "asymmetric_circles" else 1)


@dataclass(frozen=True, slots=True)
class Corners:
    """The corners found in one picture: ``board_mm`` (N, 3) on the board, ``pixels`` (N, 2)."""

    board_mm: NDArray[np.float64]
    pixels: NDArray[np.float64]


def board_picture(board: Board, px_per_mm: float) -> NDArray[np.uint8]:
    """The board to print (H, W), gray, with a white margin of half a square around it."""
    side = max(round(board.square_mm * px_per_mm), 8)
    if board.kind == "charuco":
        picture = _charuco(board).generateImage((board.columns * side, board.rows * side), marginSize=0)
    elif board.kind in _CIRCLES:
        return _circles_picture(board, side)
    else:
        squares = np.indices((board.rows, board.columns)).sum(axis=0) % 2
        picture = np.kron(squares, np.full((side, side), 255)).astype(np.uint8)
    return np.pad(picture, side // 2, constant_values=255)


def save_board(board: Board, path: Path, overwrite: bool = False) -> None:
    """Write the board as a PNG for printing at 600 dpi.

    Raises:
        InputError: ``path`` exists and ``overwrite`` is false.
    """
    px_per_mm = round(board.square_mm * _PRINT_PX_PER_MM) / board.square_mm
    pixels_per_meter = round(1000 * px_per_mm)
    with whole_file(path, overwrite) as partial:
        _, encoded = cv2.imencode(".png", board_picture(board, px_per_mm))
        partial.write_bytes(_with_resolution(encoded.tobytes(), pixels_per_meter))


def find_corners(image: NDArray[np.uint8], board: Board) -> Corners | None:
    """The board's inner corners in a picture (H, W) or (H, W, 3), or None where it shows too few."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = max(math.ceil(DETECTION_WIDTH_PX / gray.shape[1]), 1)
    large = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    finders = {"charuco": _charuco_corners, "chessboard": _chessboard_corners}
    found = finders.get(board.kind, _circle_centers)(large, board)
    if found is None or len(found[1]) < MIN_CORNERS or np.linalg.matrix_rank(found[0] - found[0].mean(axis=0)) < 2:
        return None
    return Corners(found[0].astype(float), (found[1].astype(float) + 0.5) / scale - 0.5)


def _dictionary(board: Board) -> "cv2.aruco.Dictionary":
    number = getattr(cv2.aruco, f"DICT_{board.dictionary}", None)
    if number is None:
        raise InputError(f"OpenCV knows no marker dictionary {board.dictionary!r}; try 4X4_50, 5X5_100 or 6X6_250.")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    if board.columns * board.rows // 2 > len(dictionary.bytesList):
        raise InputError(
            f"A board of {board.columns} x {board.rows} squares needs {board.columns * board.rows // 2} markers, "
            f"{board.dictionary} has {len(dictionary.bytesList)}; take a larger dictionary."
        )
    return dictionary


def _charuco(board: Board) -> "cv2.aruco.CharucoBoard":
    size = (board.columns, board.rows)
    return cv2.aruco.CharucoBoard(size, board.square_mm, board.marker_mm, _dictionary(board))


def _charuco_corners(gray: NDArray[np.uint8], board: Board) -> tuple[NDArray, NDArray] | None:
    charuco = _charuco(board)
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(charuco).detectBoard(gray)
    if pixels is None or ids is None:
        return None
    return np.asarray(charuco.getChessboardCorners())[ids.ravel()], pixels.reshape(-1, 2)


def _chessboard_corners(gray: NDArray[np.uint8], board: Board) -> tuple[NDArray, NDArray] | None:
    columns, rows = board.columns - 1, board.rows - 1
    whole, pixels = cv2.findChessboardCornersSB(gray, (columns, rows), flags=cv2.CALIB_CB_ACCURACY)
    if not whole:
        return None
    places = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), [0], indexing="xy"), axis=-1).reshape(-1, 3)
    return board.square_mm * places, pixels.reshape(-1, 2)


def circle_places(board: Board) -> NDArray[np.float64]:
    """(N, 3) centers of a board's circles in mm, row by row; rows of an asymmetric grid are half a step apart."""
    row, column = np.divmod(np.arange(board.columns * board.rows), board.columns)
    across = column + row % 2 / 2 if board.kind == "asymmetric_circles" else column
    return np.stack([board.across_mm * across, board.square_mm * row, np.zeros(len(row))], axis=1)


def _circle_centers(gray: NDArray[np.uint8], board: Board) -> tuple[NDArray, NDArray] | None:
    grid = cv2.CALIB_CB_ASYMMETRIC_GRID if board.kind == "asymmetric_circles" else cv2.CALIB_CB_SYMMETRIC_GRID
    size = (board.columns, board.rows)
    for most in _MOST_BLOB_PX:
        words = cv2.SimpleBlobDetector.Params()
        words.maxArea = most
        blobs = cv2.SimpleBlobDetector.create(words)
        for blur in _BLURS_PX:
            seen = cv2.GaussianBlur(gray, (0, 0), blur) if blur else gray
            for picture in (seen, 255 - seen):  # dark dots on a bright board, or bright ones on a dark board
                for flags in (grid, grid | cv2.CALIB_CB_CLUSTERING):
                    whole, pixels = cv2.findCirclesGrid(picture, size, flags=flags, blobDetector=blobs)
                    if whole:
                        return circle_places(board), pixels.reshape(-1, 2)
    return None


def _circles_picture(board: Board, side: int) -> NDArray[np.uint8]:
    at = np.rint(circle_places(board)[:, :2] / board.square_mm * side).astype(int)
    width, height = at.max(axis=0) + 2 * side
    picture = np.full((height, width), 255, np.uint8)
    radius = round(side * min(0.35 if board.kind == "circles" else 0.45, 0.35 * board.across_mm / board.square_mm))
    for x, y in at + side:
        cv2.circle(picture, (int(x), int(y)), radius, 0, cv2.FILLED, cv2.LINE_AA)
    return picture


def _with_resolution(png: bytes, pixels_per_meter: int) -> bytes:
    """The PNG with a pHYs chunk after its header, so that printing at 100 % gives the size in mm."""
    body = b"pHYs" + struct.pack(">IIB", pixels_per_meter, pixels_per_meter, 1)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    after_header = 8 + 25
    return png[:after_header] + chunk + png[after_header:]
