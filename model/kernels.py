"""Compiled kernels of the event loop: touch, impact, flight, and their derivatives, on plain numbers and arrays.

They stand in one file because they call each other (the cache of a kernel sees edits of its own file only). The
methods are explained where the friendly functions are: `touch` (the first root), `impacts` (the laws), `simulate` (the
loop, rest and chatter), `tangent` (derivatives).

A state is an array (13,): position [m], quaternion wxyz, velocity [m/s], angular velocity [rad/s], all in world axes.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .motion import GRAVITY_M_S2

Array = NDArray[np.float64]

SMOOTH = 0
"""Code of the paper's smooth impact; its one parameter is χ. Parameter 0 of every law is its restitution."""

RESTED, TIME_REACHED, IMPACTS_REACHED, CHATTER, IMPACT_CAP, NO_TOUCH = 0, 1, 2, 3, 4, 5
"""How the kernels end; `simulate.Ending` says the same in sentences, NO_TOUCH is for prescribed vertices alone."""

ROW = 21
"""Columns of a logged impact: time, vertex, position (3), quaternion (4), velocities before (6) and after (6)."""

_ROUNDING = 16.0 * 2.220446049250313e-16
"""A height is a sum of some ten products, each off by half a unit in the last place of its largest term."""


@njit(cache=True)
def spin_of(state: Array) -> float:
    """|ω| [rad/s]; scaled, so that 1e-200 is not lost in its square."""
    largest = max(abs(state[10]), abs(state[11]), abs(state[12]))
    if largest == 0.0:
        return 0.0
    x, y, z = state[10] / largest, state[11] / largest, state[12] / largest
    return float(largest * sqrt(x * x + y * y + z * z))


@njit(cache=True)
def axis_of(state: Array, spin: float) -> tuple[float, float, float]:
    """Unit axis of the spin; any axis serves where there is none."""
    if spin == 0.0:
        return 0.0, 0.0, 1.0
    return state[10] / spin, state[11] / spin, state[12] / spin


