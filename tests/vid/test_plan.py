from dataclasses import replace

import numpy as np
import pytest
import trimesh

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between, check_rigid
from ursnav_torch.kidney import Kidney, LumenDistance, make_phantom_kidney
from ursnav_torch.vid import Plan, PlanSettings, plan_views


@pytest.fixture(scope="module")
def settings() -> PlanSettings:
    return PlanSettings(views_per_calyx=40, passage_views=60)


@pytest.fixture(scope="module")
def views(phantom: Kidney, phantom_lumen: LumenDistance, settings: PlanSettings) -> Plan:
    return plan_views(phantom, phantom_lumen, settings)


def test_counts(views: Plan, phantom: Kidney, settings: PlanSettings) -> None:
    """As many views of each calyx as asked for, at least; the others, two thirds around, observe one or none."""
    check_rigid(views.T_kidney_camera, "T_kidney_camera")
    counts = [(views.calyx == c).sum() for c in range(len(phantom.calyces))]
    assert min(counts) >= 40 and len(views.calyx) == 40 * len(phantom.calyces) + 60 + 120
    assert (views.calyx == -1).sum() > 10, "views in pelvis and infundibula"


def test_the_scope_could_stand_there(views: Plan, phantom: Kidney, settings: PlanSettings) -> None:
    """Against the mesh itself: inside, and no nearer to the wall than the scope's radius, but for the voxels."""
    at = views.T_kidney_camera[:, :3, 3]
    inside = trimesh.proximity.signed_distance(phantom.mesh, at)
    assert inside.min() > settings.scope_radius_mm - 0.3
    assert np.mean(inside >= settings.scope_radius_mm) > 0.95


