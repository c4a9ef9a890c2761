"""What every page shall see: the newest message of each kind, so that a slow page makes no queue grow."""

import asyncio
import threading
from collections.abc import AsyncIterator

Message = str | bytes


class Mailbox:
    """Filled from any thread, read by any number of connections on an event loop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[int, Message]] = {}
        self._count, self._closed = 0, False
        self._wake: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}

    @property
    def readers(self) -> int:
        """How many connections read."""
        return len(self._wake)

    def put(self, kind: str, message: Message) -> None:
        """Leave a message; it replaces the last of its kind. Never waits."""
        with self._lock:
            self._count += 1
            self._newest.pop(kind, None)
            self._newest[kind] = self._count, message
        self._wake_all()

    def close(self) -> None:
        """End all reading."""
        self._closed = True
        self._wake_all()

    async def read(self) -> AsyncIterator[Message]:
        """Messages as they come, the last of every kind first; what was replaced meanwhile is left out."""
        told, wake = 0, asyncio.Event()
        with self._lock:
            self._wake[wake] = asyncio.get_running_loop()
        try:
            while not self._closed:
                wake.clear()
                with self._lock:
                    waiting = next(((n, m) for n, m in self._newest.values() if n > told), None)
                if waiting is None:
                    await wake.wait()
                    continue
                told = waiting[0]
                yield waiting[1]
        finally:
            with self._lock:
                self._wake.pop(wake, None)

    def _wake_all(self) -> None:
        with self._lock:
            for wake, loop in self._wake.items():
                if not loop.is_closed():
                    loop.call_soon_threadsafe(wake.set)
