"""Tests of truejoint.monitor.access: what strangers' pages, programs and bytes get."""

import contextlib
import itertools
import logging
import queue
import socket
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import viser
from tests.synthetic import build_recording
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from truejoint.errors import TruejointError
from truejoint.monitor import RecordingPage, access
from truejoint.monitor.access import HEADERS, Access, check_message
from truejoint.monitor.page import PLOT_EVERY
from truejoint.monitor.process import ArmView
from truejoint.monitor.samples import Condition, Samples
from truejoint.robots import get_robot

SPOKEN = [Subprotocol(f"viser-v{viser.__version__}")]
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0, 0, 0], "position": [0.0, 0, 1],
    "fov": 1.0, "near": 0.1, "far": 10.0, "image_height": 600, "image_width": 800,
    "look_at": [0.0, 0, 0], "up_direction": [0.0, 0, 1],
}  # fmt: skip
UPDATE = {"type": "GuiUpdateMessage", "uuid": "u", "updates": {"value": True}}


@pytest.fixture
def pressed():
    return queue.SimpleQueue()


@pytest.fixture
def view(pressed):
    """The page of a RAVEN-II that says that it is ENABLED."""
    view = ArmView(get_robot("raven2"), pressed.put, host="127.0.0.1", port=0)
    view.show(None, Condition("ENABLED", "a secret of the arm"))
    view.draw()
    with contextlib.closing(view):
        yield view


@pytest.fixture(scope="module")
def lasting():
    """A page of an arm that stays open: what strangers send it is dealt with."""
    with contextlib.closing(ArmView(get_robot("raven2"), print, host="127.0.0.1", port=0)) as view:
        yield view


@pytest.fixture
def said(caplog, monkeypatch):
    """All lines of the log, also those that are said again."""
    monkeypatch.setattr(access, "_LOG_PERIOD", -1.0)
    caplog.set_level(logging.WARNING)
    return caplog


def _connect(view, **how):
    return connect(view.url.replace("http", "ws"), subprotocols=SPOKEN, **how)


def _wait_for(condition):
    """Until what another thread does is done."""
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def _asked(view, text):
    """First line and headers of the answer to a raw request."""
    port = urllib.parse.urlsplit(view.url).port
    with socket.create_connection(("127.0.0.1", port), 20) as raw:
        raw.sendall(text.replace("\n", "\r\n").replace("PORT", str(port)).encode("latin-1"))
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while b"\r\n\r\n" not in answer and (got := raw.recv(65536)):
                answer += got
    return answer.partition(b"\r\n\r\n")[0].decode("latin-1")


EVERYWHERE = "0.0.0.0"  # noqa: S104


@pytest.mark.parametrize(
    ("host", "asked", "origin", "path", "why"),
    [
        ("127.0.0.1", "127.0.0.1:8080", "http://127.0.0.1:8080", "/", ""),
        ("127.0.0.1", "localhost:8080", "http://localhost:8080", "/?darkMode", ""),
        ("127.0.0.1", "127.0.0.1:8080", None, "/", ""),
        ("127.0.0.1", "127.0.0.1:8080", "http://127.0.0.1:9000", "/", "a page of"),
        ("127.0.0.1", "127.0.0.1:8080", "https://127.0.0.1:8080", "/", "a page of"),
        ("127.0.0.1", "127.0.0.1:8080", "null", "/", "a page of 'null'"),
        ("127.0.0.1", "rebound.example:8080", "http://rebound.example:8080", "/", "the name"),
        ("127.0.0.1", "127.0.0.1.example", None, "/", "the name"),
        ("127.0.0.1", "user@127.0.0.1:8080", "http://user@127.0.0.1:8080", "/", ""),
        ("127.0.0.1", "[::1", None, "/", "the name"),
        ("127.0.0.1", "", None, "/", "the name"),
        ("127.0.0.1", "127.0.0.1:8080", None, "/../../etc/passwd", "no page"),
        (EVERYWHERE, "192.0.2.7:8080", "http://192.0.2.7:8080", "/TOKEN", ""),
        (EVERYWHERE, "192.0.2.7:8080", "http://192.0.2.7:8080", "/TOKEN/?x", ""),
        (EVERYWHERE, "192.0.2.7:8080", "http://192.0.2.7:8080", "/", "without its token"),
        (EVERYWHERE, "192.0.2.7:8080", "http://192.0.2.7:8080", "/TOKE", "without its token"),
        (EVERYWHERE, "192.0.2.7:8080", None, "/\udcff", "without its token"),
        (EVERYWHERE, "rebound.example:8080", "http://rebound.example:8080", "/TOKEN", "the name"),
        ("robot.lab", "ROBOT.lab:8080", "http://ROBOT.lab:8080", "/TOKEN", ""),
    ],
)
def test_who_may_open_the_page(host, asked, origin, path, why):
    allowed = Access(host, "" if host == "127.0.0.1" else "TOKEN")
    headers = {"Host": asked} | ({} if origin is None else {"Origin": origin})
    refusal = allowed.refusal(path, headers, "192.0.2.7" if allowed.token else "127.0.0.1")
    assert why in refusal
    assert bool(why) == bool(refusal)


