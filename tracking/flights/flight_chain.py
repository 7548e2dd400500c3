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

from ...model.throw import Flight, State
from ...model.world import GRAVITY_M_S2
from . import flight_kernels as kernels
from .chain_solver import MAX_LINK_SIZE, Stages, chain_covariance, empty_stages
from .descent import CONTACT_SIGMA_M as CONTACT_SIGMA_M
from .descent import CUTOFF_SIGMAS as CUTOFF_SIGMAS
from .descent import (
    ChainData,
    ChainTrajectory,
    ChainValues,
    FrameErrors,
    chain_equations,
    descend,
    empty_trajectory,
    robust_cost,
)
from .flight_kernels import ImpactEquations, VertexImpacts
from .single_flights import (
    ErrorModel,
    WeightedPoses,
    frame_information,
    gradient_covariances,
    normal_equations,
    packed,
    pose_arrays,
    spin_jumps,
    transition_matrix,
    unpacked,
)

Array = NDArray[np.float64]

TABLE_SIGMA_M = 3e-5
"""Prior standard deviation [m] of the table's height, common to all contacts: flatness and calibration."""
LEVER_SHARE = 0.01
"""Tolerance of Δω = m I⁻¹ (r × Δv) as a share of Δω: drilled pips change I by a per cent."""
MIN_LEVER_SIGMA_RAD_S = 0.3
"""Least tolerance [rad/s] of the same under the usual gravity: the contact is a patch of some 0.1 mm, not a point. It goes with
the velocities of throws, and these with the root of gravity."""
LOST_SHARE = 0.25
"""A flight with a smaller share of its frames on it is lost: some frames lie on any motion by chance, as the first after an
impact."""
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
        """Standard error [px] of the first shared error, infinite if there is none: that of the contour, unless only errors of a
        calibration are estimated."""
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


# --- the descent -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Descent:
    """The result of a descent."""

    unknowns: _Unknowns
    trajectory: ChainTrajectory
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
    """Step until no step gains any more (`descent.descend`)."""
    values, trajectory = unknowns.copied_values(), unknowns.empty_trajectory()
    frames, weights = unknowns.frame_errors(), np.ones(len(unknowns.observations))
    descend(unknowns.data, values, trajectory, frames, estimate_scale, by_flight, steps, weights)
    errors = ErrorModel.white(float(np.sqrt(frames.variance[0]))) if estimate_scale else unknowns.errors
    return _Descent(replace(unknowns, values=values, errors=errors, share=frames.share), trajectory, weights)


# --- impacts at a vertex -----------------------------------------------------------------------------------------------


def vertex_impact_equations(
    before: State, behind: State, impact: VertexImpact, table_m: float, gravity_m_s2: float
) -> tuple[Array, Array]:
    """The four conditions of an impact at a vertex, in sigmas: derivatives (4, 25) with respect to the states before and behind,
    both at the instant of contact, and to that instant; and present values (4,). The sigma of the spin goes with the root of
    gravity."""
    jump = np.concatenate([behind.velocity_m_s - before.velocity_m_s, behind.omega_rad_s - before.omega_rad_s])
    impacts = _vertex_impacts((Link(behind.time_s, impact=impact),))
    found = _impact_equations(
        packed(before)[None], jump[None], impacts, table_m, _lever_sigma(jump[None], gravity_m_s2)
    )
    rows, by_link = np.zeros((4, JOINT)), found.by_link[0]
    rows[:, :12], rows[:, 18:24], rows[:, 24] = found.by_end[0], by_link[:, 1:7], by_link[:, 0]
    rows[:, 6:12] -= by_link[:, 1:7]
    return rows, found.violation[0]


