"""The thesis's own controllers: Arduinos under rosserial that turn the motors by steps.

Each message orders steps *and* the milliseconds to make them in and replaces the one before. It never ends later than
0.15 s after the boards' newest report, so that the robot stands still when host or board falls silent.

A board that was reset counts from zero, and is seen by its silence: rosserial_arduino publishes nothing until a host
asks for its topics (``NodeHandle_::publish`` returns at once where it is not ``configured_``, which a reset forgets;
rosserial_arduino/src/ros_lib of github.com/ros-drivers/rosserial). We ask only where ports are opened, and the place is
lost there; a board that announces its topics unasked loses it, too.
"""

import time

import numpy as np

from ursnav_torch.devices.base import JointRates, Joints, Lamp, LightSample
from ursnav_torch.devices.robots.kinematics import Drive
from ursnav_torch.devices.robots.recent_orders import RecentOrders, is_against
from ursnav_torch.devices.robots.robot import BLIND_S, Robot
from ursnav_torch.devices.robots.rosserial_packets import (
    INT32S,
    UINT8,
    BoardResetError,
    RosserialLink,
    pack_ints,
    unpack_ints,
)
from ursnav_torch.devices.robots.safety import Limits
from ursnav_torch.errors import (
    DeviceError,
    DeviceNotConnectedError,
    DeviceProtocolError,
    DeviceTimeoutError,
    InputError,
)
from ursnav_torch.geometry import Array

#: Subscribed by the boards: steps x, y, ms / steps z, ms / LED level 0..255.
BEND, SLIDER, LIGHT = "/ureteroscope/bend_steps", "/ureteroscope/slider_steps", "/ureteroscope/light"
#: Published by the boards: position x, y in steps, 1 while moving / position z, 1 while moving.
POSITIONS = BEND_POSITION, SLIDER_POSITION = "/ureteroscope/bend_position", "/ureteroscope/slider_position"
#: How long a board may take to announce its topics; it restarts when the port is opened.
ANNOUNCE_S = 5.0
#: A board reports 20 times a second; one that has not for this long is waited for before anything is sent to it.
FRESH_S = 0.1
#: A board that was waited for so long is hung.
SILENCE_S = 0.3
#: Serial line and scheduler take this much of the time for which motion may go on blindly.
LATENCY_S = 0.01
#: A position may be this many steps off for rounding.
ROUNDING_STEPS = 2.0


