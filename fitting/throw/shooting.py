"""Single shooting: one trajectory of the model fitted to frames, through impacts at prescribed vertices.

The fit prescribes which vertices touch. The poses are then a smooth function of the initial state and of the parameters,
with exact derivatives (`physics.model_poses`); `contact_sequences` proposes the vertices. The unknowns are scaled by the
information of the previous fit (`least_squares`), and the loss is one that bad frames cannot bend.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ...model.throw import MAX_STATE_COMPONENT, Propagation, State, Throw
from ...tracking.flights import left_jacobians, perturbed
from ..estimation import (
    COST_TOLERANCE,
    FlightObservations,
    ResidualErrors,
    huber,
    levenberg_marquardt,
    not_below,
    pose_errors,
    residual_errors,
    triangular_factor,
    whitened,
    whitened_jacobian,
)
from ..free import FreeFlights
from .physics import Physics, model_poses
from .shared_errors import FrameResiduals, without_shared_errors

Array = NDArray[np.float64]

FIRST_SIGMA = {"chi": 0.3, "mu": 0.2, "chi_fade_s_per_m": 0.2}
"""Scale of the first steps of a parameter on which the frames have no information; it has no weight in a fit. Other
parameters: `_FIRST_SHARE` of the range that their bounds allow."""

_FIRST_SHARE = 0.1
"""Share of the range of a parameter that is the scale of its first steps."""

_NO_INFORMATION = 1e-6
"""Information on a parameter, relative to that of its first scale, below which it has none."""

LARGEST_DISPLACEMENT = 0.25
"""Displacement of a state, of what the model resolves: axes of a tilted table may make a component larger by a factor of √3."""

MOST_TURNS = 1.0
"""Turns in a frame interval by which a fit may change a spin about each axis."""
MOST_MOVED_M = 1.0
"""Distance in a frame interval by which it may change a velocity along each axis."""
MOST_AWAY_M = 100.0
"""Distance by which it may move a start along each axis."""

_HOPELESS = 2.0
"""Cost in k² per frame above which a trajectory is no fit; one within any `Choices.misfit_limit` costs less."""

_CLEARANCE_FRAMES = 0.5
"""Frame intervals between a frame and a modelled impact, as in `observations`."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A modelled throw, the frames it was fitted to, and the information that they have on it."""

    state: State
    physics: Physics
    vertices: tuple[int, ...]
    reached: int
    """The last measured flight whose frames are in the fit."""
    observations: FlightObservations
    residuals: Array
    """(n, 6) whitened, without the errors that the frames share."""
    root: Array
    """(12 + k, 12 + k) upper triangular T, Tᵀ T the information on state and free parameters."""
    propagation: Propagation
    """The throw, on the true clock."""
    shared: Array = field(default_factory=lambda: np.zeros(0))
    """(m,) the shared errors, `FrameResiduals.of_prior`; none where cameras, die and clock are exact."""

    @property
    def throw(self) -> Throw:
        """The throw, on the true clock."""
        return self.propagation.throw

    @property
    def mean_square(self) -> float:
        """Of the whitened residuals."""
        return float((self.residuals**2).mean())

    @cached_property
    def errors(self) -> ResidualErrors:
        """What its residuals show of the errors of the frames and of the law."""
        frames = self.observations
        return residual_errors(self.residuals, frames.time_s, frames.flight, len(self.root))

    @property
    def covariance_root(self) -> Array:
        """(12 + k, 12 + k) T⁻¹, whose product with its own transpose is the covariance."""
        return np.asarray(solve_triangular(self.root, np.eye(len(self.root))), dtype=np.float64)

    @property
    def covariance(self) -> Array:
        """(12 + k, 12 + k) of state and free parameters, by the stated errors of the frames: (Tᵀ T)⁻¹."""
        inverse = self.covariance_root
        return np.asarray(inverse @ inverse.T, dtype=np.float64)

    @property
    def rounding(self) -> float:
        """Largest shift of the frames [sigma] by rounding of the initial state and the parameters to double precision."""
        state = (self.state.position_m, np.ones(3), self.state.velocity_m_s, self.state.omega_rad_s)
        values = [self.physics.values[name] for name in self.physics.free]
        return float(np.finfo(float).eps * np.linalg.norm(self.root * np.concatenate([*state, values]), axis=0).max())

    def cost(self, k2: float) -> float:
        """Σ ρ over the frames, and the squares of what they share; `k2` as in `least_squares.huber`."""
        scaled, _ = huber(self.residuals, np.empty((len(self.residuals), 6, 0)), k2)
        return float((scaled**2).sum() + (self.shared**2).sum())


