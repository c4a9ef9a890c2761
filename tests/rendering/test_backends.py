"""Ray casting and OpenGL draw the same lumen; where OpenGL cannot start, the message says what to install."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from omegaconf import OmegaConf

from ursnav_torch.camera import Camera, equidistant_camera, load_camera, pinhole_camera
from ursnav_torch.errors import MissingExtraError
from ursnav_torch.geometry import transform_from_quaternion
from ursnav_torch.rendering import FlatLight, HeadLight, Light, RaycastRenderer
from ursnav_torch.rendering.opengl import PyrenderRenderer

LENSES = {
    "pinhole 90": pinhole_camera(90, 160, 120),
    "off-center pinhole": Camera("pinhole", 120, 120, 70.0, 64.0, 52.5, 63.0),
    "fisheye 160": equidistant_camera(160, 160, 160),
    "fisheye 200": equidistant_camera(200, 120, 120),
    "distorted fisheye": Camera("equidistant", 160, 120, 60.0, 60.0, 79.0, 60.0, (-0.03, 0.004, 0.0, 0.0), 140.0),
}


@pytest.fixture(autouse=True)
def needs_egl() -> None:
    try:
        PyrenderRenderer(trimesh.creation.box(), pinhole_camera(60, 8, 8))
    except MissingExtraError as error:
        pytest.skip(str(error))


def away_from_silhouettes(depth: np.ndarray) -> np.ndarray:
    """Pixels whose neighborhood is one wall: no jump of depth beyond what a 20-degree grazing view makes."""
    smooth = np.isfinite(depth)
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            with np.errstate(invalid="ignore"):
                smooth &= np.abs(np.roll(depth, step, axis) - depth) < 0.06 * abs(step) * depth
    return smooth


@pytest.mark.parametrize("name", LENSES)
def test_backends_agree_on_depth_normals_and_image(name: str, lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    camera = LENSES[name]
    cast, drawn = RaycastRenderer(lumen, camera), PyrenderRenderer(lumen, camera)
    for T in poses:
        a, b = cast.render(T), drawn.render(T)
        np.testing.assert_array_equal(np.isnan(a.depth_mm), np.isnan(b.depth_mm))
        away = away_from_silhouettes(a.depth_mm)
        assert away.mean() > 0.5 * np.isfinite(a.depth_mm).mean()
        error = np.abs(a.depth_mm - b.depth_mm)[away]
        assert np.median(error) < 0.001
        assert error.max() < 0.04
        tilt = np.arccos(np.clip(np.sum(a.normals * b.normals, axis=2)[away], -1, 1))
        assert np.percentile(tilt, 99) < 0.03
        assert np.percentile(np.abs(a.image.astype(int) - b.image)[away], 99) <= 4


@pytest.mark.skipif("URSNAV_DATA" not in os.environ, reason="URSNAV_DATA is not set")
def test_backends_agree_in_a_real_kidney() -> None:
    folder = Path(os.environ["URSNAV_DATA"]) / "F_R"
    mesh, camera = trimesh.load(folder / "lumen.stl"), load_camera(folder / "camera.json")
    rows = np.genfromtxt(folder / "simulation" / "truth.csv", delimiter=",", skip_header=1)[::12, 2:]
    cast, drawn = RaycastRenderer(mesh, camera), PyrenderRenderer(mesh, camera)
    for row in rows:
        T = transform_from_quaternion(row[:3], row[3:])
        depth = cast.render(T).depth_mm
        error = np.abs(drawn.render(T).depth_mm - depth)[away_from_silhouettes(depth)]
        assert np.median(error) < 0.001
        assert np.percentile(error, 99.9) < 0.03


@pytest.mark.parametrize("light", [FlatLight(), HeadLight(offset_mm=(1.0, 0.5, 0.0))])
def test_backends_share_the_light(light: Light, lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    camera = equidistant_camera(160, 100, 100)
    a, b = (
        RaycastRenderer(lumen, camera, light).render(poses[0]),
        PyrenderRenderer(lumen, camera, light).render(poses[0]),
    )
    assert np.median(np.abs(a.image.astype(int) - b.image)) <= 1


def test_an_opening_is_at_infinity(lumen: trimesh.Trimesh) -> None:
    open_end = lumen.copy()
    open_end.update_faces(open_end.triangles_center[:, 2] < 5)
    camera = equidistant_camera(160, 80, 80)
    a, b = RaycastRenderer(open_end, camera).render(np.eye(4)), PyrenderRenderer(open_end, camera).render(np.eye(4))
    assert np.isinf(b.depth_mm[40, 40])
    assert (np.isinf(a.depth_mm) != np.isinf(b.depth_mm)).mean() < 0.01
    assert not b.normals[np.isinf(b.depth_mm)].any()
    assert not b.image[np.isinf(b.depth_mm)].any()


def test_without_egl_the_message_names_the_debian_packages() -> None:
    program = (
        "import trimesh; from ursnav_torch.camera import pinhole_camera;"
        "from ursnav_torch.rendering.opengl import PyrenderRenderer;"
        "PyrenderRenderer(trimesh.creation.box(), pinhole_camera(60, 8, 8))"
    )
    nowhere = os.environ | {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json", "PYOPENGL_PLATFORM": "egl"}
    run = subprocess.run([sys.executable, "-c", program], env=nowhere, capture_output=True, text=True)
    assert run.returncode == 1
    last = run.stderr.strip().splitlines()[-1]
    assert "MissingExtraError: OpenGL cannot draw without a display here" in last
    assert "apt-get install libegl1 libgl1-mesa-dri" in last and "rendering=raycast" in last


@pytest.mark.parametrize("backend", ["raycast", "pyrender"])
@pytest.mark.parametrize("light", ["headlight", "flat"])
def test_every_choice_composes_and_draws(backend: str, light: str, lumen: trimesh.Trimesh, poses: np.ndarray) -> None:
    from hydra import compose, initialize_config_dir
    from hydra.utils import instantiate

    configs = Path(__file__).parents[2] / "configs"
    with initialize_config_dir(str(configs), version_base="1.3"):
        config = compose(overrides=[f"+rendering={backend}", f"rendering/light={light}"])
    assert "_partial_" in OmegaConf.to_container(config.rendering)
    renderer = instantiate(config.rendering)(mesh=lumen, camera=equidistant_camera(160, 40, 40))
    assert type(renderer) is {"raycast": RaycastRenderer, "pyrender": PyrenderRenderer}[backend]
    assert type(renderer.light) is {"headlight": HeadLight, "flat": FlatLight}[light]
    assert renderer.render(poses[0]).image.max() > 50
