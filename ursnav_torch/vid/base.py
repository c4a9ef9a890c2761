"""The virtual image database in memory."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import Extractor, Settings, make_extractor
from ursnav_torch.kidney import NO_CALYX, Kidney, LumenDistance


@dataclass(frozen=True, slots=True)
class ViewFeatures:
    """Features of V views, padded to P points.

    Attributes:
        points: (V, P, 2) float32, edge points in px; zero where there is none.
        mask: (V, P) bool, where there is one.
        direction, weight: (V, P) float32, see `features.EdgePoints`.
        points_kidney: (V, P, 3) float32, each edge point's place on the wall, mm; nan where it is not known.
        maps: (V, C, R, A) float16 polar maps; (V, 0, 0, 0) for extractors without.
    """

    points: Tensor
    mask: Tensor
    direction: Tensor
    weight: Tensor
    points_kidney: Tensor
    maps: Tensor

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True)
class Vid:
    """A kidney, a lens, and views of one through the other with known poses.

    Attributes:
        kidney, camera: what was drawn, and through which lens.
        settings: of the extractor that made the features; pictures to be matched go through the same.
        T_kidney_camera: (V, 4, 4) float64.
        calyx: (V,) int, index into ``kidney.calyces``, -1 where a view observes none.
        features: of every view.
        folder: where it was loaded from.
        lumen: distances along the kidney's lumen, found when the VID was built.
        calibration: what the build learned about confidence from simulated queries; plain numbers.
    """

    kidney: Kidney
    camera: Camera
    settings: Settings
    T_kidney_camera: NDArray[np.float64]
    calyx: NDArray[np.int64]
    features: ViewFeatures
    folder: Path
    lumen: LumenDistance
    calibration: dict[str, object] | None = None

    def __len__(self) -> int:
        return len(self.T_kidney_camera)

    def extractor(self) -> Extractor:
        """An extractor as the views' features were made with."""
        return make_extractor(self.settings, self.camera)

    def check_lens(self, camera: Camera) -> None:
        """Refuse pictures of another lens than the views'.

        Raises:
            InputError: size or calibration differ.
        """
        if not self.camera.same_lens(camera):
            raise InputError(
                f"The pictures' lens ({_lens(camera)}) is not the one that the VID {self.folder} was drawn through "
                f"({_lens(self.camera)}); build a VID with camera= as the pictures have it."
            )

    def calyx_name(self, calyx: int) -> str:
        """Name of a calyx index; blank for -1."""
        return self.kidney.calyces[calyx].name if calyx >= 0 else ""

    def set_names(self, calyces: Sequence[int]) -> tuple[str, ...]:
        """Names of the calyces that a picture may show; ``none`` for -1."""
        return tuple(self.calyx_name(c) or NO_CALYX for c in calyces)

    def image_path(self, view: int) -> Path:
        """The picture of one view."""
        return self.folder / "images" / image_name(view)


def image_name(view: int) -> str:
    """File name of a view's picture."""
    return f"{view:06d}.png"


def _lens(camera: Camera) -> str:
    return f"{camera.model}, {camera.width} x {camera.height} px, fx {camera.fx:.1f}, fy {camera.fy:.1f}"
