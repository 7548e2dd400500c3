"""Flights joined by impacts, fitted to the poses of many frames at once.

A throw with N bounces has twelve numbers for its first flight, and for each bounce its instant t, the jump Δv of the
velocity and the jump Δω of the spin. Position and orientation are continuous at t: before and after meet there, which is
what gives the bounce its sub-frame time. Where several contacts follow each other too fast to be told apart no single
instant joins the flights; such a link is *open* and the flight after it has twelve free numbers of its own.

First-order changes at an impact, with those within a flight from `flights`:

    δp' = δp(t) - Δv δt     δv' = δv + δ(Δv)     δθ' = δθ(t) - Δω δt     δω' = δω + δ(Δω)

**What any impact obeys** (`VertexImpact`), with friction or without: the table pushes at one point, r from the centre, for no
time. Hence J Δω = m r × Δv (J the moment of inertia), and the point is on the table at t. Both are written as
observations with a tolerance, so that a die of not quite the stated inertia and a table not quite at its stated height
bend the fit no further than they may, and the squares they leave (`strain`) say whether the impact is one at that point.

**What all frames share**: m numbers s with a prior (`flights`), and the height of the table with another.

A step of the fit goes along the chain link by link (`chains`), so that its cost grows with the frames and with the links.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.throw import Flight, State
from ...model.world import GRAVITY_M_S2
from . import flight_kernels as kernels
from .chain_solver import MOST, Stages, solve_chain, spread_along
from .flights import (
    ErrorModel,
    Observations,
    chain_meats,
    chain_misses,
    chain_sums,
    informations,
    packed,
    roll_out,
    transition_matrix,
    unpacked,
)

Array = NDArray[np.float64]

CUT_SIGMA = 4.685
"""Frames beyond this many sigmas (of the six numbers together, scaled) carry no weight: Tukey's biweight."""
MEDIAN_RMS = 0.944
"""Median of the root mean square of six unit normals."""
PRIOR_NUMBERS = 12.0
"""The frames' stated sigmas count for as much as so many numbers that scatter as stated: few frames do not overrule them."""
TABLE_SIGMA_M = 3e-5
"""How well the height of the table is known, alike for all contacts: flatness and calibration."""
CONTACT_SIGMA_M = 2e-5
"""How far a single contact may lie off it: a stiff die of a few grams dents by some hundredths of a millimetre."""
FARTHEST = 1e5
"""A step longer than this in any parameter (SI) leaves all that a die can do: the spin of a die reaches some 1e3."""
LOOSE_TURNS = 3
"""Steps over which frames are drawn in."""
FEW_SHARE = 0.25
"""Of the frames of a flight: fewer may lie on any motion by chance, as the first behind a bounce does."""
SLOW, SLOWEST = 0.5, 0.95
"""Between these, steps that shrink by such a factor are taken together, twenty of them at the most."""
LEVER_SHARE, LEVER_RAD_S = 0.01, 0.3
"""Tolerance of J Δω = m r × Δv, as a share of Δω and at the least: drilled pips change J by a per cent, and the
contact is a patch of some 0.1 mm, not a point."""


@dataclass(frozen=True, eq=False)
class VertexImpact:
    """A contact at one point of the die."""

    point_m: Array
    """(3,) in the body frame: the corner of a sharp die, the centre of the ball inscribed at a rounded one."""
    rounding_m: float
    """Radius of that ball, whose lowest point touches."""
    mass_over_inertia: float
    """m/J [1/m²]."""

    def arm(self, rotation: Array) -> Array:
        """(3,) from the centre of the die to what touches, world axes."""
        return np.asarray(rotation @ self.point_m - np.array([0.0, 0.0, self.rounding_m]))


