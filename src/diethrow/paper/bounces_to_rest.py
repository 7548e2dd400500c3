"""The paper's films: after how many bounces the orientation no longer changes, over χ."""

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
RELEASE_M, SPIN_RAD_S = 0.6, 20.0
"""The height is the paper's; the spin is not stated."""
CHIS = (0.1, 0.3, 0.5, 0.6, 0.7, 0.8)
NOTED = 150
"""Impacts at which the lowest face is noted; a die that takes longer counts as if it took so many."""
MIDDLE = 0.9
"""Part of the throws between the ends that are given."""


def bounces(run: Run) -> tuple[Result, ...]:
    """The cube and the icosahedron of the films."""
    counts: dict[tuple[str, float], Counts] = {}
    for k, shape in enumerate(STATED):
        for j, chi in enumerate(CHIS):
            counts[shape, chi] = settled(run, shape, chi)
            run.progress("Experiment", k * len(CHIS) + j + 1, len(STATED) * len(CHIS))
    rows = [
        (shape, chi, float(np.median(each)), *_middle(each), float(np.mean(each >= STATED[shape])), STATED[shape])
        for (shape, chi), each in counts.items()
    ]
    agreeing = {
        shape: [chi for chi in CHIS if _middle(counts[shape, chi])[0] <= stated <= _middle(counts[shape, chi])[1]]
        for shape, stated in STATED.items()
    }
    told = "; ".join(
        f"{shape}: {stated} lies in the middle {100 * MIDDLE:.0f} % of the throws at χ = "
        + (", ".join(f"{chi:g}" for chi in agreeing[shape]) or "none of those tried")
        for shape, stated in STATED.items()
    )
    return (
        Result(
            key="experiment",
            title="The films: bounces until the orientation no longer changes",
            stated="Released from 60 cm, a cube on a mirror plane no longer changes its orientation after 11 bounces, an "
            "icosahedron on cork after 10.",
            ours=told + ".",
            verdict=Verdict.NOT_DECIDABLE,
            why="χ, friction, spin and the sizes of the dice are not stated, and one throw of each is told. The smooth model "
            "makes such numbers where it says so above, which neither confirms nor refutes it.",
            tables=(
                Table(
                    f"Bounces after which the lowest face stays the one that the die lands on: {run.effort.bounce_throws:,} "
                    f"throws each from {RELEASE_M:g} m, spin {SPIN_RAD_S:g} rad/s, a = 20 mm (cube), 12 mm (icosahedron).",
                    ("die", "χ", "median", "5 %", "95 %", "share with so many or more", "paper"),
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


def settled(run: Run, shape: str, chi: float) -> Counts:
    """(n,) number of the last impact at which the lowest face was not yet the one that the die landed on."""
    die = make_die(shape, EDGES_M[shape], MASS_KG)
    stage, conditions = ThrowSetup(die, SmoothImpact(chi)), UniformConditions(SPIN_RAD_S, (RELEASE_M, RELEASE_M))

    def work(first: int, end: int) -> Counts:
        landings = stage.throw(drawn_states(conditions, die, run.seed, first, end), NOTED)
        return last_other(landings.lowest, landings.face)

    throws = run.effort.bounce_throws
    return np.concatenate([part for _, _, part in chunks_in_order(work, 0, throws, BLOCK // 4, run.threads)])


def last_other(lowest: Counts, face: Counts) -> Counts:
    """Index (m,) of the last column of `lowest` (n, k) that is not the landed face, 0 if none; only the m that landed."""
    landed = face > 0
    other = lowest[landed] != face[landed, None]
    columns = np.arange(lowest.shape[1])
    return np.asarray(np.where(other, columns, 0).max(1))


def _middle(counts: Counts) -> tuple[float, float]:
    low, high = np.quantile(counts, [0.5 - 0.5 * MIDDLE, 0.5 + 0.5 * MIDDLE])
    return float(low), float(high)


def _draw(run: Run, counts: dict[tuple[str, float], Counts]) -> Picture:
    figure = drawing((8.4, 3.4))
    ax = figure.subplots()
    for k, shape in enumerate(STATED):
        median = [float(np.median(counts[shape, chi])) for chi in CHIS]
        low, high = np.array([_middle(counts[shape, chi]) for chi in CHIS]).T
        colour = hex_colour(FACE_COLOURS[(0, 2)[k]])
        ax.plot(
            CHIS,
            median,
            "o-",
            markersize=4,
            color=colour,
            label=f"{shape}: median and {100 * MIDDLE:.0f} % of the throws",
        )
        ax.fill_between(CHIS, low, high, color=colour, alpha=0.15, linewidth=0)
        ax.axhline(STATED[shape], color=colour, linewidth=0.8, linestyle=(0, (4, 3)))
    ax.set_xlabel("χ [1]")
    ax.set_ylabel("bounces until settled [number]")
    ax.legend(frameon=False, loc="upper left")
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(run.folder / "experiment.png")
    return Picture("experiment.png", "Bounces until the lowest face stays. Dashed: the paper's films.")
