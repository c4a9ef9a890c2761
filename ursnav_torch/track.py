"""Follow the scope through a video: one row a picture, and which calyces were seen."""

from typing import Any

from ursnav_torch._runner import NOT_DONE, OK, caller_path, progress, runner

#: Overrides that name files besides those that all runners share.
PATHS = ("source", "em", "em_to_kidney", "tip", "odometry", "truth", "known_stones")


@runner("track", paths=PATHS)
def main(config: Any) -> int:
    """Instantiate the choices and call `runs.track.track_source`."""
    from hydra.utils import instantiate

    from ursnav_torch.results import check_set
    from ursnav_torch.runs.lenses import stated_lens
    from ursnav_torch.runs.sources import open_source
    from ursnav_torch.runs.track import camera_source, put_back, track_results, track_source
    from ursnav_torch.tracking.follow import Instruments
    from ursnav_torch.tracking.tracker import Tracker
    from ursnav_torch.vid import load_vid

    vid = load_vid(caller_path(config.vid))
    cut = vid.cut_of(*stated_lens(config.camera, instantiate))
    choices = (config.tracking, config.search, config.matching, config.alignment)
    tracker = Tracker(vid, *(instantiate(choice) for choice in choices))
    if config.source == "camera":
        source = camera_source(instantiate(config.device), config.seconds)
    else:
        source = open_source(caller_path(config.source), config.fps)
    source = put_back(source, cut, tracker)
    sensor, readings = _em_readings(config, vid.kidney.mesh.bounds)
    instruments = Instruments(sensor, _odometry(config))
    out, besides = caller_path(config.out), _besides(config, vid.kidney.mesh.bounds)
    check_set(track_results(out, besides), config.overwrite)
    summary, whole = track_source(
        tracker, source, out, instruments, config.overwrite, progress, config.offline, besides
    )
    print(readings + summary)
    return OK if whole else NOT_DONE


def _em_readings(config: Any, bounds_mm: Any) -> tuple[Any, str]:
    """Readings of an EM log by moment, None without one, and a line that says how many pictures have one."""
    from ursnav_torch.em_log import EmFormat
    from ursnav_torch.registration import recorded_readings
    from ursnav_torch.runs.calibrate_tip import read_tip
    from ursnav_torch.runs.sources import picture_times

    if config.em is None:
        return None, ""
    _refuse_camera(config, "em= is the log of a recording; with a camera, `navigate` takes the tracker itself.")
    offset_mm, offset_s = list(config.sensor_offset_mm), config.em_offset_s
    if config.tip is not None:
        offset_mm, offset_s = read_tip(caller_path(config.tip))
    sensor, readings = recorded_readings(
        caller_path(config.em),
        None if config.em_to_kidney is None else caller_path(config.em_to_kidney),
        offset_mm,
        *picture_times(caller_path(config.source), config.fps),
        EmFormat(config.em_unit, config.em_time_unit, offset_s, config.em_join, config.em_tool),
        bounds_mm,
    )
    return sensor, readings + "\n"


def _odometry(config: Any) -> Any:
    """The robot's recorded reports, None without any."""
    from ursnav_torch.runs.sources import recorded_odometry

    if config.odometry is None:
        return None
    _refuse_camera(config, "odometry= is the log of a recording; with a camera, `navigate` hears the robot itself.")
    return recorded_odometry(caller_path(config.odometry))


def _besides(config: Any, bounds_mm: Any) -> Any:
    """What is made of the rows besides the rows, and the files that the result is bound to."""
    from hydra.utils import instantiate

    from ursnav_torch.runs.track_files import Besides, read_truth
    from ursnav_torch.stones import read_known_stones

    truth = None if config.truth is None else read_truth(caller_path(config.truth), bounds_mm)
    read = [config[key] for key in PATHS if config[key] is not None]
    inputs = tuple(caller_path(path) for path in read if path != "camera")
    known: Any = ()
    if config.known_stones is not None:
        known = read_known_stones(caller_path(config.known_stones), config.known_stones_unit, bounds_mm)
    return Besides(truth, config.tum, inputs, instantiate(config.exploration), known)


def _refuse_camera(config: Any, why: str) -> None:
    """Refuse a recording's log beside a live camera."""
    from ursnav_torch.errors import InputError

    if config.source == "camera":
        raise InputError(why)


if __name__ == "__main__":
    main()