@dataclass(frozen=True, eq=False)
class Link:
    """What stands between two flights."""

    time_s: float
    is_open: bool = False
    """Whether no single instant joins the flights; `time_s` only parts their frames then."""
    strike: VertexImpact | None = None
    """The point of contact; None for a joined link whose jumps are free."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 12 if self.is_open else 7


@dataclass(frozen=True, eq=False)
class FlightChain:
    """A fitted chain of flights."""

    flights: tuple[Flight, ...]
    """With covariance."""
    links: tuple[Link, ...]
    """What separates them, at the fitted instants."""
    sigma_time_s: Array
    """(N,) standard error of each instant; NaN for open links."""
    beside: Array
    """(N, 25, 25) covariance of the state before each link, that behind it, both at its instant as it stands, and of that
    instant; NaN for open links."""
    residual: Array
    """(n,) distance of each frame from the motion, in sigmas of its six numbers (root mean square), scattered as they are."""
    weights: Array
    """(n,) 0 for a frame that was taken for wrong, 1 for one amid the others."""
    scatter: ErrorModel
    shared: Array
    """(m,) the errors that all frames share."""
    shared_bias_sigma: Array
    """(m,) their standard errors."""
    strain: Array
    """(N,) squared sigmas by which each strike misses what an impact obeys, over its four numbers; 0 without a strike."""
    table_m: float
    """Height of the table that the strikes agree on."""
    cost: float
    """Squared sigmas of frames, priors and strikes, so that fits of the same frames with one scatter may be compared:
    Tukey's loss, by which a frame costs 2 CUT_SIGMA² at the most, and all frames for as much as they count."""

    @property
    def contour_sigma_px(self) -> float:
        """Standard error [px] of the first of the shared errors, the contour's; infinite where none was looked for."""
        return float(self.shared_bias_sigma[0]) if len(self.shared) else np.inf

    @property
    def links_s(self) -> Array:
        """(N,) instants."""
        return np.array([link.time_s for link in self.links])

    def parts(self, time_s: Array) -> list[slice]:
        """The fitted frames, which are those at some instants (n,), flight by flight."""
        edges = [0, *np.searchsorted(time_s, self.links_s, side="right").tolist(), len(time_s)]
        return [slice(a, b) for a, b in itertools.pairwise(edges)]

    def borne_out(self, time_s: Array) -> Array:
        """(flights,) share of each flight's frames that lie on it; NaN for one without a frame."""
        weights = [self.weights[part] for part in self.parts(time_s)]
        return np.array([float((own > 0.0).mean()) if len(own) else np.nan for own in weights])


def fit_chain(
    seen: Observations,
    starts: Sequence[State],
    links: Sequence[Link],
    *,
    scatter: ErrorModel | None = None,
    shared_bias_sigma: Array | None = None,
    table_sigma_m: float = TABLE_SIGMA_M,
    steps: int = 40,
) -> FlightChain:
    """Least squares over a whole chain: Gauss-Newton with Levenberg's damping and biweight frames.

    `starts` (N + 1) are guesses of each flight's state (only the velocities matter for flights behind a joined link).
    `scatter` says how errors go together; white ones of a scale that is found here where it is None. `shared_bias_sigma` (m,)
    is the prior of the shared errors, none of which is looked for where it is None; `table_sigma_m` that of the height of
    the table. Deterministic; a chain that cannot be improved is returned as it is.
    """
    seen = seen if shared_bias_sigma is not None else seen.leaning(np.zeros((len(seen), 6, 0)))
    sigma = np.zeros(0) if shared_bias_sigma is None else shared_bias_sigma
    form = scatter or ErrorModel.white()
    chain = _Chain.from_guess(seen, list(starts), tuple(links), sigma, form, table_sigma_m)
    best = _descended(chain, find_scale=scatter is None, by_flight=False, steps=steps)
    if best.lost_flights > 0:
        other = _descended(chain, find_scale=scatter is None, by_flight=True, steps=steps)
        best = min(best, other, key=lambda found: (found.lost_flights, found.cost if scatter else 0.0))
    return best.chain.finished(best.course, best.weights)


@dataclass(frozen=True, eq=False)
class _Found:
    """Where a descent has come to."""

    chain: _Chain
    course: _Course
    weights: Array

    @property
    def lost_flights(self) -> int:
        """How many flights of three frames or more hardly any of their frames bear out."""
        borne_out = [(b - a, int((self.weights[a:b] > 0.0).sum())) for a, b in itertools.pairwise(self.course.cuts)]
        return sum(frames >= 3 and good < FEW_SHARE * frames for frames, good in borne_out)

    @property
    def cost(self) -> float:
        """Comparable between descents of one scatter."""
        return self.chain.robust_cost(self.course)