def fit_trajectory(
    observations: FlightObservations,
    start: Trajectory,
    vertices: tuple[int, ...],
    k2: float,
    *,
    tolerance: float = COST_TOLERANCE,
) -> Trajectory:
    """The trajectory through `vertices` nearest to the frames, started from another trajectory.

    `k2` as in `least_squares.huber`, `tolerance` as in `levenberg_marquardt`.
    """
    physics = start.physics
    names = physics.free
    room = np.array([[bound - physics.values[name] for bound in physics.bounds(name)] for name in names])
    low, high = np.full(12 + len(names), -np.inf), np.full(12 + len(names), np.inf)
    low[12:], high[12:] = room.reshape(-1, 2).T
    low[:12], high[:12] = displacement_bounds(start.state, physics.clock * observations.time_s)

    latest: list[tuple[Array, FrameResiduals, Propagation]] = []

    def evaluate(x: Array) -> tuple[Array, Array]:
        found, propagation = _evaluated(observations, start, x, vertices, k2)
        latest[:] = [(x, found, propagation)]
        residuals, jacobian = huber(found.of_frames, found.by_frames, k2)
        jacobian = np.concatenate([jacobian.reshape(-1, jacobian.shape[2]), found.by_prior])
        # The derivative is by a rotation about the displaced orientation, the unknown one about the orientation of `start`.
        jacobian[:, 3:6] = jacobian[:, 3:6] @ left_jacobians(x[None, 3:6])[0]
        return np.append(residuals.ravel(), found.of_prior), jacobian

    hopeless = _HOPELESS * k2 * len(observations)
    x = levenberg_marquardt(evaluate, start.root, low, high, tolerance=tolerance, hopeless=hopeless)
    last_x, found, propagation = latest[0]
    if not np.array_equal(last_x, x):
        # The last step raised the cost.
        found, propagation = _evaluated(observations, start, x, vertices, k2)
    _, scaled = huber(found.of_frames, found.by_frames, k2)
    return replace(
        start,
        state=perturbed(start.state, x[:12]),
        physics=physics.moved(x[12:]),
        vertices=vertices,
        observations=observations,
        residuals=found.of_frames,
        root=_information_root(scaled, found.by_prior, physics),
        propagation=propagation,
        shared=found.of_prior,
    )


def displacement_bounds(state: State, times_s: Array) -> tuple[Array, Array]:
    """Bounds (12,) of a displacement of a state that the model still resolves, and that frames at times (n,) can tell. Frames of
    one instant leave velocities open, and a step along them may be of any length.

    Frames do not tell whether the die makes another MOST_TURNS between them, and it does not fly as far as MOST_MOVED_M. In a
    throw from 14 km above the table with 3e9 rad/s a corner may touch at billions of instants: one such trial step of a fit took
    more than an hour."""
    high = np.full(12, np.inf)
    for first, name in ((0, "position_m"), (6, "velocity_m_s"), (9, "omega_rad_s")):
        largest = float(np.abs(getattr(state, name)).max())
        high[first : first + 3] = LARGEST_DISPLACEMENT * (MAX_STATE_COMPONENT[name] - largest)
    intervals_s = np.diff(np.unique(times_s))
    if len(intervals_s):
        interval_s = float(np.median(intervals_s))
        high[:3] = np.minimum(high[:3], MOST_AWAY_M)
        high[6:9] = np.minimum(high[6:9], MOST_MOVED_M / interval_s)
        high[9:] = np.minimum(high[9:], 2.0 * np.pi * MOST_TURNS / interval_s)
    return -high, high


def refitted(start: Trajectory, k2: float, *, tolerance: float = COST_TOLERANCE) -> Trajectory:
    """A trajectory fitted again to its own frames, through its own vertices."""
    return fit_trajectory(start.observations, start, start.vertices, k2, tolerance=tolerance)


def refitted_with(
    trajectory: Trajectory, physics: Physics, k2: float, *, tolerance: float = COST_TOLERANCE
) -> Trajectory:
    """A trajectory fitted again to its own frames with other physics."""
    return refitted(with_physics(trajectory, physics, k2), k2, tolerance=tolerance)


def weighted_as_inflated(trajectory: Trajectory, k2: float) -> Trajectory:
    """The trajectory with the prior of shared errors as it counts where `errors.scale` multiplies the covariance of everything
    else: fitted again. Unchanged where frames share no error."""
    if trajectory.observations.shared is None:
        return trajectory
    weighted = replace(trajectory.observations, shared_weight=trajectory.errors.scale)
    return fit_trajectory(weighted, trajectory, trajectory.vertices, k2)


def if_known_exactly(trajectory: Trajectory, k2: float) -> Trajectory:
    """The trajectory with the information that its frames would have if cameras, die and clock were exact."""
    exact = replace(trajectory.observations, shared=None)
    return with_physics(replace(trajectory, observations=exact), trajectory.physics, k2)


def inflated_covariance(trajectory: Trajectory, k2: float) -> Array:
    """(12 + k, 12 + k) of state and free parameters, with the variance and the correlation that the residuals show, and with what
    the frames share; in no direction less than by the stated errors of the frames.

    A frame pulls by ψ(r) Jᵀ, which the loss bounds; what the frames share pulls as its prior is wide.
    """
    found, covariance = linearised(trajectory, k2), trajectory.covariance
    size = np.linalg.norm(found.of_frames, axis=1)
    # A frame beyond the threshold pulls as one at the threshold does.
    usual = np.sqrt(trajectory.errors.model.variance.sum())
    weight = np.where(size > np.sqrt(k2), np.maximum(1.0, np.sqrt(k2) / usual), 1.0)
    gains = weight[:, None, None] * (found.by_frames @ covariance)
    frames = trajectory.errors.variance_of(gains, trajectory.observations.time_s, trajectory.observations.flight)
    shared = found.by_prior @ covariance
    return not_below(frames + trajectory.observations.shared_weight * shared.T @ shared, trajectory.root)


