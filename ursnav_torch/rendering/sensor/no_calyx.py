"""Pictures that show no calyx: what a system must refuse to locate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.rendering.base import Renderer
from ursnav_torch.rendering.sensor.electronics import digitize
from ursnav_torch.rendering.sensor.occluders import occlude
from ursnav_torch.rendering.sensor.optics import image_circle, through_lens
from ursnav_torch.rendering.sensor.presets import PRESETS, draw_faults
from ursnav_torch.rendering.sensor.simulate import SensorFaults, simulate
from ursnav_torch.rendering.sensor.surface import Floats, lens_rays

Picture = NDArray[np.uint8]
Rng = np.random.Generator
Poses = NDArray[np.float64]
Draw = Callable[[Renderer, Poses, SensorFaults, Rng], Picture]
_PRESS_TRIES = 50
_PRESSED_DEPTH_MM = 4.0


def none_pictures(
    rng: Rng, n: int, renderer: Renderer, T_kidney_camera: Poses, kinds: Sequence[str] | None = None
) -> list[tuple[Picture, str]]:
    """Draw ``n`` pictures (H, W, 3), uint8, blue green red, that show no calyx, each with the name of its kind.

    Args:
        rng: draws everything.
        n: how many; the kinds take turns.
        renderer: the kidney and the scope's lens.
        T_kidney_camera: (K, 4, 4) poses inside the lumen, from which the scope runs into the wall.
        kinds: some of `NO_CALYX_KINDS`; all of them by default.

    Raises:
        InputError: an unknown kind, or no pose.
    """
    kinds = list(kinds or NO_CALYX_KINDS)
    unknown = [kind for kind in kinds if kind not in NO_CALYX_KINDS]
    if unknown or len(T_kidney_camera) == 0:
        raise InputError(
            f"Cannot draw pictures of kinds {unknown} from {len(T_kidney_camera)} poses; give at least one pose and "
            f"kinds out of {', '.join(NO_CALYX_KINDS)}."
        )
    presets = list(PRESETS.values())
    pictures = []
    for i in range(n):
        kind = kinds[i % len(kinds)]
        faults = draw_faults(presets[rng.integers(len(presets))], rng)
        pictures.append((NO_CALYX_KINDS[kind](renderer, T_kidney_camera, faults, rng), kind))
    return pictures


def _wall(renderer: Renderer, T_kidney_camera: Poses, faults: SensorFaults, rng: Rng) -> Picture:
    """The tip pressed against the wall: near, steep on, out of focus."""
    faults = replace(faults, optics=replace(faults.optics, defocus_px=float(rng.uniform(0.8, 4))))
    return simulate(renderer, pressed_pose(renderer, T_kidney_camera, rng), faults, rng)


def pressed_pose(renderer: Renderer, T_kidney_camera: Poses, rng: Rng) -> NDArray[np.float64]:
    """A pose (4, 4) 0.3 to 1.2 mm before the wall, facing it within about 30 degrees, with no deep view past it.

    Raises:
        InputError: no such pose was found from the poses (K, 4, 4).
    """
    for _ in range(_PRESS_TRIES):
        T = T_kidney_camera[rng.integers(len(T_kidney_camera))]
        view = renderer.render(T)
        seen = np.flatnonzero(np.isfinite(view.depth_mm))
        if len(seen) == 0:
            continue
        pixel = seen[rng.integers(len(seen))]
        ray = lens_rays(renderer.camera)[0].reshape(-1, 3)[pixel]
        normal = T[:3, :3] @ view.normals.reshape(-1, 3)[pixel]
        wall = T[:3, :3] @ (ray * view.depth_mm.reshape(-1)[pixel]) + T[:3, 3]
        tilt = rng.uniform(-1, 1, 3) * np.tan(np.radians(30)) / np.sqrt(3)
        pressed = look_along(wall + rng.uniform(0.3, 1.2) * normal, tilt - normal, rng.uniform(0, 2 * np.pi))
        depth = renderer.render(pressed).depth_mm
        if np.isfinite(depth).any() and np.percentile(depth[~np.isnan(depth)], 80) < _PRESSED_DEPTH_MM:
            return pressed
    raise InputError(f"No pose against the wall found in {_PRESS_TRIES} tries; give poses inside the lumen.")


def _white_out(renderer: Renderer, _poses: Poses, faults: SensorFaults, rng: Rng) -> Picture:
    return _spoiled(_even(renderer, rng, rng.uniform(0.7, 1.2)), renderer, faults, rng)


def _dark(renderer: Renderer, _poses: Poses, faults: SensorFaults, rng: Rng) -> Picture:
    """The light is off or the lens covered."""
    optics = replace(faults.optics, halo=0.0, stripes=min(faults.optics.stripes, 2.0))
    faults = replace(faults, optics=optics, occluders=SensorFaults().occluders)
    return _spoiled(_even(renderer, rng, rng.uniform(0, 0.06)), renderer, faults, rng)


def _noise(renderer: Renderer, _poses: Poses, faults: SensorFaults, rng: Rng) -> Picture:
    """A broken cable: noise of any coarseness, in color or gray."""
    mask = lens_rays(renderer.camera)[1]
    height, width = mask.shape
    grain, channels = rng.choice([1, 1, 2, 4]), rng.choice([1, 3])
    noise = rng.normal(
        rng.uniform(0.2, 0.6), rng.uniform(0.1, 0.4), (height // grain + 1, width // grain + 1, channels)
    )
    noise = np.broadcast_to(noise, (*noise.shape[:2], 3))
    picture = cv2.resize(noise.astype(np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    return digitize(picture, mask, faults.electronics, rng)


def _outside(renderer: Renderer, _poses: Poses, faults: SensorFaults, rng: Rng) -> Picture:
    """Out of the body: drapes, a sheet's weave, straight-edged things, a lamp."""
    x, y, radius = image_circle(renderer.camera)
    picture = _clouds(renderer, rng, cells=int(rng.integers(3, 7)))
    turn, pitch = rng.uniform(0, np.pi), rng.uniform(4, 14) * radius / 125
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    weave = np.sin(2 * np.pi * along / pitch) * np.sin(2 * np.pi * across / pitch)
    picture = picture * (1 + rng.uniform(0, 0.25) * weave[..., None])
    for _ in range(rng.integers(0, 4)):
        angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(-0.7, 0.7) * radius
        beyond = np.clip(x * np.cos(angle) + y * np.sin(angle) - away + 0.5, 0, 1)[..., None]
        picture = picture * (1 - beyond) + beyond * picture * rng.uniform(0.4, 1.6) * rng.uniform(0.8, 1.2, 3)
    return _spoiled(picture.astype(np.float32), renderer, faults, rng)


