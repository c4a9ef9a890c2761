"""What every page shall see: the newest message of each kind, and no more of a kind under way than one.

A connection's buffers hold megabytes, hundreds of pictures: what is sent before the last was shown comes seconds late.
So a page says of every message when it has shown it, and is sent the next of that kind only then: the newest there is.
"""

import asyncio
import threading
from collections.abc import AsyncIterator

Message = str | bytes


class Reader:
    """One page that reads; made and used on its event loop.

    Attributes:
        under_way: kinds of which a message was sent that is not shown yet.
        told: the number of the last message sent of each kind.
    """

    def __init__(self) -> None:
        self._loop, self._event = asyncio.get_running_loop(), asyncio.Event()
        self.under_way: set[str] = set()
        self.told: dict[str, int] = {}

    def shown(self, kind: str) -> None:
        """The page has shown the last message of a kind that it was sent."""
        self.under_way.discard(kind)
        self._event.set()

    def wake(self) -> None:
        """Something is new; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._event.set)

    async def wait(self) -> None:
        """Wait until there may be something to read."""
        await self._event.wait()
        self._event.clear()


class Mailbox:
    """Filled from any thread, read by any number of pages on event loops."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[int, Message]] = {}
        self._count, self._closed = 0, False
        self._readers: set[Reader] = set()

    @property
    def readers(self) -> int:
        """How many pages read."""
        return len(self._readers)

    def put(self, kind: str, message: Message, holds: str = "") -> None:
        """Leave a message; it replaces the last of its kind, and of a kind whose newest it holds. Never waits."""
        with self._lock:
            self._count += 1
            for replaced in (kind, holds):
                self._newest.pop(replaced, None)
            self._newest[kind] = self._count, message
            self._wake_all()

    def wanted(self, kind: str) -> bool:
        """Whether there is a page that has shown all that it was sent of a kind."""
        with self._lock:
            return any(kind not in reader.under_way for reader in self._readers)

    def close(self) -> None:
        """End all reading."""
        with self._lock:
            self._closed = True
            self._wake_all()

    async def read(self, reader: Reader) -> AsyncIterator[Message]:
        """Messages as they come, the last of every kind first; what was replaced meanwhile is left out."""
        with self._lock:
            self._readers.add(reader)
        try:
            while not self._closed:
                message = self._next(reader)
                if message is None:
                    await reader.wait()
                else:
                    yield message
        finally:
            with self._lock:
                self._readers.discard(reader)

    def _next(self, reader: Reader) -> Message | None:
        """What has waited longest of the kinds that the page can take; it is under way then."""
        with self._lock:
            for kind, (number, message) in self._newest.items():
                if kind not in reader.under_way and number > reader.told.get(kind, 0):
                    reader.under_way.add(kind)
                    reader.told[kind] = number
                    return message
        return None

    def _wake_all(self) -> None:
        for reader in self._readers:
            reader.wake()
