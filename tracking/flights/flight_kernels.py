"""Compiled kernels of the fits: residuals and normal equations of frames about exact motion, on plain arrays.

A state is packed into 14 numbers: time, position, quaternion, velocity, angular velocity.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from .turning import (
    TINY_ROTATION,
    begin,
    mean_omega,
    omega_after,
    quaternion_after,
    quaternion_product,
    rotation_vector,
    transition_after,
)

Array = NDArray[np.float64]

MAX_STEPS = 12
"""Gauss-Newton steps of a single flight."""
RELATIVE_GAIN = 1e-3
"""A step that gains less than this share of the squares is the last."""
LEAST_PIVOT = 1e-13
"""Least squared pivot of a scaled matrix: what rounding leaves of a singular direction."""


class PoseArrays(NamedTuple):
    """Poses of single frames with their weights."""

    time_s: Array
    """(n,) mid-exposure."""
    position_m: Array
    """(n, 3)."""
    quaternion: Array
    """(n, 4) wxyz."""
    whitener: Array
    """(n, 6, 6) W with WᵀW the inverse covariance."""
    bias_jacobian: Array
    """(n, 6, m) change of the pose for each of m errors that the whole clip shares."""
    gravity: float
    """[m/s²] along -z."""
    turning: Any
    """EvenTurning or TorqueFree."""


class FrameInformation(NamedTuple):
    """What frames say on their poses and the shared errors. It does not depend on the motion: a fit computes it once."""

    matrix: Array
    """(n, 6 + m, 6 + m) inverse covariance."""
    to_gradient: Array
    """(n, 6 + m, 6) from whitened residuals to a gradient."""


class ChainMotion(NamedTuple):
    """The motion of a chain of flights, to be filled."""

    states: Array
    """(N + 1, 14) packed, at the start of each flight."""
    ends: Array
    """(N, 14) at the end of each but the last."""
    transitions: Array
    """(N, 12, 12) from start to end."""


class VertexImpacts(NamedTuple):
    """The impacts of a chain at one vertex each."""

    link: NDArray[np.int64]
    """(S,) link of the chain."""
    point_m: Array
    """(S, 3) the vertex, body frame: the corner of a sharp die, the centre of the inscribed ball of a rounded one."""
    rounding_m: Array
    """(S,) radius of that ball."""
    mass_over_inertia: Array
    """(S, 3, 3) m I⁻¹ [1/m²], body frame."""


class ImpactEquations(NamedTuple):
    """The four conditions of each vertex impact, in sigmas."""

    by_end: Array
    """(S, 4, 12) derivative with respect to the state at the end of the flight before."""
    by_link: Array
    """(S, 4, MAX_LINK_SIZE) derivative with respect to the parameters of the link."""
    violation: Array
    """(S, 4) present values."""


@compiled(nogil=True)
def residuals(poses: PoseArrays, shared: Array, cuts: NDArray[np.int64], states: Array, out: Array) -> None:
    """Fill the whitened residuals (n, 6) of frames: observed minus motion, shared errors subtracted."""
    time, position, quaternion, W, bias_jacobian, gravity, turning = poses
    e, ahead = np.empty(6), np.empty(4)
    for flight in range(len(states)):
        state = states[flight]
        carried = begin(turning, state)
        for k in range(cuts[flight], cuts[flight + 1]):
            dt = time[k] - state[0]
            for i in range(3):
                e[i] = position[k, i] - state[1 + i] - dt * state[8 + i]
            e[2] += 0.5 * gravity * dt * dt
            w, x, y, z = quaternion_after(turning, carried, state, dt)
            ahead[0], ahead[1], ahead[2], ahead[3] = w, x, y, z
            e[3], e[4], e[5] = rotation_vector(ahead, quaternion[k])
            for j in range(len(shared)):
                for b in range(6):
                    e[b] -= bias_jacobian[k, b, j] * shared[j]
            for i in range(6):
                total = 0.0
                for j in range(6):
                    total += W[k, i, j] * e[j]
                out[k, i] = total


@compiled(nogil=True)
def frame_information(poses: PoseArrays, share: Array, out: FrameInformation) -> None:
    """Fill the information of frames whose six whitened numbers count with their share (6,)."""
    W, bias_jacobian = poses.whitener, poses.bias_jacobian
    information, to_gradient = out.matrix, out.to_gradient
    m = bias_jacobian.shape[2]
    columns = np.empty((6, 6 + m))
    for k in range(len(W)):
        for i in range(6):
            for j in range(6):
                columns[i, j] = W[k, i, j]
            for j in range(m):
                total = 0.0
                for b in range(6):
                    total += W[k, i, b] * bias_jacobian[k, b, j]
                columns[i, 6 + j] = total
        for a in range(6 + m):
            for i in range(6):
                to_gradient[k, a, i] = share[i] * columns[i, a]
            for b in range(a + 1):
                total = 0.0
                for i in range(6):
                    total += to_gradient[k, a, i] * columns[i, b]
                information[k, a, b] = total
                information[k, b, a] = total


@compiled(nogil=True)
def normal_equations(
    poses: PoseArrays, frames: FrameInformation, residual: Array, weight: Array, cuts: NDArray[np.int64], states: Array,
    normal: Array, gradient: Array,
) -> None:  # fmt: skip
    """Add the normal equations of each flight to `normal` and `gradient`.

    With the information A of a frame on its pose, and D = (1, τ) for the position and (E, τJ) for the rotation, a frame adds
    Dᵀ A D: the twelve columns need not be whitened one by one."""
    time, turning = poses.time_s, poses.turning
    information, to_gradient = frames.matrix, frames.to_gradient
    size = information.shape[1]
    m = size - 6
    A, frame_gradient = np.empty((size, size)), np.empty(size)
    rotation, AT, TAT = np.empty((3, 6)), np.empty((size, 6)), np.empty((6, 6))
    for flight in range(len(states)):
        state, N, g = states[flight], normal[flight], gradient[flight]
        carried = begin(turning, state)
        for k in range(cuts[flight], cuts[flight + 1]):
            if weight[k] == 0.0:
                continue
            dt = time[k] - state[0]
            transition_after(turning, carried, dt, rotation)
            for a in range(size):
                total = 0.0
                for i in range(6):
                    total += to_gradient[k, a, i] * residual[k, i]
                frame_gradient[a] = weight[k] * total
                for b in range(size):
                    A[a, b] = weight[k] * information[k, a, b]
            for a in range(size):
                for b in range(6):
                    AT[a, b] = A[a, 3] * rotation[0, b] + A[a, 4] * rotation[1, b] + A[a, 5] * rotation[2, b]
            for a in range(6):
                for b in range(6):
                    TAT[a, b] = rotation[0, a] * AT[3, b] + rotation[1, a] * AT[4, b] + rotation[2, a] * AT[5, b]
            for a in range(3):
                g[a] -= frame_gradient[a]
                g[6 + a] -= dt * frame_gradient[a]
                g[3 + a] -= (
                    rotation[0, a] * frame_gradient[3]
                    + rotation[1, a] * frame_gradient[4]
                    + rotation[2, a] * frame_gradient[5]
                )
                g[9 + a] -= (
                    rotation[0, 3 + a] * frame_gradient[3]
                    + rotation[1, 3 + a] * frame_gradient[4]
                    + rotation[2, 3 + a] * frame_gradient[5]
                )
                for b in range(3):
                    N[a, b] += A[a, b]
                    N[6 + a, b] += dt * A[a, b]
                    N[6 + a, 6 + b] += dt * dt * A[a, b]
                    N[3 + b, a] += AT[a, b]
                    N[9 + b, a] += AT[a, 3 + b]
                    N[6 + a, 3 + b] += dt * AT[a, b]
                    N[9 + b, 6 + a] += dt * AT[a, 3 + b]
                    N[3 + a, 3 + b] += TAT[a, b]
                    N[9 + a, 3 + b] += TAT[3 + a, b]
                    N[9 + a, 9 + b] += TAT[3 + a, 3 + b]
            for a in range(m):
                g[12 + a] -= frame_gradient[6 + a]
                for b in range(3):
                    N[12 + a, b] += A[6 + a, b]
                    N[12 + a, 6 + b] += dt * A[6 + a, b]
                    N[12 + a, 3 + b] += AT[6 + a, b]
                    N[12 + a, 9 + b] += AT[6 + a, 3 + b]
                for b in range(a + 1):
                    N[12 + a, 12 + b] += A[6 + a, 6 + b]
        for a in range(12 + m):
            for b in range(a):
                N[b, a] = N[a, b]


@compiled(nogil=True)
def gradient_covariance(
    poses: PoseArrays, weight: Array, strength: Array, state: Array, variance_ratio: Array, correlation_time_s: Array,
    out: Array,
) -> None:  # fmt: skip
    """Add Xᵀ V X to `out`, for V = 1 + a exp(-|t_j - t_k|/T) and weighted rows X. Each frame is combined with the decayed sum of
    the frames before it, so that the cost is linear."""
    time, W, bias_jacobian = poses.time_s, poses.whitener, poses.bias_jacobian
    m = bias_jacobian.shape[2]
    size = 12 + m
    rows, before, rotation = np.empty((6, size)), np.zeros((6, size)), np.empty((3, 6))
    carried = begin(poses.turning, state)
    for k in range(len(time)):
        dt = time[k] - state[0]
        transition_after(poses.turning, carried, dt, rotation)
        _frame_jacobian(dt, rotation, W[k], bias_jacobian[k], rows)
        for i in range(6):
            for a in range(size):
                rows[i, a] *= weight[k]
        for i in range(6):
            if k > 0:
                decay = exp(-(time[k] - time[k - 1]) / correlation_time_s[i])
                for a in range(size):
                    before[i, a] *= decay
            slow = strength[i] * variance_ratio[i]
            for a in range(size):
                own, past = rows[i, a], before[i, a]
                for b in range(a + 1):
                    out[a, b] += (strength[i] + slow) * own * rows[i, b]
                    out[a, b] += slow * (own * before[i, b] + past * rows[i, b])
            for a in range(size):
                before[i, a] += rows[i, a]
    for a in range(size):
        for b in range(a):
            out[b, a] = out[a, b]


@inner
def _frame_jacobian(dt: float, rotation: Array, W: Array, bias_jacobian: Array, rows: Array) -> None:
    """Fill the rows of one frame: derivative of the whitened motion by the state (12,) and the shared errors (m,). `rotation` (3,
    6) is that of the attitude."""
    for i in range(6):
        for j in range(3):
            rows[i, j] = W[i, j]
            rows[i, 6 + j] = dt * W[i, j]
            turned, spun = 0.0, 0.0
            for b in range(3):
                turned += W[i, 3 + b] * rotation[b, j]
                spun += W[i, 3 + b] * rotation[b, 3 + j]
            rows[i, 3 + j] = turned
            rows[i, 9 + j] = spun
        for j in range(bias_jacobian.shape[1]):
            bias = 0.0
            for b in range(6):
                bias += W[i, b] * bias_jacobian[b, j]
            rows[i, 12 + j] = bias


@inner
def _propagate_state(state: Array, time: float, gravity: float, turning: Any, out: Array, M: Array) -> None:
    """Fill the state (14,) at another instant, and the transition matrix (12, 12) to it."""
    dt = time - state[0]
    carried, turned = begin(turning, state), np.zeros((6, 6))
    for i in range(3):
        turned[3 + i, 3 + i] = 1.0
    transition_after(turning, carried, dt, turned)
    for i in range(14):
        out[i] = state[i]
    out[0] = time
    for i in range(3):
        out[1 + i] += dt * state[8 + i]
        M[i, i], M[6 + i, 6 + i], M[i, 6 + i] = 1.0, 1.0, dt
        for j in range(3):
            M[3 + i, 3 + j], M[3 + i, 9 + j] = turned[i, j], turned[i, 3 + j]
            M[9 + i, 3 + j], M[9 + i, 9 + j] = turned[3 + i, j], turned[3 + i, 3 + j]
    out[3] -= 0.5 * gravity * dt * dt
    out[10] -= gravity * dt
    out[4], out[5], out[6], out[7] = quaternion_after(turning, carried, state, dt)
    out[11], out[12], out[13] = omega_after(turning, carried, dt)


@compiled(nogil=True)
def empty_motion(links: int) -> ChainMotion:
    """Room for the motion of a chain with so many links."""
    return ChainMotion(np.zeros((links + 1, 14)), np.zeros((links, 14)), np.zeros((links, 12, 12)))


@compiled(nogil=True)
def propagate(
    first: Array, times_s: Array, jumps: Array, is_open: NDArray[np.bool_], free: Array, gravity: float, turning: Any,
    out: ChainMotion,
) -> None:  # fmt: skip
    """Fill the states of a chain, flight by flight, with the transition matrix of each flight."""
    states, ends, transitions = out
    for i in range(14):
        states[0, i] = first[i]
    for k in range(len(times_s)):
        _propagate_state(states[k], times_s[k], gravity, turning, ends[k], transitions[k])
        for i in range(14):
            states[k + 1, i] = free[k, i] if is_open[k] else ends[k, i]
        if not is_open[k]:
            for i in range(6):
                states[k + 1, 8 + i] += jumps[k, i]


@compiled(nogil=True)
def apply_step(
    first: Array, times_s: Array, jumps: Array, is_open: NDArray[np.bool_], free: Array, change: Array, changes: Array,
    max_shift_s: float,
) -> None:  # fmt: skip
    """Change a chain in place: its first state and its links. The instant of a link moves by `max_shift_s` at most."""
    perturbed = np.empty(14)
    _apply_change(first, change, perturbed)
    for i in range(14):
        first[i] = perturbed[i]
    for k in range(len(times_s)):
        if is_open[k]:
            _apply_change(free[k], changes[k], perturbed)
            for i in range(14):
                free[k, i] = perturbed[i]
        else:
            times_s[k] += min(max(changes[k, 0], -max_shift_s), max_shift_s)
            for i in range(6):
                jumps[k, i] += changes[k, 1 + i]


@compiled(nogil=True)
def impact_equations(
    ends: Array, jumps: Array, impacts: VertexImpacts, table_m: float, contact_sigma_m: float, lever_sigma: Array,
    out: ImpactEquations,
) -> None:  # fmt: skip
    """Fill the equations of each vertex impact, in sigmas: its lowest point lies on the table, and Δω = m I⁻¹ (r × Δv)."""
    which, points, rounding, mass_over_inertia = impacts
    by_end, by_link, violation = out
    inner_point, arm, moves = np.empty(3), np.empty(3), np.empty(3)
    torque, answer, turned_by = np.empty(3), np.empty(3), np.empty((3, 3))
    for s in range(len(which)):
        k = which[s]
        R = _rotation_matrix(ends[k, 4], ends[k, 5], ends[k, 6], ends[k, 7])
        # K = m R I⁻¹ Rᵀ: Δω = K (r × Δv).
        K = _product(_product(R, mass_over_inertia[s]), R.T)
        for i in range(3):
            inner_point[i] = R[i, 0] * points[s, 0] + R[i, 1] * points[s, 1] + R[i, 2] * points[s, 2]
        arm[0], arm[1], arm[2] = inner_point[0], inner_point[1], inner_point[2] - rounding[s]
        turn = _cross_matrix(-inner_point[0], -inner_point[1], -inner_point[2])
        spin = _cross_matrix(ends[k, 11], ends[k, 12], ends[k, 13])
        push = _cross_matrix(jumps[k, 0], jumps[k, 1], jumps[k, 2])
        lever = _product(K, _cross_matrix(arm[0], arm[1], arm[2]))
        for i in range(3):
            torque[i] = arm[(i + 1) % 3] * jumps[k, (i + 2) % 3] - arm[(i + 2) % 3] * jumps[k, (i + 1) % 3]
        for i in range(3):
            # δ(R p) = δθ × R p, and both p and R move on with the instant.
            moves[i] = spin[i, 0] * inner_point[0] + spin[i, 1] * inner_point[1] + spin[i, 2] * inner_point[2]
            answer[i] = K[i, 0] * torque[0] + K[i, 1] * torque[1] + K[i, 2] * torque[2]
        # δK t = δθ × K t - K (δθ × t), which is 0 for a spherical top.
        pushed_lever = _product(K, push)
        by_torque = _product(K, _cross_matrix(torque[0], torque[1], torque[2]))
        by_answer = _cross_matrix(answer[0], answer[1], answer[2])
        by_arm = _product(pushed_lever, turn)
        for i in range(3):
            for j in range(3):
                turned_by[i, j] = by_arm[i, j] + by_answer[i, j] - by_torque[i, j]
        by_end[s, 0, 2] = 1.0 / contact_sigma_m
        by_link[s, 0, 0] = (moves[2] + ends[k, 10]) / contact_sigma_m
        violation[s, 0] = (ends[k, 3] + arm[2] - table_m) / contact_sigma_m
        tight = 1.0 / lever_sigma[k]
        for i in range(3):
            by_end[s, 0, 3 + i] = turn[2, i] / contact_sigma_m
            by_link[s, 1 + i, 4 + i] = tight
            violation[s, 1 + i] = tight * (jumps[k, 3 + i] - answer[i])
            for j in range(3):
                by_end[s, 1 + i, 3 + j] = tight * turned_by[i, j]
                by_link[s, 1 + i, 0] += tight * turned_by[i, j] * ends[k, 11 + j]
                by_link[s, 1 + i, 1 + j] = -tight * lever[i, j]


@inner
def _product(a: Array, b: Array) -> Array:
    """(3, 3) of two matrices."""
    out = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += a[i, k] * b[k, j]
    return out


@inner
def _rotation_matrix(w: float, x: float, y: float, z: float) -> Array:
    """(3, 3) of a unit quaternion."""
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    return out


@inner
def _cross_matrix(x: float, y: float, z: float) -> Array:
    """(3, 3) that multiplies by v × from the left."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -z, y, -x
    out[1, 0], out[2, 0], out[2, 1] = z, -y, x
    return out