def _descended(chain: _Chain, *, find_scale: bool, by_flight: bool, steps: int) -> _Found:
    """The chain where no step gains any more. A first guess may leave all frames far off, and they are drawn in before any
    is taken for wrong: all alike, or those of each flight by themselves. The latter finds a flight that begins so far
    off that it would be left without frames; but where another contact lies within one, all together know better."""
    course, damping, gains = chain.course(), 1e-6, [0.0]
    for turn in range(steps):
        if find_scale:
            chain = replace(chain, scatter=ErrorModel.white(_scale(course.squares(ErrorModel.white()), chain.numbers)))
        squares = course.squares(chain.scatter)
        cuts = course.cuts if by_flight else np.array([0, len(squares)])
        weights = _biweights(squares, _looseness(squares, cuts) if turn < LOOSE_TURNS else np.ones(len(squares)))
        cost = chain.cost(course, weights)
        normal, gradient, stages = chain.equations(course, weights)
        for _ in range(12):
            first, changes = solve_chain(normal, gradient, stages, damping)
            if max(np.abs(first).max(), np.abs(changes).max(initial=0.0)) < FARTHEST:
                trial = chain.stepped(first, changes)
                there = trial.course()
                new = trial.cost(there, weights)
                if new <= cost * (1.0 + 1e-12):
                    break
            damping = max(damping * 10.0, 1e-9)
        else:
            break
        gains.append(cost - new)
        if turn > LOOSE_TURNS and (times := _steps_to_come(gains[-2:])) > 1.0:
            further = chain.stepped(times * first, times * changes)
            ahead = further.course()
            if further.robust_cost(ahead) < trial.robust_cost(there):
                trial, there, gains = further, ahead, [*gains, 0.0]
        chain, course, damping = trial, there, max(damping * 0.1, 1e-12)
        if cost - new < min(1e-2, 1e-4 * cost) and turn > LOOSE_TURNS:
            break
    return _Found(chain, course, weights)


def _steps_to_come(gains: Sequence[float]) -> float:
    """How many steps like the last are still to come, where each is shorter than the one before by the same factor: frames
    on the brink of being taken for wrong are drawn in or let go little by little. 1 where the steps say no such thing."""
    before, last = gains
    # The gain of a step goes as its square.
    rate = float(np.sqrt(last / before)) if 0.0 < last < before else 0.0
    return 1.0 / (1.0 - rate) if SLOW < rate < SLOWEST else 1.0


def _looseness(squares: Array, cuts: NDArray[np.int64]) -> Array:
    """(n,) by how much wider a frame's bounds are at first: as wide as its group is off, and thrice at the least."""
    loose = np.full(len(squares), 3.0)
    for a, b in itertools.pairwise(cuts):
        if b > a:
            loose[a:b] = max(3.0, float(np.sqrt(np.median(squares[a:b]))) / MEDIAN_RMS)
    return loose


def _biweights(squares: Array, loose: Array) -> Array:
    ratio = np.sqrt(squares) / (CUT_SIGMA * loose)
    return np.asarray(np.where(ratio < 1.0, (1.0 - ratio**2) ** 2, 0.0))


def vertex_impact_equations(before: State, behind: State, strike: VertexImpact, table_m: float) -> tuple[Array, Array]:
    """Rows (4, 25), and what is missed (4,), in sigmas, of what a strike obeys: by the states before and behind, both at the
    instant of the contact as it stands, and by that instant."""
    jump = np.concatenate([behind.velocity_m_s - before.velocity_m_s, behind.omega_rad_s - before.omega_rad_s])
    by_end, by_link, miss = np.zeros((1, 4, 12)), np.zeros((1, 4, MOST)), np.zeros((1, 4))
    kernels.strike_rows(
        packed(before)[None], jump[None], np.zeros(1, np.int64), strike.point_m[None], np.array([strike.rounding_m]),
        np.array([strike.mass_over_inertia]), table_m, CONTACT_SIGMA_M, _lever_sigma(jump[None]), by_end, by_link, miss,
    )  # fmt: skip
    rows = np.zeros((4, 25))
    rows[:, :12], rows[:, 18:24], rows[:, 24] = by_end[0], by_link[0, :, 1:7], by_link[0, :, 0]
    rows[:, 6:12] -= by_link[0, :, 1:7]
    return rows, miss[0]


def vertex_impact_cost(joined: FlightChain, k: int, strike: VertexImpact, table_sigma_m: float) -> float:
    """Squared sigmas that the joined link k would cost as that strike, over what it costs free: to the first order, from how
    far the free motion is off what the strike obeys, and how sure it is there."""
    before, behind = joined.flights[k].at(joined.links[k].time_s), joined.flights[k + 1].start
    rows, miss = vertex_impact_equations(before, behind, strike, joined.table_m)
    spread = np.eye(4) + rows @ joined.beside[k] @ rows.T
    spread[0, 0] += (table_sigma_m / CONTACT_SIGMA_M) ** 2
    # By eigenvalues, none of which is below one: a flight that no frame bears out may make some of them overflow a factor.
    values, vectors = np.linalg.eigh(spread)
    return float(((vectors.T @ miss) ** 2 / np.maximum(values, 1.0)).sum())


