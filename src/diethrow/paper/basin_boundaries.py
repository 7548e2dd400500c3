"""The paper's Fig. 6: basins of attraction of the tetrahedron, and the structure of their boundaries.

The paper shows boundaries that are smooth after few bounces and become finer as χ grows. Two quantities measure this: the
share f(ε) of conditions with a neighbour at distance ε on another face, and the exponent α of f(ε) ~ ε^α, which is 1 for a
smooth boundary.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ..commands.model.basin_maps import BALL_EPSILONS, EPSILONS
from ..model.ensembles import (
    FIG_6_CONDITIONS,
    Axis,
    FinalStateSensitivity,
    ThrowSetup,
    UncertaintyExponent,
    Window,
    final_configurations,
    final_state_sensitivity,
    map_rows,
    uncertainty_exponent,
)
from ..model.laws import SmoothImpact
from ..replay.elements import FACE_COLOURS, hex_colour
from ..replay.figures import basin_map
from .results import CHI, CURVE_FACES, Picture, Result, Run, Table, Verdict, cell, drawing, tetrahedron

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

CHIS = (0.05, 0.2, 0.5, 1.0)
HEIGHTS_M = (0.1, 0.4)
SPINS_RAD_S = (0.0, 50.0)
"""The ranges of the plane; the paper names its axes, not their ranges."""
FIRST_IMPACTS = (1, 2, 3, 5, 8)
"""Impacts at which the lowest face is taken, for the boundaries after few bounces."""
AT_CHI_1 = 20
"""A die that keeps its energy lands on no face, so at χ = 1 the lowest face at this impact is shown."""
COMPARED_AT = 1e-3
"""Distance in sides of the plane at which the uncertain shares at several χ are compared."""
CHUNK_PIXELS = 4096
"""Pixels that a thread computes at once, in whole rows."""
CHUNK_PIXELS_CHI_1 = 256
"""The same at χ = 1, where every throw has many more impacts."""
SMOOTH_EXPONENT = 0.05
"""Largest deviation of the exponent of a smooth boundary from 1; three standard errors if those are larger."""

MISSING_FIGURE = (
    "The description of the paper from which this program was written does not include this figure or its parameters, and no "
    "public text describes it. Nothing is drawn in its place."
)


def fig_6(run: Run) -> tuple[Result, ...]:
    """Maps at each χ, and the uncertainty of the boundaries by χ and by the number of bounces."""
    steps = _Steps(run, len(CHIS) + len(CHIS) + len(FIRST_IMPACTS))
    maps = {chi: steps.after(_map(run, chi)) for chi in CHIS}
    by_chi = {chi: steps.after(_uncertain(run, chi, AT_CHI_1 if chi == 1.0 else None)) for chi in CHIS}
    by_impact = {k: steps.after(_uncertain(run, CHI, k)) for k in FIRST_IMPACTS}
    pictures = (_draw_maps(run, maps), _draw_uncertain(run, by_chi, by_impact))
    verdict, ours, why = _judged(by_chi, by_impact)
    return (
        Result(
            key="fig_6",
            title="Fig. 6: basins of attraction of a tetrahedron",
            stated="In the plane of z0 and ω_η the basins have smooth boundaries for few bounces, and ever finer ones as χ "
            "grows (χ = 0.05, 0.2, 0.5, 1).",
            ours=ours,
            verdict=verdict,
            why=why,
            tables=(_table(by_chi, by_impact),),
            pictures=pictures,
            numbers={
                "plane": {"z0_m": HEIGHTS_M, "omega_eta_rad_s": SPINS_RAD_S, "pixels": run.effort.pixels},
                "area": {
                    f"chi_{chi:g}": np.bincount(face.ravel(), minlength=5) / face.size for chi, face in maps.items()
                },
                "by_chi": {f"chi_{chi:g}": _plain(each) for chi, each in by_chi.items()},
                "by_impact_at_chi_0.5": {f"impact_{k}": _plain(each) for k, each in by_impact.items()},
                "impact_at_chi_1": AT_CHI_1,
            },
        ),
    )


def fig_7(run: Run) -> tuple[Result, ...]:
    """The result that the figure is not known."""
    return (
        Result(
            key="fig_7",
            title="Fig. 7",
            stated="Not known here.",
            ours="Nothing was computed.",
            verdict=Verdict.NOT_DECIDABLE,
            why=MISSING_FIGURE,
        ),
    )


class _Steps:
    """Reports the progress of a number of steps."""

    def __init__(self, run: Run, count: int) -> None:
        self.run, self.count, self.done = run, count, 0
        run.progress("Fig. 6", 0, count)

    def after(self, value: Any) -> Any:
        """The value, after reporting one more step."""
        self.done += 1
        self.run.progress("Fig. 6", self.done, self.count)
        return value


def stage_of(chi: float) -> ThrowSetup:
    """Die and law of the figure."""
    return ThrowSetup(tetrahedron(), SmoothImpact(chi))


def plane_of(pixels: int) -> Window:
    """The plane of the figure."""
    return Window(Axis("z0", *HEIGHTS_M, pixels), Axis("omega_eta", *SPINS_RAD_S, pixels), dict(FIG_6_CONDITIONS))


def _map(run: Run, chi: float) -> Faces:
    """(rows, columns) the face; 0 for none. At χ = 1 the lowest one at impact AT_CHI_1."""
    pixels = run.effort.pixels_chi_1 if chi == 1.0 else run.effort.pixels
    after = AT_CHI_1 if chi == 1.0 else 0
    face = np.zeros((pixels, pixels), np.int64)
    rows = max(1, (CHUNK_PIXELS_CHI_1 if chi == 1.0 else CHUNK_PIXELS) // pixels)
    for i, j, part in map_rows(stage_of(chi), plane_of(pixels), after=after, rows=rows, threads=run.threads):
        face[i:j] = (part.lowest[:, -1] if chi == 1.0 else part.face).reshape(-1, pixels)
    return face


def _uncertain(run: Run, chi: float, after: int | None) -> tuple[FinalStateSensitivity, UncertaintyExponent | None]:
    stage, window = stage_of(chi), plane_of(1)
    sensitivity = final_state_sensitivity(
        lambda points: final_configurations(stage, window, points, after),
        (HEIGHTS_M[0], SPINS_RAD_S[0]),
        (HEIGHTS_M[1], SPINS_RAD_S[1]),
        BALL_EPSILONS if chi == 1.0 else EPSILONS,
        conditions=run.effort.conditions_chi_1 if chi == 1.0 else run.effort.conditions,
        seed=run.seed,
        threads=run.threads,
    )
    return sensitivity, uncertainty_exponent(sensitivity)


Measured = dict[Any, tuple[FinalStateSensitivity, UncertaintyExponent | None]]


def _judged(by_chi: Measured, by_impact: Measured) -> tuple[Verdict, str, str]:
    shares = [share_at(by_chi[chi][0], COMPARED_AT) for chi in CHIS]
    finer = all(a < b for a, b in pairwise(shares))
    first, last = by_impact[FIRST_IMPACTS[0]], by_impact[FIRST_IMPACTS[-1]]
    smooth = first[1] is not None and abs(first[1].value - 1.0) <= max(SMOOTH_EXPONENT, 3.0 * first[1].standard_error)
    grows = share_at(first[0], COMPARED_AT) < share_at(last[0], COMPARED_AT)
    values = ", ".join(f"{cell(share)} (χ = {chi:g})" for share, chi in zip(shares, CHIS, strict=True))
    ours = (
        f"A share of {values} of the conditions has a neighbour at {COMPARED_AT:g} of the plane on another face. At "
        f"χ = {CHI:g} the exponent α is {_exponent(first[1])} for the lowest face at the first impact, and "
        f"{_exponent(last[1])} for that at impact {FIRST_IMPACTS[-1]}."
    )
    reasons = [
        "The boundaries become finer as χ grows" if finer else "The boundaries do not become finer with every χ",
        "they are smooth at the first impact (α = 1)"
        if smooth
        else "they are not shown to be smooth at the first impact",
        "and they become finer with the bounces." if grows else "and they do not become finer with the bounces.",
    ]
    why = (
        ", ".join(reasons)
        + " The paper does not state the ranges of its axes, so the figures cannot be compared directly. "
        f"A die at χ = 1 never comes to rest: there the lowest face at impact {AT_CHI_1} is shown."
    )
    return (Verdict.REPRODUCED if finer and smooth and grows else Verdict.NOT_REPRODUCED), ours, why


def share_at(sensitivity: FinalStateSensitivity, epsilon: float) -> float:
    """f at a distance, interpolated over log ε."""
    shares = [share.value for share in sensitivity.shares]
    return float(np.interp(np.log(epsilon), np.log(sensitivity.epsilons), shares))


def _exponent(exponent: UncertaintyExponent | None) -> str:
    return "not determined" if exponent is None else f"{exponent.value:.3f} ± {exponent.standard_error:.3f}"


def _rows(by_chi: Measured, by_impact: Measured) -> Iterator[tuple[Any, ...]]:
    for chi, (sensitivity, exponent) in by_chi.items():
        what = f"lowest at impact {AT_CHI_1}" if chi == 1.0 else "landed face"
        yield chi, what, *_cells(sensitivity, exponent)
    for k, (sensitivity, exponent) in by_impact.items():
        yield CHI, f"lowest at impact {k}", *_cells(sensitivity, exponent)


def _cells(sensitivity: FinalStateSensitivity, exponent: UncertaintyExponent | None) -> tuple[Any, ...]:
    return (
        share_at(sensitivity, COMPARED_AT),
        sensitivity.chance,
        sensitivity.deciding_epsilon(0.5),
        _exponent(exponent),
    )


def _table(by_chi: Measured, by_impact: Measured) -> Table:
    return Table(
        "Structure of the boundaries. Distances are shares of the plane's sides. An exponent is not determined if too few "
        "distances have a share between zero and chance.",
        (
            "χ",
            "outcome",
            f"uncertain at ε = {COMPARED_AT:g}",
            "uncertain by chance",
            "half are decided up to ε",
            "exponent α",
        ),
        tuple(_rows(by_chi, by_impact)),
    )


def _plain(measured: tuple[FinalStateSensitivity, UncertaintyExponent | None]) -> dict[str, Any]:
    sensitivity, exponent = measured
    return {
        "epsilon": sensitivity.epsilons,
        "uncertain": [share.value for share in sensitivity.shares],
        "conditions": int(sensitivity.decided.sum()),
        "uncertain_by_chance": sensitivity.chance,
        "half_decided_up_to": sensitivity.deciding_epsilon(0.5),
        "exponent": None if exponent is None else exponent.value,
        "exponent_standard_error": None if exponent is None else exponent.standard_error,
    }


def _draw_maps(run: Run, maps: dict[float, Faces]) -> Picture:
    figure = drawing((9.6, 8.0))
    for ax, (chi, face) in zip(figure.subplots(2, 2).ravel(), maps.items(), strict=True):
        window = plane_of(face.shape[0])
        basin_map(ax, window.x, window.y, face, np.zeros_like(face), 4)
        ax.set_title(f"χ = {chi:g}" + (f", lowest at impact {AT_CHI_1}" if chi == 1.0 else ""), loc="left")
        legend = ax.get_legend()
        if legend is not None and chi != CHIS[1]:
            legend.remove()
    figure.savefig(run.folder / "fig_6_basins.png")
    return Picture("fig_6_basins.png", "The face that the tetrahedron lands on, by release height and spin.")


def _draw_uncertain(run: Run, by_chi: Measured, by_impact: Measured) -> Picture:
    figure = drawing((9.6, 4.0))
    left, right = figure.subplots(1, 2, sharey=True)
    _curves(left, {f"χ = {chi:g}": each for chi, each in by_chi.items()})
    left.set_title("the landed face" + f" (χ = 1: lowest at impact {AT_CHI_1})", loc="left", fontsize=9)
    _curves(right, {f"impact {k}": each for k, each in by_impact.items()})
    right.set_title(f"the lowest face at an impact, χ = {CHI:g}", loc="left", fontsize=9)
    left.set_ylabel("uncertain conditions f(ε) [share]")
    figure.savefig(run.folder / "fig_6_uncertain.png")
    return Picture(
        "fig_6_uncertain.png",
        "Share of the conditions with a neighbour at ε on another face. A smooth boundary gives a line of slope 1.",
    )


def _curves(ax: Axes, curves: Measured) -> None:
    for k, (name, (sensitivity, _)) in enumerate(curves.items()):
        shares = np.array([share.value for share in sensitivity.shares])
        some = shares > 0.0
        colour = hex_colour(FACE_COLOURS[CURVE_FACES[k % len(CURVE_FACES)]])
        ax.plot(sensitivity.epsilons[some], shares[some], ".-", linewidth=1.0, markersize=5, color=colour, label=name)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("distance ε [sides of the plane]")
    ax.legend(loc="lower right", frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
