"""Locate pictures in a kidney: one row each with calyx, pose and confidence."""

from typing import Any

from ursnav_torch._runner import OK, ROWS_WITH_ERRORS, caller_path, progress, runner


@runner("match", paths=("images", "report"))
def main(config: Any) -> int:
    """Instantiate the choices and call `runs.match.match_images`."""
    from hydra.utils import instantiate

    from ursnav_torch.localization import Localizer
    from ursnav_torch.runs.lenses import stated_lens
    from ursnav_torch.runs.match import check_results, match_images
    from ursnav_torch.vid import load_vid

    out, report = caller_path(config.out), None if config.report is None else caller_path(config.report)
    check_results(out, report, config.overwrite)
    vid = load_vid(caller_path(config.vid))
    cut = vid.cut_of(*stated_lens(config.camera, instantiate))
    choices = (config.matching, config.localization, config.search, config.alignment)
    localizer = Localizer(vid, *(instantiate(choice) for choice in choices))
    rows = match_images(localizer, str(caller_path(config.images)), out, report, config.overwrite, progress, cut=cut)
    wrong = sum(1 for row in rows if row.get("error"))
    unsure = sum(1 for row in rows if row.get("accepted") is False)
    print(
        f"{len(rows)} pictures: {len(rows) - wrong - unsure} located, {unsure} unsure, {wrong} with an error; "
        f"rows in {config.out}"
    )
    if not localizer.knows_confidence:
        print(
            "How sure an answer is, is not known: this VID learned its confidence with other matching=, search= or "
            "alignment= settings, so that column is blank and nothing is accepted. Build the VID with these settings."
        )
    return ROWS_WITH_ERRORS if wrong else OK


if __name__ == "__main__":
    main()
