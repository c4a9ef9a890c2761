"""A session of the digital twin without waiting for it: a flight is drawn, navigated and kept as a record."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.devices import Frame, Stamp
from ursnav_torch.files import Progress, no_progress, whole_folder
from ursnav_torch.navigation.effort import Governor
from ursnav_torch.navigation.navigator import Navigator
from ursnav_torch.navigation.run import run_navigation
from ursnav_torch.processes import busy_children, in_order
from ursnav_torch.rendering.sensor import PRESETS, draw_faults, simulate
from ursnav_torch.session import Recorder, Replay
from ursnav_torch.simulation.flight import FlightSettings, fly
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import MakeRenderer, Vid

#: Calyces that the flight visits, pictures a second, and their kind of sensor faults.
VISITED, RATE_HZ, FAULTS = 3, 10.0, "thesis_phantom"
#: Nobody waits for these poses: nothing is left out for the sake of pace.
NEVER_LATE_S = 1e9


def record_flight(
    vid: Vid,
    make_renderer: MakeRenderer,
    out: Path,
    *,
    pictures: int = 300,
    workers: int | None = None,
    progress: Progress = no_progress,
    begin: Callable[[str], None] = lambda what: None,
) -> Path:
    """Fly through a VID's kidney, navigate by the pictures, and keep both; the record's folder, in ``out``.

    Args:
        vid: the kidney and its views.
        make_renderer: called as ``make_renderer(mesh, camera)``.
        out: folder to be made.
        pictures: at most.
        workers: processes; all cores when None.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        begin: told what is done next.
    """
    names = [c.name for c in vid.kidney.calyces]
    visited = tuple(names[i] for i in np.linspace(0, len(names) - 1, VISITED).round().astype(int))
    flight = fly(vid.kidney, vid.lumen, visited, FlightSettings(pictures_per_s=RATE_HZ, pictures=pictures), _rng(0))
    with whole_folder(out, overwrite=False, resume=False) as work:
        begin(f"Flying a simulated scope into calyces {', '.join(visited)}: {len(flight.t_s)} pictures")
        with Recorder(work / "flight") as recorder, progress(len(flight.t_s), "pictures flown") as advance:
            for i, image in enumerate(_images(vid, make_renderer, flight.T_kidney_camera, workers)):
                recorder.write(Frame(Stamp(i, float(flight.t_s[i]), 1e9 + float(flight.t_s[i])), image))
                advance(1)
        begin("Navigating by them")
        navigator = Navigator(Tracker(vid), governor=Governor(NEVER_LATE_S))
        run_navigation(navigator, Replay(work / "flight", speed=0), recorder=Recorder(work / "session"))
        shutil.rmtree(work / "flight")
    return out / "session"


def _images(
    vid: Vid, make_renderer: MakeRenderer, T_kidney_camera: NDArray[np.float64], workers: int | None
) -> Iterator[NDArray[np.uint8]]:
    """The pictures (H, W, 3) of poses (N, 4, 4), each with its own noise and all with the same faults."""
    children = busy_children(workers)
    return in_order(partial(_Scope, vid, make_renderer), enumerate(T_kidney_camera), children)


class _Scope:
    """Called with a picture's number and pose (4, 4): the picture."""

    def __init__(self, vid: Vid, make_renderer: MakeRenderer) -> None:
        self._renderer = make_renderer(vid.kidney.mesh, vid.camera)
        self._faults = draw_faults(PRESETS[FAULTS], _rng(1))

    def __call__(self, numbered: tuple[int, NDArray[np.float64]]) -> NDArray[np.uint8]:
        number, T = numbered
        return simulate(self._renderer, T, self._faults, np.random.default_rng([2, number]))


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)
