"""Who may open the page, and what the page may do: the door before viser's server."""

import asyncio
import hmac
import ipaddress
import logging
import math
import secrets
import socket
import threading
import time
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from gzip import compress
from hashlib import sha256
from importlib.resources import files
from typing import Any, Final, Self
from urllib.parse import urlsplit

import msgspec
import websockets.asyncio.server as websocket_server
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosedError
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

MOST_VIEWERS: Final = 16
MOST_CONNECTIONS: Final = 64  # of all kinds, those that have not said yet what they want among them
MOST_BYTES: Final = 16_384  # of one message; a browser's are a few hundred

_LOOPBACK_NAMES: Final = frozenset({"127.0.0.1", "localhost", "::1"})
_EVERYWHERE: Final = ("", "0.0.0.0", "::")  # noqa: S104  # the user's choice, not ours
_LOG_PERIOD: Final = 10.0  # [s] in which the same is said once
HEADERS: Final = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}  # fmt: skip
"""Of every answer, beside `content_policy`: no other page may frame it or hold its window."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Access:
    """Where the page is, and who may open it.

    On loopback a page is open to the programs of this computer. Beyond it whoever opens the page
    must know the `token` in its address. Either way a browser must ask for the page by an address
    or the name of this computer, or by the name that the user gave: a name that somebody else has
    pointed at this computer is none of them.
    """

    host: str
    token: str = ""

    @classmethod
    def of(cls, host: str) -> Self:
        """Access to what listens at `host`: with a new token where that is beyond loopback."""
        return cls(host, "" if is_loopback(host) else secrets.token_urlsafe(24))

    def url(self, port: int) -> str:
        """Address to open in a browser."""
        host = socket.gethostname() if self.host in _EVERYWHERE else self.host
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{port}" + (f"/{self.token}" if self.token else "")

    def refusal(self, path: str, headers: Any, address: str) -> str:
        """Why a request that came in at `address` is refused; empty if it is not."""
        names = [name.lower() for name, _ in getattr(headers, "raw_items", headers.items)()]
        if twice := [name for name in names if names.count(name) > 1]:
            return f"two headers {twice[0]!r:.40}"
        host, origin = headers.get("Host", ""), headers.get("Origin")
        with suppress(ValueError):  # a port or an address that is none
            name = urlsplit(f"//{host}").hostname or ""
            own = (address, self.host, socket.gethostname() if self.token else "")
            if name not in _LOOPBACK_NAMES | {known.lower() for known in own if known}:
                return f"asked for by the name {name!r:.60}, which is not that of this page"
            if origin is not None and origin != f"http://{host}":
                return f"asked for by a page of {origin!r:.60}"
            asked = path.partition("?")[0].strip("/")
            if hmac.compare_digest(asked.encode("utf-8", "replace"), self.token.encode()):
                return ""
            return "asked for without its token" if self.token else f"no page {path!r:.60}"
        return f"asked for by the name {host!r:.60}"


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches what listens at `host`."""
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host.lower() == "localhost"


@contextmanager
def guarded(access: Access) -> Iterator[None]:
    """Put the door before each server that viser starts in this block."""
    serve = websocket_server.serve

    def guarded_serve(
        handler: Any, host: str, port: int, *, process_request: Any, **how: Any
    ) -> Any:
        asyncio.get_running_loop().set_exception_handler(_note_failure)
        how |= {"max_size": MOST_BYTES, "create_connection": _Connection, "logger": _log}
        how |= {"process_response": _with_headers}
        return serve(handler, host, port, process_request=_door(access, process_request), **how)

    with _STARTING:
        websocket_server.serve = guarded_serve  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            websocket_server.serve = serve  # type: ignore[misc]


_STARTING: Final = threading.Lock()


def _door(access: Access, serve_page: Callable[[Any, Request], Response | None]) -> Any:
    """Answer requests: refuse in one line, or hand them to viser."""

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        headers, address = request.headers, str(connection.local_address[0])
        why = access.refusal(request.path, headers, address)
        is_full = len(connection.server.connections) >= MOST_VIEWERS
        if not why and is_full and headers.get("Upgrade"):
            why = f"{MOST_VIEWERS} pages are open already"
        if why:
            _log.warning("the monitor's page refused %s: %s", _peer(connection), why)
            return connection.respond(403, f"Refused: {why}.\n")
        request.path = "/"
        response = serve_page(connection, request)
        if response is not None:
            response.body = _page(response.headers["Content-Encoding"])
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))
        return response

    return answer


