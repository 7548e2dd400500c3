"""A page in headless Chromium, controlled through its DevTools protocol, without access to any other machine.

Without Chromium the test is skipped with the reason; with DIETHROW_NEEDS_VIEWERS set, it fails.
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
from typing import Any, NoReturn

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
    # Drawing without a GPU on a busy machine is slow, and must not count as hanging.
    "--disable-gpu-watchdog",
    "--disable-hang-monitor",
    # No name resolves and no proxy answers: requests to other machines fail and are recorded.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--proxy-server=127.0.0.1:9",
)
START_TIMEOUT_S = 30.0
ANSWER_TIMEOUT_S = 60.0
LOAD_TIMEOUT_S = 30.0
SOCKET_OPTIONS: dict[str, Any] = {"proxy": None, "max_size": None, "ping_interval": None}
"""No proxy, messages of any size, and no pings, which a browser that draws without a GPU answers late."""
NO_LOG = "console.log = console.info = console.debug = console.warn = console.trace = () => {};"
"""The Rerun viewer logs thousands of lines while it loads, and their transfer would take longer than drawing."""


def skip_or_fail(reason: str) -> NoReturn:
    """Skip the test, or fail it if viewers are demanded."""
    if os.environ.get(NEEDED):
        pytest.fail(f"{reason}, and {NEEDED} is set")
    pytest.skip(reason)


class Page:
    """A tab with the errors and requests of its page."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self.errors: list[str] = []
        """Errors and exceptions of the console and of the browser's log."""
        self.requests: list[str] = []
        """Requested addresses, without those in the page itself (`data:`, `blob:`)."""

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to one command; earlier events are recorded. Raises AssertionError for an error."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        until = time.monotonic() + ANSWER_TIMEOUT_S
        while True:
            message = json.loads(self._socket.recv(timeout=until - time.monotonic()))
            if message.get("id") == number:
                assert "error" not in message, f"{method}: {message['error']}"
                return dict(message["result"])
            self._record(message)

    def evaluate(self, expression: str) -> Any:
        """The value of an expression in the page; waits for a promise."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True, userGesture=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, expression: str, within_s: float) -> None:
        """Wait until an expression is true. Raises AssertionError with the errors so far."""
        until = time.monotonic() + within_s
        while not self.evaluate(expression):
            assert time.monotonic() < until, f"{expression} is not true after {within_s:g} s; errors: {self.errors}"
            time.sleep(0.1)

    def screenshot(self) -> bytes:
        """The visible part of the page, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def click(self, x_px: int, y_px: int) -> None:
        """Click with the left button."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x_px, y=y_px, button="left", clickCount=1)

    def _record(self, message: dict[str, Any]) -> None:
        method, event = message.get("method"), message.get("params", {})
        if method == "Runtime.consoleAPICalled" and event["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(part.get("value", part.get("description"))) for part in event["args"]))
        elif method == "Runtime.exceptionThrown":
            details = event["exceptionDetails"]
            self.errors.append(str(details.get("exception", {}).get("description", details.get("text"))))
        elif method == "Log.entryAdded" and event["entry"]["level"] == "error":
            self.errors.append(f"{event['entry']['text']} {event['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            address = str(event["request"]["url"])
            if not address.startswith(("data:", "blob:")):
                self.requests.append(address)


@contextmanager
def opened(address: str, profile: Path, *, width_px: int = 1200, height_px: int = 900) -> Iterator[Page]:
    """The loaded page at an address; `profile` is a folder for the browser's own files."""
    with _browser(profile) as tab, connect(tab, **SOCKET_OPTIONS) as socket:
        page = Page(socket)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.call(f"{domain}.enable")
        size = {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": False}
        page.call("Emulation.setDeviceMetricsOverride", **size)
        page.call("Page.addScriptToEvaluateOnNewDocument", source=NO_LOG)
        page.call("Page.navigate", url=address)
        page.wait_for("document.readyState === 'complete'", LOAD_TIMEOUT_S)
        yield page


@contextmanager
def _browser(profile: Path) -> Iterator[str]:
    """The address of the only tab of a new browser."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        skip_or_fail(f"no browser is installed; wanted one of {', '.join(NAMES)} (Debian: apt-get install chromium)")
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
    until = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < until:
        assert process.poll() is None, f"the browser ended with status {process.returncode}"
        lines = port_file.read_text(encoding="ascii").split() if port_file.exists() else []
        if len(lines) == 2:
            return _first_page(f"ws://127.0.0.1:{lines[0]}{lines[1]}", f"ws://127.0.0.1:{lines[0]}/devtools/page/")
        time.sleep(0.05)
    raise AssertionError(f"the browser did not start within {START_TIMEOUT_S:g} s")


def _first_page(browser: str, pages: str) -> str:
    with connect(browser, **SOCKET_OPTIONS) as socket:
        targets = Page(socket).call("Target.getTargets")["targetInfos"]
    return pages + str(next(target["targetId"] for target in targets if target["type"] == "page"))
