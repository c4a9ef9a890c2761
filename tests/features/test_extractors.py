"""What holds for every extractor: where points are, what is never an edge, what is refused."""

import cv2
import numpy as np
import pytest
import torch
from kornia.geometry.transform import resize

from ursnav_torch.camera import Camera, equidistant_camera, pinhole_camera
from ursnav_torch.errors import FeatureError, InputError
from ursnav_torch.features import (
    DefaultSettings,
    RimSettings,
    Settings,
    ThesisSettings,
    make_extractor,
    settings_from_dict,
    settings_to_dict,
)
from ursnav_torch.features.default import _shrinking

BOTH = pytest.mark.parametrize("settings", [DefaultSettings(), ThesisSettings()], ids=["default", "thesis"])
EVERY = pytest.mark.parametrize(
    "settings", [DefaultSettings(), RimSettings(), ThesisSettings()], ids=["default", "rims", "thesis"]
)
LENS = equidistant_camera(160.0, 250, 250)


def disk(
    camera: Camera, center: tuple[float, float], radius: float, inside: int = 190, outside: int = 70
) -> np.ndarray:
    """A bright disk on gray, edges anti-aliased, black outside the image circle."""
    v, u = np.mgrid[: camera.height, : camera.width]
    share = np.clip(radius + 0.5 - np.hypot(u - center[0], v - center[1]), 0, 1)
    image = (outside + (inside - outside) * share).round().astype(np.uint8)
    image[~camera.pixel_rays()[1]] = 0
    return image


@BOTH
def test_convention_points_are_pixel_centers_of_the_whole_picture(settings: Settings) -> None:
    """Also where the extractor works on a smaller picture: a disk's edge lies where it was drawn, on average.

    Drawn pictures: in flat gray the thesis's stripe removal and equalization make bands of nothing.
    """
    features = make_extractor(settings, LENS).extract(disk(LENS, (141.0, 112.0), 45.0), virtual=True)
    points = features.edges.points.numpy()
    distance = np.hypot(*(points - [141.0, 112.0]).T)
    on = np.abs(distance - 45) < 8
    assert on.mean() > 0.7, "most points are the disk's"
    assert np.abs(np.median(distance[on]) - 45) < 1.5
    center = cv2.fitEllipse(points[on].astype(np.float32))[0]
    np.testing.assert_allclose(center, [141.0, 112.0], atol=0.8)
    assert features.edge_image.dtype == bool


@BOTH
def test_directions_run_along_the_edge(settings: Settings) -> None:
    features = make_extractor(settings, LENS).extract(disk(LENS, (124.5, 124.5), 60.0), virtual=True)
    edges = features.edges
    out = edges.points.numpy() - 124.5
    on = np.abs(np.hypot(*out.T) - 60) < 6
    along = np.arctan2(out[:, 1], out[:, 0]) + np.pi / 2
    off = np.angle(np.exp(2j * (edges.direction.numpy() - along))) / 2
    assert np.degrees(np.median(np.abs(off[on]))) < 6
    assert ((edges.direction >= 0) & (edges.direction < np.pi + 1e-6)).all()
    assert ((edges.weight >= 0) & (edges.weight <= 1)).all()


@EVERY
@pytest.mark.parametrize("level", [60, 200])
def test_the_round_rim_is_never_an_edge(settings: Settings, level: int) -> None:
    image = disk(LENS, (124.5, 124.5), 30.0, 255 - level, level)
    edges = make_extractor(settings, LENS).extract(image).edges
    assert np.hypot(*(edges.points.numpy() - 124.5).T).max() < 125 - 4


@EVERY
def test_the_border_of_a_full_picture_is_never_an_edge(settings: Settings) -> None:
    lens = pinhole_camera(90, 250, 200)
    points = make_extractor(settings, lens).extract(disk(lens, (120.0, 90.0), 50.0)).edges.points.numpy()
    assert points.min() > 1 and points[:, 0].max() < 248 and points[:, 1].max() < 198


@EVERY
@pytest.mark.parametrize(("level", "name"), [(0, "black"), (255, "white"), (128, "one gray")])
def test_blank_pictures_are_told_so(settings: Settings, level: int, name: str) -> None:
    image = np.full((250, 250), level, np.uint8)
    with pytest.raises(FeatureError, match=f"all {name}"):
        make_extractor(settings, LENS).extract(image)
    with pytest.raises(FeatureError, match=f"all {name}"):
        make_extractor(settings, LENS).extract(np.dstack([image] * 3))


@EVERY
def test_at_most_as_many_points_as_asked_for_and_no_fewer_than_needed(settings: Settings) -> None:
    from dataclasses import replace

    image = disk(LENS, (124.5, 124.5), 60.0)
    few = make_extractor(replace(settings, points=30), LENS).extract(image)
    assert len(few.edges) == 30 == len(few.edges.weight) == len(few.edges.direction)
    with pytest.raises(FeatureError, match=r"edge points; at least 9000 are needed"):
        make_extractor(replace(settings, points=9000, min_points=9000), LENS).extract(image)


