"""One page's connection: what it is sent, what it asks for, and a STOP that waits for nothing."""

import contextlib
import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec

from ursnav_torch.errors import UrsnavError
from ursnav_torch.page.commands import Command, does_overtake, run_message, shown_kind
from ursnav_torch.page.mailbox import Mailbox, Reader

logger = logging.getLogger(__name__)

#: So many commands of a page wait while one is done; its next are left out, which a notice says.
WAITING = 1000


class Conversation:
    """Serves one page's connection: messages as it shows them, and its commands one after another.

    Args:
        socket: Starlette's WebSocket.
        mailbox: what all pages are sent.
        commands: by name.
    """

    def __init__(self, socket: Any, mailbox: Mailbox, commands: Mapping[str, Command]) -> None:
        import anyio

        self._socket, self._mailbox, self._commands, self._reader = socket, mailbox, dict(commands), Reader()
        self._put, self._asked = anyio.create_memory_object_stream[str](WAITING)

    async def serve(self) -> None:
        """Go on until the connection is closed."""
        import anyio

        await self._socket.accept()
        async with self._put, self._asked, anyio.create_task_group() as tasks:

            async def until_closed(part: Callable[[], Awaitable[None]]) -> None:
                await _while_open(part)
                tasks.cancel_scope.cancel()

            async def receive() -> None:
                while True:
                    raw = await self._socket.receive_text()
                    kind = shown_kind(raw)
                    if kind is not None:
                        self._reader.shown(kind)
                    elif does_overtake(raw, self._commands):
                        self._forget()
                        tasks.start_soon(_while_open, self._take, raw)
                    else:
                        await self._hear(raw)

            for part in (self._do, receive, self._send):
                tasks.start_soon(until_closed, part)

    async def _send(self) -> None:
        """Send what the page has room for, until the server ends."""
        async for message in self._mailbox.read(self._reader):
            await (self._socket.send_text if isinstance(message, str) else self._socket.send_bytes)(message)
        await self._socket.close(1001)

    async def _do(self) -> None:
        """Do what was asked for, one after another."""
        async for raw in self._asked:
            await self._take(raw)

    async def _hear(self, raw: str) -> None:
        """Put a command behind those that wait."""
        import anyio

        try:
            self._put.send_nowait(raw)
        except anyio.WouldBlock:
            await self._notify(f"{WAITING} commands wait for one before them; this one is left out.")

    def _forget(self) -> None:
        """Let no command wait."""
        import anyio

        with contextlib.suppress(anyio.WouldBlock):
            while True:
                self._asked.receive_nowait()

    async def _take(self, raw: str) -> None:
        """Do what a page asks for, beside the loop that serves it; what cannot be done becomes a notice there."""
        import anyio

        try:
            await anyio.to_thread.run_sync(run_message, raw, self._commands)
        except UrsnavError as error:
            await self._notify(str(error))
        except Exception:  # whatever a page asks for, the others go on
            logger.exception("A page's command failed.")

    async def _notify(self, text: str) -> None:
        await self._socket.send_text(msgspec.json.encode({"kind": "notice", "text": text}).decode())


async def _while_open(part: Callable[..., Awaitable[None]], *arguments: Any) -> None:
    """One part of a conversation, as long as the page is there."""
    from starlette.websockets import WebSocketDisconnect

    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await part(*arguments)
