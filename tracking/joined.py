"""Flights joined by impacts, fitted to the poses of many frames at once.

A throw with N bounces has twelve numbers for its first flight, and for each bounce its instant t, the jump Δv of the
velocity and the jump Δω of the spin. Position and orientation are continuous at t: before and after meet there, which is
what gives the bounce its sub-frame time. Where several contacts follow each other too fast to be told apart no single
instant joins the flights; such a link is *open* and the flight after it has twelve free numbers of its own.

First-order changes at an impact, with those within a flight from `flights`:

    δp' = δp(t) - Δv δt     δv' = δv + δ(Δv)     δθ' = δθ(t) - Δω δt     δω' = δω + δ(Δω)

**What any impact obeys** (`Strike`), with friction or without: the table pushes at one point, r from the centre, for no
time. Hence J Δω = m r × Δv (J the moment of inertia), and the point is on the table at t. Both are written as
observations with a tolerance, so that a die of not quite the stated inertia and a table not quite at its stated height
bend the fit no further than they may, and the squares they leave (`strain`) say whether the impact is one at that point.

**What all frames share**: m numbers s with a prior (`flights`), and the height of the table with another.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..model.motion import Flight, State
from .flights import Scatter, carried_on, flight_meat, flight_sums, moved, rotation_matrix, scaled_inverse
from .flights import Sightings as Sightings
from .flights import fit_flight as fit_flight
from .flights import transition as transition

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
LEVER_SHARE, LEVER_RAD_S = 0.01, 0.3
"""Tolerance of J Δω = m r × Δv, as a share of Δω and at the least: drilled pips change J by a per cent, and the
contact is a patch of some 0.1 mm, not a point."""


@dataclass(frozen=True, eq=False)
class Strike:
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
    strike: Strike | None = None
    """The point of contact; None for a joined link whose jumps are free."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 12 if self.is_open else 7


@dataclass(frozen=True, eq=False)
class Joined:
    """A fitted chain of flights."""

    flights: tuple[Flight, ...]
    """With covariance."""
    links: tuple[Link, ...]
    """What separates them, at the fitted instants."""
    covariance: Array
    """Of all parameters."""
    maps: tuple[Array, ...]
    """Each flight's (12, parameters) derivative of its start state."""
    sigma_time_s: Array
    """(N,) standard error of each instant; NaN for open links."""
    time_columns: NDArray[np.int64]
    """(N,) which parameter each instant is; -1 for open links."""
    residual: Array
    """(n,) distance of each frame from the motion, in sigmas of its six numbers (root mean square), scattered as they are."""
    weights: Array
    """(n,) 0 for a frame that was taken for wrong, 1 for one amid the others."""
    scatter: Scatter
    shared: Array
    """(m,) the errors that all frames share."""
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
        if not len(self.shared):
            return np.inf
        # Last come the shared errors, and behind them the table's height where a strike measures it.
        first = len(self.covariance) - len(self.shared) - int(any(link.strike is not None for link in self.links))
        return float(np.sqrt(max(float(self.covariance[first, first]), 0.0)))

    @property
    def links_s(self) -> Array:
        """(N,) instants."""
        return np.array([link.time_s for link in self.links])