class RosserialRobot(Robot):
    """The robot on one or two Arduinos; straight and withdrawn when they start: that is where steps are zero.

    Args:
        ports: the ports of the boards for bending and slider; one port if one board does both.
        drive: cables, drums, slider and steps per mm.
        limits: joint limits and speed caps.
        baud: 57600 unless the sketch says otherwise.
        horizon_s: how long one order lasts; less where the newest report is old, see `BLIND_S`.
        watchdog_s: stop after so long without a command.
    """

    def __init__(
        self,
        ports: list[str],
        drive: Drive | None = None,
        limits: Limits | None = None,
        baud: int = 57600,
        horizon_s: float = 0.12,
        watchdog_s: float = 0.5,
    ) -> None:
        self.drive, limits = drive or Drive(), limits or Limits()
        self._unreported = _unreported(limits, self.drive)
        super().__init__(limits, horizon_s, watchdog_s, self._unreported)
        self._ahead_s = 2 * horizon_s  # an order may come so late that the one before it has run to its end
        if len(ports) not in (1, 2):
            raise InputError(f"ports must name one or two serial ports (bending, slider), got {ports}.")
        self.ports, self.baud = list(ports), baud
        self._links: list[RosserialLink] = []
        self._counts = np.zeros(3)  # as the boards report them
        self._offset = np.zeros(3)  # steps that a board forgot when it was reset
        self._moving = [False, False]
        self._heard_s = [0.0, 0.0]  # when the newest reports were made, or later
        self._came_s = [0.0, 0.0]  # when they were taken in
        self._at, self._at_s = np.zeros(3), 0.0  # where the motors are reckoned to be, and when
        self._velocity = np.zeros(3)  # steps/s of the order under way
        self._turned_s = np.zeros(3)  # since when each motor has turned this way
        self._ends_s = 0.0  # when it ends
        self._orders = RecentOrders()

    def set_light(self, level: float) -> float:
        """Dim the LED on the bending board."""
        self._check_connected()
        value = round(min(max(level, 0.0), 1.0) * 255)
        with self._exchange():
            self._boards()[0].publish(LIGHT, bytes([value]))
        return value / 255

    def _open(self) -> None:
        self._open_links()
        self._listen(ANNOUNCE_S)
        self._offset, self._at = -self._counts, np.zeros(3)
        self.place.set(np.zeros(3))

    def _open_links(self) -> None:
        bend = {BEND: INT32S, BEND_POSITION: INT32S, LIGHT: UINT8}
        slider = {SLIDER: INT32S, SLIDER_POSITION: INT32S}
        needs = [bend | slider] if len(self.ports) == 1 else [bend, slider]
        for port, needed in zip(self.ports, needs, strict=True):
            self._links.append(RosserialLink(port, self.baud, needed, ANNOUNCE_S))
        self._heard_s, self._came_s, self._ends_s = [0.0, 0.0], [0.0, 0.0], 0.0

    def _close(self) -> None:
        self._dismiss_guardian()
        for link in self._links:
            link.close()
        self._links.clear()

    def _boards(self) -> list[RosserialLink]:
        if not self._links:
            raise DeviceNotConnectedError(f"{self.ports} are not open; plug the boards in, then acknowledge.")
        return self._links

    def _stops(self) -> dict[int, bytes]:
        found: dict[int, bytes] = {}
        for link, topic, order in self._halts():
            if (fd := link.fileno()) is not None:
                found[fd] = found.get(fd, b"") + link.packed(topic, pack_ints(order))
        return found

    def _halts(self) -> list[tuple[RosserialLink, str, list[int]]]:
        boards = self._boards()
        return [(boards[0], BEND, [0, 0, 0]), (boards[-1], SLIDER, [0, 0])]

    def _joints_of(self, axes: Array) -> Joints:
        return self.drive.joints_from_steps(axes)

    def _axes_of(self, joints: Joints) -> Array:
        return np.array(self.drive.steps(joints), float)

    def _joints_ahead(self) -> Joints:
        self._listen()
        if not self.place.is_known:
            raise DeviceProtocolError(f"{self.ports}: {self.place.why_lost}.")
        return self._joints_of(self._reckon())

    def _reckon(self) -> Array:
        """Where the motors are by now, (3,) steps: reports are up to 0.1 s old, so orders are added up."""
        now = time.monotonic()
        self._at = self._at + self._velocity * max(min(now, self._ends_s) - self._at_s, 0.0)
        self._at_s = now
        return self._at

    def _send(self, rates: JointRates) -> JointRates:
        blind_s = min(self._heard_s) + BLIND_S - LATENCY_S - time.monotonic()
        seconds = round(min(self.horizon_s, blind_s), 3)
        axes = self.drive.axes_mm(Joints(rates.bend_x_rad_s, rates.bend_y_rad_s, rates.insertion_mm_s))
        steps = np.trunc(axes * self.drive.steps_per_mm * seconds).astype(int)
        if seconds <= 0 or not steps.any():
            return JointRates()
        back, forth = self._orders.unseen(min(self._heard_s))
        dropped = self.place.axes + np.where(steps > 0, forth, back)
        if self._may_pass_a_limit(steps, self._reckon(), is_against(steps, back, forth), dropped):
            return JointRates()
        self._turned_s = np.where(np.sign(steps) == np.sign(self._velocity), self._turned_s, time.monotonic())
        ends, self._velocity = self._reckon() + steps, steps / seconds
        self._ends_s = self._at_s + seconds
        self._orders.add(self._ends_s, self._velocity)
        self.place.sent(ends)
        self._widen()
        milliseconds = round(1000 * seconds)
        boards = self._boards()
        try:
            boards[0].publish(BEND, pack_ints([*steps[:2].tolist(), milliseconds]))
            boards[-1].publish(SLIDER, pack_ints([int(steps[2]), milliseconds]))
        finally:  # a busy machine may have sent it late
            self._orders.add(time.monotonic() + seconds, self._velocity)
            self._widen()
        sent = self.drive.joints_from_steps(steps / seconds)
        return JointRates(sent.bend_x_rad, sent.bend_y_rad, sent.insertion_mm)

    def _halt(self) -> None:
        self._ends_s = min(self._ends_s, time.monotonic())
        if not self._links:
            return
        failure: DeviceError | None = None
        for link, topic, order in self._halts():
            try:
                link.publish(topic, pack_ints(order))
            except DeviceError as error:  # one dead board must not keep the other one going
                failure = error
        if failure:
            raise failure

    def _kill(self) -> None:
        self._halt()

    def _recover(self) -> None:
        try:
            self._forget()
            self._listen()
        except DeviceError:  # hung, unplugged or reset, and opening the ports anew resets most Arduinos
            self._close()
            self._open_links()
            # Its counts prove nothing: a board that was reset may have obeyed one more order since, and count as far.
            self.place.lose("a board had fallen silent or was unplugged; it may have been reset")
            self._listen(ANNOUNCE_S)

    def _recount(self, axes: Array) -> None:
        self._forget()
        self._listen(ANNOUNCE_S)
        self._offset, self._at = axes - self._counts, axes

    def _forget(self) -> None:
        """Pass over what has come so far: it may be of a board that was reset since."""
        for link in self._boards():
            try:
                link.receive(0.0)
            except BoardResetError as error:
                self.place.lose(str(error))
        self._heard_s, self._came_s = [0.0, 0.0], [0.0, 0.0]

    def _read_axes(self, timeout_s: float) -> bool:
        self._listen(timeout_s)
        return any(self._moving)

    def _listen(self, timeout_s: float = SILENCE_S) -> None:
        """Take in the reports that came; wait where the newest are older than `FRESH_S`.

        Raises:
            DeviceTimeoutError: none came in time.
            DeviceProtocolError: what came cannot be read; where a board was reset, the place is lost.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                for link, wanted in zip((self._boards()[0], self._boards()[-1]), POSITIONS, strict=True):
                    for name, payload in link.receive(0.0):
                        if len(self._links) == 1 or name == wanted:
                            self._take(name, payload, link.since_s)
            except BoardResetError as error:
                self.place.lose(str(error))
                raise
            now = time.monotonic()
            if now - min(self._heard_s) < FRESH_S:
                self._believe(now)
                return
            silent = [p for p, t in zip(POSITIONS, self._came_s, strict=True) if now - t >= FRESH_S]
            if now > deadline and silent:  # else this machine is too busy to know how old they are, and looks again
                raise DeviceTimeoutError(f"{self.ports}: no {', '.join(silent)} for {timeout_s} s; is the board hung?")
            time.sleep(0.002)

    def _believe(self, now: float) -> None:
        """Take the newest report to the place."""
        at, reckoned = self._counts + self._offset, self._reckon()
        resting = self._orders.are_over(min(self._heard_s)) and not any(self._moving)
        if self.place.report(at, at):
            self._widen()
        spread = 0.0 if resting else self._unreported
        ahead = np.where(now - self._turned_s > BLIND_S, np.sign(self._velocity), 0.0)  # who goes on is past the report
        self._at = np.clip(reckoned, at - np.where(ahead > 0, 0.0, spread), at + np.where(ahead < 0, 0.0, spread))

    def _widen(self) -> None:
        """The motors may be anywhere that the orders of late can have taken them since the newest report."""
        at = self._counts + self._offset
        for way in self._orders.unseen(min(self._heard_s)):
            self.place.sent(at + way)

    def _take(self, name: str, payload: bytes, since_s: float) -> None:
        values = unpack_ints(payload)
        if name == BEND_POSITION and len(values) == 3:
            self._counts[:2], self._moving[0], board = values[:2], bool(values[2]), 0
        elif name == SLIDER_POSITION and len(values) == 2:
            self._counts[2], self._moving[1], board = values[0], bool(values[1]), 1
        else:
            return
        self._heard_s[board], self._came_s[board] = since_s, time.monotonic()


def _unreported(limits: Limits, drive: Drive) -> Array:
    """Steps (3,) that the motors can make between a report and the next one, at the speed caps."""
    fastest = Joints(limits.max_bend_rate_rad_s, limits.max_bend_rate_rad_s, limits.max_insertion_rate_mm_s)
    steps: Array = np.abs(drive.axes_mm(fastest)) * drive.steps_per_mm * BLIND_S + ROUNDING_STEPS
    return steps


class RosserialLight(Lamp):
    """An LED on an Arduino of its own, as in the thesis's set-up (§4.3.4)."""

    def __init__(self, port: str, baud: int = 57600) -> None:
        super().__init__()
        self.port, self.baud = port, baud
        self._link: RosserialLink | None = None

    def _open(self) -> None:
        self._link = RosserialLink(self.port, self.baud, {LIGHT: UINT8}, ANNOUNCE_S)

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
