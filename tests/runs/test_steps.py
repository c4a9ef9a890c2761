"""A long job says what it does and how long that took."""

from ursnav_torch.runs.tables import Steps


def test_every_step_is_named_before_and_timed_after(capsys) -> None:
    now = [100.0]
    steps = Steps(2, clock=lambda: now[0])
    steps.begin("Drawing")
    assert capsys.readouterr().out == "1/2 Drawing ...\n"
    now[0] += 31.4
    steps.begin("Locating")
    assert capsys.readouterr().out == "    31 s\n2/2 Locating ...\n"
    now[0] += 2.0
    assert round(steps.end(), 6) == 33.4
    assert capsys.readouterr().out == "    2 s\n"
