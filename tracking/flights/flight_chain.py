"""A chain of flights joined by impacts, fitted to the poses of many frames at once.

A throw with N impacts has twelve numbers for its first flight, and for each impact its instant t, the jump Δv of the velocity and
the jump Δω of the spin. Position and orientation are continuous at t, which is what determines t to a fraction of a frame. Where
several contacts follow each other too fast to be separated, no single instant joins the flights: such a link is *open*, and the
flight after it has twelve free numbers of its own.

First-order changes at an impact, with those within a flight from `single_flights`:

    δp' = δp(t) - Δv δt     δv' = δv + δ(Δv)     δθ' = δθ(t) - Δω δt     δω' = δω + δ(Δω) + (ω̇₋ - ω̇₊) δt

where ω̇ before and behind it are 0 for a spherical top.

**Conditions of an impact at a vertex** (`VertexImpact`), with or without friction: the table pushes at one point, r from the
centre, for no time. Hence Δω = m I⁻¹ (r × Δv) with the inertia I, and the point is on the table at t. Both are observations
with a tolerance, so that a deviation of the inertia or of the table's height from the stated one bends the fit no further than
allowed. The squares that they leave (`impact_chi2`) indicate whether the impact is one at that point.

**Shared parameters**: m errors common to all frames, with priors (`shared_bias`), and the height of the table, with another.

A step of the fit solves the chain link by link (`chain_solver`), at a cost linear in the frames and in the links.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.engine.asymmetric import TorqueFree
from ...model.throw import Flight, State
from . import flight_kernels as kernels
from .chain_solver import MAX_LINK_SIZE, Stages, chain_covariance, solve_chain
from .flight_kernels import FrameInformation, ImpactEquations, VertexImpacts
from .single_flights import (
    ErrorModel,
    WeightedPoses,
    chain_residuals,
    frame_information,
    gradient_covariances,
    normal_equations,
    packed,
    propagate_chain,
    spin_jumps,
    spin_rates,
    transition_matrix,
    unpacked,
)

Array = NDArray[np.float64]

CUTOFF_SIGMAS = 4.685
"""Frames beyond this many sigmas (rms of the six numbers, in units of the error model) have no weight: Tukey's biweight."""
MEDIAN_RMS = 0.944
"""Median of the root mean square of six unit normals."""
PRIOR_NUMBERS = 12.0
"""Weight of the frames' stated sigmas, in numbers whose errors are as stated: a few frames do not overrule them."""
TABLE_SIGMA_M = 3e-5
"""Prior standard deviation [m] of the table's height, common to all contacts: flatness and calibration."""
CONTACT_SIGMA_M = 2e-5
"""Standard deviation [m] of a single contact about that height: a stiff die of a few grams is indented by some 0.01 mm."""
LEVER_SHARE = 0.01
"""Tolerance of Δω = m I⁻¹ (r × Δv) as a share of Δω: drilled pips change I by a per cent."""
MIN_LEVER_SIGMA_RAD_S = 0.3
"""Least tolerance [rad/s] of the same: the contact is a patch of some 0.1 mm, not a point."""
LARGEST_STEP = 1e5
"""A step larger than this in any parameter (SI) leaves all that a die can do: its spin reaches some 1e3 rad/s."""
DAMPING_TRIALS = 12
"""Attempts, with ten times the damping each, to find a step that does not raise the cost."""
FIRST_DAMPING = 1e-6
"""Levenberg's damping at the first step."""
LOOSE_STEPS = 3
"""First steps, over which the cutoff is widened so that frames far off a first guess are drawn in."""
LOOSE_FACTOR = 3.0
"""Least factor on the cutoff over those steps."""
LOST_SHARE = 0.25
"""A flight with a smaller share of its frames on it is lost: some frames lie on any motion by chance, as the first after an
impact."""
SLOW_RATE = 0.5
"""Steps that shrink by a larger factor than this are extrapolated."""
SLOWEST_RATE = 0.95
"""Steps that shrink by a larger factor than this are not extrapolated: that would be more than twenty steps at once."""
CONVERGED_COST = 1e-2
"""Gain [squared sigmas] of a step below which the fit has converged."""
CONVERGED_SHARE = 1e-4
"""The same as a share of the cost; the smaller of both counts."""
JOINT = 25
"""Size of a joint covariance: state before a link (12), state behind it (12), its instant."""


