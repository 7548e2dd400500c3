"""The paper's largest Lyapunov exponents: at χ = 1, and on an oscillating table.

The paper gives four numbers without a unit, initial conditions, or the motion of the table. The exponent of a motion that
conserves energy depends on this energy. Several initial conditions are therefore compared, each in three units.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.die import Die
from ..model.ensembles import CONDITIONS, LyapunovExponents, ThrowSetup, largest_lyapunov_exponent, states_of
from ..model.laws import LEVEL, SmoothImpact, Table
from ..model.throw import State, unpacked_state
from ..replay.elements import FACE_COLOURS, hex_colour
from .corner_sequences import START
from .results import CHI, Picture, Result, Run, Verdict, cell, cube, drawing, tetrahedron
from .results import Table as Rows

STATED = {"tetrahedron": 0.076, "cube": 0.067}
STATED_ON_MOVING = {"tetrahedron": 0.169, "cube": 0.183}
HEIGHTS_M = (0.1, 0.3, 1.0)
"""Release heights, for several energies; 0.3 m is that of Fig. 5."""
MOTIONS = ((0.001, 25.0), (0.001, 50.0), (0.003, 25.0), (0.003, 50.0))
"""Amplitude [m] and frequency [Hz] of the table."""
UNITS = ("per_second", "per_impact", "per_unit")
UNIT_NAMES = {"per_second": "per second", "per_impact": "per impact", "per_unit": "per √(a/g)"}
LEFT_OUT = 200
"""Impacts at the beginning of each orbit that do not count."""
SIGNIFICANT_SIGMAS = 3.0
"""Difference of two ratios, in standard errors, from which they count as different."""
RATIO_ROUNDING = 0.016
"""Rounding error of the paper's ratio: half a unit of the last digit of both numbers."""


def exponents(run: Run) -> tuple[Result, ...]:
    """The results for both pairs of numbers."""
    dice = (tetrahedron(), cube())
    total, done = len(dice) * (len(HEIGHTS_M) + len(MOTIONS)), 0
    at_chi_1: dict[tuple[str, float], LyapunovExponents | str] = {}
    moving: dict[tuple[str, tuple[float, float]], LyapunovExponents | str] = {}
    for die in dice:
        for height in HEIGHTS_M:
            at_chi_1[die.solid.name, height] = _exponent(run, die, height, 1.0, LEVEL)
            done += 1
            run.progress("Exponents", done, total)
        for motion in MOTIONS:
            table = Table(amplitude_m=motion[0], frequency_hz=motion[1])
            moving[die.solid.name, motion] = _exponent(run, die, HEIGHTS_M[1], CHI, table)
            done += 1
            run.progress("Exponents", done, total)
    return _at_chi_1(run, at_chi_1), _on_moving(moving)


def start_of(height_m: float) -> State:
    """The initial state of Fig. 5 at another height, with v0z as printed."""
    given = START | {"z0": height_m, "vz": -0.7}
    return unpacked_state(states_of(np.array([[given.get(name, 0.0) for name in CONDITIONS]]))[0], 0.0)


def _exponent(run: Run, die: Die, height_m: float, chi: float, table: Table) -> LyapunovExponents | str:
    """The exponent, or the reason why there is none: on a weakly oscillating table a die comes to rest."""
    try:
        return largest_lyapunov_exponent(
            ThrowSetup(die, SmoothImpact(chi), table),
            start_of(height_m),
            impacts=run.effort.orbit_impacts,
            orbits=run.effort.orbits,
            left_out=LEFT_OUT,
            seed=run.seed,
        )
    except ValueError as error:
        if "bounced only" not in str(error):
            raise
        return str(error)


def _at_chi_1(run: Run, found: dict[tuple[str, float], LyapunovExponents | str]) -> Result:
    kept = {key: each for key, each in found.items() if isinstance(each, LyapunovExponents)}
    stated = STATED["tetrahedron"] / STATED["cube"]
    ratios = {
        unit: [_ratio(kept["tetrahedron", height], kept["cube", height], unit) for height in HEIGHTS_M]
        for unit in UNITS
    }
    paper_start = [kept[name, HEIGHTS_M[1]] for name in STATED]
    values = "; ".join(
        f"{name} {_with_error(each, 'per_second')} s⁻¹, {_with_error(each, 'per_impact')} per impact, "
        f"{_with_error(each, 'per_unit')} per √(a/g)"
        for name, each in zip(STATED, paper_start, strict=True)
    )
    why = (
        "The paper states neither the unit nor the initial conditions, and the exponent depends on the energy (table). None of "
        "the three units gives the paper's numbers from any of these initial conditions. " + _on_ratios(stated, ratios)
    )
    return Result(
        key="exponents_chi_1",
        title="Largest Lyapunov exponents at χ = 1",
        stated=f"Tetrahedron {cell(STATED['tetrahedron'])}, cube {cell(STATED['cube'])}; no unit.",
        ours=f"From the initial conditions of Fig. 5: {values}.",
        verdict=Verdict.NOT_DECIDABLE,
        why=why,
        tables=(
            Rows(
                "Largest exponents at χ = 1, from the initial conditions of Fig. 5 at several heights: "
                f"{run.effort.orbits} orbits of {run.effort.orbit_impacts} impacts each, with standard errors.",
                ("die", "z0 [m]", *UNIT_NAMES.values()),
                tuple(
                    (name, height, *(_with_error(each, unit) for unit in UNITS))
                    for (name, height), each in kept.items()
                ),
            ),
        ),
        pictures=(_draw(run, kept),),
        numbers={
            "stated": STATED,
            "ratio_stated": stated,
            "ratios": {
                unit: [
                    {"z0_m": height, "ratio": ratio, "standard_error": error}
                    for height, (ratio, error) in zip(HEIGHTS_M, row, strict=True)
                ]
                for unit, row in ratios.items()
            },
            "found": [{"die": name, "z0_m": height, **_plain(each)} for (name, height), each in found.items()],
        },
    )


