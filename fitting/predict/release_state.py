"""The release state of a flight, from its frames alone, and where a flight begins and ends in a track.

A prediction must not use later frames, so a flight is followed frame by frame. The motion nearest to the frames so far
(a parabola and a constant ω, as in `free.flights`) predicts the next one, with the variance

    σ² (1 + h),    h = j (Jᵀ J)⁻¹ jᵀ    (J the derivative of the frames so far by the state, j that of the next),

where σ² is the variance of the frames so far about their own flight, of positions and rotations separately. No covariance
of the track is needed. A frame that departs by more than `_SIGMAS` ends the flight if the next one does too (else it is
a bad frame) and if the die is near the table (else the whole track scatters more than it seemed to). A frame taken just
after a bounce may still agree; the last frame of a flight is therefore tested again, more strictly, against those before it.

Two frames determine a state, but not how far it is off: the size of their errors is then that of the flight before, or what the
track states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.errors import InputError
from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import Flight, State, Turning, touching_vertices
from ...tracking.flights import perturbed, pose_jacobian
from ...tracking.track import Track
from ..estimation import covariance_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MIN_FLIGHT_FRAMES = 3
"""Frames that a flight is estimated from by itself: two determine the state, the third the size of the errors."""

LEAST_FRAMES = 2
"""Frames that determine a state."""

_SIGMAS = 7.0
"""Departure at which a frame belongs to another flight. Most bounces make a hundred sigmas, while the standard deviation of
three or four frames is known to a factor of two."""

_STRICT_SIGMAS = 4.0
"""The same for the last frame of a flight that a bounce has ended."""

_FEW_FRAMES_DOUBT = 6.0
"""Allowance d in 1 + d/(3 n - 6), by which departures are divided for a standard deviation from n frames: Student's t of
3 n - 6 degrees of freedom at seven sigmas is as wide."""

_MAX_RATIO = 5.0
"""Standard deviation of frames about a flight, relative to that of the first, beyond which there is no flight: the die rolls or
lies on the table. Few frames determine it within a factor of two."""

_NEAR_TABLE = 0.5
"""Height of the lowest corner, in inscribed radii, below which a departure is a bounce."""

_SIGMA_FLOOR = (1e-6, 1e-5)
"""[m], [rad] smallest standard deviation: a track printed with six digits carries no smaller one."""

_MAX_DEPTH = 0.25
"""Depth of the lowest corner below the table, in inscribed radii, of a usable pose: rounded corners and depth errors of a
camera reach it; a pose beyond is wrong."""

_REFIT_FACTOR = 1.25
"""Growth of a flight, relative to its fitted frames, at which it is fitted again."""

_REFIT_SHARE = 0.5
"""Share of `_SIGMAS` from which a departing frame is tested again after a fit to all frames before it."""

_POSITION_STATE = [0, 1, 2, 6, 7, 8]
"""Components of a state that positions depend on."""

_ROTATION_STATE = [3, 4, 5, 9, 10, 11]
"""Components of a state that rotations depend on."""

_PARTS = ((slice(0, 3), _POSITION_STATE), (slice(3, 6), _ROTATION_STATE))
"""Rows of a pose's derivative, and the columns that are not zero."""

_MAX_STEPS = 6
"""Gauss-Newton steps of the rotation of a flight."""

_STEP_TOLERANCE_RAD = 1e-8
"""Step that ends them: a thousandth of what is measured."""

_MAX_GAP = 1.5
"""Frame intervals between neighbours beyond which a flight is not followed: a longer gap may hide an impact."""

_TIME_ROUNDING_S = 1e-9
"""Rounding of printed times."""


