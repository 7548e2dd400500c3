"""Where a track is parted into flights.

Wherever the lowest corner comes near the table, two exact motions, one before and one after, are compared with a single
one through both: the instant that gains most parts the track, and so on until no parting gains anything (recursive
binary segmentation of change points).
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ..track import Track
from .flights import Observations, chain_misses, fit_flights

Array = NDArray[np.float64]

BESIDE = 6
"""Frames about one that say where it should be."""
SANE_SIGMAS, WRONG_SIGMAS, TIMES_WORSE = 3.0, 10.0, 5.0
"""Neighbours that lie on one motion within this, and a frame this far off it and so many times further than they: beside a
bounce the neighbours lie on no one motion."""
ROUGH_RAD, ROUGH_SHARE = 0.05, 0.03
"""How far, in radians and edges, a frame must be off the straight way between its neighbours to be looked at: some sigmas
of a good pose, and the least of the faults that do harm."""
STRAY_RAD, STRAY_SHARE = 0.5, 0.6
"""What a contact does to a pose within two frames: a die of 16 mm is thrown at some m/s and 300 rad/s. Beyond, a pose is
wrong."""
PASSES = 3
"""A wrong frame spoils the neighbourhood of another."""
WINDOW = 12
"""Frames on either side of an instant that say whether the motion changes there."""
BRIEFEST_S = 4e-4
"""Time that they cover at the least: in a shorter one a die whose velocity changes by half a metre a second strays by less
than a pose errs. From 30 000 frames a second on that takes more frames, and as many times fewer instants are tried."""
GAIN = 10.0
"""By how much, in squared sigmas for each of the twelve numbers that it adds, a second motion must explain the frames
better than one. Noise alone gives 1 ± 0.4, the mean and spread of chi-square over its twelve degrees of freedom."""
FEWEST = 3
"""Frames that measure a flight."""
ENOUGH_FRAMES = 800
"""Frames of a throw that tell its flights apart, and place them well enough to look for better poses along them."""
SMALL_MOVE_REACH, SMALL_TURN_RAD = 0.05, np.radians(2.0)
"""Least that a die moves from frame to frame on ordinary footage, in units of its reach: less, and frames may be left out."""
WRONG_MOVES = 20
"""Moves that may be those of wrong poses, and count for none: a die that rests through most of its film has flown as fast as
any."""
TABLE_REACH = 0.35
"""A contact's lowest vertex may seem this share of an edge off the table: rounding, calibration and depth error (half a
per cent of the distance to the camera is a quarter of a die)."""


def decimation_factor(track: Track, die: Die, rows: NDArray[np.int64] | None = None) -> int:
    """Of how many tracked frames, of `rows` where those are given, one will do to find flights: 1 but on a film that shows more
    than PLENTY of a motion so slow, for its rate, that frames left out hide nothing."""
    known = np.flatnonzero(track.tracked) if rows is None else rows
    if len(known) < 2 * ENOUGH_FRAMES:
        return 1
    # Over so many frames what single poses err no longer seems a motion.
    apart = len(known) // ENOUGH_FRAMES
    a, b = known[:-apart], known[apart:]
    moves = np.linalg.norm(track.position_m[b] - track.position_m[a], axis=1) / (
        SMALL_MOVE_REACH * die.solid.circumradius
    )
    turns = np.linalg.norm(rotation_between(track.quaternion[a], track.quaternion[b]), axis=1) / SMALL_TURN_RAD
    rates = np.maximum(moves, turns) * np.median(b - a) / (b - a)
    fastest = float(np.partition(rates, -WRONG_MOVES)[-WRONG_MOVES])
    return int(max(1.0, apart * min(1.0 / max(fastest, 1e-9), 1.0)))


def rows_without_outliers(seen: Observations, die: Die) -> NDArray[np.int64]:
    """The rows without those whose pose is plainly wrong amid neighbours that agree on a motion."""
    rows = np.arange(len(seen))
    for _ in range(PASSES):
        looked = _unsteady(seen, rows, die)
        wrong = looked[_are_wrong(seen, rows, looked) | _are_stray(seen, rows, looked, die)]
        if not len(wrong):
            break
        rows = np.delete(rows, wrong)
    return rows


def _unsteady(seen: Observations, rows: NDArray[np.int64], die: Die) -> NDArray[np.int64]:
    """Which of the rows are worth a closer look: those off the way from the frame before to the frame behind, those
    beside them, and the ends."""
    if len(rows) < 3:
        return np.zeros(0, np.int64)
    t, p, q = seen.time_s[rows], seen.position_m[rows], seen.quaternion[rows]
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    away = np.linalg.norm(p[:-2] + share * (p[2:] - p[:-2]) - p[1:-1], axis=1)
    half = quat_multiply(quat_from_rotvec(share * rotation_between(q[:-2], q[2:])), q[:-2])
    turned = np.linalg.norm(rotation_between(half, q[1:-1]), axis=1)
    rough = np.concatenate([[True], (away > ROUGH_SHARE * die.solid.edge_m) | (turned > ROUGH_RAD), [True]])
    rough[:-1] |= rough[1:]
    rough[1:] |= rough[:-1]
    return np.flatnonzero(rough)


def _are_wrong(seen: Observations, rows: NDArray[np.int64], looked: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(k,) whether each of the rows `rows[looked]` (k,) lies far off the motion of its neighbours."""
    if len(rows) <= BESIDE:
        return np.zeros(len(looked), bool)
    first = np.clip(looked - BESIDE // 2, 0, len(rows) - BESIDE - 1)
    about = first[:, None] + np.arange(BESIDE + 1)
    others = about[about != looked[:, None]].reshape(-1, BESIDE)
    states, usual = _common_motions(seen, rows[others])
    off = np.sqrt((_misses(seen.rows(rows[looked]), states) ** 2).mean(1))
    return np.asarray((usual < SANE_SIGMAS) & (off > np.maximum(WRONG_SIGMAS, TIMES_WORSE * usual)))


def _are_stray(seen: Observations, rows: NDArray[np.int64], looked: NDArray[np.int64], die: Die) -> NDArray[np.bool_]:
    """(k,) whether each of the rows `rows[looked]` lies so far off the motions before and after (one of them, at an end of
    the track) that no contact between could have thrown it there: one of a few wrong frames beside each other."""
    begins = looked[:, None] + np.array([-BESIDE, 1, 2])
    inside = (begins >= 0) & (begins + BESIDE <= len(rows))
    first, which = np.unique(begins[inside], return_inverse=True)
    states, usual = _common_motions(seen, rows[first[:, None] + np.arange(BESIDE)])
    told, off = inside.copy(), np.zeros(inside.shape, bool)
    told[inside] = usual[which] < SANE_SIGMAS
    far = seen.rows(rows[np.broadcast_to(looked[:, None], inside.shape)[inside]])
    e = _misses(replace(far, whitener=np.tile(np.eye(6), (len(far), 1, 1))), states[which])
    away, turned = np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1)
    off[inside] = (turned > STRAY_RAD) | (away > STRAY_SHARE * die.solid.edge_m)
    both = told[:, 0] & told[:, 1:].any(1)
    ends = (looked < BESIDE) | (looked >= len(rows) - BESIDE)
    return np.asarray((off | ~told).all(1) & (both | (ends & told.any(1))))


