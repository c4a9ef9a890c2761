"""The runner ``build_vid``: interrupted, repeated, given bad input."""

import json
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import trimesh

from ursnav_torch.kidney import Kidney, write_calyces
from ursnav_torch.tables import read_csv
from ursnav_torch.vid import Vid, export_thesis, load_vid

SMALL = (
    "kidney=phantom", "kidney.calyces=6", "camera.width=64", "camera.height=64", "views.views_per_calyx=15",
    "views.passage_views=20", "calibrate=false",
)  # fmt: skip
FILES = [
    "calyces.csv",
    "centerline.csv",
    "features.safetensors",
    "images",
    "images.sha256",
    "kidney.stl",
    "lumen.safetensors",
    "vid.json",
    "views.csv",
]


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """150 views, built in one go by two workers."""
    out = tmp_path_factory.mktemp("whole") / "vid"
    build = started(out, "workers=2")
    err = build.communicate(timeout=300)[1]
    assert build.returncode == 0, err
    return out


def started(out: Path, *overrides: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "ursnav_torch.build_vid", *SMALL, f"out={out}", *overrides]
    heed = partial(signal.signal, signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=out.parent, preexec_fn=heed)


def test_the_folder_is_as_the_contract_says(whole: Path) -> None:
    assert sorted(p.name for p in whole.iterdir()) == FILES
    assert [p.name for p in whole.parent.iterdir()] == ["vid"], "nothing else is written in the caller's folder"
    rows = read_csv(whole / "views.csv", ["view"], "views")
    assert list(rows[0]) == ["view", "calyx", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"]
    assert len(rows) == 150 == len(list((whole / "images").glob("*.png")))
    assert list(read_csv(whole / "calyces.csv", ["calyx"], "calyces")[0])[:4] == ["calyx", "x_mm", "y_mm", "z_mm"]
    about = json.loads((whole / "vid.json").read_text(encoding="utf-8"))
    assert {"format", "camera", "kidney", "features", "package_version", "sha256"} <= set(about)
    assert "_target_" not in json.dumps(about), "plain data, never instantiated"


@pytest.mark.slow
@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, 1), (signal.SIGKILL, 2)])
def test_an_interrupted_build_goes_on_to_the_same_bytes(
    run: Any, whole: Path, tmp_path: Path, number: signal.Signals, workers: int
) -> None:
    out, shard = tmp_path / "vid", tmp_path / "vid.partial" / "shards" / "00000.safetensors"
    build = started(out, f"workers={workers}")
    while not shard.exists():
        assert build.poll() is None, build.communicate()[1]
        time.sleep(0.01)
    children = Path(f"/proc/{build.pid}/task/{build.pid}/children").read_text(encoding="utf-8").split()
    build.send_signal(number)
    err = build.communicate(timeout=120)[1]
    assert not out.exists() and (tmp_path / "vid.partial").exists()
    if number == signal.SIGINT:
        assert build.returncode == 1 and err.splitlines()[-1].startswith("interrupted:") and "Traceback" not in err
    until = time.monotonic() + 60
    while any(alive(child) for child in children):
        assert time.monotonic() < until, "a worker outlives its build"
        time.sleep(0.1)
    kept = shard.stat().st_mtime_ns
    done = run("build_vid", *SMALL, f"out={out}", "workers=1")
    assert (done.code, done.err) == (0, "") and done.out.startswith(f"150 views in {out}")
    assert content(out) == content(whole) and not (tmp_path / "vid.partial").exists()
    assert kept < (out / "vid.json").stat().st_mtime_ns


