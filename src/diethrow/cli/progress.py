"""Progress on standard error: one bar per stage, and the announcement of the first compilation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from .logs import is_quiet

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from ..commands.clip.batch import Standing

COUNTED = "compiling the kernels, once per installation"


@contextmanager
def progress_bars(first_run: str | None = None) -> Iterator[Callable[[str, int, int], None]]:
    """One bar per stage on standard error; nothing if that is not a terminal.

    `first_run` names what the list of kernels calls this command: on a first run, other cores compile with it, and one more bar
    counts the kernels.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from .compiling import shared_compilation

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<22}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    bars = Progress(*columns, TimeElapsedColumn(), console=console, disable=is_quiet() or not console.is_terminal)
    compilation = announcing() if first_run is None else shared_compilation(first_run, _compiled_in(bars))
    with bars, compilation:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                for earlier in tasks.values():
                    bars.update(earlier, total=1, completed=1)
                tasks[stage] = bars.add_task(stage, total=None)
            bars.update(tasks[stage], completed=done, total=total or None)

        yield report
        for task in tasks.values():
            bars.update(task, total=1, completed=1)


def _compiled_in(bars: Progress) -> Callable[[int, int], None]:
    """What reports the number of compiled kernels: in a bar, or in a line at the start and at each quarter."""
    tasks: list[TaskID] = []
    quarters = [-1]

    def report(done: int, total: int) -> None:
        if quarters == [-1]:
            tasks.append(bars.add_task("", total=total))
        bars.update(tasks[0], completed=done, description=f"Kernels {done} of {total}")
        quarter = 4 * done // max(total, 1)
        if quarter > quarters[0] and (bars.disable or quarter == 0):
            _announce(f"{COUNTED}: {done} of {total}")
        quarters[0] = max(quarter, quarters[0])

    return report


@contextmanager
def announcing() -> Iterator[None]:
    """Announce the compilation of kernels in one line."""
    from .compiling import announced

    with announced(_announce):
        yield


def _announce(sentence: str) -> None:
    if not is_quiet():
        typer.echo(f"diethrow: {sentence}", err=True)


def announce_for_workers() -> None:
    """Announce the compilation that the silent worker processes of this machine will do."""
    from .compiling import SENTENCE, is_compiled

    if not is_compiled():
        _announce(SENTENCE)


@contextmanager
def batch_bar() -> Iterator[Callable[[Standing], None]]:
    """A bar with the time left on standard error; one line per clip if that is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("Clips"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console, disable=is_quiet() or not console.is_terminal) as bars:
        clips = bars.add_task("", total=None)

        def report(standing: Standing) -> None:
            failed = f"{standing.failed} failed, " if standing.failed else ""
            left = "" if standing.left_s is None else f"about {_duration(standing.left_s)} left"
            bars.update(clips, completed=standing.done, total=standing.total, description=f"{failed}{left}")
            if not console.is_terminal and not is_quiet():
                line = f"{standing.done} of {standing.total} clips done, {failed}{left}".rstrip(", ")
                typer.echo(f"{line}: {standing.last}", err=True)

        yield report


def _duration(seconds: float) -> str:
    """`40 s`, `12 min`, `3.5 h`."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
