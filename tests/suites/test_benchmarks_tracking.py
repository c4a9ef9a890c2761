"""Which answers to which videos the tracking suite judges."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import tracking
from ursnav_torch.errors import InputError


@pytest.mark.parametrize(
    ("asked", "judged"),
    [
        ((), ["K video", "K video, offline", "K video with EM", "K video with EM, offline"]),
        (("offline=false",), ["K video", "K video with EM"]),
        (("live=false", "em=false"), ["K video, offline"]),
    ],
)
def test_live_hindsight_and_sensor_can_each_be_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: tuple[str, ...], judged: list[str]
) -> None:
    (tmp_path / "K").mkdir()
    (tmp_path / "K" / "video.mp4").touch()
    plain = tracking.Exploration("K video", lambda: iter(()), np.zeros((0, 4, 4)), [])
    felt = tracking.Exploration("K video with EM", lambda: iter(()), np.zeros((0, 4, 4)), [], sensor=[])
    monkeypatch.setattr(tracking, "_kidney", lambda *_: (None, [plain, felt]))
    groups: list[str] = []

    def judge(
        report: tracking.Report, vid: None, exploration: tracking.Exploration, group: str, follow: object
    ) -> None:
        groups.append(group)
        report.add(group, "judged", "of 1", [1.0])

    monkeypatch.setattr(tracking, "_judge", judge)
    tracking.main(["phantoms=0", f"data={tmp_path}", f"out={tmp_path / 'r.json'}", *asked])
    assert groups == judged


def test_nothing_left_to_judge_is_refused() -> None:
    with pytest.raises(InputError, match="leave nothing to be judged"):
        tracking.main(["phantoms=0", "live=false", "offline=false"])