def test_no_view_bends_more_than_the_scope(phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    """Against the way one bending length behind, found anew from the centerline."""
    few = PlanSettings(views_per_calyx=10, passage_views=0)
    bends = []
    for limit in (35.0, few.largest_bend_deg):
        settings = replace(few, largest_bend_deg=limit)
        views, worst = plan_views(phantom, phantom_lumen, settings), []
        for c in range(len(phantom.calyces)):
            way = phantom.centerline.points_mm[phantom.centerline.path_to(c)]
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
            for T in views.T_kidney_camera[10 * c : 10 * c + 10]:
                here = along[np.linalg.norm(way - T[:3, 3], axis=1).argmin()]
                back = max(here - settings.bending_length_mm, 0.0)
                a, b = (np.array([np.interp(s, along, way[:, i]) for i in range(3)]) for s in (back, back + 4.0))
                worst.append(float(np.degrees(angle_between(b - a, T[:3, 2]))))
        bends.append(max(worst))
    assert bends[0] < 35.0 + 8.0 < bends[1]  # a chord of the centerline is no tangent


def test_a_scope_that_turns_between_calyces_looks_at_views(
    phantom: Kidney, phantom_lumen: LumenDistance, settings: PlanSettings
) -> None:
    """From where the lumen is wide and in any direction within reach, there is one nearby that looks about there."""
    rng = np.random.default_rng(0)
    way = phantom.centerline.points_mm[phantom.centerline.path_to(0)]
    wide = way[phantom_lumen.clearance_mm(way) > 2.5]
    assert len(wide) > 3
    axis = np.diff(way[:8], axis=0).sum(0)
    toward = rng.normal(size=(200, 3))
    toward = toward[angle_between(axis, toward) < np.radians(80)]
    far = {}
    for around in (0.0, 4.0):
        views = plan_views(phantom, phantom_lumen, replace(settings, around=around)).T_kidney_camera
        nearest = []
        for place, direction in zip(wide[rng.integers(len(wide), size=len(toward))], toward, strict=True):
            beside = views[np.linalg.norm(views[:, :3, 3] - place, axis=1) < 3.0]
            nearest.append(np.degrees(angle_between(direction, beside[:, :3, 2])).min())
        far[around] = float(np.percentile(nearest, 90))
    assert far[4.0] < 30 < 45 < far[0.0]


def test_labels_follow_the_rule(views: Plan, phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    """Within 14 mm along the lumen, the tip at the smallest angle to the optical axis; else none."""
    along = phantom_lumen.to_calyces(views.T_kidney_camera[:, :3, 3])
    for T, distance, label in zip(views.T_kidney_camera, along, views.calyx, strict=True):
        near = np.flatnonzero(distance <= 14.0)
        angle = angle_between(phantom.tips_mm[near] - T[:3, 3], T[:3, 2])
        assert label == (near[np.argmin(angle)] if len(near) else -1)
    straight = np.linalg.norm(phantom.tips_mm[None] - views.T_kidney_camera[:, None, :3, 3], axis=-1)
    assert (along >= straight - 0.3).all(), "no way is shorter than the straight one"


def test_views_of_a_calyx_spread_over_the_distances_asked_for(
    views: Plan, phantom_lumen: LumenDistance, settings: PlanSettings, phantom: Kidney
) -> None:
    for calyx in range(len(phantom.calyces)):
        T = views.T_kidney_camera[40 * calyx : 40 * (calyx + 1)]
        away = phantom_lumen.to_calyces(T[:, :3, 3])[:, calyx]
        assert away.min() > settings.nearest_mm - 1.5 and away.max() <= 14.0
        assert np.ptp(away) > 4


def test_the_same_seed_gives_the_same_views(
    views: Plan, phantom: Kidney, phantom_lumen: LumenDistance, settings: PlanSettings
) -> None:
    np.testing.assert_array_equal(plan_views(phantom, phantom_lumen, settings).T_kidney_camera, views.T_kidney_camera)
    other = plan_views(phantom, phantom_lumen, replace(settings, seed=1))
    assert np.abs(other.T_kidney_camera - views.T_kidney_camera).max() > 0.1


def test_roll_turns_about_the_optical_axis_only(
    views: Plan, phantom: Kidney, phantom_lumen: LumenDistance, settings: PlanSettings
) -> None:
    rolled = plan_views(phantom, phantom_lumen, replace(settings, roll_deg=30.0))
    np.testing.assert_allclose(rolled.T_kidney_camera[:, :3, 2:], views.T_kidney_camera[:, :3, 2:])
    angle = np.degrees(angle_between(rolled.T_kidney_camera[:, :3, 0], views.T_kidney_camera[:, :3, 0]))
    assert 25 < angle.max() <= 30.001


def test_a_larger_kidney_has_the_same_views_larger(phantom: Kidney, settings: PlanSettings) -> None:
    """All settings are mm at scale 1."""
    large = phantom.scaled(1.8)
    views = plan_views(large, LumenDistance.from_kidney(large), settings)
    clearance = trimesh.proximity.signed_distance(large.mesh, views.T_kidney_camera[::7, :3, 3])
    assert clearance.min() > 1.8 * (settings.scope_radius_mm - 0.3)
    assert min((views.calyx == c).sum() for c in range(len(large.calyces))) >= 40


@pytest.mark.parametrize(
    "wrong",
    [
        {"views_per_calyx": 0}, {"passage_views": -1}, {"around": -0.1}, {"around": np.nan},
        {"nearest_mm": 13.0}, {"nearest_mm": 0.0},
        {"scope_radius_mm": 0.0}, {"stretch_mm": -0.1}, {"tilt_deg": -1.0}, {"largest_tilt_deg": 180.0},
    ],
)  # fmt: skip
def test_refuses_settings_that_cannot_be(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        PlanSettings(**wrong)  # type: ignore[arg-type]


def test_a_scope_too_thick_is_told_so(phantom: Kidney, phantom_lumen: LumenDistance) -> None:
    with pytest.raises(InputError, match=r"Calyx . has room for only .*scope_radius_mm"):
        plan_views(phantom, phantom_lumen, PlanSettings(scope_radius_mm=6.0))


def test_a_passage_narrower_than_the_scope_gives_way() -> None:
    kidney = make_phantom_kidney(seed=1004)  # the infundibulum of D is 1.3 mm wide
    lumen, settings = LumenDistance.from_kidney(kidney), PlanSettings(views_per_calyx=8, passage_views=0)
    plan = plan_views(kidney, lumen, settings)
    assert np.bincount(plan.calyx, minlength=len(kidney.calyces)).tolist() == [8] * len(kidney.calyces)
    assert lumen.clearance_mm(plan.T_kidney_camera[:, :3, 3]).min() > settings.scope_radius_mm - settings.stretch_mm
    with pytest.raises(InputError, match="Calyx D has room for only 0"):
        plan_views(kidney, lumen, replace(settings, stretch_mm=0.0))
