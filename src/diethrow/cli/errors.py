"""cli.errors."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

import typer

from .printing import print_notices

if TYPE_CHECKING:
    pass


FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit status: the run gave no result; the scene or the command line is wrong; Ctrl-C."""


@contextmanager
def one_sentence_errors() -> Iterator[None]:
    """Tell an error in one sentence, with its exit status; DIETHROW_TRACEBACK=1 shows where it came from."""
    try:
        yield
    except KeyboardInterrupt:
        stop_with_status("stopped; no output was left behind", INTERRUPTED)
    except (SystemError, RuntimeError) as error:
        if not _stems_from_interrupt(error):
            raise
        stop_with_status("stopped; no output was left behind", INTERRUPTED)
    except (ValueError, OSError) as error:
        if os.environ.get("DIETHROW_TRACEBACK"):
            raise
        from ..files.outputs import OutputExistsError, OutputPlaceError
        from ..files.settings import SceneError

        print_notices(tuple(getattr(error, "__notes__", ())))
        misused = isinstance(error, (SceneError, OutputExistsError, OutputPlaceError))
        stop_with_status(" ".join(str(error).split()) or type(error).__name__, MISUSED if misused else FAILED)


@contextmanager
def options_that_fit() -> Iterator[None]:
    """An option that cannot be is told in one sentence, with the status of a misused command."""
    try:
        yield
    except ValueError as error:
        stop_with_status(" ".join(str(error).split()), MISUSED)


@contextmanager
def that_can_go_on() -> Iterator[None]:
    """A long run that is stopped leaves its work file, and says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        stop_with_status("stopped; no output was left behind, and --resume goes on with what was done", INTERRUPTED)


@contextmanager
def whose_finished_clips_stay() -> Iterator[None]:
    """A batch that is stopped keeps what is finished, and says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        stop_with_status("stopped; what is finished stays, and the same command does the rest", INTERRUPTED)


def _stems_from_interrupt(error: BaseException) -> bool:
    """Whether this is Ctrl-C in disguise: within a compiled kernel it comes out as a chain of SystemErrors; while a kernel
    is compiled, LLVM's callback may swallow it, and numba then misses the code that the callback should have handed on."""
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt) or "no compiled object yet" in str(error)


def stop_with_status(sentence: str, status: int) -> NoReturn:
    typer.echo(f"diethrow: {sentence}", err=True)
    raise typer.Exit(status)
