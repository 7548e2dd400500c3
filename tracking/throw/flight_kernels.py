"""The kernels of `flights`: frames about the motion of a flight, on plain arrays.

A state is packed into 14 numbers: time, position, quaternion, velocity, angular velocity.
"""

from __future__ import annotations

from math import atan2, cos, exp, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from ...model.world import GRAVITY_M_S2

Array = NDArray[np.float64]


@compiled(nogil=True)
def misses(
    time: Array, position: Array, quaternion: Array, W: Array, lean: Array, shared: Array, cuts: NDArray[np.int64],
    states: Array, out: Array,
) -> None:  # fmt: skip
    """Seen minus motion, whitened."""
    e = np.empty(6)
    for flight in range(len(states)):
        state = states[flight]
        for k in range(cuts[flight], cuts[flight + 1]):
            _error(time[k], position[k], quaternion[k], state, e)
            for j in range(len(shared)):
                for b in range(6):
                    e[b] -= lean[k, b, j] * shared[j]
            for i in range(6):
                total = 0.0
                for j in range(6):
                    total += W[k, i, j] * e[j]
                out[k, i] = total


@compiled(nogil=True)
def weigh(W: Array, lean: Array, share: Array, information: Array, pulls: Array) -> None:
    """What each frame says of its pose and of the shared errors: information (n, 6 + m, 6 + m), and (n, 6 + m, 6) that makes
    the pull of whitened residuals. Of no motion: once for all steps of a fit."""
    m = lean.shape[2]
    columns = np.empty((6, 6 + m))
    for k in range(len(W)):
        for i in range(6):
            for j in range(6):
                columns[i, j] = W[k, i, j]
            for j in range(m):
                total = 0.0
                for b in range(6):
                    total += W[k, i, b] * lean[k, b, j]
                columns[i, 6 + j] = total
        for a in range(6 + m):
            for i in range(6):
                pulls[k, a, i] = share[i] * columns[i, a]
            for b in range(a + 1):
                total = 0.0
                for i in range(6):
                    total += pulls[k, a, i] * columns[i, b]
                information[k, a, b] = total
                information[k, b, a] = total


@compiled(nogil=True)
def sums(
    time: Array, information: Array, pulls: Array, off: Array, weight: Array, cuts: NDArray[np.int64], states: Array,
    normal: Array, gradient: Array,
) -> None:  # fmt: skip
    """Fill the normal equations of each flight. With the information A of a frame about its pose, and D = (1, τ) for the
    place and (E, τJ) for the turn, a frame adds Dᵀ A D: the twelve columns need not be whitened one by one."""
    own = information.shape[1]
    m = own - 6
    A, u = np.empty((own, own)), np.empty(own)
    turns, AT, TAT = np.empty((3, 6)), np.empty((own, 6)), np.empty((6, 6))
    for flight in range(len(states)):
        state, N, g = states[flight], normal[flight], gradient[flight]
        for k in range(cuts[flight], cuts[flight + 1]):
            if weight[k] == 0.0:
                continue
            dt = time[k] - state[0]
            x, y, z = state[11] * dt, state[12] * dt, state[13] * dt
            E, L = _turn_matrices(x, y, z, sqrt(x * x + y * y + z * z), dt)
            for i in range(3):
                for j in range(3):
                    turns[i, j], turns[i, 3 + j] = E[i, j], L[i, j]
            for a in range(own):
                pull = 0.0
                for i in range(6):
                    pull += pulls[k, a, i] * off[k, i]
                u[a] = weight[k] * pull
                for b in range(own):
                    A[a, b] = weight[k] * information[k, a, b]
            for a in range(own):
                for b in range(6):
                    AT[a, b] = A[a, 3] * turns[0, b] + A[a, 4] * turns[1, b] + A[a, 5] * turns[2, b]
            for a in range(6):
                for b in range(6):
                    TAT[a, b] = turns[0, a] * AT[3, b] + turns[1, a] * AT[4, b] + turns[2, a] * AT[5, b]
            for a in range(3):
                g[a] -= u[a]
                g[6 + a] -= dt * u[a]
                g[3 + a] -= turns[0, a] * u[3] + turns[1, a] * u[4] + turns[2, a] * u[5]
                g[9 + a] -= turns[0, 3 + a] * u[3] + turns[1, 3 + a] * u[4] + turns[2, 3 + a] * u[5]
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
                g[12 + a] -= u[6 + a]
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
def meat(
    time: Array, W: Array, lean: Array, weight: Array, strength: Array,
    state: Array, wander: Array, memory_s: Array, meat: Array,
) -> None:  # fmt: skip
    """Fill Xᵀ V X for V = 1 + a exp(-|t_j - t_k|/T), rows weighted: frame by frame against what the frames before have
    left, so that the cost is linear."""
    m = lean.shape[2]
    size = 12 + m
    rows, before = np.empty((6, size)), np.zeros((6, size))
    for k in range(len(time)):
        _rows(time[k], W[k], lean[k], state, rows)
        for i in range(6):
            for a in range(size):
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
def _rows(time: float, W: Array, lean: Array, state: Array, rows: Array) -> None:
    """Rows of one frame: derivative of the whitened motion with respect to the state (12,) and the shared errors (m,)."""
    dt = time - state[0]
    x, y, z = state[11] * dt, state[12] * dt, state[13] * dt
    E, L = _turn_matrices(x, y, z, sqrt(x * x + y * y + z * z), dt)
    for i in range(6):
        for j in range(3):
            rows[i, j] = W[i, j]
            rows[i, 6 + j] = dt * W[i, j]
            turned, spun = 0.0, 0.0
            for b in range(3):
                turned += W[i, 3 + b] * E[b, j]
                spun += W[i, 3 + b] * L[b, j]
            rows[i, 3 + j] = turned
            rows[i, 9 + j] = spun
        for j in range(lean.shape[1]):
            leans = 0.0
            for b in range(6):
                leans += W[i, b] * lean[b, j]
            rows[i, 12 + j] = leans


