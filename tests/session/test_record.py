"""A record holds everything, byte for byte, and can be read after a crash at any byte."""

import json
import random
import shutil

import cv2
import numpy as np
import pytest

from ursnav_torch.devices import (
    CommandSample,
    Frame,
    JointRates,
    Joints,
    LightSample,
    Note,
    OperatorInput,
    RobotSample,
    Stamp,
    Stamper,
    TrackerSample,
)
from ursnav_torch.errors import InputError
from ursnav_torch.session import Player, Recorder, Replay, Result, Snapshot
from ursnav_torch.session.events import from_line, to_line

rng = np.random.default_rng(0)


def make_events(frames=12):
    """Every kind of event, interleaved as in a session; every third picture brings its own compressed bytes."""
    stamps = {kind: Stamper() for kind in ("f", "t", "r", "c", "l", "i", "n", "s", "x")}
    events = []
    for n in range(frames):
        image = rng.integers(0, 255, (20, 30) if n % 2 else (20, 30, 3), dtype=np.uint8)
        encoded = cv2.imencode(".jpg", image)[1].tobytes() if n % 3 == 0 else None
        if encoded:
            image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED)
        frame = Frame(stamps["f"](), image, encoded, "jpg" if encoded else "png", f"camera {n}")
        tracker = TrackerSample(stamps["t"](), True, (0.1 * n, 1 / 3, -300.0), (0.0, 0.6, 0.8), None, 5, "7", n, 0.1)
        robot = RobotSample(stamps["r"](), Joints(0.1, 0.2, float(n)), True, "armed")
        events += [frame, tracker, robot]
        events.append(CommandSample(stamps["c"](), JointRates(1.0, 2.0, 3.0), JointRates(0.5, 1.0, 1.5), "limit"))
        events.append(Result(stamps["x"](), frame.stamp.sequence, {"calyx": "B", "x_mm": 1 / 3, "ok": True, "e": None}))
        if n == 5:
            events.append(OperatorInput(stamps["i"](), bend_x=0.5, snapshot=True))
            events.append(Snapshot(stamps["s"](), frame, tracker, robot))
            events.append(TrackerSample(stamps["t"](), False))
            events += [LightSample(stamps["l"](), 0.3), Note(stamps["n"](), "warning", "Kamera hängt, π")]
    return events


@pytest.fixture(scope="module")
def events():
    return make_events()


@pytest.fixture(scope="module")
def record(events, tmp_path_factory):
    path = tmp_path_factory.mktemp("sessions") / "first run, ä"
    with Recorder(path, {"hardware": "simulated"}) as recorder:
        for event in events:
            recorder.write(event)
    return path


def same(a, b):
    """Whether two events are equal, their pictures byte for byte."""
    if type(a) is not type(b) or to_line(a) != to_line(b):
        return False
    if isinstance(a, Snapshot):
        return same(a.frame, b.frame)
    if isinstance(a, Frame):
        return np.array_equal(a.image, b.image) and a.encoded == b.encoded and a.image.dtype == b.image.dtype
    return a == b


def test_everything_comes_back_as_it_went_in(events, record):
    replay = Replay(record, speed=0)
    back = list(replay)
    assert len(back) == len(events) and all(same(a, b) for a, b in zip(events, back, strict=True))
    assert replay.damaged == 0
    assert replay.about["config"] == {"hardware": "simulated"}
    assert {"numpy", "python"} <= replay.about["versions"].keys()
    assert [r.frame for r in replay.results()] == list(range(12))


def test_a_record_of_a_replay_is_the_same_record(events, record, tmp_path):
    with Recorder(tmp_path / "again") as recorder:
        for event in Replay(record, speed=0):
            recorder.write(event)
    for name in ["events.jsonl", *(f"frames/{p.name}" for p in (record / "frames").iterdir())]:
        assert (tmp_path / "again" / name).read_bytes() == (record / name).read_bytes()


