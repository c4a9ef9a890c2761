"""Who may talk to the page's server: its own pages, and other programs on this computer only where that is asked for.

A browser lets any web page from elsewhere open a connection to 127.0.0.1, or to a name that its owner points there (DNS
rebinding); such a page could stop or drive the robot. It cannot lie about its origin, nor about the host it asked for.
Nor may it show our page inside itself, where a click meant for something else would meet our buttons.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from http import HTTPStatus
from typing import Any

from ursnav_torch.errors import UrsnavError
from ursnav_torch.page.bounds import Bounds

_one_at_a_time = threading.Lock()


#: Sent with everything: in no frame, nothing from elsewhere, no guessing of kinds, no other page's handle on ours.
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' data: blob: ws://127.0.0.1:* "
        "ws://localhost:* ws://[::1]:*; worker-src 'self' blob:; object-src 'none'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def why_refused(
    hosts: Sequence[str], origins: Sequence[str], port: int, is_websocket: bool = False, programs: bool = False
) -> str:
    """Why a request is not answered; blank where it is.

    Args:
        hosts, origins: the values of its headers Host and Origin, none where it has none.
        port: where the server listens.
        is_websocket: whether it opens the connection that buttons and fields speak over.
        programs: let such a connection be opened by programs that are no browsers, which have no origin.
    """
    own = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
    if port == 80:
        own |= {"127.0.0.1", "localhost", "[::1]"}
    if len(hosts) != 1 or hosts[0].lower() not in own:
        return f"This page is at http://127.0.0.1:{port}; no other name or port leads to it."
    if origins and (len(origins) > 1 or origins[0].lower() != f"http://{hosts[0].lower()}"):
        return "Only this server's own page may connect to it."
    if is_websocket and not origins and not programs:
        return "Only a browser may connect, which says where its page comes from; viewer.programs=true lets others in."
    return ""


@contextlib.contextmanager
def guarded_server(programs: bool = False) -> Iterator[Bounds]:
    """Within the block one websocket server is started; it refuses, before anything else, what `why_refused` refuses.

    Messages that its `Bounds` do not accept are passed over; yields these, which want to know the server once it runs.
    viser has no hook for that, so the `serve` that it calls of the websockets library is another one meanwhile.

    Args:
        programs: see `why_refused`.

    Raises:
        UrsnavError: the server that was started is not guarded, because viser starts it in a way of its own.
    """
    from websockets.asyncio import server as library

    started, bounds = [], Bounds()
    with _one_at_a_time:
        serve = library.serve

        def guarded_serve(
            handler: Callable[..., Any], *args: Any, process_request: Callable[..., Any] | None = None, **options: Any
        ) -> Any:
            started.append(True)
            answer = partial(_answer, process_request, programs)
            return serve(partial(_within, handler, bounds), *args, process_request=answer, **options)

        library.serve = guarded_serve  # type: ignore[assignment,misc]
        try:
            yield bounds
        finally:
            library.serve = serve  # type: ignore[misc]
    if not started:
        raise UrsnavError("This release of viser starts its server in a way that cannot be guarded; install viser 1.1.")


def _answer(answer: Callable[..., Any] | None, programs: bool, connection: Any, request: Any) -> Any:
    """Refuse, or leave it to the server's own answer."""
    headers, port = request.headers, connection.local_address[1]
    is_websocket = headers.get("Upgrade", "").lower() == "websocket"
    refused = why_refused(headers.get_all("Host"), headers.get_all("Origin"), port, is_websocket, programs)
    if refused:
        response = connection.respond(HTTPStatus.FORBIDDEN, refused + "\n")
    else:
        response = answer(connection, request) if answer else None
    if response is not None:
        for name, value in HEADERS.items():
            if name in response.headers:
                del response.headers[name]
            response.headers[name] = value
    return response


async def _within(handler: Callable[..., Any], bounds: Bounds, connection: Any) -> None:
    """Serve a connection that gives only messages within the bounds."""
    receive = connection.recv

    async def receive_accepted(*args: Any, **options: Any) -> Any:
        while not bounds.accept(raw := await receive(*args, **options)):
            pass
        return raw

    connection.recv = receive_accepted
    await handler(connection)
