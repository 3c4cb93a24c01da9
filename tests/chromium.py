"""A headless Chromium to look at a page with: sizes, clicks, pictures, what it says on its console.

It speaks the DevTools protocol over the websocket that Chromium opens on this computer.
"""

import json
import shutil
import subprocess
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, Self

from websockets.sync.client import connect

FOUND = shutil.which("chromium")
_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--mute-audio", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-extensions", "--disable-dev-shm-usage", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--remote-debugging-port=0", "--remote-allow-origins=*",
)  # fmt: skip
_LIMIT = 60.0  # [s] for anything
# What somebody without eyes, without colours or with a phone would miss; text has 4.5:1 (WCAG AA).
_FAULTS = r"""(() => {
  const faults = [], all = (css) => [...document.querySelectorAll(css)];
  const none = (css, what, bad) =>
    all(css).filter(bad).forEach((e) => faults.push(`${what}: ${e.outerHTML.slice(0, 90)}`));
  const curved = (v) => v <= 10 ? v / 3295 : ((v / 255 + 0.055) / 1.055) ** 2.4;
  const light = (c) => 0.05 + [.2126, .7152, .0722].reduce((s, w, i) => s + w * curved(c[i]), 0);
  const colour = (e, key) => getComputedStyle(e)[key].match(/[\d.]+/g).map(Number);
  const paper = (e) => colour(e, "backgroundColor")[3] === 0 && e.parentElement
    ? paper(e.parentElement) : colour(e, "backgroundColor");
  const faint = (e, [a, b] = [colour(e, "color"), paper(e)].map(light).sort()) => b / a < 4.5;
  const level = (e) => Number(e.tagName[1]), heads = all("h1, h2, h3, h4");
  const words = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
  none("html", "language or title", (e) => !e.lang || !document.title);
  none("body", "one main, one h1", () => all("main").length !== 1 || all("h1").length !== 1);
  none("body", "sideways", () => document.documentElement.scrollWidth > innerWidth);
  none("h2, h3, h4", "skipped", (e) => level(e) > level(heads[heads.indexOf(e) - 1]) + 1);
  none("img:not([alt]), [role=img] a, [role=img] button", "unseen", () => true);
  none("select, input", "label", (e) => !e.labels.length && !e.ariaLabel);
  none("a, button, summary", "name", (e) => !(e.textContent.trim() || e.ariaLabel || e.title));
  none(".scroll", "no focus", (e) => e.scrollWidth > e.clientWidth && e.tabIndex < 0);
  none("body *:not(svg *, script, style)", "faint",
    (e) => words(e) && e.checkVisibility() && faint(e));
  return faults; })()"""


class Chromium:
    """One page of a browser of its own; `folder` keeps its profile."""

    def __init__(
        self, folder: Path, width: int = 1280, height: int = 800, flags: Sequence[str] = ()
    ) -> None:
        profile = folder / "profile"
        self._process = subprocess.Popen(
            [FOUND or "chromium", *_FLAGS, *flags, f"--user-data-dir={profile}",
             f"--window-size={width},{height}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        said = profile / "DevToolsActivePort"
        end = time.monotonic() + _LIMIT
        while not (said.exists() and said.read_text().count("\n")):
            if self._process.poll() is not None or time.monotonic() > end:
                self._process.kill()
                raise RuntimeError("chromium does not start")
            time.sleep(0.05)
        port, path = said.read_text().split("\n")[:2]
        self._socket = connect(f"ws://127.0.0.1:{port}{path}", max_size=None)
        self._count, self._session = 0, None
        self.errors: list[str] = []  # on its console
        self.requested: list[str] = []  # addresses
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(width, height)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(_LIMIT)

    def call(self, method: str, **params: Any) -> Any:
        """Call a method of the protocol and wait for its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            got = json.loads(self._socket.recv(timeout=_LIMIT))
            if got.get("id") == self._count:
                if "error" in got:
                    raise RuntimeError(f"{method}: {got['error']['message']}")
                return got["result"]
            self._note(got.get("method", ""), got.get("params", {}))

    def open(self, url: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=url)

    def resize(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Give the page a size [px]."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=2 if mobile else 1, mobile=mobile,
        )  # fmt: skip

    def faults(self) -> list[str]:
        """What bars people from the page: on a screen and a phone, light and dark."""
        found = []
        for width, scheme in product((1400, 390), ("light", "dark")):
            self.resize(width, 900, mobile=width < 600)
            feature = {"name": "prefers-color-scheme", "value": scheme}
            self.call("Emulation.setEmulatedMedia", features=[feature])
            found += [f"{width} {scheme} {fault}" for fault in self.evaluate(_FAULTS)]
        return found

    def evaluate(self, script: str) -> Any:
        """Value of a JavaScript expression, a promise awaited."""
        got = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in got:
            raise RuntimeError(got["exceptionDetails"]["exception"].get("description", script))
        return got["result"].get("value")

    def until(self, script: str, limit: float = _LIMIT) -> Any:
        """Wait until an expression is true, and give its value."""
        end = time.monotonic() + limit
        while not (value := self.evaluate(script)):
            if time.monotonic() > end:
                raise RuntimeError(f"never came true: {script}")
            time.sleep(0.05)
        return value

    def _note(self, method: str, params: Any) -> None:
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(params["exceptionDetails"].get("exception", {})))
        elif method == "Runtime.consoleAPICalled" and params["type"] == "error":
            texts = (str(a.get("value", a.get("description", ""))) for a in params["args"])
            self.errors.append(" ".join(texts))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.requested.append(params["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requested.append(params["url"])
