"""One flight through the poses of its frames: exact motion, and errors that go together from frame to frame.

In flight the motion is a parabola and a constant angular velocity ω. With E = exp(ω τ) and left (world) increments of a
rotation, R_true = exp(δθ) R, a state changes its pose a time τ later by

    δp(τ) = δp + τ δv          δθ(τ) = E δθ + τ J(ω τ) δω          J: left Jacobian of SO(3).

**Errors.** A frame's six errors, whitened by the covariance that the frame states (z = C^-½ e), are taken as

    z_k = w_k + c_k + C_k^-½ L_k s,     Var w = σ²,   Var c = σ² a,   corr(c_j, c_k) = exp(-|t_j - t_k|/T),

with σ, a and T for each of the six (`Scatter`). w is the noise of the frame's own pixels. c is what shading, grain and
marks do while they move slowly over the edges: a first-order autoregression. L s is what errs alike on every frame of
the clip (`lean`), with s a few numbers that all flights share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan2, cos, exp, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import compiled, inner
from ..model.motion import GRAVITY_M_S2, Flight, State
from ..model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between

Array = NDArray[np.float64]

SLACK_POSITION_M, SLACK_ROTATION_RAD = 1.5e-5, 1.0e-3
"""Added to each frame's own sigma where nothing has measured yet what shading and marks do to a pose beyond its noise."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """How the frames' whitened errors compare with what the frames state, and how long they stay alike: six of each."""

    scale: Array
    """(6,) σ: factor on the frame's own sigma, for the white part."""
    wander: Array
    """(6,) a: variance of the slow part, in units of the white part's."""
    memory_s: Array
    """(6,) T: time after which the slow part has forgotten all but 1/e of itself."""

    @staticmethod
    def white(scale: float = 1.0) -> Scatter:
        """Frames that err each for itself, by so many times what they state."""
        return Scatter(np.full(6, scale), np.zeros(6), np.ones(6))

    @property
    def variance(self) -> Array:
        """(6,) of a single whitened error: σ² (1 + a)."""
        return self.scale**2 * (1.0 + self.wander)

    def slow_variance(self, spacing_s: float) -> Array:
        """(6,) of a single whitened error as it counts in a mean over many frames so far apart: its spectral density at
        frequency zero, σ² (1 + a (1 + φ)/(1 - φ)) with φ = exp(-spacing/T)."""
        keep = np.exp(-spacing_s / self.memory_s)
        return np.asarray(self.scale**2 * (1.0 + self.wander * (1.0 + keep) / (1.0 - keep)))


@dataclass(frozen=True, eq=False)
class Sightings:
    """Poses of single frames, as the fits want them."""

    time_s: Array
    position_m: Array
    quaternion: Array
    whitener: Array
    """(n, 6, 6): W with WᵀW the inverse covariance."""
    lean: Array
    """(n, 6, m) change of the pose for each of m errors that the whole clip shares; m may be 0."""

    @staticmethod
    def from_poses(
        time_s: Array, position_m: Array, quaternion: Array, covariance: Array, *, slack: float = 1.0
    ) -> Sightings:
        """Poses of frames (n,) with their covariance (n, 6, 6), slack added; where that is NaN, the usual slack alone."""
        most = np.diag([SLACK_POSITION_M**2] * 3 + [SLACK_ROTATION_RAD**2] * 3)
        known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
        C = np.where(known[:, None, None], np.where(known[:, None, None], covariance, 0.0) + slack**2 * most, most)
        return Sightings(time_s, position_m, quaternion, _whiteners(C), np.zeros((len(time_s), 6, 0)))

    def leaning(self, lean: Array) -> Sightings:
        """The same frames with errors (n, 6, m) that the clip shares."""
        return replace(self, lean=np.ascontiguousarray(lean))

    def rows(self, which: NDArray[np.int64] | slice) -> Sightings:
        """Some of the frames."""
        return Sightings(
            self.time_s[which], self.position_m[which], self.quaternion[which], self.whitener[which], self.lean[which]
        )

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, eq=False)
class Sums:
    """Normal equations of one flight about a guess of its state."""

    normal: Array
    """(12 + m, 12 + m) of the state and the shared errors."""
    gradient: Array
    """(12 + m,) of half the cost."""
    cost: float
    """Sum of weighted squared residuals."""
    squares: Array
    """(n,) mean of each frame's six squared whitened residuals, each over its expected one."""


