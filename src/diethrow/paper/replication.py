"""The replication of the paper: run all parts, and write the page, the numbers and the figures.

`paper` uses the parameters that the paper states and tunes none. If a parameter is not stated, the page says which value is
used instead, or that the statement cannot be decided.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..files.csv_and_json import write_json
from ..files.outputs import whole_folder
from ..files.provenance import Stopwatch, write_provenance
from ..model.errors import InputError
from .basin_boundaries import fig_6, fig_7
from .bounces_to_rest import bounces
from .corner_sequences import fig_5
from .lyapunov_exponents import exponents
from .page import SOURCE, page
from .release_face_odds import odds_results
from .results import FULL, QUICK, Effort, Progress, Result, Run, Verdict
from .solids import fig_2, inertias

PARTS: dict[str, Callable[[Run], tuple[Result, ...]]] = {
    "inertias": inertias,
    "fig_2": fig_2,
    "fig_5": fig_5,
    "fig_6": fig_6,
    "fig_7": fig_7,
    "odds": odds_results,
    "exponents": exponents,
    "experiment": bounces,
}
"""The parts in the order of the page; each draws its figures and returns its results."""


@dataclass(frozen=True)
class PaperPlan:
    """The effort and the seed of a replication."""

    effort: Effort
    seed: int = 1
    quick: bool = False


@dataclass(frozen=True, eq=False)
class Replication:
    """All results, and the duration of each part."""

    results: tuple[Result, ...]
    seconds: dict[str, float]
    """Duration of each part."""


def plan_of(quick: bool, seed: int) -> PaperPlan:
    """The plan of the full or the quick run. Raises ValueError for a negative seed."""
    if seed < 0:
        raise InputError(f"seed {seed}: wanted 0 or more")
    return PaperPlan(QUICK if quick else FULL, seed, quick)


def paper(
    plan: PaperPlan,
    out: Path,
    *,
    force: bool = False,
    threads: int = 1,
    progress: Progress = lambda stage, done, total: None,
    command: tuple[str, ...] = (),
) -> Replication:
    """Replicate the paper and write paper.html, paper.json, the pictures and provenance to the folder `out`.

    The numbers depend on the plan alone, not on `threads`. Raises OutputExistsError if the folder exists (unless
    `force`); a stopped run leaves no folder.
    """
    watch = Stopwatch()
    results: list[Result] = []
    with whole_folder(out, force=force) as folder:
        run = Run(folder, plan.effort, plan.seed, threads, progress)
        for name, part in PARTS.items():
            with watch.stage(name):
                results += part(run)
        note = _note(plan)
        write_json(folder / "paper.json", paper_table(plan, results))
        (folder / "paper.html").write_text(page(results, folder, note), encoding="utf-8")
        write_provenance(folder, command=command, understood=plan, seconds=watch.seconds, seeds={"all": plan.seed})
    return Replication(tuple(results), watch.seconds)


def paper_table(plan: PaperPlan, results: list[Result]) -> dict[str, Any]:
    """The contents of paper.json."""
    return {
        "paper": SOURCE,
        "diethrow": __version__,
        "quick": plan.quick,
        "seed": plan.seed,
        "effort": asdict(plan.effort),
        "verdicts": {verdict.value: n for verdict, n in Counter(result.verdict for result in results).items()},
        "results": [
            {
                "key": result.key,
                "title": result.title,
                "paper": result.stated,
                "ours": result.ours,
                "verdict": result.verdict.value,
                "why": result.why,
                "numbers": result.numbers,
                "tables": [asdict(table) for table in result.tables],
                "pictures": [asdict(picture) for picture in result.pictures],
            }
            for result in results
        ],
    }


def summary(replication: Replication) -> list[str]:
    """A line for each statement, and one for the durations."""
    width = max(len(verdict.value) for verdict in Verdict)
    lines = [f"{result.verdict.value:<{width}}  {result.title}" for result in replication.results]
    parts = ", ".join(f"{name} {seconds:.0f}" for name, seconds in replication.seconds.items())
    return [*lines, f"{sum(replication.seconds.values()):.0f} s ({parts})"]


def _note(plan: PaperPlan) -> str:
    size = "quick run" if plan.quick else "full run" if plan.effort == FULL else "run of another size"
    return f"diethrow {__version__}, {size}, {plan.effort.throws:,} throws for each point of the odds, seed {plan.seed}"
