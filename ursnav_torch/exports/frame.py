"""From the kidney frame to the patient's: a mesh file's coordinates are LPS or RAS, and somebody has to know which."""

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import T_RAS_LPS, Array


def lps_from_kidney(frame: str | None) -> Array:
    """``T_lps_kidney`` (4, 4) of a kidney frame that is ``lps`` or ``ras``.

    Raises:
        InputError: it is something else, or nobody said it: guessed wrong, left would be right.
    """
    if frame is None:
        raise InputError(
            "Nothing here says whether the kidney's coordinates are LPS or RAS, and other programs need it: say "
            "frame=lps (what `segment` writes unless told otherwise) or frame=ras, or give its folder segmentation=."
        )
    if frame not in ("lps", "ras"):
        raise InputError(f"frame is {frame!r}; accepted are lps and ras.")
    return np.eye(4) if frame == "lps" else T_RAS_LPS.copy()
