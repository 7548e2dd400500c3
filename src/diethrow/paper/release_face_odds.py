"""The paper's odds: the probability that a cube lands on the face that was lowest at its release.

The paper reports four numbers and does not state when the lowest face is determined. Here every impact is simulated until
the landing face is decided. The face that is lowest at each of the first impacts is given as well; its odds differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import inf, sqrt

from ..commands.model.face_odds import share_table
from ..model.ensembles import PaperConditions, Share, Tally, ThrowSetup, UniformConditions, tally_throws
from ..model.laws import SmoothImpact
from ..replay.elements import FACE_COLOURS, hex_colour
from .results import CHI, CUBE_EDGE_M, CURVE_FACES, Picture, Result, Run, Table, Verdict, cell, cube, drawing

HEIGHT_M = (15.0 * CUBE_EDGE_M, 20.0 * CUBE_EDGE_M)
SPINS_RAD_S = (20.0, 30.0, 40.0, 300.0, 1000.0)
"""Values of ω_η. The paper gives one number for 20 to 40 rad/s."""
FIRST_IMPACTS = 6
"""Number of first impacts at which the lowest face is recorded."""
SCAN_RAD_S = (0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 18.0, 20.0, 22.0, 24.0, 26.0, 28.0, 30.0, 40.0, 60.0)
"""Spins for the odds at the first impact; the paper does not state the spin."""
PAPER_THROWS = 2_000_000
MAX_WIDTH = 0.015
"""Three standard errors from which the interpretations of a number cannot be distinguished."""
HALF_UNIT = 0.0005
"""Half a unit of the last printed digit of the paper."""


@dataclass(frozen=True)
class Statement:
    """One of the paper's numbers."""

    key: str
    title: str
    share: float
    spins_rad_s: tuple[float, ...]
    impacts: tuple[int, ...]
    """Impacts to which the lowest face may refer."""


STATEMENTS = (
    Statement("odds_20_to_40", "Odds at ω_η = 20 to 40 rad/s, 4 to 5 bounces", 0.199, (20.0, 30.0, 40.0), (4, 5, 6)),
    Statement("odds_300", "Odds at ω_η = 300 rad/s", 0.121, (300.0,), tuple(range(1, FIRST_IMPACTS + 1))),
    Statement("odds_1000", "Odds at ω_η = 1000 rad/s", 0.180, (1000.0,), tuple(range(1, FIRST_IMPACTS + 1))),
)
NO_BOUNCE = 0.548


def odds_results(run: Run) -> tuple[Result, ...]:
    """The results for the four numbers of the paper."""
    total = len(SPINS_RAD_S) * run.effort.throws
    tallies: dict[float, Tally] = {}
    for k, spin in enumerate(SPINS_RAD_S):
        for tally in _tallies(run, PaperConditions((0.0, spin, 0.0), HEIGHT_M), CHI, run.effort.throws):
            run.progress("Odds", k * run.effort.throws + tally.throws, total)
        tallies[spin] = tally
    picture = _draw(run, tallies)
    judged = [_result(statement, tallies) for statement in STATEMENTS]
    first = judged[0]
    shown = Result(**{**vars(first), "pictures": (picture,)})
    return (_no_bounce(run), shown, *judged[1:])


def _tallies(run: Run, conditions: PaperConditions | UniformConditions, chi: float, throws: int) -> Iterator[Tally]:
    stage = ThrowSetup(cube(), SmoothImpact(chi))
    return tally_throws(stage, conditions, throws, run.seed, after=FIRST_IMPACTS, threads=run.threads)


def readings(tally: Tally, impacts: tuple[int, ...]) -> dict[str, Share]:
    """The possible interpretations of the odds of the face that was lowest at release."""
    at_rest = {
        "at rest, of all throws": Share(tally.landed_as_start, tally.throws),
        "at rest, of those that landed": Share(tally.landed_as_start, tally.rested),
    }
    return at_rest | {f"lowest at impact {k}": Share(int(tally.as_start[k]), tally.throws) for k in impacts}


def agrees(stated: float, share: Share) -> bool:
    """Whether the paper's number, rounded and from 2 × 10⁶ throws, is consistent with this share."""
    return bool(abs(stated - share.value) <= HALF_UNIT + _width(share))


def _width(share: Share) -> float:
    """Three standard errors of the difference between a share and the paper's; infinite without counts."""
    if not share.of:
        return inf
    return 3.0 * sqrt(share.value * (1.0 - share.value) * (1.0 / share.of + 1.0 / PAPER_THROWS))


