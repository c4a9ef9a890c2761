"""The twin as a Gymnasium environment."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from dialogue import wait_until

gymnasium = pytest.importorskip("gymnasium")

from ursnav_torch.geometry import look_along  # noqa: E402
from ursnav_torch.simulation import TissueSettings  # noqa: E402
from ursnav_torch.simulation.environment import ScopeEnv  # noqa: E402


@pytest.fixture
def env(vid):
    env = ScopeEnv(vid, seconds=1.0)
    yield env
    env.close()


def test_it_keeps_gymnasiums_contract(env):
    from gymnasium.utils.env_checker import check_env

    check_env(env, skip_render_check=True)


def test_the_same_seed_and_actions_give_the_same_episode(env):
    def episode():
        first, _ = env.reset(seed=4)
        steps = [env.step([0.3, -0.2, 1.0]) for _ in range(6)]
        return [first["picture"], *(s[0]["picture"] for s in steps)], [s[1] for s in steps]

    pictures, rewards = episode()
    again, rewards_again = episode()
    np.testing.assert_array_equal(pictures, again)
    assert rewards == rewards_again


def test_actions_pass_the_robots_limits_and_pushing_costs(env):
    env.reset(seed=1)
    cap = env.robot.limits.max_insertion_rate_mm_s
    total = pressed = 0.0
    for _ in range(16):
        seen, reward, _, _, facts = env.step([0.0, 0.0, 99.0])
        total, pressed = total + reward, pressed + facts["pressed_mm"]
    assert 0 < seen["joints"][2] <= cap * env.now_s + 1e-9
    assert total == pytest.approx(seen["seen"].sum() - 0.01 * pressed)


def test_an_episode_is_cut_off_after_its_time(env):
    env.reset(seed=1)
    cut = [env.step(np.zeros(3))[3] for _ in range(17)]
    assert cut == [False] * 16 + [True]


def test_a_new_episode_and_the_end_disconnect_the_robot_of_the_one_before(vid):
    def watchdogs():
        return [t for t in threading.enumerate() if t.name == "robot-watchdog" and t not in before]

    before, env = threading.enumerate(), ScopeEnv(vid, pictures=False)
    env.close()  # nothing was begun
    robots = []
    for seed in range(3):
        env.reset(seed=seed)
        robots.append(env.robot)
    assert [robot.is_connected for robot in robots] == [False, False, True]
    assert wait_until(lambda: len(watchdogs()) == 1)
    env.close()
    assert not env.robot.is_connected and wait_until(lambda: not watchdogs())


def test_stones_lie_where_the_seed_puts_them_stop_the_scope_and_are_in_the_pictures(vid):
    """Two seeds, two places; the middle of a stone is no room for the scope, and a picture from beside it differs."""
    env, bare = ScopeEnv(vid, seconds=9.0, stones=3), ScopeEnv(vid, seconds=9.0)
    laid = [env.reset(seed=seed)[1]["stones"] for seed in (1, 2, 1)]
    assert len(laid[0]) == 3 and np.array_equal(laid[0][0].center_mm, laid[2][0].center_mm)
    assert not np.array_equal(laid[0][0].center_mm, laid[1][0].center_mm)
    bare.reset(seed=1)
    stone = laid[2][0]
    room = env.twin._clearance(stone.center_mm[None])[0], bare.twin._clearance(stone.center_mm[None])[0]
    assert room[0] < 0 < room[1]
    places = vid.lumen.grid.centers_mm
    away = np.linalg.norm(places - stone.center_mm, axis=1) - stone.radii_mm.max()
    place = places[np.argmax(vid.lumen.clearance_mm(places) * (away > 1.0) * (away < 3.0))]
    pictures = [e.twin._render(look_along(place, stone.center_mm - place)) for e in (env, bare)]
    differs = np.abs(pictures[0].astype(int) - pictures[1]) > 20
    assert differs.shape == pictures[1].shape and differs.mean() > 0.05
    assert env.step(np.zeros(3))[4]["stones"] is laid[2]
    for e in (env, bare):
        e.close()


def test_a_printed_kidney_breathes_by_as_much_more(env, vid):
    breaths = []
    for scale in (1.0, 2.0):
        env.vid = replace(vid, kidney=replace(vid.kidney, scale=scale))
        env.reset(seed=1)
        env._clock.now_s = 1.0
        breaths.append(env.twin._breathing())
    assert breaths[0].any()
    np.testing.assert_allclose(breaths[1], 2 * breaths[0])


def test_without_pictures_all_else_is_the_same(vid):
    both = [ScopeEnv(vid, seconds=2.0, tissue=TissueSettings(), pictures=pictures) for pictures in (True, False)]
    assert set(both[1].observation_space) == set(both[0].observation_space) - {"picture"}
    for env in both:
        env.reset(seed=4)
    for _ in range(20):
        (seen, *told, _), (bare, *bare_told, _) = (env.step([0.4, -0.2, 1.0]) for env in both)
        assert bare in both[1].observation_space and told == bare_told
        assert all(np.array_equal(bare[name], seen[name]) for name in ("joints", "seen"))