def alive(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_results_are_not_replaced_unasked(run: Any, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "vid"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    done = run("build_vid", *SMALL, f"out={out}")
    assert done.code == 1 and "exists already" in done.err and done.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith("vid")] == ["vid"] and (out / "mine.txt").exists()
    done = run("build_vid", *SMALL, f"out={out}", "overwrite=true", "workers=1")
    assert done.code == 0 and content(out) == content(whole)
    assert not (tmp_path / "vid.old").exists()


@pytest.fixture
def user_files(phantom: Kidney, tmp_path: Path) -> Path:
    """A lumen, its tips and a lens in a folder of awkward name."""
    folder = tmp_path / "Daten, [Niere] a=b {1} ä 'ß'"
    folder.mkdir()
    phantom.mesh.export(folder / "lumen (ö).stl")
    write_calyces(folder / "tips, 1.csv", phantom.calyces, phantom.pelvis_mm)
    lens = {
        "model": "equidistant",
        "width": 64,
        "height": 48,
        "fx": 23,
        "fy": 23,
        "cx": 31.5,
        "cy": 23.5,
        "fov_deg": 160,
    }
    (folder / "lens=1.json").write_text(json.dumps(lens))
    return folder


def given(folder: Path, *overrides: str) -> tuple[str, ...]:
    return (
        "build_vid", "kidney=mesh", f"kidney.path={folder}/lumen (ö).stl", f"kidney.calyces={folder}/tips, 1.csv",
        "camera=file", f"camera.path={folder}/lens=1.json", f"out={folder}/vid [x]", "views.views_per_calyx=3",
        "views.passage_views=2", "calibrate=false", "workers=1", *overrides,
    )  # fmt: skip


def test_awkward_paths(run: Any, user_files: Path, phantom: Kidney) -> None:
    done = run(*given(user_files))
    assert (done.code, done.err) == (0, "")
    vid = load_vid(user_files / "vid [x]")
    assert [c.name for c in vid.kidney.calyces] == [c.name for c in phantom.calyces]
    assert vid.camera.fx == 23 and len(vid) == 24


def test_views_collected_elsewhere(run: Any, vid: Vid, tmp_path: Path) -> None:
    export_thesis(vid, tmp_path / "gesammelt, ä=1")
    done = run(
        "build_vid", "kidney=phantom", "kidney.calyces=6", "camera.width=96", "camera.height=96", "views=imported",
        f"views.path={tmp_path}/gesammelt, ä=1", "calibrate=false", "out=vid", "workers=1",
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    assert (Path("vid") / "features.safetensors").stat().st_size > 0 and len(load_vid("vid")) == len(vid)


def in_meters(folder: Path) -> None:
    path = folder / "lumen (ö).stl"
    mesh = trimesh.load_mesh(path)
    mesh.apply_scale(0.001)
    mesh.export(path)


def cut(name: str) -> Any:
    def damage(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: len(data) // 2])

    return damage


def text(name: str, content: str) -> Any:
    return lambda folder: (folder / name).write_text(content)


STL, TIPS, LENS = "lumen (ö).stl", "tips, 1.csv", "lens=1.json"
BAD = {
    "no mesh": (lambda f: (f / STL).unlink(), "There is no mesh file"),
    "mesh empty": (text(STL, ""), "is empty"),
    "mesh cut": (cut(STL), STL),
    "mesh is text": (text(STL, "hello"), STL),
    "mesh in meters": (in_meters, "kidney.scale"),
    "no calyces": (lambda f: (f / TIPS).unlink(), "There is no calyces file"),
    "calyces empty": (text(TIPS, ""), "has no rows"),
    "calyx outside": (text(TIPS, "calyx,x_mm,y_mm,z_mm\nA,900,0,0\n"), "outside the lumen"),
    "calyx no number": (text(TIPS, "calyx,x_mm,y_mm,z_mm\nA,a,0,0\n"), "expected a finite number"),
    "no lens": (lambda f: (f / LENS).unlink(), "There is no camera file"),
    "lens cut": (cut(LENS), "not readable JSON"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_one_line(run: Any, user_files: Path, what: str) -> None:
    damage, says = BAD[what]
    damage(user_files)
    done = run(*given(user_files))
    assert done.code == 1 and done.err.startswith("error: ") and says in done.err, done.err
    assert done.err.count("\n") == 1 and done.out == ""
    assert not (user_files / "vid [x]").exists() and not list(Path().iterdir())


@pytest.mark.parametrize(
    ("overrides", "code", "says"),
    [
        (("views.scope_radius_mm=7",), 1, "scope_radius_mm"),
        (("views.nearest_mm=20",), 1, "nearest_mm"),
        (("features.points=1",), 1, "min_points"),
        (("camera=pinhole", "camera.fov_deg=180"), 1, "camera=equidistant"),
        (("camera=equidistant", "camera.width=1"), 1, "at least 8 x 8"),
        (("kidney=phantom", "kidney.seed=-1"), 1, "kidney.seed"),
        (("kidney=phantom", "kidney.calyces=3"), 1, "6 to 14"),
        (("views=imported", "views.path=nowhere"), 1, "There is no poses file"),
        (("views=imported",), 2, "views.path= is missing"),
        (("views.no_such=1",), 2, "no_such"),
    ],
)
def test_bad_settings_are_one_line(
    run: Any, user_files: Path, overrides: tuple[str, ...], code: int, says: str
) -> None:
    group = overrides[0].partition("=")[0] if "." not in overrides[0].partition("=")[0] else "none"
    base = [o for o in given(user_files) if not o.startswith((f"{group}=", f"{group}."))]
    done = run(*base, *overrides)
    assert done.code == code and says in done.err and "Traceback" not in done.err, done.err
    assert code == 2 or done.err.count("\n") == 1
    assert not (user_files / "vid [x]").exists()


def test_out_is_needed(run: Any) -> None:
    done = run("build_vid", *SMALL)
    assert done.code == 2 and "out= is missing" in done.err
