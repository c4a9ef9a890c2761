"""What a trainee's session is read beside."""

from ursnav_torch.exploration.coverage import INSPECTED, OUT_OF_REACH, UNSEEN, CalyxCoverage
from ursnav_torch.reports.session_parts import training_summary


def covered(calyx: str, verdict: str) -> CalyxCoverage:
    return CalyxCoverage(calyx, "", verdict, 0.5, 1.0, 80.0)


def test_a_calyx_out_of_reach_was_not_missed() -> None:
    calyces = [covered("A", INSPECTED), covered("B", UNSEEN), covered("C", OUT_OF_REACH)]
    assert training_summary(calyces) == {"calyces not inspected": "1 of 2 in reach: B"}
    assert training_summary(calyces[:1]) == {"calyces not inspected": "none of 1 in reach"}
