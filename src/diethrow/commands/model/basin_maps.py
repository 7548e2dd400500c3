"""Basins of attraction as a figure and as data, and the predictability of the throws in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...executors import width
from ...files.csv_and_json import write_json
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, die_record, write_provenance
from ...files.work_file import WorkFile
from ...model.die import Die, make_die
from ...model.ensembles import (
    ENDING_OF_INDEX,
    FIG_6_CONDITIONS,
    Axis,
    Fairness,
    FinalStateSensitivity,
    ThrowSetup,
    UncertaintyExponent,
    Window,
    fairness_by_dynamics,
    final_configurations,
    final_state_sensitivity,
    map_rows,
    uncertainty_exponent,
)
from ...model.errors import InputError
from ...model.laws import LEVEL, Table, checked_drag
from ...replay.figures import ball_measures, basin_map, colours_of, uncertain_shares
from .face_odds import impact_law_of, share_table

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

EPSILONS = tuple(float(e) for e in np.logspace(-10, -1, 19))
"""Distances of neighbours in sides of the window: two per decade, down to where rounding becomes noticeable."""
BALL_EPSILONS = tuple(float(e) for e in np.logspace(-8, -1, 8))
"""Radii of balls in sides of the window, one per decade."""
BALLS = 12
"""Conditions around which measures are taken."""
BALL_THROWS = 600
"""Throws in each ball: a measure of 1/6 then has a 95 % interval of ± 0.03."""
SIGNIFICANCE = 0.01
"""A ball counts as unfair if the p-value of its counts is smaller."""
CHUNK_PIXELS = 8192
"""Pixels that a thread computes at once, in whole rows."""
TASK_PIXELS = 4 * CHUNK_PIXELS
"""Pixels that a worker of a cluster computes at once: one second of work."""
MAX_AT_IMPACT = 1000
"""Largest number of the impact by which a map can be coloured."""
MAP_PIXELS = 1600
"""Pixels of each side of the figure of the map; larger maps are thinned, and pixels.png has all."""


@dataclass(frozen=True)
class BasinsPlan:
    """The plane of conditions, the die and the law."""

    x: Axis
    y: Axis
    fixed: Mapping[str, float] = field(default_factory=lambda: dict(FIG_6_CONDITIONS))
    die: Die = field(default_factory=lambda: make_die("tetrahedron", 0.040793, 0.016))
    """The default is that of the paper's Fig. 6."""
    chi: float = 0.2
    mu: float | None = None
    table: Table = LEVEL
    drag_per_m: float = 0.0
    """k of the air drag; 0 for a vacuum."""
    at_impact: int | None = None
    """The map shows the lowest face at this impact; None for the landing face."""
    predictability: bool = False
    conditions: int = 8192
    """Number of conditions for the uncertain shares, each with four neighbours at every distance."""
    seed: int = 1
    """Seed of the conditions whose predictability is measured."""

    die_files: tuple[Path, ...] = ()
    """The files that describe the die, if any do."""

    def __post_init__(self) -> None:
        if self.at_impact is not None and not 1 <= self.at_impact <= MAX_AT_IMPACT:
            raise InputError(f"at impact {self.at_impact}: wanted a number from 1 to {MAX_AT_IMPACT}")
        if self.conditions < 1 or self.seed < 0:
            raise InputError(
                f"conditions {self.conditions}, seed {self.seed}: wanted 1 or more, and a seed of 0 or more"
            )
        checked_drag(self.drag_per_m)
        _ = (self.window, self.stage)  # both raise ValueError for impossible values

    @property
    def window(self) -> Window:
        """The plane."""
        return Window(self.x, self.y, dict(self.fixed))

    @property
    def stage(self) -> ThrowSetup:
        """Die, law and table."""
        return ThrowSetup(self.die, impact_law_of(self.chi, self.mu), self.table, drag_per_m=self.drag_per_m)


@dataclass(frozen=True, eq=False)
class BasinMap:
    """The result of the throw from every pixel; rows along y, columns along x, both increasing."""

    face: NDArray[np.uint16]
    """(rows, columns) number of the face, 0 for none."""
    impacts: NDArray[np.int32]
    """(rows, columns) number of impacts until the face was decided."""
    ending: NDArray[np.int8]
    """(rows, columns) index into ENDING_OF_INDEX; -1 for a release below the table."""

    @classmethod
    def empty(cls, rows: int, columns: int) -> BasinMap:
        """A map of zeros."""
        shape = (rows, columns)
        return cls(np.zeros(shape, np.uint16), np.zeros(shape, np.int32), np.zeros(shape, np.int8))


