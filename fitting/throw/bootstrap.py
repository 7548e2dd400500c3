"""Bootstrap intervals: the fit is repeated on tracks made from its residuals (sieve bootstrap, Bühlmann, Bernoulli 3, 123, 1997).

The residuals are whitened by the error model that they show (`estimation.residual_errors`), drawn with replacement frame by
frame, and correlated again. Nothing is assumed about the distribution of the errors, and no block of frames cuts their
correlation. The cost is one fit a draw; the method serves to check the other intervals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import quat_from_rotvec, quat_multiply
from ..estimation import FlightObservations
from .physics import model_poses
from .shooting import Trajectory, fit_trajectory

Array = NDArray[np.float64]

DRAWS = 200
"""Repeated fits: they place the ends of an interval to a tenth of its width."""


def bootstrap_intervals(
    trajectory: Trajectory, k2: float, *, level: float = 0.95, draws: int = DRAWS, seed: int = 0
) -> dict[str, tuple[float, float]]:
    """Interval of every free parameter from the percentiles of repeated fits; `k2` as in `least_squares.huber`."""
    rng = np.random.default_rng(seed)
    frames, errors = trajectory.observations, trajectory.errors
    innovations = errors.innovations(trajectory.residuals, frames.time_s, frames.flight)
    # A fit leaves residuals a little smaller than the errors were; a law that misses leaves them larger.
    innovations *= np.sqrt(errors.misfit) / np.maximum(np.sqrt((innovations**2).mean(0)), np.finfo(float).tiny)
    found = []
    for _ in range(draws):
        drawn = innovations[rng.integers(len(innovations), size=len(innovations))]
        redrawn = _redrawn(trajectory, errors.errors_of(drawn, frames.time_s, frames.flight), rng)
        again = fit_trajectory(redrawn, trajectory, trajectory.vertices, k2)
        found.append([again.physics.values[name] for name in trajectory.physics.free])
    tails = 50.0 * (1.0 - level)
    low, high = np.percentile(found, [tails, 100.0 - tails], axis=0)
    return {name: (float(low[k]), float(high[k])) for k, name in enumerate(trajectory.physics.free)}


def _redrawn(trajectory: Trajectory, whitened: Array, rng: np.random.Generator) -> FlightObservations:
    """The frames of a trajectory with these whitened errors (n, 6), and with shared errors drawn from what is known of them."""
    errors = np.linalg.solve(trajectory.observations.whitener, whitened[:, :, None])[:, :, 0]
    shared = trajectory.observations.shared
    if shared is not None:
        errors = errors + shared.jacobian @ rng.standard_normal(len(shared.sources))
        shared = replace(shared, subtracted=np.zeros(len(shared.sources)))
    modelled = model_poses(trajectory.physics, trajectory.state, trajectory.observations.time_s, trajectory.vertices)
    turned = quat_multiply(quat_from_rotvec(errors[:, 3:]), modelled.quaternions)
    return replace(
        trajectory.observations, position_m=modelled.positions_m + errors[:, :3], quaternion=turned, shared=shared
    )
