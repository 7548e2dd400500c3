"""The bounces of a track: flights found, joined, and each contact named.

Wherever the lowest corner comes near the table, two exact motions, one before and one after, are compared with a single
one through both: the instant that gains most parts the track, and so on until no parting gains anything (recursive
binary segmentation of change points). Neighbouring flights are then joined at one instant each and all are fitted
together (`joined`). A link that no single instant explains stays open and is reported as an unresolved contact.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from ..model.motion import GRAVITY_M_S2, Flight, Impact, State, Throw, energy_J
from ..model.rotations import matrix_from_quat, rotation_between
from ..model.solids import Die, lowest_face
from .joined import Joined, Sightings, fit_flight, fit_joined, seen_minus_motion, transition
from .track import Track

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
OPEN_STRAIN = 5.0
"""Frames beside a link that lie this many times further off than usual say that no single instant joins its flights."""
FAULTY_STRAIN = 2.0
"""The same, for a link that on top of it does not look like a bounce."""
LONGEST = 40
"""Frames of each flight that are enough to judge a contact between them."""
GROSS_RAD = 0.2
"""Flights whose orientations stay further apart than this at their nearest are not joined at one instant."""
SAMPLES = 2000


class NoFlightError(ValueError):
    """The track holds no flight that could be measured."""


def measure_throw(track: Track, die: Die) -> Throw:
    """Flights with covariance and impacts with their uncertainty, from the poses of single frames.

    Raises NoFlightError where fewer than three frames in a row are tracked.
    """
    use = np.flatnonzero(track.tracked)
    if len(use) < 3:
        raise NoFlightError(f"{len(use)} frames are tracked: wanted at least three in a row to measure a flight")
    seen = _sightings(track, use)
    joined, opened = _join(seen, _part(seen, die), die)
    return Throw(joined.flights, _impacts(joined, die, opened))


def _sightings(track: Track, use: NDArray[np.int64]) -> Sightings:
    """The tracked frames as the fit wants them."""
    return Sightings.from_poses(track.time_s[use], track.position_m[use], track.quaternion[use], track.covariance[use])


def _state_from(seen: Sightings, rows: NDArray[np.int64]) -> tuple[State, float]:
    """The motion through some frames, and the sum of squared sigmas that it leaves."""
    state, _, left = fit_flight(seen.rows(rows))
    return state, left


def _misfit(seen: Sightings, state: State, rows: NDArray[np.int64]) -> Array:
    """Distance (rows,) of frames from a motion, in sigmas (root mean square of six)."""
    return np.asarray(np.sqrt((seen_minus_motion(seen.rows(rows), state) ** 2).mean(1)))


def _part(seen: Sightings, die: Die) -> list[NDArray[np.int64]]:
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
    both = _state_from(seen, np.concatenate([a, b]))[1]
    apart = _state_from(seen, a)[1] + _state_from(seen, b)[1]
    free = max(6 * (len(a) + len(b)) - 24, 6)
    return (both - apart) / 12.0 / max(apart / free, 1.0)


def _join(seen: Sightings, parts: list[NDArray[np.int64]], die: Die) -> tuple[Joined, list[bool]]:
    """All flights fitted together. Links that one instant cannot explain are open: each is judged on its own two
    flights, because one that is forced together where it does not hold spoils the fit of all. Links that cannot be
    bounces are removed, the weakest first; open ones stay, since one motion through both flights would be neither."""
    while True:
        gross = _gross_gaps(seen, parts, die)
        strains = [_strain(seen, a, b) for a, b in itertools.pairwise(parts)]
        opened = [g or strain > OPEN_STRAIN for g, strain in zip(gross, strains, strict=True)]
        joined = _fit_parts(seen, parts, opened)
        impossible = [not o and not _can_be_bounce(joined, k, die) for k, o in enumerate(opened)]
        if any(bad and strain > FAULTY_STRAIN for bad, strain in zip(impossible, strains, strict=True)):
            # Several contacts taken for one need not look like a bounce; what shows them is that one instant fits ill.
            opened = [
                o or (bad and strain > FAULTY_STRAIN)
                for o, bad, strain in zip(opened, impossible, strains, strict=True)
            ]
            joined = _fit_parts(seen, parts, opened)
        faults = [k for k, o in enumerate(opened) if not o and not _can_be_bounce(joined, k, die)]
        if not faults:
            return joined, opened
        k = min(faults, key=lambda j: _jump(joined, j, die))
        parts = [*parts[:k], np.concatenate([parts[k], parts[k + 1]]), *parts[k + 2 :]]


def _gross_gaps(seen: Sightings, parts: list[NDArray[np.int64]], die: Die) -> list[bool]:
    """Neighbouring flights that, each fitted alone, come nowhere near each other: several contacts lie between them, or
    the track was lost there and taken up under another labelling. Forcing them together would spoil both."""
    gross = []
    for a, b in itertools.pairwise(parts):
        before, after = (Flight(_state_from(seen, _best_rows(seen, rows))[0], np.inf) for rows in (a, b))
        t = _meeting(before.start, after.start, float(seen.time_s[a[-1]]), float(seen.time_s[b[0]]))
        p, q = before.at(t), after.at(t)
        turned = float(np.linalg.norm(rotation_between(p.quaternion, q.quaternion)))
        moved = float(np.linalg.norm(p.position_m - q.position_m))
        gross.append(turned > GROSS_RAD or moved > 0.3 * die.solid.circumradius)
    return gross


def _strain(seen: Sightings, before: NDArray[np.int64], after: NDArray[np.int64]) -> float:
    """How much further than usual the frames beside a contact lie from two flights joined at one instant. The worst is
    left out: one frame may straddle the contact in its exposure."""
    a, b = before[-LONGEST:], after[:LONGEST]
    alone = np.concatenate([_misfit(seen, _state_from(seen, rows)[0], rows) for rows in (a, b)])
    pair = seen.rows(np.concatenate([a, b]))
    joined = _fit_parts(pair, [np.arange(len(a)), np.arange(len(a), len(a) + len(b))], [False])
    beside = joined.residual[max(len(a) - 4, 0) : len(a) + 4]
    return float(np.mean(np.sort(beside)[:-1])) / max(float(np.median(alone)), 0.5)


def _can_be_bounce(joined: Joined, k: int, die: Die) -> bool:
    """Whether a link is what a table does to a die: it pushes upwards, on a corner near the table that came down before
    and goes up after. Slow drifts of the pose, as marks and shading move over the edges, do none of this."""
    t = float(joined.links_s[k])
    a, b = joined.flights[k].at(t), joined.flights[k + 1].at(t)
    arms = die.solid.vertices @ a.rotation.T
    low = int(np.argmin(arms[:, 2]))
    edge = die.solid.edge_m
    if abs(arms[low, 2] + a.position_m[2]) > TABLE_REACH * edge or b.velocity_m_s[2] <= a.velocity_m_s[2]:
        return False
    return _normal_velocity(a, arms[low]) < 0.0 < _normal_velocity(b, arms[low])


def _jump(joined: Joined, k: int, die: Die) -> float:
    """Size [m/s] of the change of motion at a link, at the die's surface."""
    t = float(joined.links_s[k])
    a, b = joined.flights[k].at(t), joined.flights[k + 1].at(t)
    spin = die.solid.circumradius * np.linalg.norm(b.omega_rad_s - a.omega_rad_s)
    return float(np.linalg.norm(b.velocity_m_s - a.velocity_m_s) + spin)