@njit(cache=True)
def arm_of(vertex: Array, state: Array) -> tuple[float, float, float]:
    """The vertex (3,) of the body frame, seen from the centre, in world axes."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    bx, by, bz = vertex[0], vertex[1], vertex[2]
    # v + 2 w (q × v) + 2 q × (q × v)
    tx, ty, tz = 2.0 * (y * bz - z * by), 2.0 * (z * bx - x * bz), 2.0 * (x * by - y * bx)
    return bx + w * tx + y * tz - z * ty, by + w * ty + z * tx - x * tz, bz + w * tz + x * ty - y * tx


@njit(cache=True)
def swing(vertices: Array, state: Array, spin: float, terms: Array) -> None:
    """Fill `terms` (n, 4) with A, B, C and √(A² + B²): a vertex stands A cos ωt + B sin ωt + C above the centre."""
    ux, uy, uz = axis_of(state, spin)
    for i in range(vertices.shape[0]):
        x, y, z = arm_of(vertices[i], state)
        along = (x * ux + y * uy + z * uz) * uz
        a, b = z - along, ux * y - uy * x
        terms[i, 0], terms[i, 1], terms[i, 2], terms[i, 3] = a, b, along, sqrt(a * a + b * b)


@njit(cache=True)
def first_touch(
    terms: Array, height: float, velocity: float, spin: float, radius: float, limit: float
) -> tuple[float, int, float, float]:
    """The first instant at which a vertex of `terms` meets the table from above, no later than `limit` [s].

    Returns the time [s] from the start of the flight, the row of the vertex (-1: the limit came first), and its
    vertical velocity (0 where it is only rounding) and acceleration there. Of vertices that touch together the fastest
    is returned, the first of equals. See `touch` for why no touch can be missed.
    """
    t = 0.0
    g = GRAVITY_M_S2
    while True:
        c, s = cos(spin * t), sin(spin * t)
        centre, rise = height + (velocity - 0.5 * g * t) * t, velocity - g * t
        turned = 1.0 + spin * t  # the phase ωt is rounded as well
        h_tol = _ROUNDING * (abs(height) + (abs(velocity) + g * t) * t + radius * turned)
        v_tol = _ROUNDING * (abs(velocity) + g * t + spin * radius * turned)
        a_tol = _ROUNDING * (g + spin * spin * radius * turned)
        hit, hit_v, hit_a, step = -1, 0.0, 0.0, inf
        for i in range(terms.shape[0]):
            a, b, amplitude = terms[i, 0], terms[i, 1], terms[i, 3]
            h = centre + a * c + b * s + terms[i, 2]
            v = rise + spin * (b * c - a * s)
            bound = g + spin * spin * amplitude
            if h > h_tol:
                root = sqrt(v * v + 2.0 * bound * h)
                # Two forms of one root: each free of cancellation for its sign of v.
                ahead = (v + root) / bound if v > 0.0 else 2.0 * h / (root - v)
            elif v > v_tol:
                ahead = 2.0 * v / bound
            else:
                acceleration = -g - spin * spin * (a * c + b * s)
                if v < -v_tol or acceleration <= a_tol:
                    v = min(v, 0.0) if v < -v_tol else 0.0
                    if hit < 0 or v < hit_v:
                        hit, hit_v, hit_a = i, v, acceleration
                    continue
                ahead = 3.0 * acceleration / (spin * spin * spin * amplitude)
            step = min(step, ahead)
        if hit >= 0:
            return t, hit, hit_v, hit_a
        if centre > radius:
            # No vertex reaches farther down than the circumscribed sphere: fall with it.
            step = max(step, (rise + sqrt(rise * rise + 2.0 * g * (centre - radius))) / g)
        if t + step > limit:
            return limit, -1, 0.0, 0.0
        t += step


@njit(cache=True)
def touch_of_vertex(
    terms: Array, height: float, velocity: float, spin: float, radius: float
) -> tuple[float, bool, float, float]:
    """The next touch of the one vertex in `terms` (1, 4), whatever the others do: time, found, velocity, acceleration.

    A vertex that is already below the table and sinking touched a little before the flight began, and the time is
    negative: so the time stays a smooth function of the state when two touches change their order. It may lie as far
    back as the die takes to fall its own circumradius. A vertex that never rises above the table again has no touch.
    """
    below = -1e-12 * radius
    h = height + terms[0, 0] + terms[0, 2]
    v = velocity + spin * terms[0, 1]
    if h < below and v < 0.0:
        return _touch_before(terms, height, velocity, spin, radius)
    t, _, v, acceleration = first_touch(terms, height, velocity, spin, radius, inf)
    return t, _height(terms, height, velocity, spin, t) >= below, v, acceleration


@njit(cache=True)
def _height(terms: Array, height: float, velocity: float, spin: float, t: float) -> float:
    """Height [m] of the one vertex of `terms` (1, 4)."""
    swung = terms[0, 0] * cos(spin * t) + terms[0, 1] * sin(spin * t) + terms[0, 2]
    return float(height + (velocity - 0.5 * GRAVITY_M_S2 * t) * t + swung)


@njit(cache=True)
def _touch_before(
    terms: Array, height: float, velocity: float, spin: float, radius: float
) -> tuple[float, bool, float, float]:
    """Backwards from a vertex below the table to the instant at which it crossed; as `touch_of_vertex`."""
    t, g = 0.0, GRAVITY_M_S2
    bound = max(spin * spin * terms[0, 3] - g, 1e-3 * g)  # h'' is no larger; kept above 0 for the division
    while t > -sqrt(2.0 * radius / g):
        swung, swept = cos(spin * t), sin(spin * t)
        h = _height(terms, height, velocity, spin, t)
        v = velocity - g * t + spin * (terms[0, 1] * swung - terms[0, 0] * swept)
        if h >= -_ROUNDING * (abs(height) + abs(velocity * t) + radius * (1.0 - spin * t)):
            return t, True, v, -g - spin * spin * (terms[0, 0] * swung + terms[0, 1] * swept)
        root = sqrt(v * v - 2.0 * bound * h)
        t -= 2.0 * h / (v - root) if v < 0.0 else (v + root) / bound
    return t, False, 0.0, 0.0


@njit(cache=True)
def advance(state: Array, spin: float, dt: float) -> None:
    """Move the state along its exact flight, in place."""
    state[0] += state[7] * dt
    state[1] += state[8] * dt
    state[2] += (state[9] - 0.5 * GRAVITY_M_S2 * dt) * dt
    state[9] -= GRAVITY_M_S2 * dt
    ux, uy, uz = axis_of(state, spin)
    c, s = cos(0.5 * spin * dt), sin(0.5 * spin * dt)
    x, y, z = s * ux, s * uy, s * uz
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    w1 = c * qw - x * qx - y * qy - z * qz
    x1 = c * qx + x * qw + y * qz - z * qy
    y1 = c * qy - x * qz + y * qw + z * qx
    z1 = c * qz + x * qy - y * qx + z * qw
    norm = sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    state[3], state[4], state[5], state[6] = w1 / norm, x1 / norm, y1 / norm, z1 / norm


@njit(cache=True)
def impulse(
    law: int, parameters: Array, mass: float, inertia: float, arm: tuple[float, float, float], state: Array
) -> tuple[float, float, float]:
    """Impulse [N s] of the table on a touching vertex at `arm` from the centre. SMOOTH is the only law so far."""
    x, y, _ = arm
    normal_velocity = state[9] + state[10] * y - state[11] * x
    s = -(1.0 + parameters[0]) * normal_velocity / (1.0 / mass + (x * x + y * y) / inertia)
    return 0.0, 0.0, s


@njit(cache=True)
def bounce(
    law: int, parameters: Array, mass: float, inertia: float, arm: tuple[float, float, float], state: Array
) -> None:
    """Apply the law to the velocities of the state, in place: Δv = S/m, Δω = (r × S)/J."""
    sx, sy, sz = impulse(law, parameters, mass, inertia, arm, state)
    x, y, z = arm
    state[7] += sx / mass
    state[8] += sy / mass
    state[9] += sz / mass
    state[10] += (y * sz - z * sy) / inertia
    state[11] += (z * sx - x * sz) / inertia
    state[12] += (x * sy - y * sx) / inertia


@njit(cache=True)
def lowest_row(normals: Array, state: Array) -> int:
    """Row of the face normal (faces, 3) that points down most."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    # Third row of the rotation matrix.
    a, b, c = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    best, lowest = 0, inf
    for k in range(normals.shape[0]):
        down = normals[k, 0] * a + normals[k, 1] * b + normals[k, 2] * c
        if down < lowest:
            best, lowest = k, down
    return best


