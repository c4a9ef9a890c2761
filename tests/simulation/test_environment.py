"""The twin as a Gymnasium environment."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

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
