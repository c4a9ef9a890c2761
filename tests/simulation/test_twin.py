"""The digital twin: walls hold, the drive has slack, the EM sensor errs as it should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ursnav_torch.devices import Drive, JointRates, Joints, Limits, clamp_rates, tip_transform
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import angle_between, check_rigid, transform_from, transform_from_quaternion
from ursnav_torch.simulation import EmField, Scope, Twin, TwinPilot, World, make_twin
from ursnav_torch.simulation.twin import Hysteresis

DRIVE = Drive()
START = transform_from(np.eye(3), [0.0, 0.0, 0.0])
RIGID = Scope(backlash=(0.0, 0.0, 0.0))


def in_the_open(points):
    return np.full(len(points), 100.0)


def in_a_tube(points):
    """A tube of radius 6 mm along z, from -30 to 60 mm."""
    radial = 6.0 - np.hypot(points[:, 0], points[:, 1])
    return np.minimum(radial, np.minimum(points[:, 2] + 30, 60 - points[:, 2]))


class Motors:
    """Axis positions that a test sets."""

    def __init__(self, twin):
        self.axes = np.zeros(3)
        twin.drive_with(lambda: self.axes)

    def go(self, **joints):
        self.axes = DRIVE.axes_mm(Joints(**joints))


def black(T):
    return np.full((4, 4), 200, np.uint8)


def make(clearance=in_the_open, scope=RIGID):
    twin = Twin(clearance, black, START, scope)
    return twin, Motors(twin)


@given(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))
@settings(max_examples=20)
def test_in_the_open_bending_is_the_segments_kinematics(x, y):
    twin, motors = make()
    motors.go(bend_x_rad=x, bend_y_rad=y)
    base = transform_from(np.eye(3), [0.0, 0.0, -20.0])
    np.testing.assert_allclose(twin.pose(), base @ tip_transform(DRIVE.segment, Joints(x, y)), atol=1e-9)


def test_pushing_a_bent_scope_drives_it_on_along_its_curve():
    twin, motors = make()
    motors.go(bend_x_rad=1.0)
    before = twin.pose()
    motors.go(bend_x_rad=1.0, insertion_mm=20.0)
    after = check_rigid(twin.pose(), "T")
    np.testing.assert_allclose(np.linalg.inv(before) @ after, DRIVE.segment.point_transform([1.0, 0.0]), atol=1e-6)


def test_pulling_goes_back_the_way_it_came():
    twin, motors = make()
    poses = []
    joints = [
        {"insertion_mm": 10.0},
        {"bend_x_rad": 0.8, "insertion_mm": 10.0},
        {"bend_x_rad": 0.8, "insertion_mm": 25.0},
    ]
    for wanted in joints:
        motors.go(**wanted)
        poses.append(twin.pose())
    for wanted, pose in zip(joints[::-1], poses[::-1], strict=True):
        motors.go(**wanted)
        np.testing.assert_allclose(twin.pose(), pose, atol=0.21)  # marks lie 0.2 mm apart
    motors.go()
    np.testing.assert_allclose(twin.pose(), START, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_however_it_is_driven_the_tip_keeps_off_the_walls(seed):
    rng = np.random.default_rng(seed)
    twin, motors = make(in_a_tube, Scope())
    joints = Joints()
    for _ in range(120):
        rates = JointRates(*rng.uniform(-3, 3, 2), rng.choice([-40.0, 40.0, 60.0]))
        sent = clamp_rates(rates, joints, Limits(max_bend_rate_rad_s=3, max_insertion_rate_mm_s=60), 0.1)
        joints = Joints(
            joints.bend_x_rad + 0.1 * sent.bend_x_rad_s,
            joints.bend_y_rad + 0.1 * sent.bend_y_rad_s,
            joints.insertion_mm + 0.1 * sent.insertion_mm_s,
        )
        motors.axes = DRIVE.axes_mm(joints)
        T = check_rigid(twin.pose(), "T_kidney_camera")
        assert in_a_tube(T[None, :3, 3])[0] >= twin.scope.keep_off_mm - 1e-6


def test_a_wall_head_on_stops_the_tip_and_the_shaft_slips():
    twin, motors = make(in_a_tube)
    motors.go(insertion_mm=100.0)
    assert twin.pose()[2, 3] == pytest.approx(60 - twin.scope.keep_off_mm, abs=0.25)
    motors.go(insertion_mm=95.0)  # 2 mm of it only relax the shaft
    assert twin.pose()[2, 3] == pytest.approx(60 - twin.scope.keep_off_mm - 3.0, abs=0.25)


def test_a_wall_at_a_slant_leads_the_tip_along():
    twin, motors = make(in_a_tube)
    motors.go(bend_x_rad=0.3)
    motors.go(bend_x_rad=0.3, insertion_mm=8.0)
    motors.go(bend_x_rad=0.1, insertion_mm=25.0)
    T = twin.pose()
    assert T[2, 3] > 15.0 and in_a_tube(T[None, :3, 3])[0] >= twin.scope.keep_off_mm - 1e-6


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=30))
def test_the_drives_slack_lags_behind_by_half_its_width_at_most_and_forgets_nothing(path):
    slack = Hysteresis([0.4, 0.4, 0.4])
    for motor in path:
        out = slack(np.full(3, motor))
        assert np.abs(out - motor).max() <= 0.2 + 1e-12
    np.testing.assert_array_equal(slack(np.full(3, path[-1])), out)  # standing still moves nothing


def test_the_way_there_and_back_differ_by_the_backlash():
    slack = Hysteresis([0.4, 0.4, 0.4])
    up = [slack(np.full(3, v))[0] for v in np.linspace(-2, 2, 41)]
    down = [slack(np.full(3, v))[0] for v in np.linspace(2, -2, 41)][::-1]
    np.testing.assert_allclose(np.subtract(down, up)[10:-10], 0.4 * 0.6, atol=1e-9)  # the mean of the three plays


def test_a_start_in_the_wall_is_refused():
    with pytest.raises(InputError, match="choose a start in the open"):
        Twin(in_a_tube, black, transform_from(np.eye(3), [5.8, 0.0, 0.0]))
    with pytest.raises(InputError, match="keep_off_mm > 0"):
        Scope(keep_off_mm=0)


def test_the_led_dims_the_picture():
    twin, _ = make()
    assert twin.image().mean() == 200
    twin.drive_with(lambda: np.zeros(3), light=lambda: 0.5)
    assert 100 < twin.image().mean() < 160
    twin.drive_with(lambda: np.zeros(3), light=lambda: 0.0)
    assert twin.image().max() == 0


def readings(em, T, n=4000):
    got = [em.read(T) for _ in range(n)]
    return np.array([g[0] for g in got]), np.array([g[1] for g in got])


def test_the_em_sensor_errs_by_its_noise_about_the_right_place():
    T = transform_from_quaternion([10.0, 20.0, 30.0], [0.1, 0.2, 0.3, 0.9])
    em = EmField(distortion_mm=0.0, seed=3)
    p, q = readings(em, T)
    truth = em.T_em_kidney @ T @ transform_from(np.eye(3), em.sensor_offset_mm)
    error = np.linalg.norm(p - truth[:3, 3], axis=1)
    assert np.sqrt((error**2).mean()) == pytest.approx(0.7, rel=0.05)
    np.testing.assert_allclose(p.mean(axis=0), truth[:3, 3], atol=0.03)
    axes = transform_from_quaternion(p, q)[:, :3, 2]
    assert np.sqrt((angle_between(axes, truth[:3, 2]) ** 2).mean()) == pytest.approx(0.005 * 2**0.5, rel=0.05)


def test_the_em_frame_is_its_own_and_its_distortion_smooth_and_bounded():
    assert not np.allclose(EmField(seed=0).T_em_kidney, EmField(seed=1).T_em_kidney)
    check_rigid(EmField(seed=1).T_em_kidney, "T")
    em = EmField(noise_mm=0.0, noise_rad=0.0, distortion_mm=1.0)
    line = [transform_from(np.eye(3), [x, 0.0, 0.0]) for x in np.linspace(0, 50, 51)]
    p = np.array([em.read(T)[0] for T in line])
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    assert np.abs(steps - 1.0).max() < 0.06  # smooth: neighbors stay neighbors
    exact = np.array([(em.T_em_kidney @ T)[:3, 3] for T in line])
    offset = p - exact
    bent = np.linalg.norm(offset - offset[0], axis=1)
    assert 0.05 < bent[-1] <= 1.0 + 1e-9


def test_dropouts_come_as_often_as_asked():
    em = EmField(dropout=0.25)
    gone = [em.read(START) is None for _ in range(2000)]
    assert np.mean(gone) == pytest.approx(0.25, abs=0.04)
    with pytest.raises(InputError, match="dropout"):
        EmField(dropout=2.0)


@pytest.mark.slow
def test_the_pilot_visits_every_calyx_of_a_phantom_without_touching_a_wall(
    monkeypatch, phantom, phantom_lumen, renderer
):
    twin = make_twin(World(phantom, renderer, phantom_lumen))
    motors, limits, joints = Motors(twin), Limits(), Joints()
    clock = [0.0]
    monkeypatch.setattr("ursnav_torch.devices.base.time.monotonic", lambda: clock[0])
    with TwinPilot(twin, phantom) as pilot:
        while not (hands := pilot.read()).quit:
            clock[0] += 0.02
            assert clock[0] < 120
            bend = limits.max_bend_rate_rad_s
            wanted = JointRates(hands.bend_x * bend, hands.bend_y * bend, hands.insertion * 8)
            sent = clamp_rates(wanted, joints, limits, 0.12)
            joints = Joints(
                joints.bend_x_rad + 0.02 * sent.bend_x_rad_s,
                joints.bend_y_rad + 0.02 * sent.bend_y_rad_s,
                joints.insertion_mm + 0.02 * sent.insertion_mm_s,
            )
            motors.axes = DRIVE.axes_mm(joints)
            assert phantom_lumen.clearance_mm(twin.pose()[None, :3, 3])[0] > 0.5
    assert pilot.visited == [c.name for c in phantom.calyces]
    print(f"{len(pilot.visited)} calyces in {clock[0]:.0f} s")


def test_a_pilot_that_hands_over_only_holds_the_button_once_it_is_in_a_calyx(phantom, phantom_lumen, renderer):
    with TwinPilot(make_twin(World(phantom, renderer, phantom_lumen)), phantom) as pilot:
        pilot.hands_over = lambda: False
        assert pilot.read().arm
        leading = pilot.read()
        assert leading.dead_man and (leading.bend_x or leading.bend_y)
        pilot.visited.append("A")
        hands = pilot.read()
        assert hands.dead_man and not (hands.bend_x or hands.bend_y or hands.insertion)


def test_a_pilot_leads_no_farther_than_until_autonomy_may_take_over_and_takes_nothing_back(
    phantom, phantom_lumen, renderer
):
    may = [False]
    with TwinPilot(make_twin(World(phantom, renderer, phantom_lumen)), phantom) as pilot:
        pilot.hands_over = lambda: may[0]
        assert pilot.read().arm and any(_sticks(pilot.read()))
        may[0] = True
        assert not any(_sticks(pilot.read())) and pilot.read().dead_man
        may[0] = False
        assert not any(_sticks(pilot.read()))
    with pilot:
        assert pilot.read().arm and any(_sticks(pilot.read())), "opened again, it leads again"


def _sticks(hands):
    return hands.bend_x, hands.bend_y, hands.insertion


def test_who_leads_in_for_autonomy_goes_back_from_what_can_be_felt(monkeypatch, phantom, phantom_lumen, renderer):
    monkeypatch.setattr(Twin, "pressed_mm", property(lambda twin: 0.5))
    for hands_over, pushes in ((None, True), (lambda: False, False)):
        with TwinPilot(make_twin(World(phantom, renderer, phantom_lumen)), phantom) as pilot:
            pilot.hands_over = hands_over
            hands = [pilot.read() for _ in range(3)]
            assert (hands[-1].insertion >= 0) == pushes


def test_breath_moves_the_scope_as_far_as_walls_allow_and_is_none_of_its_own_way():
    offset = np.array([2.0, 0.0, 0.0])
    twin = Twin(in_a_tube, black, START, RIGID, breathing=lambda: offset)
    motors = Motors(twin)
    np.testing.assert_allclose(twin.pose()[:3, 3], [2.0, 0.0, 0.0])
    np.testing.assert_allclose(twin.undisturbed[:3, 3], 0.0)
    offset[:] = [9.0, 0.0, 0.0]
    assert in_a_tube(twin.pose()[None, :3, 3])[0] >= RIGID.keep_off_mm
    offset[:] = 0.0
    motors.go(insertion_mm=5.0)
    np.testing.assert_allclose(twin.pose()[:3, 3], [0.0, 0.0, 5.0], atol=0.21)


def test_a_shaft_that_pushes_against_a_wall_is_compressed_and_says_so():
    twin = Twin(in_a_tube, black, START, RIGID)
    motors = Motors(twin)
    motors.go(insertion_mm=40.0)
    twin.pose()
    assert abs(twin.pressed_mm) < 0.25
    motors.go(insertion_mm=60.5)
    twin.pose()
    assert 0.8 < twin.pressed_mm <= RIGID.compression_mm
