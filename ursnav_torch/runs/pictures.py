"""Many pictures, one row each: what the `match` runner writes."""

import glob
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import PictureCut
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import IMAGE_SUFFIXES, read_image
from ursnav_torch.files import natural_key
from ursnav_torch.localization.answers import Location
from ursnav_torch.localization.locate import Again, Localizer
from ursnav_torch.processes import in_order
from ursnav_torch.vid import pose_cells


def find_images(where: str) -> tuple[Path, list[Path]]:
    """The pictures of a file, a folder or a glob, in natural order, and the folder their names are relative to.

    Raises:
        InputError: nothing there, or no picture among it; other files in a folder are passed over.
    """
    path = Path(where).expanduser()
    if path.is_file():
        return path.parent, [path]
    if path.is_dir():
        base, found = path, [p for p in path.rglob("*") if _is_picture(p)]
        what = f"The folder {path} holds no picture"
    else:
        found = [p for p in map(Path, glob.glob(str(path), recursive=True)) if _is_picture(p)]
        base = path.parent if found and all(p.parent == path.parent for p in found) else Path(_fixed_part(path))
        what = f"There is no picture at {path}"
    if not found:
        raise InputError(f"{what}: images= takes a file, a folder or a glob of {', '.join(IMAGE_SUFFIXES)} files.")
    return base, sorted(found, key=lambda p: natural_key(str(p.relative_to(base))))


@dataclass(frozen=True, slots=True)
class Pictures:
    """Files to be located.

    Attributes:
        base: the folder that their names are relative to.
        paths: the files, in order.
        cut: what part of the lens's pictures they show.
    """

    base: Path
    paths: list[Path]
    cut: PictureCut

    def names(self) -> list[str]:
        """What a row calls each."""
        return [path.relative_to(self.base).as_posix() for path in self.paths]

    def read(self, path: Path) -> NDArray[np.uint8]:
        """A picture as the lens gives it (H, W) or (H, W, 3); raises as `read_image` does."""
        return self.cut.put_back(read_image(path))

    def readable(self, path: Path) -> NDArray[np.uint8] | None:
        """`read`, (H, W) or (H, W, 3), or None where it is none."""
        try:
            return self.read(path)
        except InputError:
            return None

    def after(self, done: int) -> "Pictures":
        """Those that are left after so many."""
        return replace(self, paths=self.paths[done:])


def locate_files(
    localizer: Localizer, pictures: Pictures, children: int = 0
) -> Iterator[tuple[dict[str, Any], Location | None]]:
    """A row of `MATCH_COLUMNS` and the location of every picture; one that cannot be located has an ``error``.

    Args:
        localizer: for pictures taken through its VID's lens.
        pictures: the files.
        children: processes beside this one that locate while the caller does something else; their VID is the one
            in the localizer's folder.
    """
    make = (
        partial(_Locating, localizer.again(), pictures) if children else lambda: partial(_located, localizer, pictures)
    )
    yield from in_order(make, pictures.paths, children)


class _Locating:
    """Called with a picture's path: its row and location, see `locate_files`."""

    def __init__(self, again: Again, pictures: Pictures) -> None:
        self._localizer, self._pictures = again.localizer(), pictures

    def __call__(self, path: Path) -> tuple[dict[str, Any], Location | None]:
        return _located(self._localizer, self._pictures, path)


def _located(localizer: Localizer, pictures: Pictures, path: Path) -> tuple[dict[str, Any], Location | None]:
    row: dict[str, Any] = {"image": path.relative_to(pictures.base).as_posix()}
    try:
        location = localizer.locate(pictures.read(path))
    except (FeatureError, InputError) as error:
        return row | {"error": str(error)}, None
    return row | match_row(location), location


def match_row(location: Location) -> dict[str, Any]:
    """The columns of one location."""
    pose: NDArray[np.float64] = location.T_kidney_camera
    return {
        "calyx": location.calyx_name,
        **pose_cells(pose[None])[0],
        "view": location.view,
        "distance": location.distance,
        "confidence": _known(location.confidence),
        "accepted": location.accepted,
        "seconds": location.seconds,
        "calyces": "|".join(location.calyces),
        "position_sd_mm": _known(location.position_sd_mm),
        "direction_sd_deg": _known(location.direction_sd_deg),
    }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _is_picture(path: Path) -> bool:
    """By its name; a link that leads nowhere counts, and gets a row that says so."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir()


def _fixed_part(pattern: Path) -> str:
    """The folder before the first wildcard."""
    parts: list[str] = []
    for part in pattern.parts:
        if glob.has_magic(part):
            break
        parts.append(part)
    return str(Path(*parts)) if parts else "."
