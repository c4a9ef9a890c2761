"""The page's server: only its own pages and this computer's programs reach it, and nothing they send names a file."""

import contextlib
import io
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ursnav_torch.errors import InputError, UrsnavError
from ursnav_torch.extras import import_extra
from ursnav_torch.page.guard import guarded_server

if TYPE_CHECKING:
    import viser

LOCAL = ("127.0.0.1", "localhost", "::1")


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


def free_port() -> int:
    """A port that nobody uses."""
    with contextlib.closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start_server(host: str, port: int, title: str, programs: bool = False) -> "viser.ViserServer":
    """A running server without content.

    Args:
        host: 127.0.0.1.
        port: 0 takes any that is free.
        title: of the page.
        programs: let programs that are no browsers connect, too.

    Raises:
        InputError: see `check_address`.
        MissingExtraError: viser is not installed.
        UrsnavError: see `guarded_server`.
    """
    check_address(host, port)
    viser = import_extra("viser", "viewer", "The page (viewer=none does without)")

    class LocalServer(viser.ViserServer):  # type: ignore[name-defined]
        """A server that cannot be shared: viser would relay it through a public host if a page asked."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            return None

    quiet = contextlib.redirect_stdout(io.StringIO())  # viser's banner: standard output is for results
    server = None
    try:
        with quiet, guarded_server(programs) as bounds:
            server = LocalServer(host=host, port=port or free_port(), label=title, verbose=False)
            bounds.server = server
    except UrsnavError:
        if server is not None:
            stop_server(server)
        raise
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(390)
    return server


def stop_server(server: "viser.ViserServer") -> None:
    """End a server and its pages' connections."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def on_press(handle: Any) -> Callable[[Callable[[], None]], None]:
    """``on_press(button)(action)``: what a press does; an error of the package becomes a notice on that page."""

    def decorate(action: Callable[[], None]) -> None:
        @handle.on_click
        def _(event: Any) -> None:
            try:
                action()
            except UrsnavError as error:
                if event.client is not None:
                    event.client.add_notification("Not done", str(error), color="red")

    return decorate


def on_choice(handle: Any, action: Callable[[Any], None]) -> None:
    """Call ``action`` with the value that somebody chose on a page, and not with those that the program sets."""

    @handle.on_update
    def _(event: Any) -> None:
        if event.client is not None:
            action(handle.value)
