"""MCAP: a recorded session for Foxglove, in its own schemas (protobuf): pictures, poses, EM sensor, notes, the kidney.

Foxglove wants meters, and times since 1970; the axes of its cameras are ours.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import trimesh

from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.devices import Frame, Note, RobotSample, Stamp, TrackerSample
from ursnav_torch.errors import InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.files import whole_file
from ursnav_torch.session import Event, Result

#: Foxglove's names of the kinds of pictures that it shows.
_FORMATS = {"jpg": "jpeg", "jpeg": "jpeg", "png": "png", "webp": "webp"}
#: foxglove.Log's levels.
_LEVELS = {"info": 2, "warning": 3, "error": 4}
_KIDNEY_RGBA = (0.85, 0.65, 0.6, 0.35)
_SCHEMAS = ("CompressedImage", "FrameTransform", "JointState", "JointStates", "Log", "PoseInFrame", "SceneUpdate")

_Message = tuple[str, int, Any]


def write_mcap(
    path: Path, events: Iterable[Event], kidney: trimesh.Trimesh | None = None, overwrite: bool = True
) -> dict[str, int]:
    """Write a session's events; how many messages each topic has.

    Topics: ``/camera/image`` (foxglove.CompressedImage), ``/pose`` (foxglove.PoseInFrame: the camera in the kidney,
    where it was accepted), ``/tf`` (foxglove.FrameTransform: kidney -> camera, em -> sensor), ``/robot``
    (foxglove.JointStates: bends in radians, insertion in meters), ``/log`` (foxglove.Log) and ``/kidney``
    (foxglove.SceneUpdate).

    Args:
        path: the file.
        events: in their order.
        kidney: its surface, kidney frame, mm.
        overwrite: replace what stands there.

    Raises:
        InputError: there is no event that could be shown.
        MissingExtraError: the extra ``mcap`` is not installed.
    """
    writer_class = import_extra("mcap_protobuf.writer", "mcap", "Writing MCAP").Writer
    made, counts = _Messages(), dict[str, int]()
    with whole_file(path, overwrite) as partial, partial.open("wb") as file, writer_class(file) as writer:
        for event in events:
            found = list(made.of(event))
            if kidney is not None and found:  # at the session's begin, which the first event tells
                found, kidney = [made.surface(found[0][1], kidney), *found], None
            for topic, time_ns, message in found:
                writer.write_message(topic, message, log_time=time_ns, publish_time=time_ns)
                counts[topic] = counts.get(topic, 0) + 1
        if not counts:
            raise InputError("The session has no picture, pose, sample or note: there is nothing to be shown.")
    return counts


class _Messages:
    """Makes messages of events.

    Wall clocks jump; so times are the first event's wall clock and what has passed since by the steady one.
    """

    def __init__(self) -> None:
        modules = {n: import_extra(f"foxglove_schemas_protobuf.{n}_pb2", "mcap", "Writing MCAP") for n in _SCHEMAS}
        self._new = SimpleNamespace(**{name: getattr(module, name) for name, module in modules.items()})
        self._start: Stamp | None = None
        self._pictures: dict[int, int] = {}

    def of(self, event: Event) -> Iterator[_Message]:
        """Topic, time in ns since 1970 and message of what an event shows."""
        now = self._ns(event.stamp)
        if isinstance(event, Frame):
            self._pictures[event.stamp.sequence] = now
            yield "/camera/image", now, self._image(event, now)
        elif isinstance(event, Result):
            yield from self._pose(event, now)
        elif isinstance(event, TrackerSample) and event.position_mm and event.quaternion_xyzw:
            yield "/tf", now, self._transform(("em", "sensor"), event.position_mm, event.quaternion_xyzw, now)
        elif isinstance(event, RobotSample):
            yield "/robot", now, self._joints(event, now)
        elif isinstance(event, Note):
            yield "/log", now, self._stamped("Log", now, level=_LEVELS[event.level], message=event.text, name="ursnav")

    def surface(self, now: int, mesh: trimesh.Trimesh) -> _Message:
        """The kidney as a see-through surface."""
        update = self._new.SceneUpdate()
        entity = update.entities.add(frame_id="kidney", id="kidney", frame_locked=True)
        entity.timestamp.FromNanoseconds(now)
        triangles = entity.triangles.add()
        triangles.pose.orientation.w = 1.0
        for x, y, z in (np.asarray(mesh.vertices) / 1000).tolist():
            triangles.points.add(x=x, y=y, z=z)
        triangles.indices.extend(np.asarray(mesh.faces).ravel().tolist())
        triangles.color.r, triangles.color.g, triangles.color.b, triangles.color.a = _KIDNEY_RGBA
        return "/kidney", now, update

    def _ns(self, stamp: Stamp) -> int:
        self._start = self._start or stamp
        return int(1e9 * self._start.t_wall_s) + int(1e9 * (stamp.t_mono_s - self._start.t_mono_s))

    def _stamped(self, schema: str, now: int, /, **fields: Any) -> Any:
        message = getattr(self._new, schema)(**fields)
        message.timestamp.FromNanoseconds(now)
        return message

    def _image(self, frame: Frame, now: int) -> Any:
        data, kind = frame.encoded, _FORMATS.get(frame.suffix, "")
        if data is None or not kind:
            data, kind = cv2.imencode(".png", frame.image)[1].tobytes(), "png"
        return self._stamped("CompressedImage", now, frame_id="camera", data=data, format=kind)

    def _pose(self, result: Result, now: int) -> Iterator[_Message]:
        """Where the camera was when its picture was taken."""
        if not result.row.get("accepted") or result.row.get("x_mm") is None:
            return
        values = [float(result.row[name]) for name in POSE_COLUMNS]
        taken = self._pictures.get(result.frame, now)
        transform = self._transform(("kidney", "camera"), values[:3], values[3:], taken)
        yield "/tf", taken, transform
        message = self._stamped("PoseInFrame", taken, frame_id="kidney")
        for axis in "xyz":
            setattr(message.pose.position, axis, getattr(transform.translation, axis))
        message.pose.orientation.CopyFrom(transform.rotation)
        yield "/pose", taken, message

    def _transform(self, frames: tuple[str, str], at_mm: Any, quaternion_xyzw: Any, now: int) -> Any:
        message = self._stamped("FrameTransform", now, parent_frame_id=frames[0], child_frame_id=frames[1])
        for axis, value in zip("xyz", at_mm, strict=True):
            setattr(message.translation, axis, value / 1000)
        for axis, value in zip("xyzw", quaternion_xyzw, strict=True):
            setattr(message.rotation, axis, value)
        return message

    def _joints(self, sample: RobotSample, now: int) -> Any:
        joints = sample.joints
        named = {"bend_x": joints.bend_x_rad, "bend_y": joints.bend_y_rad, "insertion": joints.insertion_mm / 1000}
        states = [self._new.JointState(name=name, position=value) for name, value in named.items()]
        return self._stamped("JointStates", now, joints=states)
