"""What the scope adds to every picture, learned and taken out."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ursnav_torch.alignment import Refiner
from ursnav_torch.features import DefaultExtractor, DefaultSettings, Features
from ursnav_torch.geometry import transform_from
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.tracking.pattern import ScopePattern
from ursnav_torch.vid import Vid

HERE = np.eye(4)


def moved(mm: float, unit: float = 1.0) -> np.ndarray:
    return transform_from(np.eye(3), [0.0, 0.0, mm * unit])


@pytest.fixture(scope="module")
def extractor(vid: Vid) -> DefaultExtractor:
    assert isinstance(vid.settings, DefaultSettings)
    return DefaultExtractor(vid.settings, vid.camera)


def with_halo(image: np.ndarray) -> np.ndarray:
    """The picture through a lens with a bright spot at its upper right."""
    v, u = np.indices(image.shape) / np.array(image.shape)[:, None, None]
    spot = 90 * np.exp(-((u - 0.75) ** 2 + (v - 0.3) ** 2) / (2 * 0.08**2))
    return np.where(image > 0, np.clip(image + spot, 1, 255), 0).astype(np.uint8)


def test_a_halo_is_learned_from_other_views_and_taken_out_of_the_next(
    vid: Vid, renderer: RaycastRenderer, extractor: DefaultExtractor
) -> None:
    pattern = ScopePattern()
    clean = [extractor.extract(renderer.render(T).image) for T in vid.T_kidney_camera[:24]]
    seen = [extractor.extract(with_halo(renderer.render(T).image)) for T in vid.T_kidney_camera[:24]]
    for i in range(20):
        pattern.learn(seen[i], clean[i].fields[0].numpy(), vid.T_kidney_camera[i])
    left = [1 - likeness(pattern.removed(seen[i]), clean[i]) for i in range(20, 24)]
    before = [1 - likeness(seen[i], clean[i]) for i in range(20, 24)]
    assert np.mean(left) < 0.75 * np.mean(before)
    assert pattern.removed(seen[20]).edges is seen[20].edges


def likeness(a: Features, b: Features) -> float:
    """Correlation of two reliefs."""
    return float(torch.corrcoef(torch.stack([a.fields[0].flatten(), b.fields[0].flatten()]))[0, 1])


def test_the_first_picture_counts_as_one_of_five_and_old_ones_fade(
    extractor: DefaultExtractor, picture: np.ndarray
) -> None:
    """Against four pictures of no pattern: one picture's own relief is no pattern yet."""
    pattern, features = ScopePattern(), extractor.extract(picture)
    assert pattern.value() is None
    relief, flat = features.fields[0], np.zeros((40, 40), np.float32)
    pattern.learn(features, flat, HERE)
    torch.testing.assert_close(pattern.value(), relief / 5)
    for _ in range(400):
        pattern.learn(features, flat, HERE)
    torch.testing.assert_close(pattern.value(), relief * (1 / 0.03) / (1 / 0.03 + 4.0), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(pattern.removed(features).fields[0], relief - pattern.value())


def test_nothing_learned_nothing_removed(vid: Vid, picture: np.ndarray, extractor: DefaultExtractor) -> None:
    features = extractor.extract(picture)
    assert ScopePattern().removed(features) is features


def test_maps_and_fields_follow_the_relief(picture: np.ndarray, extractor: DefaultExtractor) -> None:
    features = extractor.extract(picture)
    same = extractor.with_relief(features, features.fields[0])
    torch.testing.assert_close(same.fields, features.fields)
    torch.testing.assert_close(same.maps, features.maps)


def test_only_well_aligned_pictures_from_new_places_teach(extractor: DefaultExtractor, picture: np.ndarray) -> None:
    pattern, features = ScopePattern(unit_mm=2.0), extractor.extract(picture)
    assert pattern.tells(HERE, 0.8) and not pattern.tells(HERE, 0.4)
    pattern.learn(features, features.fields[0].numpy(), HERE)
    assert not pattern.tells(HERE, 0.8)
    assert not pattern.tells(moved(1.5), 0.8)  # 1 mm of anatomy is 2 mm at this scale
    assert pattern.tells(moved(2.5), 0.8) and not pattern.tells(moved(2.5), 0.4)


def test_a_refined_pose_is_scored_as_it_was_refined(vid: Vid, picture: np.ndarray, extractor: DefaultExtractor) -> None:
    refiner, features = Refiner(vid), extractor.extract(picture)
    found = refiner.refine(features, [vid.T_kidney_camera[3]])
    assert refiner.score(features, found) == pytest.approx(found.score, abs=0.02)
    drawn, own = refiner.relief(found), features.fields[:1]
    size = torch.nn.functional.interpolate(own[None], drawn.shape, mode="bilinear", antialias=True)[0, 0]
    assert np.corrcoef(size.flatten(), drawn.flatten())[0, 1] > 0.9


def test_what_lies_before_the_wall_teaches_nothing(picture: np.ndarray, extractor: DefaultExtractor) -> None:
    features = extractor.extract(picture)
    valid = torch.ones_like(features.fields[0])
    valid[:20] = 0
    pattern = ScopePattern()
    pattern.learn(replace(features, valid=valid), np.zeros((40, 40), np.float32), HERE)
    assert float(pattern.value()[:20].abs().max()) == 0
    torch.testing.assert_close(pattern.value()[20:], features.fields[0][20:] / 5)
