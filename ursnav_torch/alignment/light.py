"""The light as far as alignment must know it: where the LED sits, and how much of it the water gives back.

Drawn with its light in the lens, a wall that is lit from beside it fits best from a pose a little off; there the gain
is small once gradients are aligned too, and largest for an LED well off the axis. Murky water gives light back, the
more the farther the wall behind it is (backscatter: McGlamery, SPIE 208:221, 1980): a deep calyx looks as bright as
the wall around it or brighter, and drawn dark it fits best from too far ahead. So both are found along with the pose,
held by a prior.
"""

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.rendering import HeadLight, percentile

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

#: Offset x, y, z in mm in the camera frame, reach in mm, ambient share: as the VID's views are lit; and last, of the
#: water and not of the lamp, its glow before a wall far away, picture value.
AT_CAMERA: Array = np.array([0.0, 0.0, 0.0, 4.0, 0.02, 0.0])
#: How far scopes are from that (standard deviations).
SPREAD: Array = np.array([1.5, 1.5, 1.5, 2.0, 0.06])
#: Steps by which drawings are compared to see what each number does to a picture.
STEP: Array = np.array([0.3, 0.3, 0.3, 0.5, 0.03, 0.1])
#: Largest change while one drawing is aligned.
MOST: Array = np.array([1.5, 1.5, 1.5, 2.0, 0.1, 0.5])
_LOW: Array = np.array([-4.0, -4.0, -4.0, 1.0, 0.0, 0.0])
_HIGH: Array = np.array([4.0, 4.0, 4.0, 10.0, 0.4, 2.0])
_DEFAULT = HeadLight()
_TELLING, _TELLING_WATER = 0.7, 0.5  # alignments of these scores tell the lamp, and the water's glow
_ENOUGH, _KEPT = 5, 15  # so many make it known, and so many of the last are kept
_AGAIN = 4  # after so many more it is looked for again


class LampState:
    """The light of one scope, learned from pictures that are aligned well, and then held; the water's glow goes along.

    The lamp must not be learned from pictures that show little: there it bends until a wrong pose fits as well as the
    true one, and a track that slips takes the light along. Water changes, and where it is murkiest little is shown: its
    glow is the last picture's.

    Attributes:
        value: (6,), see `AT_CAMERA`: the median of the lamps found, and the last glow; None before the first.
    """

    def __init__(self) -> None:
        self._found: list[Array] = []
        self._since = 0
        self.value: Array | None = None

    @property
    def known(self) -> bool:
        """Whether the next picture is to be aligned under this lamp; now and then it is looked for again."""
        return len(self._found) >= _ENOUGH and self._since < _AGAIN

    def learn(self, light: Array, score: float) -> None:
        """Take in the light (6,) that a picture was aligned with, and how well it was."""
        if self.known:
            self._since += score >= _TELLING
        elif score >= _TELLING:
            self._found = [*self._found[1 - _KEPT :], light]
            self.value, self._since = np.median(self._found, axis=0), 0
        if self.value is not None and score >= _TELLING_WATER:
            self.value = np.append(self.value[:-1], light[-1])


def within_limits(light: Array) -> Array:
    """The nearest light (6,) that there can be."""
    return np.clip(light, _LOW, _HIGH)


def gray_values(points_mm: Floats, normals: Floats, lights: Array, water_mm: float) -> Floats:
    """Gray values (..., M, N), 0 to 255, of wall points (..., 3, N) with normals (..., 3, N), camera frame, under M
    lights (..., M, 6).

    `HeadLight.shade` for all lights at once, and the water's glow, of which two thirds come about within ``water_mm``;
    the first light sets the exposure of all.
    """
    if not points_mm.shape[-1]:
        return np.zeros((*lights.shape[:-1], 0), np.float32)
    offset, reach, ambient = lights[..., :3].astype(np.float32), lights[..., 3, None], lights[..., 4, None]
    glow = lights[..., 5, None].astype(np.float32)
    away = _dot(points_mm, points_mm)
    square = away - 2 * offset @ points_mm + np.square(offset).sum(-1)[..., None]
    radiance = offset @ normals - _dot(points_mm, normals)
    radiance /= np.sqrt(np.maximum(square, np.float32(1e-6)))
    np.clip(radiance, 0, 1, out=radiance)
    radiance += ambient.astype(np.float32)
    radiance /= square + np.square(reach).astype(np.float32)
    reference = percentile(radiance[..., 0, :], _DEFAULT.exposure_percentile)
    radiance /= np.maximum(reference, 1e-12)[..., None, None].astype(np.float32)
    gray = np.power(radiance, np.float32(1 / _DEFAULT.gamma), out=radiance)
    gray *= np.float32(_DEFAULT.exposure_level)
    np.clip(gray, 0, 1, out=gray)
    gray += glow * (1 - np.exp(np.sqrt(away) / np.float32(-water_mm)))
    gray *= 255
    return gray


def _dot(a: Floats, b: Floats) -> Floats:
    """Products (..., 1, N) of vectors (..., 3, N)."""
    return np.einsum("...in,...in->...n", a, b)[..., None, :]
