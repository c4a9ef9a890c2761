"""One alignment: how far one step gets, what does not count, and what holds the light."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.alignment import align
from ursnav_torch.alignment.align import Aligner, Water
from ursnav_torch.alignment.fields import AlignGrid, Fields
from ursnav_torch.alignment.gauss_newton import correlated, normal_equations, tukey
from ursnav_torch.alignment.light import AT_CAMERA
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import DefaultExtractor, DefaultSettings
from ursnav_torch.geometry import inverse, rotation_angle, transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer, RayScene
from ursnav_torch.vid import Vid

VIEWS = (3, 10, 20, 30, 44, 50, 57, 65)


@pytest.fixture(scope="module")
def aligner(phantom: Kidney) -> Aligner:
    grid = AlignGrid(equidistant_camera(160.0, 250, 250), 62, DefaultSettings())
    return Aligner(RayScene(phantom.mesh), grid, Water(spread=0.4, mm=10.0))


@pytest.fixture(scope="module")
def pairs(aligner: Aligner, phantom: Kidney, vid: Vid) -> list[tuple[Fields, np.ndarray, np.ndarray]]:
    """Pictures' fields, their true poses (4, 4), and starts half a millimeter and four degrees aside."""
    lens = equidistant_camera(160.0, 250, 250)
    renderer, extractor = RaycastRenderer(phantom.mesh, lens), DefaultExtractor(DefaultSettings(), lens)
    found = []
    for view in VIEWS:
        T, (shift, axis) = vid.T_kidney_camera[view], np.random.default_rng(view).standard_normal((2, 3))
        turn = Rotation.from_rotvec(np.radians(4.0) * axis / np.linalg.norm(axis)).as_matrix()
        start = T @ transform_from(turn, 0.5 * shift / np.linalg.norm(shift))
        found.append((aligner.grid.of_picture(extractor.extract(renderer.render(T).image, virtual=True)), T, start))
    return found


def off(T_a: np.ndarray, T_b: np.ndarray) -> tuple[float, float]:
    """How far a pose is from another, mm and degrees."""
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])), float(np.degrees(rotation_angle(T_a, T_b)))


def test_one_step_by_the_mean_of_both_slopes_gets_farther_than_by_either(aligner: Aligner, pairs) -> None:  # type: ignore[no-untyped-def]
    """Efficient second-order minimization; by the drawing's slopes alone 5.0 degrees are left, by the picture's 3.7."""
    left = [off(aligner.align(seen, start[None], iterations=1, light_known=True)[0].T_kidney_camera, T)
            for seen, T, start in pairs]  # fmt: skip
    mm, deg = np.mean(left, axis=0)
    assert mm < 0.36 and deg < 3.2


def test_more_steps_get_nearer_and_the_best_is_kept(aligner: Aligner, pairs) -> None:  # type: ignore[no-untyped-def]
    for seen, T, start in pairs:
        few, many = (aligner.align(seen, start[None], iterations=n, light_known=True)[0] for n in (1, 8))
        assert many.score >= few.score and few.iterations == 1 < many.iterations <= 8
        assert off(many.T_kidney_camera, T)[0] < 0.35


