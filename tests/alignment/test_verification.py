"""Verification: the maps say how a picture and a drawing agree, and the network ranks hypotheses by them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from ursnav_torch.alignment import RefinementSettings, Refiner
from ursnav_torch.alignment import refine as refine_module
from ursnav_torch.alignment.align import Aligned
from ursnav_torch.alignment.light import AT_CAMERA
from ursnav_torch.alignment.verification import (
    MAPS,
    Drawn,
    ReadPicture,
    VerificationNetwork,
    Verifier,
    comparison_maps,
    packaged_verification,
    seen_on,
)
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import Features
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid

SIZE = 24
PRODUCTS, OFF, COUNTS, JUT = (10, 11), 9, 5, 8


@pytest.fixture(scope="module")
def fine(vid: Vid) -> Vid:
    """The small VID through a lens of 250 px."""
    return replace(vid, camera=equidistant_camera(160.0, 250, 250))


@pytest.fixture(scope="module")
def seen(fine: Vid, phantom: Kidney) -> Features:
    """A picture from the fourth view, read by the wall network."""
    return fine.extractor().extract(RaycastRenderer(phantom.mesh, fine.camera).render(fine.T_kidney_camera[3]).image)


def made_up(seed: int = 0) -> tuple[ReadPicture, Drawn, torch.Tensor]:
    """Smooth random maps of a picture and of three drawings, the first drawn as the picture is."""
    rng = np.random.default_rng(seed)
    relief, depth = (torch.nn.functional.interpolate(
        torch.from_numpy(rng.normal(size=(1, 3, 6, 6)).astype(np.float32)), (SIZE, SIZE), mode="bicubic"
    )[0] for _ in range(2))  # fmt: skip
    read = torch.stack([relief[0], torch.zeros(SIZE, SIZE), depth[0], torch.zeros(SIZE, SIZE), torch.ones(SIZE, SIZE)])
    compared = torch.ones(SIZE, SIZE, dtype=torch.bool)
    compared[:2] = False
    return ReadPicture(relief[0], read, torch.ones(SIZE, SIZE)), Drawn(relief, (depth + 2).exp()), compared


def test_a_drawing_that_is_the_picture_agrees_everywhere() -> None:
    maps = comparison_maps(*made_up())
    assert maps.shape == (3, MAPS, SIZE, SIZE)
    product, off = maps[:, PRODUCTS].mean((1, 2, 3)), maps[:, OFF].abs().mean((1, 2))
    assert product[0] > 2 * product[1:].max() and off[0] < 1e-4 < 0.1 < off[1:].min()


def test_what_is_not_compared_or_not_wall_counts_nothing() -> None:
    seen, drawn, compared = made_up()
    assert (comparison_maps(seen, drawn, compared)[:, COUNTS, :2] == 0).all()
    read = seen.read.clone()
    read[4, 10:14] = 0.0  # a stone
    maps = comparison_maps(replace(seen, read=read), drawn, compared)
    assert (maps[:, COUNTS, 10:14] == 0).all() and (maps[:, COUNTS, 4:8] == 1).all()


def test_depth_counts_up_to_a_factor_and_a_hole_is_no_wall() -> None:
    seen, drawn, compared = made_up()
    maps = comparison_maps(seen, drawn, compared)
    larger = comparison_maps(seen, Drawn(drawn.relief, 3 * drawn.distance), compared)
    inside = (slice(None), slice(None), slice(4, None))  # slopes at the border of what is compared are the mask's
    torch.testing.assert_close(maps[inside], larger[inside], atol=1e-3, rtol=1e-3)
    hole = drawn.distance.clone()
    hole[:, 5, 5] = torch.inf
    assert torch.isfinite(comparison_maps(seen, Drawn(drawn.relief, hole), compared)).all()


def test_a_step_in_depth_juts_out() -> None:
    seen, drawn, compared = made_up()
    step = torch.ones(1, SIZE, SIZE)
    step[..., SIZE // 2 :] = 4.0
    jut = comparison_maps(seen, Drawn(drawn.relief[:1], step), compared)[0, JUT, 10]
    assert jut[SIZE // 2 - 1] > 1.0 and jut[:8].max() == 0


def test_before_it_learns_the_network_goes_by_the_score() -> None:
    network, maps = VerificationNetwork().eval(), comparison_maps(*made_up())
    with torch.inference_mode():
        odds = network(maps, torch.tensor([0.4, 0.5, 0.45]))
    torch.testing.assert_close(odds, 20 * torch.tensor([0.4, 0.5, 0.45]))


def test_the_packaged_network_prefers_the_true_pose_to_one_that_scores_better(fine: Vid, seen: Features) -> None:
    verifier = Verifier(Refiner(fine).finest, fine.kidney.scale)
    views = [3, 15, 30, 45, 60]
    hypotheses = [Aligned(fine.T_kidney_camera[i], AT_CAMERA, 0.60 if i == 3 else 0.65, 1) for i in views]
    odds = verifier.log_odds(seen, hypotheses)
    assert odds.shape == (5,) and odds.argmax() == 0 and odds[0] > odds[1:].max() + 1.0
    assert packaged_verification() is packaged_verification() and not packaged_verification().training


def test_scale_does_not_matter(fine: Vid, seen: Features) -> None:
    finest = Refiner(fine).finest
    hypotheses = [Aligned(fine.T_kidney_camera[i], AT_CAMERA, 0.6, 1) for i in (3, 30)]
    one, two = (Verifier(finest, unit).drawn(hypotheses) for unit in (1.0, 2.0))
    torch.testing.assert_close(one.distance, 2 * two.distance)
    assert seen_on(finest.grid, seen).read.shape == (5, *finest.grid.compared.shape)


def test_refinement_follows_the_verifier_and_says_so(
    fine: Vid, seen: Features, monkeypatch: pytest.MonkeyPatch
) -> None:
    def prefers(which: int) -> Callable[..., np.ndarray]:
        def log_odds(_: Verifier, __: Features, hypotheses: list[Aligned]) -> np.ndarray:
            off = [np.linalg.norm(h.T_kidney_camera[:3, 3] - fine.T_kidney_camera[which, :3, 3]) for h in hypotheses]
            return -10.0 * np.array(off)

        return log_odds

    refiner, candidates = Refiner(fine), [fine.T_kidney_camera[i] for i in (30, 60, 3)]  # the best score last
    for which, row in ((3, 2), (60, 1)):
        monkeypatch.setattr(refine_module.Verifier, "log_odds", prefers(which))
        found = refiner.refine(seen, candidates)
        assert found.verified and found.hypothesis == row and len(found.tried_log_odds) == 3
        nearest = np.linalg.norm(found.tried[:, :3, 3] - fine.T_kidney_camera[which, :3, 3], axis=1).argmin()
        assert found.tried_log_odds.argmax() == nearest  # they stand beside the poses that they are of


def test_without_a_reading_or_a_wish_the_score_decides(fine: Vid, seen: Features) -> None:
    candidates = [fine.T_kidney_camera[i] for i in (30, 3)]
    unread = replace(seen, read=torch.zeros(0, 0, 0))
    for found in (
        Refiner(fine).refine(unread, candidates),
        Refiner(fine, RefinementSettings(verify=False)).refine(seen, candidates),
    ):
        assert not found.verified and found.hypothesis == 1 and (found.tried_log_odds == 0).all()
