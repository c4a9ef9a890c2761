"""Small jobs of every runner that writes results, and what they are made from."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

#: Pictures to be matched and tracked.
PICTURES = 4
#: A small VID: seconds to build.
_SMALL = ("camera.width=64", "camera.height=64", "views.views_per_calyx=4", "views.passage_views=4", "kidney.calyces=6")


@dataclass(frozen=True, slots=True)
class Job:
    """A call of a runner.

    Attributes:
        runner: its name. overrides: without out=.
        out: its result's name. besides: further results of the same call.
        codes: exit codes that mean it is done.
    """

    runner: str
    overrides: tuple[str, ...]
    out: str
    besides: tuple[str, ...] = ()
    codes: tuple[int, ...] = (0, 3)


def jobs(inputs: Path) -> list[Job]:
    """A job a runner; ``inputs`` is the folder that `make_inputs` fills."""
    vid, pictures = f"vid={inputs}/vid", inputs / "pictures"
    lumen = f"kidney.path={inputs}/lumen.stl"
    return [
        Job("build_vid", (*_SMALL, "calibrate=false", "workers=1"), "vid"),
        Job("match", (vid, f"images={pictures}", "report=page"), "rows.csv", ("page",)),
        Job("track", (vid, f"source={pictures}", "tum=true"), "track.csv",
            ("track.coverage.json", "track.coverage.png", "track.stones.csv", "track.stones.png", "track.tum")),
        Job("register", (f"landmarks={inputs}/landmarks.csv",), "em.json"),
        Job("calibrate", (f"images={inputs}/boards", "board=chessboard", "columns=9", "rows=7"), "lens.json",
            ("lens.png", "lens.mask.png")),
        Job("segment", (f"kidney.path={inputs}/labels.nii.gz",), "segmented"),
        Job("print_phantom", ("kidney=mesh", lumen), "printed"),
        Job("experiment", (*_SMALL, "calibrate=false", "workers=1"), "experiment"),
    ]  # fmt: skip


def make_inputs(folder: Path, run: Callable[[Job, Path], int]) -> None:
    """Fill the folder; ``run(job, folder)`` calls a runner there."""
    from ursnav_torch.kidney import make_phantom_kidney
    from ursnav_torch.segmentation import Scan, write_scan

    folder.mkdir(parents=True)
    kidney = make_phantom_kidney(0, calyces=6)
    kidney.mesh.export(folder / "lumen.stl")
    low, high = kidney.mesh.bounds
    grid = np.stack(np.meshgrid(*(np.arange(a - 4, b + 4, 0.8) for a, b in zip(low, high, strict=True)),
                                indexing="ij"), axis=-1)  # fmt: skip
    inside = kidney.mesh.contains(grid.reshape(-1, 3)).reshape(grid.shape[:3]).astype(np.int16)
    T = np.diag([0.8, 0.8, 0.8, 1.0])
    T[:3, 3] = low - 4
    write_scan(Scan(inside, T, "phantom"), folder / "labels.nii.gz")
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (6, 3))
    rows = [",".join(f"{v:.3f}" for v in [*p, *(p + np.array((5.0, 1.0, 2.0)))]) for p in points]
    header = "kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm"
    (folder / "landmarks.csv").write_text("\n".join([header, *rows]) + "\n")
    _boards(folder / "boards")
    if run(Job("build_vid", (*_SMALL, "calibrate=false", "workers=1"), "vid"), folder) != 0:
        raise RuntimeError(f"the VID could not be built, see {folder}")
    (folder / "pictures").mkdir()
    for number in range(PICTURES):
        picture = cv2.imread(str(folder / "vid" / "images" / f"{4 * number:06d}.png"))
        cv2.imwrite(str(folder / "pictures" / f"{number}.png"), picture)


def _boards(folder: Path) -> None:
    """Ten pictures of a chessboard through a fisheye."""
    from ursnav_torch.calibration import Board, board_picture
    from ursnav_torch.camera import Camera

    folder.mkdir()
    board = Board("chessboard", columns=9, rows=7)
    printed, scale = board_picture(board, 20), 20.0
    lens = Camera("equidistant", 250, 250, 90.0, 89.0, 122.0, 126.5, (-0.02, 0.003, 0.0, 0.0), 160.0)
    rays, mask = lens.resized(500, 500).pixel_rays()
    for number in range(10):
        rng = np.random.default_rng(number)
        R = cv2.Rodrigues(rng.uniform(-0.6, 0.6, 3))[0]
        aside = rng.uniform(-0.6, 0.6, 2)
        t = rng.uniform(15, 28) * np.array([aside[0], aside[1], 1]) - R @ (np.array([9, 7, 0]) * board.square_mm / 2)
        with np.errstate(divide="ignore"):
            away = (R[:, 2] @ t) / (rays @ R[:, 2])
        on_board = (rays * away[..., None] - t) @ R
        margin = printed.shape[1] / scale / 2 - board.columns * board.square_mm / 2
        px = ((on_board[..., :2] + margin) * scale - 0.5).astype(np.float32)
        picture = cv2.remap(printed, px[..., 0], px[..., 1], cv2.INTER_AREA, borderValue=150)
        picture[(away <= 0) | ~mask] = 0
        cv2.imwrite(str(folder / f"{number}.png"), cv2.resize(picture, (250, 250), interpolation=cv2.INTER_AREA))
