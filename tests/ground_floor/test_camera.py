import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ursnav_torch.camera import Camera, camera_from_dict, equidistant_camera, load_camera, pinhole_camera
from ursnav_torch.errors import InputError

K = (-0.031, 0.006, -0.0021, 0.0003)
FISHEYE = Camera("equidistant", 250, 240, 88.0, 91.0, 121.3, 124.7, K, 160.0)
PINHOLE = Camera("pinhole", 250, 240, 120.0, 125.0, 121.3, 124.7)


def points_within(half_angle_deg: float, n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(0)
    theta, phi = np.radians(half_angle_deg) * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    ray = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    return ray * rng.uniform(0.5, 40, (n, 1))


def matrix(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def test_fisheye_agrees_with_opencv() -> None:
    points = points_within(80)
    theirs, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), matrix(FISHEYE), np.array(FISHEYE.k)
    )
    ours, inside = FISHEYE.project(points)
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-6)
    assert inside.mean() > 0.8
    back = cv2.fisheye.undistortPoints(
        theirs, matrix(FISHEYE), np.array(FISHEYE.k),
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12),
    )[:, 0]  # fmt: skip
    rays, _ = FISHEYE.rays(theirs[:, 0])
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], back, rtol=1e-5, atol=1e-6)


def test_pinhole_agrees_with_opencv() -> None:
    points = points_within(50)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(PINHOLE), None)
    ours, _ = PINHOLE.project(points)
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-9)
    behind, inside = PINHOLE.project(-points)
    assert not inside.any() and np.isfinite(behind).all()


@given(st.floats(-0.5, 249.5), st.floats(-0.5, 239.5))
@settings(max_examples=60, deadline=None)
def test_pixels_and_rays_are_inverse(u: float, v: float) -> None:
    for camera in (FISHEYE, PINHOLE, equidistant_camera(220, 250, 240)):
        ray, inside = camera.rays([u, v])
        pixel, seen = camera.project(7.0 * ray)
        np.testing.assert_allclose(np.linalg.norm(ray), 1)
        if inside:
            np.testing.assert_allclose(pixel, [u, v], atol=1e-6)
            assert seen or min(u + 0.5, v + 0.5, 249.5 - u, 239.5 - v) < 1e-6 or camera.fov_deg is not None


@pytest.mark.parametrize(
    "camera",
    [
        FISHEYE,
        PINHOLE,
        Camera("rational", 250, 240, 120.0, 125.0, 121.3, 124.7, (-0.1, 0.02, 1e-3, -2e-3, 0.0, 0.0, 0.0, 0.0)),
        Camera("double_sphere", 250, 240, 88.0, 91.0, 121.3, 124.7, (-0.2, 0.55)),
    ],
    ids=lambda camera: camera.model,
)
def test_pixels_in_single_precision_are_those_of_project(camera: Camera) -> None:
    points = points_within(60)
    found = camera.pixels(np.ascontiguousarray(points.T, np.float32))
    assert found.dtype == np.float32 and found.flags.c_contiguous
    np.testing.assert_allclose(found.T, camera.project(points)[0], atol=2e-3)
    assert camera.pixels(np.zeros((3, 0), np.float32)).shape == (2, 0)


def test_convention_pixel_centers_are_whole_numbers_and_y_is_down() -> None:
    camera = equidistant_camera(90, 101, 51)
    ray, _ = camera.rays([50, 25])
    np.testing.assert_allclose(ray, [0, 0, 1])
    for pixel, axis in (([60, 25], 0), ([50, 35], 1)):
        assert camera.rays(pixel)[0][axis] > 0
    rays, mask = camera.pixel_rays()
    np.testing.assert_allclose(rays[0, 0], camera.rays([0, 0])[0])
    assert rays.shape == (51, 101, 3) and mask.shape == (51, 101)


@pytest.mark.parametrize("fov", [90.0, 160.0, 200.0])
def test_field_of_view_spans_the_width(fov: float) -> None:
    """The outermost ray hits the outer border of the outermost pixel, half a pixel beyond its center."""
    camera = equidistant_camera(fov, 250, 250)
    half = np.radians(fov) / 2
    pixel, _ = camera.project([np.sin(half), 0, np.cos(half)])
    np.testing.assert_allclose(pixel, [249.5, 124.5])
    mask = camera.pixel_rays()[1]
    assert not mask[0, 0] and mask[125, 0] and mask[0, 125]
    assert abs(mask.mean() - np.pi / 4) < 0.01


