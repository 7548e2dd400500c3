"""The track smoothed by exact motion: a parabola and a constant spin within each flight, never across an impact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import continuous_sign
from ...model.throw import Throw
from ..flights import pose_jacobian
from ..track import LOST, TRACKED, Track

Array = NDArray[np.float64]

KNOWN_POSITION_M = 5e-4
"""Largest standard deviation [m] of a position that a flight may supply for a lost frame."""
KNOWN_ROTATION_RAD = 0.035
"""Largest standard deviation [rad] of an orientation that a flight may supply for a lost frame."""


def smooth(
    track: Track, throw: Throw, shared_covariance: Array | None = None, excluded: NDArray[np.bool_] | None = None
) -> Track:
    """The track with every pose replaced by that of its flight, and with the flight's covariance.

    `shared_covariance` (n, 6, 6) is added to that covariance: errors common to all frames, which the throw must then not
    contain (`MeasuredThrow.throw_without_shared_errors`). `excluded` frames (n,) keep their own poses: no flight passes through
    them (`MeasuredThrow.unexplained`).

    Lost frames between tracked frames of one flight, of which neither is excluded, become tracked if the flight determines
    their pose (KNOWN_POSITION_M, KNOWN_ROTATION_RAD). Other lost frames, and absent ones, stay as they are. Errors of
    neighbouring frames are correlated afterwards: a fit needs the track of single frames instead.
    """
    tracked = np.flatnonzero(track.tracked)
    if len(tracked) == 0:
        return track
    position, quaternion = track.position_m.copy(), track.quaternion.copy()
    covariance, status = track.covariance.copy(), track.status.copy()
    rows = np.arange(int(tracked[0]), int(tracked[-1]) + 1)
    flight_of = throw.flights_at(track.time_s[rows])
    candidate = np.isin(status[rows], (TRACKED, LOST))
    if excluded is not None:
        candidate &= ~excluded[rows]
    for k in np.unique(flight_of):
        flight, own_rows = throw.flights[k], rows[candidate & (flight_of == k)]
        if flight.covariance is None or not len(own_rows):
            continue
        M = pose_jacobian(flight, track.time_s[own_rows])
        poses = M @ flight.covariance @ np.swapaxes(M, 1, 2)
        if shared_covariance is not None:
            poses += shared_covariance[own_rows]
        sigma = np.sqrt(np.diagonal(poses, axis1=1, axis2=2))
        unknown = (sigma[:, :3].max(1) > KNOWN_POSITION_M) | (sigma[:, 3:].max(1) > KNOWN_ROTATION_RAD)
        is_tracked = status[own_rows] == TRACKED
        shown = own_rows[is_tracked]
        if not len(shown):
            continue
        use = is_tracked | (~unknown & (own_rows > shown[0]) & (own_rows < shown[-1]))
        put = own_rows[use]
        position[put], quaternion[put] = flight.poses(track.time_s[put])
        covariance[put], status[put] = 0.5 * (poses + np.swapaxes(poses, 1, 2))[use], TRACKED
    return replace(
        track, position_m=position, quaternion=continuous_sign(quaternion), covariance=covariance, status=status,
        pixel_covariance=None,
    )  # fmt: skip
