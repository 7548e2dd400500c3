"""Chaos: growth of errors in a throw, decidability of its face in double precision, and the largest Lyapunov exponent.

**Growth.** The derivative of the exact motion propagates a small disturbance δ of position, orientation (rotation
vector), velocity and angular velocity. Flight has a closed form, and an impact has its saltation matrix
(`throw.tangent`). On an oscillating table the height and velocity of the vertex are those relative to it, and the
instant shifts by δt = -δh/u, with u the relative velocity. Held contact uses central differences of the integration,
which keeps the disturbed vertices on the table; laws without derivatives are differenced in the same way. Lengths are
measured in circumradii R, times in √(R/g), angles in radians. The exponents do not depend on that choice. Drag is
refused.

**Exponents.** λ = lim (1/t) Σ log |δ_k⁺|/|δ_(k-1)⁺|, with the disturbance rescaled to length 1 at every impact
(Benettin, Galgani, Giorgilli, Strelcyn, Meccanica 15, 9, 1980). At χ = 1 the motion is Hamiltonian: the twelve
exponents are pairs ±λ. Every vertex impact contracts the volume by χ², so the sum of the exponents is 2 log χ an
impact. Below χ = 1 on a table at rest every throw ends, after finitely many impacts or infinitely many in finite time.
The growth is then finite, and an exponent in the sense of the limit does not exist.

**Decidability.** Errors come from the release, from rounding at every event, from the height at which a touch was
found, and from the steps of held contact. They are propagated as columns E of disturbances with the covariance E Eᵀ. A
throw is not decidable at its precision

- if the error has grown to 0.05 in the units above: two neighbours that separate, as over an edge, have an error of
  that size between them first;
- if another falling vertex may have touched before the one that did, because three times the error of the difference of
  their instants covers it, and the throw with the other order of impacts, followed with its own errors, does not land
  on the same face. If the order makes a difference below 1e-4, it is added to the errors;
- if its energy is so close to what the deciding edge needs that the error covers the difference;
- and if it stands balanced.

If a vertex passed the table so closely that the error lets it touch, the largest impulse that it can then have received
is added to the errors. The derivative of a touch, 1/u, has no bound for the faintest bounces. A touch is therefore
assumed late by no more than the time in which the vertex falls the height of its error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..engine import derivatives
from ..errors import InputError
from ..throw import ENDINGS, Ending, State, body_of, checked_release
from .landings import ThrowSetup

Array = NDArray[np.float64]

NEIGHBOUR_DISTANCE = 1e-6
"""Distance of the first orbit from the others, in units of R and √(R/g): far above rounding, and small enough that all orbits
have the same energy and ω_z."""

MAX_BLOCKS = 20
"""Blocks of an orbit for the standard error of an exponent."""

MIN_BLOCK_IMPACTS = 50
"""Least number of impacts in a block, so that blocks are nearly independent."""

MAX_LOG10_GROWTH = 300.0
"""Largest reported growth, as a power of ten: the range of double precision."""

_UNIT = float(np.finfo(float).eps)
_UNFINISHED = (engine.IMPACT_CAP, engine.TIMED_OUT, engine.TIME_REACHED)
"""Endings that do not show where the die would land."""


@dataclass(frozen=True, eq=False)
class ErrorGrowth:
    """The factor by which a throw magnifies small disturbances of its release."""

    times_s: Array
    """(k,) instants of the events: impacts, and changes of held contact."""
    vertices: NDArray[np.int64]
    """(k,) the vertex that strikes; -1 if only the contact changes."""
    log10_growth: Array
    """(k,) log10 of the largest growth of any disturbance of the release, right after each event, with lengths in
    circumradii and times in √(R/g)."""
    ending: Ending

    @property
    def at_end(self) -> float:
        """The factor after the last event; 1 if there is none."""
        return float(10.0 ** min(self.log10_growth[-1], MAX_LOG10_GROWTH)) if len(self.log10_growth) else 1.0

    @property
    def at_impacts(self) -> Array:
        """log10 of the factor after every impact."""
        return np.asarray(self.log10_growth[self.vertices >= 0])


@dataclass(frozen=True)
class Decidability:
    """Whether the outcome of a computed throw is certain at its precision."""

    decidable: bool
    error_growth: float
    """Factor by which an error of the release has grown at the decision."""
    error_m: float
    """[m] error of the state in units of the circumradius, times the circumradius: at the decision, or at the event at
    which the throw was found not decidable."""
    margin: float
    """Factor by which all errors could be larger before another outcome is possible; at 1 or less one is possible now."""
    sentence: str
    """The same in words, for the user."""


@dataclass(frozen=True, eq=False)
class LyapunovExponents:
    """Largest Lyapunov exponents of a set of orbits."""

    per_second: float
    per_second_error: float
    """Standard error: from the scatter of orbits, or of blocks of them, whichever is larger."""
    per_impact: float
    per_impact_error: float
    per_unit: float
    """Per √(a/g), with a the edge of the solid."""
    per_unit_error: float
    impacts: int
    """Impacts of each orbit that count, after those left out at its beginning."""
    left_out: int
    logs: Array
    """(orbits, impacts) natural logarithm of the growth since the previous impact."""
    times_s: Array
    """(orbits, impacts) time [s] since the last impact that was left out."""


def error_growth(setup: ThrowSetup, release: State, *, impacts: int | None = None) -> ErrorGrowth:
    """The growth of disturbances along a throw, until its face is decided or a number of impacts is reached.

    A throw that never ends is stopped after BOUNCING_CAP impacts. Raises ValueError as `throw_die` does.
    """
    packed, start, start_s = _in_vacuum(setup), checked_release(setup.die, release, setup.table), float(release.time_s)
    most = engine.NO_LIMIT if impacts is None else impacts
    limits = engine.Limits(np.inf, most, setup.impact_cap, impacts is None)
    code, _, _, _, _, log, knots = engine.run_throw(packed, start, start_s, limits, True)
    maps, exponents = derivatives.run_growth(packed, start, start_s, log, knots)
    largest = np.linalg.norm(maps, ord=2, axis=(1, 2)) if len(log) else np.empty(0)
    log10_growth = np.log10(largest) + exponents
    return ErrorGrowth(log[:, 0].copy(), log[:, 1].astype(np.int64), log10_growth, setup.ending(code))


def decidable_in_double_precision(setup: ThrowSetup, release: State) -> Decidability:
    """Whether the outcome of a throw is certain in double precision, at this precision of the simulation.

    The release is taken as exact to the last bit. Raises ValueError as `throw_die` does.
    """
    packed, start = _in_vacuum(setup), checked_release(setup.die, release, setup.table)
    error_of_start = release_error(start[None], packed.body.radius)
    face, impacts, code, error, margin = derivatives.decide(
        packed, start, float(release.time_s), error_of_start, setup.impact_cap
    )
    grown = error_growth(setup, release).at_end
    decidable = bool(margin > 1.0) and (face >= 0 or code not in _UNFINISHED)
    sentence = _sentence(decidable, setup.ending(code), int(impacts), grown, float(margin))
    return Decidability(decidable, grown, float(error) * packed.body.radius, float(margin), sentence)


def decidable_in_double_precision_many(
    setup: ThrowSetup, starts: Array
) -> tuple[NDArray[np.int64], NDArray[np.bool_], Array]:
    """Throws from packed starts (n, 13), as the kernels take them, each with its decidability.

    Returns (n, 3) row of the face or -1, number of impacts, code of the ending; (n,) whether the outcome is certain in double
    precision; (n,) margins as in `Decidability`. It runs without the interpreter's lock, so threads may share the work.
    """
    packed, starts = _in_vacuum(setup), np.ascontiguousarray(starts, float)
    landed, figures = np.empty((len(starts), 3), np.int64), np.empty((len(starts), 2))
    errors = release_error(starts, packed.body.radius)
    derivatives.decide_many(packed, starts, errors, setup.impact_cap, landed, figures)
    decidable = (figures[:, 1] > 1.0) & ((landed[:, 0] >= 0) | ~np.isin(landed[:, 2], _UNFINISHED))
    return landed, decidable, figures[:, 1]


def release_error(starts: Array, radius_m: float) -> Array:
    """Rounding (12,) of releases (n, 13): position, rotation vector, velocity, angular velocity, of the largest release."""
    largest = np.abs(starts).max(0) if len(starts) else np.zeros(13)
    error = np.empty(12)
    error[:3] = _UNIT * (largest[2] + radius_m)
    error[3:6] = 2.0 * _UNIT
    error[6:9] = _UNIT * largest[7:10].max()
    error[9:] = _UNIT * largest[10:].max()
    return error


def largest_lyapunov_exponent(
    setup: ThrowSetup,
    start: State,
    *,
    impacts: int = 10_000,
    orbits: int = 8,
    left_out: int = 200,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> LyapunovExponents:
    """The largest Lyapunov exponent of the motion that begins with `start`, from `orbits` orbits of `impacts` each.

    The orbits begin NEIGHBOUR_DISTANCE apart, so they share energy and ω_z. If the motion is chaotic they are independent
    otherwise once the first `left_out` impacts are over. Raises ValueError for a motion that ends: χ < 1 on a table at rest,
    or a die that comes to lie on an oscillating table.
    """
    if impacts < 2 or orbits < 1 or left_out < 0:
        raise InputError(f"impacts = {impacts}, orbits = {orbits}, left_out = {left_out}: wanted at least 2, 1 and 0")
    chi = setup.law.parameters[0]
    if not setup.table.moves and chi < 1.0:
        raise InputError(
            f"chi = {chi:g} on a table at rest: every throw ends, with a finite growth and no exponent; "
            "wanted chi = 1 or an oscillating table"
        )
    first = checked_release(setup.die, start, setup.table)
    logs, times = np.empty((orbits, impacts)), np.empty((orbits, impacts))
    for k, stream in enumerate(np.random.SeedSequence(seed).spawn(orbits)):
        rng = np.random.default_rng(stream)
        packed = _nearby(setup, first, rng) if k else first
        growth, clock = _orbit(setup, packed, float(start.time_s), left_out + impacts, rng)
        before = clock[left_out - 1] if left_out else float(start.time_s)
        logs[k], times[k] = growth[left_out:], clock[left_out:] - before
        if progress is not None:
            progress(k + 1, orbits)
    return exponents_of(setup, logs, times, left_out)


def exponents_of(setup: ThrowSetup, logs: Array, times_s: Array, left_out: int) -> LyapunovExponents:
    """The exponents of the logged growth (orbits, impacts) with the times (orbits, impacts) [s] of its impacts."""
    per_second, second_error = _ratio(logs, np.diff(times_s, axis=1, prepend=0.0))
    per_impact, impact_error = _ratio(logs, np.ones_like(logs))
    unit = float(np.sqrt(setup.die.solid.edge_m / setup.table.gravity_m_s2))
    return LyapunovExponents(
        per_second,
        second_error,
        per_impact,
        impact_error,
        per_second * unit,
        second_error * unit,
        logs.shape[1],
        left_out,
        logs,
        times_s,
    )


def _in_vacuum(setup: ThrowSetup) -> engine.Setup:
    """What the kernels take. Raises ValueError for drag, of which these derivatives know nothing."""
    if setup.drag_per_m > 0.0:
        raise InputError(
            f"drag_per_m = {setup.drag_per_m:g}: growth of errors, decidability and Lyapunov exponents are computed in vacuum; "
            "wanted 0"
        )
    return setup.packed


def _ratio(logs: Array, spans: Array) -> tuple[float, float]:
    """Σ logs / Σ spans with its standard error, the larger one of that from orbits and that from blocks of them."""
    ratio = float(logs.sum() / spans.sum())
    residuals = logs - ratio * spans  # of mean zero: the error of a ratio, to first order
    orbits, n = residuals.shape
    count = max(2, min(MAX_BLOCKS, n // MIN_BLOCK_IMPACTS))
    blocks = np.concatenate([part.sum(1) for part in np.array_split(residuals, count, axis=1)])
    errors = [blocks.std(ddof=1) * np.sqrt(len(blocks))]
    if orbits > 1:
        errors.append(residuals.sum(1).std(ddof=1) * np.sqrt(orbits))
    return ratio, float(max(errors) / spans.sum())


def _orbit(
    setup: ThrowSetup, packed: Array, start_s: float, impacts: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Logarithms of the growth (impacts,) of a random disturbance, and the times (impacts,) [s], along one orbit.

    Raises ValueError if the orbit ends before so many impacts.
    """
    growth, clock = np.empty((impacts, 1)), np.empty(impacts)
    code, reached, _, _ = derivatives.run_exponents(
        _in_vacuum(setup), packed, start_s, _random_disturbance(setup, rng), growth, clock
    )
    if reached < impacts:
        raise InputError(
            f"the die bounced only {reached} times ({ENDINGS[code].value}); wanted {impacts} impacts; try a stronger "
            "oscillation or a larger chi"
        )
    return growth[:, 0], clock


