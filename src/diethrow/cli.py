"""The command line: parse, call, print.

Only typer is imported here. What computes is imported inside the commands, so that `--help` answers at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

if TYPE_CHECKING:
    from .analyze import Analysis
    from .fitting.results import Parameter

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit status: the run gave no result; the scene or the command line is wrong; Ctrl-C."""

app = typer.Typer(
    name="diethrow",
    help="Experiment against simulation for high-speed footage of thrown dice.",
    epilog="Example:  diethrow analyze data_samples/cube_wood/scene.toml --out out/cube_wood",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="The scene file: clip, camera, table and die.")]
OutFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to make.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the folder if it exists, once the new one is complete.")]


def main() -> None:
    """The program `diethrow`."""
    app(prog_name="diethrow")


def _print_version(wanted: bool) -> None:
    if wanted:
        from . import __version__

        typer.echo(f"diethrow {__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Experiment against simulation for high-speed footage of thrown dice."""


@app.command(epilog="Example:  diethrow analyze clips/cube_wood/scene.toml --out out/cube_wood")
def analyze(scene: SceneFile, out: OutFolder, force: Force = False) -> None:
    """From clip to replay: track the die, find its bounces, fit the model, write tables, a recording and a report."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene)  # before the stages are imported: a mistake in a scene is told at once
        from .analyze import analyze as analyze_scene

        with _progress() as progress:
            command = _command("analyze", scene, out, force)
            result = analyze_scene(checked, out, force=force, progress=progress, command=command)
        _print_analysis(result)


@app.command(epilog="Example:  diethrow track clips/cube_wood/scene.toml --out out/track")
def track(scene: SceneFile, out: OutFolder, force: Force = False) -> None:
    """The tracking stage alone: poses with covariances, and bounces."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene)
        from .analyze import track_only

        with _progress() as progress:
            command = _command("track", scene, out, force)
            result = track_only(checked, out, force=force, progress=progress, command=command)
        _print_notices(result.notices)
        tracked, total = int(result.frames.tracked.sum()), len(result.frames)
        typer.echo(f"{tracked} of {total} frames tracked, {len(result.measured.impacts)} bounces; see {out}")


@app.command(
    epilog="Example:  diethrow fit out/track/track_frames.csv --scene clips/cube_wood/scene.toml --out out/fit"
)
def fit(
    track_csv: Annotated[Path, typer.Argument(metavar="TRACK.csv", help="A track; its covariances lie beside it.")],
    scene: Annotated[Path, typer.Option("--scene", metavar="SCENE", help="The scene file; only die and table count.")],
    out: OutFolder,
    force: Force = False,
) -> None:
    """The fitting stage alone, on any track with the columns of track.csv."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene)
        from .analyze import fit_track

        command = ("diethrow", "fit", str(track_csv), "--scene", str(scene), *_options(out, force))
        with _progress() as progress:
            result = fit_track(track_csv, checked, out, force=force, progress=progress, command=command)
        _print_analysis(result)


@app.command(epilog="Example:  diethrow throw throw.toml --out out/throw")
def throw(
    plan: Annotated[Path, typer.Argument(metavar="THROW.toml", help="The throw file: die, law, release and end.")],
    out: OutFolder,
    force: Force = False,
) -> None:
    """Simulate one throw from its initial conditions to its end."""
    with _one_sentence_errors():
        from .plan import read_plan

        checked = read_plan(plan)
        from .throw import throw as simulate

        result = simulate(checked, out, force=force, command=_command("throw", plan, out, force))
        face = "open" if result.landed_face is None else result.landed_face
        typer.echo(f"{result.impact_count} impacts, landed face {face}. {result.ending.value}")
        typer.echo(f"Look at it:  rerun {out / 'replay.rrd'}")


@contextmanager
def _one_sentence_errors() -> Iterator[None]:
    """Tell an error in one sentence, with its exit status; DIETHROW_TRACEBACK=1 shows where it came from."""
    try:
        yield
    except KeyboardInterrupt:
        _stop("stopped; no output was left behind", INTERRUPTED)
    except SystemError as error:
        if not _stems_from_interrupt(error):
            raise
        _stop("stopped; no output was left behind", INTERRUPTED)
    except (ValueError, OSError) as error:
        if os.environ.get("DIETHROW_TRACEBACK"):
            raise
        from .outputs import OutputExistsError, OutputPlaceError
        from .settings import SceneError

        _print_notices(tuple(getattr(error, "__notes__", ())))
        misused = isinstance(error, (SceneError, OutputExistsError, OutputPlaceError))
        _stop(" ".join(str(error).split()) or type(error).__name__, MISUSED if misused else FAILED)


def _stems_from_interrupt(error: BaseException) -> bool:
    """Whether this is Ctrl-C in disguise: within a compiled kernel it comes out as a chain of SystemErrors."""
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


def _stop(sentence: str, status: int) -> NoReturn:
    typer.echo(f"diethrow: {sentence}", err=True)
    raise typer.Exit(status)


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each stage on standard error; nothing where that is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<22}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    with Progress(*columns, TimeElapsedColumn(), console=console, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                for earlier in tasks.values():
                    bars.update(earlier, total=1, completed=1)
                tasks[stage] = bars.add_task(stage, total=None)
            bars.update(tasks[stage], completed=done, total=total or None)

        yield tell
        for task in tasks.values():
            bars.update(task, total=1, completed=1)


def _print_analysis(result: Analysis) -> None:
    """What came out, in a few lines."""
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("frames tracked", f"{int(result.track.tracked.sum())} of {len(result.track)}")
    table.add_row("bounces", f"{len(result.measured.impacts)}, of which the model explains {result.fit.bounces_fitted}")
    table.add_row("restitution χ", _restitution(result.fit.parameters["chi"]))
    if result.fit.residual_rms is not None:
        table.add_row("residuals", f"{result.fit.residual_rms:.2f} sigma")
    table.add_row("report", str(result.folder / "report.html"))
    table.add_row("look at it", f"rerun {result.folder / 'replay.rrd'}")
    Console(highlight=False, markup=False, soft_wrap=True).print(table)
    _print_notices((*result.notices, *result.fit.messages))


def _restitution(chi: Parameter) -> str:
    """The value with its interval, in as many digits as the interval bears."""
    if chi.value is None:
        return "not determined"
    if chi.low is None or chi.high is None or chi.level is None:
        return f"{chi.value:.4f}, no interval"
    width = chi.high - chi.low
    digits = 4 if width <= 0 else min(max(3, 1 - floor(log10(width))), 9)
    return f"{chi.value:.{digits}f}  ({100 * chi.level:.0f} %: {chi.low:.{digits}f} to {chi.high:.{digits}f})"


def _print_notices(sentences: tuple[str, ...]) -> None:
    for sentence in sentences:
        typer.echo(f"note: {sentence}", err=True)


def _command(name: str, file: Path, out: Path, force: bool) -> tuple[str, ...]:
    return ("diethrow", name, str(file), *_options(out, force))


def _options(out: Path, force: bool) -> tuple[str, ...]:
    return ("--out", str(out), *(("--force",) if force else ()))


if __name__ == "__main__":
    main()
