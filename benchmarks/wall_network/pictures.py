"""What the wall network learns from: phantoms drawn through random lenses, with faults wider than the world."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.camera import Camera, equidistant_camera, pinhole_camera
from ursnav_torch.errors import UrsnavError
from ursnav_torch.features.network import NATIVE_PX
from ursnav_torch.kidney import Kidney, LumenDistance, make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer, WarpSettings, deform_mesh
from ursnav_torch.rendering.sensor.presets import (
    IN_VIVO_LIKE,
    THESIS_PHANTOM,
    THESIS_SIMULATION,
    WIDE,
    Preset,
    Span,
    draw_faults,
)
from ursnav_torch.rendering.sensor.simulate import SensorFaults, simulate_labeled
from ursnav_torch.vid import PlanSettings, plan_views

#: Pictures of a phantom, and how many of them share a lens and a deformation.
PER_PHANTOM, PER_LENS = 160, 20
MODELS = ("equidistant", "pinhole")
#: `WIDE` with something before the wall in most pictures.
CROWDED: Preset = {
    **WIDE, "bodies.stones": Span(1, 3, share=0.65), "bodies.stone_mm": Span(0.7, 5.0, log=True),
    "bodies.instrument_mm": Span(2.0, 13.0, share=0.65), "bodies.instrument_lean": Span(-0.1, 0.5),
}  # fmt: skip
Rng = np.random.Generator


@dataclass(frozen=True, slots=True)
class Lesson:
    """Pictures of one phantom and what is true of them, N of size S.

    Attributes:
        picture: (N, S, S, 3) uint8, blue green red.
        clean: (N, S, S) uint8, the view as a VID would hold it.
        depth_mm: (N, S, S) float16, 0 without a wall.
        kind: (N, S, S) uint8, see `rendering.sensor.bodies`.
        lens: (N, 3) row of `MODELS`, focal length in px, field of view in degrees or 0.
    """

    picture: NDArray[np.uint8]
    clean: NDArray[np.uint8]
    depth_mm: NDArray[np.float16]
    kind: NDArray[np.uint8]
    lens: NDArray[np.float64]

    def camera(self, row: int) -> Camera:
        """The lens of one picture."""
        model, focal, fov = self.lens[row]
        size, middle = self.picture.shape[1], (self.picture.shape[1] - 1) / 2
        return Camera(MODELS[int(model)], size, size, focal, focal, middle, middle, fov_deg=fov or None)


def lesson(seed: int, folder: Path, crowded: bool = False) -> Lesson | None:
    """The lesson of one phantom, drawn where the folder does not hold it; None where the phantom cannot be planned.

    In a crowded one most of the pictures show stones and an instrument.
    """
    name = f"{seed}_crowded" if crowded else str(seed)
    path = folder / f"{name}.npz"
    if not path.exists():
        drawn = draw_lesson(seed, CROWDED if crowded else WIDE)
        if drawn is None:
            return None
        partial = folder / f"{name}.partial.npz"
        np.savez(partial, **{name: getattr(drawn, name) for name in Lesson.__slots__})
        os.replace(partial, path)
    with np.load(path) as data:
        return Lesson(*(data[name] for name in Lesson.__slots__))


def draw_lesson(seed: int, widest: Preset = WIDE) -> Lesson | None:
    """Pictures of one phantom from places all over it, most of a preset; None where its plan has too few."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    try:
        kidney = make_phantom_kidney(seed)
        places = places_in(kidney, seed)
    except UrsnavError:
        return None
    order = rng.permutation(len(places))[:PER_PHANTOM]
    pictures, clean, depth, kind, lenses = [], [], [], [], []
    for number, view in enumerate(order):
        if number % PER_LENS == 0:
            renderer = lens_of(kidney, rng)
        T = places[view]
        drawn = renderer.render(T)
        labeled = simulate_labeled(drawn, renderer.camera, T, faults_of(rng, widest), rng)
        image = labeled.image
        if rng.random() < 0.05:  # a gray camera
            image = np.repeat(image.mean(2, keepdims=True).astype(np.uint8), 3, 2)
        pictures.append(image)
        clean.append(drawn.image)
        depth.append(np.where(np.isfinite(drawn.depth_mm), drawn.depth_mm, 0).astype(np.float16))
        kind.append(labeled.kind)
        lenses.append([MODELS.index(renderer.camera.model), renderer.camera.fx, renderer.camera.fov_deg or 0])
    return Lesson(np.array(pictures), np.array(clean), np.array(depth), np.array(kind), np.array(lenses, float))


def places_in(kidney: Kidney, seed: int) -> NDArray[np.float64]:
    """Poses (N, 4, 4), places and directions wider than a VID's: a scope looks anywhere.

    Raises:
        InputError: see `plan_views`.
    """
    settings = PlanSettings(
        views_per_calyx=40, passage_views=120, around=0.0, tilt_deg=24, largest_tilt_deg=70, nearest_mm=1.5,
        farthest_mm=18, roll_deg=180, seed=seed,
    )  # fmt: skip
    return plan_views(kidney, LumenDistance.from_kidney(kidney), settings).T_kidney_camera


def lens_of(kidney: Kidney, rng: Rng) -> RaycastRenderer:
    """A random lens, and in every other case a kidney that has moved and swollen since its scan."""
    if rng.random() < 0.75:
        camera = equidistant_camera(rng.uniform(90, 170), NATIVE_PX, NATIVE_PX)
    else:
        camera = pinhole_camera(rng.uniform(60, 100), NATIVE_PX, NATIVE_PX)
    mesh = kidney.mesh
    if rng.random() < 0.5:
        warp = WarpSettings(
            amplitude_mm=rng.uniform(0.3, 1.5), wavelength_mm=rng.uniform(18, 45), distension=rng.uniform(0, 0.1)
        )
        mesh = deform_mesh(mesh, warp, rng).mesh
    return RaycastRenderer(mesh, camera)


def faults_of(rng: Rng, widest: Preset) -> SensorFaults:
    """Four of five of the widest preset, most of them through a good sensor; the others of the thesis's kinds."""
    u = rng.random()
    wide = u < 0.8
    preset = widest if wide else IN_VIVO_LIKE if u < 0.9 else THESIS_PHANTOM if u < 0.97 else THESIS_SIMULATION
    faults = draw_faults(preset, rng)
    if wide and rng.random() < 0.6:
        faults = good_sensor(faults, rng)
    if rng.random() < 0.08:
        faults = replace(faults, wall=replace(faults.wall, color_bgr=(faults.wall.color_bgr[1],) * 3))
    return faults


def good_sensor(faults: SensorFaults, rng: Rng) -> SensorFaults:
    """The same scene through a clean lens and a quiet sensor: then what is hard is the scene."""
    share = rng.uniform(0, 0.35)
    fainter = ("defocus_px", "motion_px", "veil", "bloom", "halo", "vignetting")
    optics = replace(faults.optics, **{name: getattr(faults.optics, name) * share for name in fainter}, stripes=0.0)
    electronics = replace(
        faults.electronics, shot_noise=faults.electronics.shot_noise * share,
        read_noise=faults.electronics.read_noise * share, jpeg_quality=90,
    )  # fmt: skip
    occluders = faults.occluders
    if rng.random() >= 0.3:
        occluders = replace(occluders, debris=0, bubbles=0, blood=0.0)
    return replace(faults, optics=optics, electronics=electronics, occluders=occluders)