@dataclass(frozen=True, eq=False)
class VertexImpact:
    """A contact at one vertex of the die."""

    point_m: Array
    """(3,) in the body frame: the corner of a sharp die, the centre of the inscribed ball of a rounded one."""
    rounding_m: float
    """Radius [m] of that ball, whose lowest point touches."""
    mass_over_inertia: Array
    """(3, 3) m I⁻¹ [1/m²], body frame."""

    def arm(self, rotation: Array) -> Array:
        """(3,) [m] from the centre of the die to the point of contact, world axes."""
        return np.asarray(rotation @ self.point_m - np.array([0.0, 0.0, self.rounding_m]))

    def spin_change(self, rotation: Array, velocity_change_m_s: Array) -> Array:
        """Δω (3,) [rad/s] that goes with a change (3,) of velocity."""
        torque = np.cross(self.arm(rotation), velocity_change_m_s)
        return np.asarray(rotation @ self.mass_over_inertia @ rotation.T @ torque)


@dataclass(frozen=True, eq=False)
class Link:
    """The connection between two flights."""

    time_s: float
    is_open: bool = False
    """True if no single instant joins the flights; `time_s` then only separates their frames."""
    impact: VertexImpact | None = None
    """The vertex that struck; None for a joined link with free jumps."""

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
    """The links between them, at the fitted instants."""
    sigma_time_s: Array
    """(N,) standard error of each instant; NaN for open links."""
    joint_covariance: Array
    """(N, 25, 25) covariance of the state before each link, the state behind it, both at its instant, and that instant; NaN for
    open links."""
    residual: Array
    """(n,) distance of each frame from the motion: rms of its six numbers, in sigmas of the error model."""
    weights: Array
    """(n,) 0 for an outlier, 1 for a frame amid the others."""
    errors: ErrorModel
    shared: Array
    """(m,) the errors that all frames share."""
    shared_covariance: Array
    """(m, m) of these errors."""
    impact_chi2: Array
    """(N,) squared sigmas of the four conditions of each vertex impact; 0 for other links."""
    table_m: float
    """Height [m] of the table on which the impacts agree."""
    cost: float
    """Squared sigmas of frames (Tukey's loss, at most 2 CUTOFF_SIGMAS² a frame), priors and impacts: comparable between fits of
    the same frames with one error model."""

    @property
    def shared_sigma(self) -> Array:
        """(m,) standard errors of the shared errors."""
        return np.asarray(np.sqrt(np.diag(self.shared_covariance)))

    @property
    def contour_sigma_px(self) -> float:
        """Standard error [px] of the first shared error, that of the contour; infinite if it was not estimated."""
        return float(self.shared_sigma[0]) if len(self.shared) else np.inf

    @property
    def link_times_s(self) -> Array:
        """(N,) instants."""
        return np.array([link.time_s for link in self.links])

    def parts(self, time_s: Array) -> list[slice]:
        """Rows of each flight among frames at some instants (n,)."""
        edges = [0, *np.searchsorted(time_s, self.link_times_s, side="right").tolist(), len(time_s)]
        return [slice(a, b) for a, b in itertools.pairwise(edges)]

    def inlier_share(self, time_s: Array) -> Array:
        """(flights,) share of each flight's frames, at instants (n,), that lie on it; NaN for a flight without frames."""
        weights = [self.weights[part] for part in self.parts(time_s)]
        return np.array([float((own > 0.0).mean()) if len(own) else np.nan for own in weights])


def fit_chain(
    observations: WeightedPoses,
    starts: Sequence[State],
    links: Sequence[Link],
    *,
    errors: ErrorModel | None = None,
    shared_sigma: Array | None = None,
    table_sigma_m: float = TABLE_SIGMA_M,
    steps: int = 40,
) -> FlightChain:
    """Least squares over a whole chain: Gauss-Newton with Levenberg's damping and biweight frames.

    `starts` (N + 1) are initial states of the flights (for flights behind a joined link only the velocities matter). `errors` is
    the error model; if None, errors are white and their scale is estimated here. `shared_sigma` (m,) is the prior of the shared
    errors, which are not estimated if it is None; `table_sigma_m` that of the table's height. Deterministic; a chain that cannot
    be improved is returned as it is."""
    if shared_sigma is None:
        observations = observations.with_bias_jacobian(np.zeros((len(observations), 6, 0)))
    sigma = np.zeros(0) if shared_sigma is None else shared_sigma
    model = errors or ErrorModel.white()
    unknowns = _Unknowns.from_guess(observations, list(starts), tuple(links), sigma, model, table_sigma_m)
    best = _descend(unknowns, estimate_scale=errors is None, by_flight=False, steps=steps)
    if best.lost_flights > 0:
        other = _descend(unknowns, estimate_scale=errors is None, by_flight=True, steps=steps)
        best = min(best, other, key=lambda found: (found.lost_flights, found.cost if errors else 0.0))
    return best.unknowns.finished(best.trajectory, best.weights)


