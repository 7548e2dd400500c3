"""Where a flight begins and ends in a track, seen from its frames alone, and the state with which the die left it.

For predictions: a state from some frames must not know what later frames show. So a flight is grown frame by frame.
The motion nearest to the frames so far (`flights`: a parabola, a constant ω) foretells the next one, with the variance

    σ² (1 + h),    h = j (Jᵀ J)⁻¹ jᵀ    (J the derivative of the frames so far by the state, j that of the next),

σ² from how the frames so far scatter about their own flight, for positions and rotations apart: no covariance of the
track is asked for. A frame that misses by more than `_SIGMAS` ends the flight, if the one after it misses too (else it is
a bad frame) and if the die is near the table (else the whole track scatters more than it seemed to). A frame taken just
after a bounce may still agree; the last frame of a flight is therefore asked again, more strictly, of those before it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ...model.throw import Flight, State, touching_vertices
from ...model.world import GRAVITY_M_S2
from ...tracking.track import Track
from ..free import flight_jacobian, moved_state

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FEWEST = 3
"""Frames that a flight is told from: two fix the state, the third says how large the errors are."""

_SIGMAS = 7.0
"""Miss at which a frame belongs to another flight: a bounce is a hundred sigmas on most, while the scatter of three or
four frames is known to a factor of two."""

_STRICT_SIGMAS = 4.0
"""The same for the last frame of a flight that a bounce has ended."""

_CONTACT = 5.0
"""Scatter of frames about a flight, in that of the first, beyond which it is none: there the die rolls or lies on the
table. Few frames tell it within a factor of two."""

_NEAR_TABLE = 0.5
"""Part of the inscribed radius within which the lowest corner must be for a miss to be a bounce."""

_LEAST = (1e-6, 1e-5)
"""[m], [rad] smallest scatter believed: a track printed with six digits has no less."""

_SUNK = 0.25
"""Part of the inscribed radius by which a pose may have its lowest corner below the table: what rounding of corners and
depth errors of a camera do; a pose that is worse is none."""

_AHEAD = 1.25
"""How many times its own frames a flight may foretell before it is fitted anew. A frame that misses by half of what ends
a flight is asked again of all before it."""

_PARTS = ((slice(0, 3), [0, 1, 2, 6, 7, 8]), (slice(3, 6), [3, 4, 5, 9, 10, 11]))
"""Rows of a pose's derivative, and the columns of the state that these depend on: places and turns."""

_MOST_STEPS, _CLOSE_RAD = 6, 1e-8
"""Of the least squares of a flight: no more than so many, and none for less than a thousandth of what is measured."""

_GAP = 1.5
"""Frame intervals between neighbours beyond which a flight is not followed: an impact may hide in a longer gap."""


@dataclass(frozen=True, eq=False)
class Outset:
    """The state of a die at the end of the frames it was told from."""

    rows: Indices
    """Rows of the track in use, in order."""
    fair_state: State
    """At the time of the last of them, on the track's clock, if the centroid is the centre of mass."""
    covariance: Array
    """(12, 12): position, rotation vector, velocity, angular velocity, world axes, from the frames' own scatter."""
    sigma_m: float
    sigma_rad: float
    """Scatter of the frames about the flight, of one axis."""
    begin_s: float
    """Time of the first of them."""
    swing: Array
    """(2, 3, 3): by what position and velocity of the centre of mass differ from those of `fair_state` for every metre
    at which it lies from the centroid, along the axes of the body."""
    centre_of_mass_m: Array | None = None
    """(3,) from the centroid, body axes; None where it is the centroid."""

    @cached_property
    def state(self) -> State:
        """Of the centroid, at the time of the last row."""
        return _shifted(self.centre_state, self.centre_of_mass_m, -1.0)

    def of_die(self, die: Die) -> Outset:
        """The same frames as a flight of this die: what falls freely is its centre of mass, which the centroid circles."""
        return replace(self, centre_of_mass_m=die.centre_of_mass_m)

    def scatters_like(self, other: Outset) -> bool:
        """Whether the frames are as near to a flight as those of another."""
        return self.sigma_m <= _CONTACT * other.sigma_m and self.sigma_rad <= _CONTACT * other.sigma_rad

    def poses(self, times_s: Array) -> tuple[Array, Array]:
        """Positions (n, 3) and quaternions (n, 4) of the centroid from the first row to the last."""
        flight = Flight(_at(self.centre_state, self.begin_s), self.fair_state.time_s)
        positions, quaternions = flight.poses(times_s)
        if self.centre_of_mass_m is not None:
            positions = positions - matrix_from_quat(quaternions) @ self.centre_of_mass_m
        return positions, quaternions

    @cached_property
    def centre_state(self) -> State:
        """Of the centre of mass."""
        if self.centre_of_mass_m is None:
            return self.fair_state
        return replace(
            self.fair_state,
            position_m=self.fair_state.position_m + self.swing[0] @ self.centre_of_mass_m,
            velocity_m_s=self.fair_state.velocity_m_s + self.swing[1] @ self.centre_of_mass_m,
        )