@inner
def _error(time: float, position: Array, quaternion: Array, state: Array, e: Array) -> None:
    """Seen minus motion (6,) of one frame."""
    dt = time - state[0]
    x, y, z = state[11] * dt, state[12] * dt, state[13] * dt
    angle = sqrt(x * x + y * y + z * z)
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


@inner
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


@compiled(nogil=True)
def roll(
    first: Array, times_s: Array, jumps: Array, is_open: NDArray[np.bool_], free: Array, states: Array, ends: Array,
    passages: Array,
) -> None:  # fmt: skip
    """Fill the states of a chain, flight by flight."""
    for i in range(14):
        states[0, i] = first[i]
    for k in range(len(times_s)):
        _carry(states[k], times_s[k], ends[k], passages[k])
        for i in range(14):
            states[k + 1, i] = free[k, i] if is_open[k] else ends[k, i]
        if not is_open[k]:
            for i in range(6):
                states[k + 1, 8 + i] += jumps[k, i]


@compiled(nogil=True)
def step(
    first: Array, times_s: Array, jumps: Array, is_open: NDArray[np.bool_], free: Array, change: Array, changes: Array,
    most_s: float,
) -> None:  # fmt: skip
    """Change a chain in place: its first state, and each link, whose instant moves by `most_s` at the most."""
    perturbed = np.empty(14)
    _moved(first, change, perturbed)
    for i in range(14):
        first[i] = perturbed[i]
    for k in range(len(times_s)):
        if is_open[k]:
            _moved(free[k], changes[k], perturbed)
            for i in range(14):
                free[k, i] = perturbed[i]
        else:
            times_s[k] += min(max(changes[k, 0], -most_s), most_s)
            for i in range(6):
                jumps[k, i] += changes[k, 1 + i]


