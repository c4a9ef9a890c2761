"""Navigate live: the scope's place, what was seen and the way on, on a page in the browser."""

from typing import Any

from ursnav_torch._runner import caller_path, runner
from ursnav_torch.teleop import PATHS


@runner("navigate", paths=(*PATHS, "em_to_kidney", "tip", "known_stones"))
def main(config: Any) -> None:
    """Instantiate the choices and call `runs.navigate.navigate_vid`."""
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from ursnav_torch.runs.calibrate_tip import live_place
    from ursnav_torch.runs.lenses import lens_of
    from ursnav_torch.runs.navigate import navigate_vid
    from ursnav_torch.stones import read_known_stones
    from ursnav_torch.tracking.tracker import Tracker
    from ursnav_torch.vid import load_vid

    choices = (config.tracking, config.search, config.matching, config.alignment)
    vid = load_vid(caller_path(config.vid))
    cut = vid.cut_of(*lens_of(config.camera, config.hardware, instantiate))
    known: Any = ()
    if config.known_stones is not None:
        bounds_mm = vid.kidney.mesh.bounds
        known = read_known_stones(caller_path(config.known_stones), config.known_stones_unit, bounds_mm)
    plain: Any = OmegaConf.to_container(config, resolve=True)
    summary = navigate_vid(
        Tracker(vid, *(instantiate(choice) for choice in choices)),
        instantiate(config.hardware),
        make_renderer=instantiate(config.rendering),
        page=instantiate(config.viewer) if config.viewer else None,
        out=None if config.out is None else caller_path(config.out),
        duration_s=config.seconds,
        em_to_kidney=None if config.em_to_kidney is None else caller_path(config.em_to_kidney),
        sensor_offset_mm=list(config.sensor_offset_mm) if config.tip is None else live_place(caller_path(config.tip)),
        latency_s=config.latency_s,
        overwrite=config.overwrite,
        config=plain,
        exploration=instantiate(config.exploration),
        autonomy=instantiate(config.autonomy) if config.autonomy else None,
        known_stones=known,
        cut=cut,
    )
    print(summary)


if __name__ == "__main__":
    main()
