"""What runners print: tables, and the steps of a long job with how long each took."""

import time
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.table import Table

from ursnav_torch.runs.demo import PresetScore


def print_scores(scores: Sequence[PresetScore], title: str) -> None:
    """One line a kind of pictures: how many were located right, and how well."""
    table = Table(title=title, title_justify="left")
    for column in ("pictures", "right of the sure", "sure", "right calyx", "position", "direction"):
        table.add_column(column, justify="left" if column == "pictures" else "right")
    for s in scores:
        table.add_row(
            f"{s.preset} ({s.pictures})",
            share(s.accepted_right, s.accepted),
            share(s.accepted, s.pictures),
            share(s.right, s.pictures),
            f"{s.position_mm:.2f} mm",
            f"{s.direction_deg:.1f}°",
        )
    Console(width=110).print(table)


def share(part: int, whole: int) -> str:
    """``22/24 = 92 %``."""
    return f"{part}/{whole} = {100 * part / whole:.0f} %" if whole else "-"


class Steps:
    """Numbered steps of a job.

    Args:
        count: how many there will be.
        clock: seconds.
    """

    def __init__(self, count: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.count, self._clock = count, clock
        self._number, self._began_s = 0, self._clock()
        self._step_s = self._began_s

    def begin(self, what: str) -> None:
        """Say what comes next; the step before ends."""
        self._end()
        self._number, self._step_s = self._number + 1, self._clock()
        print(f"{self._number}/{self.count} {what} ...", flush=True)

    def end(self) -> float:
        """The last step ends; the seconds of all."""
        self._end()
        self._number = 0
        return self._clock() - self._began_s

    def _end(self) -> None:
        if self._number:
            print(f"    {self._clock() - self._step_s:.0f} s", flush=True)
