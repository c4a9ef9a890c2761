"""A lens that took synthetic pictures of a board is found again; bad pictures are named, not swallowed."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from ursnav_torch.calibration import Board, Corners, board_picture, calibrate_camera, find_corners, save_board
from ursnav_torch.camera import Camera, load_camera
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between

LENS = Camera("equidistant", 250, 250, 90.0, 89.0, 122.0, 126.5, (-0.02, 0.003, 0.0, 0.0), 160.0)
BOARDS = {"charuco": Board(columns=9, rows=7), "chessboard": Board("chessboard", columns=9, rows=7)}
COUNTS = {"charuco": 14, "chessboard": 10}
PX_PER_MM = 20
FLAGS = ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")


@lru_cache
def large_rays(lens: Camera) -> tuple[np.ndarray, np.ndarray]:
    return lens.resized(3 * lens.width, 3 * lens.height).pixel_rays()


def seen(board: Board, R_camera_board: np.ndarray, t_mm: np.ndarray, lens: Camera = LENS) -> np.ndarray:
    """The board on a gray table through ``lens``: every ray's way to the board's plane, three times oversampled."""
    printed = board_picture(board, PX_PER_MM)
    rays, mask = large_rays(lens)
    normal = R_camera_board[:, 2]
    with np.errstate(divide="ignore"):
        away = (normal @ t_mm) / (rays @ normal)
    on_board = (rays * away[..., None] - t_mm) @ R_camera_board
    margin = printed.shape[1] / PX_PER_MM / 2 - board.columns * board.square_mm / 2
    pixels = ((on_board[..., :2] + margin) * PX_PER_MM - 0.5).astype(np.float32)
    picture = cv2.remap(printed, pixels[..., 0], pixels[..., 1], cv2.INTER_AREA, borderValue=150)
    picture[(away <= 0) & mask] = 150
    picture[~mask] = 0
    return cv2.resize(picture, (lens.width, lens.height), interpolation=cv2.INTER_AREA)


def hand_held(board: Board, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3), (3,): a board 15 to 28 mm before the lens, tilted by up to 35 degrees, anywhere up to 45 degrees off."""
    rng = np.random.default_rng(seed)
    R = cv2.Rodrigues(rng.uniform(-0.6, 0.6, 3))[0]
    middle = np.array([board.columns, board.rows, 0]) * board.square_mm / 2
    aside = rng.uniform(-0.6, 0.6, 2)
    center = rng.uniform(15, 28) * np.array([aside[0], aside[1], 1])
    return R, center - R @ middle


@pytest.fixture(scope="module")
def pictures() -> dict[str, dict[str, np.ndarray]]:
    return {
        kind: {f"{i:02d}.png": seen(board, *hand_held(board, i)) for i in range(COUNTS[kind])}
        for kind, board in BOARDS.items()
    }


@pytest.mark.parametrize("kind", BOARDS)
def test_convention_corners_are_where_the_lens_projects_them(
    kind: str, pictures: dict[str, dict[str, np.ndarray]]
) -> None:
    board, seen_in = BOARDS[kind], 0
    for i, image in enumerate(pictures[kind].values()):
        corners = find_corners(image, board)
        if corners is None:
            continue
        seen_in += 1
        R, t = hand_held(board, i)
        ends = [corners.board_mm]
        if kind == "chessboard":  # without markers its numbering may start at the opposite corner
            ends.append(corners.board_mm.max(axis=0) - corners.board_mm)
            ends = [end + np.array([board.square_mm, board.square_mm, 0]) for end in ends]
        error = min(np.abs(LENS.project(end @ R.T + t)[0] - corners.pixels).mean() for end in ends)
        assert error < 0.25
    assert seen_in >= 9


@pytest.mark.parametrize("kind", BOARDS)
def test_the_lens_that_took_the_pictures_is_found(kind: str, pictures: dict[str, dict[str, np.ndarray]]) -> None:
    result = calibrate_camera(pictures[kind], BOARDS[kind])
    assert result.rms_px < 0.25
    assert result.residuals_px.shape == (sum(len(c.pixels) for c in result.corners.values()), 2)
    assert result.seen_deg > 50
    angle = np.radians(np.arange(0, 56, 5))
    for turn in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        ray = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], -1)
        assert np.abs(result.camera.project(ray)[0] - LENS.project(ray)[0]).max() < 1.0
        back = result.camera.rays(LENS.project(ray)[0])[0]
        assert np.degrees(angle_between(back, ray)).max() < 0.6


def test_round_picture_gives_its_field_of_view(pictures: dict[str, dict[str, np.ndarray]]) -> None:
    fov_deg = calibrate_camera(pictures["charuco"], BOARDS["charuco"]).camera.fov_deg
    assert fov_deg == pytest.approx(160, abs=5)


def test_full_picture_has_no_field_of_view() -> None:
    full = Camera("equidistant", 320, 240, 150.0, 150.0, 160.0, 119.0)
    board = BOARDS["charuco"]
    images = {str(i): seen(board, *hand_held(board, i), full) for i in range(10)}
    assert calibrate_camera(images, board).camera.fov_deg is None


