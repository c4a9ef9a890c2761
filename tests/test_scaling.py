"""Lengths in settings are anatomy's: one rule makes them a larger phantom's."""

from dataclasses import fields, is_dataclass
from typing import Any

import pytest

from ursnav_torch.alignment import RefinementSettings
from ursnav_torch.exploration.coverage import CoverageSettings
from ursnav_torch.exploration.route import ScopeLimits
from ursnav_torch.scaling import LENGTH_ENDINGS, scaled
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.vid import PlanSettings


def numbers(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Every field, those of settings inside by their path."""
    found: dict[str, Any] = {}
    for field in fields(settings):
        value = getattr(settings, field.name)
        inside = is_dataclass(value) and not isinstance(value, type)
        found |= numbers(value, f"{field.name}.") if inside else {prefix + field.name: value}
    return found


@pytest.mark.parametrize(
    "settings", [TrackSettings(), RefinementSettings(), CoverageSettings(), ScopeLimits(), PlanSettings()]
)
def test_every_length_and_no_other_number_follows_the_scale(settings: Any) -> None:
    before, after = numbers(settings), numbers(scaled(settings, 2.0))
    assert any(name.endswith(LENGTH_ENDINGS) for name in before)
    for name, value in before.items():
        expected = value
        if name.endswith(LENGTH_ENDINGS):
            expected = 2.0 * value
        assert after[name] == expected, name


def test_settings_only() -> None:
    with pytest.raises(TypeError, match="Expected settings, a dataclass, got float"):
        scaled(1.0, 2.0)