@dataclass(frozen=True, eq=False)
class Predictability:
    """Measurements for the paper's two definitions: predictability, and fairness by dynamics."""

    sensitivity: FinalStateSensitivity
    exponent: UncertaintyExponent | None
    balls: tuple[Fairness, ...]


def basins(
    plan: BasinsPlan,
    out: Path,
    *,
    force: bool = False,
    resume: bool = False,
    threads: int = 1,
    executor: Executor | None = None,
    progress: Progress = lambda stage, done, total: None,
    command: tuple[str, ...] = (),
) -> tuple[BasinMap, Predictability | None]:
    """Simulate the throw from every pixel of a window, and write figure, data and tables to the folder `out`.

    A stopped run leaves a work file beside `out`, and `resume` continues from it. The map does not depend on `threads`, or
    on an `executor`, which replaces them. Raises OutputExistsError if the folder exists (unless `force`), ValueError for a
    work file with other settings.
    """
    watch, work = Stopwatch(), WorkFile(out, plan)
    with whole_folder(out, force=force, inputs=plan.die_files) as folder:
        with watch.stage("map"):
            mapped = _mapped(plan, work, resume, threads, executor, progress)
        measured = None
        if plan.predictability:
            work.write(_kept(mapped, plan.y.pixels))  # a stop during the measurement then keeps the map
            with watch.stage("predictability"):
                measured = _measured(plan, threads, progress)
        with watch.stage("records"):
            np.savez_compressed(
                folder / "basins.npz",
                x=plan.x.centres,
                y=plan.y.centres,
                face=mapped.face,
                impacts=mapped.impacts,
                ending=mapped.ending,
                endings=np.array([ending.name.lower() for ending in ENDING_OF_INDEX]),
            )
            write_json(folder / "basins.json", basins_table(plan, mapped, measured))
        with watch.stage("figure"):
            draw_map(folder / "basins.png", plan, mapped)
            draw_pixels(folder / "pixels.png", mapped)
            if measured:
                draw_predictability(folder / "predictability.png", plan, measured)
        write_provenance(
            folder,
            command=command,
            understood=plan,
            inputs=plan.die_files,
            seconds=watch.seconds,
            seeds={"predictability": plan.seed} if plan.predictability else {},
        )
    work.remove()
    return mapped, measured


def axes_of(
    x: tuple[str, float, float],
    y: tuple[str, float, float],
    zoom: tuple[float, float, float, float] | None,
    pixels: tuple[int, int],
) -> tuple[Axis, Axis]:
    """The axes (name, low, high) with their pixels; `zoom` (x0, x1, y0, y1) replaces the bounds.

    Raises ValueError for unknown names or empty ranges.
    """
    if zoom is not None:
        x, y = (x[0], *zoom[:2]), (y[0], *zoom[2:])
    return Axis(*x, pixels[0]), Axis(*y, pixels[1])


def fixed_from(words: Sequence[str]) -> dict[str, float]:
    """Fixed conditions from words NAME=VALUE, over those of the paper's Fig. 6. Raises ValueError for other words."""
    fixed = dict(FIG_6_CONDITIONS)
    for word in words:
        name, _, value = word.partition("=")
        try:
            fixed[name.strip()] = float(value)
        except ValueError as error:
            raise InputError(f"--fix {word}: wanted NAME=VALUE, for example --fix theta=1.2") from error
    return fixed


def summary(plan: BasinsPlan, mapped: BasinMap, measured: Predictability | None) -> list[str]:
    """The areas of the faces, and the predictability if it was measured, one line each."""
    table = basins_table(plan, mapped, measured)
    faces = " ".join(f"{each['share']:.4f}" for each in table["area"]["faces"])
    lines = [f"{mapped.face.size} throws: faces {faces}; on no face {table['area']['no_face']:.4f}"]
    if measured is not None:
        predictability = table["predictability"]
        half, most = (predictability["deciding_epsilon"][name] for name in ("of_0.5", "of_0.99"))
        lines.append(
            f"Half of the throws are decided at a distance of {_size(half)} of the window, 99 % at {_size(most)}."
        )
        if measured.exponent:
            exponent = measured.exponent
            lines.append(f"Uncertainty exponent {exponent.value:.3f} ± {exponent.standard_error:.3f}")
        lines += predictability["messages"]
    return lines


def _size(epsilon: float | None) -> str:
    return "no distance that was tried" if epsilon is None else f"{epsilon:.1e}"


