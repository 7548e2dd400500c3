"""The paper's solids: the moments of inertia of its dice, and Fig. 2, the truncated dipyramid that is fair "by continuity"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, sqrt
from typing import Any

import numpy as np

from ..commands.model.face_odds import share_table
from ..model.die import SHAPES, die_from_solid, make_die, truncated_dipyramid
from ..model.ensembles import Share, Tally, ThrowSetup, UniformConditions, tally_throws
from ..model.laws import SmoothImpact
from ..replay.elements import FACE_COLOURS, hex_colour
from .results import MASS_KG, Picture, Result, Run, Table, Verdict, cell, drawing

STATED_INERTIAS = {
    "tetrahedron": ("m a²/20", 1.0 / 20.0),
    "cube": ("m a²/6", 1.0 / 6.0),
    "octahedron": ("m a²/10", 1.0 / 10.0),
    "dodecahedron": ("m a²(95 + 39√5)/300", (95.0 + 39.0 * sqrt(5.0)) / 300.0),
    "icosahedron": ("m a²(3 + √5)/20", (3.0 + sqrt(5.0)) / 20.0),
}
INTEGRAL_ROUNDING = 1e-12
"""Largest relative rounding error of a volume integral."""

SIDES = 4
"""Sides of the base: a dipyramid of eight faces, without cuts a regular octahedron."""
RADIUS_M = 0.012
"""Circumradius of the base, and height of each tip."""
CUTS = (0.25, 0.35, 0.4, 0.44, 0.5, 0.6)
"""Shares of each tip's height that are cut off."""
CHIS = (0.2, 0.5, 0.8)
SPIN_RAD_S = 30.0
HEIGHT_M = (0.2, 0.3)
FAIR = 2.0 / (2 * SIDES + 2)
"""Share of both cut faces together on a fair die."""
CHUNK_THROWS = 250
"""Throws that a thread computes at once."""
SIGNIFICANT_SIGMAS = 3.0
"""Difference of two fair cuts, in standard errors, from which they count as different."""


def inertias(run: Run) -> tuple[Result, ...]:
    """Our moments of inertia beside the paper's formulas."""
    rows, worst = [], 0.0
    for k, shape in enumerate(SHAPES):
        derived = make_die(shape, 1.0, 1.0).inertia_kg_m2
        formula, value = STATED_INERTIAS[shape]
        worst = max(worst, abs(derived / value - 1.0))
        rows.append((shape, formula, value, derived, f"{derived / value - 1.0:.1e}"))
        run.progress("Inertias", k + 1, len(SHAPES))
    same = worst <= INTEGRAL_ROUNDING
    return (
        Result(
            key="inertias",
            title="Moments of inertia of the five dice",
            stated="All five are spherical tops: "
            + ", ".join(f"{shape} {formula}" for shape, (formula, _) in STATED_INERTIAS.items())
            + ".",
            ours=f"Integrated over the volume; the largest relative difference is {worst:.1e}.",
            verdict=Verdict.REPRODUCED if same else Verdict.NOT_REPRODUCED,
            why="The integrals agree within rounding." if same else "An integral differs by more than rounding.",
            tables=(
                Table(
                    "Moments of inertia for m = 1 kg, a = 1 m.",
                    ("die", "paper", "its value", "derived", "difference"),
                    tuple(rows),
                ),
            ),
            numbers={row[0]: {"stated": row[2], "derived": row[3]} for row in rows},
        ),
    )


@dataclass(frozen=True)
class FairCut:
    """The cut at which the cut faces have their fair share."""

    chi: float
    cut: float
    standard_error: float


def fig_2(run: Run) -> tuple[Result, ...]:
    """Odds of the cut faces of truncated dipyramids as a function of the cut, at several χ."""
    shares: dict[float, list[Share]] = {chi: [] for chi in CHIS}
    rows: list[tuple[Any, ...]] = []
    for k, chi in enumerate(CHIS):
        for j, cut in enumerate(CUTS):
            tally = _thrown(run, chi, cut)
            shares[chi].append(Share(int(tally.landed[-2:].sum()), tally.rested))
            rows.append((chi, cut, shares[chi][-1].value, *shares[chi][-1].interval, tally.throws - tally.rested))
            run.progress("Fig. 2", k * len(CUTS) + j + 1, len(CHIS) * len(CUTS))
    fair = [each for chi in CHIS if (each := fair_cut(chi, shares[chi])) is not None]
    verdict, ours, why = _judged(fair)
    return (
        Result(
            key="fig_2",
            title="Fig. 2: a dipyramid with cut tips, fair by continuity",
            stated="A dipyramid of 2n faces with both tips cut is fair at some cut, by continuity; no such die can be built.",
            ours=ours,
            verdict=verdict,
            why=why,
            tables=(
                Table(
                    f"Share of the throws that land on one of the two cuts, {run.effort.dipyramid_throws:,} throws each; n = "
                    f"{SIDES}, spin {SPIN_RAD_S:g} rad/s. Fair: {FAIR:.3f}. Wilson intervals of 95 %.",
                    ("χ", "cut [share of the tip]", "lands on a cut", "low", "high", "on no face"),
                    tuple(rows),
                ),
            ),
            pictures=(_draw(run, shares),),
            numbers={
                "sides": SIDES,
                "radius_m": RADIUS_M,
                "fair_share": FAIR,
                "spin_rad_s": SPIN_RAD_S,
                "cuts": CUTS,
                "shares": {f"chi_{chi:g}": [share_table(share) for share in row] for chi, row in shares.items()},
                "fair_cuts": [
                    {"chi": each.chi, "cut": each.cut, "standard_error": each.standard_error} for each in fair
                ],
            },
        ),
    )


