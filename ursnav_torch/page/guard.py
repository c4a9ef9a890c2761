"""Who may talk to the page's server: its own pages, and programs on this computer that are no browsers.

A browser lets any web page from elsewhere open a connection to 127.0.0.1, or to a name that its owner points there (DNS
rebinding); such a page could stop or drive the robot. It cannot lie about its origin, nor about the host it asked for.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from http import HTTPStatus
from typing import Any

from ursnav_torch.errors import UrsnavError

_one_at_a_time = threading.Lock()


def why_refused(hosts: Sequence[str], origins: Sequence[str], port: int) -> str:
    """Why a request is not answered; blank where it is.

    Args:
        hosts, origins: the values of its headers Host and Origin, none where it has none.
        port: where the server listens.
    """
    own = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
    if port == 80:
        own |= {"127.0.0.1", "localhost", "[::1]"}
    if len(hosts) != 1 or hosts[0].lower() not in own:
        return f"This page is at http://127.0.0.1:{port}; no other name or port leads to it."
    if origins and (len(origins) > 1 or origins[0].lower() != f"http://{hosts[0].lower()}"):
        return "Only this server's own page may connect to it."
    return ""


@contextlib.contextmanager
def guarded_server() -> Iterator[None]:
    """Within the block one websocket server is started; it refuses, before anything else, what `why_refused` refuses.

    viser has no hook for that, so the `serve` that it calls of the websockets library is another one meanwhile.

    Raises:
        UrsnavError: the server that was started is not guarded, because viser starts it in a way of its own.
    """
    from websockets.asyncio import server as library

    started = []
    with _one_at_a_time:
        serve = library.serve

        def guarded_serve(*args: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
            started.append(True)
            return serve(*args, process_request=partial(_answer, process_request), **options)

        library.serve = guarded_serve  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            library.serve = serve  # type: ignore[misc]
    if not started:
        raise UrsnavError("This release of viser starts its server in a way that cannot be guarded; install viser 1.1.")


def _answer(answer: Callable[..., Any] | None, connection: Any, request: Any) -> Any:
    """Refuse, or leave it to the server's own answer."""
    headers, port = request.headers, connection.local_address[1]
    refused = why_refused(headers.get_all("Host"), headers.get_all("Origin"), port)
    if refused:
        return connection.respond(HTTPStatus.FORBIDDEN, refused + "\n")
    return answer(connection, request) if answer else None
