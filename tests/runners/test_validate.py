"""The runner `validate`."""

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.columns import MATCH_COLUMNS
from ursnav_torch.geometry import apply, inverse, look_along, transform_from
from ursnav_torch.registration import register_landmarks
from ursnav_torch.vid import pose_cells

OFFSET_MM = (0.0, 1.2, -4.0)
R_EM = look_along([0, 0, 0], [1.0, -2, 0.5], 0.7)[:3, :3]
T_KIDNEY_EM = transform_from(R_EM, [10.0, 20, 30])


@dataclass(frozen=True)
class Case:
    """Files of one validation: matches 0 and 1 are right, 2 looks elsewhere from the same place, 3 is elsewhere."""

    matches: Path
    em: Path
    truth: Path
    em_to_kidney: Path

    def overrides(self, out: Path) -> list[str]:
        return [f"matches={self.matches}", f"em={self.em}", f"em_to_kidney={self.em_to_kidney}", f"out={out}"]


def write_rows(path: Path, columns: Any, rows: list[dict[str, Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)
    return path


@pytest.fixture
def case(tmp_path: Path) -> Case:
    rng = np.random.default_rng(0)
    true = look_along(rng.normal(0, 10, (5, 3)), rng.normal(size=(5, 3)), rng.uniform(-1, 1, 5))
    matched = true.copy()
    matched[2] = look_along(true[2, :3, 3], true[2, :3, 0])
    matched[3, :3, 3] += 25
    names, labels = [f"{i:03d}.jpg" for i in range(5)], ["A", "B", "C", "C", "A"]
    pose = [dict(image=n, calyx=c, **p) for n, c, p in zip(names, labels, pose_cells(matched), strict=True)]
    pose[4] = {"image": names[4], "error": "The picture is black."}
    sensor = apply(inverse(T_KIDNEY_EM), apply(true, np.broadcast_to(OFFSET_MM, (5, 3))))
    axis = true[:, :3, 2] @ R_EM
    reading = np.c_[sensor, axis].tolist()
    columns = ("frame", "x_mm", "y_mm", "z_mm", "dx", "dy", "dz")
    em = [dict(zip(columns, (i, *row), strict=True)) for i, row in enumerate(reading)]
    marks = rng.normal(0, 25, (8, 3))
    register_landmarks(marks, apply(T_KIDNEY_EM, marks) + rng.normal(0, 0.4, (8, 3))).to_json(tmp_path / "r.json")
    truth = [{"image": n, "calyx": c} for n, c in zip(names, ["A", "B", "D", "E", "A"], strict=True)]
    return Case(
        write_rows(tmp_path / "matches.csv", MATCH_COLUMNS, pose),
        write_rows(tmp_path / "em.csv", columns, em),
        write_rows(tmp_path / "truth.csv", ("image", "calyx"), truth),
        tmp_path / "r.json",
    )


def test_direction_exposes_the_match_from_the_same_place(run: Callable[..., Any], case: Case, tmp_path: Path) -> None:
    out = tmp_path / "v.json"
    overrides = [*case.overrides(out), f"truth={case.truth}", "sensor_offset_mm=[0,1.2,-4]"]
    done = run("validate", *overrides, "match_mm=4")
    assert done.code == 3, done.err  # one row carries an error
    data = json.loads(out.read_text(encoding="utf-8"))
    assert [row["verdict"] for row in data["images"]] == ["right", "right", "wrong", "wrong", None]
    assert [row["verdict_by_position"] for row in data["images"]] == ["right", "right", "right", "wrong", None]
    assert "black" in data["images"][4]["error"]
    counts = {name: [c[k] for k in ("TP", "FN", "FP", "TN")] for name, c in data["confusion"].items()}
    assert counts == {"position": [2, 0, 1, 1], "position_and_direction": [2, 0, 0, 2]}
    assert data["threshold_from"] == "error_budget" and data["scale"] == 1.0
    assert "4 of 5 matches judged" in done.out and "TP 2 FN 0 FP 0 TN 2" in done.out and "at scale 1" in done.out


def test_poses_that_a_track_does_not_believe_are_not_judged(
    run: Callable[..., Any], case: Case, tmp_path: Path
) -> None:
    with case.matches.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row, state in zip(rows, ("searching", *["tracking"] * 4), strict=True):
        row["state"] = state
    write_rows(case.matches, [*MATCH_COLUMNS, "state"], rows)
    out = tmp_path / "v.json"
    assert run("validate", *case.overrides(out), "sensor_offset_mm=[0,1.2,-4]", "match_mm=4").code == 3
    said = json.loads(out.read_text(encoding="utf-8"))["images"]
    assert said[0]["error"] == "no match: searching" and [row["verdict"] for row in said[:2]] == [None, "right"]


def test_reference_pairs_give_the_thesis_threshold(run: Callable[..., Any], case: Case, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    em = rng.normal(0, 20, (5, 3))
    away = rng.normal(size=(5, 3))
    camera = apply(T_KIDNEY_EM, em) + 12 * away / np.linalg.norm(away, axis=1, keepdims=True)
    columns = ("kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
    rows = [dict(zip(columns, row, strict=True)) for row in np.c_[camera, em].tolist()]
    pairs = write_rows(tmp_path / "pairs.csv", columns, rows)
    out = tmp_path / "v.json"
    done = run("validate", *case.overrides(out), f"reference_pairs={pairs}", "em_mm=0.7", "model_scale=1.8")
    assert done.code == 3, done.err
    data = json.loads(out.read_text(encoding="utf-8"))
    e_cam = np.array(data["e_cam_mm"])
    np.testing.assert_allclose(e_cam, 12, atol=1.5)
    assert data["threshold_mm"] == pytest.approx(e_cam.mean() + e_cam.std(ddof=1) + 0.7)
    assert data["threshold_from"] == "reference_pairs" and data["scale"] == 1.8
    assert data["images"][0]["distance_mm"] == pytest.approx(np.linalg.norm(OFFSET_MM), abs=1.0)
    assert "confusion" not in data and "from reference pairs" in done.out


def test_a_fitted_scale_is_that_of_the_sensors_error_in_the_threshold_too(
    run: Callable[..., Any], case: Case, tmp_path: Path
) -> None:
    data = json.loads(case.em_to_kidney.read_text(encoding="utf-8")) | {"scale": 1.2}
    case.em_to_kidney.write_text(json.dumps(data), encoding="utf-8")
    em = np.random.default_rng(2).normal(0, 20, (5, 3))
    rows = np.c_[1.2 * em @ np.array(data["R"]).T + data["t_mm"] + [9.0, 0.0, 0.0], em]
    columns = ("kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
    pairs = write_rows(tmp_path / "pairs.csv", columns, [dict(zip(columns, row, strict=True)) for row in rows.tolist()])
    out = tmp_path / "v.json"
    run("validate", *case.overrides(out), f"reference_pairs={pairs}", "em_mm=0.7")
    assert json.loads(out.read_text(encoding="utf-8"))["threshold_mm"] == pytest.approx(9.0 + 1.2 * 0.7)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("em_to_kidney=nothing.json", "There is no registration file"),
        ("em=nothing.csv", "There is no EM file"),
        ("least_p=0.9", "least_p=0.9"),
    ],
)
def test_inputs_are_checked(run: Callable[..., Any], case: Case, tmp_path: Path, change: str, says: str) -> None:
    kept = [o for o in case.overrides(tmp_path / "v.json") if o.partition("=")[0] != change.partition("=")[0]]
    done = run("validate", *kept, change)
    assert done.code == 1 and says in done.err
    assert not (tmp_path / "v.json").exists()


def test_readings_of_other_images_are_refused(run: Callable[..., Any], case: Case, tmp_path: Path) -> None:
    text = case.em.read_text(encoding="utf-8").splitlines()
    case.em.write_text("\n".join([text[0], *(f"other{line}" for line in text[1:])]), encoding="utf-8")
    done = run("validate", *case.overrides(tmp_path / "v.json"))
    assert done.code == 1 and "0 of 5 pictures have an EM reading" in done.err