def usable_rows(track: Track, die: Die) -> Indices:
    """Rows of a track that carry a pose over the table. Raises ValueError for times that do not rise.

    A die that only comes into view is at times seen deep in the table, by frames that agree with each other.
    """
    poses = np.hstack([track.position_m, track.quaternion])
    rows = np.flatnonzero(track.tracked & np.isfinite(poses).all(1) & np.isfinite(track.time_s))
    back = np.flatnonzero(np.diff(track.time_s[rows]) <= 0.0)
    if len(back):
        at = track.time_s[rows[back[0] + 1]]
        raise ValueError(f"t_s = {at:g} does not rise; wanted times in order, so sort the track or cut it there")
    turned = matrix_from_quat(track.quaternion[rows])[:, 2] @ touching_vertices(die).T
    lowest = turned.min(axis=1, initial=np.inf) + track.position_m[rows, 2] - die.corner_radius_m
    return rows[lowest > -_SUNK * die.solid.inradius]


def first_bounce_row(track: Track, die: Die) -> int:
    """Row of the first frame after the first bounce. Raises ValueError where the track shows none, or begins too late."""
    rows = usable_rows(track, die)
    if len(rows) < FEWEST + 1:
        raise ValueError(f"{len(rows)} frames carry a pose; wanted at least {FEWEST + 1}, before a bounce and after it")
    begin = 0
    while len(rows) - begin > FEWEST:
        end = begin + flight_length(track, die, rows[begin:])
        if end == len(rows):
            break
        if not _gap_after(track, rows, end - 1):
            return int(rows[end])
        begin = end
    raise ValueError(
        "the die never bounces: frames show no flight that ends at the table; wanted a track that reaches it"
    )


def outset_before(track: Track, die: Die, row: int) -> Outset:
    """The state from the frames of the flight that the last frame before `row` belongs to; later frames are not looked at.

    Where a flight ends is told as of a fair die: within a flight the centroid leaves its parabola by little.

    Raises ValueError where the flight shows fewer than three frames, and where the die no longer flies.
    """
    rows = usable_rows(track, die)
    rows = rows[rows < row]
    begin, first = 0, None
    # Forwards from the first frame: three frames that a bounce parts would pass for a flight of their own.
    while len(rows) - begin >= FEWEST:
        count = flight_length(track, die, rows[begin:])
        if first is None:
            first = outset_of(track, rows[:count])
        begin += count
        if begin == len(rows):
            last = outset_of(track, rows[begin - count :])
            if last.scatters_like(first):
                return last.of_die(die)
            raise ValueError(
                f"the {count} frames before row {row} make no free flight: they scatter by {1e3 * last.sigma_m:.2g} mm and "
                f"{np.degrees(last.sigma_rad):.2g} degrees about the nearest; wanted a frame before the die rolls or lies"
            )
    raise ValueError(
        f"{len(rows) - begin} frames with a pose lie before row {row} in one flight; wanted at least {FEWEST}: begin from "
        "another frame"
    )


