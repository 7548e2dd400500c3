"""A page in headless Chromium, driven by its own DevTools protocol, with every way to a network closed.

`opened` is skipped with a clear line where Chromium is not installed; with `DIETHROW_NEEDS_VIEWERS` set, a missing
browser is a failure instead.
"""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
NEEDED = "DIETHROW_NEEDS_VIEWERS"
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-extensions",
    "--disable-sync",
    "--hide-scrollbars",
    "--mute-audio",
    "--remote-debugging-port=0",
    # WebGL without a GPU.
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    # Drawing without a GPU beside other work is slow; it is not hung.
    "--disable-gpu-watchdog",
    "--disable-hang-monitor",
    # No name resolves and no proxy answers: what the page asks for fails, and is told.
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--proxy-server=127.0.0.1:9",
)
START_S, ANSWER_S = 30.0, 60.0
PLAINLY: dict[str, Any] = {"proxy": None, "max_size": None, "ping_interval": None}
"""No proxy, pictures of any size, and no pings: a browser that draws without a GPU answers none for a while."""


class Page:
    """A tab: what it wrote to its console, what it asked for, and what it says of itself."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self.errors: list[str] = []
        """Errors and exceptions of the console and the browser's log."""
        self.requests: list[str] = []
        """Addresses asked for, but for those in the page itself (`data:`, `blob:`)."""

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to one command; events that come before it are noted. Raises AssertionError for an error."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        until = time.monotonic() + ANSWER_S
        while True:
            message = json.loads(self._socket.recv(timeout=until - time.monotonic()))
            if message.get("id") == number:
                assert "error" not in message, f"{method}: {message['error']}"
                return dict(message["result"])
            self._note(message)

    def evaluate(self, expression: str) -> Any:
        """The value of an expression in the page; a promise is waited for."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True, userGesture=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, expression: str, within_s: float) -> None:
        """Until an expression is true. Raises AssertionError with what the console said."""
        until = time.monotonic() + within_s
        while not self.evaluate(expression):
            assert time.monotonic() < until, f"{expression} is not true after {within_s:g} s; console: {self.errors}"
            time.sleep(0.1)

    def screenshot(self) -> bytes:
        """What is in view, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def _note(self, message: dict[str, Any]) -> None:
        method, told = message.get("method"), message.get("params", {})
        if method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(part.get("value", part.get("description"))) for part in told["args"]))
        elif method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.errors.append(str(details.get("exception", {}).get("description", details.get("text"))))
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(str(told["entry"]["text"]))
        elif method == "Network.requestWillBeSent":
            address = str(told["request"]["url"])
            if not address.startswith(("data:", "blob:")):
                self.requests.append(address)


@contextmanager
def opened(file: Path, profile: Path, *, width_px: int = 1200, height_px: int = 900) -> Iterator[Page]:
    """The page of a file, loaded. `profile` is a folder for the browser's own files."""
    with _browser(profile) as address, connect(address, **PLAINLY) as socket:
        page = Page(socket)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.call(f"{domain}.enable")
        size = {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": False}
        page.call("Emulation.setDeviceMetricsOverride", **size)
        page.call("Page.navigate", url=file.resolve().as_uri())
        page.wait_for("document.readyState === 'complete'", 30.0)
        yield page


@contextmanager
def _browser(profile: Path) -> Iterator[str]:
    """The address of the only tab of a fresh browser."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        said = f"no browser is installed; wanted one of {', '.join(NAMES)} (Debian: apt-get install chromium)"
        assert not os.environ.get(NEEDED), said
        pytest.skip(said)
    command = [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield _tab(profile / "DevToolsActivePort", process)
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()


def _tab(port_file: Path, process: subprocess.Popen[bytes]) -> str:
    until = time.monotonic() + START_S
    while time.monotonic() < until:
        assert process.poll() is None, f"the browser ended with status {process.returncode}"
        lines = port_file.read_text(encoding="ascii").split() if port_file.exists() else []
        if len(lines) == 2:
            return _first_page(f"ws://127.0.0.1:{lines[0]}{lines[1]}", f"ws://127.0.0.1:{lines[0]}/devtools/page/")
        time.sleep(0.05)
    raise AssertionError(f"the browser did not start within {START_S:g} s")


def _first_page(browser: str, pages: str) -> str:
    with connect(browser, **PLAINLY) as socket:
        targets = Page(socket).call("Target.getTargets")["targetInfos"]
    return pages + str(next(target["targetId"] for target in targets if target["type"] == "page"))
