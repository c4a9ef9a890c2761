"""Cameras: a video device or stream through OpenCV, a video file, a folder of pictures."""

import contextlib
import logging
import os
import queue
import re
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch import camera as lenses
from ursnav_torch.devices.base import CameraDevice, Frame, SourceAtEndError
from ursnav_torch.errors import DeviceNotConnectedError, DeviceTimeoutError, InputError
from ursnav_torch.inputs import read_regular
from ursnav_torch.pictures import MOST_BYTES, decode_picture, to_8_bit

logger = logging.getLogger(__name__)
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
Image = NDArray[np.uint8]


class LensCamera(CameraDevice):
    """A camera that knows its lens.

    Args:
        calibration: the camera JSON of the calibration; None when it is not known.

    Raises:
        InputError: the calibration file cannot be used.
    """

    def __init__(self, calibration: str | Path | None) -> None:
        super().__init__()
        self.lens = None if calibration is None else lenses.load_camera(calibration)

    def _check_size(self, image: Image) -> None:
        """Refuse pictures that the calibration was not made for; those scaled by one ratio are put back later."""
        if self.lens and lenses.scaled_to(image, self.lens).shape[:2] != (self.lens.height, self.lens.width):
            height, width = image.shape[:2]
            raise InputError(
                f"The camera gives {width}x{height} pixels, its calibration is for {self.lens.width}x"
                f"{self.lens.height}; set the camera to that size or calibrate it as it is."
            )


class OpenCvCamera(LensCamera):
    """A UVC camera or a stream, read by a thread of its own so that a camera that hangs hangs nobody else.

    When no picture has come for ``stall_s`` the camera is given up and opened anew, again and again; a log warning
    says so, and `reopened` counts it. `read` raises DeviceTimeoutError meanwhile.

    Args:
        source: index of a UVC camera, or a URL or device path.
        width, height, fps: asked from the camera; 0 leaves its own choice.
        calibration: camera JSON, or None.
        stall_s: silence after which the camera is opened anew.
        connect_s: how long the first picture may take.
        capture: opens ``source``; OpenCV's VideoCapture.
    """

    def __init__(
        self,
        source: int | str = 0,
        width: int = 0,
        height: int = 0,
        fps: float = 0.0,
        calibration: str | Path | None = None,
        stall_s: float = 1.0,
        connect_s: float = 5.0,
        capture: Callable[..., cv2.VideoCapture] = cv2.VideoCapture,
    ) -> None:
        super().__init__(calibration)
        self.source, self.stall_s, self.connect_s, self.reopened = source, stall_s, connect_s, 0
        self._wanted = {cv2.CAP_PROP_FRAME_WIDTH: width, cv2.CAP_PROP_FRAME_HEIGHT: height, cv2.CAP_PROP_FPS: fps}
        self._capture = capture
        self._frames: queue.Queue[Frame] = queue.Queue(maxsize=4)
        self._end = threading.Event()  # of the present reading thread
        self._last_s = 0.0
        self._first: Frame | None = None

    def read(self, timeout_s: float = 1.0) -> Frame:
        """Wait for the next picture; raises as `CameraDevice.read` does."""
        self._check_connected()
        if self._first is not None:
            frame, self._first = self._first, None
            return frame
        try:
            frame = self._frames.get(timeout=timeout_s)
        except queue.Empty:
            self._reopen_if_stalled()
            raise DeviceTimeoutError(f"Camera {self.source} gave no picture within {timeout_s} s.") from None
        self._last_s = time.monotonic()
        return frame

    def _reopen_if_stalled(self) -> None:
        silent = time.monotonic() - self._last_s
        if silent > self.stall_s:
            self.reopened += 1
            logger.warning("Camera %s gave no picture for %.1f s; opening it anew.", self.source, silent)
            self._start()

    def _start(self) -> None:
        """Leave the old thread to itself (it may hang in the driver) and start a new one."""
        self._end.set()
        self._end, self._frames = threading.Event(), queue.Queue(maxsize=4)
        self._last_s = time.monotonic()
        worker = threading.Thread(target=self._run, args=(self._end, self._frames), name="camera", daemon=True)
        worker.start()

    def _run(self, end: threading.Event, frames: "queue.Queue[Frame]") -> None:
        capture = self._capture(self.source)
        try:
            for key, value in self._wanted.items():
                if value:
                    capture.set(key, value)
            while not end.is_set():
                ok, image = capture.read()
                if not ok:
                    end.wait(0.05)
                    continue
                with contextlib.suppress(queue.Empty):
                    if frames.full():  # nobody reads: the newest pictures matter, a gap in the numbers tells
                        frames.get_nowait()
                frames.put(Frame(self._stamp(), image))
        finally:
            capture.release()

    def _open(self) -> None:
        self._start()
        try:
            self._first = self._frames.get(timeout=self.connect_s)
        except queue.Empty:
            raise DeviceNotConnectedError(
                f"Camera {self.source} gives no picture. Is it plugged in, is another program using it, and may you "
                "use it (on Linux: are you in the group 'video')?"
            ) from None
        self._check_size(self._first.image)

    def _close(self) -> None:
        self._end.set()