def vertex_impact_cost(chain: FlightChain, k: int, impact: VertexImpact, table_sigma_m: float) -> float:
    """Squared sigmas by which joined link k would cost more as that impact than with free jumps, to first order: the free
    motion's violation of the conditions over its uncertainty there."""
    before, behind = chain.flights[k].at(chain.links[k].time_s), chain.flights[k + 1].start
    gravity_m_s2 = chain.flights[k].gravity_m_s2
    rows, violation = vertex_impact_equations(before, behind, impact, chain.table_m, gravity_m_s2)
    covariance = np.eye(4) + rows @ chain.joint_covariance[k] @ rows.T
    covariance[0, 0] += (table_sigma_m / CONTACT_SIGMA_M) ** 2
    # By eigenvalues, none of which is below one: in a flight without frames some may overflow a Cholesky factor.
    values, vectors = np.linalg.eigh(covariance)
    return float(((vectors.T @ violation) ** 2 / np.maximum(values, 1.0)).sum())


def _lever_sigma(jumps: Array, gravity_m_s2: float) -> Array:
    """(N,) [rad/s] tolerance of Δω = m I⁻¹ (r × Δv) for jumps (N, 6)."""
    least_rad_s = MIN_LEVER_SIGMA_RAD_S * np.sqrt(gravity_m_s2 / GRAVITY_M_S2)
    return np.asarray(LEVER_SHARE * np.linalg.norm(jumps[:, 3:], axis=1) + least_rad_s)


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
class _Unknowns:
    """The parameters of a chain: the first state, for each link either (t, Δv, Δω) or a free state, the errors that all frames
    share, and the height of the table if there is an impact on it; with the data that they are fitted to."""

    observations: WeightedPoses
    links: tuple[Link, ...]
    values: ChainValues
    data: ChainData
    errors: ErrorModel
    share: Array
    """(6,) weights of the whitened numbers.

    Frames are weighted as if independent, with the long-run variance of their errors. For a smooth motion that loses next to
    nothing against generalised least squares (Grenander & Rosenblatt, Statistical Analysis of Stationary Time Series, 1957,
    ch. 7), and it depends less on the error model."""

    @staticmethod
    def from_guess(
        observations: WeightedPoses,
        starts: list[State],
        links: tuple[Link, ...],
        shared_sigma: Array,
        errors: ErrorModel,
        table_sigma_m: float,
    ) -> _Unknowns:
        """The unknowns at initial states of the flights, arguments as `fit_chain`. The tolerance of each impact's spin is fixed
        by the guess, so that the cost means the same on every step."""
        numbers = np.array([packed(start) for start in starts])
        times_s = np.array([link.time_s for link in links], np.float64)
        fallen = np.diff(numbers[:, 0])[:, None] * np.array([0.0, 0.0, observations.gravity_m_s2])
        # Both sides of a link fall alike: only the difference between their times of fall remains.
        spun = spin_jumps(observations, starts, times_s)
        jumps = np.hstack([np.diff(numbers[:, 8:11], axis=0) + fallen, spun])
        spacing_s = float(np.median(np.diff(observations.time_s))) if len(observations) > 1 else 1.0
        is_open = np.array([link.is_open for link in links], np.bool_)
        share = 1.0 / errors.long_run_variance(spacing_s)
        impacts = _vertex_impacts(links)
        # The table's height is a parameter if any link is a vertex impact.
        constant_sigma = np.append(shared_sigma, table_sigma_m) if len(impacts.link) else shared_sigma
        size = 12 + sum(link.size for link in links) + len(constant_sigma)
        data = ChainData(
            pose_arrays(observations), frame_information(observations, share), float(share[0]), is_open, impacts,
            np.ascontiguousarray(constant_sigma, np.float64), _lever_sigma(jumps, observations.gravity_m_s2), spacing_s, size,
        )  # fmt: skip
        values = ChainValues(numbers[0].copy(), times_s, jumps, numbers[1:].copy(), np.zeros(len(constant_sigma)))
        return _Unknowns(observations, links, values, data, errors, share)

    @property
    def has_impacts(self) -> bool:
        """Whether any link is a vertex impact."""
        return len(self.data.impacts.link) > 0

    @property
    def shared(self) -> Array:
        """(m,) the shared errors."""
        return self.values.constants[: len(self.values.constants) - self.has_impacts]

    @property
    def table_m(self) -> float:
        """Height of the table; 0 without an impact on it."""
        return float(self.values.constants[-1]) if self.has_impacts else 0.0

    def copied_values(self) -> ChainValues:
        """The values in arrays of their own."""
        return ChainValues(*(each.copy() for each in self.values))

    def frame_errors(self) -> FrameErrors:
        """The error model in arrays of its own."""
        return FrameErrors(self.errors.variance, self.share.copy())

    def empty_trajectory(self) -> ChainTrajectory:
        """Room for the motion."""
        return empty_trajectory(len(self.observations), len(self.links), len(self.data.impacts.link))

    def robust_cost(self, trajectory: ChainTrajectory) -> float:
        """`descent.robust_cost`."""
        return float(robust_cost(self.data, self.values, trajectory, self.frame_errors()))

    def equations(self, trajectory: ChainTrajectory, weights: Array) -> tuple[Array, Array, Stages]:
        """Normal equations of the flights, the priors included in those of the first, and the links between."""
        count, size = len(self.links), 12 + len(self.values.constants)
        normal, gradient = np.zeros((count + 1, size, size)), np.zeros((count + 1, size))
        stages = empty_stages(count, size)
        chain_equations(self.data, self.values, trajectory, weights, self.share, normal, gradient, stages)
        return normal, gradient, stages

    def _normal_equations(self, trajectory: ChainTrajectory, weights: Array, size: int) -> Array:
        """Normal matrices of the frames alone."""
        change = float(self.share[0]) / self.data.information_share
        return normal_equations(
            self.observations, trajectory.cuts, trajectory.motion.states, trajectory.residual, change * weights,
            self.data.information, size,
        )[0]  # fmt: skip

    def finished(self, trajectory: ChainTrajectory, weights: Array) -> FlightChain:
        """The fitted chain, with covariances."""
        normal, _, stages = self.equations(trajectory, weights)
        noise = self._gradient_covariances(trajectory, weights, normal)
        last, pairs = chain_covariance(normal, noise, stages)
        size, count = len(last), len(self.links)
        joint_covariance, sigma_time_s = np.full((count, JOINT, JOINT), np.nan), np.full(count, np.nan)
        for k in np.flatnonzero(~self.data.is_open).tolist():
            to_joint = np.zeros((JOINT, size + MAX_LINK_SIZE))
            to_joint[:12, :12] = trajectory.motion.transitions[k]
            to_joint[12:24] = np.hstack([stages.by_state[k], stages.by_link[k]])[:12]
            to_joint[24, size] = 1.0
            joint_covariance[k] = to_joint @ pairs[k] @ to_joint.T
            sigma_time_s[k] = np.sqrt(max(joint_covariance[k, 24, 24], 0.0))
        covariances = [(pairs[k] if k < count else last)[:12, :12] for k in range(count + 1)]
        squares = trajectory.residual**2 @ (1.0 / self.errors.variance) / 6.0
        impact_chi2 = np.zeros(count)
        impact_chi2[self.data.impacts.link] = (trajectory.impacts.violation**2).sum(1)
        links = tuple(replace(link, time_s=float(t)) for link, t in zip(self.links, self.values.times_s, strict=True))
        shared = slice(12, 12 + len(self.shared))
        return FlightChain(
            self._flights(trajectory.motion.states, covariances), links, sigma_time_s, joint_covariance, np.sqrt(squares),
            weights, self.errors, self.shared, last[shared, shared], impact_chi2, self.table_m, self.robust_cost(trajectory),
        )  # fmt: skip

    def _flights(self, states: Array, covariances: Sequence[Array]) -> tuple[Flight, ...]:
        """The flights from packed states (flights, 14), each stated at its own beginning."""
        begins = np.append(self.observations.time_s[0], self.values.times_s)
        ends = np.append(self.values.times_s, self.observations.time_s[-1])
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

    def _gradient_covariances(self, trajectory: ChainTrajectory, weights: Array, normal: Array) -> Array:
        """Covariances of the flights' gradients under the error model; `normal` contains them as weighted."""
        size = normal.shape[1]
        stated = self._normal_equations(trajectory, weights, size)
        if self.errors.variance_ratio.any():
            parts = (self.observations, trajectory.cuts, trajectory.motion.states, weights)
            return normal - stated + gradient_covariances(*parts, self.share, self.errors, size)
        return normal - stated + self._normal_equations(trajectory, weights**2, size)
