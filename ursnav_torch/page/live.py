"""The page of a live session: an observer that looks at the newest state a few times a second."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ursnav_torch.navigation import NavigationState, Navigator
from ursnav_torch.page.controls import ReplayControls, RobotControls, add_end, add_stop
from ursnav_torch.page.pictures import Pictures
from ursnav_torch.page.scene import KidneyScene
from ursnav_torch.page.server import on_press, start_server, stop_server
from ursnav_torch.page.words import confidence_html, coverage_html, latency_html, picture_html, status_html
from ursnav_torch.session import SessionControls

logger = logging.getLogger(__name__)

#: Looks at the state a second.
UPDATES_HZ = 10.0
#: Seconds between pictures beside the kidney.
PICTURE_S = 0.2
#: Seconds between changes of the scene, of the picture in it, and of wall and ways. The browser draws on for a quarter
#: of a second after each, which without a graphics card takes a core.
SCENE_S, FRUSTUM_S, PAINT_S = 0.25, 0.5, 1.0
#: On a slow machine pictures, and scenes, change so many times less often; the words do not.
SLOWER, MUCH_SLOWER = 3.0, 6.0


class LivePage:
    """Shows navigation on a page; closing it changes nothing, opening it again shows everything.

    Args:
        navigator: what to show.
        controls: what steers its session.
        host, port: where to listen; this computer only.
        programs: let programs that are no browsers connect, too.

    Raises:
        InputError: another address than this computer's, or a port that is taken.
        MissingExtraError: viser is not installed.
    """

    def __init__(
        self,
        navigator: Navigator,
        controls: SessionControls,
        host: str = "127.0.0.1",
        port: int = 8080,
        programs: bool = False,
    ) -> None:
        self.navigator, self.controls, self._vid = navigator, controls, navigator.vid
        self.server = start_server(host, port, "ursnav", programs)
        self.url = f"http://127.0.0.1:{self.server.get_port()}"
        self._pictures = Pictures(self._vid)
        self._scene = KidneyScene(self.server, self._vid.kidney, self.choose)
        self._end = threading.Event()
        self._done_s: dict[str, float] = {}
        self._version = -1
        self._located, self._rate = (time.monotonic(), 0), 0.0
        self._shown: Any = None
        self._framed: Any = None
        self._add_left()
        self._add_right()
        self._threads = [
            threading.Thread(target=self._run, args=part, name=f"page{part[0].__name__}", daemon=True)
            for part in ((self._show_words, UPDATES_HZ), (self._show_pictures, 2 / PICTURE_S))
        ]
        for thread in self._threads:
            thread.start()

    def choose(self, calyx: str) -> None:
        """A calyx was clicked: route there and show its views; clicked again, navigation proposes the next."""
        chosen = self.navigator.bus.latest().guidance.chosen
        self.navigator.choose("" if calyx == chosen else calyx)
        names = [c.name for c in self._vid.kidney.calyces]
        views = self._pictures.calyx(names.index(calyx))
        self._views.content = picture_html(views, f"views of calyx {calyx}", "views")

    def close(self) -> None:
        """Take the page away."""
        self._end.set()
        for thread in self._threads:
            thread.join(timeout=5.0)
        stop_server(self.server)

    def _add_left(self) -> None:
        """The panel with what must always be in reach."""
        gui = self.server.gui
        panel = gui.add_panel()
        self._robot: RobotControls | None = None
        self._replay: ReplayControls | None = None
        with panel.add_tab("Session"):
            console = self.controls.console
            if console is not None and console.has_robot:
                add_stop(self.server, console)
            self._status = gui.add_html(status_html("Starting."))
            self._confidence = gui.add_html("")
            if self.controls.player is not None:
                self._replay = ReplayControls(self.server, self.controls.player)
            if console is not None and console.has_robot:
                self._robot = RobotControls(self.server, console)
            add_end(self.server, self.controls)
        panel.dock_left()
        panel.set_width(270)

    def _add_right(self) -> None:
        """The panel with pictures, calyces and figures."""
        gui = self.server.gui
        gui.set_panel_label("Scope and kidney")
        self._pair = gui.add_html("")
        self._coverage = gui.add_html("")
        with gui.add_folder("Go to calyx"):
            group = gui.add_button_group("", [c.name for c in self._vid.kidney.calyces])
            on_press(group)(lambda: self.choose(str(group.value)))
            on_press(gui.add_button("Propose the next one"))(lambda: self.navigator.choose(""))
            self._views = gui.add_html("")
        self._latency = gui.add_html("")

    def _run(self, show: Callable[[NavigationState], None], hertz: float) -> None:
        """Bring a part of the page up to date for as long as there is somebody to see it."""
        while not self._end.wait(1 / hertz):
            if not self.server.get_clients():
                continue
            try:
                show(self.navigator.bus.latest())
            except Exception:  # whatever a picture does to the page, navigation and its controls stay
                logger.exception("The page could not be brought up to date.")

    def _show_words(self, state: NavigationState) -> None:
        """Texts: little to send and to draw."""
        if self._replay:
            self._replay.show()
        if state.version == self._version:
            return
        self._version, g = state.version, state.guidance
        self._count(time.monotonic())
        with self.server.atomic():
            self._status.content = status_html(state.status)
            self._confidence.content = confidence_html(state)
            self._latency.content = latency_html(state, self._rate)
            self._coverage.content = coverage_html(g.coverage, g.chosen)
            if self._robot is not None:
                self._robot.show(state)

    def _show_pictures(self, state: NavigationState) -> None:
        """Pictures and scene: more to make, to send and to draw, so beside the words and less often."""
        slower, much_slower = (SLOWER, MUCH_SLOWER) if state.effort else (1.0, 1.0)
        if state.frame is not None and state.frame is not self._shown and self._due("pair", PICTURE_S * slower):
            self._shown = state.frame
            pair = self._pictures.pair(state.frame.image, state.edges, state.T_kidney_camera)
            self._pair.content = picture_html(pair, "what the scope sees, with its edges; what it should see", "pair")
        if self._due("scene", SCENE_S * much_slower):
            with self.server.atomic():
                self._show_scene(state)

    def _show_scene(self, state: NavigationState) -> None:
        """All changes at once, for which the browser draws once."""
        scene, g = self._scene, state.guidance
        scene.show_camera(state.T_kidney_camera)
        scene.verdicts(g.coverage)
        if state.frame is not None and state.frame is not self._framed and self._due("frustum", FRUSTUM_S):
            self._framed = state.frame
            scene.show_picture(self._pictures.scope(state.frame.image))
        if self._due("paint", PAINT_S):
            scene.paint(self.navigator.patch_of_face, g.seen)
            scene.show_path(state.path_mm)
            scene.show_route(g.route.points_mm if g.route else None)

    def _due(self, what: str, every_s: float) -> bool:
        """Whether it is time again; if so, the time counts anew."""
        now = time.monotonic()
        if now - self._done_s.get(what, 0.0) < every_s:
            return False
        self._done_s[what] = now
        return True

    def _count(self, now: float) -> None:
        """Poses a second, over the last two seconds."""
        since, before = self._located
        if now - since >= 2.0:
            located = self.navigator.located
            self._rate, self._located = (located - before) / (now - since), (now, located)


@contextmanager
def web_page(
    navigator: Navigator,
    controls: SessionControls,
    host: str = "127.0.0.1",
    port: int = 8080,
    programs: bool = False,
) -> Iterator[LivePage]:
    """A `LivePage` for as long as the session runs; says where it is."""
    page = LivePage(navigator, controls, host, port, programs)
    print(f"page: {page.url}", file=sys.stderr, flush=True)
    try:
        yield page
    finally:
        page.close()
