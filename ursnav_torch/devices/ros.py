"""ROS without ROS: topics through a rosbridge websocket (extra ``ros``), under the names that the field uses.

ROS wants meters and radians (REP 103) and the camera's optical frame, whose axes are ours.
"""

import base64
import contextlib
import logging
import threading
import time
from typing import Any

import cv2

from ursnav_torch.devices.base import Frame, Gamepad, Joints, OperatorInput, Output
from ursnav_torch.devices.gamepads.mapping import GamepadMapping, MappedInput
from ursnav_torch.devices.wire import device_numbers
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError
from ursnav_torch.extras import import_extra
from ursnav_torch.geometry import Array, check_rigid, quaternion_from_transform

logger = logging.getLogger(__name__)

JOY = ("/joy", "sensor_msgs/Joy")
POSE = ("/ureteroscope/camera_pose", "geometry_msgs/PoseStamped")
IMAGE = ("/ureteroscope/image_raw/compressed", "sensor_msgs/CompressedImage")
JOINTS = ("/ureteroscope/joint_states", "sensor_msgs/JointState")


class RosBridge(Output):
    """A connection to a rosbridge server; connects again by itself when it is lost.

    Args:
        host, port: where rosbridge listens.
        connect_s: how long it may take to answer.
        kidney_frame, camera_frame: the tf names of the pose's and the picture's frames.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 9090,
        connect_s: float = 5.0,
        kidney_frame: str = "kidney",
        camera_frame: str = "camera_optical",
    ) -> None:
        super().__init__()
        self.host, self.port, self.connect_s = host, port, connect_s
        self.kidney_frame, self.camera_frame = kidney_frame, camera_frame
        self._library: Any = None
        self._ros: Any = None
        self._topics: dict[str, Any] = {}
        self._joy_lock = threading.Lock()
        self._joy: tuple[float, list[float], list[int]] = (-1e9, [], [])

    def publish_pose(self, T_kidney_camera: Array, t_wall_s: float) -> None:
        """Publish the camera's pose (4, 4), mm, as PoseStamped, which is in meters."""
        T = check_rigid(T_kidney_camera, "T_kidney_camera")
        x, y, z = (T[:3, 3] / 1000).tolist()
        qx, qy, qz, qw = quaternion_from_transform(T).tolist()
        pose = {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}
        self._publish(POSE, {"header": _header(self.kidney_frame, t_wall_s), "pose": pose})

    def publish_image(self, frame: Frame) -> None:
        """Publish a picture as CompressedImage: the camera's own bytes, or PNG."""
        data, suffix = frame.encoded, frame.suffix
        if data is None:
            data, suffix = cv2.imencode(".png", frame.image)[1].tobytes(), "png"
        header = _header(self.camera_frame, frame.stamp.t_wall_s)
        message = {"header": header, "format": suffix, "data": base64.b64encode(data).decode("ascii")}
        self._publish(IMAGE, message)

    def publish_joints(self, joints: Joints, t_wall_s: float) -> None:
        """Publish bend angles (radians) and insertion (meters) as JointState."""
        position = [joints.bend_x_rad, joints.bend_y_rad, joints.insertion_mm / 1000]
        names = ["bend_x", "bend_y", "insertion"]
        message = {"header": _header("", t_wall_s), "name": names, "position": position, "velocity": [], "effort": []}
        self._publish(JOINTS, message)

    def joy(self, timeout_s: float) -> tuple[list[float], list[int]]:
        """Axes and buttons of the newest ``/joy``.

        Raises:
            DeviceTimeoutError: it is older than ``timeout_s``.
            DeviceNotConnectedError: rosbridge is gone.
        """
        self._check_connected()
        if not self._ros.is_connected:
            raise DeviceNotConnectedError(f"rosbridge at {self.host}:{self.port} is gone; is it still running?")
        with self._joy_lock:
            heard_s, axes, buttons = self._joy
        if time.monotonic() - heard_s > timeout_s:
            raise DeviceTimeoutError(
                f"No {JOY[0]} for {timeout_s} s; start joy_node with autorepeat_rate 20, as it is otherwise silent "
                "while the stick rests."
            )
        return axes, buttons

    def _publish(self, topic: tuple[str, str], message: dict[str, Any]) -> None:
        self._check_connected()
        if not self._ros.is_connected:
            logger.debug("not published on %s: rosbridge is gone", topic[0])
            return
        if topic[0] not in self._topics:
            self._topics[topic[0]] = self._library.Topic(self._ros, *topic)
        self._topics[topic[0]].publish(self._library.Message(message))

    def _open(self) -> None:
        self._library = import_extra("roslibpy", "ros", "ROS over rosbridge")
        try:
            self._ros = self._library.Ros(self.host, self.port, transport="asyncio")
            self._ros.run(timeout=self.connect_s)
        except Exception as error:  # roslibpy raises its own and asyncio's errors, and plain Exception
            raise DeviceNotConnectedError(
                f"No rosbridge at {self.host}:{self.port} ({error}); start it with: "
                "roslaunch rosbridge_server rosbridge_websocket.launch"
            ) from error
        self._topics = {JOY[0]: self._library.Topic(self._ros, *JOY)}
        self._topics[JOY[0]].subscribe(self._heard)

    def _close(self) -> None:
        if self._ros is None:
            return
        with contextlib.suppress(Exception):  # it may be gone already
            self._ros.close(timeout=1.0)
        self._ros, self._topics = None, {}

    def _heard(self, message: dict[str, Any]) -> None:
        try:
            axes = device_numbers(message["axes"], "The axes of /joy")
            buttons = [int(v) for v in device_numbers(message["buttons"], "The buttons of /joy")]
        except (KeyError, TypeError, DeviceProtocolError) as error:
            logger.warning("%s passed over: %s", JOY[0], error)  # and what was held before grows old
            return
        with self._joy_lock:
            self._joy = (time.monotonic(), axes, buttons)


class RosGamepad(Gamepad):
    """A gamepad that ROS's joy node publishes, as in the thesis (§4.3.3).

    Args:
        bridge: the connection; connected and disconnected with this device.
        mapping: which stick and button means what.
        silence_s: without ``/joy`` for so long nothing counts as held.
    """

    def __init__(self, bridge: RosBridge, mapping: GamepadMapping | None = None, silence_s: float = 0.3) -> None:
        super().__init__()
        self.bridge, self.mapping, self.silence_s = bridge, mapping or GamepadMapping(), silence_s
        self._mapped = MappedInput(self.mapping)

    def read(self) -> OperatorInput:
        """The newest ``/joy``; nothing held when it is too old, and each axis must then be seen at rest again."""
        self._check_connected()
        try:
            axes, buttons = self.bridge.joy(self.silence_s)
        except DeviceTimeoutError:
            axes, buttons = [], []
        return self._mapped(self._stamp(), axes, buttons)

    def _open(self) -> None:
        self.bridge.connect()
        self._mapped = MappedInput(self.mapping)

    def _close(self) -> None:
        self.bridge.disconnect()


def _header(frame_id: str, t_wall_s: float) -> dict[str, Any]:
    seconds = int(t_wall_s)
    return {"stamp": {"secs": seconds, "nsecs": int((t_wall_s - seconds) * 1e9)}, "frame_id": frame_id}