@pytest.mark.parametrize("light_known", [False, True])
def test_several_alignments_at_once_end_where_each_ends_alone(aligner: Aligner, pairs, light_known: bool) -> None:  # type: ignore[no-untyped-def]
    """One that sees nothing of the kidney among them, and one that ends at once."""
    seen, T, start = pairs[0]
    outside = T.copy()
    outside[:3, 3] += 500.0
    aside = [T @ transform_from(np.eye(3), np.array([x, 0.5, 0.0])) for x in (1.0, -1.0, 0.5, 0.7)]
    starts = np.stack([start, T, outside, pairs[1][2], *aside])
    lights = AT_CAMERA + 0.1 * np.arange(len(starts))[:, None] * np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    together = aligner.align(seen, starts, lights, light_known=light_known)
    assert together[2].score == -1 and together[2].iterations == 0
    assert len({end.iterations for end in together}) > 1, "some go on when others have ended"
    for start, light, end in zip(starts, lights, together, strict=True):
        (alone,) = aligner.align(seen, start[None], light, light_known=light_known)
        assert end.iterations == alone.iterations and end.score == pytest.approx(alone.score, abs=1e-4)
        np.testing.assert_allclose(end.T_kidney_camera, alone.T_kidney_camera, atol=1e-3)
        np.testing.assert_allclose(end.light, alone.light, atol=1e-3)
        assert end.drawing is not None and end.drawing.value.shape == (3, len(aligner.grid.rays.T))
    assert aligner.align(seen, np.zeros((0, 4, 4))) == []


def test_the_score_is_the_drawings_where_it_was_moved_to(aligner: Aligner, pairs) -> None:  # type: ignore[no-untyped-def]
    seen, T, start = pairs[0]
    drawing = aligner.draw(start, AT_CAMERA, light_known=True)
    here, there = (aligner.score(seen, drawing, pose, AT_CAMERA) for pose in (start, T))
    back = aligner.score(seen, drawing, start @ inverse(inverse(start) @ T), AT_CAMERA)  # as far the other way
    assert there > here > back


@pytest.mark.parametrize(("mm", "deg"), [(3.0, 4.0), (0.5, 40.0), (6.0, 80.0)])
def test_no_step_is_longer_than_its_linearization_can_be_trusted(aligner: Aligner, mm: float, deg: float) -> None:
    """It keeps its direction, the light's part too."""
    step = np.concatenate([[0.0, mm, 0.0], [np.radians(deg), 0.0, 0.0], [1.0, 0, 0, 0, 0]])
    short = aligner._limited(step)
    share = min(1.5 / mm, 8.0 / deg, 1.0)
    np.testing.assert_allclose(short, share * step)
    np.testing.assert_array_equal(aligner._limited(short), short)


def test_residuals_beyond_five_times_their_size_do_not_count() -> None:
    """Tukey's biweight."""
    residual = np.full((3, 1000), 0.1, np.float32)
    residual[:, :5] = 8.0  # the size of all is some 0.57
    good = np.ones(1000, np.float32)
    good[-1] = 0.0

    def weights() -> np.ndarray:
        return tukey(residual[None], good[None], good[None].sum(1))[0]

    weight = weights()
    assert (weight[:, :5] == 0).all() and (weight[:, 5:-1] > 0.99).all() and (weight[:, -1] == 0).all()
    residual[:, :5] = 0.2
    assert (weights()[:, :5] > 0.7).all()


def test_the_prior_draws_the_light_to_where_scopes_have_it(
    aligner: Aligner, pairs, monkeypatch: pytest.MonkeyPatch
) -> None:  # type: ignore[no-untyped-def]
    start = AT_CAMERA + np.array([1.0, -0.5, 0.3, 1.0, 0.05, 0.0])
    monkeypatch.setattr(align, "_LIGHT_PRIOR", 5.0)
    for seen, _, aside in pairs[:3]:
        np.testing.assert_allclose(aligner.align(seen, aside[None], start)[0].light, AT_CAMERA, atol=0.15)
        np.testing.assert_array_equal(aligner.align(seen, aside[None], start, light_known=True)[0].light, start)


def test_what_is_not_valid_does_not_pull(aligner: Aligner, pairs) -> None:  # type: ignore[no-untyped-def]
    """A block of noise over a quarter of the picture: with no weight the pose is found as without it."""
    rng, left = np.random.default_rng(1), {"weighed": [], "blind": []}
    for seen, T, start in pairs:
        value = seen.value.copy()
        value[:, 15:45, 15:45] = rng.normal(0, 2, (3, 30, 30))
        weight = seen.weight.copy()
        weight[13:47, 13:47] = 0
        for name, counted in (("weighed", weight), ("blind", seen.weight)):
            spoiled = Fields(value, seen.slope_x, seen.slope_y, counted)
            left[name].append(
                off(aligner.align(spoiled, start[None], iterations=8, light_known=True)[0].T_kidney_camera, T)[0]
            )
    assert np.median(left["weighed"]) < 0.25 < np.median(left["blind"])


