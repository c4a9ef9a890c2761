"""A page is sent the newest of a kind, and only when it has shown the last: nothing waits in a connection's buffers."""

import asyncio
import contextlib
import json
import threading
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from ursnav_torch.devices import Frame, Stamp
from ursnav_torch.navigation import NavigationState, Navigator
from ursnav_torch.page import LivePage, PageServer
from ursnav_torch.page.commands import MOST_BYTES, Command, does_overtake, shown_kind
from ursnav_torch.page.conversation import WAITING
from ursnav_torch.page.mailbox import Mailbox, Reader
from ursnav_torch.session import SessionControls
from ursnav_torch.tracking.tracker import Tracker

pytest.importorskip("uvicorn")
client = pytest.importorskip("websockets.sync.client")


def connected(server):
    """A page's connection, as a context."""
    return client.connect(server.url.replace("http", "ws") + "/live", origin=server.url, open_timeout=60)


@pytest.fixture
def served():
    """Serve a page with some commands, and what connects to it."""
    with contextlib.ExitStack() as ends:

        def serve(**commands):
            server = PageServer("live.html", commands, {}, ("127.0.0.1", 0))
            ends.callback(server.stop)
            return server, ends.enter_context(connected(server))

        yield serve


def next_of(socket):
    """Kind and number of the next message."""
    data = socket.recv(timeout=60)
    found = json.loads(data if isinstance(data, str) else data.split(b"\n", 1)[0])
    return found["kind"], found.get("number")


def show(socket, kind):
    socket.send(json.dumps({"shown": kind}))


def publish_many(server, first, last):
    """States and pictures larger than any buffer in all, and then something else."""
    for number in range(first, last):
        server.publish("state", number=number)
        server.publish_picture("scope", bytes(40_000), number=number)
    server.publish(f"end {last}")


def test_a_page_that_never_says_it_has_shown_anything_is_sent_one_state_and_one_picture(served):
    server, socket = served()
    server.publish("state", number=0)
    assert next_of(socket) == ("state", 0)
    server.publish_picture("scope", b"", number=0)
    assert next_of(socket) == ("scope", 0)
    publish_many(server, 1, 300)
    assert next_of(socket) == ("end 300", None), "states and pictures were sent that nobody had shown"
    assert not server.wanted("scope") and server.wanted("virtual")


def test_a_page_that_opens_later_is_told_no_state_older_than_the_one_beside_the_picture(served):
    server, first = served()
    server.publish("state", number=1)
    server.publish_picture("scope", b"", "state", number=2)
    with connected(server) as later:
        server.publish("end")
        assert [next_of(later) for _ in range(2)] == [("scope", 2), ("end", None)]
        server.publish("state", number=3)
        assert next_of(later) == ("state", 3)
    assert next_of(first)[0] in ("state", "scope")


def test_a_slow_page_gets_the_newest(served):
    server, socket = served()
    publish_many(server, 0, 1)
    assert {next_of(socket)[0] for _ in range(3)} == {"state", "scope", "end 1"}
    publish_many(server, 1, 300)
    assert next_of(socket) == ("end 300", None)
    show(socket, "scope")
    assert next_of(socket) == ("scope", 299), "the newest picture, and no state before the last is shown"
    show(socket, "state")
    assert next_of(socket) == ("state", 299)
    show(socket, "scope")
    server.publish_picture("scope", b"", number=300)
    assert next_of(socket) == ("scope", 300)


def test_a_page_that_says_nothing_slows_no_other(served):
    server, silent = served()
    with connected(server) as quick:
        for number in range(20):
            server.publish("state", number=number)
            assert next_of(quick) == ("state", number)
            show(quick, "state")
    assert next_of(silent)[0] == "state", "whichever was the newest when it was heard"
    server.publish("end")
    assert next_of(silent) == ("end", None), "and no other before that is shown"


def test_states_go_on_while_a_command_takes_its_time(served):
    begun, may_end = threading.Event(), threading.Event()
    server, socket = served(slow=Command(lambda: (begun.set(), may_end.wait(60))), quick=Command(lambda: None))
    socket.send('{"do": "slow"}')
    assert begun.wait(60)
    for number in range(5):
        server.publish("state", number=number)
        assert next_of(socket) == ("state", number)
        show(socket, "state")
    may_end.set()


def test_commands_are_done_in_their_order(served):
    done, last = [], threading.Event()
    commands = {"add": Command(done.append, int), "last": Command(last.set)}
    _, socket = served(**commands)
    for number in range(120):
        socket.send(json.dumps({"do": "add", "value": number}))
    socket.send('{"do": "last"}')
    assert last.wait(60) and done == list(range(120))


def test_a_mailbox_holds_one_message_of_each_kind_whoever_reads():
    async def filled():
        mailbox, reader, got = Mailbox(), Reader(), []
        for number in range(1000):
            mailbox.put("state", str(number))
            mailbox.put("scope", str(number))
        reading = asyncio.create_task(collect(mailbox, reader, got))
        await asyncio.sleep(0)
        assert sorted(got) == ["999", "999"] and len(mailbox._newest) == 2
        assert reader.under_way == {"state", "scope"} and mailbox.readers == 1
        reader.shown("state")
        reader.shown("nothing that was ever sent")
        await asyncio.sleep(0)
        assert len(got) == 2, "the same is not sent twice"
        mailbox.close()
        await reading
        assert mailbox.readers == 0

    async def collect(mailbox, reader, got):
        async for message in mailbox.read(reader):
            got.append(message)

    asyncio.run(filled())


