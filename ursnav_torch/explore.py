"""Fly through a kidney by hand: its virtual views, its calyces' names, landmarks on its wall."""

from typing import Any

from ursnav_torch._runner import caller_path, runner


@runner("explore")
def main(config: Any) -> None:
    """Call `viewer.page.explore_vid`."""
    from ursnav_torch.vid import load_vid
    from ursnav_torch.viewer.page import explore_vid

    vid = load_vid(caller_path(config.vid))
    out = None if config.out is None else caller_path(config.out)
    print(explore_vid(vid, out, config.overwrite, config.host, config.port, config.seconds))


if __name__ == "__main__":
    main()
