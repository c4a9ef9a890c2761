"""Cameras: pictures in order and byte for byte; one that stalls is noticed, opened anew, and said so."""

import logging
import threading
import time

import cv2
import numpy as np
import pytest
from clocks import Clock, does_not_hang, runs_on
from dialogue import wait_until

from ursnav_torch.devices import FolderCamera, OpenCvCamera, SourceAtEndError, VideoCamera
from ursnav_torch.errors import DeviceNotConnectedError, DeviceTimeoutError, InputError

rng = np.random.default_rng(0)


@pytest.fixture
def folder(tmp_path):
    for name, channels in (("b10.png", 0), ("b2.JPG", 3), ("a.tif", 0)):
        shape = (12, 16, 3) if channels else (12, 16)
        cv2.imwrite(str(tmp_path / name), rng.integers(0, 255, shape, dtype=np.uint8))
    (tmp_path / "notes.txt").write_text("not a picture")
    return tmp_path


def test_a_folder_comes_in_natural_order_with_the_files_own_bytes(folder):
    with FolderCamera(folder, fps=0) as camera:
        frames = [camera.read() for _ in range(3)]
        with pytest.raises(SourceAtEndError, match="at an end after 3"):
            camera.read()
    assert [f.source for f in frames] == ["a.tif", "b2.JPG", "b10.png"]
    assert [f.stamp.sequence for f in frames] == [0, 1, 2]
    for frame in frames:
        assert frame.encoded == (folder / frame.source).read_bytes()
        np.testing.assert_array_equal(frame.image, cv2.imread(str(folder / frame.source), cv2.IMREAD_UNCHANGED))


def test_pictures_come_at_their_rate_and_a_short_wait_times_out(folder, monkeypatch):
    clock = Clock()
    runs_on(clock, "ursnav_torch.devices.cameras", monkeypatch)
    with FolderCamera(folder, fps=10) as camera:
        camera.read()
        with pytest.raises(DeviceTimeoutError, match="not due within"):
            camera.read(timeout_s=0.02)
        camera.read()
    assert clock.slept == pytest.approx([0.0, 0.02, 0.08])


def test_a_video_comes_frame_by_frame(tmp_path):
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (32, 24))
    for n in range(5):
        writer.write(np.full((24, 32, 3), 50 * n, np.uint8))
    writer.release()
    with VideoCamera(path, fps=0) as camera:
        means = [camera.read().image.mean() for _ in range(5)]
    np.testing.assert_allclose(means, [0, 50, 100, 150, 200], atol=3)
    assert VideoCamera(path).fps == pytest.approx(25)


def test_pictures_that_do_not_suit_the_calibration_are_refused(folder):
    lens = folder / "lens.json"
    lens.write_text('{"model":"pinhole","width":99,"height":12,"fx":60,"fy":60,"cx":49,"cy":5.5}')
    with FolderCamera(folder, fps=0, calibration=lens) as camera, pytest.raises(InputError, match="16x12 pixels"):
        camera.read()
    assert camera.lens.width == 99


def test_folders_and_videos_that_cannot_be_used_are_refused(tmp_path):
    with pytest.raises(InputError, match="no picture in"):
        FolderCamera(tmp_path)
    with pytest.raises(InputError, match="not a video"):
        VideoCamera(tmp_path / "none.mp4")
    (tmp_path / "broken.png").write_bytes(b"nothing")
    cv2.imwrite(str(tmp_path / "good.png"), np.zeros((4, 4), np.uint8))
    with FolderCamera(tmp_path, fps=0) as camera:
        with pytest.raises(InputError, match=r"broken\.png is not a picture"):
            camera.read()
        assert camera.read().source == "good.png"


class Capture:
    """Stands in for cv2.VideoCapture: gives ``good`` pictures, then blocks as a hung driver does."""

    opened = 0
    hang = threading.Event()

    def __init__(self, source):
        Capture.opened += 1
        self.left = 3
        self.settings = {}

    def set(self, key, value):
        self.settings[key] = value

    def read(self):
        if self.left == 0:
            Capture.hang.wait(5.0)
            return False, None
        self.left -= 1
        time.sleep(0.01)
        return True, np.full((8, 10, 3), Capture.opened, np.uint8)

    def release(self): ...


def test_a_stalled_camera_is_noticed_reopened_and_said_so(caplog):
    Capture.opened = 0
    Capture.hang.clear()
    camera = OpenCvCamera(0, width=10, stall_s=0.2, capture=Capture)
    with camera, caplog.at_level(logging.WARNING):
        assert [camera.read().image[0, 0, 0] for _ in range(3)] == [1, 1, 1]
        with does_not_hang(), pytest.raises(DeviceTimeoutError, match=r"no picture within 0\.1 s"):
            while True:
                camera.read(timeout_s=0.1)
        with pytest.raises(DeviceTimeoutError):
            camera.read(timeout_s=0.15)
        frame = camera.read(timeout_s=1.0)
    Capture.hang.set()
    assert frame.image[0, 0, 0] == 2 and frame.stamp.sequence == 3
    assert camera.reopened == 1
    assert "opening it anew" in caplog.text


def test_a_camera_that_is_not_there_is_explained():
    class Absent(Capture):
        def read(self):
            return False, None

    with does_not_hang(), pytest.raises(DeviceNotConnectedError, match="plugged in"):
        OpenCvCamera(7, connect_s=0.2, capture=Absent).connect()
    with pytest.raises(DeviceNotConnectedError, match=r"connect\(\)"):
        OpenCvCamera(7, capture=Absent).read()
    assert wait_until(lambda: not [t for t in threading.enumerate() if t.name == "camera"])
