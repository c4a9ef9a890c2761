"""What the page of a `match` run says: an answer in words, and all of them in a sentence or two."""

from collections.abc import Mapping, Sequence
from typing import Any

from ursnav_torch.kidney import set_words

#: States that pictures can be filtered by, in the page's order.
_STATES = {"sure": "sure", "unsure": "unsure", "right": "right", "wrong": "wrong", "failed": "not located"}


def answer_words(row: Mapping[str, Any], truth: str | None) -> dict[str, Any]:
    """A row of ``matches.csv`` as the page says it.

    Args:
        row: keyed by `MATCH_COLUMNS`.
        truth: the true calyx's name, blank for a picture of none, None where it is not known.

    Returns:
        Plain data: ``image``, ``located``, ``calyx``, ``answer`` and its ``tone`` (``yes``, ``unsure`` or ``no``, a
        class of the stylesheet), ``states`` (of `_STATES`, separated by blanks), ``detail``, ``calyces`` and
        ``truth_words``.
    """
    located, calyx = not row.get("error"), str(row.get("calyx") or "")
    sure = located and bool(row.get("accepted"))
    right = located and truth is not None and calyx == truth
    wrong = located and truth is not None and calyx != truth
    set_ = [name for name in str(row.get("calyces") or "").split("|") if name]
    name = set_words(set_) if len(set_) > 1 else calyx or "no calyx (passage)"
    answer = "not located" if not located else name if sure else f"unsure, perhaps {name}"
    if wrong:
        answer += f", wrong: it is {truth or 'no calyx'}"
    states = {"failed": not located, "sure": sure, "unsure": located and not sure, "right": right, "wrong": wrong}
    return {
        "image": str(row["image"]),
        "located": located,
        "calyx": calyx,
        "answer": answer,
        "tone": "no" if wrong or not located else "yes" if sure else "unsure",
        "states": " ".join(state for state, holds in states.items() if holds),
        "detail": _percent(row["confidence"]) if located else str(row.get("error", "")),
        "calyces": str(row.get("calyces") or "").replace("|", ", "),
        "truth_words": "" if truth is None else truth or "(none)",
    }


def summary_words(entries: Sequence[Mapping[str, Any]]) -> str:
    """How many are sure, unsure and not located, and how many of those with a known truth are right.

    Example:
        >>> summary_words([answer_words({"image": "a", "calyx": "B", "accepted": True, "confidence": 1.0}, None)])
        '1 is named surely, 0 with doubt, 0 could not be located.'
    """
    n = {state: sum(state in e["states"].split() for e in entries) for state in _STATES}
    said = f"{n['sure']} {_be(n['sure'])} named surely, {n['unsure']} with doubt, {n['failed']} could not be located."
    known = sum(bool(e["truth_words"]) for e in entries)
    if not known:
        return said
    sure = [e["states"].split() for e in entries if e["truth_words"] and "sure" in e["states"].split()]
    sure_right = sum("right" in states for states in sure)
    right = f"{n['right']} {_be(n['right'])} right"
    return f"{said} Of {known} whose calyx is known {right}; of the {len(sure)} sure ones {sure_right}."


def filters_of(entries: Sequence[Mapping[str, Any]], groups: Mapping[str, str]) -> list[dict[str, Any]]:
    """The filters by state and by calyx that have something to show.

    Args:
        entries: with their ``group``.
        groups: calyx's name to the word that stands for it in the page, which may hold no blanks.
    """
    states = {s: sum(s in e["states"].split() for e in entries) for s in _STATES}
    calyces = {name: sum(e["group"] == key for e in entries) for name, key in groups.items()}
    by_state = [{"value": s, "label": _STATES[s], "count": count} for s, count in states.items() if count]
    by_calyx = [
        {"value": groups[name], "label": name or "none", "count": count} for name, count in calyces.items() if count
    ]
    everything = {"value": "", "label": "all", "count": len(entries)}
    return [
        {"key": "state", "legend": "Show", "choices": [everything, *by_state]},
        {"key": "calyx", "legend": "Calyx", "choices": [everything, *by_calyx]},
    ]


def _be(count: int) -> str:
    return "is" if count == 1 else "are"


def _percent(confidence: float | None) -> str:
    """A confidence for people to read; with settings that none was learned for there is none."""
    return "not known" if confidence is None else f"{confidence:.0%}"
