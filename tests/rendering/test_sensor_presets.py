"""Presets stay inside their spans, the dial runs from clean to worst, pictures without a calyx are what they say."""

import numpy as np
import pytest
import trimesh

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import (
    NO_CALYX_KINDS,
    PRESETS,
    SensorFaults,
    in_vivo_like,
    none_pictures,
    pressed_pose,
    severity,
    simulate,
    thesis_phantom,
    thesis_simulation,
)
from ursnav_torch.rendering.sensor.presets import Span

CAMERA = equidistant_camera(160, 100, 100)


@pytest.fixture(scope="module")
def renderer(lumen: trimesh.Trimesh) -> RaycastRenderer:
    return RaycastRenderer(lumen, CAMERA)


def value(faults: SensorFaults, name: str) -> float:
    group, setting = name.split(".")
    return getattr(getattr(faults, group), setting)


@pytest.mark.parametrize("draw", [thesis_simulation, thesis_phantom, in_vivo_like])
def test_draws_lie_in_the_preset_s_spans_and_differ(draw: object) -> None:
    preset = PRESETS[draw.__name__]
    rng = np.random.default_rng(0)
    drawn = [draw(rng) for _ in range(200)]
    assert len(set(drawn)) == 200
    for name, span in preset.items():
        if isinstance(span, Span):
            values = np.array([value(f, name) for f in drawn], float)
            clean = float(value(SensorFaults(), name))
            inside = (values >= span.low - 1e-9) & (values <= span.high + 1e-9)
            assert np.all(inside | (values == clean)), name
            if span.share < 1:
                assert (values != clean).mean() == pytest.approx(span.share, abs=0.15), name


def test_same_seed_draws_the_same_faults() -> None:
    assert in_vivo_like(np.random.default_rng(4)) == in_vivo_like(np.random.default_rng(4))


@pytest.mark.parametrize("preset", list(PRESETS))
def test_severity_zero_is_the_clean_picture(preset: str, renderer: RaycastRenderer, poses: np.ndarray) -> None:
    faults = severity(preset, 0, np.random.default_rng(3))
    picture = simulate(renderer, poses[0], faults, np.random.default_rng(3))
    clean = simulate(renderer, poses[0], SensorFaults(), np.random.default_rng(3))
    np.testing.assert_allclose(picture.astype(int), clean.astype(int), atol=1)


def test_severity_grows_evenly_up_to_the_worst_end_of_the_span() -> None:
    half, full = (severity("thesis_phantom", s, np.random.default_rng(5)) for s in (0.5, 1.0))
    for name in ("optics.defocus_px", "optics.stripes", "electronics.read_noise", "light.gloss"):
        assert value(full, name) == PRESETS["thesis_phantom"][name].high
        assert value(half, name) == pytest.approx(value(full, name) / 2)
    assert full.electronics.jpeg_quality == PRESETS["thesis_phantom"]["electronics.jpeg_quality"].low


@pytest.mark.parametrize("preset", list(PRESETS))
def test_pictures_get_farther_from_the_clean_one(preset: str, renderer: RaycastRenderer, poses: np.ndarray) -> None:
    def strayed(s: float) -> float:
        likeness = []
        for seed in range(6):
            rng = np.random.default_rng(seed)
            picture = simulate(renderer, poses[0], severity(preset, s, rng), rng)
            clean = simulate(renderer, poses[0], SensorFaults(), rng)
            mask = CAMERA.pixel_rays()[1]
            likeness.append(np.corrcoef(picture.mean(axis=2)[mask], clean.mean(axis=2)[mask])[0, 1])
        return 1 - float(np.mean(likeness))

    assert strayed(0) < 0.01 < strayed(0.5) < strayed(1)


def test_unknown_preset_and_severity_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="Unknown preset 'vivo'; known are thesis_simulation"):
        severity("vivo", 0.5, rng)
    with pytest.raises(InputError, match=r"s=1\.5 must lie in 0\.\.1"):
        severity("in_vivo_like", 1.5, rng)


def test_pictures_without_a_calyx_take_turns_and_are_what_they_say(
    renderer: RaycastRenderer, poses: np.ndarray
) -> None:
    pictures = none_pictures(np.random.default_rng(0), 4 * len(NO_CALYX_KINDS), renderer, poses)
    assert [kind for _, kind in pictures[: len(NO_CALYX_KINDS)]] == list(NO_CALYX_KINDS)
    mask = CAMERA.pixel_rays()[1]
    for picture, kind in pictures:
        assert picture.shape == (100, 100, 3) and picture.dtype == np.uint8
        if kind == "dark":
            assert np.median(picture[mask]) < 40
        if kind == "white-out":
            assert np.median(picture[mask]) > 120
        if kind == "noise":
            assert picture[mask].std() > 15


def test_pressed_pose_is_near_the_wall_and_sees_little_else(renderer: RaycastRenderer, poses: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        depth = renderer.render(pressed_pose(renderer, poses, rng)).depth_mm
        assert np.nanmin(depth) < 1.3
        assert np.nanpercentile(depth, 80) < 4


def test_unknown_kind_and_missing_poses_are_refused(renderer: RaycastRenderer, poses: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="kinds out of wall, white-out"):
        none_pictures(rng, 1, renderer, poses, ["fog"])
    with pytest.raises(InputError, match="from 0 poses"):
        none_pictures(rng, 1, renderer, poses[:0])
    outside = poses + 0.0
    outside[:, :3, 3] += 500
    outside[:, :3, :3] = np.eye(3)
    with pytest.raises(InputError, match="give poses inside the lumen"):
        pressed_pose(renderer, outside, rng)
