"""The paper's films: the number of bounces after which the orientation no longer changes, as a function of χ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.die import make_die
from ..model.ensembles import BLOCK, ThrowSetup, UniformConditions, chunks_in_order, drawn_states
from ..model.laws import SmoothImpact
from ..replay.elements import FACE_COLOURS, hex_colour
from .results import MASS_KG, Picture, Result, Run, Table, Verdict, drawing

Counts = NDArray[np.int64]

STATED = {"cube": 11, "icosahedron": 10}
EDGES_M = {"cube": 0.02, "icosahedron": 0.012}
"""The paper does not state the sizes of the dice on its films."""
RELEASE_M = 0.6
"""Release height of the paper."""
SPIN_RAD_S = 20.0
"""The paper does not state the spin."""
CHIS = (0.1, 0.3, 0.5, 0.6, 0.7, 0.8)
MAX_IMPACTS = 150
"""Impacts at which the lowest face is recorded; a die with more counts as if it had this number."""
CENTRAL_SHARE = 0.9
"""Share of the throws between the two quantiles that are given."""


def bounces(run: Run) -> tuple[Result, ...]:
    """The result for the cube and the icosahedron of the films."""
    counts: dict[tuple[str, float], Counts] = {}
    for k, shape in enumerate(STATED):
        for j, chi in enumerate(CHIS):
            counts[shape, chi] = last_face_changes(run, shape, chi)
            run.progress("Experiment", k * len(CHIS) + j + 1, len(STATED) * len(CHIS))
    rows = [
        (
            shape,
            chi,
            float(np.median(each)),
            *_central_range(each),
            float(np.mean(each >= STATED[shape])),
            STATED[shape],
        )
        for (shape, chi), each in counts.items()
    ]
    agreeing = {
        shape: [
            chi
            for chi in CHIS
            if _central_range(counts[shape, chi])[0] <= stated <= _central_range(counts[shape, chi])[1]
        ]
        for shape, stated in STATED.items()
    }
    ours = "; ".join(
        f"{shape}: {stated} lies within the central {100 * CENTRAL_SHARE:.0f} % of the throws at χ = "
        + (", ".join(f"{chi:g}" for chi in agreeing[shape]) or "none of the tried values")
        for shape, stated in STATED.items()
    )
    return (
        Result(
            key="experiment",
            title="The films: bounces until the orientation no longer changes",
            stated="Released from 60 cm, a cube on a mirror plane no longer changes its orientation after 11 bounces, an "
            "icosahedron on cork after 10.",
            ours=ours + ".",
            verdict=Verdict.NOT_DECIDABLE,
            why="The paper does not state χ, friction, spin and the sizes of the dice, and reports one throw of each. The smooth "
            "model gives such numbers at the χ listed above, which neither confirms nor refutes it.",
            tables=(
                Table(
                    f"Bounces after which the lowest face stays the one that the die lands on: {run.effort.bounce_throws:,} "
                    f"throws each from {RELEASE_M:g} m, spin {SPIN_RAD_S:g} rad/s, a = 20 mm (cube), 12 mm (icosahedron).",
                    ("die", "χ", "median", "5 %", "95 %", "share with as many or more", "paper"),
                    tuple(rows),
                ),
            ),
            pictures=(_draw(run, counts),),
            numbers={
                "stated": STATED,
                "found": [
                    {
                        "die": row[0],
                        "chi": row[1],
                        "median": row[2],
                        "low": row[3],
                        "high": row[4],
                        "share_as_many": row[5],
                    }
                    for row in rows
                ],
            },
        ),
    )


def last_face_changes(run: Run, shape: str, chi: float) -> Counts:
    """(n,) number of the last impact at which the lowest face was not yet the landing face."""
    die = make_die(shape, EDGES_M[shape], MASS_KG)
    stage, conditions = ThrowSetup(die, SmoothImpact(chi)), UniformConditions(SPIN_RAD_S, (RELEASE_M, RELEASE_M))

    def work(first: int, end: int) -> Counts:
        landings = stage.throw(drawn_states(conditions, die, run.seed, first, end), MAX_IMPACTS)
        return last_other(landings.lowest, landings.face)

    throws = run.effort.bounce_throws
    return np.concatenate([part for _, _, part in chunks_in_order(work, 0, throws, BLOCK // 4, run.threads)])


def last_other(lowest: Counts, face: Counts) -> Counts:
    """Index (m,) of the last column of `lowest` (n, k) that is not the landing face, 0 if none; for the m that landed."""
    landed = face > 0
    other = lowest[landed] != face[landed, None]
    columns = np.arange(lowest.shape[1])
    return np.asarray(np.where(other, columns, 0).max(1))


def _central_range(counts: Counts) -> tuple[float, float]:
    low, high = np.quantile(counts, [0.5 - 0.5 * CENTRAL_SHARE, 0.5 + 0.5 * CENTRAL_SHARE])
    return float(low), float(high)


def _draw(run: Run, counts: dict[tuple[str, float], Counts]) -> Picture:
    figure = drawing((8.4, 3.4))
    ax = figure.subplots()
    for k, shape in enumerate(STATED):
        median = [float(np.median(counts[shape, chi])) for chi in CHIS]
        low, high = np.array([_central_range(counts[shape, chi]) for chi in CHIS]).T
        colour = hex_colour(FACE_COLOURS[(0, 2)[k]])
        ax.plot(
            CHIS,
            median,
            "o-",
            markersize=4,
            color=colour,
            label=f"{shape}: median and {100 * CENTRAL_SHARE:.0f} % of the throws",
        )
        ax.fill_between(CHIS, low, high, color=colour, alpha=0.15, linewidth=0)
        ax.axhline(STATED[shape], color=colour, linewidth=0.8, linestyle=(0, (4, 3)))
    ax.set_xlabel("χ [1]")
    ax.set_ylabel("bounces until the face stays [number]")
    ax.legend(frameon=False, loc="upper left")
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(run.folder / "experiment.png")
    return Picture("experiment.png", "Bounces until the lowest face stays. Dashed: the paper's films.")
