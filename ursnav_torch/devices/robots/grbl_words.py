"""What a GRBL 1.1 board says: reports, greetings, errors and alarms; and which of its settings suit us."""

import math
import re
from collections.abc import Mapping

from ursnav_torch.devices.robots.robot import MAX_QUEUED_S
from ursnav_torch.devices.robots.safety import Limits
from ursnav_torch.errors import InputError

ERRORS = {
    "2": "bad number format",
    "8": "not idle",
    "9": "locked out during alarm or jog",
    "11": "line too long",
    "15": "jog target beyond the machine's travel",
    "16": "invalid jog command",
    "20": "unsupported command",
    "22": "feed rate missing",
}
#: States in which nothing moves and nothing is queued.
AT_REST = ("Idle", "Alarm")
ALARMS = {"1": "hard limit hit", "2": "target beyond travel", "3": "reset while moving, position may be lost"}
#: State and machine position; boards with more than three axes tell those of all.
REPORT = re.compile(r"<(\w+)(?::\d+)?\|MPos:([-+.,\w ]+)(?:\|[^<>]*)?>")
#: Some boards explain a setting in brackets.
SETTING = re.compile(r"\$(\d+)=([-+.\w]+)\s*(?:\(.*\))?")
#: What must be told: inches, largest spindle speed, laser mode, speeds and accelerations of the three axes.
NEEDED = {13, 30, 32, 110, 111, 112, 120, 121, 122}
#: Greetings of GRBL, grblHAL and grbl-Mega-5X (1.2), wherever in the line; FluidNC counts its own versions.
GREETING = re.compile(r"Grbl(?:HAL)? (\d+\.\d+)", re.IGNORECASE)
JOGGING, FLUIDNC = ("1.1", "1.2"), "[FluidNC"


def check_settings(settings: Mapping[int, float], limits: Limits, cable_radius_mm: float, horizon_s: float) -> None:
    """Refuse a board that would move for longer than it is told, or measure in inches.

    Args:
        settings: by GRBL's numbers, those `NEEDED`.
        limits: speed caps.
        cable_radius_mm: from the shaft's middle to its cables.
        horizon_s: longest motion queued on the board.

    Raises:
        InputError: a setting does not suit; the message tells what to set.
    """
    for n in NEEDED - {13, 32}:
        if settings[n] <= 0:
            raise InputError(f"GRBL's setting ${n} must be positive, got {settings[n]:g}; see its list.")
    bend = limits.max_bend_rate_rad_s * cable_radius_mm
    for n, cap in enumerate((bend, bend, limits.max_insertion_rate_mm_s)):
        fastest, acceleration = settings[110 + n] / 60, settings[120 + n]
        if fastest < cap:
            raise InputError(
                f"GRBL allows axis {n} only {fastest:.2f} mm/s (${110 + n}), the speed cap is {cap:.2f} mm/s. "
                f"Raise ${110 + n} to {math.ceil(cap * 60)} or lower the cap."
            )
        if horizon_s + 2 * cap / acceleration > MAX_QUEUED_S:
            need = math.ceil(2 * cap / (MAX_QUEUED_S - horizon_s))
            raise InputError(
                f"GRBL's acceleration ${120 + n} is {acceleration:g} mm/s^2: axis {n} could not stop within "
                f"{MAX_QUEUED_S} s. Set it to {need} or more."
            )
    for n, what in ((13, "inches"), (32, "laser mode")):
        if settings[n]:
            raise InputError(f"GRBL is set to {what} (${n}={settings[n]:g}); set ${n}=0.")
