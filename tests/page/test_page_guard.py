"""Who may talk to the page's server, asked by real handshakes."""

import http.client

import pytest

from ursnav_torch.page import PageServer
from ursnav_torch.page.guard import why_refused

pytest.importorskip("uvicorn")


@pytest.fixture(scope="module")
def port():
    server = PageServer("live.html", {}, {}, ("127.0.0.1", 0))
    yield server.port
    server.stop()


def status(port, host, origin=None, upgrade=False):
    """What the server answers a request with these headers, and the first line of its text."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest("GET", "/live" if upgrade else "/", skip_host=True)
    headers = {"Host": host, "Origin": origin}
    if upgrade:
        headers |= {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
                    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}  # fmt: skip
    for name, value in headers.items():
        if value is not None:
            connection.putheader(name, value.replace("PORT", str(port)))
    connection.endheaders()
    answer = connection.getresponse()
    found = answer.status
    connection.close()
    return found


@pytest.mark.parametrize("host", ["127.0.0.1:PORT", "localhost:PORT", "[::1]:PORT"])
def test_own_pages_are_let_in(port, host):
    assert status(port, host, None) == status(port, host, f"http://{host}") == 200
    assert status(port, host, f"http://{host}", upgrade=True) == 101


def test_programs_without_an_origin_are_let_in_only_where_that_is_asked_for(port):
    assert status(port, "127.0.0.1:PORT", None, upgrade=True) == 403
    server = PageServer("live.html", {}, {}, ("127.0.0.1", 0), programs=True)
    try:
        assert status(server.port, "127.0.0.1:PORT", None, upgrade=True) == 101
        assert status(server.port, "127.0.0.1:PORT", "http://evil.example", upgrade=True) == 403
    finally:
        server.stop()


@pytest.mark.parametrize("path", ["/", "/nowhere", "/../x", "/static/live.js", "/static/nowhere"])
def test_every_answer_says_that_no_other_page_may_show_it(port, path):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path)
    headers = connection.getresponse().headers
    connection.close()
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"] and headers["X-Frame-Options"] == "DENY"
    policy = headers["Content-Security-Policy"]
    assert "unsafe" not in policy and "default-src 'none'" in policy and len(headers.get_all("X-Frame-Options")) == 1
    assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("upgrade", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:PORT", "https://evil.example"),
        ("127.0.0.1:PORT", "http://evil.example:PORT"),
        ("127.0.0.1:PORT", "null"),
        ("127.0.0.1:PORT", "http://127.0.0.1:1"),  # another server of this computer
        ("127.0.0.1:PORT", "http://127.0.0.1:PORT.evil.example"),
        ("127.0.0.1:PORT", ""),
        ("evil.example:PORT", "http://evil.example:PORT"),  # DNS rebinding
        ("evil.example:PORT", None),
        ("127.0.0.1:1", None),
        ("127.0.0.1", None),
        ("", None),
        (None, None),
    ],
)
def test_foreign_origins_and_hosts_are_refused(port, host, origin, upgrade):
    assert status(port, host, origin, upgrade) in ((403,) if host else (400, 403))


def test_a_header_given_twice_is_refused():
    own = "127.0.0.1:8080"
    assert why_refused([own], [f"http://{own}"], 8080) == ""
    assert why_refused([own, own], [], 8080) and why_refused([own], [f"http://{own}", "http://evil.example"], 8080)
    assert why_refused(["localhost"], ["http://localhost"], 80) == ""
