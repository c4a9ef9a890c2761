"""The state machine of an autonomous exploration: which states there are, and which may follow which."""

from dataclasses import dataclass, field
from enum import StrEnum

from ursnav_torch.errors import UrsnavError


class State(StrEnum):
    """What autonomy is doing."""

    WAITING = "waiting"  # nobody holds the dead-man button, or hands drive
    STOPPED = "stopped"  # an emergency stop that is not acknowledged
    LOOKING = "looking"  # stands still until the place is known
    RETREATING = "retreating"  # pulls back to where the next way branches off
    APPROACHING = "approaching"  # goes along the way into a calyx
    INSPECTING = "inspecting"  # turns to wall that was not seen
    BACKING_OFF = "backing off"  # something is in the way, or too near
    WITHDRAWING = "withdrawing"  # the track is in doubt: back, where it was known
    FINISHED = "finished"  # for good


_ALWAYS = {State.WAITING, State.STOPPED}
#: What may follow each state. An end of permission ends every one but the last.
TRANSITIONS: dict[State, frozenset[State]] = {
    State.WAITING: frozenset({State.STOPPED, State.LOOKING}),
    State.STOPPED: frozenset({State.WAITING}),
    State.LOOKING: frozenset(
        _ALWAYS | {State.RETREATING, State.APPROACHING, State.INSPECTING, State.WITHDRAWING, State.FINISHED}
    ),
    State.RETREATING: frozenset(_ALWAYS | {State.LOOKING, State.APPROACHING}),
    State.APPROACHING: frozenset(
        _ALWAYS | {State.LOOKING, State.RETREATING, State.INSPECTING, State.BACKING_OFF, State.FINISHED}
    ),
    State.INSPECTING: frozenset(
        _ALWAYS | {State.LOOKING, State.RETREATING, State.APPROACHING, State.BACKING_OFF, State.FINISHED}
    ),
    State.BACKING_OFF: frozenset(
        _ALWAYS | {State.LOOKING, State.RETREATING, State.APPROACHING, State.INSPECTING, State.FINISHED}
    ),
    State.WITHDRAWING: frozenset(_ALWAYS | {State.LOOKING, State.FINISHED}),
    State.FINISHED: frozenset(),
}
#: States in which the scope may move; in all others it is told to stand still.
MOVING = frozenset({State.RETREATING, State.APPROACHING, State.INSPECTING, State.BACKING_OFF, State.WITHDRAWING})


class IllegalTransitionError(UrsnavError):
    """A mistake in the program: a state was to follow one that it may not follow."""


@dataclass(slots=True)
class StateMachine:
    """Where an exploration stands.

    Attributes:
        state: now.
        reason: why it came to it, for people to read.
        since_s: when.
        visits: how often each state was entered.
    """

    state: State = State.WAITING
    reason: str = ""
    since_s: float = 0.0
    visits: dict[State, int] = field(default_factory=dict)

    def to(self, state: State, t_s: float, reason: str = "") -> None:
        """Go on to another state; to the present one changes nothing but the reason.

        Raises:
            IllegalTransitionError: it may not follow the present one.
        """
        if state is not self.state:
            if state not in TRANSITIONS[self.state]:
                raise IllegalTransitionError(f"{state.value!r} may not follow {self.state.value!r} ({reason}).")
            self.state, self.since_s = state, t_s
            self.visits[state] = self.visits.get(state, 0) + 1
        self.reason = reason