def _lever_sigma(jumps: Array) -> Array:
    """(N,) [rad/s] tolerance of what strikes do to the spin."""
    return np.asarray(LEVER_SHARE * np.linalg.norm(jumps[:, 3:], axis=1) + LEVER_RAD_S)


def _scale(squares: Array, parameters: int) -> float:
    """σ from the median frame, corrected for the fitted parameters, and drawn to 1 where the frames are few."""
    numbers = 6.0 * len(squares)
    free = max(numbers - parameters, 0.0)
    typical = float(np.median(squares)) / MEDIAN_RMS**2 * numbers / max(free, 6.0)
    return float(np.sqrt(max((free * typical + PRIOR_NUMBERS) / (free + PRIOR_NUMBERS), 1e-24)))


@dataclass(frozen=True, eq=False)
class _Rules:
    """What the strikes of a chain obey, each with four rows in sigmas."""

    by_end: Array
    """(S, 4, 12) derivative with respect to the state at the end of the flight before."""
    by_link: Array
    """(S, 4, MOST)."""
    miss: Array
    """(S, 4)."""


@dataclass(frozen=True, eq=False)
class _Course:
    """Where a chain leads, and what it misses there."""

    cuts: NDArray[np.int64]
    """(flights + 1,) rows of each flight."""
    states: Array
    """(flights, 14) packed, at the beginning of each."""
    ends: Array
    """(N, 14) at the instants of the links."""
    passages: Array
    """(N, 12, 12)."""
    misses: Array
    """(n, 6) whitened."""
    rules: _Rules

    def squares(self, scatter: ErrorModel) -> Array:
        """(n,) mean of each frame's six squared whitened residuals, each over its expected one."""
        return np.einsum("ni,ni,i->n", self.misses, self.misses, 1.0 / scatter.variance) / 6.0