@inner
def _fit_flight(poses: PoseArrays, state: Array, inverse: Array) -> float:
    """Gauss-Newton through the frames of one flight with independent errors. Fills the state (14,) and the inverse normal matrix;
    returns the sum of squared sigmas."""
    time = poses.time_s
    n = len(time)
    states, trial = np.empty((1, 14)), np.empty((1, 14))
    _initial_state(poses, states[0])
    weight, none = np.ones(n), np.zeros(0)
    information = FrameInformation(np.empty((n, 6, 6)), np.empty((n, 6, 6)))
    frame_information(poses, np.ones(6), information)
    cuts = np.zeros(2, np.int64)
    cuts[1] = n
    residual, step = np.empty((n, 6)), np.empty(12)
    residuals(poses, none, cuts, states, residual)
    chi2 = _sum_of_squares(residual)
    for _ in range(MAX_STEPS):
        normal, gradient = np.zeros((1, 12, 12)), np.zeros((1, 12))
        normal_equations(poses, information, residual, weight, cuts, states, normal, gradient)
        _invert(normal[0], inverse)
        for a in range(12):
            step[a] = 0.0
            for b in range(12):
                step[a] -= inverse[a, b] * gradient[0, b]
        _apply_change(states[0], step, trial[0])
        residuals(poses, none, cuts, trial, residual)
        new_chi2 = _sum_of_squares(residual)
        if not new_chi2 < chi2:
            break
        gain = chi2 - new_chi2
        for a in range(14):
            states[0, a] = trial[0, a]
        chi2 = new_chi2
        if gain < RELATIVE_GAIN * chi2:
            break
    for a in range(14):
        state[a] = states[0, a]
    return chi2


