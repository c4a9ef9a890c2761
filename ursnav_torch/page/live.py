"""The page of a live session: an observer that looks at the newest state a few times a second."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ursnav_torch.devices import Frame
from ursnav_torch.kidney import set_words
from ursnav_torch.navigation import NavigationState, Navigator, confidence_words
from ursnav_torch.page.commands import Command
from ursnav_torch.page.overlays import cloud, scope_overlays
from ursnav_torch.page.pictures import PagePictures, jpeg
from ursnav_torch.page.scene import edge_strokes, kidney_bytes, path_pieces, stone_rows
from ursnav_torch.page.server import PageServer
from ursnav_torch.reports.stretches import session_stretches
from ursnav_torch.session import HOLD, MOVES, Player, SessionControls
from ursnav_torch.stones import NO_STONES

logger = logging.getLogger(__name__)

#: Seconds between looks at the state: at least, and at most where there is nothing new.
LOOK_S, LONGEST_S = 0.02, 0.1
#: Seconds between scope's pictures with their states, on a slow machine, and between states without a new picture.
PICTURE_S, PICTURE_SLOW_S, WORDS_S = 0.04, 0.08, 0.15
#: Seconds between drawings of what the scope should see, changes of wall and ways, and of the cloud.
VIRTUAL_S, PAINT_S, CLOUD_S = 0.5, 1.0, 0.25
#: On a slow machine these change so many times less often.
SLOWER = 4.0
#: Seconds between changes of the figures on the last line: nobody reads them faster.
FIGURES_S = 0.5


class LivePage:
    """Shows navigation on a page; closing it changes nothing, opening it again shows everything.

    Args:
        navigator: what to show.
        controls: what steers its session.
        host, port: where to listen; this computer only.
        programs: let programs that are no browsers connect, too.

    Raises:
        InputError: another address than this computer's, or a port that is taken.
        MissingExtraError: the extra ``viewer`` is not installed.
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
        navigator.shows_edges = True
        self._pictures, self._scale = PagePictures(self._vid), self._vid.kidney.scale
        kidney = self._vid.kidney
        resources = {"/kidney.bin": ("application/octet-stream", lambda: kidney_bytes(kidney, navigator.patch_of_face))}
        for i in range(len(kidney.calyces)):
            resources[f"/calyx/{i}.jpg"] = ("image/jpeg", lambda i=i: jpeg(self._pictures.thumbnail(i)))  # type: ignore[misc]
        self.server = PageServer("live.html", self._commands(), resources, (host, port), programs)
        self.url = self.server.url
        self._end, self._done_s = threading.Event(), dict[str, float]()
        self._version, self._painted, self._stones = -1, -1, NO_STONES
        self._shown: Frame | None = None
        self._played, self._figures = (False, -1.0), ""
        self._located, self._rate = (time.monotonic(), 0), 0.0
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self.server.publish("about", **self._about())
        if controls.player is not None:
            self.server.publish("timeline", **timeline(controls.player))
        self._thread.start()

    def choose(self, calyx: str) -> None:
        """A calyx was chosen: route there; chosen again, navigation proposes the next."""
        chosen = self.navigator.bus.latest().guidance.chosen
        self.navigator.choose("" if calyx == chosen else calyx)

    def close(self) -> None:
        """Take the page away."""
        self._end.set()
        self._thread.join(timeout=5.0)
        self.server.stop()

    def _about(self) -> dict[str, Any]:
        """What does not change: which controls there are."""
        console, player = self.controls.console, self.controls.player
        has_robot = console is not None and console.has_robot
        return {
            "robot": has_robot,
            "drive": has_robot and console is not None and console.may_drive,
            "by_itself": self.controls.by_itself,
            "pilot": console is not None and console.has_pilot,
            "duration_s": player.duration_s if player is not None else None,
            "calyces": [c.name for c in self._vid.kidney.calyces],
        }

    def _commands(self) -> dict[str, Command]:
        """What the page may ask for; a robot's commands only where there is one."""
        names, console, player = (
            tuple(c.name for c in self._vid.kidney.calyces),
            self.controls.console,
            self.controls.player,
        )
        found = {
            "choose": Command(self.choose, str, choices=names),
            "propose": Command(lambda: self.navigator.choose("")),
            "end": Command(self.controls.stop),
        }
        if console is not None and console.has_robot:
            found |= {
                "stop": Command(console.emergency_stop, overtakes=True),
                "acknowledge": Command(console.acknowledge),
                "arm": Command(console.arm),
                "pilot": Command(console.give_to_pilot, bool),
                "drive": Command(console.drive, str, choices=(*MOVES, HOLD)),
                "release": Command(console.release),
                "brighten": Command(console.brighten, int, -1, 1),
            }
        if player is not None:
            found |= {
                "play": Command(lambda: player.pause() if player.playing else player.play()),
                "step": Command(player.step),
                "seek": Command(player.seek, float, 0.0, max(player.duration_s, 0.1)),
            }
        return found

    def _run(self) -> None:
        """Bring the page up to date for as long as there is somebody to see it."""
        bus, version = self.navigator.bus, -1
        while not self._end.wait(LOOK_S):
            state = bus.wait(version, LONGEST_S) or bus.latest()
            version = state.version
            if not self.server.watched:
                continue
            for show in (self._show_state, self._show_drawings, self._show_ways):
                self._safely(show, state)

    def _safely(self, show: Callable[[NavigationState], None], state: NavigationState) -> None:
        try:
            show(state)
        except Exception:  # whatever a picture does to the page, navigation and its controls stay
            logger.exception("The page could not be brought up to date.")

    def _show_state(self, state: NavigationState) -> None:
        """Words, the camera's place, and with them what the scope sees: a browser draws them in one frame."""
        player = self.controls.player
        if player is not None and (player.playing, round(player.position_s, 1)) != self._played:
            self._played = player.playing, round(player.position_s, 1)
            self.server.publish("replay", playing=self._played[0], at_s=self._played[1])
        if state.version == self._version:
            return
        frame = state.frame if state.frame is not self._shown else None
        kind, every_s = (
            ("state", WORDS_S) if frame is None else ("scope", PICTURE_SLOW_S if state.effort else PICTURE_S)
        )
        if not self.server.wanted(kind) or not self._due("state", every_s):
            return
        self._version = state.version
        self._count(time.monotonic())
        values = self._values(state)
        if frame is None:
            self.server.publish("state", **values)
        else:
            self._shown = frame
            height, width = frame.image.shape[:2]
            over = scope_overlays(state, self._vid) | {"edges": edge_strokes(state.edges)}
            picture = jpeg(self._pictures.scope(frame.image))
            self.server.publish_picture("scope", picture, "state", state=values, width=width, height=height, **over)

    def _values(self, state: NavigationState) -> dict[str, Any]:
        """The state's words and numbers; how fast all is stays for a while, so that it can be read."""
        console = self.controls.console
        values = state_values(state, self._rate)
        if self._due("figures", FIGURES_S):
            self._figures = values["latency"]
        return values | {"latency": self._figures, "by_hand": console is not None and console.by_hand}

    def _show_drawings(self, state: NavigationState) -> None:
        """The cloud of where the scope may be, and what the scope should see."""
        slower = SLOWER if state.effort else 1.0
        if self._due("cloud", CLOUD_S * slower):
            self.server.publish("cloud", points=cloud(state))
        if self._due("virtual", VIRTUAL_S * slower):
            self.server.publish_picture("virtual", jpeg(self._pictures.virtual(state.T_kidney_camera)))

    def _show_ways(self, state: NavigationState) -> None:
        """The wall that was seen, stones, the path and the way on."""
        if not self._due("paint", PAINT_S * (SLOWER if state.effort else 1.0)):
            return
        route, seen = state.guidance.route, state.guidance.seen
        ways = path_pieces(state.path_mm, self._scale)
        self.server.publish("ways", path=ways, route=[] if route is None else route.points_mm.round(2).tolist())
        if state.guidance.stones is not self._stones:
            self._stones = state.guidance.stones
            self.server.publish("stones", stones=stone_rows(self._stones, self._vid.kidney))
        if int(seen.sum()) != self._painted:
            self._painted = int(seen.sum())
            self.server.publish("seen", patches=seen.nonzero()[0].tolist())

    def _due(self, what: str, every_s: float) -> bool:
        """Whether it is time again; if so, the time counts from when it was due, or from one turn before now."""
        now, done_s = time.monotonic(), self._done_s.get(what, 0.0)
        if now - done_s < every_s:
            return False
        self._done_s[what] = max(done_s + every_s, now - every_s)  # what comes late is made up for, once
        return True

    def _count(self, now: float) -> None:
        """Poses a second, over the last two seconds."""
        since, before = self._located
        if now - since >= 2.0:
            located = self.navigator.located
            self._rate, self._located = (located - before) / (now - since), (now, located)