def flight_sums(seen: Sightings, state: State, shared: Array, weights: Array, share: Array, usual: Array) -> Sums:
    """Normal equations of the frames of one flight with `shared` (m,) errors taken out, frames weighted (n,) and the six
    whitened numbers by `share` (6,); `usual` (6,) are the inverse variances that make `squares`."""
    size = 12 + seen.lean.shape[2]
    normal, gradient, squares = np.zeros((size, size)), np.zeros(size), np.zeros(len(seen))
    cost = _sums(
        *_arrays(seen), seen.lean, weights, share, usual, _packed(state), shared, normal, gradient, squares
    )  # fmt: skip
    return Sums(normal, gradient, cost, squares)


def flight_meat(seen: Sightings, state: State, weights: Array, share: Array, scatter: Scatter) -> Array:
    """Covariance (12 + m, 12 + m) of the gradient of `flight_sums` when the errors are as `scatter` says: the middle of a
    sandwich."""
    size = 12 + seen.lean.shape[2]
    meat = np.zeros((size, size))
    strength = share**2 * scatter.scale**2
    _meat(*_arrays(seen), seen.lean, weights, strength, _packed(state), scatter.wander, scatter.memory_s, meat)
    return meat


def fit_flight(seen: Sightings) -> tuple[State, Array, float]:
    """One flight through some frames, each erring for itself: its state at the middle frame, the covariance (12, 12) of
    that state, and the sum of squared sigmas left. At least two frames.

    Gauss-Newton on the exact motion, from the mean spin between neighbours and a line through the positions (fall taken
    out), until a step gains less than a thousandth.
    """
    packed, inverse = np.empty(14), np.empty((12, 12))
    left = _fit(*_arrays(seen), packed, inverse)
    state = State(float(packed[0]), packed[1:4], packed[4:8], packed[8:11], packed[11:14])
    return state, inverse, float(left)


def seen_minus_motion(seen: Sightings, state: State) -> Array:
    """Whitened residuals (n, 6) of frames from one motion."""
    p, q = Flight(state, np.inf).poses(seen.time_s)
    raw = np.concatenate([seen.position_m - p, rotation_between(q, seen.quaternion)], axis=1)
    return np.asarray((seen.whitener @ raw[:, :, None])[:, :, 0])


def misfits(seen: Sightings, state: State) -> Array:
    """Distance (n,) of frames from a motion, in sigmas (root mean square of six)."""
    return np.asarray(np.sqrt((seen_minus_motion(seen, state) ** 2).mean(1)))


def left_jacobians(v: Array) -> Array:
    """J(v) (n, 3, 3) with exp(v + δ) = exp(J δ) exp(v), for v (n, 3). Below 1e-3 rad the series is used: it is
    exact to rounding there, while (v - sin v)/v³ has lost seven digits."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    V = np.zeros((len(v), 3, 3))
    V[:, 0, 1], V[:, 0, 2], V[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    V -= V.transpose(0, 2, 1)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + first * V + second * (V @ V))


def transitions(flight: Flight, times_s: Array) -> Array:
    """Derivatives (n, 12, 12) of the state at instants (n,) with respect to the flight's start state."""
    tau = np.asarray(times_s, float) - flight.start.time_s
    turns = np.outer(tau, flight.start.omega_rad_s)
    M = np.tile(np.eye(12), (len(tau), 1, 1))
    M[:, 0:3, 6:9] = tau[:, None, None] * np.eye(3)
    M[:, 3:6, 3:6] = matrix_from_quat(quat_from_rotvec(turns))
    M[:, 3:6, 9:12] = tau[:, None, None] * left_jacobians(turns)
    return M


def transition(flight: Flight, time_s: float) -> Array:
    """Derivative (12, 12) of the state at one instant with respect to the flight's start state."""
    return np.asarray(transitions(flight, np.array([time_s]))[0])


def carried_on(state: State, time_s: float) -> tuple[State, Array]:
    """The state at another instant of the same flight, and its derivative (12, 12): `transition` without the cost of many
    small calls."""
    out, M = np.empty(14), np.zeros((12, 12))
    _carry(_packed(state), time_s, out, M)
    return State(time_s, out[1:4], out[4:8], out[8:11], out[11:14]), M


def rotation_matrix(quaternion: Array) -> Array:
    """(3, 3) of one unit quaternion wxyz."""
    w, x, y, z = quaternion.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def moved(state: State, change: Array) -> State:
    """The state after a change of position, rotation vector, velocity and angular velocity (12,)."""
    return State(
        state.time_s,
        state.position_m + change[0:3],
        quat_multiply(quat_from_rotvec(change[3:6]), state.quaternion),
        state.velocity_m_s + change[6:9],
        state.omega_rad_s + change[9:12],
    )


