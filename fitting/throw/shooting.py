"""One throw of the model fitted to frames, its impacts at prescribed vertices.

Which vertices touch is not left to the model while it is fitted: then the poses are a smooth function of the start and
of the parameters, with exact derivatives (`physics.course`). The unknowns are measured by the information of the shot
before (`descent`), and the loss is one that bad frames cannot bend (`robust`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ...model.throw import Propagation, State, Throw
from ..estimation import (
    ENOUGH,
    Sightings,
    descend,
    huber,
    pose_errors,
    triangle,
    variance_inflation,
    whitened,
    whitened_jacobian,
)
from ..free import FreeFlights, left_jacobian, moved_state
from .physics import Physics, course

Array = NDArray[np.float64]

FIRST_SIGMA = {"chi": 0.3, "mu": 0.2, "chi_fade_s_per_m": 0.2}
"""Scale of the first steps of a parameter that no frame has told of; it has no weight in a fit. Others: a tenth of what
their bounds allow."""

_HOPELESS = 2.0
"""k² a frame: a cost above which a shot is no fit. One that counts as explained (`lengthening.MISFIT`) costs less."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A throw, the frames it was fitted to, and how well they fix it."""

    state: State
    physics: Physics
    vertices: tuple[int, ...]
    reached: int
    """The last measured flight whose frames are in the fit."""
    sightings: Sightings
    residuals: Array
    """(n, 6) whitened."""
    root: Array
    """(12 + k, 12 + k) upper triangular T, Tᵀ T the information on state and free parameters."""
    way: Propagation
    """The throw, on the true clock."""

    @property
    def throw(self) -> Throw:
        """The throw, on the true clock."""
        return self.way.throw

    @property
    def mean_square(self) -> float:
        """Of the whitened residuals."""
        return float((self.residuals**2).mean())

    @property
    def inflation(self) -> tuple[float, float]:
        """By how much its covariance is scaled for what the residuals show: s² and τ (`intervals`)."""
        return variance_inflation(self.residuals, self.residuals.size - len(self.root), self.sightings.flight)

    @property
    def covariance(self) -> Array:
        """(12 + k, 12 + k) of state and free parameters, by the stated errors of the frames: (Tᵀ T)⁻¹."""
        inverse = solve_triangular(self.root, np.eye(len(self.root)))
        return np.asarray(inverse @ inverse.T, dtype=np.float64)

    @property
    def rounding(self) -> float:
        """Sigmas by which rounding of the start and of the parameters to doubles moves the frames, at most."""
        state = (self.state.position_m, np.ones(3), self.state.velocity_m_s, self.state.omega_rad_s)
        values = [self.physics.values[name] for name in self.physics.free]
        return float(np.finfo(float).eps * np.linalg.norm(self.root * np.concatenate([*state, values]), axis=0).max())

    def cost(self, k2: float) -> float:
        """Σ ρ over the frames; `k2` as in `robust.huber`."""
        scaled, _ = huber(self.residuals, np.empty((len(self.residuals), 6, 0)), k2)
        return float((scaled**2).sum())


def shoot(sightings: Sightings, start: Shot, vertices: tuple[int, ...], k2: float, *, enough: float = ENOUGH) -> Shot:
    """The throw through `vertices` nearest to the frames, started from another shot. `k2` as in `robust.huber`, `enough`
    as in `descent.descend`."""
    physics = start.physics
    names = physics.free
    reach = np.array([[bound - physics.values[name] for bound in physics.bounds(name)] for name in names])
    low, high = np.full(12 + len(names), -np.inf), np.full(12 + len(names), np.inf)
    low[12:], high[12:] = reach.reshape(-1, 2).T

    def evaluate(x: Array) -> tuple[Array, Array]:
        residuals, jacobian, _ = _seen_from(sightings, start, x, vertices)
        # Counted from the start's orientation, not from where it has led.
        jacobian[:, :, 3:6] = jacobian[:, :, 3:6] @ left_jacobian(x[3:6])
        residuals, jacobian = huber(residuals, jacobian, k2)
        return residuals.ravel(), jacobian.reshape(-1, jacobian.shape[2])

    x = descend(evaluate, start.root, low, high, enough=enough, hopeless=_HOPELESS * k2 * len(sightings))
    residuals, jacobian, way = _seen_from(sightings, start, x, vertices)
    _, scaled = huber(residuals, jacobian, k2)
    return replace(
        start,
        state=moved_state(start.state, x[:12]),
        physics=physics.moved(x[12:]),
        vertices=vertices,
        sightings=sightings,
        residuals=residuals,
        root=root_of(scaled.reshape(-1, scaled.shape[2]), physics),
        way=way,
    )