@compiled(nogil=True)
def fit_flights(poses: PoseArrays, ends: NDArray[np.int64], states: Array, inverses: Array, chi2: Array) -> None:
    """One flight through each group of frames, which lie one after the other."""
    for group in range(len(states)):
        a, b = ends[group], ends[group + 1]
        frames = PoseArrays(
            poses.time_s[a:b], poses.position_m[a:b], poses.quaternion[a:b], poses.whitener[a:b], np.zeros((b - a, 6, 0)),
            poses.gravity, poses.turning,
        )  # fmt: skip
        chi2[group] = _fit_flight(frames, states[group], inverses[group])


@inner
def _sum_of_squares(residual: Array) -> float:
    total = 0.0
    for k in range(len(residual)):
        for i in range(6):
            total += residual[k, i] ** 2
    return total


@inner
def _initial_state(poses: PoseArrays, state: Array) -> None:
    """Fill an initial state at the middle frame: the mean spin between neighbours, and a line from the first to the last frame
    with the fall subtracted. Errors of the frames between cancel in both."""
    time, position, quaternion, gravity = poses.time_s, poses.position_m, poses.quaternion, poses.gravity
    n = len(time)
    middle = n // 2
    t0 = time[middle]
    state[0] = t0
    for i in range(4):
        state[4 + i] = quaternion[middle, i]
    span = max(time[n - 1] - time[0], 1e-12)
    state[11], state[12], state[13] = mean_omega(poses.turning, time, quaternion, middle)
    for i in range(3):
        fall = 0.5 * gravity if i == 2 else 0.0
        first = position[0, i] + fall * (time[0] - t0) ** 2
        last = position[n - 1, i] + fall * (time[n - 1] - t0) ** 2
        state[8 + i] = (last - first) / span if n > 1 else 0.0
        state[1 + i] = position[middle, i]


@inner
def _apply_change(state: Array, step: Array, out: Array) -> None:
    """The state after a change (12,) of position, rotation vector, velocity and angular velocity."""
    for i in range(14):
        out[i] = state[i]
    for i in range(3):
        out[1 + i] += step[i]
        out[8 + i] += step[6 + i]
        out[11 + i] += step[9 + i]
    angle = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    half = sin(0.5 * angle) / angle if angle > TINY_ROTATION else 0.5
    q = quaternion_product(
        cos(0.5 * angle), half * step[3], half * step[4], half * step[5], state[4], state[5], state[6], state[7]
    )
    length = sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        out[4 + i] = q[i] / length


@inner
def _invert(matrix: Array, inverse: Array) -> None:
    """Inverse (n, n) of a positive matrix by Cholesky after scaling its diagonal to one. Pivots stay above LEAST_PIVOT."""
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
                L[i, i] = sqrt(max(total, LEAST_PIVOT))
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
