"""Corners in pictures become a lens: robust least squares over the lens and every board's pose.

The lens is OpenCV's fisheye: Kannala and Brandt, IEEE TPAMI 28:1335, 2006.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ursnav_torch.calibration.board import Board, Corners, find_corners
from ursnav_torch.calibration.field import FieldCoverage, field_coverage, picture_mask, round_picture_fov
from ursnav_torch.camera import Camera, equidistant_camera, mask_text
from ursnav_torch.errors import InputError

Lens = Callable[..., Camera]

MIN_IMAGES = 4
_REJECTED_BY_MEDIAN = 3.0  # a picture whose residual exceeds the median so many times is left out
#: With boards in a few poses alone distance and focal length are hardly told apart: a share of it that is said, and one
#: that is refused. The references of `benchmarks.endocal` come from such pictures, and are uncertain by up to 5 %.
UNCERTAIN_FOCAL, _LARGEST_FOCAL_ERROR = 0.02, 0.1
_START_FOV_DEG = (60.0, 80.0, 120.0, 160.0, 200.0)
# A weak prior, in pixels of residual, tames the lens beyond all corners.
_USUAL_K = {"equidistant": np.array([0.2, 0.1, 0.05, 0.02]), "plumb_bob": np.array([10.0, 10.0, 10.0, 0.1])}


@dataclass(frozen=True, slots=True)
class Calibration:
    """A lens and how well it explains the pictures.

    Attributes:
        camera: the lens; ``fov_deg`` is set where the picture is round, ``mask`` where it does not fill the frame.
        rms_px: root mean square distance of corners from where the lens puts them, over the pictures used.
        rms_by_image: that of each picture used.
        left_out: why each other picture was not used.
        corners: of the pictures used.
        residuals_px: (N, 2) found minus predicted, of all corners used, in the order of ``corners``.
        seen_deg: the largest angle from the optical axis at which corners were seen; beyond, the lens is extrapolated.
        field: which parts of the picture the corners came to.
        focal_sd_px: standard deviation of the focal length.
    """

    camera: Camera
    rms_px: float
    rms_by_image: Mapping[str, float]
    left_out: Mapping[str, str]
    corners: Mapping[str, Corners]
    residuals_px: NDArray[np.float64]
    seen_deg: float
    field: FieldCoverage
    focal_sd_px: float


def calibrate_camera(images: Mapping[str, NDArray[np.uint8]], board: Board, model: str = "equidistant") -> Calibration:
    """Calibrate the lens that took the pictures.

    Args:
        images: name to picture (H, W) or (H, W, 3), all of one size, of the board held at different angles and places.
        board: the board, with the sizes measured on the print.
        model: ``equidistant`` (fisheye), or ``plumb_bob`` (a pinhole with radial distortion, for narrow lenses).

    Raises:
        InputError: another model, no pictures, different sizes, too few show the board, they do not determine a lens.
    """
    if model not in LENSES:
        raise InputError(f"Unknown lens model {model!r}; known are {', '.join(LENSES)}.")
    height, width = _one_size(images)
    make = partial(LENSES[model], width=width, height=height)
    found = {name: find_corners(image, board) for name, image in images.items()}
    left_out = {name: _why_not(images[name], board) for name, corners in found.items() if corners is None}
    used = {name: corners for name, corners in found.items() if corners is not None}
    while True:
        _enough(used, left_out, board)
        camera, residuals, focal_sd_px = _solve(used, make, model)
        rms = {name: float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) for name, r in zip(used, residuals, strict=True)}
        worst = max(rms, key=rms.__getitem__)
        if rms[worst] <= max(_REJECTED_BY_MEDIAN * float(np.median(list(rms.values()))), 0.3):
            break
        left_out[worst] = f"its corners lie {rms[worst]:.2f} px off, far more than the others'"
        del used[worst]
    every = np.concatenate(residuals)
    rays, _ = camera.rays(np.concatenate([corners.pixels for corners in used.values()]))
    seen_deg = math.degrees(float(np.arccos(np.clip(rays[:, 2], -1, 1)).max()))
    mask = picture_mask(list(images.values()))
    field = field_coverage(
        np.concatenate([corners.pixels for corners in used.values()]),
        np.ones((height, width), bool) if mask is None else mask,
    )
    fov_deg = round_picture_fov(list(images.values()), camera)
    camera = replace(camera, fov_deg=fov_deg, mask=None if mask is None else mask_text(mask))
    rms_px = float(np.sqrt(np.mean(np.sum(every**2, axis=1))))
    return Calibration(camera, rms_px, rms, left_out, used, every, seen_deg, field, focal_sd_px)


def _why_not(image: NDArray[np.uint8], board: Board) -> str:
    """Why a picture shows no board; only markers tell a mirrored one."""
    if board.kind == "charuco" and find_corners(np.ascontiguousarray(image[:, ::-1]), board) is not None:
        return "shows the board mirrored: switch mirroring off in the camera or grabber, or flip the pictures"
    return "shows too little of the board"


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
        f"{board.rows} squares; in pictures of 250 px a marker needs about 12 px, so take few large squares there, or "
        f"board=chessboard. Left out: {reasons}."
    )


def _solve(used: Mapping[str, Corners], make: Lens, model: str) -> tuple[Camera, list[NDArray[np.float64]], float]:
    """The lens that fits best, found minus predicted pixels (N, 2) of each picture, the focal length's deviation in px.

    Least squares over the lens and every board's pose, robust against single wrong corners. OpenCV's own solver
    starts from homographies of undistorted pixels and gives up on boards near the rim of a 160 degree lens.
    """
    x = min((_start(used, make, fov) for fov in _START_FOV_DEG), key=lambda x: _cost(x, used, make))
    for loss in ("soft_l1", "huber"):  # the first finds the way from afar, the second is least squares for what fits
        fit = least_squares(
            lambda x: np.concatenate([_residuals(x, used, make).ravel(), x[4:8] / _USUAL_K[model]]),
            x, loss=loss, x_scale="jac", method="trf", max_nfev=100,
        )  # fmt: skip
        x = fit.x
    told = fit.jac[:-4]  # by the pictures, without what is usual
    spread = np.linalg.pinv(told.T @ told, rcond=1e-14)[0, 0] ** 0.5
    residuals = _residuals(fit.x, used, make)
    noise = float(np.sqrt(np.mean(residuals**2)))
    focal_sd_px = spread * noise
    if not focal_sd_px < _LARGEST_FOCAL_ERROR * fit.x[0]:
        raise InputError(
            f"The {len(used)} pictures do not determine a lens (its focal length, {fit.x[0]:.0f} px, is uncertain by "
            f"{focal_sd_px:.0f} px): tilt the board by 20 to 40 degrees in different directions, and fill the "
            "picture with it in some."
        )
    ends = np.cumsum([len(corners.pixels) for corners in used.values()])[:-1]
    return make(fit.x), np.split(residuals, ends), float(focal_sd_px)


def _fisheye(x: NDArray[np.float64], width: int, height: int) -> Camera:
    fx, fy, cx, cy, k1, k2, k3, k4 = (float(v) for v in x[:8])
    return Camera("equidistant", width, height, max(fx, 1.0), max(fy, 1.0), cx, cy, (k1, k2, k3, k4))


def _plumb_bob(x: NDArray[np.float64], width: int, height: int) -> Camera:
    fx, fy, cx, cy, k1, k2, k3, _ = (float(v) for v in x[:8])
    k = (k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0)
    return Camera("rational", width, height, max(fx, 1.0), max(fy, 1.0), cx, cy, k)


#: The lens that the eight numbers fx, fy, cx, cy, k1..k4 make, by model.
LENSES: dict[str, Lens] = {"equidistant": _fisheye, "plumb_bob": _plumb_bob}


def _residuals(x: NDArray[np.float64], used: Mapping[str, Corners], make: Lens) -> NDArray[np.float64]:
    """(N, 2) found minus predicted pixels; ``x`` holds fx, fy, cx, cy, k1..k4, then each board's turn and place."""
    poses = x[8:].reshape(-1, 6)
    R = Rotation.from_rotvec(poses[:, :3]).as_matrix()
    points = [corners.board_mm @ R[i].T + poses[i, 3:] for i, corners in enumerate(used.values())]
    predicted, _ = make(x).project(np.concatenate(points))
    return np.concatenate([corners.pixels for corners in used.values()]) - predicted


