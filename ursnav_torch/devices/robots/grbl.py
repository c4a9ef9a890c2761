"""A robot on a GRBL 1.1 controller: axes X, Y pull the cables, Z drives the slider, the spindle PWM dims the LED.

Motion is sent as relative jogs (``$J=``) that keep the board busy for ``horizon_s`` at most. GRBL has no
watchdog of its own, so this is what bounds the motion after the host has died. The bytes follow GRBL's own
interface and jogging documents (github.com/gnea/grbl, doc/markdown). How a reset is seen that nobody heard of:
`reset_watch`.
"""

import logging
import math
import time

import numpy as np

from ursnav_torch.devices.base import JointRates, Joints
from ursnav_torch.devices.robots.grbl_words import (
    ALARMS,
    AT_REST,
    ERRORS,
    FLUIDNC,
    GREETING,
    JOGGING,
    NEEDED,
    REPORT,
    SETTING,
    check_settings,
)
from ursnav_torch.devices.robots.kinematics import Drive
from ursnav_torch.devices.robots.recent_orders import QueuedJogs, is_against
from ursnav_torch.devices.robots.reset_watch import ASK_STATE, MARK, ResetWatch, is_mark
from ursnav_torch.devices.robots.robot import MAX_QUEUED_S, Robot
from ursnav_torch.devices.robots.safety import STOPPED, Limits
from ursnav_torch.devices.serial_link import SerialLink
from ursnav_torch.devices.wire import FARTHEST_MM, device_number
from ursnav_torch.errors import DeviceNotConnectedError, DeviceProtocolError, DeviceTimeoutError
from ursnav_torch.geometry import Array

SOFT_RESET, STATUS, JOG_CANCEL = b"\x18", b"?", b"\x85"
SHORTEST_JOG_S = 0.01
#: While it is driven, the board is asked this often where it stands.
REPORT_S = 0.2
#: A board greets within the first after a reset; a greeting later than the second is of a reset that nobody asked for.
SETTLE_S, GREETED_S = 0.1, 1.0
#: GRBL reports thousandths of a mm and rounds to its own steps.
ROUNDING_MM = 0.005
#: A place in doubt by what two horizons move the slider at its cap is known well enough: give or take 1 mm.
DOUBT_MM = 2.0

logger = logging.getLogger(__name__)


