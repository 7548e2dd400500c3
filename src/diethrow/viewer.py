"""The Rerun viewer, started so that it talks to nobody: no usage statistics, and servers that only this machine reaches.

The viewer that `rerun` starts sends statistics unless a file in the home folder forbids it, and listens on all network
interfaces. Here its configuration lies in a folder of its own that forbids them, the home folder is left alone, and
everything is bound to the loopback interface.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

LOOPBACK = "127.0.0.1"
_REMOTE = ("RERUN_TELEMETRY_ENDPOINT", "TELEMETRY_ENABLED", "FORCE_RERUN_ANALYTICS", "OTEL_EXPORTER_OTLP_ENDPOINT")
"""Variables that would have the viewer talk to somebody."""


def viewer_program() -> list[str]:
    """The viewer that was installed with this Python, whatever the PATH says; with the exit status of the viewer."""
    return [sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())"]


@contextmanager
def silent_environment() -> Iterator[dict[str, str]]:
    """The environment of a viewer without statistics.

    Two things forbid them, each alone: a configuration in a temporary folder that says so, and the variable `CI`, which
    the viewer takes for a run that nobody looks at; the second holds on systems whose configuration has a fixed place.
    """
    with tempfile.TemporaryDirectory(prefix="diethrow_viewer_", ignore_cleanup_errors=True) as home:
        folder = Path(home)
        settings = {
            "analytics_enabled": False,
            "analytics_id": "",
            "metadata": {},
            "config_file_path": str(folder / "rerun" / "analytics.json"),
            "data_dir_path": str(folder / "rerun" / "analytics"),
        }
        (folder / "rerun").mkdir()
        (folder / "rerun" / "analytics.json").write_text(json.dumps(settings), encoding="utf-8")
        kept = {name: value for name, value in os.environ.items() if name not in _REMOTE}
        yield {**kept, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "CI": "1"}


def open_viewer(recordings: Sequence[Path]) -> int:
    """Show recordings in the viewer until it is closed; its exit status. Raises FileNotFoundError for one that is missing."""
    for path in recordings:
        if not path.is_file():
            raise FileNotFoundError(f"{path}: there is no such recording; make it with --out first")
    with silent_environment() as environment:
        return _run([*viewer_options(), *map(str, recordings)], environment)


def viewer_options() -> list[str]:
    """Options of a viewer that only this machine reaches, on a port of its own."""
    return ["--bind", LOOPBACK, "--port", "auto"]


def _run(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    # What the viewer says of servers and graphics on its standard error is of no use to who looks at a throw.
    done = subprocess.run([*viewer_program(), *arguments], env=environment, stderr=subprocess.DEVNULL, check=False)
    return done.returncode
