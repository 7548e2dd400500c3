"""The end of a throw: where the die no longer flies but rolls or lies on the table.

In flight the centre of the die falls with g. Once the table carries it, be it in contact that lasts or in bounces too
small to be told apart, its lowest point stays at one height and its centre falls, on the average, much more slowly. The
last frames over which both hold are no flight, and none is fitted to them.

A die that nearly rests may fly for long with its lowest point hardly off the table: where it rocks from one corner over to
another, a hop of a tenth of a millimetre lasts for 30 frames. What tells a flight from a die that tips over, which falls
nearly as fast, is the spin: a contact that carries the share ν of its weight at the distance d beside its centre makes

    a = (1 - ν) g   and   α = ν m g d/J;      while it lasts, ν = J/(J + m d²) at the least.

Flights that follow each other without a stretch in which the table carries the die are flown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from ...model.die import Die, inner_vertices
from ...model.rotations import continuous_sign, matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ...model.throw import Flight, State, Throw
from ...model.world import GRAVITY_M_S2
from ..track import LOST, Track
from .flights import Observations
from .segmentation import TABLE_REACH

Array = NDArray[np.float64]

FEWEST = 12
"""Frames that show a level."""
LEFT = 3
"""Frames that measure a flight behind a bounce."""
LEVEL_SHARE = 0.01
"""How far the lowest point may stray from its level, as a share of an edge, besides three sigmas: bounces below that are
part of coming to rest."""
HOPPING = 25.0
"""Squared sigmas off the table from which the lowest point is surely not on it: the die hops."""
LOW_SHARE = 0.15
"""The same where the frames tell a flight from a die that is carried: hops of two millimetres last for 40 ms, and edges alone
err by as much in the distance."""
SMOOTHED = 5
"""Frames whose median height is looked at, against the depth error of single frames."""
HOPS = 1.5
"""A hop that strays no further than that is over in 2 √(2h/g): what lasts so many times as long is none, nor its end."""
FEWEST_FALLING = 8
"""Frames that are tried first to tell a fall: good poses do so within 5 ms."""
MOST_FALLING = 128
"""Frames that are looked at of those over which a fall is told, or twice as many, spread evenly: more of a film far faster than
the die is lie so near each other that they err alike, and taken for independent would say more than they know."""
PASSED_OVER = 2
"""Flights too short to be told do not last for so many times as many frames."""
LONGEST_FALL_S = 0.1
"""Frames over more than that are no hop of a die that nearly rests."""
FALLING, TOLD = 16.0, 9.0
"""Squared sigmas by which frames in flight stray from free motion at the most: four numbers exceed that in three cases of a
thousand; and those by which they must stray from it if the table carried the die. They are taken for a flight where they
are less than half as far, in sigmas, from the one as from the other."""
CARRIED = 0.5
"""Share of g below which the centre does not fall freely: half-way between a die in flight and one that lies."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SupportedMotion(Flight):
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

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        times = np.clip(np.asarray(times_s, float), self.times_s[0], self.times_s[-1])
        signed = continuous_sign(self.quaternions)
        positions = np.stack([np.interp(times, self.times_s, column) for column in self.positions_m.T], axis=1)
        quaternions = np.stack([np.interp(times, self.times_s, column) for column in signed.T], axis=1)
        return positions, quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def first_low_row(seen: Observations, die: Die) -> int:
    """The first of the last rows over which the die stays near the table, LOW_SHARE; the number of rows where it does not."""
    off = _off_level(seen, die)
    return len(seen) if off is None else _last_rows(off < LOW_SHARE * die.solid.edge_m)


def first_supported_row(seen: Observations, die: Die) -> int:
    """The first of the last rows over which the table carries the die; the number of rows where it flies to the end."""
    n, off = len(seen), _off_level(seen, die)
    if off is None:
        return n
    first = _flown_on(seen, _last_rows(off < LOW_SHARE * die.solid.edge_m), die)
    if first is None:
        information = np.swapaxes(seen.whitener, 1, 2) @ seen.whitener
        sigma = np.sqrt(np.linalg.inv(information)[:, 2, 2])
        # The efficiency of a median is 0.64.
        stray = LEVEL_SHARE * die.solid.edge_m + 3.0 * sigma / np.sqrt(0.64 * SMOOTHED)
        first = _last_rows(off <= stray)
        hop = 2.0 * np.sqrt(2.0 * float(np.median(stray[first:])) / GRAVITY_M_S2) if first < n else 0.0
        if first == n or seen.time_s[-1] - seen.time_s[first] < HOPS * hop or not _is_carried(seen, slice(first, n)):
            return n
    # The last bounce may lie a frame behind the first that is level: the frames that show it are left to it.
    return min(first + LEFT, n)


