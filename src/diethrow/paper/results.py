"""Values that all parts of the replication share: a result with its verdict, the effort, the run, and the paper's dice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ..model.die import Die, make_die
from ..replay.elements import number

Progress = Callable[[str, int, int], None]

MASS_KG = 0.016
"""Mass of the dice of the paper's Fig. 5; their edges follow."""
TETRAHEDRON_EDGE_M = 0.040793
CUBE_EDGE_M = 0.02
CHI = 0.5
"""Restitution in the paper's Fig. 5, which the paper calls typical."""
CURVE_FACES = (0, 2, 4, 5, 3)
"""Faces whose colours the curves of a plot take in turn: the most distinct ones first."""


class Verdict(Enum):
    """Whether a statement of the paper is reproduced."""

    REPRODUCED = "reproduced"
    NOT_REPRODUCED = "not reproduced"
    NOT_DECIDABLE = "not decidable from what the paper states"


@dataclass(frozen=True)
class Table:
    """Rows of texts and numbers below a header."""

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
    """One statement of the paper beside our result."""

    key: str
    title: str
    stated: str
    """The statement of the paper."""
    ours: str
    """Our result."""
    verdict: Verdict
    why: str
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """All numbers of the result, for paper.json."""


@dataclass(frozen=True)
class Effort:
    """The numbers of throws, pixels, conditions and impacts that are computed."""

    throws: int
    """Throws for each point of the odds; the paper has 2 × 10⁶."""
    scan_throws: int
    """Throws for each point of a curve over the spin."""
    pixels: int
    """Pixels along each side of a map of basins."""
    pixels_chi_1: int
    """The same at χ = 1, where every throw is followed for 1000 impacts."""
    conditions: int
    """Conditions for each curve of uncertain shares."""
    conditions_chi_1: int
    shadows: int
    """Perturbed throws for each size of the perturbation."""
    dipyramid_throws: int
    """Throws for each cut and χ."""
    bounce_throws: int
    """Throws for each die and χ in the comparison with the paper's films."""
    orbits: int
    orbit_impacts: int
    """Impacts of each orbit of a Lyapunov exponent."""


FULL = Effort(2_000_000, 50_000, 500, 250, 8192, 512, 60, 3000, 10_000, 8, 5000)
QUICK = Effort(20_000, 5000, 150, 50, 2048, 64, 20, 200, 1000, 4, 600)


@dataclass(frozen=True)
class Run:
    """The output folder, the effort, and the seed of one replication."""

    folder: Path
    effort: Effort
    seed: int
    threads: int
    progress: Progress = lambda stage, done, total: None


def cube() -> Die:
    """The cube of the paper."""
    return make_die("cube", CUBE_EDGE_M, MASS_KG)


def tetrahedron() -> Die:
    """The tetrahedron of the paper."""
    return make_die("tetrahedron", TETRAHEDRON_EDGE_M, MASS_KG)


def cell(value: Any) -> str:
    """A value as the page shows it, in a table or in a sentence."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "—"}[value]
    return number(value, 4) if isinstance(value, float) else str(value)


def drawing(inches: tuple[float, float]) -> Figure:
    """An empty figure, without pyplot's global state."""
    return Figure(figsize=inches, dpi=140, layout="constrained")
