"""The thesis's own controllers: Arduinos under rosserial that turn the motors by steps.

Each message orders steps *and* the milliseconds to make them in, replaces the one before and is never good
for more than half a second, so that the robot stands still when the host falls silent.
"""

import time

import numpy as np

from ursnav_torch.devices.base import JointRates, Joints, Light, LightSample
from ursnav_torch.devices.robots.kinematics import Drive
from ursnav_torch.devices.robots.robot import Robot
from ursnav_torch.devices.robots.rosserial_packets import INT32S, UINT8, RosserialLink, pack_ints, unpack_ints
from ursnav_torch.devices.robots.safety import Limits
from ursnav_torch.errors import DeviceError, DeviceNotConnectedError, DeviceTimeoutError, InputError

#: Subscribed by the boards: steps x, y, ms / steps z, ms / LED level 0..255.
BEND, SLIDER, LIGHT = "/ureteroscope/bend_steps", "/ureteroscope/slider_steps", "/ureteroscope/light"
#: Published by the boards: position x, y in steps, 1 while moving / position z, 1 while moving.
BEND_POSITION, SLIDER_POSITION = "/ureteroscope/bend_position", "/ureteroscope/slider_position"
SILENCE_S = 0.5


class RosserialRobot(Robot):
    """The robot on one or two Arduinos; straight and withdrawn when they start: that is where steps are zero.

    Args:
        ports: the ports of the boards for bending and slider; one port if one board does both.
        drive: cables, drums, slider and steps per mm.
        limits: joint limits and speed caps.
        baud: 57600 unless the sketch says otherwise.
        horizon_s: how long one order lasts.
        watchdog_s: stop after so long without a command.
        deadline_s: how long a board may take to announce its topics.
    """

    def __init__(
        self,
        ports: list[str],
        drive: Drive | None = None,
        limits: Limits | None = None,
        baud: int = 57600,
        horizon_s: float = 0.15,
        watchdog_s: float = 0.5,
        deadline_s: float = 5.0,
    ) -> None:
        super().__init__(limits or Limits(), horizon_s, watchdog_s)
        if len(ports) not in (1, 2):
            raise InputError(f"ports must name one or two serial ports (bending, slider), got {ports}.")
        self.ports, self.drive, self.baud, self.deadline_s = list(ports), drive or Drive(), baud, deadline_s
        self._links: list[RosserialLink] = []
        self._steps = np.zeros(3)
        self._offset = np.zeros(3)  # steps that a board forgot when it lost its power
        self._moving = [False, False]
        self._heard_s = [0.0, 0.0]
        self._velocity = np.zeros(3)  # steps/s of the order under way
        self._ordered_s = 0.0
        self._level = 0.0

    def set_light(self, level: float) -> float:
        """Dim the LED on the bending board."""
        self._check_connected()
        value = round(min(max(level, 0.0), 1.0) * 255)
        with self._lock:
            self._links[0].publish(LIGHT, bytes([value]))
        return value / 255

    def _open(self) -> None:
        bend = {BEND: INT32S, BEND_POSITION: INT32S, LIGHT: UINT8}
        slider = {SLIDER: INT32S, SLIDER_POSITION: INT32S}
        needs = [bend | slider] if len(self.ports) == 1 else [bend, slider]
        for port, needed in zip(self.ports, needs, strict=True):
            self._links.append(RosserialLink(port, self.baud, needed, self.deadline_s))
        self._heard_s = [0.0, 0.0]
        self._listen(SILENCE_S)

    def _close(self) -> None:
        for link in self._links:
            link.close()
        self._links.clear()

    def _joints_ahead(self) -> Joints:
        self._listen(SILENCE_S)
        age = min(time.monotonic() - self._ordered_s, self.horizon_s)
        return self.drive.joints_from_steps(self._steps + self._offset + self._velocity * max(age, 0.0))

    def _send(self, rates: JointRates) -> JointRates:
        axes = self.drive.axes_mm(Joints(rates.bend_x_rad_s, rates.bend_y_rad_s, rates.insertion_mm_s))
        steps = np.rint(axes * self.drive.steps_per_mm * self.horizon_s).astype(int)
        self._order(steps.tolist(), round(1000 * self.horizon_s))
        self._velocity, self._ordered_s = steps / self.horizon_s, time.monotonic()
        sent = self.drive.joints_from_steps(self._velocity)
        return JointRates(sent.bend_x_rad, sent.bend_y_rad, sent.insertion_mm)

    def _order(self, steps: list[int], milliseconds: int) -> None:
        if not self._links:
            raise DeviceNotConnectedError(f"{self.ports} are not open; plug the boards in, then acknowledge.")
        self._links[0].publish(BEND, pack_ints([*steps[:2], milliseconds]))
        self._links[-1].publish(SLIDER, pack_ints([steps[2], milliseconds]))

    def _halt(self) -> None:
        self._velocity = np.zeros(3)
        if not self._links:
            return
        failure: DeviceError | None = None
        for link, topic, order in ((0, BEND, [0, 0, 0]), (-1, SLIDER, [0, 0])):
            try:
                self._links[link].publish(topic, pack_ints(order))
            except DeviceError as error:  # one dead board must not keep the other one going
                failure = error
        if failure:
            raise failure

    def _kill(self) -> None:
        self._halt()

    def _recover(self) -> None:
        before = self._steps + self._offset
        self._close()
        self._open()
        restarted = self._steps == 0
        self._offset = np.where(restarted, before, self._offset)

    def _read_joints(self, timeout_s: float) -> tuple[Joints, bool]:
        self._listen(timeout_s)
        return self.drive.joints_from_steps(self._steps + self._offset), any(self._moving)

    def _listen(self, timeout_s: float) -> None:
        """Take in the positions that came; wait only when the newest are older than half a second."""
        deadline = time.monotonic() + timeout_s
        while True:
            for link, wanted in ((self._links[0], BEND_POSITION), (self._links[-1], SLIDER_POSITION)):
                for name, payload in link.receive(0.0):
                    if len(self._links) == 1 or name == wanted:
                        self._take(name, payload)
            now = time.monotonic()
            if now - min(self._heard_s) < SILENCE_S:
                return
            if now > deadline:
                silent = [p for p, t in zip((BEND_POSITION, SLIDER_POSITION), self._heard_s, strict=True)
                          if now - t >= SILENCE_S]  # fmt: skip
                raise DeviceTimeoutError(f"{self.ports}: no {', '.join(silent)} for {SILENCE_S} s; is the board hung?")
            time.sleep(0.002)

    def _take(self, name: str, payload: bytes) -> None:
        values = unpack_ints(payload)
        if name == BEND_POSITION and len(values) == 3:
            self._steps[:2], self._moving[0], self._heard_s[0] = values[:2], bool(values[2]), time.monotonic()
        elif name == SLIDER_POSITION and len(values) == 2:
            self._steps[2], self._moving[1], self._heard_s[1] = values[0], bool(values[1]), time.monotonic()


class RosserialLight(Light):
    """An LED on an Arduino of its own, as in the thesis's set-up (§4.3.4)."""

    def __init__(self, port: str, baud: int = 57600, deadline_s: float = 5.0) -> None:
        super().__init__()
        self.port, self.baud, self.deadline_s = port, baud, deadline_s
        self._link: RosserialLink | None = None

    def _open(self) -> None:
        self._link = RosserialLink(self.port, self.baud, {LIGHT: UINT8}, self.deadline_s)

    def _close(self) -> None:
        if self._link:
            self._link.close()
            self._link = None

    def set_level(self, level: float) -> LightSample:
        """Send the level as a byte; returns it as rounded."""
        self._check_connected()
        assert self._link is not None
        value = round(min(max(level, 0.0), 1.0) * 255)
        self._link.publish(LIGHT, bytes([value]))
        return LightSample(self._stamp(), value / 255)
