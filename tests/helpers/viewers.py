"""The real viewer without a screen, natively and in a browser, and what either has to be asked in a test.

Both need programs from outside Python: a Vulkan driver (Debian's mesa-vulkan-drivers draws without a GPU) and Chromium.
If one is not installed, the tests are skipped; with DIETHROW_NEEDS_VIEWERS set, they fail.
"""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

import matplotlib.image
import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from diethrow.commands.results.viewer import (
    LOOPBACK,
    failure_line,
    silent_environment,
    viewer_options,
    viewer_program,
)

NEEDED = "DIETHROW_NEEDS_VIEWERS"
WINDOW = (960, 640)
PATIENCE_S = 60.0
"""Drawing takes seconds on one core that nothing else wants, and many times that on a busy machine."""


def missing(what: str) -> NoReturn:
    """Skip the test, or fail it where viewers are demanded."""
    if os.environ.get(NEEDED):
        pytest.fail(f"{what}, and {NEEDED} is set")
    pytest.skip(what)


def require_graphics() -> None:
    """Skip the test (or fail it, see `missing`) if the viewer cannot draw even its empty window on this machine.

    The viewer starts with OpenGL alone, and ends at its first frame if no Vulkan driver is installed.
    """
    reason = _why_nothing_is_drawn()
    if reason is not None:
        missing(f"the viewer cannot draw here ({reason}); install a Vulkan driver (Debian: mesa-vulkan-drivers)")


