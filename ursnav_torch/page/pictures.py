"""The pictures beside the kidney: what the scope sees, what it should see there, and what a calyx looks like."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Side of the virtual picture and of a calyx's thumbnail.
VIRTUAL_PX = 125


class PagePictures:
    """Makes the page's pictures, all (H, W, 3) red, green, blue.

    Args:
        vid: the views and what draws more.
    """

    def __init__(self, vid: Vid) -> None:
        self.vid = vid
        shrink = VIRTUAL_PX / max(vid.camera.width, vid.camera.height)
        self._lens = vid.camera.resized(round(vid.camera.width * shrink), round(vid.camera.height * shrink))
        self._renderer = RaycastRenderer(vid.kidney.mesh, self._lens)
        self._full = RaycastRenderer(vid.kidney.mesh, vid.camera)

    def scope(self, image: Picture) -> Picture:
        """A scope's picture (H, W) or (H, W, 3) blue, green, red."""
        return _rgb(image)

    def virtual(self, T_kidney_camera: Array | None) -> Picture:
        """What the scope should see from a pose (4, 4); black for None."""
        if T_kidney_camera is None:
            return np.zeros((self._lens.height, self._lens.width, 3), np.uint8)
        return _rgb(self._renderer.render(T_kidney_camera).image)

    def large(self, T_kidney_camera: Array) -> Picture:
        """What the scope should see, as large as its own pictures."""
        return _rgb(self._full.render(T_kidney_camera).image)

    def view(self, index: int) -> Picture:
        """The picture of one of the VID's views; drawn again where the VID was stored without pictures."""
        try:
            return _rgb(self.vid.read_picture(index))
        except InputError:
            return self.virtual(self.vid.T_kidney_camera[index])

    def thumbnail(self, calyx: int) -> Picture:
        """One of the VID's views of a calyx, half-way in; gray where it has none."""
        own = np.flatnonzero(self.vid.calyx == calyx)
        if not len(own):
            return np.full((VIRTUAL_PX, VIRTUAL_PX, 3), 90, np.uint8)
        away = np.linalg.norm(self.vid.T_kidney_camera[own, :3, 3] - self.vid.kidney.tips_mm[calyx], axis=1)
        view = self.view(int(own[np.argsort(away)[len(own) // 2]]))
        return np.asarray(cv2.resize(view, (VIRTUAL_PX, VIRTUAL_PX), interpolation=cv2.INTER_AREA), np.uint8)


def jpeg(picture: Picture, quality: int = 85) -> bytes:
    """A picture (H, W, 3) red, green, blue as a JPEG file's bytes."""
    return bytes(cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


def _rgb(image: Picture) -> Picture:
    code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)
