"""What a page may send: messages of the kinds that our pages have, with finite numbers, inside their fields' bounds.

The browser keeps to them by itself; a program that speaks for it need not, and viser takes what comes.
"""

import math
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    import viser

#: Kinds of messages that a page without uploads, forms and drags sends.
KINDS = frozenset(
    {
        "GuiUpdateMessage",
        "GuiButtonHoldMessage",
        "CommandTriggerMessage",
        "SceneNodeClickMessage",
        "ScenePointerMessage",
        "ViewerCameraMessage",
        "ReplayDoneMessage",
    }
)
MOST_BYTES, MOST_TEXT, MOST_ITEMS, DEEPEST = 16_384, 200, 64, 5
#: No place, angle, count or time on a page is farther from zero.
LARGEST = 1e6


class Bounds:
    """Decides which messages of a page are taken.

    Args:
        server: whose fields have the bounds; None until it is there, and meanwhile all fields are refused.
    """

    def __init__(self, server: "viser.ViserServer | None" = None) -> None:
        self.server = server
        self.refused = 0

    def accept(self, raw: Any) -> bool:
        """Whether a message, as bytes on the wire, is one that a page of ours can send."""
        ok = isinstance(raw, bytes) and len(raw) <= MOST_BYTES and self._is_fine(raw)
        self.refused += not ok
        return ok

    def _is_fine(self, raw: bytes) -> bool:
        try:
            message = msgspec.msgpack.decode(raw)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return False
        if not isinstance(message, dict) or str(message.get("type")) not in KINDS or not _is_plain(message):
            return False
        if not all(_is_ray_part(message[name]) for name in ("ray_origin", "ray_direction") if name in message):
            return False
        return message["type"] != "GuiUpdateMessage" or self._is_update(message)

    def _is_update(self, message: dict[Any, Any]) -> bool:
        """Whether a field's new value lies within its bounds; nothing but values is changed from outside."""
        if self.server is None or not isinstance(message.get("uuid"), str):
            return False
        updates = message.get("updates")
        if not isinstance(updates, dict) or set(updates) != {"value"}:
            return False
        handle = self.server.gui._gui_input_handle_from_uuid.get(message["uuid"])
        return handle is None or is_within(updates["value"], handle._impl.value, handle._impl.props)


def is_within(value: Any, now: Any, props: Any) -> bool:
    """Whether a field that stands at ``now`` may be set to ``value``: the same kind, and within its properties."""
    if isinstance(now, bool) or isinstance(value, bool):
        return isinstance(now, bool) and isinstance(value, bool)
    if isinstance(now, (int, float)):
        low, high = getattr(props, "min", None), getattr(props, "max", None)
        return (
            isinstance(value, (int, float))
            and math.isfinite(value)
            and (low is None or value >= low)
            and (high is None or value <= high)
        )
    if isinstance(now, str):
        options = getattr(props, "options", None)
        return isinstance(value, str) and (options is None or value in options)
    return False


def _is_plain(data: Any) -> bool:
    """Whether all numbers are finite and small, all texts short, and nothing is large or deep."""
    level = [data]
    for _ in range(DEEPEST):
        inner: list[Any] = []
        for item in level:
            if isinstance(item, (dict, list)):
                if len(item) > MOST_ITEMS:
                    return False
                inner.extend(item if isinstance(item, list) else [*item, *item.values()])
            elif not _is_small(item):
                return False
        if not inner:
            return True
        level = inner
    return False


def _is_ray_part(value: Any) -> bool:
    """Three numbers, or nothing."""
    return value is None or (
        isinstance(value, list) and len(value) == 3 and all(isinstance(v, (int, float)) for v in value)
    )


def _is_small(item: Any) -> bool:
    if isinstance(item, (int, float)):
        return math.isfinite(item) and abs(item) <= LARGEST
    return item is None or (isinstance(item, str) and len(item) <= MOST_TEXT)
