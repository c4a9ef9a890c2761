"""Writing a session: one folder with JSON lines, one file a picture, snapshots, configuration and versions.

The folder is ``NAME.partial`` while the session runs and gets its name when it ends. A picture's file is complete
before the line that names it is written, and every line is handed to the system at once: whatever byte a crash
cuts the record at, what was written before can be read.
"""

import contextlib
import json
import logging
import os
import platform
import time
import zlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2

from ursnav_torch.columns import EM_COLUMNS
from ursnav_torch.devices import Frame
from ursnav_torch.errors import InputError
from ursnav_torch.files import cell, check_output, commit
from ursnav_torch.locks import locked, partial_path
from ursnav_torch.session.events import Event, Snapshot, to_line

logger = logging.getLogger(__name__)
FORMAT = 1
EVENTS, FRAMES, SNAPSHOTS, ABOUT = "events.jsonl", "frames", "snapshots", "session.json"
SYNC_S = 2.0
PACKAGES = ("ursnav-torch", "numpy", "torch", "opencv-python-headless", "pyserial")


class Recorder:
    """Writes a session; use it in a ``with`` block, `write` each event once.

    Args:
        path: the folder to make.
        config: what the session was configured with, as plain data.
        overwrite: replace an existing record, or an interrupted one.

    Raises:
        InputError: there is no ``path``, it exists, an interrupted record of that name does, or another process writes
            it.
    """

    def __init__(
        self, path: str | Path | None, config: Mapping[str, Any] | None = None, overwrite: bool = False
    ) -> None:
        if path is None:
            raise InputError("A session is to be recorded, but not where; add out=FOLDER.")
        self.path = Path(path)
        self.config = dict(config or {})
        self._overwrite = overwrite
        self._folder = partial_path(self.path)
        self._events = -1
        self._written: dict[str, int] = {}
        self._last_frame: tuple[int, str] | None = None
        self._snapshots = 0
        self._synced_s = 0.0
        self._lock = contextlib.ExitStack()

    @property
    def written(self) -> dict[str, int]:
        """How many events of each kind were written."""
        return dict(self._written)

    def write(self, event: Event) -> None:
        """Append an event.

        Raises:
            InputError: the disk is full or gone.
        """
        try:
            if isinstance(event, Frame):
                self._line(event, **self._save(event))
            elif isinstance(event, Snapshot):
                self._line(event, image=self._save_snapshot(event))
            else:
                self._line(event)
        except OSError as error:
            raise InputError(f"The session cannot be written to {self._folder}: {error.strerror}.") from error
        name = type(event).__name__
        self._written[name] = self._written.get(name, 0) + 1

    def __enter__(self) -> Self:
        check_output(self.path, self._overwrite)
        with contextlib.ExitStack() as stack:
            stack.enter_context(locked(self.path))
            self._open()
            self._lock = stack.pop_all()  # held until the session ends, or its process does
        return self

    def _open(self) -> None:
        """Make the folder, say what will be in it, and open the file of events."""
        if self._folder.exists() and not self._overwrite:
            raise InputError(
                f"{self._folder} is an interrupted record. Keep it under another name (it can be replayed as it is), "
                "or add overwrite=true."
            )
        if self._folder.exists():
            _remove(self._folder)
        (self._folder / FRAMES).mkdir(parents=True)
        about = {"format": FORMAT, "started_wall_s": time.time(), "versions": _versions(), "config": self.config}
        text = json.dumps(about, indent=1, ensure_ascii=False)
        (self._folder / ABOUT).write_text(text + "\n", encoding="utf-8")
        self._events = os.open(self._folder / EVENTS, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._events >= 0:
            with contextlib.suppress(OSError):  # a full disk was said when the event could not be written
                os.fsync(self._events)
            os.close(self._events)
            self._events = -1
            with self._lock:
                commit(self._folder, self.path)

    def _line(self, event: Event, **extra: Any) -> None:
        line = (to_line(event, **extra) + "\n").encode("utf-8")
        while line:  # a disk that is nearly full takes a part
            line = line[os.write(self._events, line) :]
        now = time.monotonic()
        if now - self._synced_s > SYNC_S:
            getattr(os, "fdatasync", os.fsync)(self._events)
            self._synced_s = now

    def _save(self, frame: Frame) -> dict[str, Any]:
        """Write a picture's file: the camera's own bytes, else PNG without loss."""
        encoded, suffix = frame.encoded, frame.suffix
        if encoded is None:
            encoded, suffix = cv2.imencode(".png", frame.image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes(), "png"
        name = f"{FRAMES}/{frame.stamp.sequence:08d}.{suffix}"
        (self._folder / name).write_bytes(encoded)
        self._last_frame = (frame.stamp.sequence, name)
        kept = frame.encoded is not None
        return {"file": name, "bytes": len(encoded), "crc32": zlib.crc32(encoded), "kept": kept}

    def _save_snapshot(self, snapshot: Snapshot) -> str:
        """Copy the picture among the snapshots and add its EM sample, in the form that ``validate`` reads."""
        if snapshot.frame is None or self._last_frame is None or self._last_frame[0] != snapshot.frame.stamp.sequence:
            return ""
        folder = self._folder / SNAPSHOTS
        folder.mkdir(exist_ok=True)
        source = self._folder / self._last_frame[1]
        name = f"{self._snapshots:04d}{source.suffix}"
        (folder / name).write_bytes(source.read_bytes())
        self._snapshots += 1
        em, t = snapshot.tracker, snapshot.stamp.t_wall_s
        values = [*em.position_mm, *em.axis] if em and em.position_mm and em.axis else [None] * 6
        with (folder / "em.csv").open("a", encoding="utf-8") as file:
            if file.tell() == 0:
                file.write(",".join(("image", "t_s", *EM_COLUMNS)) + "\n")
            file.write(",".join([name, f"{t:.6f}", *map(cell, values)]) + "\n")
        return f"{SNAPSHOTS}/{name}"


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _remove(folder: Path) -> None:
    """Delete an interrupted record, and nothing that does not look like one."""
    if not (folder / ABOUT).is_file():
        raise InputError(f"{folder} is no interrupted record; remove it by hand.")
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()
