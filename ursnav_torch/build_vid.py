"""Build the virtual image database (VID) of a kidney: views with known poses, reduced to features."""

from typing import Any

from ursnav_torch._runner import caller_path, progress, runner


@runner("build_vid", paths=("views.path", "kidney.centerline"))
def main(config: Any) -> None:
    """Instantiate the choices and call `vid.build_vid`."""
    from functools import partial

    from hydra.utils import instantiate

    from ursnav_torch.files import check_output
    from ursnav_torch.localization import Localizer, learn_confidence
    from ursnav_torch.processes import spare_children
    from ursnav_torch.reports import report_look_alikes
    from ursnav_torch.vid import PlanSettings, build_vid

    out = caller_path(config.out)
    check_output(out, config.overwrite)
    kidney, camera = instantiate(config.kidney), instantiate(config.camera)
    make_renderer, plan = instantiate(config.rendering), instantiate(config.views)
    trial = plan if isinstance(plan, PlanSettings) else PlanSettings()
    choices = {name: instantiate(config[name]) for name in ("matching", "search", "alignment")}
    children = spare_children(config.compute.get("workers"))
    learn = partial(
        learn_confidence, make_renderer=make_renderer, plan=trial, make_localizer=partial(Localizer, **choices),
        children=children,
    )  # fmt: skip
    vid = build_vid(
        kidney,
        camera,
        instantiate(config.features),
        make_renderer,
        plan,
        out,
        overwrite=config.overwrite,
        compute=instantiate(config.compute),
        progress=progress,
        learn=learn if config.calibrate else None,
    )
    names = ", ".join(f"{c.name} {(vid.calyx == i).sum()}" for i, c in enumerate(kidney.calyces))
    print(f"{len(vid)} views in {out} (scale {kidney.scale:g}); views a calyx: {names}")
    for sentence in report_look_alikes(vid):
        print(sentence)


if __name__ == "__main__":
    main()