def _fit_parts(seen: Sightings, parts: list[NDArray[np.int64]], opened: list[bool]) -> Joined:
    """The joint fit of the frames of all flights, from each flight's own fit."""
    good = [_best_rows(seen, rows) for rows in parts]
    states = [_state_from(seen, rows)[0] for rows in good]
    links = []
    for k in range(len(parts) - 1):
        if opened[k]:
            # Between the frames that surely lie on either flight; where exactly, no single instant says.
            links.append(0.5 * float(seen.time_s[good[k][-1]] + seen.time_s[good[k + 1][0]]))
        else:
            low, high = float(seen.time_s[parts[k][-1]]), float(seen.time_s[parts[k + 1][0]])
            links.append(_meeting(states[k], states[k + 1], low, high))
    return fit_joined(seen, states, links, opened)


def _best_rows(seen: Sightings, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of a flight without those far off its own motion."""
    state, _ = _state_from(seen, rows)
    misfit = _misfit(seen, state, rows)
    good = rows[misfit < 5.0 * max(float(np.median(misfit)), 0.5)]
    return good if len(good) >= 3 else rows


def _meeting(before: State, after: State, low_s: float, high_s: float) -> float:
    """The instant near [low, high] at which two motions come closest, positions and turns (times 5 mm) together."""
    spread = max(high_s - low_s, 1e-9)
    times = np.linspace(low_s - 1.0 * spread, high_s + 1.0 * spread, 121)
    pa, qa = Flight(before, np.inf).poses(times)
    pb, qb = Flight(after, np.inf).poses(times)
    distance = np.linalg.norm(pa - pb, axis=1) + 5e-3 * np.linalg.norm(rotation_between(qa, qb), axis=1)
    return float(times[int(np.argmin(distance))])


def _impacts(joined: Joined, die: Die, opened: list[bool]) -> tuple[Impact, ...]:
    """What each link says about its bounce."""
    rng = np.random.default_rng(20120404)
    values, vectors = np.linalg.eigh(joined.covariance)
    draws = rng.standard_normal((SAMPLES, len(values))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return tuple(_impact(joined, die, k, opened[k], draws) for k in range(len(joined.links_s)))


def _impact(joined: Joined, die: Die, k: int, is_open: bool, draws: Array) -> Impact:
    """One bounce: contact, velocities of the contact point on both sides, apparent restitution with its interval."""
    before, after = joined.flights[k], joined.flights[k + 1]
    t = float(joined.links_s[k])
    a, b = before.at(t), after.at(t)
    arms = die.solid.vertices @ a.rotation.T
    heights = arms[:, 2] + a.position_m[2]
    order = np.argsort(heights)
    edge = die.solid.edge_m
    touching = tuple(int(i) for i in order if heights[i] - heights[order[0]] < 0.01 * edge)
    contact = "unresolved" if is_open else {1: "vertex", 2: "edge"}.get(len(touching), "face")
    arm = arms[list(touching)].mean(0)
    v_before, v_after = _normal_velocity(a, arm), _normal_velocity(b, arm)
    chi, low, high = np.nan, np.nan, np.nan
    if not is_open and v_before < 0:
        chi = -v_after / v_before
        low, high = _chi_interval(joined, k, t, arm, v_before, v_after, draws)
    middle_before = before.at(0.5 * (before.start.time_s + before.end_s))
    middle_after = after.at(0.5 * (after.start.time_s + after.end_s))
    return Impact(
        t,
        contact,
        () if is_open else touching,
        (a.position_m + arm)[:2],
        die.mass_kg * (b.velocity_m_s - a.velocity_m_s),
        v_before,
        v_after,
        energy_J(die, a),
        energy_J(die, b),
        lowest_face(die.solid, middle_before.rotation),
        lowest_face(die.solid, middle_after.rotation),
        sigma_time_s=float(joined.sigma_time_s[k]),
        chi=chi,
        chi_low=low,
        chi_high=high,
    )


def _normal_velocity(state: State, arm: Array) -> float:
    """Vertical velocity [m/s] of a point of the die at `arm` from its centre."""
    return float(state.velocity_m_s[2] + np.cross(state.omega_rad_s, arm)[2])


def _chi_interval(
    joined: Joined, k: int, t: float, arm: Array, v_before: float, v_after: float, draws: Array
) -> tuple[float, float]:
    """95 % interval of the apparent restitution, by drawing from the joint covariance of both flights."""
    sides = []
    shift = draws[:, joined.time_columns[k]]
    for flight, S, v in zip(joined.flights[k : k + 2], joined.maps[k : k + 2], (v_before, v_after), strict=True):
        w = flight.start.omega_rad_s
        row = np.zeros(12)
        row[3:6] = _turn_derivative(w, arm)
        row[8] = 1.0
        row[9:12] = np.cross(arm, [0.0, 0.0, 1.0])
        # The corner of a spinning die changes its speed within the uncertainty of the instant: 500 m/s² is usual.
        acceleration = float(np.cross(w, np.cross(w, arm))[2]) - GRAVITY_M_S2
        sides.append(v + draws @ (row @ transition(flight, t) @ S) + acceleration * shift)
    low, high = np.percentile(-sides[1] / sides[0], [2.5, 97.5])
    return float(low), float(high)


def _turn_derivative(omega: Array, arm: Array) -> Array:
    """Derivative (3,) of (ω × r)_z with respect to a rotation of r: ẑ·(ω × (δθ × r)) = δθ·(r × (ẑ × ω))."""
    return np.asarray(np.cross(arm, np.cross([0.0, 0.0, 1.0], omega)))
