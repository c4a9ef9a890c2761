"""The leaderboard: every policy gets the same operation, and the page names the best first."""

import sys
from types import ModuleType

import numpy as np
import pytest

pytest.importorskip("gymnasium")

from benchmarks.leaderboard import POLICIES, Episode, add_rows, found_policy, ranked, run_episode, write_page
from benchmarks.leaderboard.policies import Exploring
from benchmarks.shared.results import Report
from ursnav_torch.errors import InputError

EPISODES = {
    "drifting": [Episode(0.5, 0.0, 9, 100.0, 180.0), Episode(1.5, 0.25, 7, 120.0, 180.0)],
    "my <policy>": [Episode(5.0, 1.0, 0, 300.0, 90.0), Episode(6.0, 0.9, 1, 320.0, 80.0)],
    "scripted": [Episode(4.0, 0.75, 2, 900.0, 170.0), Episode(4.5, 0.8, 2, 800.0, 160.0)],
}


def test_the_page_and_the_table_name_the_best_first(tmp_path):
    assert ranked(EPISODES) == ["my <policy>", "scripted", "drifting"]
    report = Report("leaderboard", {"kidneys": 1})
    add_rows(report, EPISODES)
    assert [row.name for row in report.rows[:2]] == [
        "my <policy>: reward", "my <policy>: calyces in reach inspected",
    ]  # fmt: skip
    text = write_page(report, EPISODES, tmp_path / "board.json").read_text(encoding="utf-8")
    places = [text.index(f"<th>{name}</th>") for name in ("my &lt;policy&gt;", "scripted", "drifting")]
    assert places == sorted(places) and "95 %" in text and "5.50 (5.00 to 6.00)" in text and "2 episodes each" in text
    assert "kidneys 1" in text and "not a medical device" in text


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_every_policy_steers_and_is_accounted_for(vid, name):
    found = run_episode(vid, POLICIES[name](), 1, 1.2)
    assert found.seconds == pytest.approx(1.2, abs=0.07) and found.path_mm > 0.05
    assert found.inspected == 0.0 and found.reward <= 6.0


def test_the_same_seed_gives_the_same_episode_and_what_is_done_ends_it(vid):
    assert run_episode(vid, Exploring(), 2, 0.6) == run_episode(vid, Exploring(), 2, 0.6)

    class Lazy:
        done = False

        def begin(self, env, seed):
            assert env.twin.scope.friction > 0, "an operation, not a calm kidney"

        def act(self, seen, facts):
            assert seen["picture"].any(), "who does not say that it looks gets pictures, too"
            self.done = bool(facts)
            return np.zeros(3)

    assert run_episode(vid, Lazy(), 0, 60.0).seconds == pytest.approx(0.12)


def test_a_policy_of_ones_own_is_found_by_its_name():
    sys.modules["my_steering"] = ModuleType("my_steering")
    sys.modules["my_steering"].Mine = Exploring
    try:
        assert found_policy("my_steering:Mine") is Exploring
        with pytest.raises(InputError, match="names no policy"):
            found_policy("my_steering:Other")
        with pytest.raises(InputError, match=r"package\.module:Name"):
            found_policy("no_such_module:Mine")
    finally:
        del sys.modules["my_steering"]