WHITE = ErrorModel.white()


# --- the descent -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Descent:
    """The result of a descent."""

    unknowns: _Unknowns
    trajectory: _Trajectory
    weights: Array

    @property
    def lost_flights(self) -> int:
        """Number of flights of three frames or more on which hardly any of their frames lie."""
        counts = [(b - a, int((self.weights[a:b] > 0.0).sum())) for a, b in itertools.pairwise(self.trajectory.cuts)]
        return sum(frames >= 3 and inliers < LOST_SHARE * frames for frames, inliers in counts)

    @property
    def cost(self) -> float:
        """Comparable between descents with one error model."""
        return self.unknowns.robust_cost(self.trajectory)


def _descend(unknowns: _Unknowns, *, estimate_scale: bool, by_flight: bool, steps: int) -> _Descent:
    """Step until no step gains any more.

    A first guess may leave all frames far off; the cutoff is therefore widened over the first steps, by one factor for all frames
    or flight by flight. The latter recovers a flight that begins so far off that it would be left without frames; but if another
    contact lies within a flight, one factor for all frames does better."""
    trajectory, damping, gains = unknowns.trajectory(), FIRST_DAMPING, [0.0]
    for step in range(steps):
        if estimate_scale:
            scale = _scale(trajectory.squares(WHITE), unknowns.size)
            unknowns = unknowns.with_errors(ErrorModel.white(scale))
        squares = trajectory.squares(unknowns.errors)
        cuts = trajectory.cuts if by_flight else np.array([0, len(squares)])
        weights = _biweights(squares, _cutoff_factors(squares, cuts) if step < LOOSE_STEPS else np.ones(len(squares)))
        cost = unknowns.cost(trajectory, weights)
        normal, gradient, stages = unknowns.equations(trajectory, weights)
        for _ in range(DAMPING_TRIALS):
            first, changes = solve_chain(normal, gradient, stages, damping)
            if max(np.abs(first).max(), np.abs(changes).max(initial=0.0)) < LARGEST_STEP:
                trial = unknowns.stepped(first, changes)
                trial_trajectory = trial.trajectory()
                new = trial.cost(trial_trajectory, weights)
                if new <= cost * (1.0 + 1e-12):
                    break
            damping = max(damping * 10.0, 1e-9)
        else:
            break
        gains.append(cost - new)
        if step > LOOSE_STEPS and (times := _remaining_steps(gains[-2:])) > 1.0:
            further = unknowns.stepped(times * first, times * changes)
            further_trajectory = further.trajectory()
            if further.robust_cost(further_trajectory) < trial.robust_cost(trial_trajectory):
                trial, trial_trajectory, gains = further, further_trajectory, [*gains, 0.0]
        unknowns, trajectory, damping = trial, trial_trajectory, max(damping * 0.1, 1e-12)
        if cost - new < min(CONVERGED_COST, CONVERGED_SHARE * cost) and step > LOOSE_STEPS:
            break
    return _Descent(unknowns, trajectory, weights)


def _remaining_steps(gains: Sequence[float]) -> float:
    """Sum of the steps still to come, in units of the last one, if each is shorter than the one before by one factor: frames near
    the cutoff are drawn in or released little by little. 1 if the steps do not shrink that way."""
    before, last = gains
    # The gain of a step goes as its square.
    rate = float(np.sqrt(last / before)) if 0.0 < last < before else 0.0
    return 1.0 / (1.0 - rate) if SLOW_RATE < rate < SLOWEST_RATE else 1.0


