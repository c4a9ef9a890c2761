"""Input devices of the operator: a joystick through pygame-ce, the terminal's keyboard, a script."""

import os
import select
import sys
import time
from pathlib import Path
from typing import Any

from ursnav_torch.devices.base import Gamepad, OperatorInput
from ursnav_torch.devices.gamepads.mapping import GamepadMapping, MappedInput
from ursnav_torch.errors import DeviceNotConnectedError, InputError
from ursnav_torch.extras import import_extra
from ursnav_torch.tables import number, read_csv


class PygameGamepad(Gamepad):
    """A joystick through pygame-ce (extra ``gamepad``); needs no window.

    Args:
        mapping: which stick and button means what.
        index: which joystick, counted from 0.
    """

    def __init__(self, mapping: GamepadMapping | None = None, index: int = 0) -> None:
        super().__init__()
        self.index, self.mapping = index, mapping or GamepadMapping()
        self._mapped = MappedInput(self.mapping)
        self._pygame: Any = None
        self._stick: Any = None

    def read(self) -> OperatorInput:
        """The state right now.

        Raises:
            DeviceNotConnectedError: the joystick was unplugged.
        """
        self._check_connected()
        for event in self._pygame.event.get():
            if event.type == self._pygame.JOYDEVICEREMOVED and event.instance_id == self._stick.get_instance_id():
                raise DeviceNotConnectedError("The gamepad is gone; plug it in and connect again.")
        stick = self._stick
        axes = [stick.get_axis(n) for n in range(stick.get_numaxes())]
        for n in range(stick.get_numhats()):
            axes += stick.get_hat(n)
        return self._mapped(self._stamp(), axes, [stick.get_button(n) for n in range(stick.get_numbuttons())])

    def _open(self) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
        self._pygame = import_extra("pygame", "gamepad", "A gamepad")
        self._pygame.display.init()
        self._pygame.joystick.init()
        found = self._pygame.joystick.get_count()
        if self.index >= found:
            raise DeviceNotConnectedError(
                f"There are {found} gamepads, number {self.index} (from 0) is wanted. Plug it in, or use "
                "hardware/gamepad=keyboard."
            )
        self._stick = self._pygame.joystick.Joystick(self.index)
        self._mapped = MappedInput(self.mapping)  # what another stick, or this one before, was seen to do is past

    def _close(self) -> None:
        if self._pygame:
            self._pygame.joystick.quit()
            self._pygame.display.quit()
            self._pygame = self._stick = None


#: Keys that move while they are held (the terminal repeats them), and keys that act once.
MOVES = {"a": ("bend_x", -1.0), "d": ("bend_x", 1.0), "w": ("bend_y", -1.0), "s": ("bend_y", 1.0),
         "l": ("insertion", 1.0), "r": ("insertion", -1.0)}  # fmt: skip
ACTS = {"m": "arm", "c": "acknowledge", "p": "snapshot", "q": "quit", " ": "emergency_stop", "\x1b": "emergency_stop"}
KEYBOARD_HELP = "a d w s bend, l forward, r back, + - light, m arm, p snapshot, SPACE stop, c acknowledge, q quit"


class KeyboardGamepad(Gamepad):
    """The terminal's keys. A moving key is its own dead-man button: it counts as held while the terminal repeats it.

    Args:
        hold_s: how long a key counts as held after its last repeat.
        terminal: file descriptor of the terminal; standard input without it.
    """

    def __init__(self, hold_s: float = 0.3, terminal: int | None = None) -> None:
        super().__init__()
        self.hold_s = hold_s
        self._terminal = terminal
        self._saved: list[Any] | None = None
        self._held: dict[str, tuple[float, float]] = {}

    def read(self) -> OperatorInput:
        """The keys typed since the last call and those still held."""
        self._check_connected()
        now = time.monotonic()
        once: dict[str, Any] = {}
        for key in self._keys():
            if key in MOVES:
                name, value = MOVES[key]
                self._held[name] = (value, now + self.hold_s)
            elif key in ACTS:
                once[ACTS[key]] = True
            elif key in "+-":
                once["light_step"] = 1 if key == "+" else -1
        held: dict[str, Any] = {name: value for name, (value, until) in self._held.items() if until > now}
        if once.get("emergency_stop"):
            held, self._held = {}, {}
        return OperatorInput(self._stamp(), **held, dead_man=bool(held), **once)

    def _keys(self) -> str:
        fd, keys = self._fd(), b""
        while select.select([fd], [], [], 0)[0]:
            got = os.read(fd, 64)
            if not got:
                raise DeviceNotConnectedError("The keyboard's terminal was closed.")
            keys += got
        return keys.decode("utf8", "ignore").lower()

    def _fd(self) -> int:
        return sys.stdin.fileno() if self._terminal is None else self._terminal

    def _open(self) -> None:
        if not os.isatty(self._fd()):
            raise DeviceNotConnectedError("The keyboard needs a terminal; standard input is none.")
        try:
            import termios
            import tty
        except ImportError:
            raise DeviceNotConnectedError(
                "The keyboard as a gamepad needs a POSIX terminal, which this system has none of; use gamepad=pygame."
            ) from None
        self._saved = termios.tcgetattr(self._fd())
        tty.setcbreak(self._fd())
        if self._terminal is None:
            print(KEYBOARD_HELP, file=sys.stderr)

    def _close(self) -> None:
        if self._saved is not None:
            import termios

            termios.tcsetattr(self._fd(), termios.TCSADRAIN, self._saved)
            self._saved = None


RATES = ("bend_x", "bend_y", "insertion")
FLAGS = ("dead_man", "emergency_stop")
PRESSES = ("arm", "acknowledge", "snapshot", "quit")


class ScriptedGamepad(Gamepad):
    """Plays a CSV of ``t_s`` and any of the fields of `OperatorInput`; a row holds until the next one's time.

    Rates and held buttons stay for the row's time, pressed buttons and ``light_step`` count once.

    Args:
        path: the script.

    Raises:
        InputError: the script cannot be used.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self.path = Path(path)
        rows = read_csv(self.path, ("t_s",), "gamepad script")
        if unknown := sorted(rows[0].keys() - {"t_s", "light_step", *RATES, *FLAGS, *PRESSES}):
            raise InputError(f"{self.path}: columns {unknown} mean nothing to a gamepad script.")
        self._rows = [
            {name: number(row, name) for name, text in row.items() if text.strip()} | {"t_s": number(row, "t_s")}
            for row in rows
        ]
        self._next, self._start_s = 0, 0.0

    def read(self) -> OperatorInput:
        """The row of this moment."""
        self._check_connected()
        now = time.monotonic() - self._start_s
        pressed: dict[str, bool] = {}
        light = 0
        while self._next < len(self._rows) and self._rows[self._next]["t_s"] <= now:
            row = self._rows[self._next]
            pressed |= {name: True for name in PRESSES if row.get(name)}
            light += int(row.get("light_step", 0))
            self._next += 1
        present = self._rows[self._next - 1] if self._next else {}
        rates: dict[str, Any] = {name: min(max(present.get(name, 0.0), -1.0), 1.0) for name in RATES}
        flags: dict[str, Any] = {name: bool(present.get(name, 0)) for name in FLAGS}
        return OperatorInput(self._stamp(), **rates, **flags, **pressed, light_step=min(max(light, -1), 1))

    def _open(self) -> None:
        self._next, self._start_s = 0, time.monotonic()

    def _close(self) -> None: ...
