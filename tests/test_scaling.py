"""Lengths in settings are anatomy's: one rule makes them a larger phantom's."""

import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

import ursnav_torch
from ursnav_torch.alignment import RefinementSettings
from ursnav_torch.exploration.coverage import CoverageSettings
from ursnav_torch.exploration.route import ScopeLimits
from ursnav_torch.scaling import LENGTH_ENDINGS, NO_ANATOMY, scaled
from ursnav_torch.simulation.flight import FlightSettings
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.vid import PlanSettings


def numbers(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Every field that is not a device's, those of settings inside by their path."""
    found: dict[str, Any] = {}
    for field in fields(settings):
        if field.metadata == NO_ANATOMY:
            continue
        value = getattr(settings, field.name)
        inside = is_dataclass(value) and not isinstance(value, type)
        found |= numbers(value, f"{field.name}.") if inside else {prefix + field.name: value}
    return found


@pytest.mark.parametrize(
    "settings",
    [TrackSettings(), RefinementSettings(), CoverageSettings(), ScopeLimits(), PlanSettings(), FlightSettings()],
)
def test_every_length_and_no_other_number_follows_the_scale(settings: Any) -> None:
    before, after = numbers(settings), numbers(scaled(settings, 2.0))
    assert any(name.endswith(LENGTH_ENDINGS) for name in before)
    for name, value in before.items():
        expected = value
        if name.endswith(LENGTH_ENDINGS):
            expected = tuple(2.0 * v for v in value) if isinstance(value, tuple) else 2.0 * value
        assert after[name] == expected, name


def test_what_settings_accept_is_stated_at_scale_1() -> None:
    assert scaled(PlanSettings(stretch_mm=1.5), 3.0).stretch_mm == 4.5  # more than PlanSettings(stretch_mm=...) takes


#: ``settings.far_mm * kidney.scale``: what `scaled` is for.
BY_HAND = re.compile(rf"\.\w+(?:{'|'.join(LENGTH_ENDINGS)}) \* (?:\w+\.)*(?:scale|unit)\b")
#: Lines that may, and why.
MAY = {
    "thesis/drive.py": "the experiment's settings mix lengths in the kidney with lengths of devices, which stay",
    "validate.py": "of an error budget one part is the kidney's, the others are devices'",
    "kidney/mesh.py": "a calyx's tip, which is no setting",
}


def test_no_setting_is_made_a_kidneys_by_hand() -> None:
    package = Path(ursnav_torch.__file__).parent
    found = {
        f"{path.relative_to(package)}: {line.strip()}"
        for path in package.rglob("*.py")
        if path.relative_to(package).as_posix() not in MAY
        for line in path.read_text(encoding="utf-8").splitlines()
        if BY_HAND.search(line)
    }
    assert not found, f"make these settings the kidney's with scaled(settings, kidney.scale): {found}"


def test_settings_only() -> None:
    with pytest.raises(TypeError, match="Expected settings, a dataclass, got float"):
        scaled(1.0, 2.0)
