"""What a command says beside its result: the package logs, and this sends its log to standard error.

Libraries log and never print. Notes of a run are warnings, stages with their times are information.
"""

from __future__ import annotations

import logging

import typer

LOGGER = logging.getLogger("diethrow")


class _ToStderr(logging.Handler):
    """One line a record, on the standard error of the moment: tests replace it."""

    def emit(self, record: logging.LogRecord) -> None:
        word = "note: " if record.levelno == logging.WARNING else "diethrow: "
        typer.echo(f"{word}{record.getMessage()}", err=True)


def log_to_stderr(verbose: bool, quiet: bool) -> None:
    """Show notes; with `verbose` also stages, with `quiet` neither. Raises typer.BadParameter for both."""
    if verbose and quiet:
        raise typer.BadParameter("-v and -q: wanted one of the two")
    if not any(isinstance(handler, _ToStderr) for handler in LOGGER.handlers):
        LOGGER.addHandler(_ToStderr())
    LOGGER.propagate = False
    LOGGER.setLevel(logging.INFO if verbose else logging.ERROR if quiet else logging.WARNING)


def is_quiet() -> bool:
    """Whether notes and progress are unwanted."""
    return LOGGER.level >= logging.ERROR
