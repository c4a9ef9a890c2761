"""Calibrate the EM sensor on the scope's tip: its place in the camera frame, and the clocks' offset."""

from typing import Any

from ursnav_torch._runner import caller_path, runner


@runner("calibrate_tip", paths=("track", "em", "record"))
def main(config: Any) -> None:
    """Call `runs.calibrate_tip.tip_of_track` or `tip_of_session` and write what it found."""
    from ursnav_torch.em_log import EmFormat
    from ursnav_torch.errors import InputError
    from ursnav_torch.files import check_output_file, write_json
    from ursnav_torch.runs.calibrate_tip import tip_of_session, tip_of_track, tip_report, tip_summary

    out = caller_path(config.out)
    check_output_file(out, config.overwrite)
    form = EmFormat(config.em_unit, config.em_time_unit, config.em_offset_s, tool=config.em_tool)
    if config.record is not None and (config.track, config.em) == (None, None):
        found = tip_of_session(caller_path(config.record))
    elif config.record is None and None not in (config.track, config.em):
        found = tip_of_track(caller_path(config.track), caller_path(config.em), form)
    else:
        raise InputError(
            "calibrate_tip takes track=FILE.csv and em=FILE, or record=FOLDER of a session, and no others."
        )
    write_json(out, tip_report(found, form.offset_s), config.overwrite)
    takes = f"tip={out}: track takes the place and the clocks' offset, navigate the place alone"
    print(f"{tip_summary(found, form.offset_s)}\n{takes}")


if __name__ == "__main__":
    main()
