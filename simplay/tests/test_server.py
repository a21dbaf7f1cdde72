"""The server of the page without a printer: whom it answers, and what."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager, suppress

import pytest
import requests
import websocket

from simplay.server import PageServer
from simprinter.hosts.moonraker import free_port

LIMIT = 10.0
CONFIG = "[printer]\nkinematics: none\n"


class Table:
    """A desk without a printer on it."""

    moonraker_url = "http://127.0.0.1:7125"

    def __init__(self, config_file):
        self.config_file = config_file
        self.done: list[str] = []
        self.chosen: list[str] = []

    def hello(self):
        return {"kind": "hello", "scene": "none"}

    def do(self, line):
        self.done.append(line)

    def choose(self, name):
        self.chosen.append(name)


@pytest.fixture
def served(tmp_path):
    file = tmp_path / "printer.cfg"
    file.write_text(CONFIG)
    (tmp_path / "secret").write_text("secret")
    server = PageServer(free_port(), Table(file))
    server.start()
    yield server
    server.close()


def get(server, path, **headers):
    return requests.get(server.url + path, headers=headers, timeout=LIMIT)


def put(server, text, **headers):
    headers.setdefault("Origin", server.url)
    headers.setdefault("If-Match", get(server, "/printer.cfg").headers["ETag"])
    headers = {k: v for k, v in headers.items() if v is not None}
    url = f"{server.url}/printer.cfg"
    return requests.put(url, data=text, headers=headers, timeout=LIMIT)


@contextmanager
def looking(server, **options):
    options.setdefault("origin", server.url)
    url = server.url.replace("http", "ws") + "/live"
    socket = websocket.create_connection(url, timeout=LIMIT, **options)
    try:
        yield socket
    finally:
        socket.close()


def test_page_is_served_with_a_policy(served):
    page = get(served, "/")
    assert "<title>A printer to play with</title>" in page.text
    policy = page.headers["Content-Security-Policy"]
    assert "default-src 'none'; script-src 'self'" in policy
    assert "http://127.0.0.1:7125 ws://" in policy
    assert "unsafe" not in policy
    assert page.headers["X-Content-Type-Options"] == "nosniff"
    script = get(served, "/main.js")
    assert script.headers["Content-Type"].startswith("text/javascript")
    assert "Access-Control-Allow-Origin" not in page.headers


def test_it_listens_on_loopback_only(served):
    """Not on another address of this machine, though it is loopback, too."""
    with pytest.raises(requests.ConnectionError):
        requests.get(f"http://127.0.0.2:{served.port}/", timeout=LIMIT)


@pytest.mark.parametrize("path", ["/", "/main.js", "/printer.cfg"])
def test_another_name_in_host_is_refused(served, path):
    """So that a page from elsewhere cannot make its name lead here."""
    for name in ("evil.example", f"evil.example:{served.port}", "127.0.0.1"):
        assert get(served, path, Host=name).status_code == 403
    good = f"localhost:{served.port}"
    assert get(served, path, Host=good).status_code == 200


def test_other_pages_read_nothing(served):
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        answer = get(served, "/printer.cfg", Origin=origin)
        assert answer.status_code == 403
        assert CONFIG not in answer.text


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/%2e%2e/server.py",
        "/..%2fserver.py",
        "//etc/passwd",
        "/printer.cfg/../secret",
        "/secret",
    ],
)
def test_no_other_file_is_given_away(served, path):
    connection = requests.Session()
    request = requests.Request("GET", served.url).prepare()
    request.url = served.url + path
    answer = connection.send(request, timeout=LIMIT)
    assert answer.status_code in (301, 403, 404)
    assert "secret" not in answer.text


def test_configuration_is_read_and_written(served):
    file = served.desk.config_file
    read = get(served, "/printer.cfg")
    assert read.text == CONFIG
    assert put(served, "[new]\nname: ä\n".encode()).status_code == 204
    assert file.read_text(encoding="utf-8") == "[new]\nname: ä\n"
    assert [p.name for p in sorted(file.parent.iterdir())] == [
        "printer.cfg",
        "secret",
    ]


@pytest.mark.parametrize(
    "headers, status",
    [
        ({"Origin": None}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Host": "evil.example"}, 403),
        ({"If-Match": '"of another one"'}, 412),
        ({"If-Match": None}, 412),
    ],
)
def test_configuration_is_written_by_the_page_alone(served, headers, status):
    assert put(served, b"[new]\n", **headers).status_code == status
    assert served.desk.config_file.read_text() == CONFIG


def test_text_that_is_none_or_too_long_is_refused(served):
    assert put(served, b"\xff\xfe").status_code == 400
    with suppress(requests.RequestException):  # it may hang up at once
        assert put(served, b"#" * 600_000).status_code >= 400
    assert served.desk.config_file.read_text() == CONFIG


@pytest.mark.parametrize(
    "options",
    [
        {"origin": "http://evil.example"},
        {"suppress_origin": True},
        {"host": "evil.example"},
    ],
)
def test_only_its_own_page_may_give_orders(served, options):
    refused = pytest.raises(websocket.WebSocketBadStatusException)
    with refused as caught, looking(served, **options):
        pass
    assert caught.value.status_code == 403
    assert not served.is_watched


def test_orders_and_lines(served):
    served.show_line("before")
    with looking(served) as socket:
        hello = json.loads(socket.recv())
        assert hello == {"kind": "hello", "scene": "none", "lines": ["before"]}
        assert served.is_watched
        served.show_line("now")
        assert json.loads(socket.recv()) == {"kind": "line", "line": "now"}
        # One that comes while another message is on its way is left out
        for _ in range(5):
            time.sleep(0.05)
            served.show_frame({"t": 1.0})
        served.show_hello()
        kinds = []
        while "hello" not in kinds:
            message = json.loads(socket.recv())
            kinds.append(message["kind"])
            assert message["kind"] == "hello" or message["t"] == 1.0
        assert "frame" in kinds
        socket.send('{"do": "break probe"}')
        socket.send('{"scene": "extra_probe"}')
        socket.send('{"do": 5}')
        socket.send("[]")
        assert socket.recv() == ""
    assert served.desk.done == ["break probe"]
    assert served.desk.chosen == ["extra_probe"]


def test_one_who_reads_nothing_costs_no_memory(served):
    """Frames are dropped for it; the last ones come when it reads again."""
    text = "x" * 10_000
    with looking(served) as slow:
        slow.recv()
        for number in range(4000):
            served.show_frame({"n": number, "text": text})
        # 40 MB were shown; what waits is what the kernel's buffers hold
        slow.settimeout(1.0)
        count = 0
        with pytest.raises(websocket.WebSocketTimeoutException):
            while slow.recv():
                count += 1
        assert 0 < count < 2000
        served.show_frame({"n": "last"})
        assert json.loads(slow.recv())["n"] == "last"


def test_touches_reach_one_who_is_late(served):
    """A frame with touches is never left out: no other tells of them."""
    text = "x" * 10_000
    with looking(served) as late:
        late.recv()
        for number in range(2000):
            touched = [] if number % 100 else ["nozzle_pin"]
            served.show_frame({"n": number, "text": text, "touches": touched})
        served.show_line("end")
        touches, frames = [], 0
        while (message := json.loads(late.recv()))["kind"] == "frame":
            frames += 1
            touches += [message["n"]] * len(message["touches"])
        assert touches == list(range(0, 2000, 100))
        assert frames < 1000


def test_more_pages_than_there_is_room_for(served):
    sockets = []
    for _ in range(8):
        context = looking(served)
        sockets.append((context, context.__enter__()))
    try:
        with looking(served) as one_more:
            assert one_more.recv() == ""
        assert json.loads(sockets[0][1].recv())["kind"] == "hello"
    finally:
        for context, _ in sockets:
            context.__exit__(None, None, None)


def test_port_that_is_taken_is_an_error(served):
    other = PageServer(served.port, served.desk)
    with pytest.raises(OSError):
        other.start()