def test_beyond_loopback_the_address_holds_a_token_and_only_pausing_is_offered(pressed):
    assert Access.of("127.0.0.1").url(80) == "http://127.0.0.1:80"
    assert Access.of("::1").url(80) == "http://[::1]:80"
    first, second = Access.of("192.0.2.7"), Access.of("192.0.2.7")
    assert len(first.token) > 30
    assert first.token != second.token
    assert first.url(80) == f"http://192.0.2.7:80/{first.token}"
    for remote_control in (False, True):
        wide = ArmView(
            get_robot("raven2"), pressed.put,
            host=EVERYWHERE, port=0, remote_control=remote_control,
        )  # fmt: skip
        with contextlib.closing(wide):
            wide.show(None, Condition("PAUSED"))
            wide.draw()
            assert (wide.resume is not None) is remote_control
            address = urllib.parse.urlsplit(wide.url)
            near = f"http://127.0.0.1:{address.port}"
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(near, timeout=20)
            with urllib.request.urlopen(near + address.path, timeout=20) as page:  # noqa: S310
                assert b"Viser" in page.read()


@pytest.mark.parametrize(
    ("request_text", "status"),
    [
        ("GET / HTTP/1.1\nHost: 127.0.0.1:PORT\n\n", "200"),
        ("GET /x HTTP/1.1\nHost: 127.0.0.1:PORT\n\n", "403"),
        ("GET /%00 HTTP/1.1\nHost: 127.0.0.1:PORT\n\n", "403"),
        ("GET / HTTP/1.1\nHost: 127.0.0.1:PORT\nHost: 127.0.0.1:PORT\n\n", "403"),
        ("GET / HTTP/1.1\nHost: evil.example\n\n", "403"),
        ("GET / HTTP/1.1\n\n", "403"),
        ("GET / HTTP/1.1\nHost: 127.0.0.1:PORT\nUpgrade: websocket\nUpgrade: h2c\n\n", "403"),
        ("GET / HTTP/1.1\nHost: 127.0.0.1:PORT\nUpgrade: websocket\n\n", "426"),
        ("POST / HTTP/1.1\nHost: 127.0.0.1:PORT\nContent-Length: 3\n\nabc", ""),
        (f"GET /{'a' * 20_000} HTTP/1.1\nHost: 127.0.0.1:PORT\n\n", ""),
        ("\xff\x00\n\n", ""),
    ],
)
def test_every_answer_forbids_to_frame_and_no_request_leaves_a_traceback(
    lasting, said, capfd, request_text, status
):
    answer = _asked(lasting, request_text)
    assert answer.partition(" ")[2].startswith(status)
    for name, value in HEADERS.items() if status else ():
        assert f"{name}: {value}" in answer
        assert "frame-ancestors 'none'" in answer
    _wait_for(lambda: len(said.records) == (status != "200"))
    assert all("\n" not in record.getMessage() for record in said.records)
    assert "Traceback" not in said.text + "".join(capfd.readouterr())