@njit(cache=True)
def decided_face(normals: Array, barriers: Array, mass: float, inertia: float, state: Array) -> int:
    """Row of the face that the die can no longer leave, or -1; `barriers` (faces,) are `simulate.edge_barriers_m`."""
    turning = 0.5 * inertia / mass * (state[10] * state[10] + state[11] * state[11])
    reach = state[2] + (0.5 * state[9] * state[9] + turning) / GRAVITY_M_S2
    face = lowest_row(normals, state)
    return face if reach < barriers[face] else -1


@njit(cache=True)
def grown(rows: Array) -> Array:
    """The same rows with room for as many again."""
    larger = np.empty((2 * rows.shape[0], rows.shape[1]))
    larger[: rows.shape[0]] = rows
    return larger


@njit(cache=True)
def log_impact(row: Array, time: float, vertex: int, before: Array, after: Array) -> None:
    """Write one impact into a row (ROW,)."""
    row[0] = time
    row[1] = vertex
    row[2:15] = before
    row[15:21] = after[7:13]


@njit(cache=True)
def slow_contact(law_restitution: float, radius: float) -> float:
    """Speed [m/s] below which a vertex that accelerates into the table bounces on without end; see `simulate`."""
    # With χ = 1 the bounces do not shrink, so nothing collapses.
    return 0.0 if law_restitution >= 1.0 else 1e-6 * sqrt(GRAVITY_M_S2 * radius)


