"""What a program that speaks for the browser sends is taken only inside the bounds of the page's fields."""

import time

import msgspec
import pytest

from ursnav_torch.page import start_server
from ursnav_torch.page.bounds import MOST_BYTES, Bounds, is_within
from ursnav_torch.page.server import stop_server

viser = pytest.importorskip("viser")


@pytest.fixture(scope="module")
def server():
    running = start_server("127.0.0.1", 0, "bounded")
    yield running
    stop_server(running)


@pytest.fixture(scope="module")
def fields(server):
    """Fields of every kind that our pages have."""
    gui = server.gui
    return {
        "number": gui.add_number("n", 40, min=1, max=1000, step=1),
        "slider": gui.add_slider("s", 0.0, 10.0, 0.1, 0.0),
        "text": gui.add_text("t", ""),
        "choice": gui.add_dropdown("d", ["A", "B"]),
        "check": gui.add_checkbox("c", False),
        "group": gui.add_button_group("g", ["X", "Y"]),
    }


@pytest.fixture
def speak(server):
    """``speak(message, ...)`` sends messages as the page would."""
    from websockets.sync.client import connect

    port = server.get_port()
    url, origin = f"ws://127.0.0.1:{port}", f"http://127.0.0.1:{port}"
    with connect(url, origin=origin, subprotocols=[f"viser-v{viser.__version__}"]) as connection:
        yield lambda *messages: [connection.send(msgspec.msgpack.encode(m)) for m in messages]


def update(handle, value, **changed):
    return {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": {"value": value}} | changed


WRONG = [
    *(("number", value) for value in (-5, 1e9, "9", True, None)),
    *(("slider", value) for value in (11.0, float("nan"))),
    *(("text", value) for value in ("x" * 201, ["a"])),
    *(("choice", "C"), ("check", 1), ("group", "Z")),
]
RIGHT = [("number", 7), ("slider", 2.5), ("text", "a calyx"), ("choice", "B"), ("check", True), ("group", "Y")]


def test_fields_keep_to_their_bounds_whatever_is_sent(fields, speak):
    before = {name: handle.value for name, handle in fields.items()}
    speak(*(update(fields[name], value) for name, value in WRONG))
    speak(
        update(fields["number"], 5, updates={"max": 1e9}), update(fields["number"], 5, updates={"value": 5, "min": -9})
    )
    speak(update(fields["text"], "the last"))
    until = time.monotonic() + 20
    while fields["text"].value != "the last" and time.monotonic() < until:
        time.sleep(0.02)
    assert {name: handle.value for name, handle in fields.items()} == before | {"text": "the last"}
    assert fields["number"].max == 1000 and fields["number"].min == 1
    speak(*(update(fields[name], value) for name, value in RIGHT))
    while fields["group"].value != "Y" and time.monotonic() < until:
        time.sleep(0.02)
    assert [(name, fields[name].value) for name, _ in RIGHT] == RIGHT


def test_messages_of_other_kinds_sizes_and_depths_are_passed_over(server):
    bounds = Bounds(server)

    def accepted(data):
        return bounds.accept(msgspec.msgpack.encode(data))

    assert accepted({"type": "CommandTriggerMessage", "uuid": "x"})
    assert accepted({"type": "SceneNodeClickMessage", "ray_origin": [0, 1, 2.5], "ray_direction": [0, 0, 1]})
    deep = "x"
    for _ in range(9):
        deep = [deep]
    for data in (
        {"type": "FileTransferStartUpload", "source_component_uuid": "x"},
        {"type": "RunJavascriptMessage", "source": "x"},
        {"type": ["CommandTriggerMessage"]},
        {"type": "CommandTriggerMessage", "uuid": deep},
        {"type": "CommandTriggerMessage", "uuid": b"bytes"},
        {"type": "ViewerCameraMessage", "fov": float("inf")},
        {"type": "ViewerCameraMessage", "fov": 1e300},
        {"type": "SceneNodeClickMessage", "ray_origin": [0, 1]},
        {"type": "SceneNodeClickMessage", "ray_origin": "abc"},
        {"type": "CommandTriggerMessage", "uuid": "x", "more": [1] * 65},
        [],
        7,
    ):
        assert not accepted(data), data
    for raw in ("text", b"", b"\xc1", b"\x81" * 5000, bytes(MOST_BYTES + 1)):
        assert not bounds.accept(raw)
    assert bounds.refused == 17


def test_a_field_of_an_unknown_kind_takes_nothing():
    assert not is_within((1, 2), (0, 0), object())