def outset_of(track: Track, rows: Indices) -> Outset:
    """The state from three rows or more that one flight is known to hold."""
    state, errors, jacobian = _nearest(track, rows)
    sigma_m, sigma_rad = _scatter(errors)
    weighted = jacobian / np.repeat([sigma_m, sigma_rad], 3)[None, :, None]
    information = np.einsum("nij,nik->jk", weighted, weighted)
    covariance = np.linalg.pinv(information, rcond=1e-15, hermitian=True)
    begin_s = float(track.time_s[rows[0]])
    return Outset(rows, state, covariance, sigma_m, sigma_rad, begin_s, _swing(state, track.time_s[rows]))


def flight_length(track: Track, die: Die, rows: Indices) -> int:
    """How many of `rows` (three or more) the flight at their beginning lasts."""
    motion, ended = _Motion.through(track, rows[:FEWEST]), len(rows)
    for n in range(FEWEST, len(rows)):
        if _gap_after(track, rows, n - 1):
            return n
        if n > _AHEAD * motion.frames:
            motion = _Motion.through(track, rows[:n], motion)
        if motion.frames < n and motion.miss(track, rows[n]) > 0.5 * _SIGMAS:
            motion = _Motion.through(track, rows[:n], motion)
        if motion.miss(track, rows[n]) <= _SIGMAS:
            continue
        again = n + 1 == len(rows) or motion.miss(track, rows[n + 1]) > _SIGMAS
        if again and motion.lowest_m(die, float(track.time_s[rows[n]])) < _NEAR_TABLE * die.solid.inradius:
            ended = n
            break
    else:
        return ended
    last = ended - 1
    if last > FEWEST and _Motion.through(track, rows[:last], motion).miss(track, rows[last]) > _STRICT_SIGMAS:
        ended -= 1
    return ended


def _gap_after(track: Track, rows: Indices, k: int) -> bool:
    """Whether frames are missing between one of the rows and the next."""
    interval = float(np.median(np.diff(track.time_s[rows])))
    return bool(track.time_s[rows[k + 1]] - track.time_s[rows[k]] > _GAP * interval)


@dataclass(frozen=True, eq=False)
class _Motion:
    """The flight nearest to some frames, and how well they know it."""

    state: State
    frames: int
    sigmas: tuple[float, float]
    """Scatter [m], [rad] of one axis."""
    spreads: tuple[Array, Array]
    """(6, 6) of place and velocity, and of turn and spin, in units of these."""

    @classmethod
    def through(cls, track: Track, rows: Indices, guess: _Motion | None = None) -> _Motion:
        """The flight of these rows; a guess is that of fewer of them."""
        state, errors, jacobian = _nearest(track, rows, None if guess is None else guess.state)
        known = [jacobian[:, part][:, :, columns].reshape(-1, 6) for part, columns in _PARTS]
        spreads = [np.asarray(np.linalg.pinv(k.T @ k, hermitian=True), dtype=np.float64) for k in known]
        return cls(state, len(rows), _scatter(errors), (spreads[0], spreads[1]))

    def miss(self, track: Track, row: np.int64) -> float:
        """By how many sigmas a frame misses it."""
        time = float(track.time_s[row])
        foretold = _at(self.state, time)
        turned = rotation_between(foretold.quaternion[None], track.quaternion[row][None])[0]
        ahead = flight_jacobian(self.state, np.array([time]))[0]
        # Few frames tell their scatter badly: Student's t of 3 n - 6 degrees at seven sigmas is as wide as this.
        doubt = 1.0 + 6.0 / max(3 * self.frames - 6, 1)
        worst = 0.0
        for k, seen in enumerate((track.position_m[row] - foretold.position_m, turned)):
            part, columns = _PARTS[k]
            j = ahead[part][:, columns]
            lever = np.trace(j @ self.spreads[k] @ j.T) / 3.0
            worst = max(worst, float(np.linalg.norm(seen)) / (np.sqrt(3.0 * (1.0 + lever)) * self.sigmas[k] * doubt))
        return worst

    def lowest_m(self, die: Die, time_s: float) -> float:
        """Height of the lowest corner that it foretells."""
        foretold = _at(self.state, time_s)
        heights = touching_vertices(die) @ matrix_from_quat(foretold.quaternion)[2]
        return float(heights.min() + foretold.position_m[2] - die.corner_radius_m)