OPEN_PIVOT = 1e-8
"""Squared pivot of a scaled matrix below which the data may leave something open: rounding moves one by some 1e-14."""


def scaled_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix whose parameters differ by ten orders of magnitude (seconds, metres, rad/s): the
    diagonal is scaled to one first, and what the data leave open gets the pseudo-inverse.

    The pseudo-inverse wants eigenvalues, which take a hundred times as long as Cholesky's factor: it is kept for where
    that finds a pivot too small.
    """
    unit = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(unit, unit)
    if _is_settled(scaled):
        inverse = np.linalg.inv(scaled)
        inverse = 0.5 * (inverse + inverse.T)
    else:
        inverse = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)
    return np.asarray(inverse * np.outer(unit, unit))


def _is_settled(scaled: Array) -> bool:
    try:
        pivots = np.diag(np.linalg.cholesky(scaled))
    except np.linalg.LinAlgError:
        return False
    return bool(pivots.min() ** 2 > OPEN_PIVOT)


def _whiteners(C: Array) -> Array:
    """C^-½ (n, 6, 6), symmetric with metres and radians scaled to each other: it turns with the covariance, where a
    triangular factor would mix axes in an order that means nothing."""
    unit = np.sqrt(np.einsum("nii->i", C) / max(len(C), 1))
    unit = np.repeat([np.sqrt((unit[:3] ** 2).mean()), np.sqrt((unit[3:] ** 2).mean())], 3)
    values, vectors = np.linalg.eigh(C / np.outer(unit, unit))
    root = (vectors / np.sqrt(np.maximum(values, 1e-14))[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.ascontiguousarray(root / unit)


def _arrays(seen: Sightings) -> tuple[Array, Array, Array, Array]:
    return (
        np.ascontiguousarray(seen.time_s, np.float64),
        np.ascontiguousarray(seen.position_m),
        np.ascontiguousarray(seen.quaternion),
        np.ascontiguousarray(seen.whitener),
    )


def _packed(state: State) -> Array:
    """(14,): time, position, quaternion, velocity, angular velocity."""
    return np.concatenate([[state.time_s], state.position_m, state.quaternion, state.velocity_m_s, state.omega_rad_s])


# --- kernels ----------------------------------------------------------------------------------------------------------


@compiled(nogil=True)
def _sums(
    time: Array, position: Array, quaternion: Array, W: Array, lean: Array, weight: Array, share: Array, usual: Array,
    state: Array, shared: Array, normal: Array, gradient: Array, squares: Array,
) -> float:  # fmt: skip
    """Fill the normal equations of one flight; returns the cost."""
    size = 12 + lean.shape[2]
    rows = np.empty((6, size + 1))
    cost = 0.0
    for k in range(len(time)):
        _rows(time[k], position[k], quaternion[k], W[k], lean[k], state, shared, rows)
        squares[k] = 0.0
        for i in range(6):
            squares[k] += usual[i] * rows[i, size] ** 2 / 6.0
            counts = weight[k] * share[i]
            for a in range(size):
                part = counts * rows[i, a]
                for b in range(a + 1):
                    normal[a, b] += part * rows[i, b]
                gradient[a] -= part * rows[i, size]
            cost += counts * rows[i, size] ** 2
    for a in range(size):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return cost


@compiled(nogil=True)
def _meat(
    time: Array, position: Array, quaternion: Array, W: Array, lean: Array, weight: Array, strength: Array,
    state: Array, wander: Array, memory_s: Array, meat: Array,
) -> None:  # fmt: skip
    """Fill Xᵀ V X for V = 1 + a exp(-|t_j - t_k|/T), rows weighted: frame by frame against what the frames before have
    left, so that the cost is linear."""
    m = lean.shape[2]
    size = 12 + m
    rows, before, none = np.empty((6, size + 1)), np.zeros((6, size)), np.zeros(m)
    for k in range(len(time)):
        _rows(time[k], position[k], quaternion[k], W[k], lean[k], state, none, rows)
        for i in range(6):
            for a in range(size + 1):
                rows[i, a] *= weight[k]
        for i in range(6):
            if k > 0:
                left = exp(-(time[k] - time[k - 1]) / memory_s[i])
                for a in range(size):
                    before[i, a] *= left
            slow = strength[i] * wander[i]
            for a in range(size):
                own, past = rows[i, a], before[i, a]
                for b in range(a + 1):
                    meat[a, b] += (strength[i] + slow) * own * rows[i, b]
                    meat[a, b] += slow * (own * before[i, b] + past * rows[i, b])
            for a in range(size):
                before[i, a] += rows[i, a]
    for a in range(size):
        for b in range(a):
            meat[b, a] = meat[a, b]


@inner
def _rows(
    time: float, position: Array, quaternion: Array, W: Array, lean: Array, state: Array, shared: Array, rows: Array
) -> None:
    """Rows of one frame: derivative of the whitened motion with respect to the state (12,) and the shared errors (m,),
    and in the last column seen minus motion."""
    dt = time - state[0]
    x, y, z = state[11] * dt, state[12] * dt, state[13] * dt
    angle = sqrt(x * x + y * y + z * z)
    E, L = _turn_matrices(x, y, z, angle, dt)
    e = np.empty(6)
    for i in range(3):
        e[i] = position[i] - state[1 + i] - dt * state[8 + i]
    e[2] += 0.5 * GRAVITY_M_S2 * dt * dt
    half = sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    q = _product(cos(0.5 * angle), half * x, half * y, half * z, state[4], state[5], state[6], state[7])
    w, a, b, c = _product(quaternion[0], quaternion[1], quaternion[2], quaternion[3], q[0], -q[1], -q[2], -q[3])
    if w < 0.0:
        w, a, b, c = -w, -a, -b, -c
    sine = sqrt(a * a + b * b + c * c)
    factor = 2.0 * atan2(sine, w) / sine if sine > 1e-12 else 2.0
    e[3], e[4], e[5] = factor * a, factor * b, factor * c
    last = rows.shape[1] - 1
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += W[i, j] * e[j]
        rows[i, last] = total
        for j in range(3):
            rows[i, j] = W[i, j]
            rows[i, 6 + j] = dt * W[i, j]
            turned, spun = 0.0, 0.0
            for b_ in range(3):
                turned += W[i, 3 + b_] * E[b_, j]
                spun += W[i, 3 + b_] * L[b_, j]
            rows[i, 3 + j] = turned
            rows[i, 9 + j] = spun
        for j in range(len(shared)):
            leans = 0.0
            for b_ in range(6):
                leans += W[i, b_] * lean[b_, j]
            rows[i, 12 + j] = leans
            rows[i, last] -= leans * shared[j]


@compiled(nogil=True)
def _carry(state: Array, time: float, out: Array, M: Array) -> None:
    """The state (14,) at another instant, and its derivative (12, 12)."""
    dt = time - state[0]
    x, y, z = state[11] * dt, state[12] * dt, state[13] * dt
    angle = sqrt(x * x + y * y + z * z)
    E, L = _turn_matrices(x, y, z, angle, dt)
    half = sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    q = _product(cos(0.5 * angle), half * x, half * y, half * z, state[4], state[5], state[6], state[7])
    for i in range(14):
        out[i] = state[i]
    out[0] = time
    for i in range(3):
        out[1 + i] += dt * state[8 + i]
        M[i, i], M[6 + i, 6 + i], M[9 + i, 9 + i], M[i, 6 + i] = 1.0, 1.0, 1.0, dt
        for j in range(3):
            M[3 + i, 3 + j], M[3 + i, 9 + j] = E[i, j], L[i, j]
    out[3] -= 0.5 * GRAVITY_M_S2 * dt * dt
    out[10] -= GRAVITY_M_S2 * dt
    for i in range(4):
        out[4 + i] = q[i]


@inner
def _turn_matrices(x: float, y: float, z: float, angle: float, dt: float) -> tuple[Array, Array]:
    """exp(v) and dt J(v) of v = (x, y, z); the series below 1e-3 rad as in `left_jacobians`."""
    square = angle * angle
    if angle < 1e-3:
        sine, first, second = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        sine = sin(angle) / angle
        first, second = (1.0 - cos(angle)) / square, (angle - sin(angle)) / (square * angle)
    v = (x, y, z)
    E, L = np.empty((3, 3)), np.empty((3, 3))
    cross = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    for i in range(3):
        for j in range(3):
            straight = 1.0 if i == j else 0.0
            twice = v[i] * v[j] - square * straight
            E[i, j] = straight + sine * cross[i][j] + first * twice
            L[i, j] = dt * (straight + first * cross[i][j] + second * twice)
    return E, L


@inner
def _product(
    aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float]:
    """Hamilton product of two quaternions wxyz."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@compiled(nogil=True)
