"""The track smoothed by exact motion: within a flight, a parabola and a constant spin; never across a bounce."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..model.motion import Throw
from ..model.rotations import continuous_sign
from .flights import transition
from .track import LOST, TRACKED, Track

Array = NDArray[np.float64]

SURE_POSITION_M, SURE_ROTATION_RAD = 5e-4, 0.035
"""A frame without a pose of its own, inside a flight, counts as tracked where the flight knows it this well (one sigma)."""


def smooth(track: Track, throw: Throw, floor: Array | None = None) -> Track:
    """The track with every pose replaced by that of its flight, with the flight's covariance and, on top of it, that of
    what the poses err alike: `floor` (n, 6, 6), which is then not in the throw's (`bounces.Measured.own`).

    Lost frames between tracked frames of one flight become tracked where the flight knows the pose well; frames before
    the first and after the last tracked one, and frames that were absent, stay as they are. Errors of neighbouring
    frames are now correlated: a fit wants the track of single frames.
    """
    tracked = np.flatnonzero(track.tracked)
    if len(tracked) == 0:
        return track
    position, quaternion = track.position_m.copy(), track.quaternion.copy()
    covariance, status = track.covariance.copy(), track.status.copy()
    flight_of = np.array([throw.flight_at(float(t)) for t in track.time_s])
    for k in range(int(tracked[0]), int(tracked[-1]) + 1):
        if status[k] not in (TRACKED, LOST):
            continue
        flight = throw.flights[flight_of[k]]
        if flight.covariance is None:
            continue
        M = transition(flight, float(track.time_s[k]))
        pose = (M @ flight.covariance @ M.T)[:6, :6]
        if floor is not None:
            pose = pose + floor[k]
        p, q = flight.poses(track.time_s[k : k + 1])
        if status[k] == LOST:
            alone = not np.any(track.tracked & (flight_of == flight_of[k]))
            sigma = np.sqrt(np.diag(pose))
            if alone or sigma[:3].max() > SURE_POSITION_M or sigma[3:].max() > SURE_ROTATION_RAD:
                continue
        position[k], quaternion[k], covariance[k], status[k] = p[0], q[0], (pose + pose.T) / 2.0, TRACKED
    return replace(
        track, position_m=position, quaternion=continuous_sign(quaternion), covariance=covariance, status=status
    )
