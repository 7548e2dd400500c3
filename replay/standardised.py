"""Residuals in units of their own standard errors, component by component."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.rotations import rotation_between
from ..tracking.track import Track

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Standardised:
    """Measured minus simulated on the frames where both poses and the measured one's covariance are known."""

    time_s: Array
    """(n,)."""
    position: Array
    """(n, 3) world axes, each over the square root of its variance."""
    turn: Array
    """(n, 3) of the rotation vector that takes the simulated to the measured orientation, likewise."""


def standardised(track: Track, simulated: Track) -> Standardised:
    """Every component over its own standard error. `Residuals.sigmas` knows their correlations, and has no sign."""
    variances = np.einsum("kii->ki", track.covariance)
    known = track.tracked & np.isfinite(variances).all(1) & (variances > 0.0).all(1)
    _, mine, theirs = np.intersect1d(track.frame[known], simulated.frame[simulated.tracked], return_indices=True)
    mine, theirs = np.flatnonzero(known)[mine], np.flatnonzero(simulated.tracked)[theirs]
    shift = track.position_m[mine] - simulated.position_m[theirs]
    turn = rotation_between(simulated.quaternion[theirs], track.quaternion[mine])
    sigmas = np.sqrt(variances[mine])
    return Standardised(track.time_s[mine], shift / sigmas[:, :3], turn / sigmas[:, 3:])
