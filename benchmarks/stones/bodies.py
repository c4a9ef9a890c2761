"""What the wall network sees before the wall in a flight's pictures, read once and kept."""

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.shared.fingerprints import sources
from benchmarks.stones.flights import StoneFlight
from ursnav_torch.camera import Camera
from ursnav_torch.features import DefaultExtractor, DefaultSettings
from ursnav_torch.features.foreground import ForegroundBody, find_bodies
from ursnav_torch.features.network import WallReader

_LEVELS = 255


def bodies_of(flight: StoneFlight, camera: Camera) -> list[tuple[ForegroundBody, ...]]:
    """The bodies of every picture, as the default extractor would tell them."""
    extractor = DefaultExtractor(DefaultSettings(), camera)
    mask, scale = extractor.lens_mask, camera.width / extractor.working_camera.width
    return [
        find_bodies(torch.from_numpy(p.astype(np.float32) / _LEVELS), mask, scale) for p in _read(flight, extractor)
    ]


def _read(flight: StoneFlight, extractor: DefaultExtractor) -> NDArray[np.uint8]:
    """(N, 2, h, w) probabilities of `foreground.KINDS` in steps of 1/255."""
    path = flight.folder / f"before_{sources(('features',))[:8]}.npz"
    if not path.exists():
        reader = WallReader(extractor.working_camera, extractor.lens_mask)
        with torch.inference_mode():
            found = [(reader.read(image)[1] * _LEVELS).round().to(torch.uint8).numpy() for image in flight.images()]
        np.savez_compressed(path, before=np.stack(found))
    with np.load(path) as kept:
        return np.asarray(kept["before"])