def _scatter(errors: Array) -> tuple[float, float]:
    """Standard deviation of one axis, of positions [m] and rotations [rad] (n, 6), with what the fit took out put back."""
    freedom = max(3.0 * len(errors) - 6.0, 1.0)
    squares = (errors.reshape(-1, 2, 3) ** 2).sum((0, 2)) / freedom
    sigma_m, sigma_rad = np.maximum(np.sqrt(squares), _LEAST)
    return float(sigma_m), float(sigma_rad)


def _nearest(track: Track, rows: Indices, guess: State | None = None) -> tuple[State, Array, Array]:
    """Least squares of the flight over some rows: state at the last of them, errors (n, 6) and derivatives (n, 6, 12).

    Positions and rotations do not know of each other in flight. The former are linear; the latter nearly so.
    """
    times, positions, quaternions = track.time_s[rows], track.position_m[rows], track.quaternion[rows]
    dt = times - times[-1]
    straight = positions + np.outer(0.5 * GRAVITY_M_S2 * dt**2, [0.0, 0.0, 1.0])
    line = np.linalg.lstsq(np.stack([np.ones_like(dt), dt], 1), straight, rcond=None)[0]
    if guess is None:
        turns = rotation_between(quaternions[:-1], quaternions[1:]) / np.diff(times)[:, None]
        turned, omega = quaternions[-1], np.median(turns, axis=0)
    else:
        turned, omega = _at(guess, float(times[-1])).quaternion, guess.omega_rad_s
    state = State(float(times[-1]), line[0], turned, line[1], omega)
    for _ in range(_MOST_STEPS):
        errors, jacobian = _errors(state, times, positions, quaternions)
        known = jacobian[:, 3:][:, :, [3, 4, 5, 9, 10, 11]].reshape(-1, 6)
        step = np.linalg.lstsq(known, errors[:, 3:].ravel(), rcond=None)[0]
        if np.abs(step[:3]).max() < _CLOSE_RAD:
            break
        change = np.zeros(12)
        change[3:6], change[9:] = step[:3], step[3:]
        state = moved_state(state, change)
    return state, errors, jacobian


def _swing(state: State, times: Array) -> Array:
    """`Outset.swing`: the straight line nearest to R(t), of which the centre of mass takes its place in the body."""
    dt = times - state.time_s
    turned = matrix_from_quat(quat_multiply(quat_from_rotvec(np.outer(dt, state.omega_rad_s)), state.quaternion))
    line = np.linalg.pinv(np.stack([np.ones_like(dt), dt], 1))
    return np.asarray(np.einsum("an,nij->aij", line, turned), dtype=np.float64)


def _shifted(state: State, centre_of_mass_m: Array | None, sign: float) -> State:
    """The state of the centre of mass from that of the centroid (sign 1), or the other way round (-1)."""
    if centre_of_mass_m is None:
        return state
    arm = sign * (state.rotation @ centre_of_mass_m)
    return replace(
        state, position_m=state.position_m + arm, velocity_m_s=state.velocity_m_s + np.cross(state.omega_rad_s, arm)
    )


def _errors(state: State, times: Array, positions: Array, quaternions: Array) -> tuple[Array, Array]:
    dt = times - state.time_s
    flown = state.position_m + np.outer(dt, state.velocity_m_s) - np.outer(0.5 * GRAVITY_M_S2 * dt**2, [0.0, 0.0, 1.0])
    turned = quat_multiply(quat_from_rotvec(np.outer(dt, state.omega_rad_s)), state.quaternion)
    return np.hstack([positions - flown, rotation_between(turned, quaternions)]), flight_jacobian(state, times)


def _at(state: State, time_s: float) -> State:
    """The state carried along its flight, forwards or backwards."""
    dt = time_s - state.time_s
    drop = np.array([0.0, 0.0, GRAVITY_M_S2 * dt])
    return State(
        time_s,
        state.position_m + dt * state.velocity_m_s - 0.5 * dt * drop,
        quat_multiply(quat_from_rotvec(dt * state.omega_rad_s), state.quaternion),
        state.velocity_m_s - drop,
        state.omega_rad_s,
    )