def _off_level(seen: Observations, die: Die) -> Array | None:
    """(n,) [m] how far the lowest point is, smoothed, from where it stays at the end; None where that is not the table."""
    if len(seen) < FEWEST:
        return None
    corners = matrix_from_quat(seen.quaternion) @ inner_vertices(die.solid, die.corner_radius_m).T
    heights = corners[:, 2].min(1) + seen.position_m[:, 2] - die.corner_radius_m
    level = float(np.median(heights[-FEWEST:]))
    if abs(level) > TABLE_REACH * die.solid.edge_m:
        return None
    return np.asarray(np.abs(median_filter(heights, SMOOTHED, mode="nearest") - level))


def _last_rows(holds: NDArray[np.bool_]) -> int:
    """The first of the last rows over which something holds."""
    off = np.flatnonzero(~holds)
    return int(off[-1]) + 1 if len(off) else 0


def _flown_on(seen: Observations, first: int, die: Die) -> int | None:
    """The row behind the flights that go on from row `first`, itself if the die does not fly there; None where the frames, or
    too few behind, do not tell.

    Over as many frames as tell: FEWEST_FALLING, or twice, four times as many. Shorter ones between two flights are passed
    over. A die that is no spherical top does not keep its spin in flight, and is not asked.
    """
    span, n = FEWEST_FALLING, len(seen) - first if die.is_spherical_top else 0
    while span <= n and seen.time_s[first + span - 1] - seen.time_s[first] < LONGEST_FALL_S:
        begins, strays, tells = _strays(seen.rows(slice(first, len(seen))), span, die)
        if np.median(tells) > TOLD:
            reach = 0
            for k in begins[(tells > TOLD) & (strays < np.minimum(FALLING, 0.25 * tells))].tolist():
                if k <= reach + PASSED_OVER * span:
                    reach = k + span
            return first + reach if n - reach > PASSED_OVER * span else None
        span *= 2
    return None


