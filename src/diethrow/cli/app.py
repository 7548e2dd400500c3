"""The program `diethrow`: its name, its help and its version.

This package imports only typer at its top level. Each command imports what it computes with when it runs, so that
`diethrow --help` answers at once.
"""

from __future__ import annotations

from typing import Annotated

import typer

app = typer.Typer(
    name="diethrow",
    help="Experiment against simulation for high-speed footage of thrown dice.",
    epilog="Example:  diethrow analyze data_samples/cube_wood/scene.toml --out out/cube_wood",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """The program `diethrow`."""
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
) -> None:
    """Experiment against simulation for high-speed footage of thrown dice."""
