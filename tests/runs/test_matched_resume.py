"""A `match` run that is interrupted goes on where it stopped."""

import shutil
from pathlib import Path

import pytest

from ursnav_torch.files import no_progress, partial_path
from ursnav_torch.localization import Localizer
from ursnav_torch.runs.match import match_images
from ursnav_torch.vid import Vid


def test_an_interrupted_match_goes_on_after_its_last_picture(
    vid: Vid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "in").mkdir()
    for i in range(4):
        shutil.copy(vid.image_path(3 * i), tmp_path / "in" / f"{i}.png")
    localizer, asked = Localizer(vid), []
    locate = localizer.locate

    def stop_at_the_third(image):  # type: ignore[no-untyped-def]
        asked.append(1)
        if len(asked) == 3:
            raise KeyboardInterrupt
        return locate(image)

    monkeypatch.setattr(localizer, "locate", stop_at_the_third)
    out, page = tmp_path / "out.csv", tmp_path / "page"
    with pytest.raises(KeyboardInterrupt):
        match_images(localizer, str(tmp_path / "in"), out, page, False, no_progress)
    assert not out.exists() and not page.exists() and partial_path(out).exists()

    rows = match_images(localizer, str(tmp_path / "in"), out, page, False, no_progress)

    assert len(asked) == 3 + 2  # the two that were done are not asked again
    assert [row["image"] for row in rows] == [f"{i}.png" for i in range(4)]
    assert out.exists() and not partial_path(out).exists() and not partial_path(page).exists()
    assert (page / "index.html").read_text(encoding="utf-8").count("<article") == 4
    assert (page / "0_image.jpg").exists()