@pytest.mark.parametrize(
    "message",
    [
        "text", b"", b"\xff" * 100, b"x" * (access.MOST_BYTES + 1), msgspec.msgpack.encode([]),
        *(msgspec.msgpack.encode(message) for message in (
            {"type": "ShareUrlRequest"}, {"type": "RunJavascriptMessage", "source": "1"},
            {**UPDATE, "updates": {"update_cb": []}}, {**UPDATE, "updates": {"value": [1] * 9}},
            {**UPDATE, "updates": {"value": 1.0, "removed": True}},
            {**UPDATE, "updates": {"value": float("nan")}}, {**CAMERA, "wxyz": [0.0, 0, 0, 0]},
            {**CAMERA, "position": [float("inf"), 0, 0]}, {**CAMERA, "image_height": 0},
        )),
    ],
    ids=itertools.count(),
)  # fmt: skip
def test_what_the_page_would_not_send_ends_the_connection_in_a_line(lasting, said, capfd, message):
    for good in (CAMERA, UPDATE):
        check_message(msgspec.msgpack.encode(good))
    with _connect(lasting) as stranger:
        stranger.send(message)
        with contextlib.suppress(ConnectionClosed):
            for _ in stranger:  # what was under way until it is closed
                pass
        assert stranger.protocol.close_code in {1008, 1009}
    _wait_for(lambda: len(said.records) == 1)
    assert "Traceback" not in said.text + "".join(capfd.readouterr())
    with _connect(lasting) as again:
        assert again.recv(timeout=20)


def test_a_hundred_tabs_and_connections_that_say_nothing_are_refused(view, said, capfd):
    port = urllib.parse.urlsplit(view.url).port
    with contextlib.ExitStack() as stack:
        for _ in range(access.MOST_VIEWERS):
            stack.enter_context(_connect(view))
        for _ in range(100 - access.MOST_VIEWERS):
            with pytest.raises(InvalidStatus, match="403"):
                _connect(view)
        assert "16 pages are open already" in said.text
        silent = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), 20))
            for _ in range(100)
        ]
        silent[-1].settimeout(20)
        with contextlib.suppress(ConnectionResetError):
            assert silent[-1].recv(1) == b""
        assert "too many connections" in said.text
    assert "Traceback" not in said.text + "".join(capfd.readouterr())


def test_the_same_is_said_once_in_ten_seconds(monkeypatch, caplog):
    for now in np.arange(1.0, 60.0, 0.1):
        monkeypatch.setattr(access.time, "monotonic", lambda now=now: now)
        access._note_failure(None, {"message": "it failed"})
    assert len(caplog.records) == 6


def test_a_widget_set_to_what_it_does_not_offer_stops_no_page(view):
    recording = build_recording(60)
    view.show(Samples.of_recording(recording), Condition("ENABLED"))
    with RecordingPage(recording, port=0) as page:
        dropdowns = view._joint, view._span, page._page._joint, page._page._span, page._speed
        for handle in dropdowns:
            handle._impl.value = "none of these"
        page._play.value, page._slider._impl.value = True, float("nan")
        page._scrub(SimpleNamespace(client=1))
        for _ in range(2 * PLOT_EVERY):
            view.draw()
            page._frame()
        assert page._begin <= page._t <= page._end