@EVERY
def test_pictures_of_another_size_are_refused(settings: Settings) -> None:
    for shape in ((1, 1), (250, 251), (500, 500, 3)):
        with pytest.raises(InputError, match="but the lens is 250 x 250"):
            make_extractor(settings, LENS).extract(np.zeros(shape, np.uint8))


@EVERY
def test_gray_and_colored_gray_are_the_same(settings: Settings) -> None:
    image = disk(LENS, (150.0, 120.0), 50.0)
    a, b = (make_extractor(settings, LENS).extract(x).edges.points for x in (image, np.dstack([image] * 3)))
    assert len(a) == len(b) and (a - b).norm(dim=1).median() < 1e-3


@EVERY
def test_the_same_picture_gives_the_same_bits(settings: Settings) -> None:
    lens = LENS.resized(125, 125)
    extractor = make_extractor(settings, lens)
    picture = disk(lens, (60.0, 70.0), 30.0)
    striped = (picture * 0.8 + 25 + 12 * np.sin(np.arange(125) * 1.9)[:, None]).astype(np.uint8)
    for image in (picture, striped):
        first, keep = extractor.extract(image), []
        for i in range(20):
            keep.append(torch.empty(1000 + 37 * i))  # memory elsewhere must not change the last bit
            again = extractor.extract(image)
            assert torch.equal(first.edges.points, again.edges.points) and torch.equal(first.maps, again.maps)


@EVERY
def test_settings_survive_as_plain_data(settings: Settings) -> None:
    data = settings_to_dict(settings)
    assert settings_from_dict(data) == settings and isinstance(data["kind"], str)
    with pytest.raises(InputError, match="Unknown kind of features 'sift'"):
        settings_from_dict(data | {"kind": "sift"})
    with pytest.raises(InputError, match=r"sparkle; known are points"):
        settings_from_dict(data | {"sparkle": 1})


def test_exposure_does_not_move_the_default_edges(picture: np.ndarray, lens: Camera) -> None:
    """Half the light and another gamma: nearly the same points and maps."""
    extractor = make_extractor(DefaultSettings(), lens)
    bright = extractor.extract(picture)
    dark = extractor.extract((255 * (picture / 255) ** 1.3 * 0.6).astype(np.uint8))
    near = torch.cdist(dark.edges.points, bright.edges.points).min(1).values
    assert (near < 3).float().mean() > 0.8
    assert (bright.maps * dark.maps).sum((1, 2))[0] > 0.85


def test_convention_a_quarter_turn_of_the_picture_shifts_the_maps_by_a_quarter() -> None:
    """np.rot90(k=-1) turns the picture clockwise as seen, x towards y: what was at angle a is at a + 90 degrees."""
    v, u = np.mgrid[:250, :250]
    image = disk(LENS, (160.0, 110.0), 40.0).astype(float) + 25 * np.sin(u / 9 + v / 23) * LENS.pixel_rays()[1]
    image = image.clip(0, 255).astype(np.uint8)
    extractor = make_extractor(DefaultSettings(), LENS)
    straight, turned = extractor.extract(image), extractor.extract(np.rot90(image, -1).copy())
    quarter = straight.maps.shape[-1] // 4
    shifted = straight.maps.roll(quarter, dims=-1)
    similarity = (shifted * turned.maps).flatten(1).sum(1) / (straight.maps**2).flatten(1).sum(1)
    assert similarity.min() > 0.97
    assert ((straight.maps * turned.maps).sum() / (straight.maps**2).sum()) < 0.6


def test_without_edges_maps_are_the_same_and_a_picture_with_few_is_not_refused() -> None:
    picture = disk(LENS, (141.0, 112.0), 45.0)
    extractor = make_extractor(DefaultSettings(), LENS)
    whole, plain = extractor.extract(picture), extractor.extract(picture, edges=False)  # type: ignore[call-arg]
    torch.testing.assert_close(plain.maps, whole.maps, rtol=0, atol=0)
    torch.testing.assert_close(plain.fields, whole.fields, rtol=0, atol=0)
    assert (plain.contrast, plain.grain) == (whole.contrast, whole.grain)
    assert len(whole.edges) and not len(plain.edges) and not plain.edge_image.any()
    strict = make_extractor(DefaultSettings(points=9000, min_points=9000), LENS)
    assert strict.extract(picture, edges=False).maps.numel()  # type: ignore[call-arg]


@pytest.mark.parametrize("size", [(125, 125), (100, 90), (125, 200)])
def test_a_picture_is_shrunk_as_kornia_does(size: tuple[int, int]) -> None:
    picture = torch.rand(250, 200, generator=torch.Generator().manual_seed(0))
    rows, columns = _shrinking(250, size[0]), _shrinking(200, size[1])
    expected = resize(picture[None, None], size, antialias=True)[0, 0]
    torch.testing.assert_close(rows @ picture @ columns.T, expected, atol=1e-5, rtol=0)
