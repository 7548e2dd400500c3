"""Segmentation of a track into flights.

Wherever the lowest corner comes near the table, two exact motions, one before and one after, are compared with a single motion
through both. The instant with the largest gain splits the track, and this repeats until no split gains enough: recursive binary
segmentation of change points.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import angle_between, matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ..flights import WeightedPoses, chain_residuals, fit_flights
from ..track import Track

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

NEIGHBOURS = 6
"""Frames about one frame that predict its pose."""
CONSISTENT_SIGMAS = 3.0
"""Largest rms residual [sigmas] of neighbours that lie on one motion: beside an impact neighbours lie on no common motion."""
OUTLIER_SIGMAS = 10.0
"""Least rms residual [sigmas] of an outlier from the motion of its neighbours."""
OUTLIER_RATIO = 5.0
"""Least ratio of an outlier's residual to that of its neighbours."""
ROUGH_RAD = 0.05
"""Deviation [rad] from the interpolated orientation of its neighbours from which a frame is examined: some sigmas of a good
pose."""
ROUGH_SHARE = 0.03
"""Deviation from the interpolated position of its neighbours, as a share of an edge, from which a frame is examined: the smallest
error that does harm."""
IMPOSSIBLE_RAD = 0.5
"""Largest change [rad] that a contact makes to a pose within two frames: a die of 16 mm reaches some m/s and 300 rad/s."""
IMPOSSIBLE_SHARE = 0.6
"""Largest change of position by a contact within two frames, as a share of an edge."""
OUTLIER_PASSES = 3
"""Passes of the search for outliers: one outlier spoils the neighbourhood of another."""
WINDOW = 12
"""Frames on either side of an instant that are tested for a change of motion."""
SHORTEST_WINDOW_S = 4e-4
"""Least duration [s] of a window: over a shorter one, a velocity change of 0.5 m/s moves a die by less than the error of a pose.
From 30 000 frames/s on a window takes more frames, and proportionally fewer instants are tried."""
SPLIT_GAIN = 10.0
"""Least gain of a split, in squared sigmas for each of the twelve numbers that it adds. Noise alone gives 1 ± 0.4, the mean and
standard deviation of chi-square over its twelve degrees of freedom."""
SPLIT_PARAMETERS = 12
"""Numbers that a second motion adds."""
MIN_FRAMES = 3
"""Fewest frames that determine a flight."""
ENOUGH_FRAMES = 800
"""Frames of a throw that suffice to separate its flights and to start a refinement along them."""
SMALL_MOVE_REACH = 0.05
"""Least displacement from frame to frame on ordinary footage, in circumradii: if it is smaller, frames may be left out."""
SMALL_TURN_RAD = np.radians(2.0)
"""Least rotation [rad] from frame to frame on ordinary footage: if it is smaller, frames may be left out."""
IGNORED_FASTEST_MOVES = 20
"""Largest moves that are ignored, because they may be those of outliers: a die that rests through most of its film has still
flown as fast as any."""
CONTACT_REACH = 0.58
"""Largest distance of a contact's lowest vertex from the table, in circumradii: rounding, calibration and depth error.
Half a per cent of the distance to the camera is a quarter of a die, whatever the length of its edge; a codec lifted a dark
dodecahedron by 0.4 circumradii. With 0.5 the bounces of a tetrahedron in MJPEG were missed."""


def contact_reach_m(die: Die) -> float:
    """How far from the table [m] the lowest vertex may seem to lie at a contact."""
    return CONTACT_REACH * die.solid.circumradius


