"""The Rerun viewer, started so that it talks to nobody.

By itself the viewer sends usage statistics, asks GitHub for a newer version, and listens on all network interfaces. The
environment made here turns the first off, leads whatever it would fetch to a port of this machine where nobody answers,
and leaves the home folder alone; the options bind its servers to the loopback interface.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

LOOPBACK = "127.0.0.1"
NOBODY = f"http://{LOOPBACK}:9"
"""Port 9 discards, on the few machines where anything listens there at all."""
TALKATIVE = ("FORCE_RERUN_ANALYTICS", "RERUN_TELEMETRY_ENDPOINT", "TELEMETRY_ENABLED", "OTEL_EXPORTER_OTLP_ENDPOINT")
"""Variables that would have the viewer talk to somebody all the same."""


def viewer_program() -> list[str]:
    """The viewer that was installed with this Python, whatever the PATH says; with the exit status of the viewer."""
    return [sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())"]


def viewer_options(port: int | None = None) -> list[str]:
    """Options of a viewer that only this machine reaches, on a port of its own."""
    return ["--bind", LOOPBACK, "--port", "auto" if port is None else str(port)]


def silent_environment() -> dict[str, str]:
    """The environment of a viewer that sends and fetches nothing.

    `CI` is what the viewer takes for a run that nobody looks at: then it keeps no statistics, and writes no
    configuration. The proxies are for what it asks for besides; connections within this machine need none.
    """
    kept = {name: value for name, value in os.environ.items() if name not in TALKATIVE}
    proxies = {name: NOBODY for proxy in ("http_proxy", "https_proxy", "all_proxy") for name in (proxy, proxy.upper())}
    within = dict.fromkeys(("no_proxy", "NO_PROXY"), f"{LOOPBACK},localhost,::1")
    return {**kept, **proxies, **within, "CI": "1"}


def open_viewer(recordings: Sequence[Path]) -> None:
    """Show recordings in the viewer until it is closed.

    Raises FileNotFoundError for a recording that is missing, OSError where the viewer does not open.
    """
    for path in recordings:
        if not path.is_file():
            raise FileNotFoundError(f"{path}: there is no such recording; wanted the replay.rrd that analyze writes")
    command = [*viewer_program(), *viewer_options(), *map(str, recordings)]
    # What the viewer says of servers and graphics is of no use to who looks at a throw, unless it ends with an error.
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