def _thrown(run: Run, chi: float, cut: float) -> Tally:
    solid = truncated_dipyramid(SIDES, RADIUS_M, RADIUS_M, cut)
    stage = ThrowSetup(die_from_solid(solid, MASS_KG), SmoothImpact(chi))
    conditions = UniformConditions(SPIN_RAD_S, HEIGHT_M)
    throws = run.effort.dipyramid_throws
    *_, tally = tally_throws(stage, conditions, throws, run.seed, chunk=CHUNK_THROWS, threads=run.threads)
    return tally


def fair_cut(chi: float, shares: Sequence[Share]) -> FairCut | None:
    """The cut at which the interpolated share equals the fair share; None if it does nowhere."""
    values = [share.value for share in shares]
    for k, (a, b) in enumerate(pairwise(values)):
        if (a - FAIR) * (b - FAIR) <= 0.0 and a != b:
            width = CUTS[k + 1] - CUTS[k]
            part = (FAIR - a) / (b - a)
            errors = [sqrt(share.value * (1.0 - share.value) / share.of) for share in shares[k : k + 2]]
            spread = hypot((1.0 - part) * errors[0], part * errors[1]) * width / abs(b - a)
            return FairCut(chi, CUTS[k] + part * width, spread)
    return None


def _judged(fair: Sequence[FairCut]) -> tuple[Verdict, str, str]:
    if len(fair) < len(CHIS):
        return (
            Verdict.NOT_REPRODUCED,
            f"A fair cut was found at {len(fair)} of {len(CHIS)} values of χ.",
            "Within the range of the tried cuts, the odds do not reach the fair share at every χ.",
        )
    ours = "Fair where the cut takes " + ", ".join(
        f"{each.cut:.3f} ± {each.standard_error:.3f} (χ = {each.chi:g})" for each in fair
    )
    gaps = [abs(a.cut - b.cut) / hypot(a.standard_error, b.standard_error) for a in fair for b in fair if a is not b]
    if max(gaps) > SIGNIFICANT_SIGMAS:
        why = (
            f"The odds reach the fair share at every χ, but at a cut that depends on χ (up to {cell(max(gaps))} standard errors "
            "apart). A die that is fair on one table is therefore unfair on another, which is the paper's argument why none "
            "can be built."
        )
    else:
        why = (
            "The odds reach the fair share at every χ. This number of throws does not show that the cut depends on χ, the "
            f"paper's argument why none can be built (at most {cell(max(gaps))} standard errors apart)."
        )
    return Verdict.REPRODUCED, ours + " of each tip's height.", why


def _draw(run: Run, shares: dict[float, list[Share]]) -> Picture:
    figure = drawing((8.4, 3.6))
    ax = figure.subplots()
    for k, (chi, row) in enumerate(shares.items()):
        values = np.array([share.value for share in row])
        errors = np.abs(np.array([share.interval for share in row]).T - values)
        colour = hex_colour(FACE_COLOURS[(0, 2, 4)[k]])
        ax.errorbar(CUTS, values, errors, fmt="o-", markersize=4, linewidth=0.9, color=colour, label=f"χ = {chi:g}")
    ax.axhline(FAIR, color="#444444", linewidth=0.8, linestyle=(0, (4, 3)))
    ax.annotate("fair", (0.01, FAIR), xycoords=("axes fraction", "data"), xytext=(0, 3), textcoords="offset points")
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("cut [share of each tip's height]")
    ax.set_ylabel("lands on one of the two cuts [share]")
    ax.legend(frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(run.folder / "fig_2.png")
    return Picture("fig_2.png", f"How often a cut dipyramid of {2 * SIDES} side faces lands on one of its two cuts.")
