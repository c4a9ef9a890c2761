"""A kidney flown through by hand: virtual view, views for the VID, names, landmarks, what looks alike."""

import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import LumenDistance, observed_calyx
from ursnav_torch.localization import LookAlikes
from ursnav_torch.page.collected import FLIGHT, Collection, fly, pick_wall
from ursnav_torch.page.pictures import Pictures
from ursnav_torch.page.scene import KidneyScene
from ursnav_torch.page.server import on_choice, on_press, start_server, stop_server
from ursnav_torch.page.words import kept_words, look_alikes_html, picture_html, status_html
from ursnav_torch.rendering import RaycastRenderer, RayScene
from ursnav_torch.vid import PlanSettings, Vid

Array = NDArray[np.float64]

KEYS = dict(zip(FLIGHT, "IKJLUMYO", strict=True))
STEP_MM, TURN_RAD, HOLD_HZ = 0.5, np.radians(4.0), 10.0


class ExplorePage:
    """A page to explore a VID's kidney with.

    Args:
        vid: the kidney, its lens and its views.
        out: folder that "save" writes to; None keeps nothing.
        overwrite: replace what stands there.
        host, port: where to listen; this computer only.

    Raises:
        InputError, MissingExtraError: see `start_server`.
    """

    def __init__(
        self, vid: Vid, out: Path | None, overwrite: bool = False, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        self.vid, self._out, self._overwrite = vid, out, overwrite
        self.lumen, self.collection = LumenDistance.from_kidney(vid.kidney), Collection(vid.kidney)
        self._renderer, self._wall = RaycastRenderer(vid.kidney.mesh, vid.camera), RayScene(vid.kidney.mesh)
        start = vid.kidney.pelvis_mm
        self.T_kidney_camera = look_along(start, vid.kidney.tips_mm.mean(axis=0) - start)
        self._lock, self.ended = threading.RLock(), threading.Event()
        self.server = start_server(host, port, "ursnav explore")
        self.url = f"http://127.0.0.1:{self.server.get_port()}"
        self._pictures = Pictures(vid)
        self._scene = KidneyScene(self.server, vid.kidney, self.go_to)
        self._add_panels()
        self._show()

    def fly(self, move: str) -> None:
        """One step of `FLIGHT`."""
        with self._lock:
            unit = self.vid.kidney.scale
            self.T_kidney_camera = fly(self.T_kidney_camera, move, self.lumen, STEP_MM * unit, TURN_RAD, unit)
            self._show()

    def go_to(self, calyx: str) -> None:
        """Jump to one of the VID's views of a calyx, half-way in."""
        with self._lock:
            index = [c.name for c in self.collection.kidney.calyces].index(calyx)
            own = np.flatnonzero(self.vid.calyx == index)
            if not len(own):
                raise InputError(f"The VID has no view of calyx {calyx}.")
            away = np.linalg.norm(self.vid.T_kidney_camera[own, :3, 3] - self.vid.kidney.tips_mm[index], axis=1)
            self.T_kidney_camera = self.vid.T_kidney_camera[own[np.argsort(away)[len(own) // 2]]].copy()
            self._chosen.value = calyx
            self._show_views(index)
            self._show()

    def take_view(self) -> None:
        """Keep the view from here for a VID."""
        with self._lock:
            self.collection.T_kidney_camera.append(self.T_kidney_camera.copy())
            self._show()

    def plan_again(self) -> None:
        """Replace the views kept by planned ones."""
        settings = PlanSettings(views_per_calyx=int(self._count.value), passage_views=int(self._count.value))
        with self._lock:
            self.collection.plan(settings, self.lumen)
            self._show()

    def rename(self) -> None:
        """Give the calyx chosen the name in the field."""
        with self._lock:
            old, new = str(self._chosen.value), str(self._name.value).strip()
            self.collection.rename(old, new)
            self._scene.rename(old, new, self.go_to)
            self._chosen.options = [c.name for c in self.collection.kidney.calyces]
            self._chosen.value = new
            self._show_views(self._chosen.options.index(new))
            self._show()

    def save(self) -> str:
        """Write what was collected to the folder named at the start; nothing that the page sends names a file."""
        if self._out is None:
            raise InputError("There is nowhere to save to; start explore with out=FOLDER.")
        with self._lock:
            said = self.collection.save(self._out, self._renderer, self.lumen, self._overwrite)
            self._overwrite = True  # what was saved from this page may be saved again
            self._said.content = status_html(said)
        print(said, file=sys.stderr, flush=True)
        return said

    def close(self) -> None:
        """Take the page away."""
        stop_server(self.server)

    def _add_panels(self) -> None:
        gui = self.server.gui
        panel = gui.add_panel()
        with panel.add_tab("Fly"):
            self._status = gui.add_html("")
            for move, key in KEYS.items():
                self._add_move(gui, move, key)
            on_press(gui.add_button("End"))(self.ended.set)
        panel.dock_left()
        panel.set_width(250)
        gui.set_panel_label("Kidney")
        self._view = gui.add_html("")
        with gui.add_folder("Calyx"):
            self._chosen = gui.add_dropdown("calyx", [c.name for c in self.vid.kidney.calyces])
            on_press(gui.add_button("Go there"))(lambda: self.go_to(str(self._chosen.value)))
            self._name = gui.add_text("new name", "")
            on_press(gui.add_button("Rename"))(self.rename)
            self._views = gui.add_html("")
        with gui.add_folder("Collect"):
            on_press(gui.add_button("Take this view", hint="Keeps the pose for a VID."))(self.take_view)
            self._count = gui.add_number("views a calyx", 40, min=1, max=1000, step=1)
            on_press(gui.add_button("Plan views again", hint="Replaces the views kept."))(self.plan_again)
            picking = gui.add_checkbox("Pick landmarks: click the kidney", False)
            on_choice(picking, lambda wanted: self._scene.on_wall(self._pick if wanted else None))
            on_press(gui.add_button("Take back the last landmark"))(self._unpick)
            on_press(gui.add_button("Save", color="green"))(lambda: (self.save(), None)[1])
            self._said = gui.add_html("")
        with gui.add_folder("What looks alike", expand_by_default=False):
            known = (self.vid.calibration or {}).get("look_alikes")
            names = [c.name for c in self.vid.kidney.calyces]
            alike = LookAlikes.from_dict(known) if isinstance(known, dict) else None
            gui.add_html(look_alikes_html(alike, names))

    def _add_move(self, gui: Any, move: str, key: str) -> None:
        button = gui.add_button(f"{move} ({key})", hint="Hold to go on.")
        button.on_hold(lambda _event: self.fly(move), callback_hz=HOLD_HZ)
        on_press(button)(lambda: self.fly(move))
        gui.add_command(f"Fly {move}", hotkey=key).on_trigger(lambda _event: self.fly(move))

    def _pick(self, origin: Array, direction: Array) -> None:
        """Somebody clicked the kidney."""
        with self._lock:
            place = pick_wall(self._wall, origin, direction)
            if place is not None:
                self.collection.landmarks_mm.append(place)
                self._show()

    def _unpick(self) -> None:
        with self._lock:
            if self.collection.landmarks_mm:
                self.collection.landmarks_mm.pop()
            self._show()

    def _show_views(self, calyx: int) -> None:
        name = self.collection.kidney.calyces[calyx].name
        self._views.content = picture_html(self._pictures.calyx(calyx), f"views of calyx {name}", "views")

    def _show(self) -> None:
        T, kept = self.T_kidney_camera, self.collection
        index = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        place = f"Calyx {kept.kidney.calyces[index].name}." if index >= 0 else "No calyx observed."
        collected = f" {kept_words(len(kept.T_kidney_camera), len(kept.landmarks_mm))} kept."
        self._status.content = status_html(place + collected)
        picture = self._pictures.large(T)
        self._view.content = picture_html(picture, "virtual view from here", "pair")
        self._scene.show_camera(T)
        self._scene.show_picture(picture)
        self._scene.show_points("views", [pose[:3, 3] for pose in kept.T_kidney_camera], (90, 60, 200))
        self._scene.show_points("landmarks", kept.landmarks_mm, (250, 150, 0), 2.0)


def explore_vid(vid: Vid, out: Path | None, overwrite: bool, host: str, port: int, seconds: float) -> str:
    """Serve an `ExplorePage` until somebody ends it there, for some seconds (0: no end), or until Ctrl-C.

    Returns:
        What was saved, for people to read.
    """
    page = ExplorePage(vid, out, overwrite, host, port)
    print(f"page: {page.url}", file=sys.stderr, flush=True)
    try:
        page.ended.wait(seconds or None)
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    kept = page.collection
    return f"{kept_words(len(kept.T_kidney_camera), len(kept.landmarks_mm))} were kept on the page."
