"""Calyces that a picture may show, in words."""

from collections.abc import Sequence

#: In a set of calyces, where a picture may show none.
NO_CALYX = "none"
#: More calyces than this are counted, not named.
_NAMED = 3


def set_words(names: Sequence[str]) -> str:
    """Names of calyces, and `NO_CALYX`, as people say them; blank for no name.

    Example:
        >>> set_words(["C"]), set_words(["C", "D"]), set_words(["C", "D", "none"])
        ('C', 'C or D', 'C, D or no calyx')
        >>> set_words(["C", "D", "A", "B", "none"])
        'C, D or one of 3 others'
    """
    said = ["no calyx" if name == NO_CALYX else name for name in names]
    if len(said) > _NAMED + 1:
        said = [*said[: _NAMED - 1], f"one of {len(said) - _NAMED + 1} others"]
    return " or ".join([", ".join(said[:-1]), said[-1]]) if len(said) > 1 else "".join(said)