def _common_motions(seen: Observations, groups: NDArray[np.int64]) -> tuple[Array, Array]:
    """Packed motions (k, 14) of groups (k, BESIDE) of rows, and the distance (k,) of the frames from them."""
    states, left = fit_flights(seen, list(groups))
    return states, np.sqrt(left / (6.0 * BESIDE))


def _misses(seen: Observations, states: Array) -> Array:
    """(n, 6) whitened distances of frames (n,), each from a motion (n, 14) of its own."""
    return chain_misses(seen, np.arange(len(seen) + 1), states, np.zeros(0))


def segment_flights(seen: Observations, die: Die) -> list[NDArray[np.int64]]:
    """Rows of each flight, in order: the track parted wherever a second motion explains it better than one."""
    n = len(seen.time_s)
    window = max(WINDOW, ceil(BRIEFEST_S / float(np.median(np.diff(seen.time_s)))))
    tried = np.flatnonzero(_near_table(seen, die) & (np.arange(n + 1) % (window // WINDOW) == 0))
    cuts, gains = np.array([0, n]), _gains(seen, np.array([0, n]), tried, window)
    while len(tried) and gains.max() > GAIN:
        best = tried[np.argmax(gains)]
        cuts = np.sort(np.append(cuts, best))
        stale = np.abs(tried - best) <= window + 1
        gains[stale] = _gains(seen, cuts, tried[stale], window)
    return [np.arange(a, b) for a, b in itertools.pairwise(cuts) if b - a >= FEWEST]


def _near_table(seen: Observations, die: Die) -> NDArray[np.bool_]:
    """(n + 1,) where a cut before this row is possible: the lowest corner is near the table on a frame beside it."""
    heights = (matrix_from_quat(seen.quaternion) @ die.solid.vertices.T)[:, 2].min(1) + seen.position_m[:, 2]
    fall = np.abs(np.diff(heights, prepend=heights[0]))
    edge = die.solid.edge_m
    near = heights < TABLE_REACH * edge + 2.0 * fall
    out = np.zeros(len(heights) + 1, bool)
    out[:-1] |= near
    out[1:] |= near
    return out


def _gains(seen: Observations, cuts: NDArray[np.int64], rows: NDArray[np.int64], window: int) -> Array:
    """(k,) gain of a cut before each of some rows (k,) over none, in squared sigmas for each number that it adds."""
    gains = np.full(len(rows), -np.inf)
    after = np.searchsorted(cuts, rows, side="right")
    begins = np.maximum(cuts[after - 1], rows - window)
    ends = np.minimum(np.append(cuts, cuts[-1])[after], rows + window)
    use = (rows - begins >= FEWEST) & (ends - rows >= FEWEST)
    begins, middles, ends = begins[use], rows[use], ends[use]
    ranges = zip(
        np.concatenate([begins, begins, middles]), np.concatenate([ends, middles, ends]), strict=True
    )  # fmt: skip
    _, left = fit_flights(seen, [np.arange(a, b) for a, b in ranges])
    both, before, behind = left.reshape(3, -1)
    free = np.maximum(6 * (ends - begins) - 24, 6)
    gains[use] = (both - before - behind) / 12.0 / np.maximum((before + behind) / free, 1.0)
    return gains