def _seen_from(
    sightings: Sightings, start: Shot, x: Array, vertices: tuple[int, ...]
) -> tuple[Array, Array, Propagation]:
    """Whitened residuals (n, 6), their derivative (n, 6, 12 + k) at the displaced start, and the throw."""
    way = course(start.physics.moved(x[12:]), moved_state(start.state, x[:12]), sightings.time_s, vertices)
    errors = pose_errors(sightings, way.positions_m, way.quaternions)
    return whitened(sightings, errors), whitened_jacobian(sightings, errors, way.jacobian), way.way


def linear(shot: Shot) -> tuple[Array, Array]:
    """Whitened residuals (n, 6) of a shot and their derivative (n, 6, 12 + k)."""
    residuals, jacobian, _ = _seen_from(shot.sightings, shot, np.zeros(12 + len(shot.physics.free)), shot.vertices)
    return residuals, jacobian


def with_physics(shot: Shot, physics: Physics, k2: float) -> Shot:
    """The same throw with other parameters free, and the information that its frames have on them."""
    return widened(shot, physics, k2)[0]


def widened(shot: Shot, physics: Physics, k2: float) -> tuple[Shot, Array, Array]:
    """`with_physics`, and the residuals (n, 6) of the robust loss with their derivative (n, 6, 12 + k)."""
    residuals, jacobian = linear(replace(shot, physics=physics))
    scaled, slopes = huber(residuals, jacobian, k2)
    root = root_of(slopes.reshape(-1, slopes.shape[2]), physics)
    return replace(shot, physics=physics, residuals=residuals, root=root), scaled, slopes


def root_of(jacobian: Array, physics: Physics) -> Array:
    """Upper triangular T with a positive diagonal and Tᵀ T = Jᵀ J; parameters that move nothing get their first scale."""
    root = triangle(jacobian)
    for k, name in enumerate(physics.free, start=12):
        smallest = 1.0 / first_sigma(physics, name)
        if root[k, k] < 1e-6 * smallest:
            root[k, k] = smallest
    return root


def first_sigma(physics: Physics, name: str) -> float:
    """Scale of the first steps of a parameter."""
    low, high = physics.bounds(name)
    return FIRST_SIGMA.get(name, 0.1 * (high - low))


def opening(free: FreeFlights, first: int, physics: Physics) -> Shot:
    """The first flight alone, as a shot that knows nothing of the parameters."""
    fitted = free.flights[first]
    assert fitted is not None
    flight = fitted.flight
    assert flight.covariance is not None
    own = free.sightings.where(free.sightings.flight == first)
    errors = pose_errors(own, *flight.poses(own.time_s))
    sigma = np.sqrt(np.diag(flight.covariance))
    correlation = flight.covariance / np.outer(sigma, sigma)
    root = np.diag([*np.zeros(12), *(1.0 / first_sigma(physics, name) for name in physics.free)])
    root[:12, :12] = triangle(np.linalg.cholesky(np.linalg.inv(correlation)).T / sigma)
    way = course(physics, flight.start, own.time_s, ()).way
    return Shot(flight.start, physics, (), first, own, whitened(own, errors), root, way)


def clear_of_impacts(shot: Shot) -> NDArray[np.bool_]:
    """Frames (n,) of a shot at least half an interval from each of its impacts; see `sightings`."""
    instants = shot.way.impact_times_s
    if not len(instants):
        return np.ones(len(shot.sightings), bool)
    clock = shot.physics.clock
    away = np.abs(clock * shot.sightings.time_s[:, None] - instants).min(1)
    return np.asarray(away >= 0.5 * shot.sightings.interval_s)


def mean_squares(shot: Shot) -> dict[int, float]:
    """Of the whitened residuals, flight by flight."""
    flight = shot.sightings.flight
    return {int(k): float((shot.residuals[flight == k] ** 2).mean()) for k in np.unique(flight)}