def decimation_factor(track: Track, die: Die, rows: Rows | None = None) -> int:
    """One in how many tracked frames (of `rows` if given) suffices to find flights.

    It is 1 unless the film shows more than twice ENOUGH_FRAMES of a motion so slow, for its frame rate, that the frames left out
    hide nothing.
    """
    known = np.flatnonzero(track.tracked) if rows is None else rows
    if len(known) < 2 * ENOUGH_FRAMES:
        return 1
    # Over this many frames pose errors no longer look like motion.
    stride = len(known) // ENOUGH_FRAMES
    a, b = known[:-stride], known[stride:]
    moves = np.linalg.norm(track.position_m[b] - track.position_m[a], axis=1) / (
        SMALL_MOVE_REACH * die.solid.circumradius
    )
    turns = angle_between(track.quaternion[a], track.quaternion[b]) / SMALL_TURN_RAD
    rates = np.maximum(moves, turns) * np.median(b - a) / (b - a)
    fastest = float(np.partition(rates, -IGNORED_FASTEST_MOVES)[-IGNORED_FASTEST_MOVES])
    return int(max(1.0, stride * min(1.0 / max(fastest, 1e-9), 1.0)))


# --- outliers ----------------------------------------------------------------------------------------------------------


def rows_without_outliers(observations: WeightedPoses, die: Die) -> Rows:
    """The rows whose pose is consistent with the motion of their neighbours, where these agree on one."""
    rows = np.arange(len(observations))
    for _ in range(OUTLIER_PASSES):
        candidates = _rough(observations, rows, die)
        outliers = candidates[
            _are_outliers(observations, rows, candidates) | _are_impossible(observations, rows, candidates, die)
        ]
        if not len(outliers):
            break
        rows = np.delete(rows, outliers)
    return rows


def _rough(observations: WeightedPoses, rows: Rows, die: Die) -> Rows:
    """Indices into `rows` worth examining: frames off the interpolation of their neighbours, frames beside those, and both
    ends."""
    if len(rows) < 3:
        return np.zeros(0, np.int64)
    t, p, q = observations.time_s[rows], observations.position_m[rows], observations.quaternion[rows]
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    distance = np.linalg.norm(p[:-2] + share * (p[2:] - p[:-2]) - p[1:-1], axis=1)
    interpolated = quat_multiply(quat_from_rotvec(share * rotation_between(q[:-2], q[2:])), q[:-2])
    angle = angle_between(interpolated, q[1:-1])
    rough = np.concatenate([[True], (distance > ROUGH_SHARE * die.solid.edge_m) | (angle > ROUGH_RAD), [True]])
    rough[:-1] |= rough[1:]
    rough[1:] |= rough[:-1]
    return np.flatnonzero(rough)


def _are_outliers(observations: WeightedPoses, rows: Rows, candidates: Rows) -> NDArray[np.bool_]:
    """(k,) whether each of the rows `rows[candidates]` (k,) lies far off the motion of its neighbours."""
    if len(rows) <= NEIGHBOURS:
        return np.zeros(len(candidates), bool)
    first = np.clip(candidates - NEIGHBOURS // 2, 0, len(rows) - NEIGHBOURS - 1)
    window = first[:, None] + np.arange(NEIGHBOURS + 1)
    others = window[window != candidates[:, None]].reshape(-1, NEIGHBOURS)
    states, usual = _common_motions(observations, rows[others])
    residual = np.sqrt((_residuals(observations.rows(rows[candidates]), states) ** 2).mean(1))
    return np.asarray((usual < CONSISTENT_SIGMAS) & (residual > np.maximum(OUTLIER_SIGMAS, OUTLIER_RATIO * usual)))


def _are_impossible(observations: WeightedPoses, rows: Rows, candidates: Rows, die: Die) -> NDArray[np.bool_]:
    """(k,) whether each of the rows `rows[candidates]` lies so far off the motions before and after that no contact between them
    could have moved it there. At an end of the track one motion suffices. Such frames come a few in a row."""
    begins = candidates[:, None] + np.array([-NEIGHBOURS, 1, 2])
    inside = (begins >= 0) & (begins + NEIGHBOURS <= len(rows))
    first, which = np.unique(begins[inside], return_inverse=True)
    states, usual = _common_motions(observations, rows[first[:, None] + np.arange(NEIGHBOURS)])
    consistent, far = inside.copy(), np.zeros(inside.shape, bool)
    consistent[inside] = usual[which] < CONSISTENT_SIGMAS
    examined = observations.rows(rows[np.broadcast_to(candidates[:, None], inside.shape)[inside]])
    e = _residuals(replace(examined, whitener=np.tile(np.eye(6), (len(examined), 1, 1))), states[which])
    distance, angle = np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1)
    far[inside] = (angle > IMPOSSIBLE_RAD) | (distance > IMPOSSIBLE_SHARE * die.solid.edge_m)
    both = consistent[:, 0] & consistent[:, 1:].any(1)
    ends = (candidates < NEIGHBOURS) | (candidates >= len(rows) - NEIGHBOURS)
    return np.asarray((far | ~consistent).all(1) & (both | (ends & consistent.any(1))))


