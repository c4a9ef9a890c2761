"""The operator's input devices: mapping, dead zone, keyboard, script, joystick."""

import math
import os
import pty
import sys
import time
import types

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ursnav_torch.devices import GamepadMapping, KeyboardGamepad, PygameGamepad, ScriptedGamepad, Stamp
from ursnav_torch.devices.gamepads.mapping import MappedInput, past_dead_zone
from ursnav_torch.errors import DeviceNotConnectedError, InputError, MissingExtraError

NOW = Stamp(0, 0.0, 0.0)


def pressed(*numbers):
    return [int(n in numbers) for n in range(11)]


def rested(mapping=None):
    """Hands off at first, then a stick that moves a little: axes that say so may drive."""
    read = MappedInput(mapping or GamepadMapping())
    read(NOW, [0.05] * 8, pressed())
    return read


TRIGGER = GamepadMapping(axes={"insertion": (2, 1.0)})


def test_a_trigger_that_rests_at_minus_one_cannot_drive():
    read = MappedInput(TRIGGER)
    released, dead_man = [0.0, 0.0, -1.0], pressed(0)
    assert read(NOW, released, pressed()).insertion == 0.0
    for value in (-1.0, -0.5, 0.0, 0.5, 1.0, 0.0, -1.0):
        assert read(NOW, [0.0, 0.0, value], dead_man).insertion == 0.0


def test_a_trigger_of_which_the_driver_says_zero_until_it_moves_cannot_drive_either():
    read = MappedInput(TRIGGER)
    assert read(NOW, [0.0, 0.0, 0.0], pressed()).insertion == 0.0
    for value in (-0.9, -0.2, 0.6, -1.0):
        assert read(NOW, [0.0, 0.0, value], pressed(0)).insertion == 0.0


def test_a_stick_held_over_when_the_dead_man_goes_down_waits_until_it_was_let_go():
    read = rested(TRIGGER)
    assert read(NOW, [0.0, 0.0, 0.9], pressed()).insertion == 0.0
    assert read(NOW, [0.0, 0.0, 0.9], pressed(0)).insertion == 0.0
    assert read(NOW, [0.0, 0.0, 0.0], pressed(0)).insertion == 0.0
    read(NOW, [0.0, 0.0, 0.0], pressed())
    assert read(NOW, [0.0, 0.0, 0.9], pressed(0)).insertion > 0.8


def test_an_axis_that_was_not_reported_drives_again_only_after_it_was_seen_at_rest():
    read, released, held = rested(TRIGGER), [0.0, 0.0, -1.0], pressed(0)
    read(NOW, released, pressed())
    assert read(NOW, released, held).insertion == 0.0
    read(NOW, [], [])
    assert read(NOW, released, held).insertion == 0.0  # silence is not rest
    read(NOW, [0.0, 0.0, 0.0], pressed())
    assert read(NOW, [0.0, 0.0, 0.05], held).insertion == 0.0
    assert read(NOW, [0.0, 0.0, 0.9], held).insertion > 0.8


def test_after_silence_a_driver_may_say_zero_of_what_has_not_moved_once_more():
    read = rested(TRIGGER)
    read(NOW, [], [])
    read(NOW, [0.0, 0.0, 0.0], pressed())
    assert read(NOW, [0.0, 0.0, -0.98], pressed(0)).insertion == 0.0


def test_convention_sticks_and_shoulder_buttons_do_what_the_thesis_says():
    read = rested()
    hands = read(NOW, [1.0, -1.0], pressed(0, 4))
    assert (hands.bend_x, hands.bend_y, hands.insertion, hands.dead_man) == (1.0, -1.0, 1.0, True)
    assert read(NOW, [0, 0], pressed(5)).insertion == -1.0
    assert read(NOW, [0, 0], pressed(4, 5)).insertion == 0.0


def test_buttons_count_once_but_the_stop_as_long_as_it_is_held():
    read = MappedInput(GamepadMapping())
    held = read(NOW, [], pressed(1, 2, 7))
    assert not (held.snapshot or held.arm) and held.emergency_stop, "held from before, but for the stop not pressed"
    read(NOW, [], pressed())
    first, second = read(NOW, [], pressed(1, 2, 7)), read(NOW, [], pressed(1, 2, 7))
    assert (first.snapshot, first.arm, first.emergency_stop) == (True, True, True)
    assert (second.snapshot, second.arm, second.emergency_stop) == (False, False, True)
    assert read(NOW, [], pressed()).emergency_stop is False


def test_the_hat_dims_one_step_a_press():
    read = MappedInput(GamepadMapping())
    steps = [read(NOW, [0] * 7 + [v], []).light_step for v in (0, 1, 1, 0, -1)]
    assert steps == [0, 1, 0, 0, -1]


@given(st.floats(-2, 2), st.floats(0, 0.9))
def test_the_dead_zone_is_continuous_odd_and_reaches_full_deflection(value, zone):
    out = past_dead_zone(value, zone)
    assert -1 <= out <= 1 and past_dead_zone(-value, zone) == -out
    assert out == 0 if abs(value) <= zone else abs(out) > 0
    assert past_dead_zone(1.0, zone) == 1.0
    assert past_dead_zone(zone + 1e-9, zone) < 1e-6


def test_a_stick_that_reports_nonsense_moves_nothing():
    assert past_dead_zone(math.nan, 0.1) == 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"buttons": {"dead_man": 0, "emergency_stop": 1, "fire": 2}}, "fire"),
        ({"buttons": {"dead_man": 0}}, "emergency_stop"),
        ({"axes": {"roll": (0, 1)}}, "roll"),
        ({"dead_zone": 1.0}, "dead_zone"),
    ],
)
def test_mappings_with_mistakes_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        GamepadMapping(**settings)