def _evaluated(
    observations: FlightObservations, start: Trajectory, x: Array, vertices: tuple[int, ...], k2: float
) -> tuple[FrameResiduals, Propagation]:
    """The residuals of the frames with their derivative by 12 + k unknowns at the displaced start, and the throw."""
    state, physics = perturbed(start.state, x[:12]), start.physics.moved(x[12:])
    modelled = model_poses(physics, state, observations.time_s, vertices)
    errors = pose_errors(observations, modelled.positions_m, modelled.quaternions)
    jacobian = whitened_jacobian(observations, errors, modelled.jacobian)
    found = without_shared_errors(observations, whitened(observations, errors), jacobian, k2)
    return found, modelled.propagation


def linearised(trajectory: Trajectory, k2: float) -> FrameResiduals:
    """The residuals of a trajectory and their derivative by its 12 + k unknowns."""
    here = np.zeros(12 + len(trajectory.physics.free))
    return _evaluated(trajectory.observations, trajectory, here, trajectory.vertices, k2)[0]


def with_physics(trajectory: Trajectory, physics: Physics, k2: float) -> Trajectory:
    """The same throw with other free parameters, and the information that its frames have on them."""
    return linearised_with(trajectory, physics, k2)[0]


def linearised_with(trajectory: Trajectory, physics: Physics, k2: float) -> tuple[Trajectory, Array, Array]:
    """`with_physics`, and the residuals (n, 6) of the robust loss with their derivative (n, 6, 12 + k)."""
    found = linearised(replace(trajectory, physics=physics), k2)
    scaled, slopes = huber(found.of_frames, found.by_frames, k2)
    root = _information_root(slopes, found.by_prior, physics)
    fitted = replace(trajectory, physics=physics, residuals=found.of_frames, root=root, shared=found.of_prior)
    return fitted, scaled, slopes


def _information_root(by_frames: Array, by_prior: Array, physics: Physics) -> Array:
    """Upper triangular T (12 + k, 12 + k) with Tᵀ T = Jᵀ J, of J (n, 6, 12 + k) of the frames and (m, 12 + k) of the prior; first
    scales where J has no information."""
    root = triangular_factor(np.concatenate([by_frames.reshape(-1, by_frames.shape[2]), by_prior]))
    for k, name in enumerate(physics.free, start=12):
        smallest = 1.0 / first_sigma(physics, name)
        if root[k, k] < _NO_INFORMATION * smallest:
            root[k, k] = smallest
    return root


def first_sigma(physics: Physics, name: str) -> float:
    """Scale of the first steps of a parameter."""
    low, high = physics.bounds(name)
    return FIRST_SIGMA.get(name, _FIRST_SHARE * (high - low))


def first_flight_trajectory(free: FreeFlights, first: int, physics: Physics) -> Trajectory:
    """The trajectory of the first flight alone, without information on the parameters."""
    fitted = free.flights[first]
    assert fitted is not None
    flight = fitted.flight
    assert flight.covariance is not None
    own = free.observations.where(free.observations.flight == first)
    errors = pose_errors(own, *flight.poses(own.time_s))
    # The Cholesky factor of the inverse correlation matrix: metres and radians would spoil that of the covariance.
    sigma = np.sqrt(np.diag(flight.covariance))
    correlation = flight.covariance / np.outer(sigma, sigma)
    root = np.diag([*np.zeros(12), *(1.0 / first_sigma(physics, name) for name in physics.free)])
    root[:12, :12] = triangular_factor(np.linalg.cholesky(np.linalg.inv(correlation)).T / sigma)
    propagation = model_poses(physics, flight.start, own.time_s, ()).propagation
    return Trajectory(flight.start, physics, (), first, own, whitened(own, errors), root, propagation)


def clear_of_impacts(trajectory: Trajectory) -> NDArray[np.bool_]:
    """Frames (n,) of a trajectory that lie at least half a frame interval from each of its impacts."""
    instants = trajectory.propagation.impact_times_s
    if not len(instants):
        return np.ones(len(trajectory.observations), bool)
    clock = trajectory.physics.clock
    away = np.abs(clock * trajectory.observations.time_s[:, None] - instants).min(1)
    return np.asarray(away >= _CLEARANCE_FRAMES * trajectory.observations.interval_s)


def mean_squares(trajectory: Trajectory) -> dict[int, float]:
    """Mean squares of the whitened residuals, by flight."""
    flight = trajectory.observations.flight
    return {int(k): float((trajectory.residuals[flight == k] ** 2).mean()) for k in np.unique(flight)}
