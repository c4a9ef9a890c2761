"""The runners navigate and explore."""

import json

import numpy as np
import pytest

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.columns import STONE_COLUMNS
from ursnav_torch.devices import CommandSample, Frame, Stamp
from ursnav_torch.kidney import LumenDistance
from ursnav_torch.runs.calibrate_tip import live_place
from ursnav_torch.session import Recorder, Replay
from ursnav_torch.tables import read_csv


@pytest.fixture(scope="module")
def record(vid, renderer, tmp_path_factory):
    path = tmp_path_factory.mktemp("navigate") / "my record, ä=1"
    with Recorder(path) as recorder:
        for i in range(20):
            T = vid.T_kidney_camera[3].copy()
            T[:3, 3] += 0.3 * np.sin(i / 4) * T[:3, 2]
            recorder.write(Frame(Stamp(i, i / 15, 1e9 + i / 15), renderer.render(T).image))
    return path


def test_a_record_is_navigated_recorded_and_reported(run, vid, record, tmp_path):
    out, known = tmp_path / "my session", tmp_path / "stones, ä=1.csv"
    known.write_text("stone,x_mm,y_mm,z_mm,size_mm\nS1,0,0,500,4\n", encoding="utf-8")
    done = run(
        "navigate", f"vid={vid.folder}", "hardware=replay", f"hardware.path={record}", "hardware.speed=0",
        "viewer=none", f"out={out}", f"known_stones={known}", "latency_s=0.000001",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "20 pictures, 20 located" in done.out and "of its wall seen" in done.out and "report.html" in done.out
    text = (out / "report.html").read_text(encoding="utf-8")
    assert text.count("<svg") == 1 == text.count('<svg class="time-line"') and "Doubtful moments" in text
    assert "No stone seen." in done.out and "<li>No stone seen.</li>" in text
    assert "Known from the scan, not found yet: S1 of 4.0 mm." in done.out
    stones = read_csv(out / "stones.csv", STONE_COLUMNS, "stones")
    assert [(s["known"], s["state"]) for s in stones] == [("S1", "not found")] and (out / "stones.png").exists()
    rows = [r.row for r in Replay(out).results()]
    assert len(rows) == 20 and all({"state", "latency_s", "effort"} <= set(row) for row in rows)
    assert {row["effort"] for row in rows} == {0}, "nothing is late where the record waits"
    again = run(
        "navigate", f"vid={vid.folder}", "hardware=replay", f"hardware.path={record}", "viewer=none", f"out={out}"
    )
    assert again.code == 1 and "exists already" in again.err


@pytest.mark.parametrize("stated", ["camera", "calibration"])
def test_pictures_of_another_lens_than_the_vids_are_refused(run, vid, record, tmp_path, stated):
    other = equidistant_camera(120, 96, 96).to_dict()
    (tmp_path / "camera.json").write_text(json.dumps(other), encoding="utf-8")
    lens, rig = ["camera=file", f"camera.path={tmp_path / 'camera.json'}"], [f"hardware.path={record}"]
    if stated == "calibration":
        lens, rig = [f"hardware.camera.calibration={tmp_path / 'camera.json'}"], ["hardware/camera=folder"]
        rig += [f"hardware.camera.folder={vid.folder / 'images'}", "hardware/gamepad=none"]
    hardware = "replay" if stated == "camera" else "simulated"
    done = run("navigate", f"vid={vid.folder}", f"hardware={hardware}", "viewer=none", "seconds=0.1", *rig, *lens)
    assert done.code == 1 and "is not the one that the VID" in done.err


def test_a_clocks_offset_that_is_not_applied_live_is_said(run, vid, record, tmp_path):
    tip = tmp_path / "tip.json"
    tip.write_text(json.dumps({"sensor_offset_mm": [0.0, 1.0, -4.0], "em_offset_s": -0.06}), encoding="utf-8")
    replayed = ("hardware=replay", f"hardware.path={record}", "viewer=none", "seconds=0.1")
    with pytest.warns(UserWarning, match=r"EM clock -0\.060 s ahead .* does not apply the clocks' offset"):
        done = run("navigate", f"vid={vid.folder}", *replayed, f"tip={tip}")
    assert done.code == 0, done.err
    tip.write_text(json.dumps({"sensor_offset_mm": [0.0, 1.0, -4.0], "em_offset_s": 0.004}), encoding="utf-8")
    assert live_place(tip) == [0.0, 1.0, -4.0]  # of so little nothing is said


def test_a_simulated_session_ends_after_its_time_and_finds_no_distances_again(run, vid, monkeypatch):
    def again(*given):
        raise AssertionError("the VID holds the distances along its lumen")

    monkeypatch.setattr(LumenDistance, "from_kidney", again)
    done = run("navigate", f"vid={vid.folder}", "hardware=simulated", "hardware/tracker=none", "viewer=none",
               "hardware.twin.sensor=null", "seconds=3")  # fmt: skip
    assert done.code == 0, done.err
    assert "located" in done.out


@pytest.mark.slow
def test_a_scope_that_explores_by_itself_is_recorded_with_an_account_of_every_calyx(run, vid, tmp_path):
    out = tmp_path / "explored"
    done = run("navigate", f"vid={vid.folder}", "hardware=simulated", "hardware/tracker=none", "viewer=none",
               "hardware.twin.sensor=null", "autonomy=explore", "seconds=8", f"out={out}")  # fmt: skip
    assert done.code == 0, done.err
    assert "Not explored to the end" in done.out and "6 calyces inspected" in done.out
    told = json.loads((out / "explored.json").read_text(encoding="utf-8"))
    assert [c["calyx"] for c in told["calyces"]] == [c.name for c in vid.kidney.calyces] and not told["finished"]
    sent = [e for e in Replay(out, speed=0) if isinstance(e, CommandSample)]
    assert sent and any(not e.sent.is_zero for e in sent), "it moved, and by the robot's own gate"
    assert not any(e.reason == "dead-man button not held" for e in sent)


def test_autonomy_needs_a_robot(run, vid):
    done = run("navigate", f"vid={vid.folder}", "hardware=simulated", "hardware/tracker=none", "hardware/robot=none",
               "hardware/light=none", "viewer=none", "autonomy=explore", "seconds=3")  # fmt: skip
    assert done.code == 1 and "choose hardware/robot=..., or autonomy=none" in done.err


@pytest.mark.parametrize("runner", ["navigate", "explore"])
def test_other_computers_are_kept_out(run, vid, record, runner):
    arguments = {
        "navigate": ["hardware=replay", f"hardware.path={record}", "viewer.host=0.0.0.0"],
        "explore": ["host=0.0.0.0"],
    }[runner]
    done = run(runner, f"vid={vid.folder}", *arguments)
    assert done.code == 1 and "ssh -L" in done.err and "Traceback" not in done.err


def test_exploring_ends_after_its_time_and_says_what_was_kept(run, vid):
    done = run("explore", f"vid={vid.folder}", "port=0", "seconds=0.5")
    assert done.code == 0 and "0 views and 0 landmarks were kept" in done.out and "page: http://127.0.0.1:" in done.err


def test_a_kidney_without_a_vid_is_explored_and_leaves_nothing_behind(run, phantom, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    phantom.mesh.export(tmp_path / "my lumen, ä=1.stl")
    done = run(
        "explore", "kidney=mesh", f"kidney.path={tmp_path / 'my lumen, ä=1.stl'}", "views.views_per_calyx=2",
        "views.passage_views=2", "camera.width=96", "camera.height=96", "port=0", "seconds=0.5",
    )  # fmt: skip
    assert done.code == 0 and "0 views and 0 landmarks were kept" in done.out, done.err
    assert "page: http://127.0.0.1:" in done.err and not any((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize("what", [[], ["kidney=phantom", "vid=some_vid"]])
def test_exploring_takes_a_vid_or_a_kidney(run, what):
    done = run("explore", *what)
    assert done.code == 2 and "vid=FOLDER or kidney=" in done.err


def test_a_place_to_save_that_is_taken_is_refused_before_anybody_flies(run, vid, tmp_path):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "poses.csv").touch()
    done = run("explore", f"vid={vid.folder}", f"out={tmp_path / 'kept'}", "port=0", "seconds=0.5")
    assert done.code == 1 and "exists already" in done.err and "page:" not in done.err
