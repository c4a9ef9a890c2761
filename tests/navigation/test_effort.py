"""Orderly degradation."""

from ursnav_torch.navigation import Governor


def after(governor, seconds, pictures):
    for _ in range(pictures):
        level = governor.observe(seconds)
    return level


def test_on_a_quick_machine_everything_is_done():
    assert after(Governor(), 0.05, 500) == 0


def test_slow_pictures_lower_the_effort_one_level_at_a_time_and_no_further_than_the_last():
    governor = Governor(budget_s=0.1)
    levels = [governor.observe(0.3) for _ in range(40)]
    assert levels[6] == 0 and levels[7] == 1 and levels[14] == 1 and levels[15] == 2 and levels[-1] == 2


def test_one_slow_picture_changes_nothing():
    governor = Governor(budget_s=0.1)
    after(governor, 0.05, 20)
    assert governor.observe(2.0) == 0 and after(governor, 0.05, 20) == 0


def test_effort_comes_back_when_the_machine_keeps_up():
    governor = Governor(budget_s=0.1, patience=30)
    assert after(governor, 0.3, 20) == 2
    assert after(governor, 0.04, 200) == 0


def test_a_machine_in_between_is_left_where_it_is():
    """What the lower effort saves must not bring the higher one back at once."""
    governor = Governor(budget_s=0.1)
    after(governor, 0.12, 8)
    assert after(governor, 0.07, 1000) == 1


def test_a_relapse_makes_it_more_patient():
    governor = Governor(budget_s=0.1, patience=20)
    waits = []
    for _ in range(4):
        after(governor, 0.2, 8)
        assert governor.level == 1
        waits.append(0)
        while governor.observe(0.03):
            waits[-1] += 1
    assert waits[0] < waits[1] < waits[2]
