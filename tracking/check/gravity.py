"""Measures the acceleration of the die in flight: a check of scale, clock and camera at once.

A single camera cannot distinguish a small die near by from a large one far away, and a track at the wrong scale states the same
standard errors. Its fall shows the scale: with an edge k times the true one the die falls with k g, and with a frame rate k times
the true one with k² g. With a tilted camera it falls sideways.
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

MIN_FRAMES = 8
"""Fewest frames of a flight that determine its curvature."""
MIN_DEVIATION = 0.05
"""Share of g by which a fall must be off for a notice: calibrated cameras and measured edges are off by a few times less."""
MIN_DEVIATION_SIGMAS = 8.0
"""The same in standard errors. These take the frames' errors as independent, but neighbours have correlated errors along the line
of sight, and short flights without a fault reach 4."""
MAX_ASIDE_SHARE = 0.5
"""Of the error of the vertical acceleration: with a larger horizontal one, no scale or rate explains the fall."""
MEDIAN_CHI2_3 = 2.366
"""Median of chi-square with three degrees of freedom."""
HUBER_SIGMAS = 2.5
"""Residual in sigmas from which a frame counts less."""
HUBER_STEPS = 10
"""Reweighted solutions; the weights of a parabola hardly change after five."""
MIN_SQUARED_RESIDUAL = 1e-12
"""In squared sigmas; avoids a division by zero where a frame lies on the parabola."""


@dataclass(frozen=True, eq=False)
class Fall:
    """The acceleration of the die in its flights, with nothing assumed about it."""

    acceleration_m_s2: Array
    """(3,) world axes."""
    covariance: Array
    """(3, 3) [m²/s⁴], scaled by the residuals of the frames where these are larger than the frames' covariances state."""
    gravity_m_s2: float = GRAVITY_M_S2
    """Of the place, as the scene states it."""


def measure_fall(track: Track, throw: Throw) -> Fall | None:
    """The acceleration common to all flights of a throw, from poses of single frames; None where they are too short."""
    track = frames_in_flight(track, throw)
    ends = [-np.inf, *(impact.time_s for impact in throw.impacts), np.inf]
    information, weighted_sum = np.zeros((3, 3)), np.zeros(3)
    for begins_s, ends_s in itertools.pairwise(ends):
        use = np.flatnonzero(track.tracked & (track.time_s > begins_s) & (track.time_s < ends_s))
        if len(use) < MIN_FRAMES:
            continue
        acceleration, covariance = _curvature(track.time_s[use], track.position_m[use], track.covariance[use, :3, :3])
        weight = np.linalg.inv(covariance)
        information, weighted_sum = information + weight, weighted_sum + weight @ acceleration
    if not information.any():
        return None
    common = np.asarray(np.linalg.inv(information), np.float64)
    return Fall(common @ weighted_sum, common, track.gravity_m_s2)


def fall_notices(fall: Fall | None) -> tuple[str, ...]:
    """A notice where the acceleration clearly differs from gravity, with what would correct it."""
    if fall is None:
        return ()
    deviation = fall.acceleration_m_s2 + np.array([0.0, 0.0, fall.gravity_m_s2])
    size = float(np.linalg.norm(deviation))
    sigma = float(np.sqrt(deviation @ fall.covariance @ deviation)) / size if size > 0 else np.inf
    if size < max(MIN_DEVIATION * fall.gravity_m_s2, MIN_DEVIATION_SIGMAS * sigma):
        return ()
    down, aside = -float(fall.acceleration_m_s2[2]), float(np.linalg.norm(fall.acceleration_m_s2[:2]))
    measured = (
        f"The die accelerates downwards with {down:.3g} m/s² and sideways with {aside:.2g}, and gravity is "
        f"{fall.gravity_m_s2:g} and 0"
    )
    if down <= 0 or aside > MAX_ASIDE_SHARE * abs(down - fall.gravity_m_s2):
        return (
            f"{measured}: calibrate again, or correct [die]; the rotation of [camera] may not be that of this clip.",
        )
    share = fall.gravity_m_s2 / down
    return (
        f"{measured}: multiply the lengths of [die] by {share:.3g} or clip.fps by {np.sqrt(share):.3g} if one of them is wrong; "
        "else calibrate again, [camera] may not be that of this clip.",
    )


def _curvature(time_s: Array, position_m: Array, covariance: Array) -> tuple[Array, Array]:
    """Acceleration (3,) of the parabola through positions (n, 3), with its covariance.

    Weighted least squares with Huber weights, so that a few wrong poses do not bend it.
    """
    t = time_s - time_s.mean()
    span = float(np.abs(t).max())
    basis = np.stack([np.ones_like(t), t / span, 0.5 * (t / span) ** 2], 1)
    rows = np.einsum("kb,ij->kibj", basis, np.eye(3)).reshape(len(t), 3, 9)
    weights = np.linalg.inv(covariance)
    robust = np.ones(len(t))
    for _ in range(HUBER_STEPS):
        scaled = robust[:, None, None] * weights
        information = np.einsum("kia,kij,kjb->ab", rows, scaled, rows)
        values = np.linalg.solve(information, np.einsum("kia,kij,kj->a", rows, scaled, position_m))
        residuals = position_m - rows @ values
        squared = np.einsum("ki,kij,kj->k", residuals, weights, residuals)
        usual = max(1.0, float(np.median(squared)) / MEDIAN_CHI2_3)
        robust = np.minimum(1.0, HUBER_SIGMAS / np.sqrt(np.maximum(squared / usual, MIN_SQUARED_RESIDUAL)))
    return values[6:] / span**2, usual * np.linalg.inv(information)[6:, 6:] / span**4