def test_normal_equations_are_those_of_the_rows_written_out() -> None:
    rng = np.random.default_rng(0)
    motion, gradient, lit, b, weight, residual = (
        rng.random(size).astype(np.float32)
        for size in ((2, 6, 2, 50), (2, 2, 3, 50), (2, 5, 3, 50), (2, 3, 1), (2, 3, 50), (2, 3, 50))
    )
    for lights in (lit, lit[:, :0]):
        of_pose = np.einsum("bikn,bkcn->bicn", motion, gradient)
        rows = np.concatenate([of_pose, -b[:, None] * lights], 1)
        normal, slant = normal_equations(motion, gradient, lights, b, weight, residual)
        np.testing.assert_allclose(normal, np.einsum("bicn,bcn,bjcn->bij", rows, weight, rows), rtol=1e-4)
        np.testing.assert_allclose(slant, np.einsum("bicn,bcn,bcn->bi", rows, weight, residual), rtol=1e-4)


def test_correlations_are_weighted_by_how_much_pixels_count() -> None:
    rng = np.random.default_rng(1)
    fields, good = rng.normal(size=(2, 7, 80)).astype(np.float32), (rng.random((2, 80)) > 0.3).astype(np.float32)
    fields[:, 3] += 2 * fields[:, 0] + 5
    fields[:, -1] = 1
    count, correlation, a, b, c = correlated(fields, good)
    for i in range(2):
        seen = fields[i][:, good[i] > 0]
        assert count[i] == seen.shape[1]
        expected = [np.corrcoef(seen[k], seen[k + 3])[0, 1] for k in range(3)]
        np.testing.assert_allclose(correlation[i], expected, atol=1e-4)
        residual = seen[:1] * a[i, 0] - seen[3:4] * b[i, 0] + c[i, 0]
        assert abs(residual.mean()) < 1e-4 and residual.var() == pytest.approx(1 - expected[0] ** 2, abs=1e-3)


def test_an_alignment_that_another_follows_is_given_up_a_step_earlier(aligner: Aligner, pairs) -> None:  # type: ignore[no-untyped-def]
    taken = {False: 0, True: 0}
    for seen, _, start in pairs:
        ends = {last: aligner.align(seen, start[None], iterations=12, last=last)[0] for last in taken}
        taken = {last: taken[last] + end.iterations for last, end in ends.items()}
        assert ends[True].score - ends[False].score < 3e-3
    assert taken[True] - len(pairs) <= taken[False] < taken[True]


def test_walls_are_cast_once_for_poses_that_are_asked_for_again(aligner: Aligner, pairs, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    poses, light = np.stack([pairs[0][1], pairs[1][1], pairs[2][1]]), AT_CAMERA[None].repeat(3, 0)
    reliefs, distances = aligner.looks(poses, light)
    cast, counts = aligner._scene.cast, []
    monkeypatch.setattr(aligner._scene, "cast", lambda o, d: (counts.append(len(o)), cast(o, d))[1])
    again, there = aligner.looks(poses[::-1], light)
    assert not counts
    np.testing.assert_array_equal(again[::-1], reliefs)
    np.testing.assert_array_equal(there[::-1], distances)
    moved = poses.copy()
    moved[1, 0, 3] += 0.01
    fresh = aligner.looks(moved, light)[0]
    assert sum(counts) == aligner._rays.shape[1] and (fresh[1] != reliefs[1]).any()
    np.testing.assert_array_equal(fresh[[0, 2]], reliefs[[0, 2]])
