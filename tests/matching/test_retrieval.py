from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from benchmarks.retrieval import (
    aligned,
    bulls_eye,
    described,
    first_neighbor,
    main,
    nearest_distances,
    ordered_distances,
)
from benchmarks.shared.outlines import mirrored, outline, read_silhouettes, silhouette_mask
from benchmarks.shared.rerank import diffuse
from benchmarks.shared.shapes import silhouettes
from ursnav_torch.errors import InputError
from ursnav_torch.matching import Ordered


def disk(side: int = 80, radius: int = 20, center: tuple[int, int] = (40, 40)) -> np.ndarray:
    image = np.zeros((side, side), np.uint8)
    cv2.circle(image, center, radius, 255, -1)
    return image


@pytest.mark.parametrize("invert", [False, True])
def test_outline_of_black_or_white_shapes(invert: bool) -> None:
    found = outline(255 - disk() if invert else disk(), 60)
    radii = np.linalg.norm(found.points - 40, axis=1)
    assert abs(radii.mean() - 19.7) < 0.5
    assert np.ptp(radii) < 1
    across = np.cos(found.tangents) * (found.points[:, 0] - 40) + np.sin(found.tangents) * (found.points[:, 1] - 40)
    assert np.abs(across).max() < 2.5
    gaps = np.linalg.norm(np.roll(found.points, -1, 0) - found.points, axis=1)
    assert np.ptp(gaps) < 0.15 * gaps.mean()


def test_holes_and_specks_change_nothing() -> None:
    image = disk()
    image[35:45, 35:45] = 0
    image[2:5, 2:5] = 255
    np.testing.assert_allclose(outline(image, 50).points, outline(disk(), 50).points)


@pytest.mark.parametrize("center", [(0, 40), (40, 79), (5, 5)])
def test_shapes_that_touch_the_border(center: tuple[int, int]) -> None:
    found = outline(disk(center=center), 50)
    assert np.isfinite(found.points).all()
    assert found.points.min() >= -1
    assert found.points.max() <= 80


