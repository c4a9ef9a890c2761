import inspect
from dataclasses import fields
from pathlib import Path

import pytest
from hydra.utils import get_method, instantiate
from omegaconf import OmegaConf

from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import SegmentationSettings, load_ct_kidney

CONFIGS = Path(__file__).parents[2] / "configs" / "kidney"


@pytest.mark.parametrize("name", ["mesh", "phantom", "ct"])
def test_knobs_and_defaults_are_those_of_the_function(name: str) -> None:
    config = OmegaConf.load(CONFIGS / f"{name}.yaml")
    target = get_method(config._target_)
    defaults = {p.name: p.default for p in inspect.signature(target).parameters.values()}
    if target is load_ct_kidney:  # takes those of its settings one by one
        defaults |= {f.name: f.default for f in fields(SegmentationSettings)}
    for key in set(config) - {"_target_"}:
        default = defaults[str(key)]
        if default is inspect.Parameter.empty:
            assert OmegaConf.is_missing(config, key)
        elif OmegaConf.is_dict(config[key]):  # a group whose own defaults stand for nothing given
            assert default is None and instantiate(config[key]) == get_method(config[key]._target_)()
        else:
            assert config[key] == default


def test_a_phantom_comes_from_its_config(phantom: Kidney) -> None:
    kidney = instantiate(OmegaConf.load(CONFIGS / "phantom.yaml"), calyces=6)
    assert kidney.source == phantom.source and len(kidney.calyces) == len(phantom.calyces)
