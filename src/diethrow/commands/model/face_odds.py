"""The odds of the faces of a die, counted over many throws, with intervals, tables and a figure."""

from __future__ import annotations

import csv
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtrc

from ...executors import width
from ...files.csv_and_json import write_json
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, die_record, write_provenance
from ...files.work_file import Kept, WorkFile
from ...model.die import Die
from ...model.ensembles import (
    BLOCK,
    ENDING_OF_INDEX,
    HEIGHT_EDGES,
    Conditions,
    PaperConditions,
    Share,
    Tally,
    ThrowSetup,
    UniformConditions,
    check_releases,
    tally_throws,
)
from ...model.errors import InputError
from ...model.laws import LEVEL, CoulombImpact, ImpactLaw, SmoothImpact, Table, checked_drag
from ...model.throw import Ending
from ...replay.figures import face_odds, lowest_again

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[str, int, int], None]

CONDITIONS = ("paper", "uniform")
BLOCKS_PER_TASK = 8
"""Blocks that a worker of a cluster gets at once: one second of work, so that the time of sending is negligible."""
MAX_AFTER = 1000
"""Largest number of the impact at which the lowest face can be counted."""
LEVEL_OF_INTERVALS = 0.95


@dataclass(frozen=True)
class OddsPlan:
    """The die, the law, the release conditions, and the number of throws."""

    die: Die
    chi: tuple[float, ...]
    """One series of throws for each χ; all series have the same releases."""
    omega_rad_s: float
    """With `paper`: ω_η in the body frame. With `uniform`: the magnitude of the spin."""
    conditions: str = "paper"
    height_m: tuple[float, float] | None = None
    """Range of the release height; None for 15 to 20 edges."""
    throws: int = 100_000
    """Number of throws for each χ."""
    seed: int = 1
    after: int = 5
    """Number of first impacts at which the lowest face is counted."""
    mu: float | None = None
    """Coulomb friction coefficient; None for the paper's smooth impact."""
    table: Table = LEVEL
    drag_per_m: float = 0.0
    """k of the air drag; 0 for a vacuum."""

    die_files: tuple[Path, ...] = ()
    """The files that describe the die, if any do."""

    def __post_init__(self) -> None:
        if self.conditions not in CONDITIONS:
            raise InputError(f"conditions {self.conditions!r}: wanted one of {', '.join(CONDITIONS)}")
        if not self.chi:
            raise InputError("chi is empty: wanted one coefficient of restitution or more")
        if self.throws < 1 or self.seed < 0 or not 0 <= self.after <= MAX_AFTER:
            raise InputError(
                f"throws {self.throws}, seed {self.seed}, after {self.after}: "
                f"wanted 1 throw or more, a seed of 0 or more, and 0 to {MAX_AFTER} impacts"
            )
        checked_drag(self.drag_per_m)
        for stage in self.stages:
            check_releases(stage, self.drawn)

    @property
    def drawn(self) -> Conditions:
        """The distribution of the releases."""
        edge_m = self.die.solid.edge_m
        height = self.height_m or (HEIGHT_EDGES[0] * edge_m, HEIGHT_EDGES[1] * edge_m)
        if self.conditions == "paper":
            return PaperConditions((0.0, self.omega_rad_s, 0.0), height)
        return UniformConditions(self.omega_rad_s, height)

    @property
    def stages(self) -> tuple[ThrowSetup, ...]:
        """Die, law and table for each χ."""
        return tuple(
            ThrowSetup(self.die, impact_law_of(chi, self.mu), self.table, drag_per_m=self.drag_per_m)
            for chi in self.chi
        )


def impact_law_of(chi: float, mu: float | None) -> ImpactLaw:
    """The smooth impact or, with a μ, Coulomb friction with energetic restitution."""
    return SmoothImpact(chi) if mu is None else CoulombImpact(chi, mu)


def odds(
    plan: OddsPlan,
    out: Path,
    *,
    force: bool = False,
    resume: bool = False,
    threads: int = 1,
    chunk: int | None = None,
    executor: Executor | None = None,
    progress: Progress = lambda stage, done, total: None,
    command: tuple[str, ...] = (),
) -> tuple[Tally, ...]:
    """Simulate the throws of a plan, write counts, odds and a figure to the folder `out`, and return a tally for each χ.

    A stopped run leaves a work file beside `out`, and `resume` continues from it with the same counts. The counts do not
    depend on `threads`, on the size of a `chunk`, or on an `executor`, which replaces the threads. Raises
    OutputExistsError if the folder exists (unless `force`), ValueError for a work file with other settings.
    """
    watch, work = Stopwatch(), WorkFile(out, plan)
    with whole_folder(out, force=force, inputs=plan.die_files) as folder:
        with watch.stage("throws"):
            default_chunk = BLOCK if executor is None else BLOCKS_PER_TASK * BLOCK
            tallies = _tallies(plan, work, resume, threads, executor, chunk or default_chunk, progress)
        with watch.stage("records"):
            write_json(folder / "odds.json", odds_table(plan, tallies))
            write_rows(folder / "odds.csv", plan, tallies)
        with watch.stage("figure"):
            draw_odds(folder / "odds.png", plan, tallies)
        write_provenance(
            folder,
            command=command,
            understood=plan,
            inputs=plan.die_files,
            seconds=watch.seconds,
            seeds={"throws": plan.seed},
        )
    work.remove()
    return tallies


