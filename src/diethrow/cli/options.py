"""Options that several commands share, and the values that they stand for."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from .progress import progress_bars

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..files.scene import Scene
    from ..fitting.results import Choices, IntervalMethod
    from ..model.die import Die

R = TypeVar("R")


SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="The scene file: clip, camera, table and die.")]
ThrowFile = Annotated[Path, typer.Argument(metavar="THROW.toml", help="The throw file: die, law, release and end.")]
DieAndTable = Annotated[
    Path, typer.Option("--scene", metavar="SCENE", help="The scene file; only its die and table are used.")
]
Threads = Annotated[int | None, typer.Option("--threads", min=1, help="Number of threads. [default: one per core]")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Work on a Dask cluster, tcp://host:port of its scheduler; needs pip install 'diethrow[distributed]'.",
    ),
]
AllowOutside = Annotated[bool, typer.Option("--allow-outside", help="Allow files outside the scene's own folder.")]
OutFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Output folder; must not exist yet.")]
Fineness = Annotated[
    Literal["fast", "standard", "fine"],
    typer.Option(
        "--quality",
        help="fast: every frame once, edges only; standard: twice, with surface marks; fine: as standard, with more steps.",
    ),
]
Every = Annotated[int, typer.Option("--every", min=1, metavar="N", help="Use every N-th frame.")]
Shrink = Annotated[int, typer.Option("--shrink", min=1, metavar="F", help="Average F × F pixels into one.")]
FrameTiming = Annotated[
    Literal["corrected", "as-filmed"],
    typer.Option(
        "--timing",
        help="corrected: missing, doubled and frozen frames that the motion shows with certainty get their true times.",
    ),
]
Intervals = Annotated[
    Literal["profile", "covariance", "bootstrap"],
    typer.Option(
        "--intervals",
        help="Source of the intervals: the profile likelihood, the covariance, or a bootstrap of the residuals.",
    ),
]
MisfitLimit = Annotated[
    float | None,
    typer.Option(
        "--misfit-limit",
        metavar="RATIO",
        help="A bounce is explained while the frames behind it lie at most so many times as far from the model as they scatter, "
        "1.5 to 4. [default: 2.5]",
    ),
]
UsualFriction = Annotated[
    str | None,
    typer.Option(
        "--usual-friction",
        metavar="MU|none",
        help="Where the frames allow any friction above a limit, the fitted value nearest to this is reported; none: that of the "
        "least cost. [default: 0.3]",
    ),
]
EffectsOnTrial = Annotated[
    str | None,
    typer.Option(
        "--effects",
        metavar="NAMES|none",
        help='Only these effects are tried, with commas between them: "friction,rounded corners". [default: all]',
    ),
]
Squares = Annotated[str, typer.Option("--squares", metavar="CxR", help="Squares along columns and rows of the board.")]
BoardKind = Annotated[Literal["charuco", "chessboard"], typer.Option("--board", help="What is printed.")]
MarkerSide = Annotated[float | None, typer.Option("--marker-mm", metavar="MM", help="Side of a marker; ChArUco only.")]
MarkerDictionary = Annotated[str, typer.Option("--dictionary", help="OpenCV's name of the markers' dictionary.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing output once the new one is complete.")]
EmbedReplay = Annotated[
    bool,
    typer.Option("--embed-replay", help="Embed the viewer and the recording in report.html: 20 MB, needs no network."),
]
Figures = Annotated[bool, typer.Option("--figures", help="Also write the report's figures as PNG and SVG to figures/.")]


DieFile = Annotated[
    Path | None,
    typer.Option(
        "--die", metavar="FILE", help="A scene or throw file, or any other with a [die] table: a die of any shape."
    ),
]
Shape = Annotated[
    Literal["tetrahedron", "cube", "octahedron", "dodecahedron", "icosahedron"] | None,
    typer.Option(
        "--shape",
        help="Of the die; for any other see --die. [default: cube; of basins: tetrahedron]",
    ),
]
Edge = Annotated[
    float | None, typer.Option("--edge", metavar="M", help="Edge of the die [m]. [default: 0.02; of basins: 0.040793]")
]
Mass = Annotated[float | None, typer.Option("--mass", metavar="KG", help="Mass of the die [kg]. [default: 0.016]")]
Mu = Annotated[float | None, typer.Option("--mu", help="Coulomb friction coefficient. [default: smooth impact]")]
Drag = Annotated[float, typer.Option("--drag", metavar="K", help="Air drag k of -k |v| v [1/m]; a light die has 0.03.")]
Amplitude = Annotated[float, typer.Option("--amplitude", metavar="M", help="Amplitude of the table's oscillation [m].")]
Frequency = Annotated[float, typer.Option("--frequency", metavar="HZ", help="Frequency of the oscillation [Hz].")]
Phase = Annotated[float, typer.Option("--phase", metavar="RAD", help="Phase of the oscillation at release [rad].")]
ChiWithin = Annotated[
    float | None,
    typer.Option("--chi-within", metavar="WIDTH", help="Use the fastest setting whose 95 % interval of χ is ± WIDTH."),
]
TradeFile = Annotated[
    Path | None,
    typer.Option("--trade", metavar="TRADE.json", help="Measurements of diethrow trade on a similar scene."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue a stopped run with the same settings.")]


USUAL_MASS_KG = 0.016


def chosen_die(
    file: Path | None,
    shape: str | None,
    edge_m: float | None,
    mass_kg: float | None,
    usual: tuple[str, float] = ("cube", 0.02),
) -> tuple[Die, tuple[Path, ...]]:
    """The die of a file with the files that describe it, or of a shape with its edge and mass. Raises ValueError for both, and
    for an impossible die."""
    if file is None:
        from ..model.die import make_die

        mass_kg = USUAL_MASS_KG if mass_kg is None else mass_kg
        return make_die(shape or usual[0], usual[1] if edge_m is None else edge_m, mass_kg), ()
    given = [name for name, value in (("--shape", shape), ("--edge", edge_m), ("--mass", mass_kg)) if value is not None]
    if given:
        raise _impossible(
            f"{given[0]} beside --die: wanted one of the two, since the file gives shape, lengths and mass"
        )
    from ..files.die_and_table import read_die

    return read_die(file)


@contextmanager
def executor_for(scheduler: str | None) -> Iterator[Executor | None]:
    """An executor on the Dask cluster of that scheduler; None without a scheduler."""
    if scheduler is None:
        yield None
        return
    from ..executors import cluster_at

    with cluster_at(scheduler) as executor:
        yield executor


def run_on(scheduler: str | None, command: Callable[..., R], *inputs: Any, threads: int | None, **options: Any) -> R:
    """The result of a command, with progress bars, on the cores of this machine or on the cluster of that scheduler."""
    with executor_for(scheduler) as executor, progress_bars() as progress:
        workers = {"threads": threads or usable_cores(), "executor": executor}
        return command(*inputs, **workers, progress=progress, command=as_typed(), **options)


def checked_scene(path: Path, allow_outside: bool) -> Scene:
    """The scene of a file, read before the stages are imported, so that a mistake in it is reported at once."""
    from ..files.scene import read_scene

    return read_scene(path, allow_outside=allow_outside)


def two_counts(name: str, text: str) -> tuple[int, int]:
    """`7x5` as two numbers. Raises ValueError, naming the option, for any other text."""
    first, cross, second = text.lower().replace("×", "x").partition("x")
    if not (cross and first.strip().isdecimal() and second.strip().isdecimal()):
        raise _impossible(f"{name} = {text}; wanted two whole numbers with an x between them, as in 7x5")
    return int(first), int(second)


def usable_cores() -> int:
    """Number of cores that this process may use."""
    from ..executors import cores

    return cores()


def as_typed() -> tuple[str, ...]:
    """The command line."""
    return ("diethrow", *sys.argv[1:])


def choices_of(
    intervals: IntervalMethod, misfit_limit: float | None, usual_friction: str | None, effects: str | None
) -> Choices:
    """What a fit assumes, from the options of the command line. Raises ValueError that names the option."""
    from ..fitting.results import USUAL_CHOICES, Choices
    from ..fitting.throw import EFFECTS

    on_trial = (
        None if effects is None else tuple(n.strip() for n in effects.split(",") if n.strip() not in ("", "none"))
    )
    for name in on_trial or ():
        if name not in EFFECTS:
            raise _impossible(
                f"--effects {effects}: {name!r} is no effect; wanted some of {', '.join(EFFECTS)}, or none"
            )

    limit = USUAL_CHOICES.misfit_limit if misfit_limit is None else misfit_limit
    try:
        usual = USUAL_CHOICES.usual_friction if usual_friction is None else _number_or_none(usual_friction)
        return Choices(intervals, limit, usual, on_trial)
    except ValueError as error:
        text = str(error)
        for name in ("misfit_limit", "usual_friction"):
            text = text.replace(name, f"--{name.replace('_', '-')}")
        raise _impossible(text) from error


def _number_or_none(text: str) -> float | None:
    """A number, or None for the word none. Raises ValueError for anything else."""
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise _impossible(f"usual_friction = {text}: wanted a coefficient of friction, or none") from None


def check_half_width(chi_within: float | None, trade_file: Path | None = None) -> None:
    """Raise ValueError, naming the option, for a half-width that is none, and for measurements without one."""
    if chi_within is not None and not 0.0 < chi_within < 1.0:
        raise _impossible(f"--chi-within {chi_within:g}: wanted a half-width of χ between 0 and 1, such as 0.01")
    if trade_file is not None and chi_within is None:
        raise _impossible("--trade needs --chi-within; state the wanted half-width of χ, as in --chi-within 0.01")


def given_option(name: str, value: float | str | None, default: float | str | None) -> tuple[str, ...]:
    """An option as typed; nothing where it has its default."""
    return () if value == default else (name, str(value))


def command_words(name: str, file: Path, out: Path, force: bool, allow_outside: bool = False) -> tuple[str, ...]:
    outside = ("--allow-outside",) if allow_outside else ()
    return ("diethrow", name, str(file), *output_words(out, force), *outside)


def flag_words(name: str, given: bool) -> tuple[str, ...]:
    return (name,) if given else ()


def output_words(out: Path, force: bool) -> tuple[str, ...]:
    return ("--out", str(out), *(("--force",) if force else ()))


def _impossible(text: str) -> ValueError:
    """The error of an impossible option; its module loads the numerical libraries."""
    from ..model.errors import InputError

    return InputError(text)
