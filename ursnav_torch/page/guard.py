"""Who may talk to the page's server: its own pages, and other programs on this computer only where that is asked for.

A browser lets any web page from elsewhere open a connection to 127.0.0.1, or to a name that its owner points there (DNS
rebinding); such a page could stop or drive the robot. It cannot lie about its origin, nor about the host it asked for.
Nor may it show our page inside itself, where a click meant for something else would meet our buttons.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Sent with everything: in no frame, nothing from elsewhere, no script or style within the page's own text, no guessing
#: of kinds, no other page's handle on ours.
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self' "
        "ws://127.0.0.1:* ws://localhost:*; object-src 'none'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
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


class Guard:
    """An ASGI application around another: refuses, before anything else, what `why_refused` refuses.

    Args:
        app: what is guarded.
        programs: see `why_refused`.
    """

    def __init__(self, app: "ASGIApp", programs: bool = False) -> None:
        self.app, self.programs = app, programs

    async def __call__(self, scope: "Scope", receive: "Receive", send: "Send") -> None:
        """Answer one request or connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        is_websocket, port = scope["type"] == "websocket", int(scope["server"][1])
        refused = why_refused(_values(scope, b"host"), _values(scope, b"origin"), port, is_websocket, self.programs)

        async def send_with_headers(message: "Message") -> None:
            if message["type"] == "http.response.start":
                kept = [(name, value) for name, value in message["headers"] if name.decode().title() not in _TITLES]
                message["headers"] = [*kept, *((n.lower().encode(), v.encode()) for n, v in HEADERS.items())]
            await send(message)

        if not refused:
            await self.app(scope, receive, send_with_headers)
        elif is_websocket:
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": refused})  # before accepting: status 403
        else:
            body = (refused + "\n").encode()
            plain = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
            await send_with_headers({"type": "http.response.start", "status": 403, "headers": plain})
            await send({"type": "http.response.body", "body": body})


_TITLES = {name.title() for name in HEADERS}


def _values(scope: Any, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]
