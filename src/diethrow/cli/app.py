"""The program `diethrow`: its name, its help and its version.

This package imports only typer at its top level. Each command imports what it computes with when it runs, so that
`diethrow --help` answers at once.
"""

from __future__ import annotations

import atexit
import gc
from typing import Annotated

import typer

from .logs import log_to_stderr
from .usage import Program

app = typer.Typer(
    name="diethrow",
    cls=Program,
    help="Experiment against simulation for high-speed footage of thrown dice.",
    epilog="Example:  diethrow analyze data_samples/cube_wood/scene.toml --out out/cube_wood",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


COLLECTION_THRESHOLDS = (100_000, 20, 100)
"""Of Python's garbage collector. The libraries make objects that live until the end, and to look through them again and again
takes half a second of an analysis; frames and arrays are freed without it."""


def main() -> None:
    """The program `diethrow`."""
    gc.set_threshold(*COLLECTION_THRESHOLDS)
    atexit.register(
        gc.freeze
    )  # at the end nothing needs collecting: the system takes all memory back, half a second sooner
    app(prog_name="diethrow")


def _print_version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        typer.echo(f"diethrow {__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", "-v", help="Log every stage with its time, before the command: diethrow -v analyze ..."
        ),
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no notes; errors alone.")] = False,
) -> None:
    """Experiment against simulation for high-speed footage of thrown dice."""
    log_to_stderr(verbose, quiet)
