"""What the operation is about: stones, with places, sizes and calyces, from a track's pictures."""

from ursnav_torch.stones.known import NO_STONES, KnownStone, StoneList, compare_stones
from ursnav_torch.stones.map import GONE, THERE, FoundStone, StoneMap
from ursnav_torch.stones.settings import StoneMapSettings
from ursnav_torch.stones.tables import read_known_stones, write_stones
from ursnav_torch.stones.watch import StoneWatch, watch_stones
from ursnav_torch.stones.words import calyx_name, residual_fragments, stone_count, stone_sentences

__all__ = [
    "GONE",
    "NO_STONES",
    "THERE",
    "FoundStone",
    "KnownStone",
    "StoneList",
    "StoneMap",
    "StoneMapSettings",
    "StoneWatch",
    "calyx_name",
    "compare_stones",
    "read_known_stones",
    "residual_fragments",
    "stone_count",
    "stone_sentences",
    "watch_stones",
    "write_stones",
]
