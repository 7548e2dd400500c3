"""The Rerun viewer without a screen, natively and in a browser, with the requests that tests make.

Both need programs from outside Python: a Vulkan driver (Debian's mesa-vulkan-drivers draws without a GPU) and Chromium.
If one is not installed, the tests are skipped; with DIETHROW_NEEDS_VIEWERS set, they fail.
"""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from browser import skip_or_fail
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from diethrow.commands.results.viewer import (
    LOOPBACK,
    failure_line,
    silent_environment,
    viewer_options,
    viewer_program,
)

WINDOW_PX = (960, 640)
TIMEOUT_S = 60.0
"""Drawing takes seconds on an idle core, and many times that on a busy machine."""


def require_graphics() -> None:
    """Skip the test (or fail it, see `skip_or_fail`) if the viewer cannot draw even its empty window on this machine.

    The viewer starts with OpenGL alone, and ends at its first frame if no Vulkan driver is installed.
    """
    reason = _why_nothing_is_drawn()
    if reason is not None:
        skip_or_fail(f"the viewer cannot draw here ({reason}); install a Vulkan driver (Debian: mesa-vulkan-drivers)")


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
                timeout=TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"no picture within {TIMEOUT_S:g} s"
        return None if shot.exists() else failure_line(done.stderr)


def image_of(png: bytes) -> NDArray[np.float32]:
    """(height, width, 3) image, 0 to 1."""
    return np.asarray(matplotlib.image.imread(io.BytesIO(png), format="png")[..., :3])


def free_port() -> int:
    """A free port of this machine."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def wait_for(attempt: Callable[[], Any], what: str) -> Any:
    """The first result of `attempt` that is neither None nor an error. Fails the test after TIMEOUT_S."""
    end, last = time.monotonic() + TIMEOUT_S, None
    while time.monotonic() < end:
        try:
            last = attempt()
            if last is not None:
                return last
        except (ConnectionError, RuntimeError, TimeoutError, OSError) as error:
            last = error
        time.sleep(0.1)
    pytest.fail(f"{what}: not within {TIMEOUT_S:.0f} s; the last result was {last!r}")


@contextmanager
def running(
    command: Sequence[str], log: Path, environment: dict[str, str], **more: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """A program that is ended with the block, with all its children; its output goes to `log`."""
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=environment, start_new_session=True, **more
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
    options = ["--headless", *viewer_options(port), "--window-size", f"{WINDOW_PX[0]}x{WINDOW_PX[1]}"]
    command = [*viewer_program(), *options, *map(str, recordings)]
    with running(command, log, silent_environment()) as process:

        def ready() -> ViewerClient | None:
            if process.poll() is not None:
                require_graphics()
                pytest.fail(f"the viewer ended with status {process.returncode}: {log.read_text(errors='replace')}")
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            state = client.get_state()
            return client if len(state.recordings) == len(recordings) and not state.loading else None

        yield wait_for(ready, "the viewer loads the recordings")


def tabs_of(client: ViewerClient) -> dict[str, str]:
    """The id of every tab by its name, in order."""
    views = client.get_blueprint().blueprint
    root = _tabs(views)
    found = {}
    for identity in views[root]["ContainerBlueprint"]["contents"]:
        part = views["/" + identity]
        content = part.get("ContainerBlueprint") or part["ViewBlueprint"]
        found[str(content["display_name"])] = str(identity)
    return found


def show_tab(client: ViewerClient, identity: str) -> None:
    """Activate a tab."""
    views = client.get_blueprint().blueprint
    views[_tabs(views)]["ContainerBlueprint"]["active_tab"] = identity
    client.set_blueprint(views, of="recording")


def _tabs(views: dict[str, Any]) -> str:
    """The outermost container of tabs."""
    root = views["/viewport"]["ViewportBlueprint"]["root_container"]
    return "/container/" + str(root).removeprefix("container/").removeprefix("/container/")


# --- the web viewer ---


@contextmanager
def web_viewer(recording: Path, folder: Path) -> Iterator[str]:
    """The address of the web viewer with one recording, served on localhost only."""
    port, page_port = free_port(), free_port()
    options = ["--serve-web", *viewer_options(port), "--web-viewer-port", str(page_port)]
    command = [*viewer_program(), *options, str(recording)]
    with running(command, folder / "server.log", silent_environment()):
        wait_for(lambda: _answers(page_port) and _answers(port), "the web viewer is served")
        yield f"http://{LOOPBACK}:{page_port}/?url=rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"


def _answers(port: int) -> bool:
    with socket.create_connection((LOOPBACK, port), timeout=1.0):
        return True
