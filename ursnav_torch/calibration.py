"""Camera calibration: pictures of a printed board become an equidistant fisheye `Camera` (OpenCV's model).

Kannala and Brandt, IEEE TPAMI 28:1335, 2006, in OpenCV's form. Lengths mm; pixel centers at whole numbers.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError

BOARDS = ("charuco", "chessboard")
#: Pictures are enlarged to at least this width before corners are sought: a scope's 250 px are few for a marker.
DETECTION_WIDTH_PX = 500
MIN_IMAGES = 4
MIN_CORNERS = 6
_REJECTED_BY_MEDIAN = 3.0  # a picture whose residual exceeds the median so many times is left out
_DARK = 16  # gray value that no lit part of the picture stays below in all pictures


@dataclass(frozen=True, slots=True)
class Board:
    """A flat printed board.

    Args:
        kind: ``charuco`` (chessboard with markers; may be partly out of the picture) or ``chessboard``.
        columns, rows: squares across and down.
        square_mm: side of a square.
        marker_mm: side of a charuco marker.
        dictionary: charuco marker dictionary, OpenCV's name without ``DICT_``.

    Raises:
        InputError: a value is out of range.
    """

    kind: str = "charuco"
    columns: int = 7
    rows: int = 5
    square_mm: float = 4.0
    marker_mm: float = 3.0
    dictionary: str = "4X4_50"

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
        if self.kind == "charuco":
            _dictionary(self)


@dataclass(frozen=True, slots=True)
class Corners:
    """The corners found in one picture: ``board_mm`` (N, 3) on the board, ``pixels`` (N, 2)."""

    board_mm: NDArray[np.float64]
    pixels: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """A lens and how well it explains the pictures.

    Attributes:
        camera: the lens; ``fov_deg`` is set where the picture is round.
        rms_px: root mean square distance of corners from where the lens puts them, over the pictures used.
        rms_by_image: that of each picture used.
        left_out: why each other picture was not used.
        corners: of the pictures used.
        residuals_px: (N, 2) found minus predicted, of all corners used, in the order of ``corners``.
        seen_deg: the largest angle from the optical axis at which corners were seen; beyond, the lens is extrapolated.
    """

    camera: Camera
    rms_px: float
    rms_by_image: Mapping[str, float]
    left_out: Mapping[str, str]
    corners: Mapping[str, Corners]
    residuals_px: NDArray[np.float64]
    seen_deg: float


def board_picture(board: Board, px_per_mm: float) -> NDArray[np.uint8]:
    """The board to print, with a white margin of half a square around it."""
    side = max(round(board.square_mm * px_per_mm), 8)
    if board.kind == "charuco":
        picture = _charuco(board).generateImage((board.columns * side, board.rows * side), marginSize=0)
    else:
        squares = np.indices((board.rows, board.columns)).sum(axis=0) % 2
        picture = np.kron(squares, np.full((side, side), 255)).astype(np.uint8)
    return np.pad(picture, side // 2, constant_values=255)


def find_corners(image: NDArray[np.uint8], board: Board) -> Corners | None:
    """The board's inner corners in a picture (H, W) or (H, W, 3), or None where it shows too few."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = max(math.ceil(DETECTION_WIDTH_PX / gray.shape[1]), 1)
    large = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found = _charuco_corners(large, board) if board.kind == "charuco" else _chessboard_corners(large, board)
    if found is None or len(found[1]) < MIN_CORNERS or np.linalg.matrix_rank(found[0] - found[0].mean(axis=0)) < 2:
        return None
    return Corners(found[0].astype(float), (found[1].astype(float) + 0.5) / scale - 0.5)


def calibrate_camera(images: Mapping[str, NDArray[np.uint8]], board: Board) -> Calibration:
    """Calibrate the fisheye lens that took the pictures.

    Args:
        images: name to picture (H, W) or (H, W, 3), all of one size, of the board held at different angles and places.
        board: the board, with the sizes measured on the print.

    Raises:
        InputError: no pictures, different sizes, too few show the board, or they do not determine a lens.
    """
    height, width = _one_size(images)
    found = {name: find_corners(image, board) for name, image in images.items()}
    left_out = {name: "shows too little of the board" for name, corners in found.items() if corners is None}
    used = {name: corners for name, corners in found.items() if corners is not None}
    while True:
        _enough(used, left_out, board)
        camera, residuals = _solve(used, width, height)
        rms = {name: float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) for name, r in zip(used, residuals, strict=True)}
        worst = max(rms, key=rms.__getitem__)
        if rms[worst] <= max(_REJECTED_BY_MEDIAN * float(np.median(list(rms.values()))), 0.3):
            break
        left_out[worst] = f"its corners lie {rms[worst]:.2f} px off, far more than the others'"
        del used[worst]
    every = np.concatenate(residuals)
    rays, _ = camera.rays(np.concatenate([corners.pixels for corners in used.values()]))
    seen_deg = math.degrees(float(np.arccos(np.clip(rays[:, 2], -1, 1)).max()))
    camera = replace(camera, fov_deg=_round_picture_fov(list(images.values()), camera))
    return Calibration(camera, float(np.sqrt(np.mean(np.sum(every**2, axis=1)))), rms, left_out, used, every, seen_deg)


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
    whole, pixels = cv2.findChessboardCornersSB(gray, (columns, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not whole:
        return None
    places = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), [0], indexing="xy"), axis=-1).reshape(-1, 3)
    return board.square_mm * places, pixels.reshape(-1, 2)


