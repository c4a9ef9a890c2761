"""Each fault does what its setting says, and nothing where it is clean."""

import cv2
import numpy as np
import pytest
import trimesh

from ursnav_torch.camera import Camera, equidistant_camera, pinhole_camera
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import transform_from
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.rendering.sensor import (
    ElectronicsFaults,
    LightFaults,
    OccluderFaults,
    OpticsFaults,
    SensorFaults,
    WallFaults,
    simulate,
    simulate_view,
)
from ursnav_torch.rendering.sensor.electronics import digitize
from ursnav_torch.rendering.sensor.light import lamp_place, shade
from ursnav_torch.rendering.sensor.noise import fractal_noise, noise_and_slope, solid_noise
from ursnav_torch.rendering.sensor.optics import through_lens
from ursnav_torch.rendering.sensor.surface import Surface, lens_rays, surface_of
from ursnav_torch.rendering.sensor.wall import paint

CAMERA = equidistant_camera(160, 120, 120)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def renderer(lumen: trimesh.Trimesh) -> RaycastRenderer:
    return RaycastRenderer(lumen, CAMERA)


@pytest.fixture(scope="module")
def round_room() -> RaycastRenderer:
    return RaycastRenderer(trimesh.creation.icosphere(subdivisions=4, radius=6), CAMERA)


def gray(picture: np.ndarray) -> np.ndarray:
    return picture.astype(float).mean(axis=2)


def test_clean_picture_is_the_renderer_s_own(renderer: RaycastRenderer, poses: np.ndarray) -> None:
    light = HeadLight()
    clean = LightFaults(reach_mm=light.reach_mm, ambient=light.ambient, gamma=light.gamma)
    for T in poses:
        picture = simulate(renderer, T, SensorFaults(light=clean), rng())
        np.testing.assert_allclose(gray(picture), renderer.render(T).image, atol=1.01)


