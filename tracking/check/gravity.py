"""Whether the die falls as things fall: a check of scale, clock and camera at once.

A single camera cannot tell a small die near by from a large one far away, and a track of the wrong size looks as sure of
itself as one of the right size. But its fall is as wrong as its scale: with an edge of k times the true one the die falls
with k g, and with a frame rate of k times the true one, with k² g. A camera that is tilted makes it fall sideways.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.throw import Throw
from ...model.world import GRAVITY_M_S2
from ..throw import frames_in_flight
from ..track import Track

Array = NDArray[np.float64]

FEWEST = 8
"""Frames of a flight that say anything of its curvature."""
CLEARLY = 0.05
"""Share of g by which a fall must be off to be spoken of: calibrated cameras and measured edges are a few times nearer."""
SIGMAS = 8.0
"""And this many times its own uncertainty, which takes the frames' errors for independent: neighbours err alike along the
line of sight, and short flights without a fault come to 4."""
MEDIAN_CHI2_3 = 2.366
"""Median of the sum of three squared standard normal numbers."""
HUBER = 2.5
"""Sigmas from which a frame counts less."""


@dataclass(frozen=True, eq=False)
class Fall:
    """The acceleration of the die in its flights, with nothing assumed of it."""

    acceleration_m_s2: Array
    """(3,) world axes; gravity is (0, 0, -9.81)."""
    covariance: Array
    """(3, 3) [m²/s⁴], with the scatter of the frames about the parabolas where that is larger than they state."""


def measure_fall(track: Track, throw: Throw) -> Fall | None:
    """The acceleration common to all flights of a throw, from poses of single frames; None where they are too short."""
    track = frames_in_flight(track, throw)
    ends = [-np.inf, *(impact.time_s for impact in throw.impacts), np.inf]
    information, pull = np.zeros((3, 3)), np.zeros(3)
    for begins_s, ends_s in itertools.pairwise(ends):
        use = np.flatnonzero(track.tracked & (track.time_s > begins_s) & (track.time_s < ends_s))
        if len(use) < FEWEST:
            continue
        acceleration, covariance = _curvature(track.time_s[use], track.position_m[use], track.covariance[use, :3, :3])
        weight = np.linalg.inv(covariance)
        information, pull = information + weight, pull + weight @ acceleration
    if not information.any():
        return None
    common = np.asarray(np.linalg.inv(information), np.float64)
    return Fall(common @ pull, common)


def fall_notices(fall: Fall | None) -> tuple[str, ...]:
    """A sentence where the die clearly falls otherwise than by gravity, and what would put it right."""
    if fall is None:
        return ()
    miss = fall.acceleration_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2])
    size = float(np.linalg.norm(miss))
    sigma = float(np.sqrt(miss @ fall.covariance @ miss)) / size if size > 0 else np.inf
    if size < max(CLEARLY * GRAVITY_M_S2, SIGMAS * sigma):
        return ()
    down, aside = -float(fall.acceleration_m_s2[2]), float(np.linalg.norm(fall.acceleration_m_s2[:2]))
    told = (
        f"The die falls with {down:.3g} m/s² and drifts aside with {aside:.2g} m/s², where gravity alone is 9.81 and 0"
    )
    if down <= 0 or aside > 0.5 * abs(down - GRAVITY_M_S2):
        return (f"{told}: the rotation of [camera], or [die], is not that of this clip.",)
    share = GRAVITY_M_S2 / down
    return (
        f"{told}: with die.edge_m {share:.3g} times, or clip.fps {np.sqrt(share):.3g} times what the scene says, "
        "it would fall right; or [camera] is not that of this clip.",
    )


def _curvature(time_s: Array, position_m: Array, covariance: Array) -> tuple[Array, Array]:
    """Acceleration (3,) of the parabola through positions (n, 3), with its covariance.

    Weighted least squares with Huber weights: a few frames of a wrong pose must not bend it.
    """
    t = time_s - time_s.mean()
    span = float(np.abs(t).max())
    basis = np.stack([np.ones_like(t), t / span, 0.5 * (t / span) ** 2], 1)
    rows = np.einsum("kb,ij->kibj", basis, np.eye(3)).reshape(len(t), 3, 9)
    weights = np.linalg.inv(covariance)
    robust = np.ones(len(t))
    for _ in range(10):
        scaled = robust[:, None, None] * weights
        information = np.einsum("kia,kij,kjb->ab", rows, scaled, rows)
        values = np.linalg.solve(information, np.einsum("kia,kij,kj->a", rows, scaled, position_m))
        left = position_m - rows @ values
        squared = np.einsum("ki,kij,kj->k", left, weights, left)
        usual = max(1.0, float(np.median(squared)) / MEDIAN_CHI2_3)
        robust = np.minimum(1.0, HUBER / np.sqrt(np.maximum(squared / usual, 1e-12)))
    return values[6:] / span**2, usual * np.linalg.inv(information)[6:, 6:] / span**4