def _cutoff_factors(squares: Array, cuts: NDArray[np.int64]) -> Array:
    """(n,) factor on each frame's cutoff over the first steps: as large as its group is off, and LOOSE_FACTOR at least."""
    loose = np.full(len(squares), LOOSE_FACTOR)
    for a, b in itertools.pairwise(cuts):
        if b > a:
            loose[a:b] = max(LOOSE_FACTOR, float(np.sqrt(np.median(squares[a:b]))) / MEDIAN_RMS)
    return loose


def _biweights(squares: Array, loose: Array) -> Array:
    ratio = np.sqrt(squares) / (CUTOFF_SIGMAS * loose)
    return np.asarray(np.where(ratio < 1.0, (1.0 - ratio**2) ** 2, 0.0))


def _scale(squares: Array, parameters: int) -> float:
    """σ from the median frame, corrected for the fitted parameters, and drawn to 1 if the frames are few."""
    numbers = 6.0 * len(squares)
    free = max(numbers - parameters, 0.0)
    typical = float(np.median(squares)) / MEDIAN_RMS**2 * numbers / max(free, 6.0)
    return float(np.sqrt(max((free * typical + PRIOR_NUMBERS) / (free + PRIOR_NUMBERS), 1e-24)))


# --- impacts at a vertex -----------------------------------------------------------------------------------------------


def vertex_impact_equations(before: State, behind: State, impact: VertexImpact, table_m: float) -> tuple[Array, Array]:
    """The four conditions of an impact at a vertex, in sigmas: derivatives (4, 25) with respect to the states before and behind,
    both at the instant of contact, and to that instant; and present values (4,)."""
    jump = np.concatenate([behind.velocity_m_s - before.velocity_m_s, behind.omega_rad_s - before.omega_rad_s])
    impacts = _vertex_impacts((Link(behind.time_s, impact=impact),))
    found = _impact_equations(packed(before)[None], jump[None], impacts, table_m, _lever_sigma(jump[None]))
    rows, by_link = np.zeros((4, JOINT)), found.by_link[0]
    rows[:, :12], rows[:, 18:24], rows[:, 24] = found.by_end[0], by_link[:, 1:7], by_link[:, 0]
    rows[:, 6:12] -= by_link[:, 1:7]
    return rows, found.violation[0]


def vertex_impact_cost(chain: FlightChain, k: int, impact: VertexImpact, table_sigma_m: float) -> float:
    """Squared sigmas by which joined link k would cost more as that impact than with free jumps, to first order: the free
    motion's violation of the conditions over its uncertainty there."""
    before, behind = chain.flights[k].at(chain.links[k].time_s), chain.flights[k + 1].start
    rows, violation = vertex_impact_equations(before, behind, impact, chain.table_m)
    covariance = np.eye(4) + rows @ chain.joint_covariance[k] @ rows.T
    covariance[0, 0] += (table_sigma_m / CONTACT_SIGMA_M) ** 2
    # By eigenvalues, none of which is below one: in a flight without frames some may overflow a Cholesky factor.
    values, vectors = np.linalg.eigh(covariance)
    return float(((vectors.T @ violation) ** 2 / np.maximum(values, 1.0)).sum())


def _lever_sigma(jumps: Array) -> Array:
    """(N,) [rad/s] tolerance of Δω = m I⁻¹ (r × Δv) for jumps (N, 6)."""
    return np.asarray(LEVER_SHARE * np.linalg.norm(jumps[:, 3:], axis=1) + MIN_LEVER_SIGMA_RAD_S)


def _vertex_impacts(links: Sequence[Link]) -> VertexImpacts:
    """The impacts among the links of a chain."""
    impacts = [(k, link.impact) for k, link in enumerate(links) if link.impact is not None]
    return VertexImpacts(
        np.array([k for k, _ in impacts], np.int64),
        np.array([impact.point_m for _, impact in impacts]).reshape(-1, 3),
        np.array([impact.rounding_m for _, impact in impacts]),
        np.array([impact.mass_over_inertia for _, impact in impacts]).reshape(-1, 3, 3),
    )


