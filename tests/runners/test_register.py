"""The runner `register`."""

import csv
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.geometry import apply, inverse, look_along
from ursnav_torch.registration import Registration
from ursnav_torch.vid import Vid

HEADER = "kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm"
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def write_table(path: Path, header: str, rows: Any) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header.split(","))
        writer.writerows(np.asarray(rows).tolist())
    return path


@pytest.fixture
def landmarks(tmp_path: Path) -> Path:
    em = np.random.default_rng(0).normal(0, 30, (8, 3))
    return write_table(tmp_path / "land, marks=[1] ä.csv", HEADER, np.c_[em @ TURN.T + [1, 2, 3], em])


def test_landmarks_become_the_json_of_the_contract(run: Callable[..., Any], landmarks: Path, tmp_path: Path) -> None:
    out = tmp_path / "em to kidney.json"
    done = run("register", f"landmarks={landmarks}", f"out={out}", "model_scale=1.8")
    assert done.code == 0, done.err
    data = json.loads(out.read_text(encoding="utf-8"))
    np.testing.assert_allclose(data["R"], TURN, atol=1e-9)
    np.testing.assert_allclose(data["t_mm"], [1, 2, 3], atol=1e-9)
    assert (data["n"], data["scale"], data["model_scale"], data["from"], data["to"]) == (8, 1.0, 1.8, "em", "kidney")
    assert len(data["fre_mm"]) == 8 and data["fre_rmse_mm"] < 1e-9 and data["tre_loo_rmse_mm"] < 1e-9
    assert "8 of 8 used" in done.out and "mm at scale 1.8" in done.out and "leave-one-out" in done.out
    assert Registration.from_json(out).method == "landmarks"


def test_an_existing_result_is_kept_unless_told(run: Callable[..., Any], landmarks: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.json"
    out.write_text("mine")
    refused = run("register", f"landmarks={landmarks}", f"out={out}")
    assert refused.code == 1 and "overwrite=true" in refused.err and out.read_text(encoding="utf-8") == "mine"
    assert run("register", f"landmarks={landmarks}", f"out={out}", "overwrite=true").code == 0
    assert json.loads(out.read_text(encoding="utf-8"))["n"] == 8


def test_a_wrong_pair_is_left_out_or_named(run: Callable[..., Any], landmarks: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(landmarks, delimiter=",", skiprows=1)
    rows[4, :3] += 30
    wrong = write_table(tmp_path / "wrong.csv", HEADER, rows)
    done = run("register", f"landmarks={wrong}", f"out={tmp_path / 'a.json'}", "registration.ransac=3")
    assert done.code == 0 and "7 of 8 used" in done.out
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert run("register", f"landmarks={wrong}", f"out={tmp_path / 'b.json'}").code == 0
    assert any("Pair 5 looks wrong" in str(w.message) for w in said)
    assert "Pair 5 looks wrong" in json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["suspicions"][0]


def test_a_touch_reaches_ahead_of_the_sensor(run: Callable[..., Any], landmarks: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(landmarks, delimiter=",", skiprows=1)
    axis = np.random.default_rng(1).normal(size=(8, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rows[:, 3:] -= 4.5 * axis
    held = write_table(tmp_path / "held.csv", f"{HEADER},em_dx,em_dy,em_dz", np.c_[rows, axis])
    out = tmp_path / "r.json"
    assert run("register", f"landmarks={held}", f"out={out}", "registration.reach_mm=4.5").code == 0
    assert json.loads(out.read_text(encoding="utf-8"))["fre_rmse_mm"] < 1e-9
    missing = run("register", f"landmarks={landmarks}", f"out={tmp_path / 'x.json'}", "registration.reach_mm=4.5")
    assert missing.code == 1 and "em_dx,em_dy,em_dz" in missing.err


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        ((), "takes landmarks=FILE"),
        (("registration=centerline", "points=p.csv"), "give vid=DIR"),
        (("registration=surface", "landmarks=l.csv"), "takes points=FILE"),
        (("landmarks=nowhere.csv",), "There is no landmark file"),
    ],
)
def test_what_is_missing_is_said(run: Callable[..., Any], tmp_path: Path, overrides: tuple, says: str) -> None:
    (tmp_path / "caller's folder" / "p.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n", encoding="utf-8")
    done = run("register", *overrides, f"out={tmp_path / 'r.json'}")
    assert done.code == 1 and says in done.err and "Traceback" not in done.err
    assert not list(tmp_path.glob("r.json*"))


@pytest.mark.slow
def test_a_path_is_laid_into_the_kidney_of_a_vid(run: Callable[..., Any], vid: Vid, tmp_path: Path) -> None:
    tree, rng = vid.kidney.centerline, np.random.default_rng(0)
    paths = [tree.path_to(c)[:-4] for c in range(len(vid.kidney.calyces))]
    points = np.concatenate([tree.points_mm[np.r_[p, p[::-1]]] for p in paths])
    axes = np.concatenate([np.r_[tree.tangents(p), tree.tangents(p)[::-1]] for p in paths])
    T = look_along(points, axes)
    sensor = apply(T, np.broadcast_to([0, 1.2, -4.0], points.shape)) + rng.normal(0, 0.4, points.shape)
    T_em_kidney = inverse(look_along([5.0, 60, -20], [1.0, 2, 3], 0.4))
    columns = np.c_[np.arange(len(T)), apply(T_em_kidney, sensor), T[:, :3, 2] @ T_em_kidney[:3, :3].T]
    em = write_table(tmp_path / "em.csv", "frame,x_mm,y_mm,z_mm,dx,dy,dz", columns)
    out = tmp_path / "r.json"
    place = ("sensor_offset_mm=[0,1.2,-4]", f"vid={vid.folder}", f"points={em}", f"out={out}")
    done = run("register", "registration=centerline", *place)
    assert done.code == 0, done.err
    assert "centerline" in done.out and "expected error at the calyces" in done.out
    found = Registration.from_json(out)
    error = found.apply(columns[:, 1:4]) - sensor
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 3.0


def test_a_refusal_names_the_landmarks_file(run: Callable[..., Any], tmp_path: Path) -> None:
    head = "kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm"
    (tmp_path / "two.csv").write_text(f"{head}\n0,0,0,0,0,0\n30,0,0,30,0,0\n")
    done = run("register", f"landmarks={tmp_path / 'two.csv'}", "out=r.json")
    assert done.code == 1 and "two.csv: 2 landmark pairs do not fix a rotation" in done.err.replace("\n", " ")
