"""What the parts of `paper` have in common: a result with its verdict, the effort, and the run that they belong to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..model.die import Die, make_die
from ..replay.elements import number

Progress = Callable[[str, int, int], None]

MASS_KG = 0.016
TETRAHEDRON_EDGE_M, CUBE_EDGE_M = 0.040793, 0.02
"""The dice of the paper's Fig. 5."""
CHI = 0.5
"""Of its Fig. 5, and what it calls typical."""


class Verdict(Enum):
    """What became of a statement of the paper."""

    REPRODUCED = "reproduced"
    NOT_REPRODUCED = "not reproduced"
    NOT_DECIDABLE = "not decidable from what the paper states"


@dataclass(frozen=True)
class Table:
    """Rows of texts and numbers under a header."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A PNG in the output folder."""

    file: str
    caption: str


@dataclass(frozen=True)
class Result:
    """One statement of the paper beside what came out here."""

    key: str
    title: str
    stated: str
    """What the paper says."""
    ours: str
    verdict: Verdict
    why: str
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """Every number behind it, for paper.json."""


@dataclass(frozen=True)
class Effort:
    """How much is computed."""

    throws: int
    """Of each point of the odds: the paper's 2 × 10⁶."""
    scan_throws: int
    """Of each point of a curve beside them."""
    pixels: int
    """Along each side of a map of basins."""
    pixels_chi_1: int
    """The same at χ = 1, where every throw is followed for 1000 impacts."""
    conditions: int
    """Conditions of each curve of uncertain shares."""
    conditions_chi_1: int
    shadows: int
    """Disturbed throws at each size of a disturbance."""
    dipyramid_throws: int
    """Of each cut and χ."""
    bounce_throws: int
    """Of each die and χ of the comparison with the paper's films."""
    orbits: int
    orbit_impacts: int
    """Of each Lyapunov exponent."""


FULL = Effort(2_000_000, 50_000, 500, 250, 8192, 512, 60, 3000, 10_000, 8, 5000)
QUICK = Effort(20_000, 5000, 150, 50, 2048, 64, 20, 200, 1000, 4, 600)


@dataclass(frozen=True)
class Run:
    """Where the pictures go, and with what effort."""

    folder: Path
    effort: Effort
    seed: int
    threads: int
    progress: Progress = lambda stage, done, total: None


def cube() -> Die:
    """The paper's."""
    return make_die("cube", CUBE_EDGE_M, MASS_KG)


def tetrahedron() -> Die:
    """The paper's."""
    return make_die("tetrahedron", TETRAHEDRON_EDGE_M, MASS_KG)


def cell(value: Any) -> str:
    """A cell of a table, or a number in a sentence, as the page shows it."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "—"}[value]
    return number(value, 4) if isinstance(value, float) else str(value)


def drawing(inches: tuple[float, float]) -> Figure:
    """An empty figure, without the state that pyplot would keep."""
    figure = Figure(figsize=inches, dpi=140, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