def _random_disturbance(setup: ThrowSetup, rng: np.random.Generator) -> Array:
    """A disturbance (12, 1) in a random direction, in units of R and √(R/g)."""
    return rng.normal(size=(12, 1)) * derivatives.scales_of(body_of(setup.die), setup.table.plane)[:, None]


def _nearby(setup: ThrowSetup, start: Array, rng: np.random.Generator) -> Array:
    """A start (13,) at NEIGHBOUR_DISTANCE, whose lowest vertex is no lower."""
    moved, vertices = np.empty(13), body_of(setup.die).vertices
    derivatives.displaced(start, _random_disturbance(setup, rng), 0, NEIGHBOUR_DISTANCE, moved)
    lowest = np.min([engine.clearance(vertex, moved, 0.0) for vertex in vertices])
    before = np.min([engine.clearance(vertex, start, 0.0) for vertex in vertices])
    moved[2] += max(0.0, before - lowest)
    return moved


def _sentence(decidable: bool, ending: Ending, impacts: int, grown: float, margin: float) -> str:
    """The message for the user."""
    magnified = f"{impacts} impacts magnify an error of the release {grown:.1e} times"
    if ending is Ending.BALANCED:
        return "This throw is not decidable in double precision: the die stands balanced, and any neighbouring state falls."
    if decidable:
        room = "no error matters" if margin == np.inf else f"errors {margin:.1e} times as large would not change it"
        return f"This throw is decidable in double precision: {magnified}, and {room}."
    if margin > 1.0:
        return (
            f"Decidability in double precision is unknown, because the throw was stopped before its end: {magnified}."
        )
    return f"This throw is not decidable in double precision: {magnified}, and rounding may have chosen its outcome."
