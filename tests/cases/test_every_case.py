"""Every file that was ever met badly, given to the runner that takes such files: an answer, or a refusal in words.

A refusal is one line that names the file; nobody is shown a Python error's name or a traceback.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ursnav_torch.vid import Vid

pytestmark = pytest.mark.slow

#: Files with many tests are begun first, so that none works on while the others are done.
PARTS = 24
#: ``KeyError``, ``numpy.linalg.LinAlgError``, a traceback, what the runners say of an error that nobody expected.
BARE = re.compile(r"\b\w*[a-z](?:Error|Exception)\b(?!=)|Traceback|HYDRA_FULL_ERROR")
LANDMARKS = "landmarks={file}"
TRACK = "vid={vid} source={frames} em_to_kidney={registration} em={file}"
LIVE = "hardware=simulated hardware/camera=none hardware/tracker=none duration_s=0.3"
#: The runner and overrides for files by how their names begin. Meshes are read alike by all: one in twelve is enough.
RUNNERS = {
    "camera": "match vid={vid} images={frames} camera=file camera.path={file}",
    "bom": "match vid={vid} images={frames} camera=file camera.path={file}",
    "fold": "build_vid camera=file camera.path={file}",
    "em": f"track {TRACK}",
    "registration": "track vid={vid} source={frames} em={em} em_to_kidney={file}",
    "landmarks": f"register {LANDMARKS}",
    "matches": "validate em={em} em_to_kidney={registration} matches={file}",
    "truth": "track vid={vid} source={frames} truth={file}",
    "track": "calibrate_tip em={em} track={file}",
    "image": "match vid={vid} images={file}",
    "15_stack": "match vid={vid} images={file}",
    "calyces": "segment kidney.path={scan} kidney.calyces={file}",
    "m.mrk": "segment kidney.path={scan} kidney.calyces={file}",
    "ucum": "segment kidney.path={scan} kidney.calyces={file}",
    "gamepad": f"teleop {LIVE} hardware/gamepad=scripted hardware.gamepad.path={{file}}",
    "mesh": "print_phantom kidney=mesh kidney.path={file}",
    "lumen": "print_phantom kidney=mesh kidney.path={file}",
    "session": "navigate vid={vid} hardware=replay hardware.path={session} viewer=none",
    "vid+sum": "match vid={copy} images={frames}",
} | dict.fromkeys(
    ("crash", "scan", "lab", "noheader", "nospacing", "pixdim0", "units_cm", "rle", "series"),
    "segment kidney.path={file}",
)  # fmt: skip


@pytest.fixture(scope="module")
def given(vid: Vid, cases: Path, picture: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What else a runner needs beside the file."""
    base = tmp_path_factory.mktemp("given")
    (base / "frames").mkdir()
    for n in range(4):
        cv2.imwrite(str(base / "frames" / f"{n}.png"), picture)
    (base / "registration.json").write_text(json.dumps({"R": np.eye(3).tolist(), "t_mm": [0, 0, 0]}), encoding="utf-8")
    rows = [f"{n},{n / 10},1,2,3,0,0,1" for n in range(4)]
    (base / "em.csv").write_text("\n".join(["frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz", *rows]), encoding="utf-8")
    words = {name: str(base / file) for name, file in (("frames", "frames"), ("em", "em.csv"))}
    scan = cases / "01-nifti-slope-intercept" / "control.nii.gz"
    return words | {"registration": str(base / "registration.json"), "vid": str(vid.folder), "scan": str(scan)}


def _inputs(cases: Path) -> list[Path]:
    """Files, and the folders of slices."""
    folders = {"rle", "series"}
    found = [p for p in sorted(cases.rglob("*")) if (p.is_dir() and p.name in folders) or p.is_file()]
    found = [p for p in found if not p.is_file() or p.parent.name not in folders | {"control"}]
    meshes = [p for p in found if p.name.startswith("mesh")]
    return [p for p in found if p not in meshes] + meshes[::12]


def _around(path: Path, vid: Path, folder: Path) -> dict[str, str]:
    """A session or a VID that has the file in it."""
    words = {"file": str(path)}
    name = re.sub(r"_[0-9a-f]{8}\.\w+$", "", path.name)
    if name.startswith("session_"):
        (folder / "s").mkdir()
        shutil.copy(path, folder / "s" / name.removeprefix("session_"))
        words["session"] = str(folder / "s")
    if name.startswith("vid+sum_"):
        shutil.copytree(vid, folder / "v")
        inner = folder / "v" / name.removeprefix("vid+sum_")
        shutil.copy(path, inner)
        _with_its_sum(folder / "v" / "vid.json", inner)
        words["copy"] = str(folder / "v")
    return words


def _with_its_sum(description: Path, inner: Path) -> None:
    """Where the VID tells its files' sums, those of the file as it is now."""
    try:
        text = description.read_text(encoding="utf-8")
        sums = json.loads(text)["files"]
    except (ValueError, KeyError, TypeError):
        return
    if inner.name in sums:
        description.write_text(text.replace(str(sums[inner.name]), hashlib.sha256(inner.read_bytes()).hexdigest()))


def _asked(cases: Path) -> list[tuple[Path, str]]:
    """Files that a runner takes, and its line."""
    lines = [
        (path, next((line for start, line in RUNNERS.items() if path.name.startswith(start)), None))
        for path in _inputs(cases)
    ]
    return [(path, line) for path, line in lines if line is not None]


def test_there_are_enough_cases(cases: Path) -> None:
    assert len(_asked(cases)) > 100


@pytest.mark.parametrize("part", range(PARTS))
def test_every_case_is_answered_or_refused_in_words(
    run: Callable[..., Any], given: dict[str, str], cases: Path, vid: Vid, tmp_path: Path, part: int
) -> None:
    wrong = []
    for number, (path, line) in enumerate(_asked(cases)[part::PARTS]):
        folder = tmp_path / str(number)
        folder.mkdir()
        words = given | _around(path, vid.folder, folder)
        runner, *overrides = [part.format(**words) for part in line.split(" ")]
        out = f"out={folder / 'out'}" + (
            "" if runner in ("segment", "build_vid", "print_phantom", "navigate") else ".csv"
        )
        overrides += [out] if runner != "teleop" else []
        done = run(runner, *overrides)
        said = done.out + done.err
        rows = (folder / "out.csv").read_text(encoding="utf-8") if done.code == 3 else ""
        if done.code not in (0, 1, 3) or BARE.search(said + rows) or (done.code == 1 and said.count("error:") != 1):
            wrong.append(f"{path.name}: {runner} gives {done.code}: {said}")
    assert not wrong, "\n".join(wrong)
