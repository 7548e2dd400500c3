"""Where a track is parted into flights.

Wherever the lowest corner comes near the table, two exact motions, one before and one after, are compared with a single
one through both: the instant that gains most parts the track, and so on until no parting gains anything (recursive
binary segmentation of change points).
"""

from __future__ import annotations

import itertools
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..model.motion import Flight, State
from ..model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ..model.solids import Die
from .flights import Sightings, fit_flight, misfits

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
TABLE_REACH = 0.35
"""A contact's lowest vertex may seem this share of an edge off the table: rounding, calibration and depth error (half a
per cent of the distance to the camera is a quarter of a die)."""


def sane_rows(seen: Sightings, die: Die) -> NDArray[np.int64]:
    """The rows without those whose pose is plainly wrong amid neighbours that agree on a motion."""
    rows = np.arange(len(seen))
    for _ in range(PASSES):
        wrong = [k for k in _unsteady(seen, rows, die) if _is_wrong(seen, rows, k) or _is_stray(seen, rows, k, die)]
        if not wrong:
            break
        rows = np.delete(rows, wrong)
    return rows


def _unsteady(seen: Sightings, rows: NDArray[np.int64], die: Die) -> list[int]:
    """Which of the rows are worth a closer look: those off the way from the frame before to the frame behind, those
    beside them, and the ends."""
    if len(rows) < 3:
        return []
    t, p, q = seen.time_s[rows], seen.position_m[rows], seen.quaternion[rows]
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    away = np.linalg.norm(p[:-2] + share * (p[2:] - p[:-2]) - p[1:-1], axis=1)
    half = quat_multiply(quat_from_rotvec(share * rotation_between(q[:-2], q[2:])), q[:-2])
    turned = np.linalg.norm(rotation_between(half, q[1:-1]), axis=1)
    rough = np.concatenate([[True], (away > ROUGH_SHARE * die.solid.edge_m) | (turned > ROUGH_RAD), [True]])
    rough[:-1] |= rough[1:]
    rough[1:] |= rough[:-1]
    return [int(k) for k in np.flatnonzero(rough)]


def _is_wrong(seen: Sightings, rows: NDArray[np.int64], k: int) -> bool:
    """Whether row `rows[k]` lies far off the motion of its neighbours."""
    first = int(np.clip(k - BESIDE // 2, 0, max(len(rows) - BESIDE - 1, 0)))
    about = rows[first : first + BESIDE + 1]
    others = about[about != rows[k]]
    motion = _common_motion(seen, others)
    if motion is None:
        return False
    off = float(misfits(seen.rows(rows[k : k + 1]), motion[0])[0])
    return off > max(WRONG_SIGMAS, TIMES_WORSE * motion[1])


def _is_stray(seen: Sightings, rows: NDArray[np.int64], k: int, die: Die) -> bool:
    """Whether row `rows[k]` lies so far off the motions before and after (one of them, at an end of the track) that no
    contact between could have thrown it there: one of a few wrong frames beside each other."""
    told = []
    for others in (rows[max(k - BESIDE, 0) : k], rows[k + 1 :][:BESIDE], rows[k + 2 :][:BESIDE]):
        motion = _common_motion(seen, others)
        if motion is not None:
            p, q = Flight(motion[0], np.inf).poses(seen.time_s[rows[k : k + 1]])
            turned = float(np.linalg.norm(rotation_between(q, seen.quaternion[rows[k : k + 1]])))
            away = float(np.linalg.norm(p - seen.position_m[rows[k : k + 1]]))
            told.append((turned > STRAY_RAD or away > STRAY_SHARE * die.solid.edge_m, others[0] > rows[k]))
    after, before = [off for off, later in told if later], [off for off, later in told if not later]
    ends = k < BESIDE or k >= len(rows) - BESIDE
    return all(after) and all(before) and (bool(after and before) or (ends and bool(told)))


def _common_motion(seen: Sightings, rows: NDArray[np.int64]) -> tuple[State, float] | None:
    """The motion of some frames, with their distance from it; None where they are too few or lie on no one motion."""
    if len(rows) < BESIDE:
        return None
    state, _, _ = fit_flight(seen.rows(rows))
    usual = float(np.sqrt((misfits(seen.rows(rows), state) ** 2).mean()))
    return (state, usual) if usual < SANE_SIGMAS else None


def part_flights(seen: Sightings, die: Die) -> list[NDArray[np.int64]]:
    """Rows of each flight, in order: the track parted wherever a second motion explains it better than one."""
    n = len(seen.time_s)
    window = max(WINDOW, ceil(BRIEFEST_S / float(np.median(np.diff(seen.time_s)))))
    low = _near_table(seen, die) & (np.arange(n + 1) % (window // WINDOW) == 0)
    cuts = [0, n]
    gains = np.full(n + 1, -np.inf)
    stale = np.ones(n + 1, bool)
    while True:
        for s in np.flatnonzero(stale):
            gains[s] = _gain(seen, cuts, int(s), window) if low[s] else -np.inf
        stale[:] = False
        best = int(np.argmax(gains))
        if not gains[best] > GAIN:
            break
        cuts = sorted([*cuts, best])
        stale[max(0, best - window - 1) : best + window + 2] = True
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


def _gain(seen: Sightings, cuts: list[int], s: int, window: int) -> float:
    """Gain of a cut before row s over none, in squared sigmas for each number that it adds."""
    below = max(c for c in cuts if c <= s)
    above = min((c for c in cuts if c > s), default=s)
    a, b = np.arange(max(below, s - window), s), np.arange(s, min(above, s + window))
    if len(a) < FEWEST or len(b) < FEWEST:
        return -np.inf
    both = fit_flight(seen.rows(slice(int(a[0]), int(b[-1]) + 1)))[2]
    apart = sum(fit_flight(seen.rows(slice(int(r[0]), int(r[-1]) + 1)))[2] for r in (a, b))
    free = max(6 * (len(a) + len(b)) - 24, 6)
    return (both - apart) / 12.0 / max(apart / free, 1.0)
