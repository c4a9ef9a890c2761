"""The whole job on a built-in phantom: VID, simulated pictures, matches, a table and a page with pictures."""

from typing import Any

from ursnav_torch._runner import caller_path, progress, runner


@runner("demo")
def main(config: Any) -> None:
    """Instantiate the choices, build the VID unless it is there, and call `runs.demo.run_demo`."""
    from functools import partial

    from hydra.utils import instantiate

    from ursnav_torch.files import check_output
    from ursnav_torch.localization import learn_confidence
    from ursnav_torch.runs.demo import run_demo
    from ursnav_torch.runs.tables import print_scores
    from ursnav_torch.vid import build_vid

    out = caller_path(config.out)
    check_output(out, config.overwrite)
    make_renderer, plan = instantiate(config.rendering), instantiate(config.views)
    vid = build_vid(
        instantiate(config.kidney),
        instantiate(config.camera),
        instantiate(config.features),
        make_renderer,
        plan,
        out.with_name(out.name + "_vid"),
        overwrite=config.overwrite,
        workers=config.workers,
        progress=progress,
        learn=partial(
            learn_confidence, make_renderer=make_renderer, plan=plan, queries_per_calyx=config.queries_per_calyx
        ),
    )
    scores = run_demo(
        vid, make_renderer, plan, config.pictures_per_calyx, out, overwrite=config.overwrite, progress=progress
    )
    print_scores(scores, f"{len(vid)} views of {len(vid.kidney.calyces)} calyces")
    print(f"\nOpen {out / 'report' / 'index.html'} to see where each picture was taken.")


if __name__ == "__main__":
    main()