class _PlayedCamera(LensCamera):
    """Pictures that exist already, given out at ``fps`` or, with 0, as fast as they are read."""

    def __init__(self, fps: float, calibration: str | Path | None) -> None:
        super().__init__(calibration)
        if fps < 0:
            raise InputError(f"fps must be 0 or more, got {fps}.")
        self.fps = fps
        self._next, self._start_s = 0, 0.0

    def read(self, timeout_s: float = 1.0) -> Frame:
        """Wait for the next picture's time; raises as `CameraDevice.read` does.

        Raises:
            InputError: that picture cannot be read or has another size than the calibration; the next call goes on.
        """
        self._check_connected()
        if self.fps:
            wait = self._start_s + self._next / self.fps - time.monotonic()
            time.sleep(max(0.0, min(wait, timeout_s)))
            if wait > timeout_s:
                raise DeviceTimeoutError(f"The next picture is not due within {timeout_s} s.")
        number, stamp = self._next, self._stamp()
        self._next += 1
        image, encoded, suffix, source = self._picture(number)
        self._check_size(image)
        return Frame(stamp, image, encoded, suffix, source)

    @abstractmethod
    def _picture(self, number: int) -> tuple[Image, bytes | None, str, str]:
        """Picture, own bytes, file type and name of the picture ``number``; asked for in order from 0.

        Raises:
            SourceAtEndError: there are no more.
        """

    def _open(self) -> None:
        self._next, self._start_s = 0, time.monotonic()


class FolderCamera(_PlayedCamera):
    """The pictures of a folder in natural name order, gray or color as they are; their files' bytes are passed on.

    Raises:
        InputError: there is no picture in the folder.
    """

    def __init__(self, folder: str | Path, fps: float = 15.0, calibration: str | Path | None = None) -> None:
        super().__init__(fps, calibration)
        self.folder = Path(folder)
        names = os.listdir(self.folder) if self.folder.is_dir() else []
        self.names = sorted((n for n in names if n.lower().endswith(IMAGE_SUFFIXES)), key=_natural)
        if not self.names:
            raise InputError(f"There is no picture in {self.folder}; expected files {' '.join(IMAGE_SUFFIXES)}.")

    def _picture(self, number: int) -> tuple[Image, bytes | None, str, str]:
        if number >= len(self.names):
            raise SourceAtEndError(f"The pictures of {self.folder} are at an end after {len(self.names)}.")
        path = self.folder / self.names[number]
        encoded = read_regular(path, "picture", MOST_BYTES)
        return decode_image(encoded, str(path)), encoded, path.suffix[1:].lower(), path.name

    def _close(self) -> None: ...


class VideoCamera(_PlayedCamera):
    """The pictures of a video file.

    Args:
        path: the file.
        fps: pictures a second; None for the video's own, 0 for as fast as they are read.
        calibration: camera JSON, or None.

    Raises:
        InputError: there is no such file, or OpenCV cannot read it.
    """

    def __init__(self, path: str | Path, fps: float | None = None, calibration: str | Path | None = None) -> None:
        self.path = Path(path)
        self._capture = self._opened()
        own = float(self._capture.get(cv2.CAP_PROP_FPS)) or 15.0
        self._capture.release()
        super().__init__(own if fps is None else fps, calibration)

    def _picture(self, number: int) -> tuple[Image, bytes | None, str, str]:
        ok, image = self._capture.read()
        if not ok:
            raise SourceAtEndError(f"{self.path} is at an end after {number} pictures.")
        return image, None, "png", str(number)

    def _opened(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self.path)) if self.path.is_file() else None
        if capture is None or not capture.isOpened():
            raise InputError(f"{self.path} is not a video that OpenCV can read.")
        return capture

    def _open(self) -> None:
        super()._open()
        self._capture = self._opened()

    def _close(self) -> None:
        self._capture.release()


def decode_image(encoded: bytes, where: str) -> Image:
    """The picture in a file's bytes, uint8 (H, W) or (H, W, 3) in OpenCV's order; 16 bits are scaled by its maximum.

    Raises:
        InputError: the bytes are no picture, or too large a one; ``where`` names them.
    """
    image = decode_picture(encoded, where)
    if image is None:
        raise InputError(f"{where} is not a picture that can be read.")
    return to_8_bit(image)


def _natural(name: str) -> list[tuple[int, int, str]]:
    """A sort key by which frame2 comes before frame10."""
    return [(int(p), 0, "") if p.isdigit() else (-1, 1, p.lower()) for p in re.split(r"(\d+)", name) if p]
