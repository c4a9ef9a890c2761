"""A kidney flown through by hand: virtual view, views for the VID, names, landmarks, what looks alike."""

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import look_along
from ursnav_torch.kidney import observed_calyx
from ursnav_torch.localization import LookAlikes
from ursnav_torch.page.collected import FLIGHT, Collection, fly, pick_wall
from ursnav_torch.page.commands import Command
from ursnav_torch.page.pictures import PagePictures, jpeg
from ursnav_torch.page.scene import kidney_bytes
from ursnav_torch.page.server import PageServer
from ursnav_torch.rendering import RaycastRenderer, RayScene
from ursnav_torch.vid import PlanSettings, Vid

Array = NDArray[np.float64]

STEP_MM, TURN_RAD = 0.5, np.radians(4.0)


class ExplorePage:
    """A page to explore a VID's kidney with.

    Args:
        vid: the kidney, its lens and its views.
        out: folder that "save" writes to; None keeps nothing.
        overwrite: replace what stands there.
        host, port: where to listen; this computer only.

    Raises:
        InputError, MissingExtraError: see `PageServer`.
    """

    def __init__(
        self, vid: Vid, out: Path | None, overwrite: bool = False, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        self.vid, self._out, self._overwrite = vid, out, overwrite
        self.lumen, self.collection = vid.lumen, Collection(vid.kidney)
        self._renderer, self._wall = RaycastRenderer(vid.kidney.mesh, vid.camera), RayScene(vid.kidney.mesh)
        start = vid.kidney.pelvis_mm
        self.T_kidney_camera = look_along(start, vid.kidney.tips_mm.mean(axis=0) - start)
        self._lock, self.ended = threading.RLock(), threading.Event()
        self._pictures = PagePictures(vid)
        resources: dict[str, tuple[str, Callable[[], bytes]]] = {
            "/kidney.bin": ("application/octet-stream", lambda: kidney_bytes(vid.kidney))
        }
        for i in range(len(vid.kidney.calyces)):
            resources[f"/calyx/{i}.jpg"] = ("image/jpeg", lambda i=i: jpeg(self._pictures.thumbnail(i)))  # type: ignore[misc]
        self.server = PageServer("explore.html", self._commands(), resources, (host, port))
        self.url = self.server.url
        self.server.publish("about", moves=list(FLIGHT), saves=out is not None, alike=self._alike())
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
            self._show()

    def take_view(self) -> None:
        """Keep the view from here for a VID."""
        with self._lock:
            self.collection.T_kidney_camera.append(self.T_kidney_camera.copy())
            self._show()

    def plan_again(self, views_a_calyx: int) -> None:
        """Replace the views kept by planned ones."""
        settings = PlanSettings(views_per_calyx=views_a_calyx, passage_views=views_a_calyx)
        with self._lock:
            self.collection.plan(settings, self.lumen)
            self._show()

    def rename(self, names: tuple[str, str]) -> None:
        """Give a calyx (first name) another name (second)."""
        with self._lock:
            self.collection.rename(*names)
            self._show()

    def pick(self, ray: tuple[float, ...]) -> None:
        """Keep the place where a ray, origin and direction in the kidney frame, meets the wall first."""
        with self._lock:
            place = pick_wall(self._wall, np.array(ray[:3]), np.array(ray[3:])) if any(ray[3:]) else None
            if place is not None:
                self.collection.landmarks_mm.append(place)
                self._show()

    def unpick(self) -> None:
        """Take back the last landmark."""
        with self._lock:
            if self.collection.landmarks_mm:
                self.collection.landmarks_mm.pop()
            self._show()

    def save(self) -> str:
        """Write what was collected to the folder named at the start; nothing that the page sends names a file."""
        if self._out is None:
            raise InputError("There is nowhere to save to; start explore with out=FOLDER.")
        with self._lock:
            said = self.collection.save(self._out, self._renderer, self.lumen, self._overwrite)
            self._overwrite = True  # what was saved from this page may be saved again
            self.server.publish("said", text=said)
        print(said, file=sys.stderr, flush=True)
        return said

    def close(self) -> None:
        """Take the page away."""
        self.server.stop()

    def _commands(self) -> dict[str, Command]:
        """What the page may ask for."""
        return {
            "fly": Command(self.fly, str, choices=tuple(FLIGHT)),
            "go_to": Command(self.go_to, str),
            "rename": Command(self.rename, tuple[str, str]),
            "take": Command(self.take_view),
            "plan": Command(self.plan_again, int, 1, 1000),
            "pick": Command(self.pick, tuple[float, float, float, float, float, float]),
            "unpick": Command(self.unpick),
            "save": Command(self.save),
            "end": Command(self.ended.set),
        }

    def _alike(self) -> dict[str, Any]:
        """What looks alike: shares in percent of the row, by names of rows and columns, and sentences."""
        known = (self.vid.calibration or {}).get("look_alikes")
        if not isinstance(known, dict):
            return {"names": [], "share": [], "sentences": ["Not known: build_vid learns it from simulated pictures."]}
        alike, names = LookAlikes.from_dict(known), [c.name for c in self.vid.kidney.calyces]
        share = 100 * alike.counts / np.maximum(alike.counts.sum(axis=1, keepdims=True), 1)
        return {"names": [*names, "(none)"], "share": share.round().tolist(), "sentences": alike.sentences(names)}

    def _show(self) -> None:
        T, kept = self.T_kidney_camera, self.collection
        names = [c.name for c in kept.kidney.calyces]
        index = int(observed_calyx(T[None], self.vid.kidney, self.lumen)[0])
        place = f"Calyx {names[index]}." if index >= 0 else "No calyx observed."
        words = f"{place} {kept_words(len(kept.T_kidney_camera), len(kept.landmarks_mm))} kept."
        picture = self._pictures.large(T)
        self.server.publish_picture("scope", jpeg(picture), width=picture.shape[1], height=picture.shape[0], edges=[])
        self.server.publish(
            "state",
            status=words,
            pose=T.round(4).ravel().tolist(),
            calyces=names,
            views=[pose[:3, 3].round(2).tolist() for pose in kept.T_kidney_camera],
            landmarks=[place.round(2).tolist() for place in kept.landmarks_mm],
        )


def kept_words(views: int, landmarks: int) -> str:
    """How much was collected.

    Example:
        >>> kept_words(1, 3)
        '1 view and 3 landmarks'
    """
    return f"{views} view{'s' * (views != 1)} and {landmarks} landmark{'s' * (landmarks != 1)}"


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
