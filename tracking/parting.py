"""Where a track is parted into flights.

Wherever the lowest corner comes near the table, two exact motions, one before and one after, are compared with a single
one through both: the instant that gains most parts the track, and so on until no parting gains anything (recursive
binary segmentation of change points).
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from ..model.rotations import matrix_from_quat
from ..model.solids import Die
from .flights import Sightings, fit_flight

Array = NDArray[np.float64]

WINDOW = 12
"""Frames on either side of an instant that say whether the motion changes there."""
GAIN = 10.0
"""By how much, in squared sigmas for each of the twelve numbers that it adds, a second motion must explain the frames
better than one. Noise alone gives 1 ± 0.4, the mean and spread of chi-square over its twelve degrees of freedom."""
FEWEST = 3
"""Frames that measure a flight."""
TABLE_REACH = 0.35
"""A contact's lowest vertex may seem this share of an edge off the table: rounding, calibration and depth error (half a
per cent of the distance to the camera is a quarter of a die)."""


def part_flights(seen: Sightings, die: Die) -> list[NDArray[np.int64]]:
    """Rows of each flight, in order: the track parted wherever a second motion explains it better than one."""
    n = len(seen.time_s)
    low = _near_table(seen, die)
    cuts = [0, n]
    gains = np.full(n + 1, -np.inf)
    stale = np.ones(n + 1, bool)
    while True:
        for s in np.flatnonzero(stale):
            gains[s] = _gain(seen, cuts, int(s)) if low[s] else -np.inf
        stale[:] = False
        best = int(np.argmax(gains))
        if not gains[best] > GAIN:
            break
        cuts = sorted([*cuts, best])
        stale[max(0, best - WINDOW - 1) : best + WINDOW + 2] = True
    return [np.arange(a, b) for a, b in itertools.pairwise(cuts) if b - a >= FEWEST]


def _near_table(seen: Sightings, die: Die) -> NDArray[np.bool_]:
    """(n + 1,) where a cut before this row is possible: the lowest corner is near the table on a frame beside it."""
    heights = (matrix_from_quat(seen.quaternion) @ die.solid.vertices.T)[:, 2].min(1) + seen.position_m[:, 2]
    fall = np.abs(np.diff(heights, prepend=heights[0]))
    edge = die.solid.edge_m
    near = heights < TABLE_REACH * edge + 2.0 * fall
    out = np.zeros(len(heights) + 1, bool)
    out[:-1] |= near
    out[1:] |= near
    return out


def _gain(seen: Sightings, cuts: list[int], s: int) -> float:
    """Gain of a cut before row s over none, in squared sigmas for each number that it adds."""
    below = max(c for c in cuts if c <= s)
    above = min((c for c in cuts if c > s), default=s)
    a, b = np.arange(max(below, s - WINDOW), s), np.arange(s, min(above, s + WINDOW))
    if len(a) < FEWEST or len(b) < FEWEST:
        return -np.inf
    both = fit_flight(seen.rows(slice(int(a[0]), int(b[-1]) + 1)))[2]
    apart = sum(fit_flight(seen.rows(slice(int(r[0]), int(r[-1]) + 1)))[2] for r in (a, b))
    free = max(6 * (len(a) + len(b)) - 24, 6)
    return (both - apart) / 12.0 / max(apart / free, 1.0)