@cache
def _page(encoding: str) -> bytes:
    """Give viser's page with names for what it leaves without one, ``gzip`` or as it is."""
    body = f"{_text('viser', 'client/build/index.html')}<script>{_names()}</script>".encode()
    return compress(body) if encoding == "gzip" else body


def _names() -> str:
    return _text("truejoint.monitor", "assets/names.js")


def _text(package: str, path: str) -> str:
    return (files(package) / path).read_text(encoding="utf-8")


def _with_headers(_connection: Any, _request: Request, response: Response) -> None:
    response.headers.update({**HEADERS, "Content-Security-Policy": content_policy()})


@cache
def content_policy() -> str:
    """Say what the page may do: run two scripts and what viser's unpacks, talk to us alone.

    Text in it is never a script. `unsafe-eval` is for its WebAssembly, which makes functions.
    """
    page = _text("viser", "client/build/index.html")
    script = page.partition("<script")[2].partition(">")[2].partition("</script>")[0]
    digests = [b64encode(sha256(text.encode()).digest()).decode() for text in (script, _names())]
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {hashes} 'strict-dynamic' 'unsafe-eval'; "
        "worker-src blob:; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
        "connect-src 'self' data: blob:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )


class _Camera(msgspec.Struct, tag_field="type", tag="ViewerCameraMessage"):
    """Where somebody looks from; viser makes arrays of it."""

    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: tuple[float, float, float]
    up_direction: tuple[float, float, float]


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    """What a widget is set to; viser would let a message change anything else of it."""

    value: bool | float | str


class _Update(msgspec.Struct, tag_field="type", tag="GuiUpdateMessage"):
    """A widget that somebody pressed or moved."""

    uuid: str
    updates: _Value


_DECODER: Final = msgspec.msgpack.Decoder(_Camera | _Update)


def check_message(message: bytes | str) -> None:
    """Raise ValueError for a message that viser's page does not send."""
    if isinstance(message, str):
        raise ValueError("text")
    try:
        decoded = _DECODER.decode(message)
    except msgspec.DecodeError as error:
        raise ValueError(str(error)) from None
    if isinstance(decoded, _Camera):
        numbers = (*decoded.wxyz, *decoded.position, *decoded.look_at, *decoded.up_direction)
        sizes = (decoded.fov, decoded.near, decoded.far)
        if not all(map(math.isfinite, numbers + sizes)) or math.hypot(*decoded.wxyz) < 1e-6:
            raise ValueError("a camera that looks nowhere")
        if not 0 < min(decoded.image_height, decoded.image_width) < 1 << 16:
            raise ValueError("a picture of no size")
    elif isinstance(decoded.updates.value, float) and not math.isfinite(decoded.updates.value):
        raise ValueError("a value that is no number")


class _Connection(ServerConnection):
    """A connection of which only what viser's page sends comes through."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if len(self.server.handlers) > MOST_CONNECTIONS:
            _log.warning("the monitor's page refused %s: too many connections", _peer(self))
            self.transport.abort()

    async def recv(self, decode: bool | None = None) -> Any:
        """Receive the next message; one that viser's page would not send ends the connection."""
        try:
            message = await super().recv(decode)
            check_message(message)
        except ConnectionClosedError as error:
            if error.sent is not None and error.sent.code == CloseCode.MESSAGE_TOO_BIG:
                _log.warning("the monitor's page refused %s: a message too long", _peer(self))
            raise
        except ValueError as error:
            _log.warning("the monitor's page refused a message of %s: %s", _peer(self), error)
            await self.close(CloseCode.POLICY_VIOLATION, "not a message of this page")
            raise self.protocol.close_exc from None
        return message


class _Brief(logging.Filter):
    """One line a record, without a traceback, and the same line once in a while."""

    def __init__(self) -> None:
        super().__init__()
        self._said: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        if record.exc_info and (error := record.exc_info[1]) is not None:
            if isinstance(error.__cause__, EOFError):  # a browser that connects ahead of time
                return False
            cause = error.__cause__ or error
            record.msg = f"the monitor's page: {record.getMessage()}: {cause!s:.200}"
            record.args, record.exc_info = None, None
        kind, now = str(record.msg), time.monotonic()
        if now - self._said.get(kind, -math.inf) < _LOG_PERIOD:
            return False
        self._said = {**self._said, kind: now} if len(self._said) < 100 else {kind: now}
        return True


_log.addFilter(_Brief())


def _note_failure(_loop: Any, context: dict[str, Any]) -> None:
    """Say in one line what failed in a task of the server."""
    _log.warning("the monitor's page: %.200s", context.get("exception") or context.get("message"))


def _peer(connection: Any) -> str:
    return str((connection.remote_address or ("somebody",))[0])