def timeline(player: Player) -> dict[str, Any]:
    """What a record says was known when, and how long it is, s."""
    stretches = [[round(m.from_s, 2), round(m.to_s, 2), m.kind, m.calyx] for m in session_stretches(player.replay)]
    return {"moments": stretches, "duration_s": player.duration_s}


def state_values(state: NavigationState, rate: float) -> dict[str, Any]:
    """A state as the page shows it, plain: words, verdicts, and the camera's pose (16 numbers, row by row)."""
    g, t, T = state.guidance, state.latency, state.T_kidney_camera
    parts = {"waiting": t.waiting_s, "features": t.features_s, "tracking": t.tracking_s, "painting": t.painting_s}
    stages = ", ".join(f"{name} {1e3 * seconds:.0f}" for name, seconds in parts.items())
    latency = f"picture to pose {1e3 * t.total_s:.0f} ms ({stages}); {rate:.1f} poses a second."
    share = max(0.0, min(1.0, state.confidence))
    return {
        "version": state.version,
        "status": state.status,
        "place": "" if T is None else g.place,
        "calyx": "" if T is None else state.calyx,
        "may_be": "" if T is None or not state.calyx else set_words(state.calyces) or state.calyx,
        "confidence": share if T is not None else 0.0,
        "words": confidence_words(share) if T is not None else "no place known",
        "coverage": [[c.calyx, c.pole, c.verdict, round(c.share, 3)] for c in g.coverage],
        "chosen": g.chosen,
        "next": g.route.calyx if g.route is not None else "",
        "robot": state.robot,
        "autonomy": state.autonomy,
        "notice": state.notice,
        "pose": None if T is None else T.round(4).ravel().tolist(),
        "latency": latency,
        "stale": state.stale,
    }


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
