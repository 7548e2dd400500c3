"""Mistakes on the command line, in one sentence like every other error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import typer
from typer.core import TyperGroup

from .errors import MISUSED, stop_with_status

# Some releases of Typer bring their own copy of Click and others take the installed one; this is the class of either.
_UsageError = cast("type[Exception]", typer.BadParameter.__bases__[0])


class Program(TyperGroup):
    """The commands of the program; a mistake in typing one of them ends it with one sentence and MISUSED."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words that belong to the command, after the options of the program are taken."""
        with _one_sentence():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Parse the words of the command, and run it."""
        with _one_sentence():
            return super().invoke(ctx)


@contextmanager
def _one_sentence() -> Iterator[None]:
    """Report a mistake on the command line with the command whose help lists what there is."""
    try:
        yield
    except _UsageError as error:
        # Without arguments a group shows its help.
        if type(error).__name__ == "NoArgsIsHelpError":
            raise
        mistake: Any = error
        sentence = " ".join(mistake.format_message().split()).rstrip(".")
        for said, better in ((". Did you", "; did you"), ("Value error, ", ""), ("Invalid value: ", "")):
            sentence = sentence.replace(said, better)
        where = "diethrow" if mistake.ctx is None else mistake.ctx.command_path
        stop_with_status(f"{sentence[:1].lower()}{sentence[1:]} (see {where} --help)", MISUSED)