def _one_size(images: Mapping[str, NDArray[np.uint8]]) -> tuple[int, int]:
    sizes = {name: image.shape[:2] for name, image in images.items()}
    if not sizes:
        raise InputError("There are no pictures to calibrate from.")
    (first, size), *others = sizes.items()
    for name, other in others:
        if other != size:
            raise InputError(
                f"{name} is {other[1]} x {other[0]} px, {first} is {size[1]} x {size[0]} px: a calibration needs "
                "pictures of one size, neither cropped nor resized."
            )
    return size[0], size[1]


def _enough(used: Mapping[str, Corners], left_out: Mapping[str, str], board: Board) -> None:
    if len(used) >= MIN_IMAGES:
        return
    reasons = "; ".join(f"{name} {why}" for name, why in list(left_out.items())[:5])
    raise InputError(
        f"Only {len(used)} of {len(used) + len(left_out)} pictures can be used, at least {MIN_IMAGES} are needed "
        f"(better 15 or more, at different angles, up to the rim). Sought was a {board.kind} of {board.columns} x "
        f"{board.rows} squares. Left out: {reasons}."
    )


def _solve(used: Mapping[str, Corners], width: int, height: int) -> tuple[Camera, list[NDArray[np.float64]]]:
    """The lens that fits best, and found minus predicted pixels (N, 2) of each picture."""
    board = [corners.board_mm[None] for corners in used.values()]
    pixels = [corners.pixels[None] for corners in used.values()]
    flags = _fisheye_flag("CALIB_RECOMPUTE_EXTRINSIC") | _fisheye_flag("CALIB_FIX_SKEW")
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-8)
    try:
        _, K, distortion, turns, shifts = cv2.fisheye.calibrate(
            board, pixels, (width, height), np.eye(3), np.zeros(4), flags=flags, criteria=until
        )
        k = distortion.ravel()
        camera = Camera(
            "equidistant", width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]),
            (float(k[0]), float(k[1]), float(k[2]), float(k[3])),
        )  # fmt: skip
    except (cv2.error, InputError) as error:
        raise InputError(
            f"The {len(used)} pictures do not determine a lens ({str(error).splitlines()[-1].strip()}): tilt the board "
            "by 20 to 40 degrees in different directions, and fill the picture with it in some."
        ) from None
    predicted = [
        camera.project(b[0] @ cv2.Rodrigues(turn)[0].T + shift.ravel())[0]
        for b, turn, shift in zip(board, turns, shifts, strict=True)
    ]
    return camera, [p[0] - q for p, q in zip(pixels, predicted, strict=True)]


def _fisheye_flag(name: str) -> int:
    """OpenCV 5 moved the flags from ``cv2.fisheye`` to ``cv2`` and changed their values."""
    return int(getattr(cv2.fisheye, name, None) or getattr(cv2, name))


def _round_picture_fov(images: Sequence[NDArray[np.uint8]], camera: Camera) -> float | None:
    """Full angle of the image circle in degrees where the picture's corners are black in every picture, else None."""
    gray = [image if image.ndim == 2 else image.max(axis=2) for image in images]
    brightest = cv2.medianBlur(np.max(gray, axis=0), 3)
    v, u = np.indices(brightest.shape)
    radius = np.hypot(u - camera.cx, v - camera.cy)
    rings = np.bincount(radius.astype(int).ravel(), (brightest > _DARK).ravel()) / np.bincount(
        radius.astype(int).ravel()
    )
    lit = np.flatnonzero(rings > 0.5)
    if len(lit) == 0 or rings[-1] > 0.5 or lit[-1] + 2 >= len(rings):
        return None
    rim = camera.rays([camera.cx + lit[-1] + 0.5, camera.cy])[0]
    return math.degrees(2 * math.acos(float(np.clip(rim[2], -1, 1))))
