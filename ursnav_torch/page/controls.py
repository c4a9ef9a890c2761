"""What the page's buttons and keys do: stop and drive a robot, play a record."""

from typing import TYPE_CHECKING, Any

from ursnav_torch.navigation import NavigationState
from ursnav_torch.page.server import on_choice, on_press
from ursnav_torch.page.words import robot_html
from ursnav_torch.session import Console, Player, SessionControls

if TYPE_CHECKING:
    import viser

#: Keys of the moves; the viewer itself uses W, A, S, D, Q, E and the arrows to look around.
KEYS = {"forward": "I", "back": "K", "left": "J", "right": "L", "up": "U", "down": "M"}
HOLD_HZ = 10.0


def add_stop(server: "viser.ViserServer", console: Console) -> None:
    """The button and the key that stop the robot; put first, so that they never move."""
    stop = server.gui.add_button("STOP (space)", color="red", hint="Stops the robot at once, until acknowledged.")
    on_press(stop)(console.emergency_stop)
    server.gui.add_command("Stop the robot", hotkey="space").on_trigger(lambda _event: console.emergency_stop())


class RobotControls:
    """Acknowledge a stop, and where it is allowed arm and drive.

    Args:
        server: the page's.
        console: the hands.
    """

    def __init__(self, server: "viser.ViserServer", console: Console) -> None:
        self.console, gui = console, server.gui
        self._text = gui.add_html("")
        self._flying: Any = None
        on_press(gui.add_button("Acknowledge the stop"))(console.acknowledge)
        if console.may_drive:
            on_press(gui.add_button("Arm"))(console.arm)
            if console.has_pilot:
                self._flying = gui.add_checkbox("The pilot flies", not console.by_hand)
                on_choice(self._flying, console.give_to_pilot)
            for move, key in KEYS.items():
                _add_move(gui, console, move, key)
            on_press(gui.add_button("Brighter", hint="A stop can put the light out; this brings it back."))(
                lambda: console.brighten(1)
            )
            on_press(gui.add_button("Darker"))(lambda: console.brighten(-1))

    def show(self, state: NavigationState) -> None:
        """Say how the robot stands, and who flies."""
        self._text.content = robot_html(state)
        if self._flying is not None and self._flying.value == self.console.by_hand:
            self._flying.value = not self.console.by_hand


def _add_move(gui: Any, console: Console, move: str, key: str) -> None:
    button = gui.add_button(f"{move} ({key})", hint="Hold to move.")
    button.on_hold(lambda _event: console.drive(move), callback_hz=HOLD_HZ)
    on_press(button)(lambda: console.drive(move))
    gui.add_command(f"Move {move}", hotkey=key).on_trigger(lambda _event: console.drive(move))


class ReplayControls:
    """Play, pause, step and seek.

    Args:
        server: the page's.
        player: the record.
    """

    def __init__(self, server: "viser.ViserServer", player: Player) -> None:
        self.player, gui = player, server.gui
        self._play = gui.add_button("Pause", icon=None)
        on_press(self._play)(lambda: player.pause() if player.playing else player.play())
        on_press(gui.add_button("One picture on"))(player.step)
        end = max(round(player.duration_s, 1), 0.1)
        self._at = gui.add_slider("time, s", 0.0, end, 0.1, 0.0)
        on_choice(self._at, player.seek)

    def show(self) -> None:
        """Bring button and slider up to date."""
        label = "Pause" if self.player.playing else "Play"
        if self._play.label != label:
            self._play.label = label
        at = min(round(self.player.position_s, 1), self._at.max)
        if abs(self._at.value - at) >= 0.1:
            self._at.value = at


def add_end(server: "viser.ViserServer", controls: SessionControls) -> None:
    """The button that ends the session."""
    on_press(server.gui.add_button("End the session"))(controls.stop)
