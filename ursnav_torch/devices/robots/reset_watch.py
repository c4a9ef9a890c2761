"""Was a GRBL board reset? A mark that every reset wipes, and how counts look that began at zero again.

GRBL's machine position is zero after a power-on and kept by a soft reset. Its parser's feed rate F "defaults to 0 upon
a reset" of either kind, is told by ``$G`` in every state, and is neither used nor changed by jogs (commands.md and
jogging.md in doc/markdown of github.com/gnea/grbl; so it is in grblHAL and FluidNC). So a feed rate of our own is the
mark: a report is believed only where the mark is seen after it, whether or not a greeting was heard.
"""

import re

import numpy as np

from ursnav_torch.geometry import Array

#: A feed rate that nobody else sets, in mm/min, and the line that sets it.
MARK_MM_MIN = 1234
MARK = f"F{MARK_MM_MIN}"
ASK_STATE = "$G"
STATE = re.compile(r"\[GC:.*\bF(\d+(?:\.\d*)?)(?: .*)?\]", re.ASCII)


class ResetWatch:
    """What is known of a board's mark, and what a board would count that was reset since the mark was last seen.

    A soft reset of our own wipes the mark, too. Until it is set again only the counts can tell: a board that was reset
    counts at most what it was sent since.

    Args:
        tolerance: how far counts may be off, in mm.

    Attributes:
        marked: the board bears the mark, as far as we know.
        wiped: we wiped it ourselves.
    """

    def __init__(self, tolerance: float) -> None:
        self.marked = self.wiped = False
        self._tolerance = tolerance
        self._back, self._forth = np.zeros(3), np.zeros(3)

    def wipe(self) -> None:
        """The board is about to be reset by us."""
        self.marked, self.wiped = False, True

    def set(self, seen: bool) -> None:
        """The mark was set; ``seen`` where the board then told it."""
        self.marked, self.wiped = seen, False

    def sent(self, step: Array) -> None:
        """A jog by (3,) mm is about to be sent."""
        self._back, self._forth = self._back + np.minimum(step, 0.0), self._forth + np.maximum(step, 0.0)

    def proved(self) -> None:
        """Nothing that was sent so far can be counted by a board that is reset from now on."""
        self._back, self._forth = np.zeros(3), np.zeros(3)

    def may_count_anew(self, counts: Array) -> bool:
        """Whether a board that was reset since the last proof may count (3,) mm."""
        return bool(((counts >= self._back - self._tolerance) & (counts <= self._forth + self._tolerance)).all())


def is_mark(line: str) -> bool | None:
    """Whether a line of a board tells the mark; None where it does not tell the parser's state.

    Args:
        line: such as ``[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F1234 S0]``; GRBL's documents show F500.0, too.
    """
    found = STATE.fullmatch(line)
    return float(found[1]) == MARK_MM_MIN if found else None
