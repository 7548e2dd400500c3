"""The largest Lyapunov exponent of a bouncing die with its standard errors, as a table and a figure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...files.csv_and_json import write_json
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, write_provenance
from ...model.die import Die
from ...model.ensembles import ErrorGrowth, LyapunovExponents, ThrowSetup, error_growth, largest_lyapunov_exponent
from ...model.errors import InputError
from ...model.laws import LEVEL, ImpactLaw, Table
from ...model.rotations import matrix_from_quat, quat_from_euler
from ...model.throw import BodyKind, State, body_kind, checked_release
from ...replay.figures import convergence, growth_curve
from .face_odds import impact_law_of

Progress = Callable[[str, int, int], None]

REPORTED = {"tetrahedron": (0.076, 0.169), "cube": (0.067, 0.183)}
"""Values of Kapitaniak et al. (Chaos 22, 047504, 2012) at χ = 1, on a table at rest and on an oscillating one. The paper
states neither their unit nor the oscillation."""
DRIFT_SIGMAS = 6.0
"""Difference of the two halves of the orbits, in standard errors, from which a drift of the exponent is reported."""


@dataclass(frozen=True)
class LyapunovPlan:
    """The die, the law, the table, the start, and the length of the orbits."""

    die: Die
    chi: float = 1.0
    mu: float | None = None
    """Coulomb friction coefficient; None for the paper's smooth impact."""
    table: Table = LEVEL
    impacts: int = 10_000
    """Number of impacts of each orbit."""
    orbits: int = 8
    left_out: int = 200
    """Number of impacts at the beginning of each orbit that do not count."""
    seed: int = 1
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.3)
    """Initial position; the defaults of this and the fields below are those of the paper's Fig. 5."""
    euler_rad: tuple[float, float, float] = (0.001, 0.00001, 0.0001)
    velocity_m_s: tuple[float, float, float] = (0.6, 0.0, -0.7)
    omega_body_rad_s: tuple[float, float, float] = (0.0, 60.0, 0.0)

    die_files: tuple[Path, ...] = ()
    """The files that describe the die, if any do."""

    def __post_init__(self) -> None:
        if self.impacts < 2 or self.orbits < 1 or self.left_out < 0 or self.seed < 0:
            raise InputError(
                f"impacts {self.impacts}, orbits {self.orbits}, leave-out {self.left_out}, seed {self.seed}: "
                "wanted at least 2 impacts and 1 orbit, and 0 or more of the others"
            )
        if body_kind(self.die) is not BodyKind.CENTRED:
            raise InputError(
                f"a {self.die.solid.name}: wanted a die with one moment of inertia about its centroid, as exponents need it"
            )
        checked_release(self.die, self.start, self.table)
        assert self.law.parameters.size  # raises ValueError for impossible values

    @property
    def law(self) -> ImpactLaw:
        """The smooth impact or, with a μ, Coulomb friction with energetic restitution."""
        return impact_law_of(self.chi, self.mu)

    @property
    def start(self) -> State:
        """The initial state of the first orbit."""
        quaternion = quat_from_euler(np.array(self.euler_rad))
        spin = matrix_from_quat(quaternion) @ np.array(self.omega_body_rad_s, float)
        return State(0.0, np.array(self.position_m, float), quaternion, np.array(self.velocity_m_s, float), spin)

    @property
    def ends(self) -> bool:
        """Whether every such throw ends, so that it has no exponent."""
        return self.chi < 1.0 and not self.table.moves


def lyapunov(
    plan: LyapunovPlan,
    out: Path,
    *,
    force: bool = False,
    progress: Progress = lambda stage, done, total: None,
    command: tuple[str, ...] = (),
) -> LyapunovExponents | ErrorGrowth:
    """Compute the exponents of a motion that continues, or the error growth along one that ends; write them to `out`.

    Raises OutputExistsError if the folder exists (unless `force`).
    """
    watch = Stopwatch()
    with whole_folder(out, force=force, inputs=plan.die_files) as folder:
        with watch.stage("orbits"):
            result = _computed(plan, progress)
        with watch.stage("records"):
            write_json(folder / "lyapunov.json", lyapunov_table(plan, result))
        with watch.stage("figure"):
            draw(folder / "lyapunov.png", plan, result)
        write_provenance(
            folder,
            command=command,
            understood=plan,
            inputs=plan.die_files,
            seconds=watch.seconds,
            seeds={"orbits": plan.seed},
        )
    return result