def test_same_seed_same_picture_and_another_seed_another(renderer: RaycastRenderer, poses: np.ndarray) -> None:
    faults = SensorFaults(
        electronics=ElectronicsFaults(read_noise=5.0), occluders=OccluderFaults(debris=5, bubbles=3),
        optics=OpticsFaults(stripes=5.0), wall=WallFaults(mottle=0.3, vessels=0.5, relief_mm=0.1),
    )  # fmt: skip
    a, b, c = (simulate(renderer, poses[0], faults, rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.any(a != c)


@pytest.mark.parametrize(
    ("group", "values"),
    [(OpticsFaults, {"defocus_px": 40.0}), (WallFaults, {"vessels": -0.1}), (LightFaults, {"offset_mm": 9.0}),
     (OccluderFaults, {"debris": 4000}), (ElectronicsFaults, {"jpeg_quality": 0}), (LightFaults, {"gloss": np.nan})],
)  # fmt: skip
def test_a_setting_out_of_range_is_refused_with_its_range(group: type, values: dict[str, float]) -> None:
    with pytest.raises(InputError, match=rf"{next(iter(values))}=.* must lie in .* \.\. "):
        group(**values)


def test_texture_stays_on_the_wall_when_the_camera_turns(renderer: RaycastRenderer, poses: np.ndarray) -> None:
    faults = WallFaults(seed=3, mottle=0.4, relief_mm=0.2, vessels=0.7, redness=0.3, seam=0.5)
    surface = surface_of(renderer.render(poses[0]), CAMERA, poses[0])
    turn = transform_from(cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0], [0, 0, 0])[:3, :3].astype(np.float32)
    turned = Surface(
        surface.pixels, surface.rays @ turn, surface.distance_mm, surface.normals @ turn, surface.points_kidney,
        surface.R_kidney_camera @ turn,
    )  # fmt: skip
    a, b = paint(surface, faults), paint(turned, faults)
    np.testing.assert_allclose(a.color, b.color, atol=1e-6)
    np.testing.assert_allclose(a.normals @ turn, b.normals, atol=1e-4)
    assert a.color.std() > 0.03
    assert np.abs(a.normals - surface.normals).max() > 0.05


def test_seam_is_thin_and_there_wherever_the_kidney_lies() -> None:
    for origin in ([0, 0, 0], [-70, 266, -112]):
        points = (np.array(origin) + rng().uniform(-30, 30, (20000, 3))).astype(np.float32)
        zero = np.zeros_like(points)
        surface = Surface(np.arange(20000), zero, zero[:, 0], zero, points, np.eye(3, dtype=np.float32))
        dark = paint(surface, WallFaults(seed=2, seam=0.8, seam_width_mm=1.0)).color[:, 0] < 0.6
        assert 0.005 < dark.mean() < 0.05  # about 1 mm in 40 mm


def test_noise_has_unit_variance_and_its_slope_is_its_derivative() -> None:
    points = rng().uniform(-40, 40, (20000, 3)).astype(np.float32)
    for values in (solid_noise(points, 2.0, 5), fractal_noise(points, 2.0, 5)):
        assert abs(values.mean()) < 0.1
        assert values.std() == pytest.approx(1, abs=0.15)  # interpolation between cells takes some
    step = np.float32(0.2)
    value, slope = noise_and_slope(points, 4.0, 5)
    for axis in range(3):
        moved = points.copy()
        moved[:, axis] += step
        difference = (solid_noise(moved, 4.0, 5) - value) / step * 4.0
        assert np.corrcoef(difference, slope[:, axis])[0, 1] > 0.93  # interpolation is piecewise linear
        assert np.polyfit(slope[:, axis], difference, 1)[0] == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_light_beside_the_lens_brightens_its_side(round_room: RaycastRenderer, angle: float) -> None:
    picture = gray(
        simulate(round_room, np.eye(4), SensorFaults(light=LightFaults(offset_mm=2.5, angle_rad=angle)), rng())
    )
    v, u = np.indices(picture.shape) - (np.array(picture.shape)[:, None, None] - 1) / 2
    mask = picture > 0
    toward = (u * np.cos(angle) + v * np.sin(angle)) > 0
    assert picture[mask & toward].mean() > 1.1 * picture[mask & ~toward].mean()


def test_light_stays_in_the_passage_that_the_tip_is_in() -> None:
    passage = RaycastRenderer(trimesh.creation.cylinder(2.0, 40.0), equidistant_camera(160.0, 120, 120))
    lit = [
        gray(simulate(passage, np.eye(4), SensorFaults(light=LightFaults(offset_mm=mm)), rng()))
        for mm in (0.0, 1.4, 3.5)
    ]
    inside = lit[0] > 0
    np.testing.assert_allclose(lit[2], lit[1], atol=3)  # 0.7 of the passage's 2 mm
    assert (lit[2][inside] > 25).all()


def test_convention_radiance_falls_with_the_square_of_distance() -> None:
    z = np.array([4.0, 8.0], np.float32)
    ahead = np.tile(np.array([[0, 0, 1]], np.float32), (2, 1))
    surface = Surface(np.arange(2), ahead, z, -ahead, ahead * z[:, None], np.eye(3, dtype=np.float32))
    faults = LightFaults(reach_mm=0.0, ambient=0.0, gamma=1.0)
    values = shade(surface, paint(surface, WallFaults()), faults, lamp_place(surface, faults))[:, 0]
    assert values[0] / values[1] == pytest.approx(4, rel=1e-5)


def test_highlights_sit_where_the_wall_mirrors_the_light(round_room: RaycastRenderer) -> None:
    light = LightFaults(gloss=2.0, shininess=150.0)
    lit = gray(simulate(round_room, np.eye(4), SensorFaults(light=light), rng()))
    brightest = np.array(np.unravel_index(cv2.GaussianBlur(lit, (0, 0), 3).argmax(), lit.shape))
    view = round_room.render(np.eye(4))
    facing = -np.einsum("hwc,hwc->hw", lens_rays(CAMERA)[0], view.normals)
    assert facing[tuple(brightest)] > 0.99


def test_murky_water_takes_contrast_of_far_walls(renderer: RaycastRenderer, poses: np.ndarray) -> None:
    def spread(turbidity: float) -> float:
        light = LightFaults(turbidity_per_mm=turbidity)
        picture = simulate(renderer, poses[0], SensorFaults(light=light), rng())
        inside = gray(picture)[lens_rays(CAMERA)[1]]
        return float(inside.std() / inside.mean())

    assert spread(0.1) < spread(0.03) < spread(0)


def test_blur_and_lens_error_take_nothing_from_the_black_outside() -> None:
    mask = lens_rays(CAMERA)[1]
    even = np.where(mask[..., None], np.float32(0.5), np.float32(0)) * np.ones(3, np.float32)
    for faults in (
        OpticsFaults(defocus_px=4), OpticsFaults(motion_px=20, motion_rad=0.7), OpticsFaults(lens_scale=-0.04),
        OpticsFaults(center_px=5, center_angle_rad=2.0), OpticsFaults(veil=0.7),
    ):  # fmt: skip
        np.testing.assert_allclose(through_lens(even, mask, CAMERA, faults, rng())[mask], 0.5, atol=5e-3)


@pytest.mark.parametrize("scale", [0.03, -0.03])
def test_lens_error_is_a_picture_through_the_other_lens(
    lumen: trimesh.Trimesh, poses: np.ndarray, scale: float
) -> None:
    camera = equidistant_camera(160, 240, 240)
    shift = np.array([1.5, -2.0]) * camera.width / 250
    other = Camera(
        "equidistant", 240, 240, camera.fx * (1 + scale), camera.fy * (1 + scale),
        camera.cx + shift[0], camera.cy + shift[1], fov_deg=200,
    )  # fmt: skip
    optics = OpticsFaults(lens_scale=scale, center_px=2.5, center_angle_rad=float(np.arctan2(shift[1], shift[0])))
    warped = simulate(RaycastRenderer(lumen, camera), poses[1], SensorFaults(optics=optics), rng())
    direct = simulate(RaycastRenderer(lumen, other), poses[1], SensorFaults(), rng())
    middle = np.hypot(*(np.indices((240, 240)) - 119.5)) < 100
    a, b = gray(warped)[middle], gray(direct)[middle]
    assert np.corrcoef(a, b)[0, 1] > 0.995  # exposure may differ: the rims differ
    assert np.median(np.abs(a - a.mean() / b.mean() * b)) < 1.5


def test_vignetting_leaves_the_center_and_takes_its_share_at_the_rim() -> None:
    mask = lens_rays(CAMERA)[1]
    white = np.ones((120, 120, 3), np.float32)
    picture = through_lens(white, mask, CAMERA, OpticsFaults(vignetting=0.6), rng())[..., 0]
    assert picture[60, 60] == pytest.approx(1, abs=1e-3)
    assert picture[mask].min() == pytest.approx(0.4, abs=0.01)


def test_stripes_have_their_period_and_amplitude() -> None:
    camera = equidistant_camera(160, 250, 250)
    mask = lens_rays(camera)[1]
    faults = OpticsFaults(stripes=10.0, stripe_period_px=10.0)
    picture = 255 * through_lens(np.zeros((250, 250, 3), np.float32), mask, camera, faults, rng())[..., 0]
    spectrum = np.abs(np.fft.rfft(picture[:, 125]))
    assert 250 / (spectrum[1:].argmax() + 1) == pytest.approx(10, rel=0.05)
    assert picture.std() * np.sqrt(2) == pytest.approx(10, rel=0.15)
    np.testing.assert_allclose(picture[:, 0], picture[:, 249], atol=1e-4)


def test_noise_has_the_deviation_that_the_settings_say() -> None:
    mask = np.ones((200, 200), bool)
    even = np.full((200, 200, 3), 0.5, np.float32)
    for faults, expected in [
        (ElectronicsFaults(read_noise=8.0), 8.0),
        (ElectronicsFaults(shot_noise=10.0), 10 * np.sqrt(0.5)),
        (ElectronicsFaults(read_noise=6.0, shot_noise=10.0), np.hypot(6, 10 * np.sqrt(0.5))),
    ]:
        picture = digitize(even, mask, faults, rng()).astype(float)
        assert picture.mean() == pytest.approx(127.5, abs=0.5)
        assert picture.std() == pytest.approx(expected, rel=0.05)
    rows = digitize(even, mask, ElectronicsFaults(row_noise=4.0), rng()).astype(float)
    assert rows.mean(axis=(1, 2)).std() == pytest.approx(4, rel=0.25)
    assert rows.std(axis=1).max() == 0


def test_bayer_pattern_keeps_colors_and_blurs_single_pixels() -> None:
    mask = np.ones((40, 40), bool)
    colored = np.tile(np.array([0.2, 0.4, 0.8], np.float32), (40, 40, 1))
    picture = digitize(colored, mask, ElectronicsFaults(bayer=True), rng())
    np.testing.assert_allclose(picture[5:-5, 5:-5].reshape(-1, 3), [[51, 102, 204]] * 900, atol=1)
    noisy = digitize(colored, mask, ElectronicsFaults(bayer=True, read_noise=10.0), rng())[5:-5, 5:-5, 1].astype(float)
    assert noisy.std() < 9  # half of the green values are means of four neighbors


def test_clipping_is_at_black_and_white() -> None:
    picture = np.array([[[-0.3, 0.5, 4.0]]], np.float32)
    np.testing.assert_array_equal(
        digitize(picture, np.ones((1, 1), bool), ElectronicsFaults(), rng()), [[[0, 128, 255]]]
    )


def test_jpeg_loses_more_at_lower_quality() -> None:
    mask = np.ones((64, 64), bool)
    picture = rng().uniform(0, 1, (64, 64, 3)).astype(np.float32)
    exact = digitize(picture, mask, ElectronicsFaults(), rng()).astype(float)
    loss = [np.abs(digitize(picture, mask, ElectronicsFaults(jpeg_quality=q), rng()) - exact).mean() for q in (40, 90)]
    assert loss[0] > loss[1] > 0


def test_fiber_comes_from_its_side_and_reaches_as_far_as_it_says(round_room: RaycastRenderer) -> None:
    clean = gray(simulate(round_room, np.eye(4), SensorFaults(), rng()))
    for reach in (0.4, 0.9):
        fiber = OccluderFaults(fiber=reach, fiber_angle_rad=np.pi / 2, fiber_bgr=(0.1, 0.05, 0.0))
        changed = np.abs(gray(simulate(round_room, np.eye(4), SensorFaults(occluders=fiber), rng())) - clean) > 8
        rows = np.flatnonzero(changed.any(axis=1))
        assert rows.max() >= 116  # +y is down
        assert rows.min() == pytest.approx(59.5 + 60 * (1 - reach), abs=2)
        assert np.abs(np.flatnonzero(changed.any(axis=0)) - 59.5).max() < 8


def test_occluders_change_about_the_area_they_cover(round_room: RaycastRenderer) -> None:
    clean = gray(simulate(round_room, np.eye(4), SensorFaults(), rng()))
    for faults, low, high in [
        (OccluderFaults(debris=10, debris_px=3.0), 0.001, 0.05),
        (OccluderFaults(bubbles=10, bubble_px=8.0), 0.005, 0.2),
        (OccluderFaults(stone=0.3), 0.02, 0.2),
        (OccluderFaults(blood=0.8), 0.3, 1.0),
    ]:
        picture = gray(simulate(round_room, np.eye(4), SensorFaults(occluders=faults), rng(1)))
        share = (np.abs(picture - clean) > 5)[lens_rays(CAMERA)[1]].mean()
        assert low < share < high, faults


@pytest.mark.parametrize("camera", [CAMERA, pinhole_camera(90, 64, 48), equidistant_camera(190, 90, 60)])
def test_picture_is_black_outside_and_only_outside_the_lens_circle(
    lumen: trimesh.Trimesh, poses: np.ndarray, camera: Camera
) -> None:
    optics = OpticsFaults(defocus_px=2.0, halo=0.4, stripes=9.0, vignetting=0.5, motion_px=5.0, veil=0.3)
    faults = SensorFaults(optics=optics, electronics=ElectronicsFaults(read_noise=2.0, bayer=True))
    renderer = RaycastRenderer(lumen, camera)
    picture = simulate_view(renderer.render(poses[0]), camera, poses[0], faults, rng())
    mask = camera.pixel_rays()[1]
    assert picture.shape == (camera.height, camera.width, 3)
    assert not picture[~mask].any()
    assert np.median(picture[mask]) > 20
