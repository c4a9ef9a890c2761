"""The thesis's whole protocol in simulation, as one report: its printed values beside ours."""

from typing import Any

from ursnav_torch._runner import OK, ROWS_WITH_ERRORS, caller_path, progress, runner


@runner("experiment")
def main(config: Any) -> int:
    """Instantiate the choices and call `thesis.run_experiment`."""
    from functools import partial

    from hydra.core.hydra_config import HydraConfig
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from ursnav_torch.files import check_output
    from ursnav_torch.localization import Localizer
    from ursnav_torch.thesis import Pipeline, beside_text, run_experiment

    out = caller_path(config.out)
    check_output(out, config.overwrite)
    matching, localization = instantiate(config.matching), instantiate(config.localization)
    search, alignment = instantiate(config.search), instantiate(config.alignment)
    pipeline = Pipeline(
        instantiate(config.camera),
        instantiate(config.features),
        instantiate(config.rendering),
        instantiate(config.views),
        partial(Localizer, matching=matching, settings=localization, search=search, alignment=alignment),
        config.calibrate,
        config.workers,
    )
    kept: Any = OmegaConf.to_container(config, resolve=True)
    outcome, figures = run_experiment(
        instantiate(config.kidney),
        pipeline,
        instantiate(config.protocol),
        out,
        name=str(HydraConfig.get().runtime.choices["experiment"]),
        record=kept,
        overwrite=config.overwrite,
        progress=progress,
    )
    print(beside_text(figures))
    print(f"\nOpen {out / 'report.html'} for tables, plots and pictures.")
    rows = [*outcome.simulation.rows, *outcome.phantom.rows]
    return ROWS_WITH_ERRORS if any(row.get("error") for row in rows) else OK


if __name__ == "__main__":
    main()
