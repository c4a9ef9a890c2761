"""A live page beside a session, and somebody who looks at it, closes it and opens it anew."""

import contextlib
import json
import threading
import urllib.request
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ursnav_torch.camera import Camera
from ursnav_torch.devices import Frame
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import Kidney
from ursnav_torch.navigation import Navigator
from ursnav_torch.page import LivePage
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.session import Event, SessionControls
from ursnav_torch.tracking.tracker import Tracker
from ursnav_torch.vid import PlanSettings, build_vid


class Watching:
    """A page that shows a session's pictures; a context manager, looked at within the block.

    Nothing is located: what is asked is whether page and server hold on to anything.

    Args:
        kidney, lens: what the page shows.
        folder: for a small VID.

    Attributes:
        heard: messages that arrived on the page, of all its openings.
        reloads: how often it was opened.
    """

    def __init__(self, kidney: Kidney, lens: Camera, folder: Path) -> None:
        plan = PlanSettings(views_per_calyx=2, passage_views=2)
        vid = build_vid(kidney, lens, DefaultSettings(), RaycastRenderer, plan, folder, workers=1)
        self._page = LivePage(Navigator(Tracker(vid)), SessionControls(lambda: None), port=0)
        self._looking = contextlib.ExitStack()
        self.heard = self.reloads = 0

    def __enter__(self) -> Self:
        self.reload()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._looking.close()
        self._page.close()

    def show(self, event: Event) -> None:
        """Show a picture of the session."""
        if isinstance(event, Frame):
            self._page.navigator.bus.update(lambda state: replace(state, frame=event))

    def reload(self) -> None:
        """Close the page, as a browser's reload does, and open it: its text, its kidney, its connection."""
        from websockets.sync.client import connect
        from websockets.typing import Origin

        self._looking.close()
        for path in ("/", "/static/live.js", "/kidney.bin", "/calyx/0.jpg"):
            with urllib.request.urlopen(self._page.url + path, timeout=60) as answer:
                answer.read()
        address = self._page.url.replace("http", "ws") + "/live"
        socket: Any = connect(
            address, origin=Origin(self._page.url), open_timeout=60, max_size=1 << 24, ping_interval=None
        )
        self._looking.enter_context(socket)
        looking = threading.Thread(target=self._look, args=(socket,), name="looking", daemon=True)
        looking.start()
        self._looking.callback(looking.join, 5.0)
        self._looking.callback(socket.close)
        self.reloads += 1

    def _look(self, socket: Any) -> None:
        for message in socket:
            self.heard += 1
            line = message if isinstance(message, str) else message.split(b"\n", 1)[0]
            socket.send(json.dumps({"shown": json.loads(line)["kind"]}))