def basins_table(plan: BasinsPlan, mapped: BasinMap, measured: Predictability | None) -> dict[str, Any]:
    """The contents of basins.json."""
    pixels = mapped.face.size
    faces = np.bincount(mapped.face.ravel(), minlength=len(plan.stage.die.solid.faces) + 1)
    endings = np.bincount(mapped.ending.ravel().astype(int) + 1, minlength=len(ENDING_OF_INDEX) + 1)
    below = int(endings[0])
    named = {ending.name.lower(): int(n) / pixels for ending, n in zip(ENDING_OF_INDEX, endings[1:], strict=True) if n}
    return {
        "die": die_record(plan.die),
        "chi": plan.chi,
        "mu": plan.mu,
        "drag_per_m": plan.drag_per_m,
        "x": _axis_table(plan.x),
        "y": _axis_table(plan.y),
        "fixed": {name: value for name, value in plan.fixed.items() if name not in (plan.x.name, plan.y.name)},
        "coloured_by": "landed face" if plan.at_impact is None else f"lowest face at impact {plan.at_impact}",
        "area": {
            "faces": [{"face": k, "share": int(faces[k]) / pixels} for k in range(1, len(faces))],
            "no_face": int(faces[0]) / pixels,
            "below_the_table": below / pixels,
        },
        "endings": named,
        "mean_impacts": float(mapped.impacts.mean()),
        "predictability": None if measured is None else predictability_table(plan, measured),
    }


def predictability_table(plan: BasinsPlan, measured: Predictability) -> dict[str, Any]:
    """The part `predictability` of basins.json; distances are in sides of the window."""
    sensitivity, exponent = measured.sensitivity, measured.exponent
    messages = []
    if exponent is None:
        messages.append(
            "No exponent was fitted: at too few distances the share of uncertain conditions is clearly between zero and "
            "chance. Use more --conditions or another window."
        )
    if sensitivity.deciding_epsilon(0.5) is None:
        messages.append("Half of the conditions are uncertain even at the smallest distance.")
    return {
        "conditions": int(sensitivity.decided.sum()),
        "uncertain": [
            {"epsilon": float(e), **share_table(s)} for e, s in zip(sensitivity.epsilons, sensitivity.shares, strict=True)
        ],
        "uncertain_by_chance": sensitivity.chance,
        "deciding_epsilon": {f"of_{share:g}": sensitivity.deciding_epsilon(share) for share in (0.5, 0.9, 0.99)},
        "uncertainty_exponent": None
        if exponent is None
        else {
            "value": exponent.value,
            "prefactor": exponent.prefactor,
            "standard_error": exponent.standard_error,
            "epsilon_from": exponent.epsilon_from,
            "epsilon_to": exponent.epsilon_to,
            "boundary_dimension": exponent.boundary_dimension,
        },
        "fair_by_dynamics": _fair_table(measured.balls),
        "balls": [
            {
                plan.x.name: float(ball.condition[0]),
                plan.y.name: float(ball.condition[1]),
                "radii": [
                    {"epsilon": float(e), "counts": ball.counts[k], "no_face": int(ball.none[k]),
                     "chi_square": float(ball.chi_square[k]), "p_value": float(ball.p_value[k])}
                    for k, e in enumerate(ball.epsilons)
                ],
            }
            for ball in measured.balls
        ],
        "messages": messages,
    }  # fmt: skip