def test_keys_move_while_they_repeat_and_act_once():
    master, slave = pty.openpty()
    try:
        with KeyboardGamepad(hold_s=0.1, terminal=slave) as keyboard:
            os.write(master, b"dlp+")
            time.sleep(0.02)
            hands = keyboard.read()
            assert (hands.bend_x, hands.insertion, hands.dead_man) == (1.0, 1.0, True)
            assert (hands.snapshot, hands.light_step) == (True, 1)
            held = keyboard.read()
            assert (held.bend_x, held.snapshot, held.light_step) == (1.0, False, 0)
            time.sleep(0.12)
            assert keyboard.read().dead_man is False
            os.write(master, b"d ")
            time.sleep(0.02)
            stopped = keyboard.read()
            assert stopped.emergency_stop and not stopped.dead_man and stopped.bend_x == 0
    finally:
        os.close(master)
        os.close(slave)


def test_a_keyboard_needs_a_terminal():
    read_end, write_end = os.pipe()
    with pytest.raises(DeviceNotConnectedError, match="needs a terminal"):
        KeyboardGamepad(terminal=read_end).connect()
    os.close(read_end)
    os.close(write_end)


def test_a_script_holds_rates_and_presses_once(tmp_path):
    path = tmp_path / "script.csv"
    path.write_text("t_s,bend_x,insertion,dead_man,arm,snapshot\n0,0.5,,1,1,\n0.1,,1,1,,1\n0.2,,,,,\n")
    with ScriptedGamepad(path) as script:
        first, again = script.read(), script.read()
        time.sleep(0.12)
        second, then = script.read(), script.read()
        time.sleep(0.12)
        rest = script.read()
    assert (first.bend_x, first.dead_man, first.arm, again.arm, again.bend_x) == (0.5, True, True, False, 0.5)
    assert (second.insertion, second.bend_x, second.snapshot, then.snapshot) == (1.0, 0.0, True, False)
    assert (rest.insertion, rest.dead_man) == (0.0, False)
    path.write_text("t_s,bendx\n0,1\n")
    with pytest.raises(InputError, match="bendx"):
        ScriptedGamepad(path)


class Joystick:
    def __init__(self, index):
        self.axes, self.buttons, self.hat = [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0] * 9, (0, 1)

    def get_instance_id(self):
        return 3

    def get_numaxes(self):
        return len(self.axes)

    def get_axis(self, n):
        return self.axes[n]

    def get_numhats(self):
        return 1

    def get_hat(self, n):
        return self.hat

    def get_numbuttons(self):
        return len(self.buttons)

    def get_button(self, n):
        return self.buttons[n]


@pytest.fixture
def events(monkeypatch):
    """What happens to the one joystick of a pygame that is made up."""
    events = []
    pygame = types.ModuleType("pygame")
    pygame.JOYDEVICEREMOVED = 1542
    pygame.display = types.SimpleNamespace(init=lambda: None, quit=lambda: None)
    pygame.joystick = types.SimpleNamespace(
        init=lambda: None, quit=lambda: None, get_count=lambda: 1, Joystick=Joystick
    )
    pygame.event = types.SimpleNamespace(get=lambda: events)
    monkeypatch.setitem(sys.modules, "pygame", pygame)
    return events


def test_a_joystick_is_read_and_its_unplugging_noticed(events):
    with PygameGamepad() as gamepad:
        stick = gamepad._stick
        stick.axes[0] = 0.05
        gamepad.read()
        stick.axes[0], stick.hat = 0.5, (0, 0)
        gamepad.read()
        assert gamepad.read().bend_x == 0.0  # moved while the dead man's button was not held
        stick.axes[0] = 0.05
        gamepad.read()
        stick.axes[0], stick.hat = 0.5, (0, 1)
        stick.buttons[0] = 1
        hands = gamepad.read()
        assert hands.bend_x == pytest.approx((0.5 - 0.08) / 0.92) and hands.light_step == 1  # the hat is axis 7
        events.append(types.SimpleNamespace(type=1542, instance_id=3))
        with pytest.raises(DeviceNotConnectedError, match="gamepad is gone"):
            gamepad.read()
    with pytest.raises(DeviceNotConnectedError, match="hardware/gamepad=keyboard"):
        PygameGamepad(index=1).connect()


def test_a_trigger_of_a_joystick_that_was_plugged_in_again_is_not_known_from_before(events):
    gamepad = PygameGamepad(TRIGGER)
    with gamepad:
        gamepad._stick.axes[2] = 0.05
        gamepad.read()
        gamepad._stick.axes[2], gamepad._stick.buttons[0] = 0.98, 1
        assert gamepad.read().insertion > 0.9
    with gamepad:
        gamepad.read()  # its driver says 0 until it moves
        gamepad._stick.axes[2], gamepad._stick.buttons[0] = -0.98, 1
        assert gamepad.read().insertion == 0.0


def test_the_real_pygame_says_that_nothing_is_plugged_in():
    pygame = pytest.importorskip("pygame", reason="needs the extra gamepad")
    gamepad = PygameGamepad(index=9)
    with pytest.raises(DeviceNotConnectedError, match="number 9"):
        gamepad.connect()
    assert not pygame.joystick.get_init()


def test_without_the_extra_the_message_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(MissingExtraError, match=r"ursnav-torch\[gamepad\]"):
        PygameGamepad().connect()
