"""ROS over rosbridge, against a real websocket server."""

import asyncio
import base64
import json
import sys
import threading
import time

import cv2
import numpy as np
import pytest
from clocks import does_not_hang
from dialogue import wait_until

from ursnav_torch.devices import Frame, GamepadMapping, Joints, RosBridge, RosGamepad, Stamp
from ursnav_torch.errors import DeviceNotConnectedError, DeviceTimeoutError, MissingExtraError
from ursnav_torch.geometry import transform_from_quaternion


class Rosbridge:
    """A rosbridge server on a real websocket that remembers what it was sent."""

    def __init__(self):
        from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol

        self.heard, self.clients = [], []
        bridge = self

        class Protocol(WebSocketServerProtocol):
            def onOpen(self):  # noqa: N802
                bridge.clients.append(self)

            def onMessage(self, payload, is_binary):  # noqa: N802
                bridge.heard.append(json.loads(payload))

        self.loop = asyncio.new_event_loop()
        factory = WebSocketServerFactory("ws://127.0.0.1", loop=self.loop)
        factory.protocol = Protocol
        self.server = self.loop.run_until_complete(self.loop.create_server(factory, "127.0.0.1", 0))
        self.port = self.server.sockets[0].getsockname()[1]
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()

    def publish(self, topic, message):
        data = json.dumps({"op": "publish", "topic": topic, "msg": message}).encode()
        self.loop.call_soon_threadsafe(lambda: [client.sendMessage(data) for client in self.clients])

    def messages(self, topic):
        return [m["msg"] for m in self.heard if m["op"] == "publish" and m["topic"] == topic]

    def close(self):
        async def end():
            for client in self.clients:
                client.sendClose()
            self.server.close()
            await asyncio.sleep(0.05)

        asyncio.run_coroutine_threadsafe(end(), self.loop).result(2.0)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


@pytest.fixture
def bridge():
    pytest.importorskip("roslibpy", reason="needs the extra ros")
    bridge = Rosbridge()
    yield bridge
    bridge.close()


JOY = {"header": {}, "axes": [0.54, 0.0, 0, 0, 0, 0, 0, 0], "buttons": [1, 0, 0, 0, 1]}


def test_joy_drives_and_silence_lets_go(bridge):
    with RosGamepad(RosBridge(port=bridge.port), silence_s=0.2) as gamepad:
        assert gamepad.read().dead_man is False
        assert wait_until(lambda: any(m["op"] == "subscribe" for m in bridge.heard))
        assert bridge.heard[0]["topic"] == "/joy" and bridge.heard[0]["type"] == "sensor_msgs/Joy"
        hands = gamepad.read()

        def driven():
            nonlocal hands
            for message in (JOY | {"axes": [0.05] * 8, "buttons": [0] * 11}, JOY):  # hands off, then on
                bridge.publish("/joy", message)
                time.sleep(0.05)
                hands = gamepad.read()
            return hands.dead_man

        assert wait_until(driven)
        assert (hands.bend_x, hands.insertion) == (pytest.approx(0.5), 1.0)
        assert wait_until(lambda: not gamepad.read().dead_man)


class ToyBridge(RosBridge):
    """Says what a test's ``/joy`` does; None is silence."""

    now = None

    def _open(self): ...
    def _close(self): ...
    def joy(self, timeout_s):
        if self.now is None:
            raise DeviceTimeoutError("silent")
        return self.now


@pytest.mark.parametrize("how", ["silence", "reconnection"])
def test_a_trigger_that_nobody_touches_does_not_drive_after(how):
    bridge = ToyBridge()
    gamepad = RosGamepad(bridge, GamepadMapping(axes={"insertion": (0, 1.0)}))
    with gamepad:
        bridge.now = ([0.05], [0])
        gamepad.read()
        if how == "silence":
            bridge.now = None
            gamepad.read()
        else:
            gamepad.disconnect()
            gamepad.connect()
        bridge.now = ([-1.0], [1])
        hands = gamepad.read()
        assert hands.dead_man and hands.insertion == 0.0


def test_poses_joints_and_pictures_go_out_in_meters_under_the_fields_names(bridge):
    T = transform_from_quaternion([10.0, -20.0, 30.0], [0.0, 0.6, 0.0, 0.8])
    image = np.random.default_rng(0).integers(0, 255, (8, 9), dtype=np.uint8)
    with RosBridge(port=bridge.port) as ros:
        ros.publish_pose(T, 1234.5)
        ros.publish_joints(Joints(0.1, 0.2, 30.0), 1234.5)
        ros.publish_image(Frame(Stamp(0, 0.0, 1234.5), image))
        ros.publish_image(Frame(Stamp(1, 0.0, 1234.5), image, b"own bytes", "jpg"))
        assert wait_until(lambda: len(bridge.messages("/ureteroscope/image_raw/compressed")) == 2)
    (pose,) = bridge.messages("/ureteroscope/camera_pose")
    assert pose["pose"]["position"] == {"x": 0.01, "y": -0.02, "z": 0.03}
    assert pose["pose"]["orientation"] == pytest.approx({"x": 0.0, "y": 0.6, "z": 0.0, "w": 0.8})
    assert pose["header"] == {"stamp": {"secs": 1234, "nsecs": 500000000}, "frame_id": "kidney"}
    (joints,) = bridge.messages("/ureteroscope/joint_states")
    assert joints["position"] == [0.1, 0.2, 0.03] and joints["name"] == ["bend_x", "bend_y", "insertion"]
    png, own = bridge.messages("/ureteroscope/image_raw/compressed")
    sent = cv2.imdecode(np.frombuffer(base64.b64decode(png["data"]), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(sent, image)
    assert (own["format"], base64.b64decode(own["data"])) == ("jpg", b"own bytes")
    types = {m["topic"]: m["type"] for m in bridge.heard if m["op"] == "advertise"}
    assert types["/ureteroscope/camera_pose"] == "geometry_msgs/PoseStamped"
    assert types["/ureteroscope/image_raw/compressed"] == "sensor_msgs/CompressedImage"
    assert types["/ureteroscope/joint_states"] == "sensor_msgs/JointState"


def test_a_bridge_that_goes_away_stops_nothing_but_the_driving(bridge):
    with RosGamepad(RosBridge(port=bridge.port)) as gamepad:
        wait_until(lambda: bridge.clients)
        bridge.loop.call_soon_threadsafe(bridge.clients[0].sendClose)
        with pytest.raises(DeviceNotConnectedError, match="is gone"):
            for _ in range(100):
                gamepad.read()
                time.sleep(0.02)
        gamepad.bridge.publish_joints(Joints(), 0.0)


def test_no_bridge_fails_within_the_deadline():
    pytest.importorskip("roslibpy", reason="needs the extra ros")
    with does_not_hang(), pytest.raises(DeviceNotConnectedError, match="roslaunch rosbridge_server"):
        RosBridge(port=1, connect_s=0.3).connect()


def test_without_the_extra_the_message_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "roslibpy", None)
    with pytest.raises(MissingExtraError, match=r"ursnav-torch\[ros\]"):
        RosBridge().connect()