@njit(cache=True)
def run_throw(
    vertices: Array,
    normals: Array,
    barriers: Array,
    mass: float,
    inertia: float,
    law: int,
    parameters: Array,
    start: Array,
    duration: float,
    impact_limit: int,
    stop_when_decided: bool,
    impact_cap: int,
    keep: bool,
) -> tuple[int, int, int, float, Array, Array]:
    """The event loop. Nothing is changed in its arguments.

    Returns the code of the ending, the number of impacts, the row of the face decided on (-1: none), the end [s] of
    the last flight counted from the start, the state (13,) after the last impact, and the log (impacts, ROW), which
    stays empty unless `keep`.
    """
    state, before = start.copy(), np.empty(13)
    terms = np.empty((vertices.shape[0], 4))
    log = np.empty((64 if keep else 1, ROW))
    radius = sqrt(np.max(np.sum(vertices * vertices, axis=1)))
    slow = slow_contact(parameters[0], radius)
    time, impacts = 0.0, 0
    while True:
        face = decided_face(normals, barriers, mass, inertia, state)
        spin = spin_of(state)
        swing(vertices, state, spin, terms)
        dt, hit, velocity, acceleration = first_touch(terms, state[2], state[9], spin, radius, duration - time)
        ending = -1
        if stop_when_decided and face >= 0:
            ending = RESTED
        elif hit < 0:
            ending = TIME_REACHED
        elif impacts >= impact_limit:
            ending = IMPACTS_REACHED
        elif velocity == 0.0 or (-velocity <= slow and acceleration < 0.0):
            ending = CHATTER
        elif impacts >= impact_cap:
            ending = IMPACT_CAP
        if ending >= 0:
            return ending, impacts, face, time + dt, state, log[: impacts if keep else 0]
        time += dt
        advance(state, spin, dt)
        before[:] = state
        bounce(law, parameters, mass, inertia, arm_of(vertices[hit], state), state)
        if keep:
            if impacts == log.shape[0]:
                log = grown(log)
            log_impact(log[impacts], time, hit, before, state)
        impacts += 1


@njit(cache=True)
def flight_tangent(tangent: Array, state: Array, spin: float, dt: float, moved: Array) -> None:
    """Carry derivatives (12, m) of a state along `dt` [s] of its flight into `moved`; see `tangent`."""
    ux, uy, uz = axis_of(state, spin)
    angle = spin * dt
    c, s = cos(angle), sin(angle)
    half = sin(0.5 * angle)
    # sin θ/θ and (1 - cos θ)/θ keep their digits for every θ but zero itself: no series is needed.
    mean_c = s / angle if angle != 0.0 else 1.0
    mean_s = 2.0 * half * half / angle if angle != 0.0 else 0.0
    for j in range(tangent.shape[1]):
        for k in range(3):
            moved[k, j] = tangent[k, j] + dt * tangent[6 + k, j]
            moved[6 + k, j] = tangent[6 + k, j]
            moved[9 + k, j] = tangent[9 + k, j]
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        wx, wy, wz = dt * tangent[9, j], dt * tangent[10, j], dt * tangent[11, j]
        along_r = (1.0 - c) * (ux * rx + uy * ry + uz * rz)
        along_w = (1.0 - mean_c) * (ux * wx + uy * wy + uz * wz)
        along = along_r + along_w
        # exp(ωt) δ by Rodrigues' formula, and the left Jacobian of exp applied to t δω.
        px, py, pz = s * rx + mean_s * wx, s * ry + mean_s * wy, s * rz + mean_s * wz
        moved[3, j] = c * rx + mean_c * wx + along * ux + uy * pz - uz * py
        moved[4, j] = c * ry + mean_c * wy + along * uy + uz * px - ux * pz
        moved[5, j] = c * rz + mean_c * wz + along * uz + ux * py - uy * px


