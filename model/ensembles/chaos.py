"""Chaos: how errors grow in a throw, whether double precision decides its face, and the largest Lyapunov exponent.

**Growth.** A small disturbance δ of position, orientation (rotation vector), velocity and angular velocity is carried
along by the derivative of the exact motion: through flight in closed form, through an impact by its saltation matrix
(`tangent`; on a table that moves the height and velocity of the vertex are those relative to it, and the instant shifts
by δt = -δh/u, u the relative velocity), through held contact by central differences of the integration, which keeps the
disturbed vertices on the table. Laws without derivatives are differenced in the same way. Lengths are measured by the
circumradius R, times by √(R/g), angles in radians; the exponents do not depend on that choice.

**Exponents.** λ = lim (1/t) Σ log |δ_k⁺|/|δ_(k-1)⁺|, the disturbance brought back to length 1 at every impact (Benettin,
Galgani, Giorgilli, Strelcyn, Meccanica 15, 9, 1980). At χ = 1 the motion is Hamiltonian: the twelve exponents are pairs
±λ. Any vertex impact contracts the volume by χ², so their sum is 2 log χ an impact. Below χ = 1 on a table at rest
every throw ends, after finitely many impacts or infinitely many in finite time: growth is finite, and an exponent in
the sense of the limit does not exist.

**What double precision decides.** Errors come from the start, from rounding at every event, from the height at which a
touch was found, and from the steps of held contact. They are carried along as columns E of disturbances of which E Eᵀ
is the covariance. A throw is undecidable at its precision

- once the error has grown to 0.05 in the units above: where two neighbours part, as over an edge, the error between
  them passes that size first;
- where another vertex, falling, may have touched before the one that did (the error of the difference of their
  instants, three times over, bridges it), and the throw with the other order of impacts, which is followed with its own
  errors, does not land on the same face. Where the order makes a difference below 1e-4 it is added to the errors;
- where a vertex passed the table so closely that the error lets it touch: the largest impulse that it can then have got
  is added to the errors;
- where its energy is so close to what the deciding edge needs that the error bridges it;
- and where it stands balanced.

The derivative of a touch, 1/u, has no bound for the faintest bounces; a touch is taken to be late by no more than the
time in which the vertex falls the height of its error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die
from ..engine import derivatives
from ..laws import LEVEL, ImpactLaw, Table
from ..throw import BOUNCING_CAP, EXACT, IMPACT_CAP, Ending, Precision, State, body_of, checked_release
from ..throw import ENDINGS as _ENDINGS

Array = NDArray[np.float64]

_UNIT = 2.220446049250313e-16
_ENDLESS = np.iinfo(np.int64).max
_LEAVES_OFF = (engine.IMPACT_CAP, engine.TIMED_OUT, engine.TIME_REACHED)
"""Endings that say nothing of where the die would land."""


@dataclass(frozen=True, eq=False)
class ErrorGrowth:
    """By how much a throw magnifies small disturbances of its release."""

    times_s: Array
    """(k,) instants of the events: impacts, and changes of held contact."""
    vertices: NDArray[np.int64]
    """(k,) the vertex that strikes; -1 where the contact only changes."""
    log10_growth: Array
    """(k,) of the factor by which the worst disturbance of the release has grown right after each event, its size
    measured with lengths by the circumradius and times by √(R/g)."""
    ending: Ending

    @property
    def at_end(self) -> float:
        """The factor after the last event; 1 where there is none."""
        return float(10.0 ** min(self.log10_growth[-1], 300.0)) if len(self.log10_growth) else 1.0

    @property
    def at_impacts(self) -> Array:
        """log10 of the factor after every impact."""
        return np.asarray(self.log10_growth[self.vertices >= 0])


@dataclass(frozen=True)
class Decidability:
    """Whether a throw, as it was computed, can be trusted with its outcome."""

    decidable: bool
    error_growth: float
    """Factor by which an error of the release has grown at the decision."""
    error_m: float
    """[m] error of the state at the decision, times the circumradius; where the throw is undecidable, at the event at
    which that was found."""
    margin: float
    """How many times larger all errors might have been before another outcome could not be ruled out; 1 or less: it
    cannot be."""
    sentence: str


@dataclass(frozen=True, eq=False)
class LyapunovExponents:
    """Largest Lyapunov exponents of a set of orbits."""

    per_second: float
    per_second_error: float
    """Standard error: of the mean over the orbits, or over blocks of them, whichever is larger."""
    per_impact: float
    per_impact_error: float
    per_unit: float
    """Per √(a/g), a the edge of the solid."""
    per_unit_error: float
    impacts: int
    """Counted, of each orbit, after those that were left out at its beginning."""
    left_out: int
    logs: Array
    """(orbits, impacts) logarithm of the growth since the impact before."""
    times_s: Array
    """(orbits, impacts) since the last impact that was left out."""


def error_growth(
    die: Die,
    release: State,
    law: ImpactLaw,
    *,
    table: Table = LEVEL,
    precision: Precision = EXACT,
    impacts: int | None = None,
) -> ErrorGrowth:
    """The growth of disturbances along a throw, to its decision, or to a number of impacts.

    A throw that never ends is left after `simulate.BOUNCING_CAP` impacts. Raises ValueError as `throw_die` does.
    """
    body, plane, start = body_of(die), table.plane, checked_release(die, release, table)
    packed = engine.law_of(law.code, law.parameters)
    code, _, _, _, _, log, knots = engine.run_throw(
        body,
        packed,
        plane,
        _packed(precision),
        start,
        float(release.time_s),
        np.inf,
        _ENDLESS if impacts is None else impacts,
        impacts is None,
        _cap(law, table),
        True,
    )
    maps, exponents = derivatives.run_growth(body, packed, plane, start, float(release.time_s), log, knots)
    largest = np.linalg.norm(maps, ord=2, axis=(1, 2)) if len(log) else np.empty(0)
    return ErrorGrowth(
        log[:, 0].copy(), log[:, 1].astype(np.int64), np.log10(largest) + exponents, _ending(code, law, table)
    )


def decidable_in_double_precision(
    die: Die, release: State, law: ImpactLaw, *, table: Table = LEVEL, precision: Precision = EXACT
) -> Decidability:
    """Whether double precision, at this setting of the simulator, decides the outcome of a throw.

    The release is taken as exact to the last bit. Raises ValueError as `throw_die` does.
    """
    body, plane, start = body_of(die), table.plane, checked_release(die, release, table)
    face, impacts, code, error, margin = derivatives.decide(
        body,
        engine.law_of(law.code, law.parameters),
        plane,
        _packed(precision),
        start,
        float(release.time_s),
        release_error(start[None], body.radius),
        _cap(law, table),
    )
    grown = error_growth(die, release, law, table=table, precision=precision).at_end
    decidable = bool(margin > 1.0) and (face >= 0 or code not in _LEAVES_OFF)
    ending = _ending(code, law, table)
    sentence = _sentence(decidable, ending, int(impacts), grown, float(margin))
    return Decidability(decidable, grown, float(error) * body.radius, float(margin), sentence)


def decidable_in_double_precision_many(
    die: Die, starts: Array, law: ImpactLaw, *, table: Table = LEVEL, precision: Precision = EXACT
) -> tuple[NDArray[np.int64], NDArray[np.bool_], Array]:
    """Throws from packed starts (n, 13), as the kernels have them, each with its decidability.

    Returns (n, 3): face row or -1, impacts, code of the ending; (n,) whether double precision decides it; (n,) margins.
    Runs without the interpreter's lock, so that threads may share the work.
    """
    body, starts = body_of(die), np.ascontiguousarray(starts, float)
    landed, figures = np.empty((len(starts), 3), np.int64), np.empty((len(starts), 2))
    derivatives.decide_many(
        body,
        engine.law_of(law.code, law.parameters),
        table.plane,
        _packed(precision),
        starts,
        release_error(starts, body.radius),
        _cap(law, table),
        landed,
        figures,
    )
    decidable = (figures[:, 1] > 1.0) & ((landed[:, 0] >= 0) | ~np.isin(landed[:, 2], _LEAVES_OFF))
    return landed, decidable, figures[:, 1]


def release_error(starts: Array, radius_m: float) -> Array:
    """Rounding (12,) of releases (n, 13): position, rotation vector, velocity, angular velocity; of the largest."""
    largest = np.abs(starts).max(0) if len(starts) else np.zeros(13)
    error = np.empty(12)
    error[:3] = _UNIT * (largest[2] + radius_m)
    error[3:6] = 2.0 * _UNIT
    error[6:9] = _UNIT * largest[7:10].max()
    error[9:] = _UNIT * largest[10:].max()
    return error


def largest_lyapunov_exponent(
    die: Die,
    start: State,
    law: ImpactLaw,
    *,
    table: Table = LEVEL,
    precision: Precision = EXACT,
    impacts: int = 10_000,
    orbits: int = 8,
    left_out: int = 200,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> LyapunovExponents:
    """The largest Lyapunov exponent of the motion that begins with `start`, from `orbits` orbits of `impacts` each.

    The orbits begin 1e-6 (in units of R and √(R/g)) apart from each other, so that they share energy and ω_z and, where
    the motion is chaotic, nothing else once the first `left_out` impacts are over. Raises ValueError for a motion that
    ends: χ < 1 on a table at rest, or a die that comes to lie on a table that oscillates.
    """
    if impacts < 2 or orbits < 1 or left_out < 0:
        raise ValueError(f"impacts = {impacts}, orbits = {orbits}, left_out = {left_out}: wanted 2, 1, 0 or more")
    if not table.moves and law.parameters[0] < 1.0:
        raise ValueError(
            f"chi = {law.parameters[0]:g} on a table at rest: every throw ends, and has no exponent but only a finite "
            "growth; wanted chi = 1 or a table that oscillates"
        )
    body, packed = body_of(die), checked_release(die, start, table)
    streams = np.random.SeedSequence(seed).spawn(orbits)
    logs, times = np.empty((orbits, impacts)), np.empty((orbits, impacts))
    for k, stream in enumerate(streams):
        rng = np.random.default_rng(stream)
        run = np.empty((left_out + impacts, 1)), np.empty(left_out + impacts)
        code, reached, _, _ = derivatives.run_exponents(
            body,
            engine.law_of(law.code, law.parameters),
            table.plane,
            _packed(precision),
            _nearby(packed, body, table, rng) if k else packed,
            float(start.time_s),
            _columns(rng, 1) * derivatives.scales_of(body, table.plane)[:, None],
            *run,
        )
        if reached < left_out + impacts:
            raise ValueError(
                f"the die bounced only {reached} times ({_ENDINGS[code].value}); wanted {left_out + impacts} impacts; try a "
                "stronger oscillation or a larger chi"
            )
        before = run[1][left_out - 1] if left_out else float(start.time_s)
        logs[k], times[k] = run[0][left_out:, 0], run[1][left_out:] - before
        if progress is not None:
            progress(k + 1, orbits)
    return exponents_of(die, logs, times, left_out)


def exponents_of(die: Die, logs: Array, times_s: Array, left_out: int) -> LyapunovExponents:
    """The exponents of logged growth (orbits, impacts) and the instants [s] of the impacts since the beginning."""
    per_second, second_error = _ratio(logs, np.diff(times_s, axis=1, prepend=0.0))
    per_impact, impact_error = _ratio(logs, np.ones_like(logs))
    unit = float(np.sqrt(die.solid.edge_m / engine.LEVEL.g))
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


def _ratio(logs: Array, spans: Array) -> tuple[float, float]:
    """Σ logs / Σ spans with its standard error: the larger one of that from orbits and that from blocks of them."""
    ratio = float(logs.sum() / spans.sum())
    rest = logs - ratio * spans  # of mean zero: the error of a ratio, to the first order
    orbits, n = rest.shape
    blocks = [part.sum(1) for part in np.array_split(rest, max(2, min(20, n // 50)), axis=1)]
    sums = np.concatenate(blocks)
    errors = [sums.std(ddof=1) * np.sqrt(len(sums))]
    if orbits > 1:
        errors.append(rest.sum(1).std(ddof=1) * np.sqrt(orbits))
    return ratio, float(max(errors) / spans.sum())


def _columns(rng: np.random.Generator, count: int) -> Array:
    """Disturbances (12, count) in random directions."""
    return np.asarray(rng.normal(size=(12, count)))


def _nearby(start: Array, body: engine.Body, table: Table, rng: np.random.Generator) -> Array:
    """A start (13,) some 1e-6 away, and no nearer to the table."""
    moved = np.empty(13)
    direction = _columns(rng, 1) * derivatives.scales_of(body, table.plane)[:, None]
    derivatives.displaced(start, direction, 0, 1e-6, moved)
    drop = np.min([engine.clearance(vertex, moved, 0.0) for vertex in body.vertices])
    before = np.min([engine.clearance(vertex, start, 0.0) for vertex in body.vertices])
    moved[2] += max(0.0, before - drop)
    return moved


def _packed(precision: Precision) -> engine.Precision:
    return engine.Precision(precision.contact_tolerance_m, precision.slowest_bounce, precision.step_turn_rad)


def _endless(law: ImpactLaw, table: Table) -> bool:
    return bool(law.parameters[0] >= 1.0 or table.moves)


def _cap(law: ImpactLaw, table: Table) -> int:
    """Impacts after which a throw is left, as `throw_die` does."""
    return BOUNCING_CAP if _endless(law, table) else IMPACT_CAP


def _ending(code: int, law: ImpactLaw, table: Table) -> Ending:
    return Ending.BOUNCING if code == engine.IMPACT_CAP and _endless(law, table) else _ENDINGS[code]


def _sentence(decidable: bool, ending: Ending, impacts: int, grown: float, margin: float) -> str:
    """What throw.json says."""
    magnified = f"{impacts} impacts magnify an error of the release {grown:.1e} times"
    if ending is Ending.BALANCED:
        return "Double precision does not decide this throw: the die stands balanced, and any neighbour of it falls."
    if decidable:
        room = "no error matters" if margin == np.inf else f"errors {margin:.1e} times as large would not change it"
        return f"Double precision decides this throw: {magnified}, and {room}."
    if margin > 1.0:
        return f"Whether double precision decides this throw is open, since it was left before its end: {magnified}."
    return f"Double precision does not decide this throw: {magnified}, and rounding may have chosen its end."