def _common_motions(observations: WeightedPoses, groups: Rows) -> tuple[Array, Array]:
    """Packed motions (k, 14) of groups (k, NEIGHBOURS) of rows, and the rms residuals (k,) of their frames."""
    states, chi2 = fit_flights(observations, list(groups))
    return states, np.sqrt(chi2 / (6.0 * NEIGHBOURS))


def _residuals(observations: WeightedPoses, states: Array) -> Array:
    """(n, 6) whitened residuals of frames (n,), each from a motion (n, 14) of its own."""
    return chain_residuals(observations, np.arange(len(observations) + 1), states, np.zeros(0))


# --- change points -----------------------------------------------------------------------------------------------------


def segment_flights(observations: WeightedPoses, die: Die) -> list[Rows]:
    """Rows of each flight, in order: the track split wherever a second motion explains it better than one."""
    n = len(observations.time_s)
    window = max(WINDOW, ceil(SHORTEST_WINDOW_S / float(np.median(np.diff(observations.time_s)))))
    tried = np.flatnonzero(_near_table(observations, die) & (np.arange(n + 1) % (window // WINDOW) == 0))
    cuts, gains = np.array([0, n]), _gains(observations, np.array([0, n]), tried, window)
    while len(tried) and gains.max() > SPLIT_GAIN:
        best = tried[np.argmax(gains)]
        cuts = np.sort(np.append(cuts, best))
        stale = np.abs(tried - best) <= window + 1
        gains[stale] = _gains(observations, cuts, tried[stale], window)
    return [np.arange(a, b) for a, b in itertools.pairwise(cuts) if b - a >= MIN_FRAMES]


def _near_table(observations: WeightedPoses, die: Die) -> NDArray[np.bool_]:
    """(n + 1,) where a cut before this row is possible: the lowest corner is near the table on an adjacent frame."""
    corners = matrix_from_quat(observations.quaternion) @ die.solid.vertices.T
    heights = corners[:, 2].min(1) + observations.position_m[:, 2]
    fall = np.abs(np.diff(heights, prepend=heights[0]))
    near = heights < contact_reach_m(die) + 2.0 * fall
    out = np.zeros(len(heights) + 1, bool)
    out[:-1] |= near
    out[1:] |= near
    return out


def _gains(observations: WeightedPoses, cuts: Rows, rows: Rows, window: int) -> Array:
    """(k,) gain of a cut before each of some rows (k,) over none, in squared sigmas for each number that it adds."""
    gains = np.full(len(rows), -np.inf)
    after = np.searchsorted(cuts, rows, side="right")
    begins = np.maximum(cuts[after - 1], rows - window)
    ends = np.minimum(np.append(cuts, cuts[-1])[after], rows + window)
    use = (rows - begins >= MIN_FRAMES) & (ends - rows >= MIN_FRAMES)
    begins, middles, ends = begins[use], rows[use], ends[use]
    ranges = zip(
        np.concatenate([begins, begins, middles]), np.concatenate([ends, middles, ends]), strict=True
    )  # fmt: skip
    _, chi2 = fit_flights(observations, [np.arange(a, b) for a, b in ranges])
    both, before, behind = chi2.reshape(3, -1)
    free = np.maximum(6 * (ends - begins) - 2 * SPLIT_PARAMETERS, 6)
    gains[use] = (both - before - behind) / float(SPLIT_PARAMETERS) / np.maximum((before + behind) / free, 1.0)
    return gains