def _fit(time: Array, position: Array, quaternion: Array, W: Array, state: Array, inverse: Array) -> float:
    """Gauss-Newton through the frames of one flight, white errors; fills state (14,) and the inverse normal matrix."""
    n = len(time)
    _guess(time, position, quaternion, state)
    lean, weight, none, unit = np.zeros((n, 6, 0)), np.ones(n), np.zeros(0), np.ones(6)
    normal, gradient, squares = np.zeros((12, 12)), np.zeros(12), np.empty(n)
    left = _sums(
        time, position, quaternion, W, lean, weight, unit, unit, state, none, normal, gradient, squares
    )  # fmt: skip
    trial = np.empty(14)
    for _ in range(12):
        _invert(normal, inverse)
        step = np.zeros(12)
        for a in range(12):
            for b in range(12):
                step[a] -= inverse[a, b] * gradient[b]
        _moved(state, step, trial)
        new_normal, new_gradient = np.zeros((12, 12)), np.zeros(12)
        new_left = _sums(
            time, position, quaternion, W, lean, weight, unit, unit, trial, none, new_normal, new_gradient, squares
        )
        if not new_left < left:
            break
        gain = left - new_left
        for a in range(14):
            state[a] = trial[a]
        normal, gradient, left = new_normal, new_gradient, new_left
        if gain < 1e-3 * left:
            break
    _invert(normal, inverse)
    return left


