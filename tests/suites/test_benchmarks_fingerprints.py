"""Work folders know the code and the weights that their contents came from."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.shared import fingerprints


@pytest.mark.parametrize("changed", ["room/code.py", "room/learned.json", "room/deep/weights.safetensors"])
def test_code_and_weights_of_a_room_change_its_fingerprint_and_others_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    for name in ("room/code.py", "room/learned.json", "room/deep/weights.safetensors", "other/code.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("before", encoding="utf-8")
    monkeypatch.setattr(fingerprints, "ursnav_torch", SimpleNamespace(__file__=str(tmp_path / "__init__.py")))
    before = fingerprints.sources(("room",))
    (tmp_path / "other/code.py").write_text("after", encoding="utf-8")
    assert fingerprints.sources(("room",)) == before
    (tmp_path / changed).write_text("after", encoding="utf-8")
    assert fingerprints.sources(("room",)) != before
