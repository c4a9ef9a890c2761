"""Drawing views and reducing them to features: the part of a build that takes the time, shard by shard."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from ursnav_torch.camera import Camera
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import (
    NO_EDGES,
    NO_MAPS,
    EdgePoints,
    Extractor,
    Features,
    Settings,
    make_extractor,
    read_image,
)
from ursnav_torch.files import write_image
from ursnav_torch.geometry import apply
from ursnav_torch.rendering import Renderer, View
from ursnav_torch.vid.base import ViewFeatures, image_name

Array = NDArray[np.float64]
MakeRenderer = Callable[[trimesh.Trimesh, Camera], Renderer]

_FIELDS = ("points", "mask", "direction", "weight", "points_kidney", "maps")


@dataclass(frozen=True, slots=True, eq=False)
class Studio:
    """All that is needed to draw views in another process; ``pictures``, where given, stand in for what is drawn."""

    mesh: trimesh.Trimesh
    camera: Camera
    settings: Settings
    make_renderer: MakeRenderer
    pictures: tuple[Path, ...] = ()

    def draw(self, T_kidney_camera: Array, first: int, images: Path) -> ViewFeatures:
        """Draw poses (N, 4, 4), write their pictures as views ``first``... into a folder, return their features."""
        renderer, extractor = _tools(self)
        rows = []
        for number, T in enumerate(T_kidney_camera):
            view = renderer.render(T)
            image = read_image(self.pictures[first + number]) if self.pictures else view.image
            write_image(images / image_name(first + number), image)
            try:
                features = extractor.extract(image, virtual=True)
            except FeatureError:  # a wall without relief: the view stays, and never matches
                features = _no_features(image.shape)
            rows.append((features, wall_points(features.edges, view, self.camera, T)))
        return pack(rows, self.settings.points)


@lru_cache(maxsize=1)
def _tools(studio: Studio) -> tuple[Renderer, Extractor]:
    """What draws and reads a studio's views: made once a process, as shard follows on shard."""
    return studio.make_renderer(studio.mesh, studio.camera), make_extractor(studio.settings, studio.camera)


def wall_points(edges: EdgePoints, view: View, camera: Camera, T_kidney_camera: Array) -> NDArray[np.float32]:
    """Where edge points (N) lie on the wall: (N, 3) in the kidney frame, nan without a wall.

    At an occluding edge the nearer wall makes the edge, so the least depth of the 3 x 3 px around counts.
    """
    pixels = edges.points.numpy()
    if not len(pixels):
        return np.zeros((0, 3), np.float32)
    depth = np.where(np.isfinite(view.depth_mm), view.depth_mm, np.inf).astype(np.float32)
    nearest = cv2.erode(depth, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    x, y = np.rint(pixels).astype(int).T
    d = nearest[y.clip(0, camera.height - 1), x.clip(0, camera.width - 1)]
    rays, _ = camera.rays(pixels)
    points = apply(T_kidney_camera, rays * np.where(np.isfinite(d), d, np.nan)[:, None])
    return points.astype(np.float32)


def pack(rows: list[tuple[Features, NDArray[np.float32]]], width: int) -> ViewFeatures:
    """Features of N pictures, each with its points on the wall (K, 3), mm, kidney frame, padded to ``width`` points."""
    n = len(rows)
    points, points_kidney = torch.zeros(n, width, 2), torch.full((n, width, 3), torch.nan)
    mask = torch.zeros(n, width, dtype=torch.bool)
    direction, weight = torch.zeros(n, width), torch.zeros(n, width)
    shape = next((f.maps.shape for f, _ in rows if f.maps.numel()), NO_MAPS.shape)
    maps = torch.zeros(n, *shape, dtype=torch.float16)
    for i, (features, wall) in enumerate(rows):
        k = len(features.edges)
        points[i, :k], mask[i, :k] = features.edges.points, True
        direction[i, :k], weight[i, :k] = features.edges.direction, features.edges.weight
        points_kidney[i, :k] = torch.from_numpy(wall)
        if features.maps.numel():
            maps[i] = features.maps.half()
    return ViewFeatures(points, mask, direction, weight, points_kidney, maps)


def join(parts: list[ViewFeatures]) -> ViewFeatures:
    """Features of several shards in one."""
    return ViewFeatures(*(torch.cat([getattr(part, name) for part in parts]) for name in _FIELDS))


def save_features(path: Path, features: ViewFeatures) -> None:
    """Write features as safetensors, readable by whom the umask lets read (the library alone would say 0600)."""
    path.touch()
    mode = path.stat().st_mode
    save_file({name: getattr(features, name).contiguous() for name in _FIELDS}, str(path))
    path.chmod(mode)


def load_features(path: Path) -> ViewFeatures:
    """Read `save_features`'s file, memory-mapped.

    Raises:
        InputError: damaged, or not such a file.
    """
    try:
        data = load_file(str(path))
        return ViewFeatures(*(data[name] for name in _FIELDS))
    except (SafetensorError, KeyError, OSError) as error:
        raise InputError(f"{path} is damaged ({error}); copy it again or build the VID again.") from None


def check_features(features: ViewFeatures, views: int, width: int, where: str) -> None:
    """Refuse features that are not those of this many views: other counts, shapes or kinds of numbers.

    Args:
        features: to be checked.
        views: how many there must be.
        width: points a view that the extractor's settings allow.
        where: names the file in errors.

    Raises:
        InputError: naming the field.
    """
    float32, points = torch.float32, (views, width)
    wanted = {
        "points": (float32, (*points, 2)),
        "mask": (torch.bool, points),
        "direction": (float32, points),
        "weight": (float32, points),
        "points_kidney": (float32, (*points, 3)),
        "maps": (torch.float16, (views, *features.maps.shape[1:])),
    }
    for name, (kind, shape) in wanted.items():
        found = getattr(features, name)
        if found.dtype != kind or tuple(found.shape) != shape or (name == "maps" and found.ndim != 4):
            raise InputError(
                f"{where}: {name} is {found.dtype} {tuple(found.shape)}, expected {kind} {shape} for {views} views; "
                "build the VID again."
            )


def _no_features(shape: tuple[int, ...]) -> Features:
    return Features(NO_EDGES, NO_MAPS, np.zeros(shape[:2], bool), NO_MAPS)