def test_across_the_diagonal() -> None:
    camera = pinhole_camera(90, 300, 400, across="diagonal")
    pixel, _ = camera.project([3, 4, 5])  # 45 degrees along the diagonal
    np.testing.assert_allclose(pixel, [299.5, 399.5])
    with pytest.raises(InputError, match="diagonal"):
        pinhole_camera(90, across="height")


def test_fisheye_sees_behind_itself_only_within_its_field() -> None:
    camera = equidistant_camera(220, 250, 250)
    pixel, inside = camera.project([[0, 5, -0.5], [0, 5, -5], [0, 0, -1]])
    assert inside.tolist() == [True, False, False] and np.isfinite(pixel).all()
    np.testing.assert_allclose(camera.project([0, 0, 3])[0], [124.5, 124.5])


def test_resizing_keeps_what_a_pixel_covers() -> None:
    """Halved, each pixel covers two by two of the old: new (0, 0) lies where (0.5, 0.5) was."""
    half = FISHEYE.resized(125, 120)
    np.testing.assert_allclose(half.rays([0, 0])[0], FISHEYE.rays([0.5, 0.5])[0], atol=1e-9)
    np.testing.assert_allclose(half.rays([60, 70])[0], FISHEYE.rays([120.5, 140.5])[0], atol=1e-9)
    assert (half.resized(250, 240)).same_lens(FISHEYE)


def test_the_same_lens_is_told_by_where_it_puts_rays() -> None:
    same = Camera("equidistant", 250, 240, 88.2, 91.0, 121.5, 124.7, K)
    assert FISHEYE.same_lens(same)
    for other in (
        FISHEYE.resized(500, 480), Camera("equidistant", 250, 240, 88.0, 91.0, 121.3, 124.7),
        Camera("equidistant", 250, 240, 84.0, 91.0, 121.3, 124.7, K), PINHOLE,
    ):  # fmt: skip
        assert not FISHEYE.same_lens(other)


def test_json_round_trips_and_passes_further_keys_over(tmp_path: Path) -> None:
    for camera in (FISHEYE, PINHOLE):
        path = tmp_path / "lens.json"
        path.write_text(json.dumps(camera.to_dict() | {"serial": 7, "rms_px": 0.1}))
        assert load_camera(path) == camera
    plain = {k: v for k, v in PINHOLE.to_dict().items() if k != "k"}
    assert camera_from_dict(plain | {"k": None}, "x") == PINHOLE
    assert camera_from_dict(plain | {"width": float(PINHOLE.width)}, "x") == PINHOLE


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "not readable JSON"),
        ("[1, 2]", "does not hold a camera"),
        ('{"model": "pinhole", "width": 10}', "lacks height, fx"),
        (json.dumps(FISHEYE.to_dict() | {"model": "division"}), "Unknown lens model 'division'"),
        (
            json.dumps(FISHEYE.to_dict() | {"fx": "wide"}),
            r"lens.json cannot be used: Expected `float`, got `str` - at `\$.fx`",
        ),
        (json.dumps(FISHEYE.to_dict() | {"fx": -88}), "fy > 0"),
        (json.dumps(FISHEYE.to_dict() | {"fx": float("nan")}), "not readable JSON"),
        (json.dumps(FISHEYE.to_dict() | {"width": 1e400}), "not readable JSON"),
        (json.dumps(FISHEYE.to_dict() | {"k": [0.1, 0.2]}), "takes 4 coefficients k"),
        (json.dumps(FISHEYE.to_dict() | {"width": 1}), "at least 8 x 8"),
        (json.dumps(FISHEYE.to_dict() | {"fov_deg": 400}), "between 0 and 360"),
        (json.dumps(FISHEYE.to_dict() | {"model": "pinhole"}), "pinhole lens takes no k"),
    ],
)
def test_refuses_camera_files_that_are_none(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "lens.json"
    path.write_text(text)
    with pytest.raises(InputError, match=match):
        load_camera(path)


def test_refuses_what_cannot_be() -> None:
    with pytest.raises(InputError, match="There is no camera file"):
        load_camera("nowhere.json")
    with pytest.raises(InputError, match="camera=equidistant"):
        pinhole_camera(180)
