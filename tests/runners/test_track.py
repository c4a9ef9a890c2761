"""The runner `track`: its files, and a clear word for every video that cannot be tracked."""

import csv
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from flights import flight

from ursnav_torch.camera import mask_text
from ursnav_torch.columns import POSE_COLUMNS, TRACK_COLUMNS
from ursnav_torch.devices import CameraDevice, Frame, SourceAtEndError, Stamp
from ursnav_torch.errors import DeviceTimeoutError, InputError
from ursnav_torch.files import write_csv
from ursnav_torch.kidney import Kidney
from ursnav_torch.registration import Registration
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.sources import open_source
from ursnav_torch.runs.track import camera_source, track_source
from ursnav_torch.tracking.follow import Moment, Source
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import Vid, pose_cells

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def poses(phantom: Kidney) -> np.ndarray:
    """(8, 4, 4) on the way into the first calyx."""
    return flight(phantom, 0, from_mm=12.0)[:8]


@pytest.fixture(scope="module")
def pictures(poses: np.ndarray, renderer: RaycastRenderer) -> list[np.ndarray]:
    """What is seen on that way."""
    return [renderer.render(T).image for T in poses]


@pytest.fixture(scope="module")
def folder(pictures: list[np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("frames ä, 1")
    for i, image in enumerate(pictures):
        cv2.imwrite(str(out / f"{i}.png"), image)
    return out


@pytest.fixture(scope="module")
def video(pictures: list[np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "flight.avi"
    height, width = pictures[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (width, height))
    for image in pictures:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@contextmanager
def silent(total: int, what: str) -> Iterator[Callable[[int], None]]:
    yield lambda n: None


def read(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_folder_gives_rows_coverage_and_a_picture(run: Run, vid: Vid, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "track.csv"
    done = run("track", f"vid={vid.folder}", f"source={folder}", f"out={out}", "fps=5")
    assert done.code == 0, done.err
    assert "8 pictures" in done.out
    rows = read(out)
    assert tuple(rows[0]) == TRACK_COLUMNS
    assert [row["frame"] for row in rows] == [str(i) for i in range(8)]
    assert [float(row["t_s"]) for row in rows] == pytest.approx([i / 5 for i in range(8)])
    assert {row["state"] for row in rows} <= {"tracking", "searching", "lost"}
    for row in rows:
        assert bool(row["x_mm"]) == (row["state"] == "tracking")
    report = json.loads((out.parent / "track.coverage.json").read_text(encoding="utf-8"))
    assert set(report["calyces"]) == {c.name for c in vid.kidney.calyces}
    assert report["pictures"] and report["next"]["calyx"] in report["calyces"]
    assert cv2.imread(str(out.parent / "track.coverage.png")) is not None
    kinds = ("coverage.json", "coverage.png", "csv", "stones.csv", "stones.png")
    assert sorted(p.name for p in out.parent.iterdir()) == [f"track.{kind}" for kind in kinds]
    again = run("track", f"vid={vid.folder}", f"source={folder}", f"out={out}")
    assert again.code == 1 and "overwrite=true" in again.err


def test_a_recording_is_tracked_with_hindsight_scored_and_exported(
    run: Run, vid: Vid, folder: Path, poses: np.ndarray, tmp_path: Path
) -> None:
    truth = tmp_path / "truth.csv"
    write_csv(truth, ("calyx", *POSE_COLUMNS), [{"calyx": ""} | cells for cells in pose_cells(poses)])
    arguments = [f"vid={vid.folder}", f"source={folder}", "offline=true", "tum=true"]
    # Along a straight neck of a phantom eight pictures are too few to be told from their mirror images.
    arguments.append("tracking.own_kidney.doubt_below=-99")
    done = run("track", *arguments, f"out={tmp_path / 'a.csv'}", f"truth={truth}")
    assert done.code == 0, done.err
    assert "8 pictures: 8 tracking" in done.out and "position_mm" in done.out
    assert {row["state"] for row in read(tmp_path / "a.csv")} == {"tracking"}
    score = json.loads((tmp_path / "a.score.json").read_text(encoding="utf-8"))
    assert score["pictures"] == 8 and score["not_tracking"] == 0 and score["position_mm"] < 1.0
    assert score["right_calyx"] is None and score["within_5_mm"] == 1.0
    assert len((tmp_path / "a.tum").read_text(encoding="utf-8").splitlines()) == 8
    truth.write_text("".join(truth.read_text(encoding="utf-8").splitlines(keepends=True)[:5]))
    short = run("track", *arguments, f"out={tmp_path / 'b.csv'}", f"truth={truth}")
    assert short.code == 1 and "not scored: " in short.out and "the truth has 4 rows" in short.out
    assert len(read(tmp_path / "b.csv")) == 8, "a score costs no track"
    missing = run("track", *arguments, f"out={tmp_path / 'c.csv'}", "truth=nowhere.csv")
    assert missing.code == 1 and "no truth file" in missing.err and not (tmp_path / "c.csv").exists()


def test_a_video_and_em_samples(run: Run, vid: Vid, video: Path, tmp_path: Path) -> None:
    em = tmp_path / "em.csv"
    x, y, z = vid.kidney.calyces[0].tip_mm
    em.write_text("frame,t_s,x_mm,y_mm,z_mm\n" + "".join(f"{i},{i / 10},{x},{y},{z}\n" for i in range(8)))
    registration = tmp_path / "registration.json"
    registration.write_text(json.dumps({"R": np.eye(3).tolist(), "t_mm": [0, 0, 0]}))
    assert Registration.from_json(registration).scale == 1.0
    arguments = [f"vid={vid.folder}", f"source={video}", f"em={em}", "sensor_offset_mm=[0,0,8]"]
    done = run("track", *arguments, f"em_to_kidney={registration}", f"out={tmp_path / 'a.csv'}")
    assert done.code == 0, done.err
    assert len(read(tmp_path / "a.csv")) == 8
    assert "8 of 8 pictures have an EM reading (by frame)" in done.out
    refused = run("track", *arguments, f"out={tmp_path / 'b.csv'}")
    assert refused.code == 1 and "em_to_kidney=" in refused.err
    em.write_text("t_s,x_mm,y_mm,z_mm\n" + "".join(f"{1000 + i / 10},{x},{y},{z}\n" for i in range(8)))
    refused = run("track", *arguments, f"em_to_kidney={registration}", f"out={tmp_path / 'b.csv'}")
    assert refused.code == 1 and "0 of 8 pictures" in refused.err and "em_offset_s=" in refused.err
    tip = tmp_path / "tip.json"
    tip.write_text(json.dumps({"sensor_offset_mm": [0, 0, 8], "em_offset_s": 1000}))
    given = [*arguments[:-1], f"em_to_kidney={registration}", f"tip={tip}", f"out={tmp_path / 't.csv'}"]
    done = run("track", *given)
    assert "8 of 8 pictures have an EM reading (by time)" in done.out, done.err
    told = [[row[c] for c in POSE_COLUMNS] for row in read(tmp_path / "t.csv")]
    assert told == [[row[c] for c in POSE_COLUMNS] for row in read(tmp_path / "a.csv")]
    tip.write_text("{}")
    refused = run("track", *given, "overwrite=true")
    assert refused.code == 1 and "is no tip calibration" in refused.err
    registration.write_text(json.dumps({"R": np.eye(3).tolist(), "t_mm": [0, 0, 900]}))
    refused = run("track", *arguments, f"em_to_kidney={registration}", f"out={tmp_path / 'b.csv'}", "em_offset_s=1000")
    assert refused.code == 1 and "mm outside the kidney" in refused.err
    assert not (tmp_path / "b.csv").exists()


def test_the_stated_mask_of_the_lens_is_what_is_tracked_through(
    run: Run, vid: Vid, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The calibration's mask is narrower than the VID's lens; the pictures are as large as the lens's."""
    lens, mask, trackers = tmp_path / "lens.json", np.zeros((96, 96), bool), list[Tracker]()
    mask[:, :64] = True
    lens.write_text(json.dumps(replace(vid.camera, mask=mask_text(mask)).to_dict()), encoding="utf-8")

    def tracked(tracker: Tracker, *_: Any) -> tuple[str, bool]:
        trackers.append(tracker)
        return "", True

    monkeypatch.setattr("ursnav_torch.runs.track.track_source", tracked)
    given = ["track", f"vid={vid.folder}", f"source={folder}", f"out={tmp_path / 'track.csv'}"]
    for stated in ([], ["camera=file", f"camera.path={lens}"]):
        assert run(*given, *stated).code == 0
    assert trackers[0].shown is None
    np.testing.assert_array_equal(trackers[1].shown, mask & vid.camera.pixel_rays()[1])


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("missing.mp4", None, "There is no video or folder"),
        ("empty.mp4", b"", "not a video that can be read"),
        ("text.mp4", b"not a video at all" * 100, "not a video that can be read"),
    ],
)
def test_what_is_no_video_is_refused(
    run: Run, vid: Vid, tmp_path: Path, name: str, content: bytes | None, word: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    done = run("track", f"vid={vid.folder}", f"source={path}", f"out={tmp_path / 'out.csv'}")
    assert done.code == 1 and word in done.err
    assert not list(tmp_path.glob("out*"))


def test_a_video_cut_short_is_tracked_as_far_as_it_goes_and_said_so(
    run: Run, vid: Vid, video: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.avi"
    data = video.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    done = run("track", f"vid={vid.folder}", f"source={cut}", f"out={tmp_path / 'cut.csv'}")
    assert done.code == 0, done.err
    rows = read(tmp_path / "cut.csv")
    assert 0 < len(rows) < 8 and "cut short" in done.out


def test_a_folder_without_pictures_and_a_picture_of_another_size_are_refused(
    run: Run, vid: Vid, tmp_path: Path
) -> None:
    (tmp_path / "none").mkdir()
    done = run("track", f"vid={vid.folder}", f"source={tmp_path / 'none'}", f"out={tmp_path / 'a.csv'}")
    assert done.code == 1 and "holds no picture" in done.err
    cv2.imwrite(str(tmp_path / "none" / "0.png"), np.zeros((50, 60), np.uint8))
    done = run("track", f"vid={vid.folder}", f"source={tmp_path / 'none'}", f"out={tmp_path / 'a.csv'}")
    assert done.code == 1 and "60 x 50" in done.err
    assert not list(tmp_path.glob("a*"))


def test_times_of_a_video_rise(video: Path) -> None:
    times = [moment.t_s for moment in open_source(video).moments()]
    assert len(times) == 8 and (np.diff(times) > 0).all()
    assert np.diff(times) == pytest.approx(0.1, abs=0.01)


def test_a_video_of_variable_rate_keeps_its_own_times(monkeypatch: pytest.MonkeyPatch, video: Path) -> None:
    class Uneven:
        """A video whose file gives its frames at 0, 0.1, 0.5 and 0.55 s, and then no times any more."""

        number, stamps = -1, (0.0, 0.1, 0.5, 0.55, 0.0, 0.0, 0.0, 0.0)

        def __init__(self, path: str) -> None:
            self.inner = plain(path)
            self.release = self.inner.release

        def read(self) -> Any:
            self.number += 1
            return self.inner.read()

        def get(self, what: int) -> float:
            assert what == cv2.CAP_PROP_POS_MSEC
            return 1e3 * self.stamps[min(max(self.number, 0), 7)]

    plain = cv2.VideoCapture
    source = open_source(video)
    monkeypatch.setattr(cv2, "VideoCapture", Uneven)
    times = [moment.t_s for moment in source.moments()]
    assert times[:4] == pytest.approx([0.0, 0.1, 0.5, 0.55])
    assert np.diff(times[3:]) == pytest.approx(0.1)  # evenly on, at the file's rate


def test_a_video_that_says_it_has_frames_and_gives_none_is_refused(tmp_path: Path, video: Path) -> None:
    path, data = tmp_path / "header.avi", video.read_bytes()
    path.write_bytes(data[: data.index(b"movi") + 4])  # the header of a video, without its frames
    with pytest.raises(InputError, match=r"(no frames|not a video) that can be read"):
        open_source(path)


def test_an_interruption_keeps_the_rows_so_far(vid: Vid, folder: Path, tmp_path: Path) -> None:
    whole = open_source(folder)

    def broken_off() -> Iterator[Moment]:
        for moment in whole.moments():
            if moment.frame == 5:
                raise KeyboardInterrupt
            yield moment

    def start(out: Path, source: Source) -> tuple[str, bool]:
        return track_source(Tracker(vid), source, out, None, False, silent)

    summary, finished = start(tmp_path / "a.csv", replace(whole, moments=broken_off))
    assert not finished and "interrupted after 5 pictures" in summary and "cut short" not in summary
    assert len(read(tmp_path / "a.csv")) == 5 and (tmp_path / "a.coverage.json").exists()
    summary, finished = start(tmp_path / "b.csv", replace(whole, moments=broken_off, live=True))
    assert finished and "interrupted" not in summary
    assert not list(tmp_path.glob("*.partial"))


def test_a_camera_that_fails_leaves_the_rows_so_far(vid: Vid, folder: Path, tmp_path: Path) -> None:
    whole = open_source(folder)

    def unplugged(after: int) -> Iterator[Moment]:
        for moment in whole.moments():
            if moment.frame == after:
                raise DeviceTimeoutError("no picture for 5 s")
            yield moment

    source = replace(whole, moments=lambda: unplugged(5), live=True)
    summary, finished = track_source(Tracker(vid), source, tmp_path / "a.csv", None, False, silent)
    assert not finished and "The camera failed, and the track ends there: no picture for 5 s" in summary
    assert len(read(tmp_path / "a.csv")) == 5
    with pytest.raises(DeviceTimeoutError):
        never = replace(whole, moments=lambda: unplugged(0), live=True)
        track_source(Tracker(vid), never, tmp_path / "b.csv", None, False, silent)


def test_a_camera_that_is_silent_for_a_moment_is_asked_again() -> None:
    class Stalls(CameraDevice):
        """A picture, silence, a picture, the end."""

        says = iter(["picture", "silence", "silence", "picture", "end"])

        def _open(self) -> None: ...
        def _close(self) -> None: ...
        def stop(self) -> None: ...
        def read(self, timeout_s: float = 1.0) -> Frame:
            said = next(self.says)
            if said != "picture":
                raise DeviceTimeoutError("no picture") if said == "silence" else SourceAtEndError("the end")
            return Frame(Stamp(0, 0.0, 0.0), np.zeros((4, 4), np.uint8))

    assert len(list(camera_source(Stalls(), None).moments())) == 2


@pytest.mark.parametrize("breaks", [False, True])
def test_a_camera_is_closed_at_its_end_and_after_an_error(breaks: bool) -> None:
    class Three(CameraDevice):
        """Three pictures, then its end, or a broken wire."""

        left = 3

        def _open(self) -> None: ...
        def _close(self) -> None: ...
        def stop(self) -> None: ...
        def read(self, timeout_s: float = 1.0) -> Frame:
            self.left -= 1
            if self.left < 0:
                raise DeviceTimeoutError("no picture") if breaks else SourceAtEndError("the end")
            return Frame(Stamp(self.left, 0.0, 0.0), np.zeros((4, 4), np.uint8))

    device = Three()
    source, seen = camera_source(device, None), 0
    assert source.live and not device.is_connected
    with pytest.raises(DeviceTimeoutError) if breaks else nullcontext():
        for _ in source.moments():
            seen += 1
            assert device.is_connected
    assert seen == 3 and not device.is_connected