def _on_ratios(stated: float, ratios: dict[str, list[tuple[float, float]]]) -> str:
    """Whether a change of unit alone could explain the paper's two numbers."""
    rows = []
    for unit, row in ratios.items():
        met = any(abs(ratio - stated) <= SIGNIFICANT_SIGMAS * error + RATIO_ROUNDING for ratio, error in row)
        low, high = min(ratio for ratio, _ in row), max(ratio for ratio, _ in row)
        rows.append(f"{low:.2f} to {high:.2f} {UNIT_NAMES[unit]} ({'agrees' if met else 'does not agree'})")
    here = ", ".join(rows)
    return f"The ratio of tetrahedron to cube is independent of the unit. It is {stated:.2f} in the paper, and here {here}."


def _ratio(a: LyapunovExponents, b: LyapunovExponents, unit: str) -> tuple[float, float]:
    """The ratio of two exponents and its standard error."""
    x, y = getattr(a, unit), getattr(b, unit)
    spread = np.hypot(getattr(a, f"{unit}_error") / x, getattr(b, f"{unit}_error") / y)
    return float(x / y), float(abs(x / y) * spread)


def _on_moving(found: dict[tuple[str, tuple[float, float]], LyapunovExponents | str]) -> Result:
    kept = {key: each for key, each in found.items() if isinstance(each, LyapunovExponents)}
    larger = sum(
        kept["cube", motion].per_second > kept["tetrahedron", motion].per_second
        for motion in MOTIONS
        if ("cube", motion) in kept and ("tetrahedron", motion) in kept
    )
    both = sum(("cube", motion) in kept and ("tetrahedron", motion) in kept for motion in MOTIONS)
    spread = [each.per_second for each in kept.values()]
    span = f"{cell(min(spread))} to {cell(max(spread))} s⁻¹" if spread else "no exponent"
    rows = [
        (name, 1e3 * motion[0], motion[1], *(_with_error(each, unit) for unit in UNITS))
        if isinstance(each, LyapunovExponents)
        else (name, 1e3 * motion[0], motion[1], "comes to rest on the table", "—", "—")
        for (name, motion), each in found.items()
    ]
    return Result(
        key="exponents_moving_table",
        title="Largest Lyapunov exponents on an oscillating table",
        stated=f"Tetrahedron {cell(STATED_ON_MOVING['tetrahedron'])}, cube {cell(STATED_ON_MOVING['cube'])}; no unit.",
        ours=f"{span[0].upper()}{span[1:]}, depending on amplitude and frequency; that of the cube is larger in {larger} of "
        f"{both} motions.",
        verdict=Verdict.NOT_DECIDABLE,
        why=f"The paper does not state amplitude and frequency of the table, χ and the unit, and the exponent depends on all. "
        f"Here χ = {CHI:g}.",
        tables=(
            Rows(
                "Largest exponents on an oscillating table, with standard errors.",
                ("die", "amplitude [mm]", "frequency [Hz]", *UNIT_NAMES.values()),
                tuple(rows),
            ),
        ),
        numbers={
            "stated": STATED_ON_MOVING,
            "chi": CHI,
            "found": [
                {"die": name, "amplitude_m": motion[0], "frequency_hz": motion[1], **_plain(each)}
                for (name, motion), each in found.items()
            ],
        },
    )


def _with_error(each: LyapunovExponents, unit: str) -> str:
    return f"{getattr(each, unit):.3f} ± {getattr(each, f'{unit}_error'):.3f}"


def _plain(each: LyapunovExponents | str) -> dict[str, Any]:
    if isinstance(each, str):
        return {"message": each}
    return {name: getattr(each, name) for unit in UNITS for name in (unit, f"{unit}_error")} | {"impacts": each.impacts}


def _draw(run: Run, kept: dict[tuple[str, float], LyapunovExponents]) -> Picture:
    """The running estimate against the number of impacts, from the initial conditions of Fig. 5."""
    figure = drawing((8.4, 3.4))
    ax = figure.subplots()
    for k, name in enumerate(STATED):
        each = kept[name, HEIGHTS_M[1]]
        count = np.arange(1, each.impacts + 1)
        running = np.cumsum(each.logs, axis=1) / each.times_s
        colour = hex_colour(FACE_COLOURS[(0, 2)[k]])
        ax.plot(count, running.T, linewidth=0.5, color=colour, alpha=0.6)
        ax.axhline(each.per_second, color=colour, linewidth=1.4, label=f"{name}: {_with_error(each, 'per_second')} s⁻¹")
    ax.set_xscale("log")
    ax.set_ylim(0.0, 2.0 * max(each.per_second for each in kept.values()))
    ax.set_xlabel("impacts [number]")
    ax.set_ylabel("running estimate [1/s]")
    ax.legend(frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(run.folder / "exponents.png")
    return Picture(
        "exponents.png", "Convergence of the exponents at χ = 1 for each orbit, from the initial conditions of Fig. 5."
    )