@dataclass(frozen=True, eq=False)
class _Chain:
    """The unknowns: the first state, for each link either (t, Δv, Δω) or a free state, what all frames share, and the
    height of the table where anything strikes it."""

    seen: Observations
    spacing_s: float
    """Usual time between frames."""
    first: Array
    """(14,) packed."""
    links: tuple[Link, ...]
    times_s: Array
    """(N,) instants of the links."""
    jumps: Array
    """(N, 6) Δv, Δω at joined links."""
    is_open: NDArray[np.bool_]
    free: Array
    """(N, 14) packed states behind open links."""
    which: NDArray[np.int64]
    """(S,) the links that are strikes."""
    contacts: tuple[Array, Array, Array]
    """(S, 3) points, (S,) roundings and (S,) m/J of the strikes."""
    shared: Array
    shared_bias_sigma: Array
    table_m: float
    table_sigma_m: float
    lever_sigma: Array
    """(N,) tolerance [rad/s] of each strike's spin; set by the guess, so that the cost means the same on every step."""
    scatter: ErrorModel
    told: tuple[Array, Array]
    """What the frames say, for the scatter that the chain began with (`flights.informations`)."""
    told_share: float
    """The first number's share in that."""

    @staticmethod
    def from_guess(
        seen: Observations,
        starts: list[State],
        links: tuple[Link, ...],
        shared_bias_sigma: Array,
        scatter: ErrorModel,
        table_sigma_m: float,
    ) -> _Chain:
        numbers, times_s = np.array([packed(start) for start in starts]), np.array([link.time_s for link in links])
        fallen = np.diff(numbers[:, 0])[:, None] * np.array([0.0, 0.0, GRAVITY_M_S2])
        # Both sides of a link fall alike: what is left is how much longer one has fallen than the other.
        jumps = np.hstack([np.diff(numbers[:, 8:11], axis=0) + fallen, np.diff(numbers[:, 11:14], axis=0)])
        spacing_s = float(np.median(np.diff(seen.time_s))) if len(seen) > 1 else 1.0
        is_open = np.array([link.is_open for link in links], bool)
        struck = [(k, link.strike) for k, link in enumerate(links) if link.strike is not None]
        contacts = (
            np.array([strike.point_m for _, strike in struck]).reshape(-1, 3),
            np.array([strike.rounding_m for _, strike in struck]),
            np.array([strike.mass_over_inertia for _, strike in struck]),
        )
        share = 1.0 / scatter.slow_variance(spacing_s)
        return _Chain(
            seen, spacing_s, numbers[0], links, times_s, jumps, is_open, numbers[1:],
            np.array([k for k, _ in struck], np.int64), contacts, np.zeros(len(shared_bias_sigma)), shared_bias_sigma, 0.0,
            table_sigma_m, _lever_sigma(jumps), scatter, informations(seen, share), float(share[0]),
        )  # fmt: skip

    @property
    def has_table(self) -> bool:
        """Whether anything strikes it."""
        return len(self.which) > 0

    @property
    def constants(self) -> int:
        """How many numbers all flights share."""
        return len(self.shared) + self.has_table

    @property
    def numbers(self) -> int:
        """How many are looked for."""
        return 12 + sum(link.size for link in self.links) + self.constants

    def course(self) -> _Course:
        """Where the chain leads as it stands."""
        states, ends, passages = roll_out(self.first, self.times_s, self.jumps, self.is_open, self.free)
        inside = np.searchsorted(self.seen.time_s, self.times_s, side="right")
        cuts = np.concatenate([[0], inside, [len(self.seen)]]).astype(np.int64)
        misses = chain_misses(self.seen, cuts, states, self.shared)
        return _Course(cuts, states, ends, passages, misses, self._rules(ends))

    def _rules(self, ends: Array) -> _Rules:
        """Of each strike: its point on the table, and J Δω = m r × Δv."""
        count = len(self.which)
        by_end, by_link, miss = np.zeros((count, 4, 12)), np.zeros((count, 4, MOST)), np.zeros((count, 4))
        kernels.strike_rows(
            ends, self.jumps, self.which, *self.contacts, self.table_m, CONTACT_SIGMA_M, self.lever_sigma, by_end, by_link,
            miss,
        )  # fmt: skip
        return _Rules(by_end, by_link, miss)

    @property
    def _priors(self) -> tuple[Array, Array]:
        """Of the constants: standard deviations (c,), and where they stand (c,)."""
        sigma, value = self.shared_bias_sigma, self.shared
        return (
            (np.append(sigma, self.table_sigma_m), np.append(value, self.table_m)) if self.has_table else (sigma, value)
        )

    def _share(self) -> Array:
        """Frames are weighted as if each erred for itself, with the variance that their slow errors have in a mean: for a
        smooth motion that loses next to nothing against generalised least squares (Grenander & Rosenblatt, Statistical
        Analysis of Stationary Time Series, 1957, ch. 7), and it does not lean on the errors' model as that does."""
        return 1.0 / self.scatter.slow_variance(self.spacing_s)

    def _rest(self, course: _Course) -> float:
        """Squared sigmas of priors and strikes."""
        sigma, value = self._priors
        return float(((value / sigma) ** 2).sum() + (course.rules.miss**2).sum())

    def cost(self, course: _Course, weights: Array) -> float:
        """Sum of weighted squared sigmas of frames, priors and strikes."""
        frames = np.einsum("n,ni,ni,i->", weights, course.misses, course.misses, self._share())
        return float(frames) + self._rest(course)

    def robust_cost(self, course: _Course) -> float:
        """The same with Tukey's loss for frames (`FlightChain.cost`)."""
        ratio = np.minimum(np.sqrt(course.squares(self.scatter)) / CUT_SIGMA, 1.0)
        share = float(np.mean(self.scatter.variance * self._share()))
        return self._rest(course) + share * float((2.0 * CUT_SIGMA**2 * (1.0 - (1.0 - ratio**2) ** 3)).sum())

    def equations(self, course: _Course, weights: Array) -> tuple[Array, Array, Stages]:
        """Normal equations of the flights, the priors with those of the first, and the links between."""
        size = 12 + self.constants
        normal, gradient = self._sums(course, weights, size)
        sigma, value = self._priors
        constants = np.arange(12, size)
        normal[0, constants, constants] += 1.0 / sigma**2
        gradient[0, 12:] += value / sigma**2
        return normal, gradient, self._stages(course, size)

    def _sums(self, course: _Course, weights: Array, size: int) -> tuple[Array, Array]:
        """Of the frames alone. A scatter that is found on the way is white: all shares change by one factor."""
        change = float(self._share()[0]) / self.told_share
        return chain_sums(self.seen, course.cuts, course.states, course.misses, change * weights, self.told, size)

    def _stages(self, course: _Course, size: int) -> Stages:
        """The links as `chains` wants them."""
        stages, rules = Stages.empty(len(self.links), size), course.rules
        stages.sizes[:] = np.where(self.is_open, 12, 7)
        constants = np.arange(12, size)
        stages.onward[:, constants, constants] = 1.0
        stages.onward[:, :12, :12] = np.where(self.is_open[:, None, None], 0.0, course.passages)
        # The velocity at the link changes with its instant only through gravity, which both sides share.
        stages.turned[:, 0:6, 0] = -self.jumps
        stages.turned[:, np.arange(6, 12), np.arange(1, 7)] = 1.0
        stages.turned[self.is_open] = np.eye(size, MOST)
        stages.rows[self.which, :, :12] = rules.by_end @ course.passages[self.which]
        stages.rows[self.which, 0, size - 1] -= 1.0 / CONTACT_SIGMA_M
        stages.own_rows[self.which], stages.miss[self.which] = rules.by_link, rules.miss
        return stages

    def stepped(self, first: Array, changes: Array) -> _Chain:
        """The chain after a step; links keep their order and move by half a frame at the most."""
        start, times_s, jumps, free = self.first.copy(), self.times_s.copy(), self.jumps.copy(), self.free.copy()
        kernels.step(start, times_s, jumps, self.is_open, free, first[:12], changes, 0.5 * self.spacing_s)
        for k in range(1, len(times_s)):
            times_s[k] = max(times_s[k], times_s[k - 1] + 1e-6 * self.spacing_s)
        m = len(self.shared)
        return replace(
            self, first=start, times_s=times_s, jumps=jumps, free=free, shared=self.shared + first[12 : 12 + m],
            table_m=self.table_m + (float(first[-1]) if self.has_table else 0.0),
        )  # fmt: skip

    def finished(self, course: _Course, weights: Array) -> FlightChain:
        """The result, with every flight at its own beginning."""
        normal, _, stages = self.equations(course, weights)
        last, pairs = spread_along(normal, self._noises(course, weights, normal), stages)
        size, count = len(last), len(self.links)
        beside, sigma_time_s = np.full((count, 25, 25), np.nan), np.full(count, np.nan)
        for k in np.flatnonzero(~self.is_open).tolist():
            passed = np.zeros((25, size + MOST))
            passed[:12, :12] = course.passages[k]
            passed[12:24] = np.hstack([stages.onward[k], stages.turned[k]])[:12]
            passed[24, size] = 1.0
            beside[k] = passed @ pairs[k] @ passed.T
            sigma_time_s[k] = np.sqrt(max(beside[k, 24, 24], 0.0))
        begins = np.append(self.seen.time_s[0], self.times_s)
        ends = np.append(self.times_s, self.seen.time_s[-1])
        flights = []
        for k, numbers in enumerate(course.states):
            state, C = unpacked(numbers), (pairs[k] if k < count else last)[:12, :12]
            if state.time_s != begins[k]:
                # The state that a chain or a free flight starts from is kept at its reference instant; the flight is quoted
                # from where it begins.
                motion = Flight(state, np.inf)
                passage = transition_matrix(motion, float(begins[k]))
                state, C = motion.at(float(begins[k])), passage @ C @ passage.T
            flights.append(Flight(state, float(ends[k]), (C + C.T) / 2.0))
        squares, strain = course.squares(self.scatter), np.zeros(count)
        strain[self.which] = (course.rules.miss**2).sum(1)
        links = tuple(replace(link, time_s=float(t)) for link, t in zip(self.links, self.times_s, strict=True))
        shared_bias_sigma = np.sqrt(np.diag(last)[12 : 12 + len(self.shared)])
        return FlightChain(
            tuple(flights), links, sigma_time_s, beside, np.sqrt(squares), weights, self.scatter, self.shared,
            shared_bias_sigma, strain, self.table_m, self.robust_cost(course),
        )  # fmt: skip

    def _noises(self, course: _Course, weights: Array, normal: Array) -> Array:
        """Covariances of the flights' gradients, as the errors are: `normal` has them as they were weighted."""
        size = normal.shape[1]
        stated, _ = self._sums(course, weights, size)
        if self.scatter.wander.any():
            parts = (self.seen, course.cuts, course.states, weights)
            return normal - stated + chain_meats(*parts, self._share(), self.scatter, size)
        return normal - stated + self._sums(course, weights**2, size)[0]