@dataclass(frozen=True, eq=False)
class ReleaseState:
    """The state of a die at the end of the frames it was estimated from."""

    rows: Indices
    """Rows of the track in use, in order."""
    fair_state: State
    """At the time of the last of them, on the track's clock, if the centroid is the centre of mass."""
    covariance: Array
    """(12, 12): position, rotation vector, velocity, angular velocity, world axes, from the scatter of the frames."""
    sigma_m: float
    """Standard deviation of the frames about the flight, of one axis."""
    sigma_rad: float
    """The same."""
    begin_s: float
    """Time of the first of them."""
    offset_derivative: Array
    """(2, 3, 3): derivative of the position and the velocity of the centre of mass by its offset from the centroid, in body
    axes."""
    gravity_m_s2: float
    """Of the track."""
    turning: Turning
    """Of the track: how the die turns in flight."""
    centre_of_mass_m: Array | None = None
    """(3,) from the centroid, body axes; None where it is the centroid."""

    @cached_property
    def state(self) -> State:
        """Of the centroid, at the time of the last row."""
        centre = self.centre_state
        if self.centre_of_mass_m is None:
            return centre
        arm = -(centre.rotation @ self.centre_of_mass_m)
        return replace(
            centre,
            position_m=centre.position_m + arm,
            velocity_m_s=centre.velocity_m_s + np.cross(centre.omega_rad_s, arm),
        )

    @cached_property
    def centre_state(self) -> State:
        """Of the centre of mass."""
        if self.centre_of_mass_m is None:
            return self.fair_state
        return replace(
            self.fair_state,
            position_m=self.fair_state.position_m + self.offset_derivative[0] @ self.centre_of_mass_m,
            velocity_m_s=self.fair_state.velocity_m_s + self.offset_derivative[1] @ self.centre_of_mass_m,
        )

    @property
    def frame_covariance(self) -> Array:
        """(6, 6) of the pose of one frame, as far as these show it."""
        return np.diag(np.repeat([self.sigma_m**2, self.sigma_rad**2], 3))

    def of_die(self, die: Die) -> ReleaseState:
        """The same frames as a flight of this die, whose centre of mass falls freely while the centroid circles it."""
        return replace(self, centre_of_mass_m=die.centre_of_mass_m)

    def has_residuals_like(self, other: ReleaseState) -> bool:
        """Whether the frames are as near to a flight as those of another."""
        return self.sigma_m <= _MAX_RATIO * other.sigma_m and self.sigma_rad <= _MAX_RATIO * other.sigma_rad

    def covers(self, times_s: Array) -> NDArray[np.bool_]:
        """Whether times (n,) are finite and not before the first row."""
        return np.asarray(np.isfinite(times_s) & (times_s >= self.begin_s - _TIME_ROUNDING_S))

    def poses(self, times_s: Array) -> tuple[Array, Array]:
        """Positions (n, 3) and quaternions (n, 4) of the centroid from the first row to the last."""
        end_s = self.fair_state.time_s
        flight = Flight(self.centre_state, end_s, gravity_m_s2=self.gravity_m_s2, turning=self.turning)
        positions, quaternions = flight.poses(times_s)
        if self.centre_of_mass_m is not None:
            positions = positions - matrix_from_quat(quaternions) @ self.centre_of_mass_m
        return positions, quaternions


def usable_rows(track: Track, die: Die) -> Indices:
    """Rows of a track that have a pose over the table. Raises ValueError for times that do not increase.

    A die that is only coming into view may be seen deep in the table, by frames that agree with each other.
    """
    poses = np.hstack([track.position_m, track.quaternion])
    rows = np.flatnonzero(track.tracked & np.isfinite(poses).all(1) & np.isfinite(track.time_s))
    back = np.flatnonzero(np.diff(track.time_s[rows]) <= 0.0)
    if len(back):
        at = track.time_s[rows[back[0] + 1]]
        raise InputError(f"t_s = {at:g} does not rise; wanted times in order: sort the track, or cut it there")
    turned = matrix_from_quat(track.quaternion[rows])[:, 2] @ touching_vertices(die).T
    lowest = turned.min(axis=1, initial=np.inf) + track.position_m[rows, 2] - die.corner_radius_m
    return rows[lowest > -_MAX_DEPTH * die.solid.inradius]


def first_bounce_row(track: Track, die: Die) -> int:
    """Row of the first frame after the first bounce. Raises ValueError if the track shows none, or begins too late."""
    rows, needed = usable_rows(track, die), MIN_FLIGHT_FRAMES + 1
    if len(rows) < needed:
        raise InputError(f"{len(rows)} frames have a pose; wanted at least {needed}, before a bounce and after it")
    begin = 0
    while len(rows) - begin > MIN_FLIGHT_FRAMES:
        end = begin + flight_length(track, die, rows[begin:])
        if end == len(rows):
            break
        if not _gap_after(track, rows, end - 1):
            return int(rows[end])
        begin = end
    raise InputError("the die never bounces: no flight in the track ends at the table; wanted a track that reaches it")


