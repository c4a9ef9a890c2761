"""The half of UrsnavLive that needs no Slicer: Python's standard library and NumPy, both of which Slicer brings."""

from UrsnavLiveLib.exported import FILES, Exported, find_exports, read_stones
from UrsnavLiveLib.messages import Picture, Points, Pose, Text, decode
from UrsnavLiveLib.receiver import Receiver

__all__ = [
    "FILES",
    "Exported",
    "Picture",
    "Points",
    "Pose",
    "Receiver",
    "Text",
    "decode",
    "find_exports",
    "read_stones",
]