@inner
def _guess(time: Array, position: Array, quaternion: Array, state: Array) -> None:
    """A first state at the middle frame: the mean spin between neighbours, and a line from the first to the last frame
    with the fall taken out. Errors of the frames between cancel in both."""
    n = len(time)
    middle = n // 2
    t0 = time[middle]
    state[0] = t0
    for i in range(4):
        state[4 + i] = quaternion[middle, i]
    span = max(time[n - 1] - time[0], 1e-12)
    state[11], state[12], state[13] = 0.0, 0.0, 0.0
    for k in range(n - 1):
        a, b = quaternion[k], quaternion[k + 1]
        w, x, y, z = _product(b[0], b[1], b[2], b[3], a[0], -a[1], -a[2], -a[3])
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        sine = sqrt(x * x + y * y + z * z)
        factor = 2.0 * atan2(sine, w) / sine if sine > 1e-12 else 2.0
        state[11] += factor * x / span
        state[12] += factor * y / span
        state[13] += factor * z / span
    for i in range(3):
        fall = 0.5 * GRAVITY_M_S2 if i == 2 else 0.0
        first = position[0, i] + fall * (time[0] - t0) ** 2
        last = position[n - 1, i] + fall * (time[n - 1] - t0) ** 2
        state[8 + i] = (last - first) / span if n > 1 else 0.0
        state[1 + i] = position[middle, i]


@inner
def _moved(state: Array, step: Array, out: Array) -> None:
    """The state after a change (12,) of position, rotation vector, velocity and angular velocity."""
    for i in range(14):
        out[i] = state[i]
    for i in range(3):
        out[1 + i] += step[i]
        out[8 + i] += step[6 + i]
        out[11 + i] += step[9 + i]
    angle = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    half = sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    q = _product(
        cos(0.5 * angle), half * step[3], half * step[4], half * step[5], state[4], state[5], state[6], state[7]
    )
    length = sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        out[4 + i] = q[i] / length


@inner
def _invert(matrix: Array, inverse: Array) -> None:
    """Inverse (n, n) of a positive matrix by Cholesky, its diagonal scaled to one; what rounding leaves of a singular
    direction is held by 1e-13."""
    n = len(matrix)
    unit = np.empty(n)
    for i in range(n):
        unit[i] = 1.0 / sqrt(max(matrix[i, i], 1e-300))
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j] * unit[i] * unit[j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = sqrt(max(total, 1e-13))
            else:
                L[i, j] = total / L[j, j]
    for column in range(n):
        x = np.zeros(n)
        x[column] = 1.0
        for i in range(n):
            for k in range(i):
                x[i] -= L[i, k] * x[k]
            x[i] /= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                x[i] -= L[k, i] * x[k]
            x[i] /= L[i, i]
        for i in range(n):
            inverse[i, column] = x[i] * unit[i] * unit[column]