def odds_table(plan: OddsPlan, tallies: tuple[Tally, ...]) -> dict[str, Any]:
    """The contents of odds.json."""
    return {
        "die": die_record(plan.die),
        "level": LEVEL_OF_INTERVALS,
        "series": [
            {"chi": chi, "mu": plan.mu, "drag_per_m": plan.drag_per_m, **_series(tally)}
            for chi, tally in zip(plan.chi, tallies, strict=True)
        ],
        "messages": [sentence for tally in tallies for sentence in _messages(tally)],
    }


def summary(plan: OddsPlan, tallies: tuple[Tally, ...]) -> list[str]:
    """One line for each χ, and one for its throws that landed on no face."""
    lines = []
    for chi, tally in zip(plan.chi, tallies, strict=True):
        shares = [Share(int(n), tally.throws) for n in tally.landed]
        again = Share(tally.landed_as_start, tally.throws)
        low, high = again.interval
        faces = " ".join(f"{share.value:.4f}" for share in shares)
        lines.append(f"χ {chi:g}: faces {faces}; as at release {again.value:.4f} (95 %: {low:.4f} to {high:.4f})")
        lines += [f"χ {chi:g}: {sentence}" for sentence in _messages(tally)]
    return lines


def write_rows(path: Path, plan: OddsPlan, tallies: tuple[Tally, ...]) -> None:
    """Write odds.csv, one row for each share; `face` and `impact` are empty if they do not apply."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["chi", "quantity", "face", "impact", "count", "of", "share", "low", "high"])
        for chi, tally in zip(plan.chi, tallies, strict=True):
            for quantity, face, impact, share in _shares(tally):
                rows.writerow([chi, quantity, face, impact, share.count, share.of, share.value, *share.interval])


def draw_odds(path: Path, plan: OddsPlan, tallies: tuple[Tally, ...]) -> None:
    """Write the figure: odds of the faces among the throws that landed, and of the face that was lowest at release."""
    from matplotlib.figure import Figure  # a third of a second, after the first result

    faces = len(tallies[0].landed)
    figure = Figure(figsize=(11.0, 4.4), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2)
    names = [_name(chi, tally) for chi, tally in zip(plan.chi, tallies, strict=True)]
    landed = {n: [Share(int(k), t.rested) for k in t.landed] for n, t in zip(names, tallies, strict=True)}
    again = {n: _again(t) for n, t in zip(names, tallies, strict=True)}
    face_odds(left, landed).set_title("faces, of the throws that landed", loc="left")
    lowest_again(right, again, faces).set_title("the face that was lowest at release", loc="left")
    _title(figure, plan)
    figure.savefig(path)


def _title(figure: Figure, plan: OddsPlan) -> None:
    spin = rf"$\omega_\eta$ = {plan.omega_rad_s:g}" if plan.conditions == "paper" else f"spin {plan.omega_rad_s:g}"
    friction = "" if plan.mu is None else f", μ = {plan.mu:g}"
    friction += f", air drag {plan.drag_per_m:g}/m" if plan.drag_per_m else ""
    figure.suptitle(f"{plan.die.solid.name}, {plan.throws:,} throws for each χ, {spin} rad/s{friction}; bars: 95 %")


def _name(chi: float, tally: Tally) -> str:
    no_face = tally.throws - tally.rested
    return f"χ = {chi:g}" + (f" ({100 * no_face / tally.throws:.2g} % on no face)" if no_face else "")


def _again(tally: Tally) -> list[Share]:
    """Shares of throws whose lowest face is that of the release: at each impact, then among the throws that landed."""
    at_impacts = [Share(int(k), tally.throws) for k in tally.as_start[1:]]
    return [*at_impacts, Share(tally.landed_as_start, tally.rested)]


def _tallies(
    plan: OddsPlan,
    work: WorkFile,
    resume: bool,
    threads: int,
    executor: Executor | None,
    chunk: int,
    progress: Progress,
) -> tuple[Tally, ...]:
    """The tallies of all series; with `resume`, continued from the work file."""
    done = _unpacked(work.read() or {}) if resume else []
    total = plan.throws * len(plan.chi)
    with work.keeping() as keep:
        for number, stage in enumerate(plan.stages):
            begun = done[number] if number < len(done) else None
            tallies = tally_throws(
                stage,
                plan.drawn,
                plan.throws,
                plan.seed,
                after=plan.after,
                begun=begun,
                chunk=chunk,
                threads=threads if executor is None else width(executor),
                executor=executor,
            )
            for tally in tallies:
                done[number:] = [tally, *done[number + 1 :]]
                keep(_packed(done))
                progress("Throwing", number * plan.throws + tally.throws, total)
    return tuple(done)


def _packed(tallies: list[Tally]) -> Kept:
    return {
        f"{number}.{part.name}": np.asarray(getattr(tally, part.name))
        for number, tally in enumerate(tallies)
        for part in fields(Tally)
    }


def _unpacked(kept: Kept) -> list[Tally]:
    tallies = []
    for number in sorted({int(name.split(".")[0]) for name in kept}):
        arrays = {part.name: kept[f"{number}.{part.name}"] for part in fields(Tally)}
        values: dict[str, Any] = {name: int(each) if each.ndim == 0 else each for name, each in arrays.items()}
        tallies.append(Tally(**values))
    return tallies


def _series(tally: Tally) -> dict[str, Any]:
    mean = tally.rested / len(tally.landed)
    statistic = float(((tally.landed - mean) ** 2).sum() / mean) if mean else None
    freedom = len(tally.landed) - 1
    return {
        "throws": tally.throws,
        "impacts_per_throw": tally.impacts / tally.throws,
        "most_impacts": tally.most_impacts,
        "landed": [
            {
                "face": k + 1,
                **share_table(Share(int(n), tally.throws)),
                "of_landed": share_table(Share(int(n), tally.rested)),
            }
            for k, n in enumerate(tally.landed)
        ],
        "landed_as_start": {
            **share_table(Share(tally.landed_as_start, tally.throws)),
            "of_landed": share_table(Share(tally.landed_as_start, tally.rested)),
        },
        "endings": {
            ending.name.lower(): {**share_table(Share(int(n), tally.throws)), "meaning": ending.value}
            for ending, n in zip(ENDING_OF_INDEX, tally.endings, strict=True)
            if n
        },
        "equal_odds": {
            "chi_square": statistic,
            "degrees_of_freedom": freedom,
            "p_value": None if statistic is None else float(chdtrc(freedom, statistic)),
        },
        "at_impact": [
            {
                "impact": impact,
                "lowest": [{"face": k + 1, **share_table(Share(int(n), tally.throws))} for k, n in enumerate(row)],
                "as_start": share_table(Share(int(tally.as_start[impact]), tally.throws)),
                "as_landed": share_table(Share(int(tally.as_landed[impact]), tally.throws)),
            }
            for impact, row in enumerate(tally.lowest)
        ],
    }


def share_table(share: Share) -> dict[str, Any]:
    """A share with its interval, as in JSON."""
    low, high = share.interval
    return {"count": share.count, "of": share.of, "share": share.value, "low": low, "high": high}


def _shares(tally: Tally) -> list[tuple[str, int | str, int | str, Share]]:
    """Quantity, face, impact and share of every row of odds.csv."""
    n = tally.throws
    rows: list[tuple[str, int | str, int | str, Share]] = [
        ("landed", k + 1, "", Share(int(count), n)) for k, count in enumerate(tally.landed)
    ]
    rows.append(("landed_as_start", "", "", Share(tally.landed_as_start, n)))
    for ending, count in zip(ENDING_OF_INDEX, tally.endings, strict=True):
        if count:
            rows.append((f"ending_{ending.name.lower()}", "", "", Share(int(count), n)))
    for impact in range(len(tally.lowest)):
        rows += [("lowest", k + 1, impact, Share(int(count), n)) for k, count in enumerate(tally.lowest[impact])]
        rows.append(("lowest_as_start", "", impact, Share(int(tally.as_start[impact]), n)))
        rows.append(("lowest_as_landed", "", impact, Share(int(tally.as_landed[impact]), n)))
    return rows


def _messages(tally: Tally) -> list[str]:
    no_face = tally.throws - tally.rested
    if not no_face:
        return []
    endings = ", ".join(
        f"{int(n)} {ending.name.lower().replace('_', ' ')}"
        for ending, n in zip(ENDING_OF_INDEX, tally.endings, strict=True)
        if n and ending is not Ending.RESTED
    )
    return [f"{no_face} of {tally.throws} throws landed on no face: {endings or 'not decided'}."]