ATTACKS = {
    "frame": "new Promise(r => {const f = document.createElement('iframe'); f.src = TARGET;"
    "document.body.append(f); setTimeout(r, 1000, '')})",
    "object": "new Promise(r => {const f = document.createElement('object'); f.data = TARGET;"
    "f.onload = () => r('shown'); f.onerror = () => r(''); document.body.append(f);"
    "setTimeout(r, 1000, '')})",
    "fetch": "fetch(TARGET).then(r => r.text()).catch(() => '')",
    "fetch without CORS": "fetch(TARGET, {mode: 'no-cors'}).then(r => r.text()).catch(() => '')",
    "script": "new Promise(r => {const s = document.createElement('script'); s.src = TARGET;"
    "s.onload = () => r('ran'); s.onerror = () => r(''); document.body.append(s)})",
    "WebSocket": "new Promise(r => {const w = new WebSocket(SOCKET, PROTOCOL);"
    "w.onmessage = () => r('read'); w.onopen = () => w.send(PRESS); w.onclose = () => r('')})",
    "WebSocket of a worker": "new Promise(r => {const b = new Blob(["
    "`const w = new WebSocket('${SOCKET}', '${PROTOCOL}'); w.onmessage = () => postMessage('read');"
    "w.onclose = () => postMessage('')`]); const k = new Worker(URL.createObjectURL(b));"
    "k.onmessage = e => r(e.data)})",
    "WebSocket of a sandbox": "new Promise(r => {const f = document.createElement('iframe');"
    "f.sandbox = 'allow-scripts'; onmessage = e => r(e.data); f.srcdoc = "
    "`<script>const w = new WebSocket('${SOCKET}', '${PROTOCOL}');"
    "w.onmessage = () => parent.postMessage('read', '*');"
    "w.onclose = () => parent.postMessage('', '*')</script>`; document.body.append(f)})",
    "form": "new Promise(r => {const f = document.createElement('form'); f.action = TARGET;"
    "f.method = 'post'; f.target = 'of_form'; f.innerHTML = '<input name=value value=true>';"
    "const i = document.createElement('iframe'); i.name = 'of_form'; document.body.append(i, f);"
    "f.submit(); setTimeout(r, 1000, '')})",
    "beacon": "new Promise(r => {navigator.sendBeacon(TARGET, PRESS); setTimeout(r, 500, '')})",
    "window": "new Promise(r => {const w = open(TARGET); setTimeout(() => {let got = '';"
    "try {got = w.document.body.innerText} catch {} r(got)}, 1000)})",
}


@pytest.fixture
def evil():
    """Address of a page of another origin; it collects what is sent to it."""

    class Evil(BaseHTTPRequestHandler):
        def do_GET(self):
            self.server.asked.append(self.headers.get("Upgrade", self.path))
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>evil</title><body>")

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Evil)
    server.asked = []
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def test_pages_of_other_origins_neither_read_nor_press(view, pressed, evil, browser):
    port, uuid = urllib.parse.urlsplit(view.url).port, view.pause._impl.uuid
    press = list(msgspec.msgpack.encode({**UPDATE, "uuid": uuid}))
    opened = []
    view._server._websock_server.on_client_connect(opened.append)
    browser.open(f"http://evil.example:{evil.server_port}/")
    browser.until("document.title === 'evil'")
    constants = (
        f"const TARGET = '{view.url}/', SOCKET = '{view.url.replace('http', 'ws')}',"
        f"PROTOCOL = '{SPOKEN[0]}', PRESS = new Uint8Array({press});"
    )
    attacks = ", ".join(ATTACKS.values())  # all at once
    answers = browser.evaluate(f"(() => {{{constants} return Promise.all([{attacks}])}})()")
    got = dict(zip(ATTACKS, answers, strict=True))
    # A name that points at this computer now, and the page itself told to ask elsewhere.
    browser.open(f"http://rebound.example:{port}/")
    got["rebind"] = browser.until("document.body?.innerText")
    assert got.pop("rebind").startswith("Refused: asked for by the name 'rebound.example'")
    browser.open(f"{view.url}/?websocket=ws://evil.example:{evil.server_port}/")
    browser.until("document.querySelectorAll('script').length > 1")
    browser.evaluate("new Promise(r => setTimeout(r, 800))")
    assert "websocket" not in evil.asked
    assert opened == []  # so that no frame runs the page either
    assert {name: text for name, text in got.items() if text} == {}
    assert pressed.empty()
    # The button does work for who opens the page.
    browser.open(view.url)
    browser.until("document.body?.innerText.includes('a secret of the arm')")
    browser.evaluate(
        "[...document.querySelectorAll('button')]"
        ".find(b => b.innerText.trim() === 'Pause the arm').click()"
    )
    assert pressed.get(timeout=20) == "pause"


def test_a_host_that_is_no_name_is_refused():
    with pytest.raises(TruejointError, match="cannot listen there"):
        ArmView(get_robot("raven2"), print, host="a" * 300, port=0)