@njit(cache=True)
def bounce_tangent(
    tangent: Array, chi: float, mass: float, inertia: float, arm: tuple[float, float, float], state: Array, dtime: Array
) -> None:
    """Carry derivatives (12, 13) at the instant of a smooth impact through it, in place; column 12 is χ.

    `state` is the state before. `dtime` (13,) receives the derivative of the instant of the impact.
    """
    x, y, z = arm
    vz, wx, wy, wz = state[9], state[10], state[11], state[12]
    normal_velocity = vz + wx * y - wy * x
    softness = 1.0 / mass + (x * x + y * y) / inertia
    s = -(1.0 + chi) * normal_velocity / softness
    for j in range(tangent.shape[1]):
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        # The height stays zero at the touch: this is the derivative of its instant.
        dt = -(tangent[2, j] + rx * y - ry * x) / normal_velocity
        dtime[j] = dt
        # To the instant of the disturbed touch ...
        rx, ry, rz = rx + wx * dt, ry + wy * dt, rz + wz * dt
        dx, dy = ry * z - rz * y, rz * x - rx * z
        dwx, dwy = tangent[9, j], tangent[10, j]
        dv = tangent[8, j] - GRAVITY_M_S2 * dt + dwx * y + wx * dy - dwy * x - wy * dx
        dsoftness = 2.0 * (x * dx + y * dy) / inertia
        ds = -((1.0 + chi) * dv + (normal_velocity if j == 12 else 0.0)) / softness - s * dsoftness / softness
        dsx, dsy = (y * ds + dy * s) / inertia, -(x * ds + dx * s) / inertia
        # ... and back: between the two instants the die moved with the velocities before, not those after.
        tangent[2, j] -= s / mass * dt
        tangent[3, j] -= y * s / inertia * dt
        tangent[4, j] += x * s / inertia * dt
        tangent[8, j] += ds / mass
        tangent[9, j] += dsx
        tangent[10, j] += dsy


@njit(cache=True)
def run_tangent(
    vertices: Array,
    mass: float,
    inertia: float,
    chi: float,
    start: Array,
    start_time: float,
    times: Array,
    sequence: NDArray[np.int64],
    free: bool,
    impact_cap: int,
) -> tuple[int, Array, Array, Array, Array]:
    """The event loop with derivatives, for smooth impacts. `times` (n,) ascending; `sequence` is used unless `free`.

    Returns an ending (TIME_REACHED, CHATTER, IMPACT_CAP or NO_TOUCH), poses (n, 7), their derivatives (n, 6, 13), the
    log (k, ROW) with absolute times, and the derivatives (k, 13) of the impacts' instants.
    """
    n = times.shape[0]
    poses, jacobian = np.empty((n, 7)), np.empty((n, 6, 13))
    log, dtimes = np.empty((16, ROW)), np.empty((16, 13))
    state, before, pose = start.copy(), np.empty(13), np.empty(13)
    tangent, moved = np.zeros((12, 13)), np.empty((12, 13))
    for k in range(12):
        tangent[k, k] = 1.0
    terms = np.empty((vertices.shape[0], 4))
    parameters = np.array([chi])
    radius = sqrt(np.max(np.sum(vertices * vertices, axis=1)))
    slow = slow_contact(chi, radius)
    last = times[n - 1] if n > 0 else start_time
    time, done, impacts, ending = start_time, 0, 0, TIME_REACHED
    while True:
        spin = spin_of(state)
        swing(vertices, state, spin, terms)
        hit, dt = -1, 0.0
        if free:
            dt, hit, velocity, acceleration = first_touch(terms, state[2], state[9], spin, radius, last - time)
            if hit >= 0 and (velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)):
                hit, ending = -1, CHATTER
            elif hit >= 0 and impacts >= impact_cap:
                hit, ending = -1, IMPACT_CAP
        elif impacts < sequence.shape[0]:
            hit = sequence[impacts]
            dt, found, velocity, _ = touch_of_vertex(terms[hit : hit + 1], state[2], state[9], spin, radius)
            if not found or velocity >= 0.0:
                hit, ending = -1, NO_TOUCH
        while done < n and (hit < 0 or times[done] < time + dt):
            pose[:] = state
            advance(pose, spin, times[done] - time)
            flight_tangent(tangent, state, spin, times[done] - time, moved)
            poses[done] = pose[:7]
            jacobian[done] = moved[:6]
            done += 1
        if hit < 0:
            return ending, poses, jacobian, log[:impacts], dtimes[:impacts]
        if impacts == log.shape[0]:
            log, dtimes = grown(log), grown(dtimes)
        flight_tangent(tangent, state, spin, dt, moved)
        tangent, moved = moved, tangent
        advance(state, spin, dt)
        time += dt
        before[:] = state
        arm = arm_of(vertices[hit], state)
        bounce_tangent(tangent, chi, mass, inertia, arm, state, dtimes[impacts])
        bounce(SMOOTH, parameters, mass, inertia, arm, state)
        log_impact(log[impacts], time, hit, before, state)
        impacts += 1
