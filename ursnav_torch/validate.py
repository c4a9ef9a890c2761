"""Judge matches by the EM sensor: position and direction, beside the thesis's rule on position alone."""

from typing import Any

from ursnav_torch._runner import OK, ROWS_WITH_ERRORS, caller_path, runner


@runner("validate", paths=("matches", "em", "em_to_kidney", "reference_pairs", "truth"))
def main(config: Any) -> int:
    """Call `judge_matches` and write its report."""
    from ursnav_torch.em_log import EmFormat
    from ursnav_torch.files import check_output_file, write_json
    from ursnav_torch.registration import ErrorBudget, Registration
    from ursnav_torch.runs.validate import judge_matches, verdict_report, verdict_summary

    out = caller_path(config.out)
    check_output_file(out, config.overwrite)
    registration = Registration.from_json(caller_path(config.em_to_kidney))
    scale = registration.model_scale if config.model_scale is None else float(config.model_scale)
    verdicts = judge_matches(
        caller_path(config.matches),
        caller_path(config.em),
        registration,
        sensor_offset_mm=None if config.sensor_offset_mm is None else tuple(config.sensor_offset_mm),
        reference_pairs=None if config.reference_pairs is None else caller_path(config.reference_pairs),
        truth=None if config.truth is None else caller_path(config.truth),
        budget=ErrorBudget(config.em_mm, config.em_axis_deg, config.match_mm * scale, config.match_axis_deg),
        least_p=config.least_p,
        form=EmFormat(config.em_unit, config.em_time_unit, config.em_offset_s, config.em_join, config.em_tool),
    )
    write_json(out, verdict_report(verdicts, scale), config.overwrite)
    print(f"{verdict_summary(verdicts, scale)}\nverdicts in {out}")
    return OK if verdicts.judged.all() else ROWS_WITH_ERRORS


if __name__ == "__main__":
    main()