def release_before(track: Track, die: Die, row: int) -> ReleaseState:
    """The state from the frames of the flight that the last frame before `row` belongs to, without any later frame.

    The end of a flight is found as for a fair die: within a flight the centroid departs little from its parabola.

    Raises ValueError if the flight has fewer than three frames (two where the size of their errors is known), and if the die no
    longer flies.
    """
    rows = usable_rows(track, die)
    rows = rows[rows < row]
    begin, first = 0, None
    # Forwards from the first frame: backwards, three frames on both sides of a bounce would pass for a flight.
    while len(rows) - begin >= MIN_FLIGHT_FRAMES:
        count = flight_length(track, die, rows[begin:])
        if first is None:
            first = release_from(track, rows[:count])
        begin += count
        if begin == len(rows):
            last = release_from(track, rows[begin - count :])
            if last.has_residuals_like(first):
                return last.of_die(die)
            raise InputError(
                f"the {count} frames before row {row} make no free flight: they scatter by {1e3 * last.sigma_m:.2g} mm and "
                f"{np.degrees(last.sigma_rad):.2g} degrees about the nearest one; wanted a frame before the die rolls or lies"
            )
    left = rows[begin:]
    if len(left) == LEAST_FRAMES:
        covariances = track.covariance[left] if first is None else np.tile(first.frame_covariance, (LEAST_FRAMES, 1, 1))
        if np.isfinite(covariances).all():
            return _from_two_frames(track, left, covariances).of_die(die)
    raise InputError(
        f"{len(left)} frames with a pose lie before row {row} in one flight; wanted at least {MIN_FLIGHT_FRAMES}, or "
        f"{LEAST_FRAMES} whose errors the track states: begin from another frame"
    )


def release_from(track: Track, rows: Indices) -> ReleaseState:
    """The state from three rows or more that are known to belong to one flight."""
    state, errors, jacobian = _nearest(track, rows)
    sigmas = _standard_deviations(errors)
    return _release(track, rows, state, covariance_of(jacobian / np.repeat(sigmas, 3)[None, :, None]), sigmas)


def _from_two_frames(track: Track, rows: Indices, covariances: Array) -> ReleaseState:
    """The state through two rows of one flight, whose poses have these covariances (2, 6, 6)."""
    state, _, jacobian = _nearest(track, rows)
    variances = np.diagonal(covariances, axis1=1, axis2=2).reshape(-1, 2, 3).mean(axis=(0, 2))
    sigma_m, sigma_rad = np.sqrt(variances).tolist()
    whitened = np.linalg.solve(np.linalg.cholesky(covariances), jacobian)
    return _release(track, rows, state, covariance_of(whitened), (sigma_m, sigma_rad))


def _release(track: Track, rows: Indices, state: State, covariance: Array, sigmas: tuple[float, float]) -> ReleaseState:
    (sigma_m, sigma_rad), times = sigmas, track.time_s[rows]
    return ReleaseState(
        rows, state, covariance, sigma_m, sigma_rad, float(times[0]), _derivative_by_offset(track, state, times),
        track.gravity_m_s2, track.turning,
    )  # fmt: skip


def flight_length(track: Track, die: Die, rows: Indices) -> int:
    """How many of `rows` (three or more) belong to the flight that they begin with."""
    motion, ended = _Motion.through(track, rows[:MIN_FLIGHT_FRAMES]), len(rows)
    for n in range(MIN_FLIGHT_FRAMES, len(rows)):
        if _gap_after(track, rows, n - 1):
            return n
        if n > _REFIT_FACTOR * motion.frames:
            motion = _Motion.through(track, rows[:n], motion)
        if motion.frames < n and motion.departure(track, rows[n]) > _REFIT_SHARE * _SIGMAS:
            motion = _Motion.through(track, rows[:n], motion)
        if motion.departure(track, rows[n]) <= _SIGMAS:
            continue
        repeated = n + 1 == len(rows) or motion.departure(track, rows[n + 1]) > _SIGMAS
        if repeated and motion.lowest_m(die, float(track.time_s[rows[n]])) < _NEAR_TABLE * die.solid.inradius:
            ended = n
            break
    else:
        return ended
    last = ended - 1
    if last > MIN_FLIGHT_FRAMES:
        without_last = _Motion.through(track, rows[:last], motion)
        if without_last.departure(track, rows[last]) > _STRICT_SIGMAS:
            ended -= 1
    return ended


def _gap_after(track: Track, rows: Indices, k: int) -> bool:
    """Whether frames are missing between one of the rows and the next."""
    interval = float(np.median(np.diff(track.time_s[rows])))
    return bool(track.time_s[rows[k + 1]] - track.time_s[rows[k]] > _MAX_GAP * interval)