def judge(stated: float, by_spin: Mapping[float, Mapping[str, Share]]) -> tuple[Verdict, str]:
    """The verdict on one number, from its interpretations at each spin for which it is stated.

    A number for a range of spins agrees with an interpretation that takes this value within the range.
    """

    def met(name: str) -> bool:
        shares = [each[name] for each in by_spin.values()]
        values = [share.value for share in shares]
        return any(agrees(stated, share) for share in shares) or min(values) <= stated <= max(values)

    names = list(next(iter(by_spin.values())))
    if max(_width(share) for each in by_spin.values() for share in each.values()) > MAX_WIDTH:
        return Verdict.NOT_DECIDABLE, "This run has too few throws for a verdict; use the full run."
    at_rest = [name for name in names if name.startswith("at rest") and met(name)]
    before = [name for name in names if not name.startswith("at rest") and met(name)]
    if at_rest:
        return Verdict.REPRODUCED, f"It agrees with the odds {at_rest[0]}."
    if before:
        return (
            Verdict.NOT_DECIDABLE,
            f"The landing face does not have these odds, but the face that is {' or '.join(before)} has. The paper does not "
            "state when the face is determined.",
        )
    return (
        Verdict.NOT_REPRODUCED,
        "Neither the face at rest nor the lowest face at any of the first impacts has these odds.",
    )


def _result(statement: Statement, tallies: Mapping[float, Tally]) -> Result:
    by_spin = {spin: readings(tallies[spin], statement.impacts) for spin in statement.spins_rad_s}
    verdict, why = judge(statement.share, by_spin)
    aside = {spin: Share(tallies[spin].throws - tallies[spin].rested, tallies[spin].throws) for spin in by_spin}
    if any(share.value > 0.01 for share in aside.values()):
        spun = ", ".join(cell(share.value) for share in aside.values())
        why += (
            f" A share of {spun} of the throws lands on no face: without friction nothing reduces the spin about the vertical, "
            "so these dice spin forever. The paper does not state how it counts them."
        )
    values = [each["at rest, of those that landed"].value for each in by_spin.values()]
    rest = " to ".join(dict.fromkeys((cell(min(values)), cell(max(values)))))
    return Result(
        key=statement.key,
        title=statement.title,
        stated=f"A cube lands on the face that was lowest at the start with a probability of {cell(statement.share)}.",
        ours=f"At rest, of those that landed: {rest}.",
        verdict=verdict,
        why=why,
        tables=(_table(statement.share, by_spin, aside),),
        numbers={
            "stated": statement.share,
            "chi": CHI,
            "throws": next(iter(tallies.values())).throws,
            "by_spin": {
                f"omega_eta_{spin:g}": {name: share_table(share) for name, share in each.items()}
                | {"on no face": share_table(aside[spin])}
                for spin, each in by_spin.items()
            },
        },
    )


def _table(stated: float, by_spin: Mapping[float, Mapping[str, Share]], aside: Mapping[float, Share]) -> Table:
    rows = []
    for spin, each in by_spin.items():
        for name, share in each.items():
            rows.append((spin, name, share.value, *share.interval, "yes" if agrees(stated, share) else "no"))
        rows.append((spin, "on no face", aside[spin].value, *aside[spin].interval, "—"))
    throws = next(iter(aside.values())).of
    return Table(
        f"Odds of the face that was lowest at release, {throws:,} throws for each spin at χ = {CHI:g}; Wilson intervals of "
        f"95 %. The paper's number: {cell(stated)}.",
        ("ω_η [rad/s]", "counted", "share", "low", "high", "agrees"),
        tuple(rows),
    )


def _no_bounce(run: Run) -> Result:
    """The result for the paper's odds with no bounce, whose spin it does not state."""
    scans: dict[str, dict[float, Tally]] = {"Euler angles": {}, "orientations": {}}
    steps = 2 * len(SCAN_RAD_S)
    for k, spin in enumerate(SCAN_RAD_S):
        by_angles, by_orientation = PaperConditions((0.0, spin, 0.0), HEIGHT_M), UniformConditions(spin, HEIGHT_M)
        *_, scans["Euler angles"][spin] = _tallies(run, by_angles, 0.0, run.effort.scan_throws)
        run.progress("Odds, no bounce", 2 * k + 1, steps)
        *_, scans["orientations"][spin] = _tallies(run, by_orientation, 0.0, run.effort.scan_throws)
        run.progress("Odds, no bounce", 2 * k + 2, steps)
    rows = [
        (f"uniform {name}", spin, *_wilson(Share(int(t.as_start[1]), t.throws)), *_wilson(_rest(t)))
        for name, scan in scans.items()
        for spin, t in scan.items()
    ]
    at_first = [(spin, t.as_start[1] / t.throws) for spin, t in scans["Euler angles"].items()]
    passed = crossings(at_first, NO_BOUNCE)
    low, high = min(share for _, share in at_first), max(share for _, share in at_first)
    within = low <= NO_BOUNCE <= high
    return Result(
        key="odds_no_bounce",
        title="Odds with no bounce",
        stated=f"With no bounce a cube lands on the face that was lowest at the start with a probability of "
        f"{cell(NO_BOUNCE)}.",
        ours=f"The face that was lowest at release is the lowest at the first impact with a probability from {cell(low)} to "
        f"{cell(high)}, by ω_η"
        + (f"; it is {cell(NO_BOUNCE)} at {', '.join(f'{spin:.3g}' for spin in passed)} rad/s." if within else "."),
        verdict=Verdict.NOT_DECIDABLE if within else Verdict.NOT_REPRODUCED,
        why="The number depends on ω_η, which the paper does not state here and which sets how far the die turns before the "
        "first impact."
        + (
            " Some ω_η gives the number, so it can be neither confirmed nor refuted."
            if within
            else " None of the tried ω_η gives it."
        ),
        tables=(
            Table(
                f"Odds of the face that was lowest at release, {run.effort.scan_throws:,} throws each: at the first impact, "
                "and at rest at χ = 0, where the die rolls over its corners without bouncing. Wilson intervals of 95 %.",
                ("release", "spin [rad/s]", "first impact", "low", "high", "at rest, χ = 0", "low", "high"),
                tuple(rows),
            ),
        ),
        pictures=(_draw_scan(run, scans),),
        numbers={
            "stated": NO_BOUNCE,
            "throws": run.effort.scan_throws,
            "omega_eta_at_stated": passed,
            "scans": {
                name: [
                    {
                        "spin_rad_s": spin,
                        "first_impact": share_table(Share(int(t.as_start[1]), t.throws)),
                        "at_rest_chi_0": share_table(_rest(t)),
                    }
                    for spin, t in scan.items()
                ]
                for name, scan in scans.items()
            },
        },
    )


