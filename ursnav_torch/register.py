"""Register the EM tracker to the kidney: from touched landmarks, touched surface points, or the tip's own path."""

from typing import Any

from ursnav_torch._runner import caller_path, runner


@runner("register", paths=("landmarks", "points"))
def main(config: Any) -> None:
    """Instantiate the choice of registration and call it on the files."""
    from dataclasses import replace

    from hydra.utils import instantiate

    from ursnav_torch.em_log import EmFormat, read_em_samples
    from ursnav_torch.files import check_output_file
    from ursnav_torch.runs.register import registration_summary
    from ursnav_torch.vid import load_vid

    out = caller_path(config.out)
    check_output_file(out, config.overwrite)
    job = instantiate(config.registration, _convert_="all")
    form = EmFormat(config.em_unit, tool=config.em_tool)
    landmarks = None if config.landmarks is None else caller_path(config.landmarks)
    points = None if config.points is None else read_em_samples(caller_path(config.points), form)
    kidney = None if config.vid is None else load_vid(caller_path(config.vid)).kidney
    found = job(landmarks, points, kidney)
    if kidney is None:
        found = replace(found, model_scale=float(config.model_scale))
    found.to_json(out, config.overwrite)
    print(f"{registration_summary(found, kidney)}\nEM to kidney in {out}")


if __name__ == "__main__":
    main()