def _computed(plan: LyapunovPlan, progress: Progress) -> LyapunovExponents | ErrorGrowth:
    setup = ThrowSetup(plan.die, plan.law, plan.table)
    if plan.ends:
        return error_growth(setup, plan.start)
    return largest_lyapunov_exponent(
        setup,
        plan.start,
        impacts=plan.impacts,
        orbits=plan.orbits,
        left_out=plan.left_out,
        seed=plan.seed,
        progress=lambda done, total: progress("orbits", done, total),
    )


def lyapunov_table(plan: LyapunovPlan, result: LyapunovExponents | ErrorGrowth) -> dict[str, Any]:
    """The contents of lyapunov.json."""
    if isinstance(result, ErrorGrowth):
        return {
            "exponent": None,
            "growth": {
                "log10_at_impacts": result.at_impacts,
                "times_s": result.times_s[result.vertices >= 0],
                "ending": result.ending.name.lower(),
            },
            "messages": [_no_exponent(plan)],
        }
    return {
        "exponent": {
            "per_second": {"value": result.per_second, "standard_error": result.per_second_error},
            "per_impact": {"value": result.per_impact, "standard_error": result.per_impact_error},
            "per_sqrt_edge_over_g": {"value": result.per_unit, "standard_error": result.per_unit_error},
            "impacts": result.impacts,
            "left_out": result.left_out,
            "orbits": len(result.logs),
            "per_second_of_orbits": result.logs.sum(1) / result.times_s[:, -1],
            "per_impact_of_orbits": result.logs.mean(1),
        },
        "growth": None,
        "messages": _messages(plan, result),
    }


def _no_exponent(plan: LyapunovPlan) -> str:
    return (
        f"At chi = {plan.chi:g} on a table at rest every throw ends: the error growth is finite, and there is no Lyapunov "
        "exponent. For an exponent, use chi = 1 or an oscillating table."
    )


def _messages(plan: LyapunovPlan, result: LyapunovExponents) -> list[str]:
    """Reservations about the exponents, one sentence each."""
    messages = []
    half = result.logs.shape[1] // 2
    first = result.logs[:, :half].sum() / result.times_s[:, half - 1].sum()
    second = result.logs[:, half:].sum() / (result.times_s[:, -1] - result.times_s[:, half - 1]).sum()
    if abs(first - second) > DRIFT_SIGMAS * result.per_second_error:
        messages.append(
            f"The exponent drifts: {first:.4g} per second over the first half of the orbits, {second:.4g} over the second. "
            "The motion is not stationary; leave out more impacts or use longer orbits."
        )
    if plan.table.moves and plan.chi >= 1.0:
        messages.append("At chi = 1 an oscillating table increases the energy of the die without limit.")
    return messages


def draw(path: Path, plan: LyapunovPlan, result: LyapunovExponents | ErrorGrowth) -> None:
    """Write the figure: the convergence of the estimates, or the growth of an error."""
    from matplotlib.figure import Figure  # a third of a second, after the first result

    figure = Figure(figsize=(8.0, 5.0), dpi=150, layout="constrained")
    ax = figure.add_subplot()
    if isinstance(result, ErrorGrowth):
        growth_curve(ax, result.at_impacts)
    else:
        convergence(ax, result.logs, result.times_s, result.per_second, result.per_second_error)
    ax.set_title(f"{plan.die.solid.name}, χ = {plan.chi:g}", fontsize="medium")
    figure.savefig(path)


def summary(plan: LyapunovPlan, result: LyapunovExponents | ErrorGrowth) -> tuple[str, ...]:
    """The lines that the terminal shows."""
    if isinstance(result, ErrorGrowth):
        last = f"An error of the release grows {result.at_end:.2e} times over {len(result.at_impacts)} impacts."
        return last, _no_exponent(plan)
    lines = [
        f"largest Lyapunov exponent, {len(result.logs)} orbits of {result.impacts} impacts (± one standard error)",
        f"  per second       {result.per_second:.4f} ± {result.per_second_error:.4f}",
        f"  per impact       {result.per_impact:.5f} ± {result.per_impact_error:.5f}",
        f"  per √(edge/g)    {result.per_unit:.5f} ± {result.per_unit_error:.5f}",
    ]
    if plan.die.solid.name in REPORTED and plan.chi == 1.0:
        reported = REPORTED[plan.die.solid.name][plan.table.moves]
        lines.append(f"  Kapitaniak et al. (2012) report {reported}, without a unit")
    return (*lines, *_messages(plan, result))