class GrblRobot(Robot):
    """The robot on a GRBL board; straight and withdrawn when it is connected: that is where joints are zero.

    Args:
        port: device path or pyserial URL.
        drive: cables, drums and slider; GRBL's own steps per mm ($100..$102) must suit it.
        limits: joint limits and speed caps.
        horizon_s: longest motion queued on the board.
        watchdog_s: stop after so long without a command.
        deadline_s: how long the board may take to answer.
        boot_s: how long it may take to start; opening the port restarts many boards.

    Raises:
        InputError: a time is out of range (see `Robot`).
    """

    def __init__(
        self,
        port: str,
        drive: Drive | None = None,
        limits: Limits | None = None,
        horizon_s: float = 0.12,
        watchdog_s: float = 0.5,
        deadline_s: float = 0.4,
        boot_s: float = 3.0,
    ) -> None:
        super().__init__(limits or Limits(), horizon_s, watchdog_s, ROUNDING_MM)
        self.port, self.drive, self.deadline_s, self.boot_s = port, drive or Drive(), deadline_s, boot_s
        self._link: SerialLink | None = None
        self._settings: dict[int, float] = {}
        self._offset_mm = np.zeros(3)
        self._resets, self._queued = ResetWatch(ROUNDING_MM), QueuedJogs()
        self._axes_mm: Array | None = None  # where all that was sent will end; None: ask the board first
        self._reported_s = -math.inf  # when the board was asked where it stands, and said so
        self._reset_s = -math.inf  # when the board was last reset by hand
        self._busy_until_s = 0.0
        self._velocity = np.zeros(3)
        self._rates = JointRates()
        self._level = 0.0

    def set_light(self, level: float) -> float:
        """Dim the LED; GRBL refuses this while jogging (error 9), so motion pauses for it."""
        self._check_connected()
        speed = round(min(max(level, 0.0), 1.0) * self._settings[30])
        with self._exchange():
            self._level = speed / self._settings[30]
            if self.gate.state != STOPPED:
                self._halt()
                self._come_to_rest()
                self._ask(f"M3S{speed}" if speed else "M5")
        return self._level

    def _open(self) -> None:
        self._link = SerialLink(self.port, 115200)
        self._reset()
        self._settings = self._read_settings()
        check_settings(self._settings, self.limits, self.drive.segment.cable_radius_mm, self.horizon_s)
        state, axes = self._status(self.deadline_s)
        if state == "Alarm":
            self.gate.emergency_stop("the controller woke up in alarm")
        else:
            axes = self._mark()
        self._offset_mm, self._axes_mm = axes, np.zeros(3)
        self.place.set(self._axes_mm)

    def _close(self) -> None:
        self._dismiss_guardian()
        if self._link:
            self._link.close()
            self._link = None

    def _stops(self) -> dict[int, bytes]:
        fd = self._link_or_fail().fileno()
        return {} if fd is None else {fd: JOG_CANCEL}

    def _joints_of(self, axes: Array) -> Joints:
        return self.drive.joints(axes)

    def _axes_of(self, joints: Joints) -> Array:
        return self.drive.axes_mm(joints)

    def _joints_ahead(self) -> Joints:
        # A reset that went by unnoticed must not do so for long.
        if self._axes_mm is not None and time.monotonic() - self._reported_s > REPORT_S:
            self._read_axes(self.deadline_s)
            if not self.place.is_known:
                raise DeviceProtocolError(f"{self.port}: {self.place.why_lost}.")
        axes = self._axes_mm  # once: a stop by another thread may take it away at any moment
        return self.drive.joints(self._settle() if axes is None else axes)

    def _send(self, rates: JointRates) -> JointRates:
        now = time.monotonic()
        queued = max(0.0, self._busy_until_s - now)
        before = self._velocity if queued else np.zeros(3)
        velocity = self.drive.axes_mm(Joints(rates.bend_x_rad_s, rates.bend_y_rad_s, rates.insertion_mm_s))
        ramp = self._ramp_s(before, velocity)
        duration = self.horizon_s - queued - ramp
        if duration < SHORTEST_JOG_S:
            return self._rates if queued else JointRates()
        step = np.round(velocity * duration, 5)
        feed = round(float(np.linalg.norm(step)) / duration * 60, 2)
        if not step.any() or feed <= 0:
            return JointRates()
        words = "".join(f"{axis}{value:.5f}" for axis, value in zip("XYZ", step, strict=True) if value)
        axes = self._axes_mm
        ahead = self.place.axes if axes is None else axes
        back, forth = self._queued.unmade()
        dropped = ahead - np.where(step > 0, back, forth)
        if self._may_pass_a_limit(step, ahead, is_against(step, back, forth), dropped):
            self._reported_s = -math.inf  # ask first next time: it may have been made by then
            return JointRates()
        end = ahead + step
        self.place.moves(step)  # from anywhere: the board may have been reset since it last told its mark
        self._resets.sent(step)
        self._queued.add(step)
        self._jog(f"$J=G21G91{words}F{feed:.2f}")
        ends_s = max(time.monotonic(), self._busy_until_s) + duration + ramp  # it may have taken the jog only now
        self._queued.taken(ends_s)
        self._axes_mm = None if self._axes_mm is None else end
        self._busy_until_s, self._velocity = ends_s, velocity
        joints = self.drive.joints(step / duration)
        self._rates = JointRates(joints.bend_x_rad, joints.bend_y_rad, joints.insertion_mm)
        return self._rates

    def _jog(self, line: str) -> None:
        """Send a jog, and ask for the mark thereafter.

        Raises:
            DeviceProtocolError: it was refused, or the board was reset before.
        """
        if not self._resets.marked:
            self._ask(line)
            return
        self._heed(any(is_mark(news) for news in self._ask(f"{line}\n{ASK_STATE}", answers=2)))
        if not self.place.is_known:
            raise DeviceProtocolError(f"{self.port}: {self.place.why_lost}.")

    def _ramp_s(self, before: Array, after: Array) -> float:
        """Time that the board needs to change velocity, (3,) mm/s each; corners are taken through a standstill."""
        slowest = min(self._settings[n] for n in (120, 121, 122))
        v0, v1 = float(np.linalg.norm(before)), float(np.linalg.norm(after))
        straight = before @ after > 0.95 * v0 * v1
        return (abs(v1 - v0) if straight else v0 + v1) / slowest

    def _halt(self) -> None:
        self._axes_mm = None
        self._busy_until_s = 0.0
        self._write(JOG_CANCEL)

    def _kill(self) -> None:
        self._axes_mm = None
        self._busy_until_s = 0.0
        self._write_reset()

    def _recover(self) -> None:
        try:
            self._reset()
        except DeviceNotConnectedError:  # plugged in again, perhaps; who knows what happened meanwhile
            self._close()
            self._link = SerialLink(self.port, 115200)
            self._reset()
            self.place.lose("the board was unplugged")
        state, counts = self._status(self.deadline_s)
        self._doubt(counts)
        if state == "Alarm":
            self._ask("$X")
        counts = self._mark()
        self._doubt(counts)  # it may have been reset before it was marked
        at = counts - self._offset_mm
        self._axes_mm = at if self.place.report(at, at) else None
        if self._level:
            self._ask(f"M3S{round(self._level * self._settings[30])}")

    def _recount(self, axes: Array) -> None:
        if self.gate.state != STOPPED:  # else it is done when the stop is acknowledged
            self._come_to_rest()
            counts = self._mark()
        else:
            counts = self._status(self.deadline_s)[1]
        self._offset_mm = counts - axes
        self._axes_mm = axes

    def _mark(self) -> Array:
        """Set the mark that a reset wipes, see `reset_watch`; the board must stand still and be unlocked.

        Returns:
            The machine position (3,) thereafter.

        Raises:
            DeviceProtocolError: the board was reset meanwhile, by another thread's stop or by itself.
        """
        self._ask(MARK)
        seen = any(is_mark(line) for line in self._ask(ASK_STATE))
        if not seen:
            logger.warning("%s: the board does not tell its feed rate ($G); a reset may go unseen.", self.port)
        self._resets.set(seen)
        counts = self._status(self.deadline_s)[1]
        if self._resets.marked != seen or self._reset_s > -math.inf:
            raise DeviceProtocolError(f"{self.port}: the board was reset meanwhile; acknowledge once more.")
        return counts

    def _doubt(self, counts: Array) -> None:
        """While stopped and without a mark: lose the place where counts (3,) may be those of a board that was reset.

        Stopped where counts begin, before it has moved: then all it may have moved is said to be slack instead.
        """
        at = counts - self._offset_mm
        if not self.place.is_known or not self._resets.may_count_anew(counts) or self.place.is_certainly(at):
            self._resets.proved()
        elif self.place.fits(at) and self.place.width.max() <= DOUBT_MM:
            self.place.confirm()
            self._offset_mm = counts - self.place.axes
        else:
            self.place.lose("the controller may count from zero again; it may have been reset")

    def _read_axes(self, timeout_s: float) -> bool:
        state, axes = self._status(timeout_s)
        if state == "Alarm" and self.gate.state != STOPPED:
            raise DeviceProtocolError(f"{self.port}: GRBL is in alarm; look for the cause, then acknowledge.")
        if self._resets.wiped:
            self._doubt(axes)
        at, moving, ends = axes - self._offset_mm, state not in AT_REST, self._axes_mm
        if moving and ends is None:
            self.place.check(at)
        elif self.place.report(at, at):
            least, most = (at + way for way in self._queued.unmade())
            self.place.sent(least)
            self.place.sent(most)
            if self._axes_mm is not None and ends is not None:  # the guardian may have cancelled a jog
                self._axes_mm = np.clip(ends, least, most)
        return moving

    def _settle(self) -> Array:
        """Where the board came to rest after a halt, (3,): the new starting point.

        Raises:
            DeviceProtocolError: it does not come to rest, or the place is lost.
        """
        counts = self._come_to_rest()
        if self._resets.wiped:  # by a stop that came first
            self._doubt(counts)
        at = counts - self._offset_mm
        if not self.place.report(at, at):
            raise DeviceProtocolError(f"{self.port}: {self.place.why_lost}.")
        self._axes_mm = at
        return at

    def _come_to_rest(self) -> Array:
        """Wait until the board stands still; its machine position (3,)."""
        deadline = time.monotonic() + MAX_QUEUED_S
        while True:
            state, axes = self._status(self.deadline_s)
            if state == "Idle":
                return axes
            if state == "Alarm" or time.monotonic() > deadline:
                raise DeviceProtocolError(f"{self.port}: GRBL does not come to rest but is in state {state}.")
            time.sleep(0.005)

    def _reset(self) -> None:
        """Reset the board by hand and wait for its greeting.

        Raises:
            DeviceTimeoutError: it does not greet; the message tells what came instead.
            DeviceProtocolError: it is a board that cannot jog.
        """
        time.sleep(max(0.0, self._reset_s + SETTLE_S - time.monotonic()))  # an earlier reset's greeting must be in
        self._link_or_fail().discard_input()
        self._write_reset()
        deadline, heard = time.monotonic() + self.boot_s, list[str]()
        while not (greeting := GREETING.search(heard[-1] if heard else "")):
            try:
                heard = [*heard[-4:], self._line(deadline)]
            except DeviceTimeoutError as error:
                came = f"it sent {heard}, but no greeting of GRBL's" if heard else "is the board switched on?"
                raise DeviceTimeoutError(f"{self.port}: no answer to a reset in {self.boot_s} s; {came}.") from error
        self._reset_s = -math.inf
        if not (FLUIDNC in heard[-1] or greeting[1] in JOGGING):
            raise DeviceProtocolError(f"{self.port} greets with {heard[-1]!r}; GRBL 1.1 is needed for jogging.")
        self._axes_mm, self._busy_until_s = None, 0.0

    def _read_settings(self) -> dict[int, float]:
        settings = {}
        self._write(b"$$\n")
        deadline = time.monotonic() + 1.0
        while (line := self._checked_line(deadline)) != "ok":
            if (found := SETTING.fullmatch(line)) and int(found[1]) in NEEDED:
                settings[int(found[1])] = device_number(found[2], f"{self.port}: GRBL's setting ${found[1]}", 0.0, 1e9)
        if missing := NEEDED - settings.keys():
            raise DeviceProtocolError(f"{self.port}: GRBL did not tell its settings {sorted(missing)}.")
        return settings

    def _status(self, timeout_s: float) -> tuple[str, Array]:
        """Machine state and machine position (3,) in mm; where the board has lost its mark, the place is lost."""
        asked_s = time.monotonic()
        line = self._report(timeout_s)
        found = REPORT.fullmatch(line)
        words = found[2].split(",") if found else []
        if not found or len(words) < 3:
            raise DeviceProtocolError(f"{self.port}: unreadable status {line!r}; GRBL needs $10=1 (MPos).")
        self._reported_s = asked_s
        if found[1] in AT_REST:
            self._queued.clear()
        else:
            self._queued.reported(asked_s)
        what = f"{self.port}: a position in {line!r}"
        return found[1], np.array([device_number(word, what, -FARTHEST_MM, FARTHEST_MM) for word in words[:3]])

    def _report(self, timeout_s: float) -> str:
        """The line of a status report; a board that bears a mark is asked for it, too, and must tell it thereafter."""
        ends, marked = not self._resets.marked, None
        self._write(STATUS + (b"" if ends else f"{ASK_STATE}\n".encode()))
        deadline, report = time.monotonic() + timeout_s, ""
        while not report or not (ends or self._resets.wiped):  # another thread may reset the board meanwhile
            line = self._checked_line(deadline)
            report = line if line.startswith("<") else report
            marked = is_mark(line) if marked is None else marked
            ends = ends or (line == "ok" and marked is not None)
        self._heed(bool(marked))
        return report

    def _heed(self, marked: bool) -> None:
        """The board has told whether it still bears its mark, unless we have wiped it meanwhile."""
        if self._resets.marked and marked:
            self._resets.proved()
        elif self._resets.marked:
            self._resets.set(False)
            self.place.lose("the controller has lost its mark; it was reset")

    def _ask(self, command: str, answers: int = 1) -> list[str]:
        """Send lines and wait for an ``ok`` to each; the news that came before."""
        self._write(command.encode("ascii") + b"\n")
        deadline, news = time.monotonic() + self.deadline_s, list[str]()
        while answers:
            line = self._checked_line(deadline)
            if line == "ok":
                answers -= 1
            elif line.startswith(("[", "<", ">")):  # news, reports and start-up lines are no answers
                news.append(line)
            else:
                raise DeviceProtocolError(f"{self.port} answered {line!r} to {command!r}; expected 'ok'.")
        return news

    def _checked_line(self, deadline: float) -> str:
        """The next line, unless it is an error, an alarm or a greeting that nobody asked for."""
        line = self._line(deadline)
        kind, _, code = line.partition(":")
        if GREETING.search(line):
            if time.monotonic() - self._reset_s < GREETED_S:  # the answer to our own reset
                return f"[{line}]"
            self.place.lose("the controller was reset")
            raise DeviceProtocolError(f"{self.port}: the controller was reset in mid-session; check its power.")
        if self.gate.state == STOPPED and kind == "ALARM":
            return f"[{line}]"
        if kind == "error":
            raise DeviceProtocolError(f"{self.port}: GRBL error {code}: {ERRORS.get(code, 'see its list')}.")
        if kind == "ALARM":
            raise DeviceProtocolError(f"{self.port}: GRBL alarm {code}: {ALARMS.get(code, 'see its list')}.")
        return line

    def _line(self, deadline: float) -> str:
        """The next line that is not empty."""
        while True:
            remaining = deadline - time.monotonic()
            if remaining <= 0:
                raise DeviceTimeoutError(f"{self.port}: GRBL did not answer in time; is the board switched on?")
            text = self._link_or_fail().read_until(b"\n", remaining).decode("ascii", "replace").strip()
            if text:
                return text

    def _write_reset(self) -> None:
        self._resets.wipe()
        self._reset_s = time.monotonic()
        self._write(SOFT_RESET)

    def _write(self, data: bytes) -> None:
        self._link_or_fail().write(data)

    def _link_or_fail(self) -> SerialLink:
        if self._link is None:
            raise DeviceNotConnectedError(f"{self.port} is not open; plug the board in, then acknowledge or connect().")
        return self._link
