"""What kills the reader of a scan ends in a sentence, and the next scan is read."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation import Scan, read_scan, write_scan
from ursnav_torch.segmentation.scans import apart
from ursnav_torch.segmentation.scans.read import read_scan_here

pytest.importorskip("SimpleITK")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    voxels = np.random.default_rng(0).integers(-1000, 1000, (9, 8, 7)).astype(np.int16)
    write_scan(Scan(voxels, np.diag([0.7, 0.8, 0.9, 1.0]), "made"), tmp_path / "scan.nrrd")
    return tmp_path / "scan.nrrd"


def test_the_same_scan_comes_back(scan: Path) -> None:
    here, there = read_scan_here(scan), read_scan(scan)
    np.testing.assert_array_equal(there.voxels, here.voxels)
    np.testing.assert_array_equal(there.T_lps_voxel, here.T_lps_voxel)
    assert (there.source, there.names, there.voxels.dtype) == (here.source, here.names, here.voxels.dtype)


@pytest.mark.parametrize("digits", [400, 5000, 100_000])
def test_a_header_that_crashes_itk_is_a_sentence(scan: Path, digits: int) -> None:
    """A number of 5,000 digits kills ITK by SIGSEGV."""
    head, _, data = scan.read_bytes().partition(b"\n\n")
    lines = [b"sizes: " + b"9" * digits + b" 8 7" if line.startswith(b"sizes:") else line for line in head.split(b"\n")]
    bad = scan.with_name("bad.nrrd")
    bad.write_bytes(b"\n".join(lines) + b"\n\n" + data)
    with pytest.raises(InputError, match=r"bad\.nrrd (cannot be read as a scan|declares|has the size)"):
        read_scan(bad)
    assert read_scan(scan).voxels.shape == (9, 8, 7)


def test_known_killers_are_sentences() -> None:
    cases = Path(os.environ.get("URSNAV_CASES", "/nowhere")) / "fuzz"
    if not cases.is_dir():
        pytest.skip("URSNAV_CASES does not name the folder of inputs that broke something")
    killers = [p for p in cases.iterdir() if p.suffix == ".nrrd"]
    assert len(killers) >= 3
    for path in killers:
        with pytest.raises(InputError):
            read_scan(path)


@pytest.mark.parametrize(
    ("number", "said"), [(signal.SIGSEGV, r"crashed \(SIGSEGV\)"), (signal.SIGXCPU, "did not come to an end")]
)
def test_the_way_it_died_is_told(scan: Path, monkeypatch: pytest.MonkeyPatch, number: int, said: str) -> None:
    monkeypatch.setattr(apart, "_ask", lambda request: number)
    with pytest.raises(InputError, match=said):
        read_scan(scan)


def test_a_server_that_was_killed_is_started_again(scan: Path) -> None:
    read_scan(scan)
    assert apart._server is not None
    apart._server.kill()
    apart._server.wait()
    assert read_scan(scan).voxels.shape == (9, 8, 7)


def test_a_read_without_end_is_ended(scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = scan.with_name("pipe.nrrd")
    os.mkfifo(bad)
    with pytest.raises(InputError, match="There is no scan"):
        read_scan(bad)
