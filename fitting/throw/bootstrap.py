"""Bootstrap intervals: the fit is repeated on tracks made from its residuals, redrawn in blocks.

Blocks of neighbouring frames of one flight keep the correlation of their errors (Künsch, Ann. Stat. 17, 1217, 1989).
Nothing is assumed about the distribution of the errors. The cost is one fit a draw; the method serves to check the
other intervals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import quat_from_rotvec, quat_multiply
from ..estimation import FlightObservations, correlation_time
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
    freedom = trajectory.residuals.size - len(trajectory.root)
    # A fit leaves residuals a little smaller than the errors were.
    residuals = trajectory.residuals * np.sqrt(trajectory.residuals.size / max(freedom, 1))
    length = int(np.ceil(correlation_time(trajectory.residuals, trajectory.observations.flight)))
    found = []
    for _ in range(draws):
        again = fit_trajectory(_redrawn(trajectory, residuals, 2 * length, rng), trajectory, trajectory.vertices, k2)
        found.append([again.physics.values[name] for name in trajectory.physics.free])
    tails = 50.0 * (1.0 - level)
    low, high = np.percentile(found, [tails, 100.0 - tails], axis=0)
    return {name: (float(low[k]), float(high[k])) for k, name in enumerate(trajectory.physics.free)}


def block_rows(flight: NDArray[np.int64], length: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Rows (n,) that frames (n,) of flights in order of time take their errors from: blocks of `length` frames, none of which
    spans two flights, neither of those that it is drawn from nor of those that it is laid on. A flight with fewer frames takes
    one block of as many."""
    n, out = len(flight), np.empty(len(flight), np.int64)
    begins = np.flatnonzero(np.diff(flight, prepend=flight[0] - 1))
    for begin, end in zip(begins, [*begins[1:], n], strict=True):
        size = min(length, int(end - begin))
        whole = np.flatnonzero(flight[: n - size + 1] == flight[size - 1 :])
        firsts = rng.choice(whole, size=-(-int(end - begin) // size))
        out[begin:end] = (firsts[:, None] + np.arange(size)).ravel()[: end - begin]
    return out


def _redrawn(trajectory: Trajectory, residuals: Array, length: int, rng: np.random.Generator) -> FlightObservations:
    """The frames of a trajectory with errors drawn from its residuals, in blocks of `length` frames, and with shared errors drawn
    from what is known of them."""
    rows = block_rows(trajectory.observations.flight, length, rng)
    errors = np.linalg.solve(trajectory.observations.whitener, residuals[rows][:, :, None])[:, :, 0]
    shared = trajectory.observations.shared
    if shared is not None:
        errors = errors + shared.jacobian @ rng.standard_normal(len(shared.sources))
        shared = replace(shared, subtracted=np.zeros(len(shared.sources)))
    modelled = model_poses(trajectory.physics, trajectory.state, trajectory.observations.time_s, trajectory.vertices)
    turned = quat_multiply(quat_from_rotvec(errors[:, 3:]), modelled.quaternions)
    return replace(
        trajectory.observations, position_m=modelled.positions_m + errors[:, :3], quaternion=turned, shared=shared
    )
