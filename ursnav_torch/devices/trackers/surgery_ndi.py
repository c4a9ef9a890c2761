"""NDI trackers through scikit-surgerynditracker (extra ``ndi``): Vega by network, Polaris with tool files, Aurora.

The package holds Python's lock while it waits for the unit, and its reads have no deadline. It therefore runs in a
process of its own (this file, run as a module) that prints one JSON line a frame.
"""

import json
import math
import subprocess
import sys
import time
from queue import Empty, Queue
from threading import Thread
from typing import Any

from ursnav_torch.devices.base import EmTracker, TrackerSample
from ursnav_torch.devices.wire import SensorPose, Tool
from ursnav_torch.errors import DeviceNotConnectedError, DeviceTimeoutError, InputError
from ursnav_torch.extras import import_extra


class SurgeryNdiTracker(EmTracker):
    """A tool of an NDI tracker, read by scikit-surgerynditracker in a child process.

    Args:
        settings: that package's configuration, such as ``{"tracker type": "vega", "ip address": "192.168.2.17",
            "port": 8765, "romfiles": ["scope.rom"]}``.
        tool: which of the tools, counted from 0.
        dof: 5 for a sensor that does not know its roll, 6 otherwise.
        connect_s: how long the tracker may take to start.

    Raises:
        InputError: ``dof`` is neither 5 nor 6.
    """

    def __init__(self, settings: dict[str, Any], tool: int = 0, dof: int = 6, connect_s: float = 20.0) -> None:
        super().__init__()
        if dof not in (5, 6):
            raise InputError(f"dof must be 5 or 6, got {dof}.")
        self.settings, self.tool, self.dof, self.connect_s = dict(settings), tool, dof, connect_s
        self._process: subprocess.Popen[str] | None = None
        self._lines: Queue[str] = Queue()

    def read(self, timeout_s: float = 1.0) -> TrackerSample:
        """Wait for the next frame; raises as `EmTracker.read` does."""
        self._check_connected()
        return self._sample(json.loads(self._line(timeout_s)))

    def _sample(self, row: dict[str, Any]) -> TrackerSample:
        pose = None
        if row["pose"] is not None:
            w, x, y, z, *position = row["pose"]
            pose = SensorPose.from_quaternion([x, y, z, w], position)
        return Tool(str(self.tool), self.dof).sample(self._stamp(), pose, int(row["frame"]), row["error_mm"])

    def _line(self, timeout_s: float) -> str:
        try:
            line = self._lines.get(timeout=timeout_s)
        except Empty:
            raise DeviceTimeoutError(f"The NDI tracker gave no new frame within {timeout_s} s.") from None
        if not line.startswith("{"):
            raise DeviceNotConnectedError(f"scikit-surgerynditracker ended: {line.strip() or 'no reason given'}")
        return line

    def _open(self) -> None:
        import_extra("sksurgerynditracker.nditracker", "ndi", "An NDI tracker through scikit-surgerynditracker")
        command = [sys.executable, "-m", __name__, json.dumps(self.settings), str(self.tool)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._lines = Queue()
        Thread(target=_pump, args=(self._process, self._lines), name="surgery-ndi", daemon=True).start()
        self._line(self.connect_s)

    def _close(self) -> None:
        if self._process is None:
            return
        assert self._process.stdin is not None
        self._process.stdin.close()  # the child ends when this pipe does
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process = None


def _pump(process: "subprocess.Popen[str]", lines: "Queue[str]") -> None:
    """Move the child's lines to a queue; a last line says how it ended."""
    last = ""
    assert process.stdout is not None
    with process.stdout:
        for line in process.stdout:
            last = line
            if line.startswith("{"):
                lines.put(line)
    lines.put(last if not last.startswith("{") else "closed")


def _serve(settings: dict[str, Any], tool: int) -> None:
    """Print one JSON line for every new frame until standard input ends."""
    from sksurgerynditracker.nditracker import NDITracker

    tracker = NDITracker(settings | {"use quaternions": True})
    tracker.start_tracking()
    ended = Thread(target=sys.stdin.read, daemon=True)
    ended.start()
    before = -1.0
    while ended.is_alive():
        _, _, frames, poses, errors = tracker.get_frame()
        if len(frames) <= tool:
            sys.exit(f"the tracker has {len(frames)} tools, number {tool} (from 0) is wanted")
        if frames[tool] != before:
            before = float(frames[tool])
            pose = [float(v) for v in poses[tool].ravel()]
            error = float(errors[tool])
            seen = not math.isnan(pose[4])
            row = {"frame": before, "pose": pose if seen else None, "error_mm": error if seen else None}
            print(json.dumps(row), flush=True)
        time.sleep(0.004)
    tracker.stop_tracking()
    tracker.close()


if __name__ == "__main__":
    _serve(json.loads(sys.argv[1]), int(sys.argv[2]))
