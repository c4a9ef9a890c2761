"""A record played back: at its own pace, paused, a picture at a time, from any moment."""

import threading
import time
from collections.abc import Callable, Iterator

from ursnav_torch.devices import Frame
from ursnav_torch.session.events import Event, Result
from ursnav_torch.session.replay import Replay
from ursnav_torch.session.source import LosslessSource, Pace


class Player(LosslessSource):
    """The events of a record as somebody at a page wants them; iterate once, steer from any thread.

    Args:
        replay: the record and its speed; at speed 0 pictures come as fast as they are taken.
        stay: at the end wait for `seek` or `stop` instead of ending.
        on_seek: called before the first event of another moment.
        duration_s: end so long after the record's beginning; 0 for its end.
    """

    def __init__(
        self, replay: Replay, stay: bool = False, on_seek: Callable[[], None] = lambda: None, duration_s: float = 0.0
    ) -> None:
        self._limit_s = duration_s
        self.replay, self.stay, self._on_seek = replay, stay, on_seek
        self.duration_s, self.position_s, self.playing = replay.duration_s(), 0.0, True
        self._changed = threading.Condition()
        self._goal_s: float | None = None
        self._steps, self._ended = 0, False

    @property
    def pace(self) -> Pace:
        """A record's times are of another day; at speed 0 it waits until each picture is dealt with."""
        return Pace(stamped_now=False, steady=False, patient=self.replay.speed == 0)

    def play(self) -> None:
        """Go on; from the beginning where the record is at its end."""
        if self.position_s >= self.duration_s:
            self.seek(0.0)
        self._set(playing=True)

    def pause(self) -> None:
        """Stand still."""
        self._set(playing=False)

    def step(self) -> None:
        """Stand still after one more picture."""
        with self._changed:
            self.playing, self._steps = False, self._steps + 1
            self._changed.notify_all()

    def seek(self, position_s: float) -> None:
        """Go on, or stand still, from another moment, in seconds from the record's beginning."""
        with self._changed:
            self._goal_s = min(max(position_s, 0.0), self.duration_s)
            self._steps += not self.playing  # show the picture there
            self._changed.notify_all()

    def stop(self) -> None:
        """End the iteration."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator[Event]:
        from_s = 0.0
        first = next((event for event in self.replay.events() if not isinstance(event, Result)), None)
        begun_s = first.stamp.t_mono_s if first else 0.0
        while first is not None and not self._ended:
            yield from self._run(from_s, begun_s)
            with self._changed:
                if self._goal_s is None and self.stay and not self._ended:
                    self.playing, self.position_s = False, self.duration_s
                    self._changed.wait_for(lambda: self._ended or self._goal_s is not None)
                if self._goal_s is None:
                    return
                from_s, self._goal_s = self._goal_s, None
            self._on_seek()

    def _run(self, from_s: float, begun_s: float) -> Iterator[Event]:
        """Events from a moment on, when they are due, until the end, a seek or a stop."""
        self.position_s = from_s
        anchor = (from_s, time.monotonic())
        at_s = from_s
        for event in self.replay.events(from_s):
            if not isinstance(event, Result):  # made when the record was navigated, perhaps on another day
                at_s = event.stamp.t_mono_s - begun_s
            if 0 < self._limit_s <= at_s:
                self.stop()
            with self._changed:
                if not (self.playing or self._steps):
                    self._changed.wait_for(lambda: self.playing or self._steps or self._turned())
                    anchor = (at_s, time.monotonic())
                if self.playing and self.replay.speed:
                    wait = anchor[1] + (at_s - anchor[0]) / self.replay.speed - time.monotonic()
                    self._changed.wait_for(self._turned, max(wait, 0.0))
                if self._turned():
                    return
                if self._steps and isinstance(event, Frame):
                    self._steps -= 1
                self.position_s = max(self.position_s, at_s)
            yield event

    def _turned(self) -> bool:
        return self._ended or self._goal_s is not None

    def _set(self, playing: bool) -> None:
        with self._changed:
            self.playing, self._steps = playing, 0
            self._changed.notify_all()