def test_snapshots_lie_ready_for_validation(record):
    head, row = (record / "snapshots" / "em.csv").read_text(encoding="utf-8").splitlines()
    assert head == "image,t_s,x_mm,y_mm,z_mm,dx,dy,dz"
    name, _, *values = row.split(",")
    assert [float(v) for v in values] == pytest.approx([0.5, 1 / 3, -300, 0, 0.6, 0.8], abs=1e-5)
    assert (record / "snapshots" / name).read_bytes() == (record / "frames" / "00000005.png").read_bytes()


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ({"kind": "note", "stamp": [0, 1.0, 2.0], "level": "info"}, "missing required field `text`"),
        ({"kind": "note", "stamp": [0, 1.0], "level": "info", "text": "x"}, r"list \[sequence, t_mono_s, t_wall_s\]"),
        ({"kind": "light", "stamp": [0, "1", 2.0], "level": 1.0}, r"got `str` - at `\$.stamp.t_mono_s`"),
        ({"kind": "robot", "stamp": [0, 1.0, 2.0], "joints": 3, "moving": True, "state": "armed"}, "Expected `object`"),
        ({"kind": "snapshot", "stamp": [0, 1.0, 2.0], "tracker": [1], "robot": None}, "snapshot's tracker"),
    ],
)
def test_a_line_that_is_no_event_is_refused_by_what_is_wrong(line, match):
    with pytest.raises(InputError, match=match):
        from_line(line)


def written(record):
    """What was written in which order: (file, bytes) for pictures and lines; the snapshot's files are left aside."""
    order = []
    for line in (record / "events.jsonl").read_bytes().splitlines(keepends=True):
        data = json.loads(line)
        if data["kind"] == "frame":
            order.append((data["file"], (record / data["file"]).read_bytes()))
        order.append(("events.jsonl", line))
    return order


def test_cut_at_200_random_bytes_it_always_opens_and_loses_at_most_the_last_item(events, record, tmp_path):
    order = written(record)
    total = sum(len(data) for _, data in order)
    draw = random.Random(7)
    lost_most = 0
    for n in range(200):
        cut, left = tmp_path / str(n), draw.randrange(total + 1)
        (cut / "frames").mkdir(parents=True)
        shutil.copy(record / "session.json", cut)
        (cut / "events.jsonl").touch()
        begun = complete = 0  # items of which a byte, or all bytes, were written
        for name, data in order:
            part = data[:left]
            left -= len(part)
            with (cut / name).open("ab") as file:
                file.write(part)
            begun += name == "events.jsonl" and bool(part)
            complete += name == "events.jsonl" and len(part) == len(data)
            if len(part) < len(data):
                begun += name != "events.jsonl" and bool(part)
                break
        replay = Replay(cut, speed=0)
        back = list(replay)
        assert all(same(a, b) for a, b in zip(events, back, strict=False))
        assert len(back) == complete
        lost_most = max(lost_most, begun - len(back))
        shutil.rmtree(cut)
    print(f"200 cuts, all opened; lost at most {lost_most} item")
    assert lost_most <= 1


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_any_single_file_may_be_cut(events, record, tmp_path, share, caplog):
    for name in ("session.json", "frames/00000004.png", "frames/00000003.jpg"):
        cut = tmp_path / name.replace("/", "-")
        shutil.copytree(record, cut)
        data = (cut / name).read_bytes()
        (cut / name).write_bytes(data[: int(share * len(data))])
        replay = Replay(cut, speed=0)
        back = list(replay)
        assert len(back) == len(events) - (name != "session.json")
        assert replay.damaged == (name != "session.json")
    assert "missing or cut" in caplog.text and "1 damaged items" in caplog.text


def test_a_foreign_byte_in_the_middle_costs_one_item(events, record, tmp_path):
    cut = tmp_path / "cut"
    shutil.copytree(record, cut)
    lines = (cut / "events.jsonl").read_bytes().splitlines(keepends=True)
    lines[7] = b"\xff" + lines[7]
    (cut / "events.jsonl").write_bytes(b"".join(lines))
    assert len(list(Replay(cut, speed=0))) == len(events) - 1