def fit_joined(
    seen: Sightings,
    starts: Sequence[State],
    links: Sequence[Link],
    *,
    scatter: Scatter | None = None,
    shared_sigma: Array | None = None,
    table_sigma_m: float = TABLE_SIGMA_M,
    steps: int = 40,
) -> Joined:
    """Least squares over a whole chain: Gauss-Newton with Levenberg's damping and biweight frames.

    `starts` (N + 1) are guesses of each flight's state (only the velocities matter for flights behind a joined link).
    `scatter` says how errors go together; white ones of a scale that is found here where it is None. `shared_sigma` (m,)
    is the prior of the shared errors, none of which is looked for where it is None; `table_sigma_m` that of the height of
    the table. Deterministic; a chain that cannot be improved is returned as it is.
    """
    seen = seen if shared_sigma is not None else seen.leaning(np.zeros((len(seen), 6, 0)))
    sigma = np.zeros(0) if shared_sigma is None else shared_sigma
    form = scatter or Scatter.white()
    chain = _Chain.from_guess(seen, list(starts), tuple(links), sigma, form, table_sigma_m)
    weights, damping = np.ones(len(seen)), 1e-6
    sums = chain.sums(weights)
    for turn in range(steps):
        if scatter is None:
            squares = sums.squares * chain.scatter.scale[0] ** 2
            chain = replace(chain, scatter=Scatter.white(_scale(squares, len(sums.gradient))))
            sums = replace(sums, squares=squares / chain.scatter.scale[0] ** 2)
        # A first guess may leave all frames far off: they are drawn in before any is taken for wrong.
        loose = max(3.0, float(np.sqrt(np.median(sums.squares))) / MEDIAN_RMS) if turn < 3 else 1.0
        ratio = np.sqrt(sums.squares) / (CUT_SIGMA * loose)
        weights = np.where(ratio < 1.0, (1.0 - ratio**2) ** 2, 0.0)
        sums = chain.sums(weights)
        for _ in range(12):
            # A number that no frame knows of, as of a flight between two frames, stays where it is.
            held = sums.normal + damping * np.diag(np.diag(sums.normal)) + 1e-9 * np.eye(len(sums.gradient))
            unit = 1.0 / np.sqrt(np.diag(held))
            step = -unit * np.linalg.solve(held * np.outer(unit, unit), unit * sums.gradient)
            if np.abs(step).max() < FARTHEST:
                trial = chain.stepped(step)
                new = trial.sums(weights)
                if new.cost <= sums.cost * (1.0 + 1e-12):
                    break
            damping = max(damping * 10.0, 1e-9)
        else:
            break
        gained = sums.cost - new.cost
        chain, sums, damping = trial, new, max(damping * 0.1, 1e-12)
        if gained < min(1e-2, 1e-4 * sums.cost) and turn >= 4:
            break
    return chain.finished(sums, weights)


def _scale(squares: Array, parameters: int) -> float:
    """σ from the median frame, corrected for the fitted parameters, and drawn to 1 where the frames are few."""
    numbers = 6.0 * len(squares)
    free = max(numbers - parameters, 0.0)
    typical = float(np.median(squares)) / MEDIAN_RMS**2 * numbers / max(free, 6.0)
    return float(np.sqrt(max((free * typical + PRIOR_NUMBERS) / (free + PRIOR_NUMBERS), 1e-24)))


@dataclass(frozen=True, eq=False)
class _Sums:
    """The whole chain's normal equations, all in sigmas."""

    normal: Array
    gradient: Array
    cost: float
    squares: Array
    strain: Array


