"""A series of pictures with known poses: drawn, kept, matched."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import MATCH_COLUMNS, TRUTH_COLUMNS
from ursnav_torch.features import read_image
from ursnav_torch.files import Progress, write_csv, write_image
from ursnav_torch.geometry import Array
from ursnav_torch.localization import Localizer, Location
from ursnav_torch.rendering import Renderer
from ursnav_torch.rendering.sensor import PRESETS, draw_faults, simulate
from ursnav_torch.runs.pictures import Pictures, locate_files
from ursnav_torch.vid import Vid, pose_cells

RESULT_COLUMNS = (*MATCH_COLUMNS, "points")


@dataclass(frozen=True, slots=True)
class DrawnPictures:
    """Pictures in a folder's ``images/``.

    Attributes:
        names: N file names; a picture of calyx C is called C1, C2, ... as in the thesis.
        calyx: (N,) index of the calyx that each observes.
        T_kidney_camera: (N, 4, 4) where each was taken.
    """

    folder: Path
    names: tuple[str, ...]
    calyx: NDArray[np.int64]
    T_kidney_camera: Array

    def read(self, i: int) -> NDArray[np.uint8]:
        """One picture."""
        return read_image(self.folder / "images" / self.names[i])


@dataclass(frozen=True, slots=True)
class Matched:
    """Pictures and what matching said of them.

    Attributes:
        rows: N rows keyed by `RESULT_COLUMNS`. locations: N, None where there is an error.
        right: (N,) whether the calyx is right.
    """

    pictures: DrawnPictures
    rows: list[dict[str, Any]]
    locations: list[Location | None]
    right: NDArray[np.bool_]

    def column(self, name: str) -> Array:
        """(N,) numbers of a column, NaN where a picture was not matched."""
        return np.array([float(row.get(name, np.nan)) for row in self.rows])


def draw_pictures(
    folder: Path,
    renderer: Renderer,
    T_kidney_camera: Array,
    calyx: NDArray[np.int64],
    vid: Vid,
    preset: str,
    rng: np.random.Generator,
) -> DrawnPictures:
    """Draw pictures with the faults of a sensor preset, drawn anew for each; write them and ``truth.csv``.

    They are taken at poses (N, 4, 4); ``calyx`` (N,) is the index of the calyx that each observes.
    """
    (folder / "images").mkdir(parents=True, exist_ok=True)
    names, count = [], dict.fromkeys(range(len(vid.kidney.calyces)), 0)
    for T, c in zip(T_kidney_camera, calyx.tolist(), strict=True):
        count[c] += 1
        names.append(f"{vid.calyx_name(c)}{count[c]}.png")
        picture = simulate(renderer, T, draw_faults(PRESETS[preset], rng), rng)
        write_image(folder / "images" / names[-1], picture)
    cells = pose_cells(T_kidney_camera)
    truth = [
        {"image": name, "calyx": vid.calyx_name(c)} | cell
        for name, c, cell in zip(names, calyx.tolist(), cells, strict=True)
    ]
    write_csv(folder / "truth.csv", TRUTH_COLUMNS, truth)
    return DrawnPictures(folder, tuple(names), calyx, T_kidney_camera)


def match_pictures(localizer: Localizer, pictures: DrawnPictures, progress: Progress) -> Matched:
    """Locate every picture and write ``matches.csv``."""
    paths = [pictures.folder / "images" / name for name in pictures.names]
    rows: list[dict[str, Any]] = []
    locations: list[Location | None] = []
    with progress(len(paths), f"{pictures.folder.name} pictures matched") as advance:
        whole = Pictures(pictures.folder / "images", paths, localizer.vid.cut_of(None))
        for row, location in locate_files(localizer, whole):
            rows.append(row if location is None else row | {"points": len(location.features.edges)})
            locations.append(location)
            advance(1)
    write_csv(pictures.folder / "matches.csv", RESULT_COLUMNS, rows)
    answers = [-1 if location is None else location.calyx for location in locations]
    return Matched(pictures, rows, locations, np.array(answers) == pictures.calyx)
