"""Stones in plain words, for people to read: "2 stones in the lower pole: 6.1 ± 0.6 mm in F, …"."""

from collections import Counter
from collections.abc import Sequence

from ursnav_torch.kidney import Kidney
from ursnav_torch.stones.known import StoneList
from ursnav_torch.stones.map import GONE, FoundStone
from ursnav_torch.stones.settings import RESIDUAL_MM


def stone_sentences(stones: StoneList, kidney: Kidney) -> list[str]:
    """One sentence a pole, then what is gone, what was not found yet, and what each calyx holds, fragments apart."""
    there = [s for s in stones.seen if s.state != GONE]
    lines = []
    for pole in dict.fromkeys(_pole(s, kidney) for s in there):
        here = [s for s in there if _pole(s, kidney) == pole]
        count = f"{len(here)} stone{'s' if len(here) > 1 else ''}"
        lines.append(f"{count} in {pole}: {', '.join(_sized(s, stones, kidney) for s in here)}.")
    if not there:
        lines.append("No stone seen.")
    gone = [s for s in stones.seen if s.state == GONE]
    if gone:
        lines.append(f"Seen again after treatment, gone: {', '.join(_sized(s, stones, kidney) for s in gone)}.")
    if stones.not_found:
        lines.append("Known from the scan, not found yet: " + ", ".join(
            f"{k.name} of {k.size_mm:.1f} mm" for k in stones.not_found) + ".")  # fmt: skip
    left, residual_mm = residual_fragments(there, kidney), RESIDUAL_MM * kidney.scale
    if left:
        lines.append(f"Stones and fragments above {residual_mm:g} mm: {_counted(left)}.")
    if stones.fragments:
        lines.append(f"Fragments up to {residual_mm:g} mm: {_counted(_by_calyx(stones.fragments, kidney))}.")
    return lines


def stone_count(stones: StoneList) -> str:
    """How many there are, in one short sentence; blank where none was seen.

    Example:
        >>> stone_count(StoneList((), (), (), False))
        ''
    """
    gone = sum(s.state == GONE for s in stones.seen)
    there = len(stones.seen) - gone
    if not stones.seen:
        return ""
    return f"{there or 'No'} stone{'' if there == 1 else 's'} left{f', {gone} gone' if gone else ''}."


def residual_fragments(there: Sequence[FoundStone], kidney: Kidney) -> dict[str, int]:
    """How many stones and fragments above `RESIDUAL_MM` each calyx holds, by its name; blank for outside of them."""
    return _by_calyx([s for s in there if s.size_mm > RESIDUAL_MM * kidney.scale], kidney)


def _by_calyx(stones: Sequence[FoundStone], kidney: Kidney) -> dict[str, int]:
    counts = Counter(calyx_name(stone, kidney) for stone in stones)
    return dict(sorted(counts.items()))


def _counted(by_calyx: dict[str, int]) -> str:
    return ", ".join(f"{calyx or 'outside the calyces'} {count}" for calyx, count in by_calyx.items())


def calyx_name(stone: FoundStone, kidney: Kidney) -> str:
    """Name of the calyx in which a stone lies, blank for none."""
    return kidney.calyces[stone.calyx].name if stone.calyx >= 0 else ""


def _pole(stone: FoundStone, kidney: Kidney) -> str:
    if stone.calyx < 0:
        return "the pelvis or an infundibulum"
    pole = kidney.calyces[stone.calyx].pole
    return {"mid": "the middle", "": "the calyces"}.get(pole, f"the {pole} pole")


def _sized(stone: FoundStone, stones: StoneList, kidney: Kidney) -> str:
    name, known = calyx_name(stone, kidney), stones.known[stones.seen.index(stone)]
    place = f" in {name}" if name else ""
    which = f" ({known} of the scan)" if known else " (new)" if stones.compared else ""
    return f"{stone.size_mm:.1f} ± {stone.size_sd_mm:.1f} mm{place}{which}"
