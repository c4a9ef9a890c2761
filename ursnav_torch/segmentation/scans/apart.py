"""Scans are read in a process apart: the readers of medical formats are large C++ libraries that damaged files kill.

A server is started with the first scan and stays, single-threaded, without ITK's threads; for each scan it forks a
child with limits of time and memory, which reads and writes down voxels and place. What ends the child ends nothing
else.
"""

import atexit
import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import ursnav_torch
from ursnav_torch.errors import InputError, MissingExtraError, UrsnavError
from ursnav_torch.segmentation.scans.headers import ScanHeader
from ursnav_torch.segmentation.scans.read import LARGEST_VOXELS, dicom_files_here, read_scan_here, simple_itk
from ursnav_torch.segmentation.scans.scan import Scan

#: Most address space of a child: the largest scan that is accepted, 8 bytes a voxel in the file, and as 16 bits.
MOST_BYTES = 12 << 30
#: Seconds of a processor for a small file; each megabyte of it, packed or not, may take one more.
READ_S = 10
#: A busy machine or a slow disk may stretch these.
STRETCH = 20

_lock = threading.Lock()
_server: "subprocess.Popen[str] | None" = None


def read_scan(
    path: Path | str,
    series: str | None = None,
    largest_voxels: int = LARGEST_VOXELS,
    header: ScanHeader | None = None,
) -> Scan:
    """A scan or label map from a NIfTI, NRRD or MetaImage file, a DICOM file with many slices, or a folder of slices.

    Args:
        path: file or folder.
        series: UID of the series to take where a folder holds several.
        largest_voxels: files that declare more are refused before memory is taken for them.
        header: the user's word on the geometry, in place of the file's.

    Raises:
        InputError: see `read_scan_here`; or the file makes its reader crash, or read without end.
        MissingExtraError: SimpleITK is not installed.
    """
    simple_itk()
    path = Path(path)
    if not hasattr(os, "fork"):  # Windows
        return read_scan_here(path, series, largest_voxels, header)
    with tempfile.TemporaryDirectory(prefix="ursnav_scan_") as folder:
        more = {"largest_voxels": largest_voxels, "header": dataclasses.asdict(header or ScanHeader())}
        told = _told(path, folder, {"series": series, **more})
        voxels = np.load(Path(folder) / "voxels.npy", allow_pickle=False)
    return Scan(voxels, np.array(told["T_lps_voxel"]), told["source"], told["names"])


def dicom_files(folder: Path | str, series: str | None = None) -> tuple[str, ...]:
    """The files of the one DICOM series in a folder, from the first slice to the last, checked as `read_scan` does.

    Args:
        folder: of the slices.
        series: its UID where there are several.

    Raises:
        InputError: see `series_files`; or a file makes the library that sorts them crash, or take memory without end.
        MissingExtraError: SimpleITK is not installed.
    """
    simple_itk()
    folder = Path(folder)
    if not hasattr(os, "fork"):
        return dicom_files_here(folder, series)
    with tempfile.TemporaryDirectory(prefix="ursnav_series_") as answers:
        told = _told(folder, answers, {"series": series, "names_alone": True})
    return tuple(told["files"])


def _told(path: Path, answers: str, request: dict[str, Any]) -> dict[str, Any]:
    """What a child answers to a request for a file or folder, in a folder for its answers.

    Raises:
        InputError: its own, or it ended without an answer.
        MissingExtraError: its own.
    """
    whole = request | {"path": str(path.absolute()), "folder": answers}
    status = _ask(whole | {"seconds": READ_S + _size(path) // 1_000_000})
    answer = Path(answers) / "answer.json"
    if os.WIFSIGNALED(status) or not answer.exists():
        raise InputError(_why_dead(path, status))
    told: dict[str, Any] = json.loads(answer.read_text(encoding="utf-8"))
    if "error" in told:
        kind = MissingExtraError if told["kind"] == "MissingExtraError" else InputError
        raise kind(told["error"].replace(str(path.absolute()), str(path)))
    for note in told["notes"]:
        warnings.warn(note.replace(str(path.absolute()), str(path)), stacklevel=3)
    return told


def _why_dead(path: Path, status: int) -> str:
    number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if number in (signal.SIGXCPU, signal.SIGALRM):
        return f"{path} cannot be read as a scan: its reader did not come to an end. Export or copy it again."
    name = signal.Signals(number).name if number else f"exit code {os.waitstatus_to_exitcode(status)}"
    return f"{path} cannot be read as a scan: its reader crashed ({name}), so it is damaged. Export or copy it again."


def _size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    with contextlib.suppress(OSError):
        return sum(p.stat().st_size for p in path.iterdir()) if path.is_dir() else path.stat().st_size
    return 0


def _ask(request: dict[str, Any]) -> int:
    """Have one scan read; how the child ended, as `os.waitpid` says it.

    Raises:
        InputError: the server went away.
    """
    global _server
    with _lock:
        if _server is None or _server.poll() is not None:
            _stop()
            _server = _start()
        assert _server.stdin is not None and _server.stdout is not None
        try:
            print(json.dumps(request), file=_server.stdin, flush=True)
            return int(_server.stdout.readline())
        except (OSError, ValueError) as error:
            _stop()
            raise InputError(f"The process that reads scans went away ({error}); give the command again.") from None


def _start() -> "subprocess.Popen[str]":
    place = os.pathsep.join([str(Path(ursnav_torch.__file__).parent.parent), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-c", "from ursnav_torch.segmentation.scans.apart import serve; serve()"]
    environment = os.environ | {"PYTHONPATH": place}
    atexit.register(_stop)
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)


def _stop() -> None:
    global _server
    if _server is not None:
        _server.kill()
        with _server:
            pass
        _server = None


def serve() -> None:
    """The server: a request a line, a child for each, and how it ended as the answer; ends with its input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that asks
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            _read(json.loads(line))
            os._exit(0)
        print(os.waitpid(child, 0)[1], flush=True)


def _read(request: dict[str, Any]) -> None:
    """The child: read within limits, write down what was found or why not."""
    import resource  # POSIX only, as this child is

    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (request["seconds"], request["seconds"] + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.alarm(STRETCH * request["seconds"])
    folder = Path(request["folder"])
    try:
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always", UserWarning)
            told = _files(request) if request.get("names_alone") else _scan(request, folder)
        told["notes"] = [str(note.message) for note in notes if note.category is UserWarning]
    except UrsnavError as error:
        told = {"error": str(error), "kind": type(error).__name__}
    except (Exception, MemoryError) as error:
        traceback.print_exc(file=sys.stderr) if os.environ.get("HYDRA_FULL_ERROR") == "1" else None
        told = {"error": _odd(request["path"], error), "kind": "InputError"}
    draft = folder / "answer.new"
    draft.write_text(json.dumps(told), encoding="utf-8")
    os.replace(draft, folder / "answer.json")


def _files(request: dict[str, Any]) -> dict[str, Any]:
    return {"files": dicom_files_here(Path(request["path"]), request["series"])}


def _scan(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    """What there is to say of a scan, whose voxels lie in the folder for answers."""
    scan = read_scan_here(
        request["path"], request["series"], request["largest_voxels"], ScanHeader(**request["header"])
    )
    np.save(folder / "voxels.npy", scan.voxels)
    return {"T_lps_voxel": scan.T_lps_voxel.tolist(), "source": scan.source, "names": scan.names}


def _odd(path: str, error: Exception) -> str:
    why = "it takes more memory than is given" if isinstance(error, MemoryError) else f"its reader stumbled: {error}"
    return f"{path} cannot be read as a scan ({why[:200]}). Export or copy it again."
