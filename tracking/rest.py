"""The end of a throw: where the die no longer flies but rolls or lies on the table.

In flight the centre of the die falls with g. Once the table carries it, be it in contact that lasts or in bounces too
small to be told apart, its lowest point stays at one height and its centre falls, on the average, much more slowly. The
last frames over which both hold are no flight, and none is fitted to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.motion import GRAVITY_M_S2, Flight, State
from ..model.rotations import continuous_sign, matrix_from_quat, rotation_between
from ..model.solids import Die, inner_vertices
from .flights import Sightings
from .parting import TABLE_REACH

Array = NDArray[np.float64]

FEWEST = 12
"""Frames over which the mean acceleration of the centre is known to a fraction of g, from poses of a few hundredths of a
millimetre at some thousand frames a second."""
LEVEL_SHARE = 0.02
"""How far the lowest point may stray from its level, as a share of an edge, besides three sigmas of a frame: bounces
below that are part of coming to rest."""
HOPS = 1.5
"""A hop that strays no further than that is over in 2 √(2h/g): what lasts so many times as long is none, nor its end."""
CARRIED = 0.5
"""Share of g below which the centre does not fall freely: half-way between a die in flight and one that lies."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Carried(Flight):
    """What was seen of a die that the table carries: the poses of its frames, and straight lines between."""

    times_s: Array
    """(n,) of the frames."""
    positions_m: Array
    """(n, 3)."""
    quaternions: Array
    """(n, 4) wxyz."""

    def at(self, time_s: float) -> State:
        """The state at any instant; before the first frame and after the last the die does not move."""
        positions, quaternions = self.poses(np.array([time_s]))
        k = int(np.clip(np.searchsorted(self.times_s, time_s), 1, len(self.times_s) - 1))
        dt = float(self.times_s[k] - self.times_s[k - 1])
        inside = self.times_s[0] <= time_s <= self.times_s[-1]
        share = 1.0 / dt if inside else 0.0
        velocity = share * (self.positions_m[k] - self.positions_m[k - 1])
        omega = share * rotation_between(self.quaternions[k - 1], self.quaternions[k])
        return State(float(time_s), positions[0], quaternions[0], velocity, omega)

    def poses(self, times_s: object) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        times = np.clip(np.asarray(times_s, float), self.times_s[0], self.times_s[-1])
        signed = continuous_sign(self.quaternions)
        positions = np.stack([np.interp(times, self.times_s, column) for column in self.positions_m.T], axis=1)
        quaternions = np.stack([np.interp(times, self.times_s, column) for column in signed.T], axis=1)
        return positions, quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def carried_from(seen: Sightings, die: Die) -> int:
    """The first of the last rows over which the table carries the die; the number of rows where it flies to the end."""
    n = len(seen)
    if n < FEWEST:
        return n
    corners = matrix_from_quat(seen.quaternion) @ inner_vertices(die.solid, die.corner_radius_m).T
    heights = corners[:, 2].min(1) + seen.position_m[:, 2] - die.corner_radius_m
    level = float(np.median(heights[-FEWEST:]))
    if abs(level) > TABLE_REACH * die.solid.edge_m:
        return n
    information = np.swapaxes(seen.whitener, 1, 2) @ seen.whitener
    stray = LEVEL_SHARE * die.solid.edge_m + 3.0 * np.sqrt(np.linalg.inv(information)[:, 2, 2])
    off = np.flatnonzero(np.abs(heights - level) > stray)
    first = int(off[-1]) + 1 if len(off) else 0
    if first >= n:
        return n
    hop = 2.0 * np.sqrt(2.0 * float(np.median(stray[first:])) / GRAVITY_M_S2)
    # A bounce that ends in the level brings its own last moments of flight: they are left to it while enough remains.
    while n - first >= FEWEST and seen.time_s[-1] - seen.time_s[first] > HOPS * hop:
        if all(_is_carried(seen, rows) for rows in (slice(first, n), slice(first, first + FEWEST))):
            return first
        first += 1
    return n


def _is_carried(seen: Sightings, rows: slice) -> bool:
    """Whether the centre falls clearly more slowly than freely over these frames, noise allowed for."""
    t, z = seen.time_s[rows] - seen.time_s[rows].mean(), seen.position_m[rows, 2]
    basis = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1)
    values, *_ = np.linalg.lstsq(basis, z, rcond=None)
    inverse = np.linalg.inv(basis.T @ basis)
    scatter = float(((z - basis @ values) ** 2).sum()) / max(len(t) - 3, 1)
    sigma = float(np.sqrt(scatter * inverse[2, 2]))
    return bool(values[2] - 2.0 * sigma > -CARRIED * GRAVITY_M_S2)


def resting_vertices(die: Die, rotation: Array) -> tuple[int, ...]:
    """The vertices that touch the table with the die in this orientation, within a hundredth of an edge."""
    heights = (rotation @ die.solid.vertices.T)[2]
    order = np.argsort(heights)
    return tuple(int(i) for i in order if heights[i] - heights[order[0]] < 0.01 * die.solid.edge_m)
