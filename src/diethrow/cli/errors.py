"""Failures of a command: one sentence on standard error, and an exit status.

A DiethrowError is a mistake in the input, or a run without a result, and an OSError one of the machine; its text is the sentence.
Any other exception, of numpy for example, is a fault of the program: it shows its traceback, and how to report it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer

from .printing import print_notices

FAILED = 1
"""Exit status of a run without a result."""
MISUSED = 2
"""Exit status of a mistake in a scene or on the command line."""
INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""
FAULT = (
    "diethrow: this is a fault of the program, not of your input; please report the lines below, with the command, "
    "`diethrow --version`, and the input if it can be shared"
)
RESUMABLE = "no output was left behind; --resume continues from the work done"
CLIPS_KEPT = "finished clips are kept; the same command continues with the others"


@contextmanager
def one_sentence_errors() -> Iterator[None]:
    """Report an error in one sentence and stop with its exit status; DIETHROW_TRACEBACK=1 shows the traceback."""
    try:
        yield
    except KeyboardInterrupt:
        stop_with_status("stopped; no output was left behind", INTERRUPTED)
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if isinstance(error, (SystemError, RuntimeError)) and _stems_from_interrupt(error):
            stop_with_status("stopped; no output was left behind", INTERRUPTED)
        if not _can_be_mended(error):
            typer.echo(FAULT, err=True)
            raise
        if os.environ.get("DIETHROW_TRACEBACK"):
            raise
        from ..files.outputs import OutputExistsError, OutputPlaceError
        from ..files.settings import SceneError

        print_notices(tuple(getattr(error, "__notes__", ())))
        misused = isinstance(error, (SceneError, OutputExistsError, OutputPlaceError))
        stop_with_status(" ".join(str(error).split()) or type(error).__name__, MISUSED if misused else FAILED)


def _can_be_mended(error: Exception) -> bool:
    """Whether the user can do something about it."""
    from ..executors import WorkerLostError
    from ..model.errors import DiethrowError

    return isinstance(error, (DiethrowError, OSError, WorkerLostError))


@contextmanager
def checked_options() -> Iterator[None]:
    """Report an impossible value of an option in one sentence and stop with MISUSED."""
    try:
        yield
    except ValueError as error:
        if not _can_be_mended(error):
            raise
        stop_with_status(" ".join(str(error).split()), MISUSED)


@contextmanager
def stopped_with(sentence: str) -> Iterator[None]:
    """Report after Ctrl-C what is kept of a long run, and how to continue it."""
    try:
        yield
    except KeyboardInterrupt:
        stop_with_status(f"stopped; {sentence}", INTERRUPTED)


def _stems_from_interrupt(error: BaseException) -> bool:
    """Whether the error is a consequence of Ctrl-C.

    A compiled kernel turns it into a chain of SystemErrors. During compilation LLVM's callback may swallow it, and numba then
    misses the object code that the callback should have passed on.
    """
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt) or "no compiled object yet" in str(error)


def stop_with_status(sentence: str, status: int) -> NoReturn:
    typer.echo(f"diethrow: {sentence}", err=True)
    raise typer.Exit(status)
