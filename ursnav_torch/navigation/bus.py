"""Between threads: the newest item alone, so that nobody who is slow makes a queue grow."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Generic, TypeVar

from ursnav_torch.navigation.state import NavigationState

T = TypeVar("T")


class Newest(Generic[T]):
    """A place for one item: what is put replaces what was not yet taken."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._item: T | None = None
        self.replaced = 0

    def put(self, item: T) -> None:
        """Leave an item; never waits. Counts in `replaced` what nobody took."""
        with self._changed:
            self.replaced += self._item is not None
            self._item = item
            self._changed.notify_all()

    def take(self, timeout_s: float) -> T | None:
        """The newest item, once; None when none came in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None, timeout_s)
            item, self._item = self._item, None
            return item


class StateBus:
    """Holds the newest state. Publishers never wait for observers; an observer takes what is there when it looks.

    Example:
        >>> bus = StateBus()
        >>> bus.update(lambda state: replace(state, calyx="C")).version
        1
        >>> bus.latest().calyx
        'C'
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._state = NavigationState()

    def update(self, change: Callable[[NavigationState], NavigationState]) -> NavigationState:
        """Publish what ``change`` makes of the newest state; returns it with its version."""
        with self._changed:
            self._state = replace(change(self._state), version=self._state.version + 1)
            self._changed.notify_all()
            return self._state

    def latest(self) -> NavigationState:
        """The newest state."""
        return self._state

    def wait(self, version: int, timeout_s: float) -> NavigationState | None:
        """The newest state once it is newer than ``version``; None when none came in time."""
        until = time.monotonic() + timeout_s
        with self._changed:
            while self._state.version <= version:
                if not self._changed.wait(until - time.monotonic()) and time.monotonic() >= until:
                    return None
            return self._state
