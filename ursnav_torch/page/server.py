"""The page's server: only its own pages and this computer's programs reach it, and nothing they send names a file."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from ursnav_torch.errors import InputError, UrsnavError
from ursnav_torch.extras import import_extra
from ursnav_torch.page.commands import Command
from ursnav_torch.page.conversation import Conversation
from ursnav_torch.page.guard import Guard
from ursnav_torch.page.mailbox import Mailbox

LOCAL = ("127.0.0.1", "localhost", "::1")
STATIC = Path(__file__).parent / "static"
#: The server has so long to come up, and to end.
PATIENCE_S = 20.0


def check_address(host: str, port: int) -> None:
    """Refuse to be reached from other computers: the page has no password, and whoever sees it could stop the robot.

    Raises:
        InputError: the address is not this computer's own, or the port cannot be had.
    """
    if host not in LOCAL:
        raise InputError(
            f"viewer.host={host} would let other computers in, and the page has no password. It listens on 127.0.0.1 "
            f"only; from another computer, tunnel to it: ssh -L {port}:127.0.0.1:{port} USER@THIS_COMPUTER, and open "
            f"http://127.0.0.1:{port} there."
        )
    family = socket.AF_INET6 if host == "::1" else socket.AF_INET
    with contextlib.closing(socket.socket(family, socket.SOCK_STREAM)) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError) as error:
            raise InputError(f"Port {port} cannot be had ({error}); choose another by viewer.port=.") from None


class PageServer:
    """Serves one page with what it fetches, publishes to all who look at it, and takes their commands.

    Args:
        page: the HTML file in ``static/``.
        commands: by name.
        resources: what the page fetches besides, by path: kind and a function that makes the bytes once.
        host, port: where to listen; this computer only, port 0 takes any that is free.
        programs: let programs that are no browsers connect, too.

    Raises:
        InputError: see `check_address`.
        MissingExtraError: the extra ``viewer`` is not installed.
        UrsnavError: the server did not come up.
    """

    def __init__(
        self,
        page: str,
        commands: Mapping[str, Command],
        resources: Mapping[str, tuple[str, Callable[[], bytes]]],
        address: tuple[str, int] = ("127.0.0.1", 8080),
        programs: bool = False,
    ) -> None:
        check_address(*address)
        import_extra("starlette", "viewer", "The page (viewer=none does without)")
        uvicorn = import_extra("uvicorn", "viewer", "The page (viewer=none does without)")
        self._commands, self._mailbox = dict(commands), Mailbox()
        app = Guard(_application(page, resources, self._speak), programs)
        config = uvicorn.Config(
            app, *address, log_config=None, access_log=False, lifespan="off", ws="websockets-sansio",
            ws_max_size=65_536, ws_per_message_deflate=False, timeout_graceful_shutdown=1, server_header=False,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, name="page-server", daemon=True)
        self._thread.start()
        until = time.monotonic() + PATIENCE_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > until:
                raise UrsnavError(f"The page's server did not come up at port {address[1]}; is it in use?")
            time.sleep(0.005)
        self.port = int(self._server.servers[0].sockets[0].getsockname()[1])
        self.url = f"http://127.0.0.1:{self.port}"

    @property
    def watched(self) -> bool:
        """Whether anybody looks at the page."""
        return self._mailbox.readers > 0

    def wanted(self, kind: str) -> bool:
        """Whether somebody would see a message of a kind at once: none is under way to a page that looks."""
        return self._mailbox.wanted(kind)

    def publish(self, kind: str, **values: Any) -> None:
        """Send plain values to all pages; who opens one later gets the last of every kind."""
        self._mailbox.put(kind, msgspec.json.encode({"kind": kind, **values}).decode())

    def publish_picture(self, kind: str, jpeg: bytes, holds: str = "", **values: Any) -> None:
        """Send a picture: a line of JSON with the values, then the bytes; what was left of a kind it holds is old."""
        self._mailbox.put(kind, msgspec.json.encode({"kind": kind, **values}) + b"\n" + jpeg, holds)

    def stop(self) -> None:
        """End the server and its pages' connections."""
        self._mailbox.close()
        self._server.should_exit = True
        self._thread.join(PATIENCE_S)

    async def _speak(self, socket: Any) -> None:
        """Serve one page's connection until it is closed."""
        await Conversation(socket, self._mailbox, self._commands).serve()


def _application(
    page: str, resources: Mapping[str, tuple[str, Callable[[], bytes]]], speak: Callable[[Any], Any]
) -> Any:
    """The routes: the page itself, what it fetches, and its connection."""
    from starlette.applications import Starlette
    from starlette.responses import FileResponse, Response
    from starlette.routing import Mount, Route, WebSocketRoute
    from starlette.staticfiles import StaticFiles

    made: dict[str, bytes] = {}

    def resource(request: Any) -> Response:
        path = request.url.path
        if path not in made:
            made[path] = resources[path][1]()
        return Response(made[path], media_type=resources[path][0])

    return Starlette(
        routes=[
            Route("/", lambda _request: FileResponse(STATIC / page)),
            *(Route(path, resource) for path in resources),
            WebSocketRoute("/live", speak),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
    )