def test_a_wrong_picture_is_left_out_and_named(
    pictures: dict[str, dict[str, np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    board = BOARDS["charuco"]
    images = pictures["charuco"] | {"blank.png": np.full((250, 250), 90, np.uint8)}

    def bent(image: np.ndarray, board: Board) -> Corners | None:
        corners = find_corners(image, board)
        if corners is not None and image is images["03.png"]:
            return Corners(
                corners.board_mm, corners.pixels + np.random.default_rng(0).normal(0, 4, corners.pixels.shape)
            )
        return corners

    monkeypatch.setattr("ursnav_torch.calibration.solve.find_corners", bent)
    result = calibrate_camera(images, board)
    assert "too little of the board" in result.left_out["blank.png"]
    assert "px off, far more than the others" in result.left_out["03.png"]
    assert result.rms_px < 0.25


def test_board_picture_has_the_size_that_was_asked() -> None:
    for board in BOARDS.values():
        picture = board_picture(board, 10)
        assert picture.shape == (7 * 40 + 40, 9 * 40 + 40)
        assert picture[:20].min() == 255 and picture[:, -20:].min() == 255


def test_printed_at_full_size_a_square_has_its_millimeters(tmp_path: Path) -> None:
    save_board(BOARDS["charuco"], tmp_path / "board.png")
    data = (tmp_path / "board.png").read_bytes()
    at = data.index(b"pHYs") + 4
    px_per_m, unit = int.from_bytes(data[at : at + 4], "big"), data[at + 8]
    height, width = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE).shape
    assert unit == 1  # the meter
    assert width / px_per_m * 1000 == pytest.approx(9 * 4 + 4, rel=1e-3)
    assert height / px_per_m * 1000 == pytest.approx(7 * 4 + 4, rel=1e-3)


def test_opencv_s_own_solver_agrees(pictures: dict[str, dict[str, np.ndarray]]) -> None:
    result = calibrate_camera(pictures["charuco"], BOARDS["charuco"])
    flag = {name: getattr(cv2.fisheye, name, None) or getattr(cv2, name) for name in FLAGS}
    _, K, k, _, _ = cv2.fisheye.calibrate(
        [c.board_mm[None] for c in result.corners.values()], [c.pixels[None] for c in result.corners.values()],
        (250, 250), np.eye(3), np.zeros(4), flags=sum(flag.values()),
    )  # fmt: skip
    other = Camera("equidistant", 250, 250, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(k.ravel()))
    assert result.camera.same_lens(replace(other, fov_deg=110.0), tolerance_px=0.5)


def test_refusals_say_what_was_found(pictures: dict[str, dict[str, np.ndarray]]) -> None:
    board, images = BOARDS["charuco"], pictures["charuco"]
    with pytest.raises(InputError, match="no pictures"):
        calibrate_camera({}, board)
    with pytest.raises(InputError, match=r"b is 100 x 90 px, a is 250 x 250 px"):
        calibrate_camera({"a": images["00.png"], "b": np.zeros((90, 100), np.uint8)}, board)
    with pytest.raises(InputError, match=r"Only 0 of 2 pictures can be used.*chessboard of 6 x 5 squares.*00\.png"):
        calibrate_camera({name: images[name] for name in ("00.png", "01.png")}, Board("chessboard", 6, 5))
    with pytest.raises(InputError, match="Unknown board 'dots'; known are charuco, chessboard"):
        Board("dots")
    with pytest.raises(InputError, match="marker smaller than its square"):
        Board(marker_mm=5)
    with pytest.raises(InputError, match="no marker dictionary '3X3'"):
        Board(dictionary="3X3")
    with pytest.raises(InputError, match=r"needs 200 markers, 4X4_50 has 50"):
        Board(columns=20, rows=20)


def test_pictures_that_determine_no_lens_are_refused() -> None:
    board = BOARDS["charuco"]
    still = {str(i): seen(board, np.eye(3), np.array([-18.0, -14.0, 25.0])) for i in range(5)}
    with pytest.raises(InputError, match="tilt the board"):
        calibrate_camera(still, board)


@pytest.mark.slow
def test_runner_writes_a_camera_that_loads_and_a_picture(
    tmp_path: Path, pictures: dict[str, dict[str, np.ndarray]]
) -> None:
    folder = tmp_path / "board, 1=2 ü"
    folder.mkdir()
    for name, image in pictures["charuco"].items():
        cv2.imencode(".png", image)[1].tofile(folder / name)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        program = [sys.executable, "-m", "ursnav_torch.calibrate", *arguments]
        return subprocess.run(program, cwd=tmp_path, capture_output=True, text=True)

    arguments = (f"images={folder.name}", "board=charuco", "columns=9", "rows=7", "out=lens.json")
    first = run(*arguments)
    assert first.returncode == 0, first.stderr
    assert "px" in first.stdout and "of 14 pictures" in first.stdout
    assert load_camera(tmp_path / "lens.json").same_lens(load_camera(tmp_path / "lens.json"))
    assert json.loads((tmp_path / "lens.json").read_text(encoding="utf-8"))["rms_px"] < 0.25
    assert cv2.imread(str(tmp_path / "lens.png")) is not None
    mask = load_camera(tmp_path / "lens.json").mask_image()
    assert mask is not None and np.mean(mask != LENS.pixel_rays()[1]) < 0.02
    assert "take more pictures with the board at the rim at the " in first.stdout
    again = run(*arguments)
    assert again.returncode == 1 and "exists already" in again.stderr
    assert run("print_board=board.png", "columns=9", "rows=7").returncode == 0
    assert cv2.imread(str(tmp_path / "board.png"), 0).shape[1] > 900
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "board, 1=2 ü",
        "board.png",
        "lens.json",
        "lens.mask.png",
        "lens.png",
    ]