def _bubbles(renderer: Renderer, _poses: Poses, faults: SensorFaults, rng: Rng) -> Picture:
    """A curtain of bubbles and dust before a wall that cannot be made out."""
    occluders = replace(
        faults.occluders, bubbles=int(rng.integers(8, 40)), bubble_px=float(rng.uniform(4, 20)),
        debris=int(rng.integers(0, 40)), fiber=0.0, stone=0.0,
    )  # fmt: skip
    picture = _even(renderer, rng, rng.uniform(0.25, 0.6))
    return _spoiled(picture, renderer, replace(faults, occluders=occluders), rng)


#: What a picture without a calyx may show.
NO_CALYX_KINDS: Mapping[str, Draw] = MappingProxyType({
    "wall": _wall, "white-out": _white_out, "dark": _dark, "noise": _noise, "outside": _outside, "bubbles": _bubbles,
})  # fmt: skip


def _even(renderer: Renderer, rng: Rng, level: float) -> Floats:
    """(H, W, 3): one brightness, a little uneven and tinted."""
    clouds = _clouds(renderer, rng, cells=3).mean(axis=2, keepdims=True)
    uneven = clouds / max(float(clouds.mean()), 1e-3)
    return (level * uneven ** rng.uniform(0, 0.4) * rng.uniform(0.92, 1.0, 3)).astype(np.float32)


def _clouds(renderer: Renderer, rng: Rng, cells: int) -> Floats:
    """(H, W, 3): smooth patches of color."""
    coarse = rng.uniform(0.15, 0.9, (cells, cells, 1)) * rng.uniform(0.8, 1, (cells, cells, 3))
    size = (renderer.camera.width, renderer.camera.height)
    return np.clip(cv2.resize(coarse.astype(np.float32), size, interpolation=cv2.INTER_CUBIC), 0.02, None)


def _spoiled(picture: Floats, renderer: Renderer, faults: SensorFaults, rng: Rng) -> Picture:
    """The picture through occluders, lens and electronics."""
    camera, mask = renderer.camera, lens_rays(renderer.camera)[1]
    picture = occlude(picture, mask, camera, faults.occluders, rng)
    return digitize(through_lens(picture, mask, camera, faults.optics, rng), mask, faults.electronics, rng)
