"""Halves to print: closed, thick enough, and cut where the fewest calyces are crossed."""

import numpy as np
import pytest
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.kidney import Kidney
from ursnav_torch.kidney.build import build_kidney
from ursnav_torch.printing import (
    Cut,
    PrintCheck,
    PrintedPhantom,
    calyx_regions,
    check_print,
    find_cut,
    make_printed_phantom,
)
from ursnav_torch.printing.cut import GRAZE_MM, SMALLEST_SHARE, Body

pytest.importorskip("manifold3d", reason="the extra ct is not installed")
WALL_MM = 2.0


@pytest.fixture(scope="module")
def printed(phantom: Kidney) -> PrintedPhantom:
    return make_printed_phantom(phantom, 1.8, WALL_MM)


@pytest.fixture(scope="module")
def check(printed: PrintedPhantom) -> PrintCheck:
    return check_print(printed)


def test_both_halves_are_closed_and_of_one_piece(printed: PrintedPhantom, check: PrintCheck) -> None:
    assert check.watertight
    for half in printed.halves:
        assert half.is_watertight and half.is_winding_consistent and half.volume > 0 and half.body_count == 1


def test_walls_are_as_thick_as_asked(check: PrintCheck) -> None:
    assert check.thinnest_wall_mm >= 0.9 * WALL_MM


def test_the_halves_joined_are_the_shell(printed: PrintedPhantom, check: PrintCheck) -> None:
    assert check.union_mm < 0.1
    play = len(printed.pins_mm) * 8.0  # mm3 left open around and below the pins
    assert abs(sum(h.volume for h in printed.halves) - printed.shell.volume) < play


def test_the_inside_is_the_lumen_at_the_printed_size(printed: PrintedPhantom, phantom: Kidney) -> None:
    assert printed.kidney.scale == 1.8
    np.testing.assert_allclose(printed.kidney.mesh.extents, 1.8 * phantom.mesh.extents)
    assert not np.any(printed.shell.contains(printed.kidney.tips_mm)), "tips are hollow"
    inward = printed.kidney.centerline.points_mm[0]
    assert not printed.shell.contains(inward[None])[0]


def test_the_scope_gets_in_at_the_ureter(printed: PrintedPhantom) -> None:
    point, out, radius = printed.mouth
    assert radius > 1.5
    way = point + np.linspace(0, 8, 40)[:, None] * out
    assert not np.any(printed.shell.contains(way))
    assert printed.shell.euler_number == 2, "one opening and nothing else: the inside is the outside"


def test_a_lumen_without_a_ureter_is_opened_opposite_to_the_calyces() -> None:
    ball = trimesh.creation.icosphere(4, 9.0)
    fingers = [trimesh.creation.capsule(22.0, 3.0, count=[24, 24], transform=turn) for turn in _turns()]
    lumen = trimesh.boolean.union([ball, *fingers], engine="manifold")
    kidney = build_kidney(lumen, "a hand", 1.0, None, None, None)
    with pytest.warns(UserWarning, match="a hand shows no ureter: it is opened opposite to the calyces"):
        printed = make_printed_phantom(kidney, 1.0, WALL_MM)
    check = check_print(printed)
    assert check.watertight and check.thinnest_wall_mm > 0.9 * WALL_MM and check.union_mm < 0.1
    assert printed.shell.euler_number == 2 and not printed.shell.contains(kidney.pelvis_mm[None])[0]
    assert printed.mouth[1] @ (kidney.tips_mm.mean(axis=0) - kidney.pelvis_mm) < 0


def _turns() -> list[np.ndarray]:
    return [trimesh.transformations.rotation_matrix(a, axis) for a, axis in
            ((0.0, [1, 0, 0]), (0.9, [1, 0, 0]), (-0.9, [1, 0, 0]), (0.9, [0, 1, 0]), (-0.9, [0, 1, 0]))]  # fmt: skip


def test_each_half_keeps_to_its_side_of_the_plane(printed: PrintedPhantom) -> None:
    n, d = printed.cut.normal, printed.cut.offset_mm
    first, second = (h.vertices @ n - d for h in printed.halves)
    assert second.max() < 1e-6 and first.max() > 5
    below = printed.halves[0].vertices[first < -1e-6]
    apart = np.linalg.norm(below[:, None] - printed.pins_mm, axis=-1).min(axis=1)
    assert apart.max() < 3, "only pins reach through the plane"


def test_pins_fit_their_holes_with_a_little_play(printed: PrintedPhantom) -> None:
    n = printed.cut.normal
    side = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    side /= np.linalg.norm(side)
    for pin in printed.pins_mm:
        at = pin - 1.0 * n + np.array([[0.0], [1.45], [1.55], [1.8]]) * side
        assert printed.halves[0].contains(at).tolist() == [True, True, False, False]
        assert printed.halves[1].contains(at).tolist() == [False, False, False, True]


def test_landmarks_are_dimples_spread_over_both_halves(printed: PrintedPhantom) -> None:
    points = printed.landmarks_mm
    assert len(points) == 8
    assert np.abs(trimesh.proximity.signed_distance(printed.shell, points)).max() < 0.1, "on the surface"
    apart = np.linalg.norm(points[:, None] - points, axis=-1) + 999 * np.eye(8)
    assert apart.min() > 10
    sides = points @ printed.cut.normal > printed.cut.offset_mm
    assert sides.any() and not sides.all()


def test_no_plane_crosses_fewer_calyces(phantom: Kidney) -> None:
    """Against planes in random places: none that parts the phantom fairly crosses fewer."""
    found = find_cut(phantom, WALL_MM)
    regions, body = calyx_regions(phantom), Body.of(phantom, WALL_MM)
    rng = np.random.default_rng(0)

    def crossed(cut: Cut) -> int:
        heights = [p @ cut.normal - cut.offset_mm for p in regions]
        return sum(bool((h > GRAZE_MM).any() and (h < -GRAZE_MM).any()) for h in heights)

    assert crossed(found) == len(found.crossed) and body.parts_are_whole(found)
    fewest = 99
    for normal in rng.normal(size=(1500, 3)):
        normal /= np.linalg.norm(normal)
        heights = body.points_mm @ normal
        for offset in np.quantile(heights, rng.uniform(SMALLEST_SHARE, 1 - SMALLEST_SHARE, 4)):
            cut = Cut(normal, float(offset), ())
            count = crossed(cut)
            if count < min(fewest, len(found.crossed)) and body.parts_are_whole(cut):
                fewest = count
    assert len(found.crossed) <= fewest


@pytest.mark.parametrize(
    ("scale", "wall", "match"),
    [(0.0, 2.0, "scale is 0.0; accepted are"), (1.8, 0.1, r"wall_mm is 0\.1"), (1.8, 99.0, r"wall_mm is 99\.0")],
)
def test_values_out_of_range_are_refused(phantom: Kidney, scale: float, wall: float, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make_printed_phantom(phantom, scale, wall)
