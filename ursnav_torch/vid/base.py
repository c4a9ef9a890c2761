"""The virtual image database in memory."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera, PictureCut, cut_of
from ursnav_torch.errors import InputError
from ursnav_torch.features import Extractor, Settings, image_from_bytes, make_extractor
from ursnav_torch.inputs import read_regular
from ursnav_torch.kidney import NO_CALYX, Kidney, LumenDistance
from ursnav_torch.pictures import MOST_BYTES

if TYPE_CHECKING:
    from ursnav_torch.vid.screen import Screen


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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
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
        picture_sums: sha256 of every view's picture; none where it was built before they were kept.
        screen: of a large VID, by which it is searched in two stages; its features are proven view by view.
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
    picture_sums: tuple[str, ...] = ()
    screen: "Screen | None" = None

    def __len__(self) -> int:
        return len(self.T_kidney_camera)

    def __repr__(self) -> str:
        lens = f"{self.camera.model} {self.camera.width} x {self.camera.height}"
        return f"<Vid of {len(self)} views of {self.kidney!r} through {lens}>"

    def extractor(self) -> Extractor:
        """An extractor as the views' features were made with."""
        return make_extractor(self.settings, self.camera)

    def cut_of(self, camera: Camera | None, was_cut: bool = False) -> PictureCut:
        """Where pictures through ``camera`` lie in the views'; None: they are as the views' lens gives them.

        Args:
            camera: the pictures' lens.
            was_cut: whether it is said to be the views', cropped or scaled; else it must be as large as theirs.

        Raises:
            InputError: it is another lens.
        """
        lens = self.camera
        whole = PictureCut(lens, lens.width, lens.height, 0, 0, lens.width, lens.height)
        if camera is None or lens.same_lens(camera):
            return whole if camera is None else whole.through(camera)
        cut = cut_of(camera, lens) if was_cut else None
        if cut is None:
            raise InputError(
                f"The pictures' lens ({_lens(camera)}) is not the one that the VID {self.folder} was drawn through "
                f"({_lens(self.camera)}), nor a part of it; build a VID with camera= as the pictures have it."
            )
        return cut

    def calyx_name(self, calyx: int) -> str:
        """Name of a calyx index; blank for -1."""
        return self.kidney.calyces[calyx].name if calyx >= 0 else ""

    def set_names(self, calyces: Sequence[int]) -> tuple[str, ...]:
        """Names of the calyces that a picture may show; ``none`` for -1."""
        return tuple(self.calyx_name(c) or NO_CALYX for c in calyces)

    def image_path(self, view: int) -> Path:
        """The picture of one view."""
        return self.folder / "images" / image_name(view)

    def read_picture(self, view: int) -> NDArray[np.uint8]:
        """The picture of one view (H, W) or (H, W, 3), proven by its checksum.

        Raises:
            InputError: it is not there, was changed, or the VID was built before pictures were under its checksums.
        """
        path = self.image_path(view)
        if not self.picture_sums:
            raise InputError(f"The pictures of the VID {self.folder} are not under its checksums; build the VID again.")
        data = read_regular(path, "picture", MOST_BYTES)
        if hashlib.sha256(data).hexdigest() != self.picture_sums[view]:
            raise InputError(f"{path} was changed after the VID was built; build the VID again.")
        return image_from_bytes(data, path.name)

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """All pictures in turn; raises as `read_picture` does."""
        return map(self.read_picture, range(len(self)))


def image_name(view: int) -> str:
    """File name of a view's picture."""
    return f"{view:06d}.png"


def _lens(camera: Camera) -> str:
    return f"{camera.model}, {camera.width} x {camera.height} px, fx {camera.fx:.1f}, fy {camera.fy:.1f}"
