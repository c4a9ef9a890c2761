"""Plus's sequence files (.mha, .mhd): a header with a transform, its status and a time a frame.

Written from the Plus toolkit's description of sequence metafiles. Lengths are mm, times s; pictures that follow the
header are not read.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.em_log.lengths import check_lengths
from ursnav_torch.em_log.samples import TIME_S, EmFormat, EmSamples
from ursnav_torch.errors import InputError
from ursnav_torch.units import LENGTH_MM

Array = NDArray[np.float64]

#: Endings of such files.
SEQUENCE_SUFFIXES = (".mha", ".mhd")
#: A header of an hour at 60 frames a second has 100 MB.
_MOST_BYTES = 256 << 20
_FIELD = re.compile(r"Seq_Frame(\d+)_(\w+)\s*=(.*)", re.DOTALL)
_TRANSFORM, _STATUS = "Transform", "TransformStatus"


def read_sequence(path: Path, form: EmFormat) -> EmSamples:
    """The poses of one tool in the tracker's frame, a row a frame; NaN where its status is not OK.

    The transform is the only one named ``...ToTracker`` (or ``...ToReference``), or what ``em_tool`` names.

    Raises:
        InputError: no such file, no frame in it, no transform or several, or one that is none; see `check_lengths`.
    """
    frames = _frames(path)
    name = _chosen(frames, path, form.tool)
    T = np.array([_matrix(frame.get(name + _TRANSFORM), path) for frame in frames])
    seen = [frame.get(name + _STATUS, "OK").upper() == "OK" for frame in frames]
    R = T[:, :3, :3]
    rigid = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) < 1e-2
    ok = np.array(seen) & np.isfinite(T).all(axis=(1, 2)) & rigid & (np.linalg.det(R) > 0)
    position, axis, quaternion = (np.full((len(T), n), np.nan) for n in (3, 3, 4))
    position[ok], axis[ok] = T[ok, :3, 3], T[ok, :3, 2]
    if ok.any():
        quaternion[ok] = Rotation.from_matrix(R[ok]).as_quat()
    position *= LENGTH_MM[form.unit or "mm"]
    t_s = _clock(frames, path) * TIME_S[form.time_unit or "s"] - form.offset_s
    check_lengths(position, t_s, str(path), form)
    return EmSamples(position, axis, t_s, quaternion=quaternion, source=str(path))


def _frames(path: Path) -> list[dict[str, str]]:
    """The fields of every frame, in order."""
    found: dict[int, dict[str, str]] = {}
    try:
        with path.open("rb") as file:
            while (line := file.readline(1 << 16)) and file.tell() < _MOST_BYTES:
                text = line.decode("utf-8", "replace")
                if text.startswith("ElementDataFile"):
                    break
                if (match := _FIELD.match(text)) is not None:
                    found.setdefault(int(match[1][:9]), {})[match[2]] = match[3].strip()
    except OSError as error:
        raise InputError(f"The EM file {path} cannot be read: {error.strerror}.") from None
    if not found:
        raise InputError(f"{path} has no frames (lines Seq_Frame0000_...): it is no sequence that Plus recorded.")
    return [found[number] for number in sorted(found)]


def _chosen(frames: list[dict[str, str]], path: Path, tool: str | None) -> str:
    """The name of the transform to take, without its ending."""
    every = sorted({key.removesuffix(_TRANSFORM) for frame in frames for key in frame if key.endswith(_TRANSFORM)})
    wanted = (
        [n for n in every if n.endswith(("ToTracker", "ToReference"))] if tool is None else [tool] * (tool in every)
    )
    if len(wanted) != 1:
        raise InputError(
            f"{path} has the transforms {', '.join(every) or 'none'}; say which is the sensor's in the tracker's "
            "frame: em_tool=, such as em_tool=ProbeToTracker."
        )
    return wanted[0]


def _matrix(text: str | None, path: Path) -> Array:
    if text is None:
        return np.full((4, 4), np.nan)
    try:
        return np.array(text.split(), float).reshape(4, 4)
    except ValueError:
        raise InputError(f"{path} has a transform that is no 4 x 4 numbers: {text[:60]!r}.") from None


def _clock(frames: list[dict[str, str]], path: Path) -> Array:
    try:
        return np.array([float(frame["Timestamp"]) for frame in frames])
    except (KeyError, ValueError):
        raise InputError(f"{path} has a frame without a Timestamp; record the sequence again.") from None