def _impact_equations(
    ends: Array, jumps: Array, impacts: VertexImpacts, table_m: float, lever_sigma: Array
) -> ImpactEquations:
    """Of each vertex impact, from the states (N, 14) before the links and the jumps (N, 6): its point lies on the table, and
    Δω = m I⁻¹ (r × Δv) within `lever_sigma` (N,)."""
    count = len(impacts.link)
    found = ImpactEquations(np.zeros((count, 4, 12)), np.zeros((count, 4, MAX_LINK_SIZE)), np.zeros((count, 4)))
    kernels.impact_equations(ends, jumps, impacts, table_m, CONTACT_SIGMA_M, lever_sigma, found)
    return found


# --- the unknowns ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Trajectory:
    """The motion that the unknowns give, and the residuals of the frames about it."""

    cuts: NDArray[np.int64]
    """(flights + 1,) rows of each flight."""
    states: Array
    """(flights, 14) packed, at the beginning of each."""
    ends: Array
    """(N, 14) at the instants of the links."""
    transitions: Array
    """(N, 12, 12) from beginning to end."""
    residuals: Array
    """(n, 6) whitened."""
    impacts: ImpactEquations

    def squares(self, errors: ErrorModel) -> Array:
        """(n,) mean of each frame's six squared whitened residuals, each over its expected one."""
        return np.asarray(self.residuals**2 @ (1.0 / errors.variance) / 6.0)


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """The parameters of a chain: the first state, for each link either (t, Δv, Δω) or a free state, the errors that all frames
    share, and the height of the table if there is an impact on it; with the data that they are fitted to."""

    observations: WeightedPoses
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
    vertex_impacts: VertexImpacts
    constants: Array
    """(c,) parameters that all flights share: the shared errors, and behind them the table's height [m] if there is an impact."""
    constant_sigma: Array
    """(c,) their prior standard deviations."""
    lever_sigma: Array
    """(N,) tolerance [rad/s] of each impact's spin; fixed by the guess, so that the cost means the same on every step."""
    errors: ErrorModel
    share: Array
    """(6,) weights of the whitened numbers.

    Frames are weighted as if independent, with the long-run variance of their errors. For a smooth motion that loses next to
    nothing against generalised least squares (Grenander & Rosenblatt, Statistical Analysis of Stationary Time Series, 1957,
    ch. 7), and it depends less on the error model."""
    information: FrameInformation
    """`single_flights.frame_information` with the error model of the guess."""
    information_share: float
    """Share of the first whitened number in it."""

    @staticmethod
    def from_guess(
        observations: WeightedPoses,
        starts: list[State],
        links: tuple[Link, ...],
        shared_sigma: Array,
        errors: ErrorModel,
        table_sigma_m: float,
    ) -> _Unknowns:
        """The unknowns at initial states of the flights, arguments as `fit_chain`."""
        numbers, times_s = np.array([packed(start) for start in starts]), np.array([link.time_s for link in links])
        fallen = np.diff(numbers[:, 0])[:, None] * np.array([0.0, 0.0, observations.gravity_m_s2])
        # Both sides of a link fall alike: only the difference between their times of fall remains.
        spun = spin_jumps(observations, starts, times_s)
        jumps = np.hstack([np.diff(numbers[:, 8:11], axis=0) + fallen, spun])
        spacing_s = float(np.median(np.diff(observations.time_s))) if len(observations) > 1 else 1.0
        is_open = np.array([link.is_open for link in links], bool)
        share = 1.0 / errors.long_run_variance(spacing_s)
        impacts = _vertex_impacts(links)
        # The table's height is a parameter if any link is a vertex impact.
        constant_sigma = np.append(shared_sigma, table_sigma_m) if len(impacts.link) else shared_sigma
        return _Unknowns(
            observations, spacing_s, numbers[0], links, times_s, jumps, is_open, numbers[1:],
            impacts, np.zeros(len(constant_sigma)), constant_sigma, _lever_sigma(jumps),
            errors, share, frame_information(observations, share), float(share[0]),
        )  # fmt: skip

    def with_errors(self, errors: ErrorModel) -> _Unknowns:
        """The same with another error model."""
        return replace(self, errors=errors, share=1.0 / errors.long_run_variance(self.spacing_s))

    @property
    def has_impacts(self) -> bool:
        """Whether any link is a vertex impact."""
        return len(self.vertex_impacts.link) > 0

    @property
    def shared(self) -> Array:
        """(m,) the shared errors."""
        return self.constants[: len(self.constants) - self.has_impacts]

    @property
    def table_m(self) -> float:
        """Height of the table; 0 without an impact on it."""
        return float(self.constants[-1]) if self.has_impacts else 0.0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 12 + sum(link.size for link in self.links) + len(self.constants)

    def trajectory(self) -> _Trajectory:
        """The motion at the present values."""
        states, ends, transitions = propagate_chain(
            self.observations, self.first, self.times_s, self.jumps, self.is_open, self.free
        )
        inside = np.searchsorted(self.observations.time_s, self.times_s, side="right")
        cuts = np.concatenate([[0], inside, [len(self.observations)]]).astype(np.int64)
        residuals = chain_residuals(self.observations, cuts, states, self.shared)
        impacts = _impact_equations(ends, self.jumps, self.vertex_impacts, self.table_m, self.lever_sigma)
        return _Trajectory(cuts, states, ends, transitions, residuals, impacts)

    def _cost_of_priors_and_impacts(self, trajectory: _Trajectory) -> float:
        """Squared sigmas of priors and impacts."""
        return float(((self.constants / self.constant_sigma) ** 2).sum() + (trajectory.impacts.violation**2).sum())

    def cost(self, trajectory: _Trajectory, weights: Array) -> float:
        """Sum of weighted squared sigmas of frames, priors and impacts."""
        frames = float(weights @ (trajectory.residuals**2 @ self.share))
        return frames + self._cost_of_priors_and_impacts(trajectory)

    def robust_cost(self, trajectory: _Trajectory) -> float:
        """The same with Tukey's loss for frames (`FlightChain.cost`). What lies beyond the cutoff counts in full: errors that
        stay for many frames, for which the others count less, explain no such frame."""
        ratio = np.minimum(np.sqrt(trajectory.squares(self.errors)) / CUTOFF_SIGMAS, 1.0)
        share = np.where(ratio < 1.0, float(np.mean(self.errors.variance * self.share)), 1.0)
        frames = float((share * 2.0 * CUTOFF_SIGMAS**2 * (1.0 - (1.0 - ratio**2) ** 3)).sum())
        return self._cost_of_priors_and_impacts(trajectory) + frames

    def equations(self, trajectory: _Trajectory, weights: Array) -> tuple[Array, Array, Stages]:
        """Normal equations of the flights, the priors included in those of the first, and the links between."""
        size = 12 + len(self.constants)
        normal, gradient = self._normal_equations(trajectory, weights, size)
        information, constants = self.constant_sigma**-2, np.arange(12, size)
        normal[0, constants, constants] += information
        gradient[0, 12:] += self.constants * information
        return normal, gradient, self._stages(trajectory, size)

    def _normal_equations(self, trajectory: _Trajectory, weights: Array, size: int) -> tuple[Array, Array]:
        """Of the frames alone. An error model that is estimated on the way is white: all shares change by one factor."""
        change = float(self.share[0]) / self.information_share
        return normal_equations(
            self.observations, trajectory.cuts, trajectory.states, trajectory.residuals, change * weights,
            self.information, size,
        )  # fmt: skip

    def _stages(self, trajectory: _Trajectory, size: int) -> Stages:
        """The links as `chain_solver` needs them."""
        stages, impacts = Stages.empty(len(self.links), size), trajectory.impacts
        struck = self.vertex_impacts.link
        stages.sizes[:] = np.where(self.is_open, 12, 7)
        constants = np.arange(12, size)
        stages.by_state[:, constants, constants] = 1.0
        stages.by_state[:, :12, :12] = np.where(self.is_open[:, None, None], 0.0, trajectory.transitions)
        # The velocity at the link changes with its instant only through gravity, which both sides share, and the spin only of a
        # body with several moments of inertia.
        stages.by_link[:, 0:6, 0] = -self.jumps
        stages.by_link[:, 9:12, 0] = self._spin_drift(trajectory)
        stages.by_link[:, np.arange(6, 12), np.arange(1, 7)] = 1.0
        stages.by_link[self.is_open] = np.eye(size, MAX_LINK_SIZE)
        stages.impact_by_state[struck, :, :12] = impacts.by_end @ trajectory.transitions[struck]
        stages.impact_by_state[struck, 0, size - 1] -= 1.0 / CONTACT_SIGMA_M
        stages.impact_by_link[struck] = impacts.by_link
        stages.violation[struck] = impacts.violation
        return stages

    def _spin_drift(self, trajectory: _Trajectory) -> Array:
        """(N, 3) [rad/s²] by how much the spin changes faster before each link than behind it; 0 for a spherical top."""
        turning = self.observations.turning
        if not isinstance(turning, TorqueFree):
            return np.zeros((len(self.links), 3))
        return spin_rates(turning, trajectory.ends) - spin_rates(turning, trajectory.states[1:])

    def stepped(self, first: Array, changes: Array) -> _Unknowns:
        """The unknowns after a step; links keep their order and move by half a frame at most."""
        start, times_s, jumps, free = self.first.copy(), self.times_s.copy(), self.jumps.copy(), self.free.copy()
        kernels.apply_step(start, times_s, jumps, self.is_open, free, first[:12], changes, 0.5 * self.spacing_s)
        for k in range(1, len(times_s)):
            times_s[k] = max(times_s[k], times_s[k - 1] + 1e-6 * self.spacing_s)
        return replace(
            self, first=start, times_s=times_s, jumps=jumps, free=free, constants=self.constants + first[12:]
        )

    def finished(self, trajectory: _Trajectory, weights: Array) -> FlightChain:
        """The fitted chain, with covariances."""
        normal, _, stages = self.equations(trajectory, weights)
        noise = self._gradient_covariances(trajectory, weights, normal)
        last, pairs = chain_covariance(normal, noise, stages)
        size, count = len(last), len(self.links)
        joint_covariance, sigma_time_s = np.full((count, JOINT, JOINT), np.nan), np.full(count, np.nan)
        for k in np.flatnonzero(~self.is_open).tolist():
            to_joint = np.zeros((JOINT, size + MAX_LINK_SIZE))
            to_joint[:12, :12] = trajectory.transitions[k]
            to_joint[12:24] = np.hstack([stages.by_state[k], stages.by_link[k]])[:12]
            to_joint[24, size] = 1.0
            joint_covariance[k] = to_joint @ pairs[k] @ to_joint.T
            sigma_time_s[k] = np.sqrt(max(joint_covariance[k, 24, 24], 0.0))
        covariances = [(pairs[k] if k < count else last)[:12, :12] for k in range(count + 1)]
        squares, impact_chi2 = trajectory.squares(self.errors), np.zeros(count)
        impact_chi2[self.vertex_impacts.link] = (trajectory.impacts.violation**2).sum(1)
        links = tuple(replace(link, time_s=float(t)) for link, t in zip(self.links, self.times_s, strict=True))
        shared = slice(12, 12 + len(self.shared))
        return FlightChain(
            self._flights(trajectory.states, covariances), links, sigma_time_s, joint_covariance, np.sqrt(squares), weights,
            self.errors, self.shared, last[shared, shared], impact_chi2, self.table_m, self.robust_cost(trajectory),
        )  # fmt: skip

    def _flights(self, states: Array, covariances: Sequence[Array]) -> tuple[Flight, ...]:
        """The flights from packed states (flights, 14), each stated at its own beginning."""
        begins = np.append(self.observations.time_s[0], self.times_s)
        ends = np.append(self.times_s, self.observations.time_s[-1])
        flights = []
        for k, numbers in enumerate(states):
            state, C = unpacked(numbers), covariances[k]
            if state.time_s != begins[k]:
                # The free state of a chain or of a flight behind an open link is stated at its reference instant.
                motion = self.observations.flight(state)
                transition = transition_matrix(motion, float(begins[k]))
                state, C = motion.at(float(begins[k])), transition @ C @ transition.T
            flight = self.observations.flight(state)
            flights.append(replace(flight, end_s=float(ends[k]), covariance=(C + C.T) / 2.0))
        return tuple(flights)

    def _gradient_covariances(self, trajectory: _Trajectory, weights: Array, normal: Array) -> Array:
        """Covariances of the flights' gradients under the error model; `normal` contains them as weighted."""
        size = normal.shape[1]
        stated, _ = self._normal_equations(trajectory, weights, size)
        if self.errors.variance_ratio.any():
            parts = (self.observations, trajectory.cuts, trajectory.states, weights)
            return normal - stated + gradient_covariances(*parts, self.share, self.errors, size)
        return normal - stated + self._normal_equations(trajectory, weights**2, size)[0]
