"""The screening suite on a small VID: both searches agree, and a VID of repeated views opens and locates."""

from pathlib import Path

from benchmarks.screening import compare, open_and_locate, simulated, tile
from benchmarks.shared.results import Report
from ursnav_torch.vid import Vid, load_vid


def test_two_stages_are_compared_with_one(vid: Vid) -> None:
    report = Report("screening", {})
    compare(report, vid, simulated(vid, 3, seed=1))
    rows = {row.name: row for row in report.rows}
    assert rows["same calyx and within 0.3 mm, refined"].median == 100  # of 84 views all are passed on
    assert rows["same calyx and within 0.3 mm, unrefined"].n == 3
    assert len(simulated(vid, 4, seed=1)) == 4


def test_a_tiled_vid_opens_without_its_tables_and_locates(vid: Vid, tmp_path: Path) -> None:
    tile(vid, 200, tmp_path / "tiled")
    tiled = load_vid(tmp_path / "tiled")
    assert len(tiled) == 200 and tiled.screen is not None and len(tiled.picture_sums) == 200
    views, opened, ready, located, memory = open_and_locate(tmp_path / "tiled", simulated(vid, 2, seed=1), 1)
    assert views == 200 and (0, 0) < opened < ready and len(located) == 2 and memory > 0