def test_kinds_of_image_agree() -> None:
    gray = disk()
    kinds = [gray > 0, gray // 255, gray.astype(np.uint16) * 200, cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)]
    transparent = np.dstack([np.zeros((80, 80, 3), np.uint8), gray])
    for image in (*kinds, transparent):
        np.testing.assert_array_equal(
            silhouette_mask(image.astype(np.uint8) if image.dtype == bool else image), gray > 0
        )


def test_tiny_shapes_have_an_outline_and_empty_images_none() -> None:
    dot = np.zeros((9, 9), np.uint8)
    dot[4, 4] = 255
    assert np.isfinite(outline(dot, 20).points).all()
    with pytest.raises(InputError, match="one gray"):
        outline(np.zeros((9, 9), np.uint8), 20)


def test_a_mirror_image_is_the_outline_of_the_mirrored_picture() -> None:
    image = silhouettes(1, 1)[0][1]
    seen, turned = mirrored(outline(image, 100)), outline(image[:, ::-1], 100)
    histograms = described([seen, turned, outline(image, 100)], 1.0).histograms
    distances = nearest_distances(histograms, 0 * histograms)
    assert distances[0, 1] < 0.5 * distances[0, 2]


def test_names_may_hold_hyphens_digits_and_upper_case(tmp_path: Path) -> None:
    folder = tmp_path / "bilder ü [1]"
    folder.mkdir()
    for name in ("device-9-12.png", "apple-1.PNG", "HCircle-20.png", "note.txt", "apple.png"):
        ok, data = cv2.imencode(".png", disk())
        assert ok
        (folder / name).write_bytes(data.tobytes())
    assert [label for label, _ in read_silhouettes(folder)] == ["HCircle", "apple", "device-9"]
    (folder / "cut-1.png").write_bytes(data.tobytes()[:20])
    with pytest.raises(InputError, match=r"cut-1\.png cannot be read"):
        read_silhouettes(folder)
    with pytest.raises(InputError, match=r"class-number\.png"):
        read_silhouettes(tmp_path)


def test_protocol_counts_by_hand() -> None:
    labels = np.array([0, 0, 1, 1])
    right = np.array([[0, 1, 2, 3], [1, 0, 2, 3], [3, 2, 0, 1], [3, 2, 1, 0]], float)
    assert bulls_eye(right, np.zeros(4, int)) == 1
    assert first_neighbor(right, labels) == 1
    six = np.arange(6) // 2
    line = np.abs(np.array([0, 5, 1, 2, 3, 9])[:, None] - np.array([0, 5, 1, 2, 3, 9])).astype(float)
    hits = [1, 1, 2, 2, 1, 1]  # of each query's class among its four nearest, the query itself among them
    assert bulls_eye(line, six) == pytest.approx(sum(hits) / 12, abs=0.17)


def test_order_and_neighborhoods_help_on_drawn_silhouettes() -> None:
    shapes = silhouettes(6, 8, seed=2)
    labels = np.unique([name.rsplit("-", 1)[0] for name, _ in shapes], return_inverse=True)[1]
    outlines = [outline(image, 60) for _, image in shapes]
    own, flipped = described(outlines, 1.0), described([mirrored(o) for o in outlines], 1.0)
    coarse = nearest_distances(own.histograms, flipped.histograms)
    np.testing.assert_array_equal(coarse, coarse.T)
    fine = ordered_distances(own, flipped, 30, Ordered(skip=0.5))
    assert np.diag(fine).max() < 1e-3
    np.testing.assert_allclose(fine, fine.T)
    assert bulls_eye(fine, labels) >= bulls_eye(coarse, labels) - 0.02 > 0.6
    assert bulls_eye(-diffuse(fine), labels) >= bulls_eye(fine, labels) - 0.02


def test_costs_are_hellingers_and_what_heights_weigh() -> None:
    shapes = described([outline(image, 60) for _, image in silhouettes(3, 1)], 2.0)
    found = shapes.costs(0, shapes, torch.tensor([1, 2]))
    apart = torch.cdist(shapes.heights[0], shapes.heights[2], compute_mode="donot_use_mm_for_euclid_dist")
    wanted = 1 - shapes.histograms[0] @ shapes.histograms[2].T + apart
    torch.testing.assert_close(found[1], wanted, atol=1e-3, rtol=0)
    lighter = described([outline(image, 60) for _, image in silhouettes(3, 1)], 1.0)
    torch.testing.assert_close(shapes.heights, 2 * lighter.heights)


def test_a_mirrored_outline_is_the_same_shape() -> None:
    seen = outline(silhouettes(2, 1)[1][1], 60)
    pair = [seen, mirrored(seen)]
    own, flipped = described(pair, 1.0), described(pair[::-1], 1.0)
    both = np.ones((2, 2), dtype=bool)
    assert aligned(own, flipped, both, Ordered(0.5))[0, 1] < 1e-3 < 0.05 < aligned(own, own, both, Ordered(0.5))[0, 1]


def test_the_shortlist_is_compared_with_all_points_and_stands_first() -> None:
    outlines = [outline(image, 60) for _, image in silhouettes(4, 5, seed=3)]
    own, flipped = described(outlines, 1.0), described([mirrored(o) for o in outlines], 1.0)
    whole = aligned(own, flipped, np.ones((20, 20), dtype=bool), Ordered(0.5))
    np.testing.assert_array_equal(ordered_distances(own, flipped, 20, Ordered(0.5)), whole)
    short = ordered_distances(own, flipped, 4, Ordered(0.5))
    near = short == whole
    assert (near.sum(1) >= 4).all() and not near.all()
    assert all(row[listed].max() < row[~listed].min() for row, listed in zip(short, near, strict=True))


def test_runs_on_a_folder_and_refuses_an_empty_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, image in silhouettes(3, 4):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    assert main([f"data={tmp_path}", "points=40", f"out={tmp_path / 'r.json'}"]) == 0
    assert "Bull's-eye" in capsys.readouterr().out
    (tmp_path / "none").mkdir()
    assert main([f"data={tmp_path / 'none'}"]) == 1
    assert "class-number.png" in capsys.readouterr().err
