"""What a scan's header says of its geometry; what it does not say is refused, or given by the user by name."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.errors import InputError

Array = NDArray[np.float64]

#: mm a unit of length, by the words of file formats.
UNITS_MM = {
    "mm": 1.0, "millimeter": 1.0, "millimeters": 1.0, "millimetre": 1.0, "cm": 10.0, "centimeter": 10.0,
    "centimeters": 10.0, "m": 1000.0, "meter": 1000.0, "meters": 1000.0, "um": 1e-3, "µm": 1e-3, "micrometer": 1e-3,
}  # fmt: skip
_AXES = {"l": (0, 1.0), "r": (0, -1.0), "p": (1, 1.0), "a": (1, -1.0), "s": (2, 1.0), "i": (2, -1.0)}


@dataclass(frozen=True, slots=True)
class ScanHeader:
    """The user's word on a scan's geometry; it takes the place of the file's.

    Args:
        spacing_mm: [x, y, z] distances between voxels, in mm.
        orientation: towards what the voxel axes rise: three letters such as lps or ras (left, right, anterior,
            posterior, superior, inferior).
        unit: of the file's own lengths: mm, cm, m, um.

    Raises:
        InputError: one of them cannot be.
    """

    spacing_mm: Sequence[float] | None = None
    orientation: str | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        if self.spacing_mm is not None and (len(self.spacing_mm) != 3 or not min(self.spacing_mm) > 0):
            raise InputError(f"kidney.header.spacing_mm is {self.spacing_mm}; expected three distances [x,y,z] in mm.")
        if self.unit is not None and self.unit not in UNITS_MM:
            raise InputError(f"kidney.header.unit is {self.unit!r}; accepted are mm, cm, m and um.")
        if self.orientation is not None:
            self.direction()

    def direction(self) -> Array:
        """(3, 3) direction cosines, a column a voxel axis, LPS."""
        word = (self.orientation or "").lower()
        R = np.zeros((3, 3))
        for axis, letter in enumerate(word[:3]):
            row, sign = _AXES.get(letter, (0, 0.0))
            R[row, axis] = sign
        if len(word) != 3 or abs(abs(np.linalg.det(R)) - 1) > 1e-9:
            raise InputError(
                f"kidney.header.orientation is {self.orientation!r}; expected three letters, one of l/r, one of a/p, "
                "one of s/i, such as lps or ras."
            )
        return R


@dataclass(frozen=True, slots=True)
class Said:
    """What a file's header says.

    Attributes:
        spacing: it states how far voxels lie apart.
        orientation: it states how they lie in the patient.
        unit_mm: mm a unit of its lengths; None: it does not say, which is mm by custom.
        read_mm: the factor that its reader applies on its own.
        notes: what is odd about it, for people to read.
        rivals: what it says twice of its spacing, and differently; None: once, or the same.
        found: what stands where the spacing should, for people to read; "": nothing.
        added: what its reader adds to the stored numbers, and should not.
    """

    spacing: bool
    orientation: bool
    unit_mm: float | None = None
    read_mm: float = 1.0
    notes: tuple[str, ...] = ()
    rivals: str | None = None
    found: str = ""
    added: float = 0.0


def check_said(said: Said, given: ScanHeader, name: str) -> None:
    """Refuse a header that does not say the geometry, where the user does not say it, either.

    Raises:
        InputError: spacing or orientation are unknown; the message names what to set.
    """
    if not said.spacing and given.spacing_mm is None:
        raise InputError(
            f"{name} does not say how far its voxels lie apart: its header lacks the spacing"
            f"{said.found and f' ({said.found})'}. Export it again with it, or give it in mm: "
            "kidney.header.spacing_mm=[x,y,z]."
        )
    if said.rivals is not None and given.spacing_mm is None:
        raise InputError(
            f"{name} says two things of how far its voxels lie apart: {said.rivals}. Export it again, or say which is "
            "right in mm: kidney.header.spacing_mm=[x,y,z]."
        )
    if not said.orientation and given.orientation is None:
        raise InputError(
            f"{name} does not say how it lies in the patient: its header lacks the orientation, and left and right "
            "would be guessed. Export it again with it, or say towards what its voxel axes rise: "
            "kidney.header.orientation=lps (left, posterior, superior; ras and others are understood)."
        )


def voxel_geometry(
    spacing: Array, direction: Array, origin: Array, said: Said, given: ScanHeader
) -> tuple[Array, Array, Array]:
    """Spacing (3,) mm, direction cosines (3, 3) and origin (3,) mm, LPS, from what a reader took from the file."""
    unit = UNITS_MM[given.unit] if given.unit else (said.unit_mm or 1.0)
    factor = unit / said.read_mm
    spacing = spacing * factor if given.spacing_mm is None else np.asarray(given.spacing_mm, float)
    return spacing, direction if given.orientation is None else given.direction(), origin * factor
