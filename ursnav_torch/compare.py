"""Lay two recorded sessions in one kidney side by side: time lines, calyces, paths, as a page."""

from typing import Any

from ursnav_torch._runner import caller_path, runner


@runner("compare", paths=("first", "second"))
def main(config: Any) -> None:
    """Call `reports.session.write_comparison`."""
    from ursnav_torch.files import check_output
    from ursnav_torch.reports.session import write_comparison
    from ursnav_torch.session import Replay
    from ursnav_torch.vid import load_vid

    out = caller_path(config.out)
    check_output(out, config.overwrite)
    first, second = (Replay(caller_path(config[name]), speed=0) for name in ("first", "second"))
    print(f"page: {write_comparison(load_vid(caller_path(config.vid)), first, second, out)}")


if __name__ == "__main__":
    main()