def _rest(tally: Tally) -> Share:
    return Share(tally.landed_as_start, tally.rested)


def _wilson(share: Share) -> tuple[float, float, float]:
    return share.value, *share.interval


def crossings(points: list[tuple[float, float]], level: float) -> list[float]:
    """Where a curve crosses a level, with linear interpolation between its points."""
    return [
        float(x0 + (level - y0) / (y1 - y0) * (x1 - x0))
        for (x0, y0), (x1, y1) in pairwise(points)
        if min(y0, y1) <= level < max(y0, y1)
    ]


def _draw(run: Run, tallies: Mapping[float, Tally]) -> Picture:
    figure = drawing((8.4, 4.0))
    ax = figure.subplots()
    for k, (spin, tally) in enumerate(tallies.items()):
        shares = [Share(int(n), tally.throws) for n in tally.as_start[1:]] + [_rest(tally)]
        colour = hex_colour(FACE_COLOURS[CURVE_FACES[k % len(CURVE_FACES)]])
        ax.plot(range(1, FIRST_IMPACTS + 2), [s.value for s in shares], "o-", markersize=4, linewidth=0.8, color=colour,
                label=f"{spin:g} rad/s")  # fmt: skip
    for level in (*(statement.share for statement in STATEMENTS), 1.0 / 6.0):
        ax.axhline(level, color="#444444", linewidth=0.7, linestyle=(0, (4, 3)), zorder=1)
        ax.annotate("1/6" if level == 1.0 / 6.0 else f"paper: {level:.3f}", (1.0, level),
                    xycoords=("axes fraction", "data"), xytext=(3, 0), textcoords="offset points", va="center",
                    fontsize=8)  # fmt: skip
    ax.set_xticks(range(1, FIRST_IMPACTS + 2), [*(str(k) for k in range(1, FIRST_IMPACTS + 1)), "landed"])
    ax.set_xlabel("impact [number]")
    ax.set_ylabel("same lowest face as at release: probability [1]")
    ax.legend(title=r"$\omega_\eta$", frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(run.folder / "odds.png")
    return Picture(
        "odds.png",
        f"Probability that the lowest face is the one that was lowest at release: at the first impacts, and at rest among "
        f"the throws that landed; χ = {CHI:g}. Intervals are smaller than the dots in the full run.",
    )


def _draw_scan(run: Run, scans: Mapping[str, Mapping[float, Tally]]) -> Picture:
    figure = drawing((8.4, 3.6))
    ax = figure.subplots()
    for k, (name, scan) in enumerate(scans.items()):
        colour = hex_colour(FACE_COLOURS[(0, 2)[k]])
        at_first = [t.as_start[1] / t.throws for t in scan.values()]
        ax.plot(list(scan), at_first, "o-", markersize=4, color=colour, label=f"first impact, uniform {name}")
        rest = [_rest(t).value for t in scan.values()]
        ax.plot(
            list(scan), rest, "s--", markersize=4, mfc="none", color=colour, label=f"at rest, χ = 0, uniform {name}"
        )
    ax.axhline(NO_BOUNCE, color="#444444", linewidth=0.8, linestyle=(0, (4, 3)))
    ax.annotate(f"paper: {NO_BOUNCE}", (1.0, NO_BOUNCE), xycoords=("axes fraction", "data"), xytext=(-4, 4),
                textcoords="offset points", ha="right", fontsize=8)  # fmt: skip
    ax.set_ylim(0.0, 1.05)
    ax.set_xlabel("spin [rad/s]")
    ax.set_ylabel("same lowest face as at release [1]")
    ax.legend(frameon=False, fontsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(run.folder / "odds_no_bounce.png")
    return Picture("odds_no_bounce.png", "Odds of the face that was lowest at release, with no bounce, over the spin.")
