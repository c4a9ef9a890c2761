"""The runner teleop, and every choice of configs/hardware."""

import json
from functools import partial
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import instantiate

from ursnav_torch._runner import config_dir
from ursnav_torch.devices import CameraDevice, EmTracker, Gamepad, Lamp, Output, Robot
from ursnav_torch.session import Replay, Snapshot

CONTRACTS = {
    "camera": CameraDevice,
    "tracker": EmTracker,
    "robot": Robot,
    "light": Lamp,
    "gamepad": Gamepad,
    "output": Output,
}
CHOICES = [
    (kind, path.stem) for kind in CONTRACTS for path in sorted((Path(config_dir()) / "hardware" / kind).glob("*.yaml"))
]
FAST = ("camera.width=64", "camera.height=64", "hardware.twin.sensor=null")


def composed(*overrides):
    GlobalHydra.instance().clear()
    with initialize_config_dir(config_dir(), version_base="1.3"):
        return compose("teleop", overrides=list(overrides))


@pytest.mark.parametrize(("kind", "choice"), CHOICES)
def test_every_choice_names_a_device_of_its_kind(kind, choice, tmp_path):
    (tmp_path / "a.png").write_bytes(b"")
    needs = {
        ("camera", "folder"): [f"hardware.camera.folder={tmp_path}"],
        ("camera", "video"): ["hardware.camera.path=none.mp4"],
        ("tracker", "csv"): [f"hardware.tracker.path={tmp_path}/em.csv"],
        ("gamepad", "scripted"): [f"hardware.gamepad.path={tmp_path}/script.csv"],
    }
    (tmp_path / "em.csv").write_text("x_mm,y_mm,z_mm,dx,dy,dz\n1,2,3,0,0,1\n")
    (tmp_path / "script.csv").write_text("t_s,arm\n0,1\n")
    config = composed(f"hardware/{kind}={choice}", *needs.get((kind, choice), []))
    if choice == "none":
        assert not config.hardware[kind]
    elif choice == "video":
        assert config.hardware.camera._target_ == "ursnav_torch.devices.VideoCamera"
    else:
        made = instantiate(config.hardware[kind])
        assert issubclass(made.func if isinstance(made, partial) else type(made), CONTRACTS[kind])


@pytest.mark.parametrize("choice", ["simulated", "lab"])
def test_every_set_up_can_be_built(choice):
    made = instantiate(composed(f"hardware={choice}").hardware)
    assert made.func.__name__ == "build_rig"


def test_the_lab_is_built_without_a_kidney_and_its_missing_device_is_explained(run):
    done = run("teleop", "hardware=lab", "hardware.robot.port=/dev/no-such-port", "hardware/gamepad=none")
    assert done.code == 1
    assert "/dev/no-such-port cannot be opened" in done.err and "Traceback" not in done.err


def test_a_missing_package_is_named_and_all_else_works(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    nothing = [f"hardware/{kind}=none" for kind in ("camera", "tracker", "robot", "light")]
    done = run("teleop", "hardware=lab", *nothing)
    assert done.code == 1 and "ursnav-torch[gamepad]" in done.err
    done = run("teleop", "hardware=lab", *nothing, "hardware/gamepad=none", "duration_s=0.2")
    assert done.code == 0 and "nothing" in done.out


def test_recording_without_a_place_is_refused(run):
    done = run("teleop", "session=record", "duration_s=1", *FAST)
    assert done.code == 1 and "add out=FOLDER" in done.err


@pytest.mark.slow
def test_a_simulated_flight_is_recorded_and_replayed_the_same(run, tmp_path):
    out = tmp_path / "my session, ä=1 [x]"
    script = tmp_path / "hands.csv"
    script.write_text("t_s,insertion,dead_man,arm,snapshot,quit\n0,,,1,,\n0.1,1,1,,,\n1.2,,,,1,\n1.6,,,,,1\n")
    hands = ("hardware/gamepad=scripted", f"hardware.gamepad.path={script}")
    done = run("teleop", "session=record", f"out={out}", *hands, *FAST)
    assert done.code == 0, done.err
    assert "1 snapshots" in done.out and "lost" in done.out  # a machine that is late may lose samples, and then says so
    about = json.loads((out / "session.json").read_text(encoding="utf-8"))
    assert about["config"]["hardware"]["twin"]["em"]["noise_mm"] == 0.7 and "ursnav-torch" in about["versions"]
    events = list(Replay(out, speed=0))
    (snapshot,) = (e for e in events if isinstance(e, Snapshot))
    assert snapshot.robot.joints.insertion_mm > 0 and snapshot.frame is not None and snapshot.tracker is not None

    again = tmp_path / "again"
    replay = ("hardware=replay", "hardware.speed=0", f"hardware.path={out}")
    done = run("teleop", *replay, "session=record", f"out={again}")
    assert done.code == 0, done.err
    for path in [out / "events.jsonl", *(out / "frames").iterdir()]:
        assert (again / path.relative_to(out)).read_bytes() == path.read_bytes()

    done = run("teleop", *replay, "session=record", f"out={again}")
    assert done.code == 1 and "overwrite=true" in done.err
    done = run("teleop", *replay, "session=record", f"out={out}", "overwrite=true")
    assert done.code == 1 and "cannot be replayed and written" in done.err
    assert (out / "events.jsonl").stat().st_size > 1000
    assert not any(Path.cwd().iterdir())  # nothing is left where the runner was called
