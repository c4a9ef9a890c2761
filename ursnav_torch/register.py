"""Register the EM tracker to the kidney: from touched landmarks, touched surface points, or the tip's own path."""

from typing import Any

from ursnav_torch._runner import caller_path, runner


@runner("register", paths=("landmarks", "points"))
def main(config: Any) -> None:
    """Instantiate the method and call it on the file."""
    from dataclasses import replace

    from hydra.utils import instantiate

    from ursnav_torch.errors import InputError
    from ursnav_torch.files import check_output_file
    from ursnav_torch.registration import registration_summary
    from ursnav_torch.vid import load_vid

    out = caller_path(config.out)
    check_output_file(out, config.overwrite)
    source = config.landmarks if config.registration.source == "landmarks" else config.points
    if source is None:
        raise InputError(f"This registration needs {config.registration.source}=FILE; see --help.")
    if config.registration.source == "points" and config.vid is None:
        raise InputError("Without landmarks the kidney is needed: give vid=DIR from build_vid.")
    kidney = None if config.vid is None else load_vid(caller_path(config.vid)).kidney
    found = instantiate(config.registration.job)(caller_path(source), kidney)
    if kidney is None:
        found = replace(found, model_scale=float(config.model_scale))
    found.to_json(out, config.overwrite)
    print(f"{registration_summary(found, kidney)}\nEM to kidney in {out}")


if __name__ == "__main__":
    main()
