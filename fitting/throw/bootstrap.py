"""Intervals by doing it again: the residuals of a fit, drawn anew in blocks, make tracks that the fit is repeated on.

Blocks of neighbouring frames of one flight keep what errors of neighbours have in common (Künsch, Ann. Stat. 17, 1217,
1989); nothing is assumed of their distribution. It costs a fit a draw, and serves to check the other intervals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import quat_from_rotvec, quat_multiply
from ..estimation import Sightings, correlation_length
from .physics import course
from .shooting import Shot, shoot

Array = NDArray[np.float64]

DRAWS = 200


def bootstrap_intervals(
    shot: Shot, k2: float, *, level: float = 0.95, draws: int = DRAWS, seed: int = 0
) -> dict[str, tuple[float, float]]:
    """Interval of every free parameter from the percentiles of repeated fits; `k2` as in `robust.huber`."""
    rng = np.random.default_rng(seed)
    freedom = shot.residuals.size - len(shot.root)
    # A fit leaves residuals a little smaller than the errors were.
    residuals = shot.residuals * np.sqrt(shot.residuals.size / max(freedom, 1))
    length = int(np.ceil(correlation_length(shot.residuals, shot.sightings.flight)))
    found = []
    for _ in range(draws):
        again = shoot(_drawn(shot, residuals, 2 * length, rng), shot, shot.vertices, k2)
        found.append([again.physics.values[name] for name in shot.physics.free])
    tails = 50.0 * (1.0 - level)
    low, high = np.percentile(found, [tails, 100.0 - tails], axis=0)
    return {name: (float(low[k]), float(high[k])) for k, name in enumerate(shot.physics.free)}


def _drawn(shot: Shot, residuals: Array, length: int, rng: np.random.Generator) -> Sightings:
    """The frames of a shot with errors drawn from the residuals, in blocks of so many frames."""
    n = len(residuals)
    first = rng.integers(0, n, size=n // length + 1)
    rows = ((first[:, None] + np.arange(length)) % n).ravel()[:n]
    errors = np.linalg.solve(shot.sightings.whitener, residuals[rows][:, :, None])[:, :, 0]
    way = course(shot.physics, shot.state, shot.sightings.time_s, shot.vertices)
    turned = quat_multiply(quat_from_rotvec(errors[:, 3:]), way.quaternions)
    return replace(shot.sightings, position_m=way.positions_m + errors[:, :3], quaternion=turned)