def test_kinds_of_a_newer_version_are_passed_over(events, record, tmp_path):
    cut = tmp_path / "cut"
    shutil.copytree(record, cut)
    with (cut / "events.jsonl").open("a") as file:
        file.write('{"kind":"hologram","stamp":[0,1.0,2.0]}\n')
    assert len(list(Replay(cut, speed=0))) == len(events)


def test_while_it_runs_the_record_is_called_partial_and_can_be_read(events, tmp_path):
    with Recorder(tmp_path / "run") as recorder:
        recorder.write(events[0])
        assert not (tmp_path / "run").exists()
        assert len(list(Replay(tmp_path / "run", speed=0))) == 1
    assert (tmp_path / "run").is_dir() and not (tmp_path / "run.partial").exists()
    with pytest.raises(InputError, match="overwrite=true"), Recorder(tmp_path / "run"):
        pass
    (tmp_path / "run").rename(tmp_path / "other.partial")
    with pytest.raises(InputError, match="interrupted record"), Recorder(tmp_path / "other"):
        pass
    with Recorder(tmp_path / "other", overwrite=True):
        pass
    assert list(Replay(tmp_path / "other", speed=0)) == []


def test_what_is_no_record_is_refused(tmp_path, record):
    with pytest.raises(InputError, match="no recorded session"):
        Replay(tmp_path)
    with pytest.raises(InputError, match="speed"):
        Replay(record, speed=-1)
    newer = tmp_path / "newer"
    shutil.copytree(record, newer)
    (newer / "session.json").write_text('{"format": 99}')
    with pytest.raises(InputError, match="record format 99"):
        Replay(newer)
    (tmp_path / "mine.partial").mkdir()
    (tmp_path / "mine.partial" / "keep.txt").write_text("x")
    with pytest.raises(InputError, match="remove it by hand"), Recorder(tmp_path / "mine", overwrite=True):
        pass
    assert (tmp_path / "mine.partial" / "keep.txt").is_file()


def test_numbers_that_are_none_are_not_written(tmp_path):
    with Recorder(tmp_path / "run") as recorder, pytest.raises(ValueError, match="not JSON compliant"):
        recorder.write(Result(Stamper()(), 0, {"x": float("nan")}))


def test_a_replay_may_begin_in_the_middle(events, record):
    replay = Replay(record, speed=0)
    begun = events[0].stamp.t_mono_s
    whole, half = replay.duration_s(), replay.duration_s() / 2
    given = [e.stamp.t_mono_s for e in events if not isinstance(e, Result)]
    assert whole == pytest.approx(max(given) - begun)
    late = list(replay.events(half))
    assert 0 < len(late) < len(events)
    assert all(e.stamp.t_mono_s - begun >= half for e in late if not isinstance(e, Result))
    assert [type(e) for e in replay.events()] == [type(e) for e in replay]


def test_a_record_that_was_navigated_on_another_day_plays_at_its_own_pace(tmp_path):
    """Its results are stamped by the clock of that day; pictures must not wait for them."""
    picture = np.zeros((8, 8), np.uint8)
    with Recorder(tmp_path / "run") as recorder:
        for i in range(6):
            recorder.write(Frame(Stamp(i, i / 50, 1e9), picture))
            recorder.write(Result(Stamp(i, 50_000.0 + i, 2e9), i, {"state": "tracking"}))
    replay = Replay(tmp_path / "run")
    assert replay.duration_s() == pytest.approx(0.1)
    played = list(Player(replay))
    assert sum(isinstance(event, Frame) for event in played) == 6 and len(played) == 12
    late = list(replay.events(from_s=0.05))
    assert [event.stamp.sequence for event in late if isinstance(event, Result)] == [3, 4, 5]
    ended = list(Player(replay, duration_s=0.05))
    assert sum(isinstance(event, Frame) for event in ended) < 6
