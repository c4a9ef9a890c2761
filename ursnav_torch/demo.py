"""The whole job on a built-in phantom: VID, simulated pictures, matches, a table and a page with pictures."""

from pathlib import Path
from typing import Any

from ursnav_torch._runner import caller_path, progress, runner


@runner("demo", words=("live",))
def main(config: Any) -> None:
    """Build the VID unless it is there, then locate pictures, or with ``live`` fly and open the page."""
    out = caller_path(config.out)
    if config.live:
        _live(config, out)
    else:
        _pictures(config, out)


def _pictures(config: Any, out: Path) -> None:
    """Call `runs.demo.run_demo`."""
    from ursnav_torch.files import check_output
    from ursnav_torch.runs.demo import run_demo
    from ursnav_torch.runs.tables import Steps, print_scores

    check_output(out, config.overwrite)
    print("The whole job on a phantom kidney that comes with the program: about two minutes on two cores.")
    steps = Steps(4)
    vid, make_renderer, plan = _vid(config, out, config.overwrite, steps)
    scores = run_demo(
        vid, make_renderer, plan, config.pictures_per_calyx, out, overwrite=config.overwrite, progress=progress,
        workers=config.workers, begin=steps.begin,
    )  # fmt: skip
    print(f"Done in {steps.end():.0f} s.\n")
    print_scores(scores, f"{len(vid)} views of {len(vid.kidney.calyces)} calyces")
    print(f"\nWhere each picture was taken: {(out / 'report' / 'index.html').as_uri()}")


def _live(config: Any, out: Path) -> None:
    """Call `navigation.flight_record.record_flight` unless that is there, then `runs.navigate.navigate_vid` on it."""
    from hydra.utils import instantiate

    from ursnav_torch.navigation.flight_record import record_flight
    from ursnav_torch.runs.navigate import navigate_vid
    from ursnav_torch.runs.tables import Steps
    from ursnav_torch.session import Replay
    from ursnav_torch.tracking.tracker import Tracker

    session = out.with_name(out.name + "_live")
    steps = Steps(2 * (not out.with_name(out.name + "_vid").exists()) + 2 * (not session.exists()))
    vid, make_renderer, _ = _vid(config, out, False, steps)
    if not session.exists():
        record_flight(
            vid, make_renderer, session, pictures=config.flight_pictures, workers=config.workers, progress=progress,
            begin=steps.begin,
        )  # fmt: skip
    steps.end()
    page, replay = instantiate(config.viewer), Replay(session / "session")
    there = "The session plays until you end it, with Ctrl-C"
    print(f"{there}." if page is None else f"{there} or on its page. The page's address:", flush=True)
    print(navigate_vid(Tracker(vid), replay, make_renderer, page, duration_s=config.seconds))


def _vid(config: Any, out: Path, overwrite: bool, steps: Any) -> tuple[Any, Any, Any]:
    """The demo's VID, built unless it is there and may stay, what draws in it, and the plan of its views."""
    from functools import partial

    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from ursnav_torch.localization import learn_confidence
    from ursnav_torch.processes import busy_children
    from ursnav_torch.runs.demo import demo_vid
    from ursnav_torch.vid import build_vid, load_vid

    folder = out.with_name(out.name + "_vid")
    make_renderer, plan = instantiate(config.rendering), instantiate(config.views)
    if config.live and folder.exists():
        return load_vid(folder), make_renderer, plan

    def learn(vid: Any, progress: Any) -> dict[str, object]:
        steps.begin("Learning from other pictures how far answers in this kidney can be trusted")
        count, children = config.queries_per_calyx, busy_children(config.workers)
        return learn_confidence(vid, make_renderer, plan, count, progress, children=children)

    steps.begin("Drawing views of the kidney, and reducing each to what can be compared")
    kidney, camera, features = (instantiate(config[choice]) for choice in ("kidney", "camera", "features"))
    build = partial(
        build_vid, kidney, camera, features, make_renderer, plan,
        overwrite=overwrite, workers=config.workers, progress=progress, learn=learn,
    )  # fmt: skip
    if config.live:
        return build(folder), make_renderer, plan
    kept: Any = OmegaConf.to_container(config, resolve=True)
    made_for = {name: value for name, value in kept.items() if name not in ("out", "overwrite", "workers")}
    return demo_vid(build, out, made_for, overwrite), make_renderer, plan


if __name__ == "__main__":
    main()
