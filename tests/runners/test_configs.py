"""Every configuration composes, and every choice is what its target takes."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ursnav_torch._runner import config_dir
from ursnav_torch.alignment import RefinementSettings
from ursnav_torch.autonomy import AutonomySettings
from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.exploration import ExplorationSettings
from ursnav_torch.features import DefaultSettings, RimSettings, ThesisSettings
from ursnav_torch.localization import LocalizationSettings
from ursnav_torch.rendering import FlatLight, HeadLight, RaycastRenderer
from ursnav_torch.search import VIDEO_SEARCH, SearchSettings
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.tracking.tracker import video_refinement
from ursnav_torch.vid import PlanSettings

FOLDER = Path(config_dir())
ROOTS = sorted(p.stem for p in FOLDER.glob("*.yaml"))


def composed(root: str, *overrides: str) -> Any:
    with initialize_config_dir(str(FOLDER), version_base="1.3"):
        return compose(root, list(overrides), return_hydra_config=False)


def groups(root: str) -> dict[str, str]:
    """Group and chosen default, from the root's defaults list."""
    defaults = OmegaConf.load(FOLDER / f"{root}.yaml").get("defaults", [])
    chosen = [dict(entry) for entry in defaults if not isinstance(entry, str)]
    return {k: v for entry in chosen for k, v in entry.items() if not str(k).startswith("override ")}


def choices() -> list[tuple[str, str, str]]:
    return [
        (root, group, option.stem)
        for root in ROOTS
        for group in groups(root)
        for option in sorted((FOLDER / group).glob("*.yaml"))
    ]


@pytest.mark.parametrize("root", ROOTS)
def test_every_root_says_what_it_is_and_writes_nothing(root: str) -> None:
    text = (FOLDER / f"{root}.yaml").read_text(encoding="utf-8")
    assert text.startswith(f"# {root}: ") and f"python -m ursnav_torch.{root}" in text.splitlines()[1]
    assert "hydra: {run: {dir: .}, output_subdir: null}" in text
    assert "overwrite" in composed(root)


@pytest.mark.parametrize(("root", "group", "choice"), choices())
def test_every_choice_composes(root: str, group: str, choice: str) -> None:
    config = composed(root, f"{group}={choice}")
    section = OmegaConf.select(config, group)
    assert section == {} or section is None or "_target_" in section


@pytest.mark.parametrize(
    ("root", "override", "expected"),
    [
        ("build_vid", "camera=equidistant", equidistant_camera()),
        ("build_vid", "features=default", DefaultSettings()),
        ("build_vid", "features=rims", RimSettings()),
        ("build_vid", "features=thesis", ThesisSettings()),
        ("build_vid", "views=planned", PlanSettings()),
        ("match", "localization=default", LocalizationSettings()),
        ("match", "search=default", SearchSettings()),
        ("match", "alignment=default", RefinementSettings()),
        ("track", "search=video", VIDEO_SEARCH),
        ("track", "alignment=video", video_refinement()),
        ("track", "tracking=default", TrackSettings()),
        ("navigate", "tracking=default", TrackSettings()),
        ("navigate", "exploration=default", ExplorationSettings()),
        ("navigate", "autonomy=explore", AutonomySettings()),
        ("navigate", "autonomy=assist", AutonomySettings(mode="assist")),
    ],
)
def test_configurations_repeat_the_defaults_of_the_code(root: str, override: str, expected: object) -> None:
    """What a library user gets without settings is what a runner's user gets."""
    assert instantiate(OmegaConf.select(composed(root, override), override.partition("=")[0])) == expected


@pytest.mark.parametrize("root", ["track", "navigate"])
def test_every_setting_of_a_track_is_overridden_without_a_plus(root: str) -> None:
    """The YAML spells out every field, and what a runner gives is what the settings then say."""
    config = composed(root, "tracking.challenger.starts=3", "tracking.own_kidney.frame_s=0.2", "search.shape_weight=1")
    assert instantiate(config.tracking).challenger.starts == 3
    assert instantiate(config.search).shape_weight == 1
    for part in fields(TrackSettings):
        given = {f.name for f in fields(getattr(TrackSettings(), part.name))}
        assert set(config.tracking[part.name]) - {"_target_"} == given


def test_edges_alone_compare_no_intensities_whatever_the_search() -> None:
    for root, search in (("match", "default"), ("track", "video"), ("build_vid", "default")):
        config = composed(root, f"search={search}", "localization=edges")
        assert instantiate(config.search).relief_weight == 0 < instantiate(config.search).direction_weight
        assert instantiate(config.localization) == LocalizationSettings()


def test_matching_without_a_choice_is_the_default_one() -> None:
    from ursnav_torch.matching import Matching
    from ursnav_torch.search import default_matching

    for choice in ("nearest", "sinkhorn", "hungarian", "opencv"):
        assert isinstance(instantiate(composed("match", f"matching={choice}").matching), Matching)
    assert instantiate(composed("match").matching) == default_matching()


def test_renderers_are_made_with_the_light_of_the_configuration() -> None:
    for light, kind in (("flat", FlatLight), ("headlight", HeadLight)):
        make = instantiate(composed("build_vid", f"rendering/light={light}").rendering)
        assert make.func is RaycastRenderer and isinstance(make.keywords["light"], kind)


def test_a_lens_from_a_file(tmp_path: Path) -> None:
    import json

    path = tmp_path / "lens.json"
    path.write_text(json.dumps(equidistant_camera(120, 64, 48).to_dict()))
    camera = instantiate(composed("match", "camera=file", f"camera.path='{path}'").camera)
    assert isinstance(camera, Camera) and camera == equidistant_camera(120, 64, 48)
