"""The track smoothed by exact motion: within a flight, a parabola and a constant spin; never across a bounce."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import continuous_sign
from ...model.throw import Throw
from ..track import LOST, TRACKED, Track
from .flights import pose_jacobian

Array = NDArray[np.float64]

SURE_POSITION_M, SURE_ROTATION_RAD = 5e-4, 0.035
"""A frame without a pose of its own, inside a flight, counts as tracked where the flight knows it this well (one sigma)."""


def smooth(track: Track, throw: Throw, floor: Array | None = None, alone: NDArray[np.bool_] | None = None) -> Track:
    """The track with every pose replaced by that of its flight, with the flight's covariance and, on top of it, that of
    what the poses err alike: `floor` (n, 6, 6), which is then not in the throw's (`bounces.MeasuredThrow.own`). Frames that stand
    `alone` (n,), because no flight goes through them (`bounces.MeasuredThrow.alone`), keep their own poses.

    Lost frames between tracked frames of one flight become tracked where the flight knows the pose well; frames before
    the first and after the last tracked one, and frames that were absent, stay as they are. Errors of neighbouring
    frames are now correlated: a fit wants the track of single frames.
    """
    tracked = np.flatnonzero(track.tracked)
    if len(tracked) == 0:
        return track
    position, quaternion = track.position_m.copy(), track.quaternion.copy()
    covariance, status = track.covariance.copy(), track.status.copy()
    rows = np.arange(int(tracked[0]), int(tracked[-1]) + 1)
    flight_of = throw.flights_at(track.time_s[rows])
    told = np.isin(status[rows], (TRACKED, LOST))
    if alone is not None:
        told &= ~alone[rows]
    for k in np.unique(flight_of):
        flight, mine = throw.flights[k], rows[told & (flight_of == k)]
        if flight.covariance is None or not len(mine):
            continue
        M = pose_jacobian(flight, track.time_s[mine])
        poses = M @ flight.covariance @ np.swapaxes(M, 1, 2)
        if floor is not None:
            poses += floor[mine]
        sigma = np.sqrt(np.diagonal(poses, axis1=1, axis2=2))
        unsure = (sigma[:, :3].max(1) > SURE_POSITION_M) | (sigma[:, 3:].max(1) > SURE_ROTATION_RAD)
        seen = status[mine] == TRACKED
        use = seen | ~unsure if seen.any() else seen
        put = mine[use]
        position[put], quaternion[put] = flight.poses(track.time_s[put])
        covariance[put], status[put] = 0.5 * (poses + np.swapaxes(poses, 1, 2))[use], TRACKED
    return replace(
        track, position_m=position, quaternion=continuous_sign(quaternion), covariance=covariance, status=status, own=None
    )  # fmt: skip
