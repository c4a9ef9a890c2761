"""The runner print_phantom."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from ursnav_torch.kidney import Kidney
from ursnav_torch.tables import read_csv

pytest.importorskip("manifold3d", reason="the extra ct is not installed")


@pytest.mark.slow
def test_the_folder_holds_all_that_is_needed(run: Any, phantom: Kidney, tmp_path: Path) -> None:
    phantom.mesh.export(tmp_path / "lumen.stl")
    done = run("print_phantom", "kidney=mesh", f"kidney.path={tmp_path}/lumen.stl", "scale=1.5", "out=my print")
    assert (done.code, done.err) == (0, "") and "two halves at 1.5 times anatomy" in done.out
    out = Path("my print")
    names = ["calyces.csv", "half_a.stl", "half_b.stl", "landmarks.csv", "picture.png", "print.json"]
    assert sorted(p.name for p in out.iterdir()) == names
    about = json.loads((out / "print.json").read_text(encoding="utf-8"))
    assert about["scale"] == 1.5 and about["watertight"] and about["thinnest_wall_mm"] > 1.8
    volume = sum(trimesh.load_mesh(out / f"half_{h}.stl").volume for h in "ab")
    assert volume == pytest.approx(1000 * about["volume_ml"], rel=1e-3)
    rows = read_csv(out / "landmarks.csv", ["kidney_x_mm", "em_x_mm"], "landmarks")
    at = np.array([[float(row[f"kidney_{k}_mm"]) for k in "xyz"] for row in rows])
    bounds = 1.5 * phantom.mesh.bounds + [[-6], [6]]
    assert np.all((at > bounds[0]) & (at < bounds[1]))
    picture = cv2.imread(str(out / "picture.png"))
    assert picture is not None and picture.std() > 20
    again = run("print_phantom", "out=my print")
    assert again.code == 1 and "exists already" in again.err


@pytest.mark.parametrize(
    ("overrides", "code", "says"),
    [
        (("kidney=mesh", "kidney.path=none.stl"), 1, "There is no mesh file"),
        (("scale=0",), 1, "scale is 0.0; accepted are"),
        (("wall_mm=-1",), 1, "wall_mm is -1.0"),
        (("walls=3",), 2, "walls"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(run: Any, overrides: tuple[str, ...], code: int, says: str) -> None:
    done = run("print_phantom", "out=mine", *overrides)
    assert done.code == code and says in done.err and "Traceback" not in done.err, done.err
    assert not list(Path().iterdir())
