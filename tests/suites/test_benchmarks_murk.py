"""The suite of poses in murk: its pictures, choices and halves."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import murk
from ursnav_torch.errors import InputError
from ursnav_torch.rendering.sensor import SensorFaults


def test_every_kind_is_aligned_clear_and_in_murk_and_the_halves_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ["phantoms=1", "pictures=2", f"out={tmp_path / 'murk.json'}"]
    assert murk.main([*few, "half=choosing", "vary=water_mm=20"]) == 0
    choosing = capsys.readouterr().out
    for text in (
        "**thesis_phantom**",
        "**thesis_phantom, in murk**",
        "as set: off",
        "clear water: ahead",
        "water_mm=20",
    ):
        assert text in choosing
    murk.main(few)
    judging = capsys.readouterr().out
    assert "water_mm" not in judging and judging.count("as set: off") == choosing.count("as set: off")
    assert [x for x in judging.splitlines() if "as set" in x] != [x for x in choosing.splitlines() if "as set" in x]


def test_murk_is_what_a_kind_had_or_more() -> None:
    drawn = murk._murky(SensorFaults(), np.random.default_rng(0))
    assert 0.02 <= drawn.light.turbidity_per_mm <= 0.12 and 0 <= drawn.optics.veil <= 0.6
    assert drawn.electronics == SensorFaults().electronics


@pytest.mark.parametrize(
    ("given", "said"), [("half=third", "no half of the phantoms"), ("vary=water_mm=5", "the judging half must not see")]
)
def test_no_other_half_and_no_choice_by_the_judging_one(given: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        murk.main([given])