@pytest.mark.parametrize(
    ("raw", "kind"),
    [
        ('{"shown":"scope"}', "scope"),
        ('{"shown": "a b"}', "a b"),
        ('{"shown":7}', None),
        ('{"shown":', None),
        ('{"do":"stop"}', None),
        ('{"shown":"' + "x" * MOST_BYTES + '"}', None),
        ("", None),
    ],
)
def test_what_a_page_has_shown_is_told_from_its_commands(raw, kind):
    assert shown_kind(raw) == kind


@pytest.fixture
def shown(vid, monkeypatch):
    """A live page whose clock and server are the test's own: it, the clock, the server."""
    page = LivePage(Navigator(Tracker(vid)), SessionControls(lambda: None), port=0)
    page._end.set()  # the test alone shows states
    page._thread.join()
    clock, server = [1000.0], Mock()
    monkeypatch.setattr("ursnav_torch.page.live.time", SimpleNamespace(monotonic=lambda: clock[0]))
    monkeypatch.setattr(page, "server", server)
    yield page, clock, server
    monkeypatch.undo()
    page.close()


def picture_state(number, effort=0):
    """A state with a picture of its own."""
    frame = Frame(Stamp(number, number / 15, number / 15), np.zeros((96, 96), np.uint8))
    return NavigationState(version=number, effort=effort, frame=frame)


def test_no_picture_is_encoded_that_no_page_waits_for_and_the_newest_is_when_one_does(shown):
    page, clock, server = shown
    for number, wanted in ((0, True), (1, False), (2, False), (3, True)):
        server.wanted.return_value = wanted
        page._show_state(picture_state(number))
        clock[0] += 1.0
    sent = [call.kwargs["state"]["version"] for call in server.publish_picture.call_args_list]
    assert sent == [0, 3] and not server.publish.called


@pytest.mark.parametrize(("effort", "at_least", "at_most"), [(0, 14.9, 15.1), (2, 12.3, 12.6)])
def test_how_many_pictures_of_a_camera_are_sent(shown, effort, at_least, at_most):
    """Between two pictures of a camera there is no third: a pace that starts anew with each would halve its rate."""
    page, clock, server = shown
    for number in range(15 * 60):
        page._show_state(picture_state(number, effort))
        clock[0] += 1 / 15
    assert at_least <= server.publish_picture.call_count / 60 <= at_most


def test_words_without_a_new_picture_are_sent_by_themselves_and_seldom(shown):
    page, clock, server = shown
    still = picture_state(0)
    for number in range(300):
        page._show_state(replace(still, version=number, notice=str(number)))
        clock[0] += 0.02
    sent = [call.kwargs["version"] for call in server.publish.call_args_list if call.args[0] == "state"]
    assert server.publish_picture.call_count == 1 and len(sent) == pytest.approx(6 / 0.15, abs=2)


def test_figures_stay_long_enough_to_be_read(shown):
    page, clock, server = shown
    for number in range(60):
        page._show_state(
            replace(picture_state(number), latency=replace(NavigationState().latency, total_s=number / 100))
        )
        clock[0] += 1 / 15
    said = [call.kwargs["state"]["latency"] for call in server.publish_picture.call_args_list]
    assert len(set(said)) == pytest.approx(8, abs=1)


def test_where_a_record_is_played_is_sent_when_it_changes(shown):
    page, _, server = shown
    player = SimpleNamespace(playing=True, position_s=1.0)
    page.controls = replace(page.controls, player=player)
    for at_s in (1.0, 1.01, 1.02, 1.2, 1.2):
        player.position_s = at_s
        page._show_state(NavigationState(version=-1))
    sent = [call.kwargs["at_s"] for call in server.publish.call_args_list if call.args[0] == "replay"]
    assert sent == [1.0, 1.2]


def ask(socket, name):
    socket.send(json.dumps({"do": name}))


def test_a_stop_overtakes_what_waits_and_makes_it_forgotten(served):
    """Acknowledging and arming that were asked for before a stop do not follow it."""
    begun, go_on, stopped, done = threading.Event(), threading.Event(), threading.Event(), []
    server, socket = served(
        slow=Command(lambda: (begun.set(), go_on.wait(60))),
        arm=Command(lambda: done.append("arm")),
        last=Command(lambda: server.publish("last")),
        stop=Command(stopped.set, overtakes=True),
    )
    ask(socket, "slow")
    assert begun.wait(60)
    for _ in range(3):
        ask(socket, "arm")
    ask(socket, "stop")
    assert stopped.wait(60), "it waits for no other"
    ask(socket, "last")
    go_on.set()
    assert next_of(socket)[0] == "last"
    assert done == []


def test_a_page_that_asks_for_too_much_is_told_and_still_heard(served):
    begun, go_on, stopped = threading.Event(), threading.Event(), threading.Event()
    _, socket = served(slow=Command(lambda: (begun.set(), go_on.wait(60))), stop=Command(stopped.set, overtakes=True))
    ask(socket, "slow")
    assert begun.wait(60)
    for _ in range(WAITING + 1):
        ask(socket, "slow")
    try:
        assert next_of(socket)[0] == "notice"
        ask(socket, "stop")
        assert stopped.wait(60)
    finally:
        go_on.set()


@pytest.mark.parametrize("raw", ['{"do": "other"}', '{"do": 3}', "[]", "x", "{", "[" * 5000, '{"do": "none"}'])
def test_what_is_no_stop_overtakes_nothing(raw):
    commands = {"stop": Command(print, overtakes=True), "other": Command(print)}
    assert does_overtake('{"do": "stop"}', commands) and not does_overtake(raw, commands)


def test_the_live_page_stops_at_once():
    page = object.__new__(LivePage)
    page._vid = SimpleNamespace(kidney=SimpleNamespace(calyces=()))
    page.controls = SimpleNamespace(console=Mock(has_robot=True), player=None, stop=None)
    overtaking = {name for name, command in page._commands().items() if command.overtakes}
    assert overtaking == {"stop"}
