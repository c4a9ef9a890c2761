"""What was learned about certainty is stored, read again, and used only with the settings that it was learned with."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.localization.population import made_up
from ursnav_torch.errors import InputError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.localization import Localizer
from ursnav_torch.localization import learned as room
from ursnav_torch.localization.calibrating import learn_certainty
from ursnav_torch.localization.evidence import REFINED_CALYX_NUMBERS, REFINED_NUMBERS, Evidence
from ursnav_torch.localization.fitting import Asked
from ursnav_torch.localization.learned import (
    Packaged,
    asked_from_table,
    certainty_model,
    evidence_table,
    packaged_models,
    save_packaged,
)


def table(asked: Asked) -> list[dict[str, object]]:
    rows = []
    for i, e in enumerate(asked.evidence):
        mm, deg = (None if np.isnan(v[i]) else float(v[i]) for v in (asked.position_mm, asked.direction_deg))
        nearest = Evidence(e.answer, e.numbers[:-REFINED_NUMBERS], e.calyces[:, :-REFINED_CALYX_NUMBERS])
        rows.append({"shown": asked.shown[i], "refined": (e, mm, deg), "nearest": (nearest, mm, deg)})
    return evidence_table(rows)


@pytest.fixture
def own_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package that has learned with settings "default", and is asked with them."""
    path = tmp_path / "certainty.json"
    monkeypatch.setattr(room, "PACKAGED", path)
    model = learn_certainty(made_up(400))
    save_packaged(Packaged("default", model, model), path)
    yield path
    room.packaged_models.cache_clear()  # the next test knows the package's own again


def test_the_package_has_learned_with_its_default_settings() -> None:
    packaged = packaged_models()
    assert packaged is not None
    assert packaged.settings == Localizer.settings_line(DefaultSettings()), (
        "A default setting changed: learn anew, python -m benchmarks.certainty work=DIR save=true"
    )


def test_pictures_come_back_as_they_were_stored() -> None:
    asked = made_up(60)
    rows = json.loads(json.dumps(table(asked), allow_nan=False))
    again, nearest = asked_from_table(rows, True), asked_from_table(rows, False)
    assert again.shown.tolist() == asked.shown.tolist() == nearest.shown.tolist()
    np.testing.assert_allclose(again.numbers, asked.numbers, atol=1e-4)
    np.testing.assert_allclose(again.position_mm, asked.position_mm, atol=1e-4)
    assert nearest.numbers.shape[1] == asked.numbers.shape[1] - REFINED_NUMBERS


def test_a_vid_that_asked_nothing_has_the_populations_model(own_package: Path) -> None:
    model = certainty_model(None, "default", True)
    assert model is not None and (model.slope, model.shift) == (1.0, 0.0)
    assert model == packaged_models().refined  # type: ignore[union-attr]


def test_a_vids_own_pictures_shift_the_populations_model(own_package: Path) -> None:
    stored = {"confidence": {"settings": "default", "pictures": table(made_up(200, seed=5, shift=2.0))}}
    model = certainty_model(stored, "default", True)
    assert model is not None and model.shift < -0.5


def test_other_settings_have_the_vids_own_pictures_alone_or_nothing(own_package: Path) -> None:
    stored = {"confidence": {"settings": "mine", "pictures": table(made_up(200, seed=5))}}
    for refined in (True, False):
        model = certainty_model(stored, "mine", refined)
        assert model is not None and 0 < model.threshold(0.2) < 1
    assert certainty_model(stored, "yours", True) is None and certainty_model(None, "mine", True) is None
    few = {"confidence": {"settings": "mine", "pictures": table(made_up(6, seed=5))}}
    assert certainty_model(few, "mine", True) is None


def test_what_is_no_table_is_refused() -> None:
    for rows in ([{"shown": 1}], [{"shown": 1, "refined": {"answer": 0, "numbers": [1], "calyces": [[1]]}}], [3], 7):
        stored = {"confidence": {"settings": "mine", "pictures": rows}}
        with pytest.raises(InputError, match="build the VID again"):
            certainty_model(stored, "mine", True)
