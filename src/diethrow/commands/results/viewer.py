"""The Rerun viewer, started without access to a network.

By default the viewer sends usage statistics, asks GitHub for a newer version, and listens on all network interfaces. The
environment made here turns the statistics off, directs every request to a port of this machine on which nothing listens,
and keeps the viewer from writing to the home folder. The options bind its servers to localhost.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

LOOPBACK = "127.0.0.1"
DEAD_PROXY = f"http://{LOOPBACK}:9"
"""Port 9 is the discard service: on most machines nothing listens there, on the others it discards everything."""
TELEMETRY_VARIABLES = (
    "FORCE_RERUN_ANALYTICS",
    "RERUN_TELEMETRY_ENDPOINT",
    "TELEMETRY_ENABLED",
    "OTEL_EXPORTER_OTLP_ENDPOINT",
)
"""Variables that would make the viewer send data in spite of `silent_environment`; they are removed."""


def viewer_program() -> list[str]:
    """The command of the viewer that is installed with this Python, independent of PATH; it keeps the exit status."""
    return [sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())"]


def viewer_options(port: int | None = None) -> list[str]:
    """Options of a viewer that listens on localhost only, on the given port or a free one."""
    return ["--bind", LOOPBACK, "--port", "auto" if port is None else str(port)]


def silent_environment() -> dict[str, str]:
    """The environment of a viewer that sends and fetches nothing.

    With `CI` the viewer assumes an automatic run: it collects no statistics and writes no configuration. The proxies
    catch all other requests; connections within this machine bypass them.
    """
    kept = {name: value for name, value in os.environ.items() if name not in TELEMETRY_VARIABLES}
    schemes = ("http_proxy", "https_proxy", "all_proxy")
    proxies = {name: DEAD_PROXY for proxy in schemes for name in (proxy, proxy.upper())}
    bypass = dict.fromkeys(("no_proxy", "NO_PROXY"), f"{LOOPBACK},localhost,::1")
    return {**kept, **proxies, **bypass, "CI": "1"}


def open_viewer(recordings: Sequence[Path]) -> None:
    """Show recordings in the viewer until it is closed.

    Raises FileNotFoundError for a missing recording, OSError if the viewer ends with an error.
    """
    for path in recordings:
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such recording; wanted the replay.rrd that analyze writes")
    command = [*viewer_program(), *viewer_options(), *map(str, recordings)]
    # The viewer's log about servers and graphics is shown only if the viewer ends with an error.
    done = subprocess.run(
        command, env=silent_environment(), stderr=subprocess.PIPE, text=True, errors="replace", check=False
    )
    if done.returncode:
        reason = failure_line(done.stderr)
        raise OSError(f"the viewer ended with status {done.returncode} ({reason}); it needs a screen and Vulkan")


def failure_line(log: str) -> str:
    """The line of the viewer's log that says why it ended: where it stopped itself, otherwise the last line."""
    lines = [line.strip() for line in log.splitlines() if line.strip()] or ["it gives no reason"]
    return next((line for line in lines if "panicked at" in line), lines[-1])
