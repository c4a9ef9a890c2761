"""Fly through a kidney by hand: its virtual views, its calyces' names, landmarks on its wall."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ursnav_torch._runner import WRONG_USAGE, caller_path, progress, runner

if TYPE_CHECKING:
    from ursnav_torch.vid import Vid


@runner("explore", paths=("kidney.centerline", "views.path"))
def main(config: Any) -> int | None:
    """Load the VID, or build a small one of a kidney for as long as this lasts, and call `page.explore_vid`."""
    from tempfile import TemporaryDirectory

    from ursnav_torch.files import check_output
    from ursnav_torch.page import check_address, explore_vid
    from ursnav_torch.vid import load_vid

    if (config.vid is None) == (config.get("kidney") is None):
        print("error: explore takes vid=FOLDER or kidney=phantom, mesh or ct; one of the two.", file=sys.stderr)
        return WRONG_USAGE
    check_address(config.host, config.port)
    out = None if config.out is None else caller_path(config.out)
    if out is not None:
        check_output(out, config.overwrite)
    with TemporaryDirectory(prefix="ursnav_explore_") as folder:
        vid = _small_vid(config, Path(folder) / "vid") if config.vid is None else load_vid(caller_path(config.vid))
        print(explore_vid(vid, out, config.overwrite, config.host, config.port, config.seconds))
    return None


def _small_vid(config: Any, folder: Path) -> "Vid":
    """A few views of every calyx, to go to and to show."""
    from hydra.utils import instantiate

    from ursnav_torch.features import DefaultSettings
    from ursnav_torch.vid import build_vid

    kidney, camera, make_renderer, plan = map(
        instantiate, (config.kidney, config.camera, config.rendering, config.views)
    )
    return build_vid(kidney, camera, DefaultSettings(), make_renderer, plan, folder, workers=1, progress=progress)


if __name__ == "__main__":
    main()
