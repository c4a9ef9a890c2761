"""The runner `experiment`."""

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SMALL = (
    "kidney.calyces=6", "camera.width=96", "camera.height=96", "views.views_per_calyx=12", "views.passage_views=12",
    "calibrate=false", "workers=1",
)  # fmt: skip
Run = Callable[..., Any]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_the_whole_protocol(run: Run, tmp_path: Path) -> None:
    """One run, looked at from all sides: files, both columns, and the other runners agreeing with it."""
    out = tmp_path / "result, 1"
    done = run("experiment", *SMALL, f"out={out}")
    assert done.code in (0, 3), done.err
    assert re.search(r"registration residual, mm at scale 1.8 +5\.20 +\d+\.\d\d", done.out)
    assert "14, 1, 2, 7" in done.out and "22/24 = 92 %" in done.out
    assert not out.with_name(out.name + ".partial").exists()

    page = (out / "report.html").read_text(encoding="utf-8")
    assert "scale 1.8" in page and page.count("<img") > 40
    assert all(source.startswith("data:image/") for source in re.findall(r'src="([^"]*)"', page))

    result = json.loads((out / "results.json").read_text(encoding="utf-8"))
    for series in ("simulation", "phantom"):
        truth = {row["image"]: row["calyx"] for row in rows(out / series / "truth.csv")}
        found = rows(out / series / "matches.csv")
        right = sum(row["calyx"] == truth[row["image"]] for row in found)
        assert right == result[series]["right"] and len(found) == result[series]["pictures"] == 18
    assert result["simulation"]["right"] >= 9  # few small views; guessing would give 3

    registered = run("register", f"landmarks={out / 'landmarks.csv'}", "out=again.json")
    assert registered.code == 0
    again, ours = (json.loads(p.read_text(encoding="utf-8")) for p in (Path("again.json"), out / "em_to_kidney.json"))
    np.testing.assert_allclose(again["R"], ours["R"], atol=1e-4)
    phantom = out / "phantom"
    judged = run(
        "validate", f"matches={phantom / 'matches.csv'}", f"em={phantom / 'em.csv'}",
        f"em_to_kidney={out / 'em_to_kidney.json'}", f"truth={phantom / 'truth.csv'}",
        f"reference_pairs={out / 'reference_pairs.csv'}", "sensor_offset_mm=[0,1.2,-4]", "match_mm=2.7", "out=v.json",
    )  # fmt: skip
    assert judged.code == 0, judged.err
    confusion = json.loads(Path("v.json").read_text(encoding="utf-8"))["confusion"]["position_and_direction"]
    assert {k: confusion[k] for k in ("TP", "FN", "FP", "TN")} == result["confusion"]["position_and_direction"]

    refused = run("experiment", *SMALL, f"out={out}")
    assert refused.code == 1 and "overwrite=true" in refused.err


@pytest.mark.slow
def test_the_thesiss_own_pipeline(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "thesis"
    done = run("experiment", "experiment=thesis", "kidney.calyces=6", "camera.width=96", "camera.height=96",
               "workers=1", f"out={out}")  # fmt: skip
    assert done.code in (0, 3), done.err
    assert len(rows(out / "vid" / "views.csv")) == 5 * 6
    assert re.search(r"views in the VID +40 +30", done.out)


@pytest.mark.slow
def test_an_interrupted_run_takes_up_its_views(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "later"
    monkeypatch.setattr("ursnav_torch.thesis.run.drive_robot", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    assert run("experiment", *SMALL, f"out={out}").code == 1
    assert (tmp_path / "later.partial" / "vid").exists() and not out.exists()
    monkeypatch.undo()
    before = (tmp_path / "later.partial" / "vid" / "views.csv").stat().st_mtime_ns
    assert run("experiment", *SMALL, f"out={out}").code in (0, 3)
    assert (out / "vid" / "views.csv").stat().st_mtime_ns == before
