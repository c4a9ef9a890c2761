"""How an exploration goes by itself."""

from dataclasses import dataclass

from ursnav_torch.errors import InputError

ASSIST, EXPLORE = MODES = ("assist", "explore")


@dataclass(frozen=True, slots=True)
class AutonomySettings:
    """What autonomy does and how carefully; mm at the kidney's scale 1.

    ``turn_per_s`` and ``ahead_mm`` were chosen on one phantom, ``slack_mm`` and ``attempts`` on five, ``view_time_mm``
    on ten, ``resistance_mm`` on twenty, by ``python -m benchmarks.exploring half=choosing pose=true
    set=NAME=VALUE,...``; the others were set, not varied.

    Attributes:
        mode: ``explore`` moves everything; ``assist`` bends, and the person inserts.
        advance_mm_s, retreat_mm_s, withdraw_mm_s: the slider's speeds: in, back along a known way, back in doubt.
        turn_per_s: share of the angle to where it steers that is turned in a second.
        ahead_mm: how far ahead on the way it steers for.
        clearance_mm: the tip is kept this far from the wall as the model has it; in a neck, from less of its radius.
        standoff_mm: a way in ends this far before the calyx's tip.
        room_mm: so far before a branching the turn into the other branch begins.
        sure_sd_mm, doubtful_sd_mm: deviation of the position up to which it goes at full speed, and from which not on.
        stale_s: a place older than this is not known any more.
        look_s: how long it stands and looks before it withdraws.
        withdraw_mm: how far it withdraws before it looks again.
        withdrawals: after so many in a row without a place it gives up.
        slack_mm: the slider's play, so far it turns round before the shaft follows, where nobody has learned it.
        touch_mm: nearer to a wall ahead than this it does not go on; in a neck, nearer than 0.9 of its radius.
        resistance_mm: pushed this far without getting on, it meets resistance. With 0.7 and 1.0 it inspected 92 and 91
            of the twenty's 93 calyces in reach, by a path of 1.58 and 1.62 times the shortest tour, with two forced
            contacts either way (``phantoms=40 tissue=breathing,buckling,bleeding``).
        back_off_mm: how far it backs off then.
        attempts: ways into a calyx that are tried before it counts as not reached; and losses of the place on the way
            there before it is left for later, and the second time for good.
        patience_s: an attempt that gets nowhere ends after this.
        inspect_s: a calyx whose wall is not seen after so long is left as it is.
        done_share: part of a calyx's wall, of what the scope can see of it, that must be seen.
        least_gain: part of it that another view must add to be worth going to.
        view_time_mm: going to a view costs the way there, and so much of way for the time that it takes.
        glare: share of a picture too bright to see anything from which on the wall is too near.
    """

    mode: str = EXPLORE
    advance_mm_s: float = 4.0
    retreat_mm_s: float = 6.0
    withdraw_mm_s: float = 2.0
    turn_per_s: float = 1.5
    ahead_mm: float = 5.0
    clearance_mm: float = 0.8
    standoff_mm: float = 3.0
    room_mm: float = 2.0
    sure_sd_mm: float = 0.7
    doubtful_sd_mm: float = 2.5
    stale_s: float = 0.6
    look_s: float = 2.0
    withdraw_mm: float = 4.0
    withdrawals: int = 8
    slack_mm: float = 1.2
    touch_mm: float = 0.0
    resistance_mm: float = 0.7
    back_off_mm: float = 1.5
    attempts: int = 3
    patience_s: float = 12.0
    inspect_s: float = 30.0
    done_share: float = 0.9
    least_gain: float = 0.015
    view_time_mm: float = 20.0
    glare: float = 0.5

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InputError(f"autonomy.mode={self.mode!r} is none of {', '.join(MODES)}; autonomy=none does without.")
        speeds = (self.advance_mm_s, self.retreat_mm_s, self.withdraw_mm_s, self.turn_per_s, self.ahead_mm)
        if min(speeds) <= 0 or min(self.attempts, self.withdrawals) < 1:
            raise InputError(f"Autonomy needs speeds above 0 and at least one attempt and withdrawal, got {self}.")
        if not 0 < self.sure_sd_mm < self.doubtful_sd_mm or not 0 < self.done_share <= 1:
            raise InputError(
                "Autonomy needs 0 < sure_sd_mm < doubtful_sd_mm and 0 < done_share <= 1, got "
                f"{self.sure_sd_mm}, {self.doubtful_sd_mm} and {self.done_share}."
            )
