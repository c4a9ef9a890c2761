"""The pictures beside the kidney: what the scope sees, what it should see there, and what a calyx looks like."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.features import EdgePoints, read_image
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.reports import draw_edges
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_GREEN = (60, 230, 60)
#: Side of the virtual picture; and how many of a calyx's views are shown.
VIRTUAL_PX, VIEWS_SHOWN = 125, 6


class Pictures:
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

    def scope(self, image: Picture, edges: EdgePoints | None = None) -> Picture:
        """A scope's picture (H, W) or (H, W, 3) blue, green, red, with its edges."""
        return _rgb(image if edges is None else draw_edges(image, edges, _GREEN))

    def pair(self, image: Picture | None, edges: EdgePoints | None, T_kidney_camera: Array | None) -> Picture:
        """The scope's picture and what it should see from a pose, side by side; black for None."""
        virtual = self.virtual(T_kidney_camera)
        scope = np.zeros_like(virtual) if image is None else self.scope(image, edges)
        height = self.vid.camera.height
        sized = [cv2.resize(p, (round(p.shape[1] * height / p.shape[0]), height)) for p in (scope, virtual)]
        return np.asarray(np.concatenate(sized, axis=1), np.uint8)

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
            return _rgb(read_image(self.vid.image_path(index)))
        except InputError:
            return self.virtual(self.vid.T_kidney_camera[index])

    def calyx(self, calyx: int) -> Picture:
        """Some of the VID's views of a calyx, side by side, from far to near."""
        own = np.flatnonzero(self.vid.calyx == calyx)
        if not len(own):
            return np.full((VIRTUAL_PX, 3 * VIRTUAL_PX, 3), 230, np.uint8)
        away = np.linalg.norm(self.vid.T_kidney_camera[own, :3, 3] - self.vid.kidney.tips_mm[calyx], axis=1)
        chosen = own[np.argsort(-away)][np.linspace(0, len(own) - 1, VIEWS_SHOWN).astype(int)]
        small = [cv2.resize(self.view(int(i)), (VIRTUAL_PX, VIRTUAL_PX), interpolation=cv2.INTER_AREA) for i in chosen]
        half = VIEWS_SHOWN // 2
        return np.asarray(np.concatenate([np.concatenate(small[:half], 1), np.concatenate(small[half:], 1)]), np.uint8)


def _rgb(image: Picture) -> Picture:
    code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)
