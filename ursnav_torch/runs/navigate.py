"""A `navigate` run: devices or a record in, page, record and report out."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ursnav_torch.autonomy import AutonomySettings
from ursnav_torch.camera import PictureCut
from ursnav_torch.exploration import ExplorationSettings
from ursnav_torch.files import write_json
from ursnav_torch.navigation import Governor, Navigator, Page, run_navigation, sensor_in_kidney
from ursnav_torch.reports.session import write_session_report
from ursnav_torch.reports.stones import write_stone_files
from ursnav_torch.session import Recorder, Replay, Rig
from ursnav_torch.simulation import World
from ursnav_torch.stones import KnownStone, stone_sentences
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import MakeRenderer

REPORT, EXPLORED = "report.html", "explored.json"
STONES, STONES_PICTURE = "stones.csv", "stones.png"


def navigate_vid(
    tracker: Tracker,
    hardware: Replay | Callable[..., Rig],
    make_renderer: MakeRenderer,
    page: Page | None = None,
    out: Path | None = None,
    duration_s: float = 0.0,
    em_to_kidney: Path | None = None,
    sensor_offset_mm: list[float] | None = None,
    latency_s: float = 0.13,
    overwrite: bool = False,
    config: Mapping[str, Any] | None = None,
    exploration: ExplorationSettings | None = None,
    autonomy: AutonomySettings | None = None,
    known_stones: tuple[KnownStone, ...] = (),
    cut: PictureCut | None = None,
) -> str:
    """Navigate in a VID's kidney until the session ends; record it and report on it where ``out`` says.

    Args:
        tracker: follows the scope in a VID; a simulated scope is in its kidney and looks through its lens.
        hardware: a record, or what builds a rig (a partial of `session.build_rig`).
        make_renderer: draws a simulated scope's pictures.
        page: what shows it, or None.
        out: folder for the record, with the report in it; None keeps nothing.
        duration_s: end after so long; 0 for no end.
        em_to_kidney, sensor_offset_mm: registration of the EM tracker, and its sensor's place in the camera frame.
        latency_s: time to a pose above which less is done with every picture.
        overwrite: replace what stands in ``out``.
        config: the session's configuration, kept with the record.
        exploration: when wall counts as seen, what the scope can do, and how stones are told.
        autonomy: how the scope moves by itself while the dead-man button is held; None does without.
        known_stones: those of a scan: which of them were found, which were not, which are new.
        cut: where the camera's pictures lie in those of the VID's lens; None: they are as it gives them.

    Returns:
        The summary, for people to read.

    Raises:
        InputError: a result stands there already, or a file cannot be used.
        DeviceError: a device cannot be connected.
    """
    recorder = None if out is None else Recorder(out, config, overwrite)
    sensor = None if em_to_kidney is None else sensor_in_kidney(em_to_kidney, sensor_offset_mm or [0.0, 0.0, 0.0])
    vid = tracker.vid
    navigator = Navigator(tracker, exploration, sensor, Governor(latency_s), known_stones, cut)

    def world() -> World:
        return World(
            vid.kidney,
            make_renderer(vid.kidney.mesh, vid.camera),
            vid.lumen,
            redraw=lambda mesh: make_renderer(mesh, vid.camera),
        )

    found = run_navigation(navigator, hardware, world, recorder, duration_s, page, autonomy)
    watch = navigator.guide.watch
    if out is None:
        return "\n".join([found.text(), *stone_sentences(watch.found(), vid.kidney)])
    stones = write_stone_files(watch, out / STONES, out / STONES_PICTURE)
    if found.explored is not None:
        write_json(out / EXPLORED, found.explored.to_dict())
    report = write_session_report(vid, Replay(out, speed=0), out / REPORT, stones)
    return f"{found.text()}\n{stones.text()}\nrecord in {out}, report in {report}"