@cache
def _why_nothing_is_drawn() -> str | None:
    """Why the viewer cannot take a picture of its empty window; None if it can."""
    with TemporaryDirectory() as folder:
        shot = Path(folder) / "empty.png"
        options = ["--headless", "--window-size", "320x240", "--screenshot-to", str(shot), *viewer_options()]
        try:
            done = subprocess.run(
                [*viewer_program(), *options],
                env=silent_environment(),
                capture_output=True,
                text=True,
                errors="replace",
                timeout=PATIENCE_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"no picture within {PATIENCE_S:g} s"
        return None if shot.exists() else failure_line(done.stderr)


def picture(png: bytes) -> NDArray[np.float32]:
    """(height, width, 3) in 0 to 1."""
    return np.asarray(matplotlib.image.imread(io.BytesIO(png), format="png")[..., :3])


def free_port() -> int:
    with socket.socket() as own:
        own.bind((LOOPBACK, 0))
        return int(own.getsockname()[1])


def until(true: Callable[[], Any], what: str) -> Any:
    """What `true` returns once it is neither None nor an error. Fails the test when patience ends."""
    end, last = time.monotonic() + PATIENCE_S, None
    while time.monotonic() < end:
        try:
            last = true()
            if last is not None:
                return last
        except (ConnectionError, RuntimeError, TimeoutError, OSError) as error:
            last = error
        time.sleep(0.1)
    pytest.fail(f"{what}: not within {PATIENCE_S:.0f} s; the last answer was {last!r}")


@contextmanager
def running(
    command: Sequence[str], log: Path, environment: dict[str, str], **more: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """A program and all that it starts, ended with the block; what it says goes to `log`."""
    with log.open("wb") as said:
        process = subprocess.Popen(
            command, stdout=said, stderr=subprocess.STDOUT, env=environment, start_new_session=True, **more
        )
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


# --- the native viewer ---


@contextmanager
def native_viewer(recordings: Sequence[Path], folder: Path) -> Iterator[ViewerClient]:
    """The viewer with these recordings loaded, without a window."""
    port, log = free_port(), folder / "viewer.log"
    options = ["--headless", *viewer_options(port), "--window-size", f"{WINDOW[0]}x{WINDOW[1]}"]
    command = [*viewer_program(), *options, *map(str, recordings)]
    with running(command, log, silent_environment()) as process:

        def ready() -> ViewerClient | None:
            if process.poll() is not None:
                require_graphics()
                pytest.fail(f"the viewer ended with status {process.returncode}: {log.read_text(errors='replace')}")
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            state = client.get_state()
            return client if len(state.recordings) == len(recordings) and not state.loading else None

        yield until(ready, "the viewer loads the recordings")


def tabs_of(client: ViewerClient) -> dict[str, str]:
    """The identity of every tab by its name, in order."""
    views = client.get_blueprint().blueprint
    root = _tabs(views)
    found = {}
    for identity in views[root]["ContainerBlueprint"]["contents"]:
        part = views["/" + identity]
        content = part.get("ContainerBlueprint") or part["ViewBlueprint"]
        found[str(content["display_name"])] = str(identity)
    return found


def show_tab(client: ViewerClient, identity: str) -> None:
    views = client.get_blueprint().blueprint
    views[_tabs(views)]["ContainerBlueprint"]["active_tab"] = identity
    client.set_blueprint(views, of="recording")


def _tabs(views: dict[str, Any]) -> str:
    """The outermost container of tabs."""
    root = views["/viewport"]["ViewportBlueprint"]["root_container"]
    return "/container/" + str(root).removeprefix("container/").removeprefix("/container/")


# --- the browser ---

WIRE = """
import os, sys
orders, answers = (os.dup(int(end)) for end in sys.argv[1:3])
os.dup2(orders, 3), os.dup2(answers, 4)
os.set_inheritable(3, True), os.set_inheritable(4, True)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Chromium reads its orders from descriptor 3 and answers on 4."""

ONLY_ERRORS = """
window.wrong = [];
console.error = (...words) => window.wrong.push(words.map(String).join(" "));
window.addEventListener("error", event => window.wrong.push(String(event.message)));
window.addEventListener("unhandledrejection", event => window.wrong.push(String(event.reason)));
console.log = console.info = console.debug = console.warn = console.trace = () => {};
"""
"""The viewer says thousands of things while it loads, and passing them on takes longer than drawing."""


@dataclass
class Page:
    """One page of a headless Chromium, driven through its debugging pipe."""

    write: int
    read: int
    session: str | None = None
    events: list[dict[str, Any]] = field(default_factory=list)
    _count: Iterator[int] = field(default_factory=lambda: itertools.count(1))
    _rest: bytes = b""

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol and wait for its answer; events on the way are kept."""
        number = next(self._count)
        call: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self.session is not None:
            call["sessionId"] = self.session
        os.write(self.write, json.dumps(call).encode() + b"\0")
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            for message in self.listen(0.2):
                if message.get("id") == number:
                    if "error" in message:
                        raise RuntimeError(f"{method}: {message['error']}")
                    return dict(message["result"])
        raise TimeoutError(f"{method}: no answer within {PATIENCE_S:.0f} s")

    def listen(self, seconds: float) -> list[dict[str, Any]]:
        """The messages that come within some time; those that answer nothing are events."""
        with selectors.DefaultSelector() as waiting:
            waiting.register(self.read, selectors.EVENT_READ)
            if waiting.select(seconds):
                heard = os.read(self.read, 1 << 20)
                if not heard:
                    pytest.fail("Chromium ended; see chromium.log")
                self._rest += heard
        *whole, self._rest = self._rest.split(b"\0")
        messages = [json.loads(part) for part in whole]
        self.events += [message for message in messages if "method" in message]
        return messages

    def screenshot(self) -> bytes:
        """PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot")["data"])

    def click(self, x: int, y: int) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def errors(self) -> list[str]:
        """What went wrong: errors on the console, exceptions, and what could not be loaded."""
        found = self.ask("Runtime.evaluate", expression="JSON.stringify(window.wrong || [])")
        entries = [event["params"]["entry"] for event in self.events if event["method"] == "Log.entryAdded"]
        logged = [f"{entry['text']} {entry.get('url', '')}" for entry in entries if entry["level"] == "error"]
        return [*json.loads(found["result"]["value"]), *logged]


@contextmanager
def browser_page(folder: Path) -> Iterator[Page]:
    """A page of a Chromium that reaches no other machine."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        missing("Chromium is not installed (Debian: chromium)")
    to_browser, from_browser = os.pipe(), os.pipe()
    options = [
        "--headless=new",
        "--no-sandbox",
        "--remote-debugging-pipe",
        f"--user-data-dir={folder / 'chromium'}",
        f"--window-size={WINDOW[0]},{WINDOW[1]}",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--ignore-gpu-blocklist",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-dev-shm-usage",
        f"--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE {LOOPBACK}",
    ]
    passed = (to_browser[0], from_browser[1])
    command = [sys.executable, "-c", WIRE, *map(str, passed), program, *options]
    with running(command, folder / "chromium.log", dict(os.environ), pass_fds=passed):
        for end in passed:
            os.close(end)
        page = Page(to_browser[1], from_browser[0])
        try:
            target = page.ask("Target.createTarget", url="about:blank")["targetId"]
            page.session = page.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Log"):
                page.ask(f"{domain}.enable")
            page.ask("Page.addScriptToEvaluateOnNewDocument", source=ONLY_ERRORS)
            size = {"width": WINDOW[0], "height": WINDOW[1], "deviceScaleFactor": 1, "mobile": False}
            page.ask("Emulation.setDeviceMetricsOverride", **size)
            yield page
        finally:
            os.close(to_browser[1])
            os.close(from_browser[0])


@contextmanager
def web_viewer(recording: Path, folder: Path) -> Iterator[str]:
    """The address of the viewer in the browser, serving one recording to this machine alone."""
    port, page_port = free_port(), free_port()
    options = ["--serve-web", *viewer_options(port), "--web-viewer-port", str(page_port)]
    command = [*viewer_program(), *options, str(recording)]
    with running(command, folder / "server.log", silent_environment()):
        until(lambda: _answers(page_port) and _answers(port), "the web viewer is served")
        yield f"http://{LOOPBACK}:{page_port}/?url=rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"


def _answers(port: int) -> bool:
    with socket.create_connection((LOOPBACK, port), timeout=1.0):
        return True