def _cost(x: NDArray[np.float64], used: Mapping[str, Corners], make: Lens) -> float:
    return float(np.median(np.abs(_residuals(x, used, make))))


def _start(used: Mapping[str, Corners], make: Lens, fov_deg: float) -> NDArray[np.float64]:
    """An ideal lens of this field of view and the boards' poses that it implies."""
    size = make(np.array([1.0, 1, 0, 0, 0, 0, 0, 0]))
    camera = equidistant_camera(fov_deg, size.width, size.height)
    poses = [_board_pose(corners, camera) for corners in used.values()]
    return np.concatenate([[camera.fx, camera.fy, camera.cx, camera.cy, 0, 0, 0, 0], *poses])


def _board_pose(corners: Corners, camera: Camera) -> NDArray[np.float64]:
    """(6,) turn and place of a board before a known lens, from the plane's linear map onto viewing rays."""
    rays, _ = camera.rays(corners.pixels)
    middle = corners.board_mm.mean(axis=0)
    flat = np.column_stack([corners.board_mm[:, :2] - middle[:2], np.ones(len(rays))])
    x, y, z = (ray[:, None] * flat for ray in rays.T)  # each row of ray x (H flat) = 0, H by rows
    zero = np.zeros_like(x)
    rows = np.concatenate([np.hstack([zero, -z, y]), np.hstack([z, zero, -x]), np.hstack([-y, x, zero])])
    H = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    H /= np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    if np.sum(rays @ H[:, 2]) < 0:
        H = -H
    U, _, Vt = np.linalg.svd(np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])]))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return np.concatenate([Rotation.from_matrix(R).as_rotvec(), H[:, 2] - R @ middle])