def _strays(seen: Observations, span: int, die: Die) -> tuple[NDArray[np.int64], Array, Array]:
    """Of frames, `span` in a row of which MOST_FALLING are enough: the first row (w,), the squared sigmas by which they stray
    from free motion, in how fast they fall and how their spin changes, and those by which they would at the least if the table
    carried the die.

    Nothing is taken to push the die aside: what is seen across the line of sight then tells how it falls, whatever the
    distance errs.
    """
    begins = np.arange(0, len(seen) - span + 1, max(span // FEWEST_FALLING, 1))
    rows = begins[:, None] + np.arange(0, span, max(span // MOST_FALLING, 1))
    middle = rows[:, rows.shape[1] // 2, None]
    tau = seen.time_s[rows] - seen.time_s[middle]
    A = np.zeros((*rows.shape, 6, 16))
    A[..., :6] = np.eye(6)
    A[..., 6:12] = tau[..., None, None] * np.eye(6)
    A[..., 2, 12] = -0.5 * tau**2
    A[..., 3:, 13:] = 0.5 * tau[..., None, None] ** 2 * np.eye(3)
    perturbed = seen.position_m[rows] - seen.position_m[middle]
    turned = rotation_between(seen.quaternion[middle], seen.quaternion[rows])
    W = seen.whitener[rows]
    A = (W @ A).reshape(len(rows), -1, 16)
    y = (W @ np.concatenate([perturbed, turned], axis=2)[..., None]).reshape(len(rows), -1)
    inverse = np.linalg.inv(np.einsum("wip,wiq->wpq", A, A))
    found = np.einsum("wpq,wiq,wi->wp", inverse, A, y)
    left = ((y - np.einsum("wip,wp->wi", A, found)) ** 2).sum(1) / (A.shape[1] - 16)
    C = inverse[:, 12:, 12:] * left[:, None, None]
    off = found[:, 12:] - np.array([GRAVITY_M_S2, 0.0, 0.0, 0.0])
    strays = np.einsum("wi,wi->w", off, np.linalg.solve(C, off[..., None])[..., 0])
    return begins, strays, _told(C, die)


def _told(C: Array, die: Die) -> Array:
    """(w,) squared sigmas of what a contact does at the least, for covariances C (w, 4, 4) of fall and angular acceleration."""
    lever = float(np.sqrt(die.solid.circumradius**2 - die.solid.inradius**2))
    beside = np.linspace(0.0, lever, 9)
    share = die.inertia_kg_m2 / (die.inertia_kg_m2 + die.mass_kg * beside**2)
    turning = share * die.mass_kg * GRAVITY_M_S2 * beside / die.inertia_kg_m2
    least_known = np.linalg.eigvalsh(C[:, 1:, 1:])[:, -1:]
    return np.asarray(((share * GRAVITY_M_S2) ** 2 / C[:, :1, 0] + turning**2 / least_known).min(1))


def _is_carried(seen: Observations, rows: slice) -> bool:
    """Whether the centre clearly does not fall freely over these frames, but much more slowly."""
    t, z = seen.time_s[rows] - seen.time_s[rows].mean(), seen.position_m[rows, 2]
    basis = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1)
    values, *_ = np.linalg.lstsq(basis, z, rcond=None)
    inverse = np.linalg.inv(basis.T @ basis)
    scatter = float(((z - basis @ values) ** 2).sum()) / max(len(t) - 3, 1)
    sigma = float(np.sqrt(scatter * inverse[2, 2]))
    return bool(values[2] > -CARRIED * GRAVITY_M_S2 and values[2] + GRAVITY_M_S2 > 3.0 * sigma)


def on_table(track: Track, rows: NDArray[np.int64], die: Die, table_m: float, table_sigma_m: float) -> Track:
    """The track with the poses of its frames `rows`, over which the table carries the die, corrected by what that says: the
    lowest point is on the table, whose height is `table_m`, known to `table_sigma_m`, or hops by LEVEL_SHARE at the most, taken
    for two sigmas. What is so known of the height one camera hardly sees, as distance. A frame that is too far off (HOPPING)
    stays as it is."""
    p, q, C = track.position_m[rows], track.quaternion[rows], track.covariance[rows]
    corners = matrix_from_quat(q) @ inner_vertices(die.solid, die.corner_radius_m).T
    low = np.argmin(corners[:, 2], axis=1)
    x, y, z = np.moveaxis(np.take_along_axis(corners, low[:, None, None], axis=2)[..., 0], 1, 0)
    height = p[:, 2] + z - die.corner_radius_m - table_m
    # ẑ·(δp + δθ × r)
    row = np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x), y, -x, np.zeros_like(x)], axis=1)
    told = np.einsum("nij,nj->ni", C, row)
    sigma_m = np.hypot(0.5 * LEVEL_SHARE * die.solid.edge_m, table_sigma_m)
    spread = (row * told).sum(1) + sigma_m**2
    share = np.where(height**2 < HOPPING * spread, 1.0 / spread, 0.0)[:, None] * told
    change = -share * height[:, None]
    position, quaternion, covariance = track.position_m.copy(), track.quaternion.copy(), track.covariance.copy()
    position[rows] += change[:, :3]
    quaternion[rows] = quat_multiply(quat_from_rotvec(change[:, 3:]), q)
    covariance[rows] = C - share[:, :, None] * told[:, None, :]
    return replace(track, position_m=position, quaternion=quaternion, covariance=covariance)


def flights_only(throw: Throw) -> Throw:
    """The flights of a measured throw alone, without what the table carries at its end."""
    if not isinstance(throw.flights[-1], SupportedMotion):
        return throw
    return Throw(throw.flights[:-1], throw.impacts[:-1])


def frames_in_flight(track: Track, throw: Throw) -> Track:
    """The track with the frames behind the last flight of a measured throw as lost: what a model of flights may be
    fitted to. The poses stay as they are."""
    behind = track.tracked & (track.time_s > flights_only(throw).flights[-1].end_s)
    return replace(track, status=np.where(behind, LOST, track.status)) if behind.any() else track


def resting_vertices(die: Die, rotation: Array) -> tuple[int, ...]:
    """The vertices that touch the table with the die in this orientation, within a hundredth of an edge."""
    heights = (rotation @ die.solid.vertices.T)[2]
    order = np.argsort(heights)
    return tuple(int(i) for i in order if heights[i] - heights[order[0]] < 0.01 * die.solid.edge_m)