@dataclass(frozen=True, eq=False)
class _Motion:
    """The flight nearest to some frames, and how well they determine it."""

    flight: Flight
    """Its state is that of the last of them."""
    frames: int
    sigmas: tuple[float, float]
    """Standard deviations [m], [rad] of one axis."""
    covariances: tuple[Array, Array]
    """(6, 6) of position and velocity, and of rotation and angular velocity, for errors of standard deviation 1."""

    @classmethod
    def through(cls, track: Track, rows: Indices, guess: _Motion | None = None) -> _Motion:
        """The flight of these rows; a guess is that of fewer of them."""
        state, errors, jacobian = _nearest(track, rows, None if guess is None else guess.flight)
        position, rotation = (covariance_of(jacobian[:, part][:, :, columns]) for part, columns in _PARTS)
        return cls(_flight(track, state), len(rows), _standard_deviations(errors), (position, rotation))

    def departure(self, track: Track, row: np.int64) -> float:
        """Sigmas by which a frame departs from it."""
        time = float(track.time_s[row])
        predicted = self.flight.at(time)
        turned = rotation_between(predicted.quaternion[None], track.quaternion[row][None])[0]
        ahead = pose_jacobian(self.flight, np.array([time]))[0]
        doubt = 1.0 + _FEW_FRAMES_DOUBT / max(3 * self.frames - 6, 1)
        worst = 0.0
        for k, error in enumerate((track.position_m[row] - predicted.position_m, turned)):
            part, columns = _PARTS[k]
            j = ahead[part][:, columns]
            h = np.trace(j @ self.covariances[k] @ j.T) / 3.0
            worst = max(worst, float(np.linalg.norm(error)) / (np.sqrt(3.0 * (1.0 + h)) * self.sigmas[k] * doubt))
        return worst

    def lowest_m(self, die: Die, time_s: float) -> float:
        """Height of the lowest corner that it predicts."""
        predicted = self.flight.at(time_s)
        heights = touching_vertices(die) @ matrix_from_quat(predicted.quaternion)[2]
        return float(heights.min() + predicted.position_m[2] - die.corner_radius_m)


def _standard_deviations(errors: Array) -> tuple[float, float]:
    """Of one axis of positions [m] and rotations [rad] (n, 6), corrected for the degrees of freedom of the fit."""
    freedom = max(3.0 * len(errors) - 6.0, 1.0)
    squares = (errors.reshape(-1, 2, 3) ** 2).sum((0, 2)) / freedom
    sigma_m, sigma_rad = np.maximum(np.sqrt(squares), _SIGMA_FLOOR)
    return float(sigma_m), float(sigma_rad)


def _nearest(track: Track, rows: Indices, guess: Flight | None = None) -> tuple[State, Array, Array]:
    """Least squares of the flight over some rows: state at the last of them, errors (n, 6) and derivatives (n, 6, 12).

    Positions and rotations are independent in flight. The former are linear in the state, the latter nearly so.
    """
    times, positions, quaternions = track.time_s[rows], track.position_m[rows], track.quaternion[rows]
    dt = times - times[-1]
    straight = positions + np.outer(0.5 * track.gravity_m_s2 * dt**2, [0.0, 0.0, 1.0])
    line = np.linalg.lstsq(np.stack([np.ones_like(dt), dt], 1), straight, rcond=None)[0]
    if guess is None:
        turns = rotation_between(quaternions[:-1], quaternions[1:]) / np.diff(times)[:, None]
        turned, omega = quaternions[-1], np.median(turns, axis=0)
    else:
        turned, omega = guess.at(float(times[-1])).quaternion, guess.start.omega_rad_s
    state = State(float(times[-1]), line[0], turned, line[1], omega)
    for _ in range(_MAX_STEPS):
        errors, jacobian = _errors(_flight(track, state), times, positions, quaternions)
        by_rotation = jacobian[:, 3:][:, :, _ROTATION_STATE].reshape(-1, 6)
        step = np.linalg.lstsq(by_rotation, errors[:, 3:].ravel(), rcond=None)[0]
        if np.abs(step[:3]).max() < _STEP_TOLERANCE_RAD:
            break
        change = np.zeros(12)
        change[_ROTATION_STATE] = step
        state = perturbed(state, change)
    return state, errors, jacobian


def _flight(track: Track, state: State) -> Flight:
    """The flight of a die that falls as in a track, from a state on."""
    return Flight(state, state.time_s, gravity_m_s2=track.gravity_m_s2, turning=track.turning)


def _errors(flight: Flight, times: Array, positions: Array, quaternions: Array) -> tuple[Array, Array]:
    """Errors (n, 6) of poses about a flight, and the derivatives (n, 6, 12) of its poses."""
    flown, turned = flight.poses(times)
    return np.hstack([positions - flown, rotation_between(turned, quaternions)]), pose_jacobian(flight, times)


def _derivative_by_offset(track: Track, state: State, times: Array) -> Array:
    """`ReleaseState.offset_derivative`: the straight line nearest to R(t), by which the centre of mass differs from a centroid
    that falls freely."""
    dt = times - state.time_s
    rotations = matrix_from_quat(_flight(track, state).poses(times)[1])
    line = np.linalg.pinv(np.stack([np.ones_like(dt), dt], 1))
    return np.asarray(np.einsum("an,nij->aij", line, rotations), dtype=np.float64)
