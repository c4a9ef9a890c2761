"""Pages from Jinja templates: whatever is filled in is escaped, and a name that is missing is an error."""

import base64
from functools import cache
from typing import Any

import cv2
import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

#: The room whose templates all pages share: ``base.html.j2``, ``macros.html.j2`` and the one stylesheet.
_SHARED = "ursnav_torch.reports"


def render_page(template: str, room: str = _SHARED, **values: Any) -> str:
    """A page as text.

    Args:
        template: file name in the folder ``templates`` of the room; it extends ``base.html.j2``.
        room: the package that ships it.
        values: what the template names, plain text and numbers, not HTML.

    Raises:
        jinja2.UndefinedError: the template names something that was not given.
    """
    return _environment(room).get_template(template).render(values)


def inline_picture(picture: NDArray[np.uint8] | bytes, quality: int = 85) -> str:
    """A picture as an address that holds it: (H, W) or (H, W, 3) blue, green, red as JPEG, or PNG's or JPEG's bytes."""
    if not isinstance(picture, bytes):
        picture = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    kind = "png" if picture.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"


@cache
def _environment(room: str) -> Environment:
    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((room, _SHARED))])
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