@compiled(nogil=True)
def strike_rows(
    ends: Array, jumps: Array, which: NDArray[np.int64], points: Array, rounding: Array, ratio: Array, table_m: float,
    contact_sigma_m: float, lever_sigma: Array, by_end: Array, by_link: Array, miss: Array,
) -> None:  # fmt: skip
    """What each strike obeys, in sigmas: its point on the table, and J Δω = m r × Δv. Derivatives by the state at the end of
    the flight before and by the link, and what is missed now."""
    ball, arm, moves = np.empty(3), np.empty(3), np.empty(3)
    for s in range(len(which)):
        k = which[s]
        w, x, y, z = ends[k, 4], ends[k, 5], ends[k, 6], ends[k, 7]
        a, b, c = points[s, 0], points[s, 1], points[s, 2]
        ball[0] = (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c
        ball[1] = 2.0 * (x * y + w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z - w * x) * c
        ball[2] = 2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c
        arm[0], arm[1], arm[2] = ball[0], ball[1], ball[2] - rounding[s]
        turn = _cross_matrix(-ball[0], -ball[1], -ball[2])
        spin = _cross_matrix(ends[k, 11], ends[k, 12], ends[k, 13])
        push = _cross_matrix(jumps[k, 0], jumps[k, 1], jumps[k, 2])
        lever = _cross_matrix(arm[0], arm[1], arm[2])
        # δ(R p) = δθ × R p, and both p and R move on with the instant.
        for i in range(3):
            moves[i] = spin[i, 0] * ball[0] + spin[i, 1] * ball[1] + spin[i, 2] * ball[2]
        by_end[s, 0, 2] = 1.0 / contact_sigma_m
        by_link[s, 0, 0] = (moves[2] + ends[k, 10]) / contact_sigma_m
        miss[s, 0] = (ends[k, 3] + arm[2] - table_m) / contact_sigma_m
        tight = 1.0 / lever_sigma[k]
        for i in range(3):
            by_end[s, 0, 3 + i] = turn[2, i] / contact_sigma_m
            by_link[s, 1 + i, 4 + i] = tight
            pushed = jumps[k, 3 + i]
            for j in range(3):
                total = push[i, 0] * turn[0, j] + push[i, 1] * turn[1, j] + push[i, 2] * turn[2, j]
                by_end[s, 1 + i, 3 + j] = ratio[s] * tight * total
                by_link[s, 1 + i, 0] += ratio[s] * tight * push[i, j] * moves[j]
                by_link[s, 1 + i, 1 + j] = -ratio[s] * tight * lever[i, j]
                pushed -= ratio[s] * lever[i, j] * jumps[k, j]
            miss[s, 1 + i] = tight * pushed


@inner
def _cross_matrix(x: float, y: float, z: float) -> Array:
    """(3, 3) that multiplies by v × from the left."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -z, y, -x
    out[1, 0], out[2, 0], out[2, 1] = z, -y, x
    return out


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


@inner
def _fit(time: Array, position: Array, quaternion: Array, W: Array, state: Array, inverse: Array) -> float:
    """Gauss-Newton through the frames of one flight, white errors; fills state (14,) and the inverse normal matrix."""
    n = len(time)
    states, trial = np.empty((1, 14)), np.empty((1, 14))
    _guess(time, position, quaternion, states[0])
    lean, weight, none = np.zeros((n, 6, 0)), np.ones(n), np.zeros(0)
    information, pulls = np.empty((n, 6, 6)), np.empty((n, 6, 6))
    weigh(W, lean, np.ones(6), information, pulls)
    cuts = np.zeros(2, np.int64)
    cuts[1] = n
    off, step = np.empty((n, 6)), np.empty(12)
    misses(time, position, quaternion, W, lean, none, cuts, states, off)
    left = _squares(off)
    for _ in range(12):
        normal, gradient = np.zeros((1, 12, 12)), np.zeros((1, 12))
        sums(time, information, pulls, off, weight, cuts, states, normal, gradient)
        _invert(normal[0], inverse)
        for a in range(12):
            step[a] = 0.0
            for b in range(12):
                step[a] -= inverse[a, b] * gradient[0, b]
        _moved(states[0], step, trial[0])
        misses(time, position, quaternion, W, lean, none, cuts, trial, off)
        new_left = _squares(off)
        if not new_left < left:
            break
        gain = left - new_left
        for a in range(14):
            states[0, a] = trial[0, a]
        left = new_left
        if gain < 1e-3 * left:
            break
    for a in range(14):
        state[a] = states[0, a]
    return left


@compiled(nogil=True)
def fit_many(
    time: Array, position: Array, quaternion: Array, W: Array, ends: NDArray[np.int64], states: Array, inverses: Array,
    left: Array,
) -> None:  # fmt: skip
    """One flight through each group of frames, which lie one after the other."""
    for group in range(len(states)):
        a, b = ends[group], ends[group + 1]
        left[group] = _fit(time[a:b], position[a:b], quaternion[a:b], W[a:b], states[group], inverses[group])


@inner
def _squares(off: Array) -> float:
    total = 0.0
    for k in range(len(off)):
        for i in range(6):
            total += off[k, i] ** 2
    return total


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
