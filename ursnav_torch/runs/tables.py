"""Tables that runners print."""

from collections.abc import Sequence

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
