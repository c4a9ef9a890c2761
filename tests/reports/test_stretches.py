"""A session's stretches: cut where certainty or the calyx change, doubts told from what is sure."""

import pytest

from ursnav_torch.reports.stretches import kind_of, stretches_of


def row(state="tracking", accepted=True, confidence=0.95, calyx="A"):
    return {"state": state, "accepted": accepted, "confidence": confidence, "calyx": calyx}


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (row(), ("sure", "A")),
        (row(confidence=0.59), ("unsure", "A")),
        (row(calyx=None), ("sure", "")),
        (row(accepted=False), ("unsure", "")),  # expected there, but the picture shows too little
        ({"state": "searching", "accepted": False}, ("searching", "")),
        ({"state": "lost", "accepted": False}, ("lost", "")),
    ],
)
def test_kinds(given, kind):
    assert kind_of(given) == kind


def test_stretches_meet_and_gaps_in_the_record_stay_gaps():
    rows = [row(), row(), row(calyx="B"), row(calyx="B", confidence=0.9), {"state": "lost", "accepted": False}, row()]
    t = [0.0, 0.1, 0.2, 0.3, 0.4, 9.0]
    found = stretches_of(t, list(enumerate(rows)))
    assert [(m.kind, m.calyx) for m in found] == [("sure", "A"), ("sure", "B"), ("lost", ""), ("sure", "A")]
    assert [(m.from_s, m.to_s) for m in found] == [(0.0, 0.2), (0.2, 0.4), (0.4, pytest.approx(0.65)), (9.0, 9.0)]
    assert [m.frame for m in found] == [0, 2, 4, 5] and found[1].confidence == 0.9
    assert stretches_of([], []) == []
