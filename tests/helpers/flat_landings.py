"""Throws that land nearly flat: they strike twice within a frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from random_throws import random_quaternion

from diethrow.model.die.die import Die, make_die
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import rotation_between
from diethrow.model.throw.motion import State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.track import Track

FPS = 1500.0
FLAT_DICE = {
    "cube": make_die("cube", 0.016, 0.0048),
    "dodecahedron": make_die("dodecahedron", 0.008, 0.004),
    "icosahedron": make_die("icosahedron", 0.011, 0.004),
}
LEAST_FRAMES, MOST_FRAMES = 12.0, 40.0
"""Frames of flight before and behind the two impacts; at most, behind them."""
FIVE_SIGMAS = 43.0
"""Squared Mahalanobis distance of six numbers as improbable as five standard deviations of one."""


def flat_landings(die: Die) -> Iterator[tuple[Throw, np.random.Generator]]:
    """Throws through two impacts less than a frame apart, without end, each with a generator for its noise."""
    seed = 0
    while True:
        rng = np.random.default_rng(seed)
        seed += 1
        height_m = die.solid.circumradius + rng.uniform(0.06, 0.09)
        velocity_m_s, omega_rad_s = np.array([*rng.uniform(-0.1, 0.1, 2), -0.8]), rng.normal(scale=17.0, size=3)
        release = State(0.0, np.array([0.0, 0.0, height_m]), random_quaternion(rng), velocity_m_s, omega_rad_s)
        whole = throw_die(die, release, SmoothImpact(0.6), until=Until(impacts=3)).throw
        frames = np.array([impact.time_s for impact in whole.impacts]) * FPS
        if len(frames) < 3 or frames[0] < LEAST_FRAMES or frames[2] - frames[1] < LEAST_FRAMES:
            continue
        if 0.05 < frames[1] - frames[0] < 0.9:
            end_s = whole.impacts[1].time_s + min(frames[2] - frames[1] - 0.5, MOST_FRAMES) / FPS
            yield Throw((*whole.flights[:2], replace(whole.flights[2], end_s=end_s)), whole.impacts[:2]), rng


def off_behind(throw: Throw, track: Track) -> NDArray[np.bool_]:
    """(n,) whether the poses of a track behind the second impact of a throw are off by over five standard errors."""
    rows = np.flatnonzero(track.time_s > throw.impacts[1].time_s)
    positions_m, quaternions = throw.poses(track.time_s[rows])
    turned = rotation_between(quaternions, track.quaternion[rows])
    error = np.concatenate([track.position_m[rows] - positions_m, turned], axis=1)
    whitened = np.linalg.solve(track.covariance[rows], error[..., None])[..., 0]
    return np.asarray(np.einsum("ni,ni->n", error, whitened) > FIVE_SIGMAS)
