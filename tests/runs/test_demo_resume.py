"""A demo that was killed after its VID had been built goes on with the same call, and with no other."""

from pathlib import Path

import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.files import check_output
from ursnav_torch.runs.demo import demo_vid
from ursnav_torch.vid import Vid


class Builder:
    """Copies the small VID, as a build would make it, and counts how often."""

    def __init__(self, vid: Vid, overwrite: bool = False, dies: bool = False) -> None:
        self.vid, self.overwrite, self.dies, self.built = vid, overwrite, dies, 0

    def __call__(self, path: Path) -> Vid:
        check_output(path, self.overwrite)
        if self.dies:
            raise KeyboardInterrupt
        self.built += 1
        path.symlink_to(self.vid.folder) if not path.exists() else None
        return self.vid


def test_the_same_call_takes_the_vid_that_it_had_built(vid: Vid, tmp_path: Path) -> None:
    build, settings = Builder(vid), {"kidney": {"seed": 1}, "sizes": (1, 2)}
    demo_vid(build, tmp_path / "demo", settings)
    again = demo_vid(build, tmp_path / "demo", settings)
    assert build.built == 1 and len(again) == len(vid)
    with pytest.raises(InputError, match="exists already"):
        demo_vid(build, tmp_path / "demo", settings | {"kidney": {"seed": 2}})


def test_a_vid_that_was_there_before_is_refused(vid: Vid, tmp_path: Path) -> None:
    (tmp_path / "demo_vid").symlink_to(vid.folder)
    for _ in range(2):  # the refusal itself must not make it the demo's own
        with pytest.raises(InputError, match="exists already"):
            demo_vid(Builder(vid), tmp_path / "demo", {"seed": 1})


def test_what_is_to_be_replaced_is_not_taken_for_the_new_one(vid: Vid, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    demo_vid(Builder(vid), out, {"seed": 1})
    with pytest.raises(KeyboardInterrupt):
        demo_vid(Builder(vid, overwrite=True, dies=True), out, {"seed": 2}, overwrite=True)
    again = Builder(vid, overwrite=True)
    demo_vid(again, out, {"seed": 2}, overwrite=True)
    demo_vid(again, out, {"seed": 2}, overwrite=True)
    assert again.built == 1