def draw_map(path: Path, plan: BasinsPlan, mapped: BasinMap) -> None:
    """Write the figure of the map with axes and legend, with about MAP_PIXELS of each side."""
    from matplotlib.figure import Figure  # a third of a second, after the first result

    figure = Figure(figsize=(10.0, 7.0), dpi=160, layout="constrained")
    rows, columns = (max(1, n // MAP_PIXELS) for n in mapped.face.shape)
    face, ending = mapped.face[::rows, ::columns], mapped.ending[::rows, ::columns]
    faces = len(plan.stage.die.solid.faces)
    ax = basin_map(figure.add_subplot(), plan.x, plan.y, face, ending, faces)
    friction = "" if plan.mu is None else f", μ = {plan.mu:g}"
    friction += f", air drag {plan.drag_per_m:g}/m" if plan.drag_per_m else ""
    at = "" if plan.at_impact is None else f", lowest face at impact {plan.at_impact}"
    ax.set_title(
        f"{plan.die.solid.name}, a = {1e3 * plan.die.solid.edge_m:g} mm, χ = {plan.chi:g}{friction}{at}", loc="left"
    )
    figure.savefig(path)


def draw_pixels(path: Path, mapped: BasinMap) -> None:
    """Write the map alone, one pixel for each throw, y upwards."""
    colours = colours_of(mapped.face[::-1], mapped.ending[::-1])
    if not cv2.imwrite(str(path), colours[:, :, ::-1]):
        raise OSError(f"{path}: the image could not be written; check that the folder exists and has free space")


def draw_predictability(path: Path, plan: BasinsPlan, measured: Predictability) -> None:
    """Write the figure of f(ε) with its fitted slope, and of the measures of balls."""
    from matplotlib.figure import Figure  # a third of a second, after the first result

    figure = Figure(figsize=(11.0, 4.4), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2)
    uncertain_shares(left, measured.sensitivity, measured.exponent).set_title("predictability", loc="left")
    ball_measures(right, measured.balls).set_title("fairness by dynamics", loc="left")
    figure.suptitle(f"{plan.die.solid.name}, χ = {plan.chi:g}, in the plane of {plan.x.name} and {plan.y.name}")
    figure.savefig(path)


def _mapped(
    plan: BasinsPlan, work: WorkFile, resume: bool, threads: int, executor: Executor | None, progress: Progress
) -> BasinMap:
    """The map; with `resume`, continued from the work file."""
    rows, columns = plan.y.pixels, plan.x.pixels
    kept = work.read() if resume else None
    mapped = BasinMap(kept["face"], kept["impacts"], kept["ending"]) if kept else BasinMap.empty(rows, columns)
    first = int(kept["rows"]) if kept else 0
    at_once = max(1, (CHUNK_PIXELS if executor is None else TASK_PIXELS) // columns)
    with work.keeping() as keep:
        landings = map_rows(
            plan.stage,
            plan.window,
            first=first,
            after=plan.at_impact or 0,
            rows=at_once,
            threads=threads if executor is None else width(executor),
            executor=executor,
        )
        for i, j, part in landings:
            face = part.face if plan.at_impact is None else part.lowest[:, -1] * (part.ending >= 0)
            mapped.face[i:j] = face.reshape(-1, columns)
            mapped.impacts[i:j] = part.impacts.reshape(-1, columns)
            mapped.ending[i:j] = part.ending.reshape(-1, columns)
            keep(_kept(mapped, j))
            progress("Mapping", j, rows)
    return mapped


def _kept(mapped: BasinMap, rows: int) -> dict[str, Any]:
    """The contents of the work file after the first `rows` rows."""
    return {"face": mapped.face, "impacts": mapped.impacts, "ending": mapped.ending, "rows": np.array(rows)}


def _measured(plan: BasinsPlan, threads: int, progress: Progress) -> Predictability:
    low, high = np.array([plan.x.low, plan.y.low]), np.array([plan.x.high, plan.y.high])
    stage, window, faces = plan.stage, plan.window, len(plan.stage.die.solid.faces)

    def outcome(points: Array) -> NDArray[np.int64]:
        return final_configurations(stage, window, points, plan.at_impact)

    sensitivity = final_state_sensitivity(
        outcome,
        low,
        high,
        EPSILONS,
        conditions=plan.conditions,
        seed=plan.seed,
        threads=threads,
        progress=lambda done, total: progress("Disturbing", done, total),
    )
    balls = []
    centres = np.random.default_rng([plan.seed, 1]).uniform(low, high, (BALLS, 2))
    for number, centre in enumerate(centres):
        seed = plan.seed * BALLS + number
        balls.append(
            fairness_by_dynamics(outcome, centre, high - low, faces, BALL_EPSILONS, throws=BALL_THROWS, seed=seed)
        )
        progress("Filling balls", number + 1, BALLS)
    return Predictability(sensitivity, uncertainty_exponent(sensitivity), tuple(balls))


def _fair_table(balls: tuple[Fairness, ...]) -> list[dict[str, Any]]:
    """For each radius: the number of balls whose counts are consistent with equal measures, and the largest deviation."""
    n = balls[0].counts.shape[1]
    table = []
    for k, epsilon in enumerate(balls[0].epsilons):
        landed = [ball for ball in balls if ball.counts[k].any()]
        away = [float(np.abs(ball.measures[k] - 1.0 / n).max()) for ball in landed]
        table.append(
            {
                "epsilon": float(epsilon),
                "balls": len(landed),
                "not_refuted": sum(bool(ball.p_value[k] >= SIGNIFICANCE) for ball in landed),
                "one_face_alone": sum(int((ball.counts[k] > 0).sum() == 1 and ball.none[k] == 0) for ball in landed),
                "mean_largest_difference": float(np.mean(away)) if away else None,
            }
        )
    return table


def _axis_table(axis: Axis) -> dict[str, Any]:
    return {"name": axis.name, "low": axis.low, "high": axis.high, "pixels": axis.pixels}