@dataclass(frozen=True, eq=False)
class _Chain:
    """The unknowns: the first state, for each link either (t, Δv, Δω) or a free state, what all frames share, and the
    height of the table where anything strikes it."""

    seen: Sightings
    first: State
    links: tuple[Link, ...]
    jumps: Array
    """(N, 6) Δv, Δω at joined links."""
    free: tuple[State | None, ...]
    shared: Array
    shared_sigma: Array
    table_m: float
    table_sigma_m: float
    lever_sigma: Array
    """(N,) tolerance [rad/s] of each strike's spin; set by the guess, so that the cost means the same on every step."""
    scatter: Scatter

    @staticmethod
    def from_guess(
        seen: Sightings,
        starts: list[State],
        links: tuple[Link, ...],
        shared_sigma: Array,
        scatter: Scatter,
        table_sigma_m: float,
    ) -> _Chain:
        jumps = np.zeros((len(links), 6))
        free: list[State | None] = []
        for k, link in enumerate(links):
            before, after = (Flight(start, np.inf).at(link.time_s) for start in starts[k : k + 2])
            jumps[k] = np.concatenate(
                [after.velocity_m_s - before.velocity_m_s, after.omega_rad_s - before.omega_rad_s]
            )
            free.append(starts[k + 1] if link.is_open else None)
        lever_sigma = LEVER_SHARE * np.linalg.norm(jumps[:, 3:], axis=1) + LEVER_RAD_S
        shared = np.zeros(len(shared_sigma))
        return _Chain(
            seen, starts[0], links, jumps, tuple(free), shared, shared_sigma, 0.0, table_sigma_m, lever_sigma, scatter
        )

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of parameters: of flights and links, of what is shared, of the table."""
        motion = 12 + sum(link.size for link in self.links)
        return motion, len(self.shared), int(any(link.strike is not None for link in self.links))

    @property
    def spacing_s(self) -> float:
        """Usual time between frames."""
        return float(np.median(np.diff(self.seen.time_s))) if len(self.seen) > 1 else 1.0

    @property
    def _pick(self) -> Array:
        """(m, parameters) that takes what all frames share out of all parameters."""
        motion, shared, table = self.sizes
        return np.eye(motion + shared + table)[motion : motion + shared]

    def states_and_maps(self) -> tuple[list[State], list[Array], list[tuple[State, Array]]]:
        """Start state of each flight and its derivative with respect to all parameters; and the same at each flight's
        end, at the instant of its link as it stands."""
        total = sum(self.sizes)
        S = np.zeros((12, total))
        S[:, :12] = np.eye(12)
        states, maps, ends = [self.first], [S], []
        column = 12
        for k, link in enumerate(self.links):
            t = link.time_s
            end, passage = carried_on(states[-1], t)
            reached = passage @ maps[-1]
            ends.append((end, reached))
            free = self.free[k]
            if free is not None:
                S = np.zeros((12, total))
                S[:, column : column + 12] = np.eye(12)
                states.append(free)
            else:
                S = reached.copy()
                S[0:3, column] -= self.jumps[k, :3]
                S[3:6, column] -= self.jumps[k, 3:]
                S[6:12, column + 1 : column + 7] += np.eye(6)
                # The velocity at the link changes with its instant only through gravity, which both sides share.
                states.append(
                    State(t, end.position_m, end.quaternion, end.velocity_m_s + self.jumps[k, :3],
                          end.omega_rad_s + self.jumps[k, 3:])
                )  # fmt: skip
            maps.append(S)
            column += link.size
        return states, maps, ends

    def _parts(self) -> list[slice]:
        """Rows of each flight."""
        inside = np.searchsorted(self.seen.time_s, [link.time_s for link in self.links], side="right")
        cuts = [0, *(int(c) for c in inside), len(self.seen)]
        return [slice(a, b) for a, b in itertools.pairwise(cuts)]

    def sums(self, weights: Array) -> _Sums:
        """Normal equations of frames, priors and strikes.

        Frames are weighted as if each erred for itself, with the variance that their slow errors have in a mean: for a
        smooth motion that loses next to nothing against generalised least squares (Grenander & Rosenblatt, Statistical
        Analysis of Stationary Time Series, 1957, ch. 7), and it does not lean on the errors' model as that does.
        """
        states, maps, ends = self.states_and_maps()
        motion, shared, table = self.sizes
        total = motion + shared + table
        normal, gradient = np.zeros((total, total)), np.zeros(total)
        cost, squares = 0.0, np.zeros(len(self.seen))
        share, usual = 1.0 / self.scatter.slow_variance(self.spacing_s), 1.0 / self.scatter.variance
        for mine, state, S in zip(self._parts(), states, maps, strict=True):
            if mine.stop <= mine.start:
                continue
            part = flight_sums(self.seen.rows(mine), state, self.shared, weights[mine], share, usual)
            F = np.vstack([S, self._pick])
            normal += F.T @ part.normal @ F
            gradient += F.T @ part.gradient
            cost += part.cost
            squares[mine] = part.squares
        strain = np.zeros(len(self.links))
        for rows, residual, k in self._rules(ends):
            normal += rows.T @ rows
            gradient += rows.T @ residual
            cost += float(residual @ residual)
            if k >= 0:
                strain[k] = float(residual @ residual)
        return _Sums(normal, gradient, cost, squares, strain)

    def _rules(self, ends: list[tuple[State, Array]]) -> list[tuple[Array, Array, int]]:
        """Derivatives, residuals (in sigmas) and links (-1: none) of priors and strikes."""
        motion, shared, table = self.sizes
        total = motion + shared + table
        rules: list[tuple[Array, Array, int]] = []
        if shared:
            rows = np.zeros((shared, total))
            rows[:, motion : motion + shared] = np.diag(1.0 / self.shared_sigma)
            rules.append((rows, self.shared / self.shared_sigma, -1))
        if table:
            rows = np.zeros((1, total))
            rows[0, -1] = 1.0 / self.table_sigma_m
            rules.append((rows, np.array([self.table_m / self.table_sigma_m]), -1))
        column = 12
        for k, link in enumerate(self.links):
            if link.strike is not None:
                rules.append((*self._strike_rows(link.strike, *ends[k], k, column), k))
            column += link.size
        return rules

    def _strike_rows(self, strike: Strike, end: State, reached: Array, k: int, column: int) -> tuple[Array, Array]:
        """Four rows of a strike: its point on the table, and J Δω = m r × Δv."""
        rotation = rotation_matrix(end.quaternion)
        ball = rotation @ strike.point_m
        arm, ratio = strike.arm(rotation), strike.mass_over_inertia
        dv, dw = self.jumps[k, :3], self.jumps[k, 3:]
        rows, residual = np.zeros((4, reached.shape[1])), np.empty(4)
        # δ(R p) = δθ × R p, and both p and R move on with the instant.
        turn = -_cross(ball)
        moves = turn @ reached[3:6]
        moves[:, column] += _cross(end.omega_rad_s) @ ball
        rows[0] = reached[2] + moves[2]
        rows[0, column] += end.velocity_m_s[2]
        rows[0, -1] -= 1.0
        rows[0] /= CONTACT_SIGMA_M
        residual[0] = (end.position_m[2] + arm[2] - self.table_m) / CONTACT_SIGMA_M
        rows[1:] = ratio * _cross(dv) @ moves
        rows[1:, column + 1 : column + 4] -= ratio * _cross(arm)
        rows[1:, column + 4 : column + 7] += np.eye(3)
        residual[1:] = dw - ratio * (_cross(arm) @ dv)
        return np.vstack([rows[:1], rows[1:] / self.lever_sigma[k]]), np.append(
            residual[:1], residual[1:] / self.lever_sigma[k]
        )

    def stepped(self, step: Array) -> _Chain:
        """The chain after a step of all parameters; links keep their order and move by half a frame at the most."""
        times, jumps, free = [link.time_s for link in self.links], self.jumps.copy(), list(self.free)
        spacing = self.spacing_s
        column = 12
        for k, link in enumerate(self.links):
            state = self.free[k]
            if state is not None:
                free[k] = moved(state, step[column : column + 12])
            else:
                times[k] += float(np.clip(step[column], -0.5 * spacing, 0.5 * spacing))
                jumps[k] += step[column + 1 : column + 7]
            column += link.size
        for k in range(1, len(times)):
            times[k] = max(times[k], times[k - 1] + 1e-6 * spacing)
        links = tuple(replace(link, time_s=t) for link, t in zip(self.links, times, strict=True))
        motion, shared, table = self.sizes
        return replace(
            self, first=moved(self.first, step[:12]), links=links, jumps=jumps, free=tuple(free),
            shared=self.shared + step[motion : motion + shared],
            table_m=self.table_m + (float(step[-1]) if table else 0.0),
        )  # fmt: skip

    def _covariance(self, sums: _Sums, weights: Array, states: list[State], maps: list[Array]) -> Array:
        """A⁻¹ B A⁻¹: A as it was weighted, B as the errors are."""
        bread = scaled_inverse(sums.normal)
        share = 1.0 / self.scatter.slow_variance(self.spacing_s)
        meat = sums.normal.copy()
        for mine, state, S in zip(self._parts(), states, maps, strict=True):
            if mine.stop > mine.start:
                part, F = self.seen.rows(mine), np.vstack([S, self._pick])
                stated = flight_sums(part, state, self.shared, weights[mine], share, share).normal
                true = flight_meat(part, state, weights[mine], share, self.scatter)
                meat += F.T @ (true - stated) @ F
        return np.asarray(bread @ meat @ bread)

    def finished(self, sums: _Sums, weights: Array) -> Joined:
        """The result, with every flight at its own beginning."""
        states, maps, ends_of_flights = self.states_and_maps()
        covariance, scatter = self._covariance(sums, weights, states, maps), self.scatter
        rest = sum(float(residual @ residual) for _, residual, _ in self._rules(ends_of_flights))
        ratio = np.minimum(np.sqrt(sums.squares) / CUT_SIGMA, 1.0)
        share = float(np.mean(scatter.variance / scatter.slow_variance(self.spacing_s)))
        cost = rest + share * float((2.0 * CUT_SIGMA**2 * (1.0 - (1.0 - ratio**2) ** 3)).sum())
        sigma, columns, column = [], [], 12
        for link in self.links:
            columns.append(-1 if link.is_open else column)
            sigma.append(np.nan if link.is_open else float(np.sqrt(max(covariance[column, column], 0.0))))
            column += link.size
        ends = [*(link.time_s for link in self.links), float(self.seen.time_s[-1])]
        flights = []
        for k, (state, S) in enumerate(zip(states, maps, strict=True)):
            if k == 0 or self.links[k - 1].is_open:
                # A free state is kept at its reference instant; the flight is quoted from where it begins.
                begin = float(self.seen.time_s[0]) if k == 0 else self.links[k - 1].time_s
                flight = Flight(state, np.inf)
                state, S = flight.at(begin), transition(flight, begin) @ S
            maps[k] = S
            C = S @ covariance @ S.T
            flights.append(Flight(state, float(ends[k]), (C + C.T) / 2.0))
        return Joined(
            tuple(flights), self.links, covariance, tuple(maps), np.array(sigma), np.array(columns, np.int64),
            np.sqrt(sums.squares), weights, scatter, self.shared, sums.strain, self.table_m, cost,
        )  # fmt: skip


def _cross(v: Array) -> Array:
    """(3, 3) with _cross(v) @ u = v × u."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
