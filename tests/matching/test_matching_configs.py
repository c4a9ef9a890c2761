import json
from dataclasses import replace
from pathlib import Path

import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ursnav_torch.matching import Hungarian, Matching, Nearest, OpenCV, Sinkhorn
from ursnav_torch.search import SearchSettings, default_matching

FOLDER = Path(__file__).parents[2] / "configs" / "matching"
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "finalists--amd-epyc.json"
METHODS = {"nearest": Nearest, "sinkhorn": Sinkhorn, "hungarian": Hungarian, "opencv": OpenCV}


@pytest.mark.parametrize("name", ["nearest", "opencv"])
def test_a_choice_says_what_its_class_does_by_default(name: str) -> None:
    assert instantiate(OmegaConf.load(FOLDER / f"{name}.yaml")) == Matching(method=METHODS[name]())


@pytest.mark.parametrize("name", ["sinkhorn", "hungarian"])
def test_assignments_have_the_cost_of_the_default(name: str) -> None:
    """Finalists are turned to the picture's roll and tilt, so that position and edge direction count."""
    found, default = instantiate(OmegaConf.load(FOLDER / f"{name}.yaml")), default_matching()
    assert (found.descriptor, found.cost) == (default.descriptor, default.cost)
    assert isinstance(found.method, METHODS[name])


def test_sinkhorn_is_as_the_choosing_phantoms_had_it_best() -> None:
    """The best row of ``python -m benchmarks.finalists``, choosing half, at the search's weight of shapes."""
    method = instantiate(OmegaConf.load(FOLDER / "sinkhorn.yaml")).method
    assert method == Sinkhorn(0.05, iterations=20, tolerance=float("inf"), dummy_cost=0.2)
    rows = json.loads(RESULTS.read_text())["rows"]
    group = f"choosing: shapes at weight {SearchSettings().shape_weight:g}"
    right = {row["name"]: row["median"] for row in rows if row["group"] == group}
    assert right["sinkhorn, epsilon 0.05, dummies at 0.2"] == max(right.values()) > right["nearest"]


def test_both_sides_differ_from_the_default_in_that_alone() -> None:
    found = instantiate(OmegaConf.load(FOLDER / "both_sides.yaml"))
    assert found == replace(default_matching(), method=Nearest("sum", keep=1.0))


def test_every_file_is_a_known_choice() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*METHODS, "default", "both_sides"}
