from pathlib import Path

import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ursnav_torch.matching import Hungarian, Matching, Nearest, OpenCV, Sinkhorn

FOLDER = Path(__file__).parents[2] / "configs" / "matching"
METHODS = {"nearest": Nearest, "sinkhorn": Sinkhorn, "hungarian": Hungarian, "opencv": OpenCV}


@pytest.mark.parametrize("name", METHODS)
def test_a_choice_says_what_its_class_does_by_default(name: str) -> None:
    assert instantiate(OmegaConf.load(FOLDER / f"{name}.yaml")) == Matching(method=METHODS[name]())


def test_every_file_is_a_known_choice() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*METHODS, "default"}
