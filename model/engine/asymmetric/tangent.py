"""model.engine.asymmetric.tangent."""

from __future__ import annotations

from math import ceil, cos, inf, nan, sin, sqrt

import numpy as np

from ...compiled import compiled, inner
from ..impact import ParameterDerivatives
from ..types import CHATTER, FINE, IMPACT_CAP, LEVEL, LOG_COLUMNS, NO_TOUCH, TIME_REACHED, Law, Plane
from .contact import spin_growth_bound
from .event_loop import next_event, room_for, to_angular_momentum, to_angular_velocity
from .motion import (
    MAX_TURN_RAD,
    ROUNDING_BOUND,
    RUNGE_KUTTA_A,
    RUNGE_KUTTA_B,
    Array,
    AsymmetricBody,
    Indices,
    body_angular_velocity,
    clearance,
    rotational_energy,
    state_after_step,
    to_world,
    vertex_velocity,
)


@inner
def angular_velocity_of(body: AsymmetricBody, y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W x = R I⁻¹ Rᵀ x of a vector in table axes: the angular velocity that an angular momentum x makes."""
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return to_world(
        y,
        (a + w * tx + z * tz - v * ty) / body.moments[0],
        (b + w * ty + v * tx - x * tz) / body.moments[1],
        (c + w * tz + x * ty - z * tx) / body.moments[2],
    )


@inner
def _attitude_rates(body: AsymmetricBody, y: Array, values: Array, out: Array) -> None:
    """Fill `out` (22,) with the rates of `values`: quaternion (4), Φ (3 × 3) and Ψ (3 × 3) row by row.

    δ' = W (δL - δ × L) for a turn δ of the attitude, so Φ' = W [L]× Φ and Ψ' = W [L]× Ψ + W.
    """
    y[3:7] = values[:4]
    p, q, r = body_angular_velocity(body, y)
    w, a, b, c = values[0], values[1], values[2], values[3]
    out[0] = 0.5 * (-a * p - b * q - c * r)
    out[1] = 0.5 * (w * p + b * r - c * q)
    out[2] = 0.5 * (w * q + c * p - a * r)
    out[3] = 0.5 * (w * r + a * q - b * p)
    lx, ly, lz = y[10], y[11], y[12]
    for block in (4, 13):
        for k in range(3):
            i, j, m = block + k, block + 3 + k, block + 6 + k
            dx, dy, dz = values[i], values[j], values[m]
            ux, uy, uz = ly * dz - lz * dy, lz * dx - lx * dz, lx * dy - ly * dx
            if block == 13:
                ux, uy, uz = ux + (k == 0), uy + (k == 1), uz + (k == 2)
            out[i], out[j], out[m] = angular_velocity_of(body, y, ux, uy, uz)


@inner
def _attitude_step(body: AsymmetricBody, y: Array, dt: float, room: Array) -> None:
    """One step of the attitude in flight, in place in `y`; leaves quaternion, Φ and Ψ of the step in `room[13]`.

    `room` (14, 22).
    """
    start, now = room[12], room[13]
    start[:] = 0.0
    start[:4] = y[3:7]
    start[4], start[8], start[12] = 1.0, 1.0, 1.0
    for s in range(13):
        for k in range(22):
            total = 0.0
            for n in range(s):
                total += (RUNGE_KUTTA_A[s, n] if s < 12 else RUNGE_KUTTA_B[n]) * room[n, k]
            now[k] = start[k] + dt * total
        if s < 12:
            _attitude_rates(body, y, now, room[s])
    norm = sqrt(now[0] * now[0] + now[1] * now[1] + now[2] * now[2] + now[3] * now[3])
    y[3:7] = now[:4] / norm


@inner
def _fly(
    body: AsymmetricBody,
    plane: Plane,
    y: Array,
    dt: float,
    sources: ParameterDerivatives,
    tangent: Array,
    pull: Array,
    room: Array,
) -> None:
    """Carry a state in flight and its derivatives (12, 12 + m) through `dt` [s], of either sign, in place.

    `pull` (12 + m,) is where the moments of inertia change: ω is another then for the same L.
    """
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    steps = max(1, ceil(abs(dt) * spin / MAX_TURN_RAD))
    for _ in range(steps):
        ox, oy, oz = angular_velocity_of(body, y, y[10], y[11], y[12])
        _attitude_step(body, y, dt / steps, room)
        now = room[13]
        for j in range(tangent.shape[1]):
            dx, dy, dz = tangent[3, j], tangent[4, j], tangent[5, j]
            lx = tangent[9, j] - pull[j] * ox
            ly = tangent[10, j] - pull[j] * oy
            lz = tangent[11, j] - pull[j] * oz
            for k in range(3):
                i, n = 4 + 3 * k, 13 + 3 * k
                turned = now[i] * dx + now[i + 1] * dy + now[i + 2] * dz
                tangent[3 + k, j] = turned + now[n] * lx + now[n + 1] * ly + now[n + 2] * lz
    for k in range(3):
        for j in range(tangent.shape[1]):
            pulled = sources.gravity[j - 12, k] if j >= 12 else 0.0
            tangent[k, j] += (tangent[6 + k, j] + 0.5 * pulled * dt) * dt
            tangent[6 + k, j] += pulled * dt
    y[0] += (y[7] + 0.5 * plane.gx * dt) * dt
    y[1] += (y[8] + 0.5 * plane.gy * dt) * dt
    y[2] += (y[9] - 0.5 * plane.g * dt) * dt
    y[7] += plane.gx * dt
    y[8] += plane.gy * dt
    y[9] -= plane.g * dt


@inner
def _impact_tangent(
    body: AsymmetricBody,
    plane: Plane,
    chi: float,
    y: Array,
    time: float,
    i: int,
    sources: ParameterDerivatives,
    tangent: Array,
    pull: Array,
    dtime: Array,
) -> None:
    """Carry state and derivatives through the smooth impact of vertex i, in place. `dtime` (12 + m,) receives the
    derivative of its instant."""
    x, z, v = body.vertices[i, 0], body.vertices[i, 1], body.vertices[i, 2]
    rx, ry, rz = to_world(y, x, z, v)
    lx, ly, lz = y[10], y[11], y[12]
    ox, oy, oz = angular_velocity_of(body, y, lx, ly, lz)
    phase = plane.rate * time + plane.phase
    s, c = sin(phase), cos(phase)
    u = y[9] + ox * ry - oy * rx - plane.amplitude * plane.rate * c
    # Wt with the lever t = r × ẑ = (r_y, -r_x, 0).
    ax, ay, az = angular_velocity_of(body, y, ry, -rx, 0.0)
    softness = 1.0 / body.mass + ry * ax - rx * ay
    impulse = -(1.0 + chi) * u / softness
    closing = -plane.g + plane.rate * plane.rate * plane.amplitude * s
    for j in range(tangent.shape[1]):
        bx, by, bz, raised, lifted, softer = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if j >= 12:
            p = j - 12
            vertex = sources.vertices[p, i]
            bx, by, bz = to_world(y, vertex[0], vertex[1], vertex[2])
            by_amplitude, by_rate, by_phase = sources.table[p, 0], sources.table[p, 1], sources.table[p, 2]
            turned = by_rate * time + by_phase
            raised = by_amplitude * s + plane.amplitude * c * turned
            lifted = plane.rate * (by_amplitude * c - plane.amplitude * s * turned) + plane.amplitude * c * by_rate
            softer = sources.chi[p]
        dx, dy, dz = tangent[3, j], tangent[4, j], tangent[5, j]
        late = -(tangent[2, j] + dx * ry - dy * rx + bz - raised) / u
        dtime[j] = late
        dx, dy, dz = dx + ox * late, dy + oy * late, dz + oz * late
        ex, ey = dy * rz - dz * ry + bx, dz * rx - dx * rz + by
        kx = tangent[9, j] - (dy * lz - dz * ly) - pull[j] * ox
        ky = tangent[10, j] - (dz * lx - dx * lz) - pull[j] * oy
        kz = tangent[11, j] - (dx * ly - dy * lx) - pull[j] * oz
        wx, wy, _ = angular_velocity_of(body, y, kx, ky, kz)
        wx, wy = wx + dy * oz - dz * oy, wy + dz * ox - dx * oz
        du = tangent[8, j] + closing * late + wx * ry - wy * rx + ox * ey - oy * ex - lifted
        # δ × Wt, x and y.
        gx, gy = dy * az - dz * ay, dz * ax - dx * az
        dsoftness = 2.0 * (ey * ax - ex * ay + ry * gx - rx * gy) - pull[j] * (ax * ax + ay * ay + az * az)
        ds = -((1.0 + chi) * du + softer * u) / softness - impulse * dsoftness / softness
        tangent[2, j] -= impulse / body.mass * late
        tangent[3, j] = dx - (ox + impulse * ax) * late
        tangent[4, j] = dy - (oy + impulse * ay) * late
        tangent[5, j] = dz - (oz + impulse * az) * late
        tangent[8, j] += ds / body.mass
        tangent[9, j] += ds * ry + impulse * ey
        tangent[10, j] -= ds * rx + impulse * ex
    y[9] += impulse / body.mass
    y[10] += impulse * ry
    y[11] -= impulse * rx


@inner
def _earlier_crossing(
    body: AsymmetricBody, plane: Plane, y: Array, time: float, i: int, stages: Array, now: Array
) -> float:
    """How long ago [s, negative] vertex i, which is below the table and sinks, came through it; NaN for longer than
    the die takes to fall its own radius. As `kernels.touch_of_vertex`."""
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    bound = spin * spin * (1.0 + spin_growth_bound(body) / sqrt(3.0)) * body.radius + peak_table_acceleration - plane.g
    bound = max(bound, 1e-3 * plane.g)  # h'' is no larger; kept above 0 for the division
    t = 0.0
    back = y.copy()
    while t > -sqrt(2.0 * body.radius / plane.g):
        h = clearance(body, plane, back, time + t, i)
        v = vertex_velocity(body, plane, back, time + t, i)
        phase = 1.0 + abs(plane.rate * (time + t)) + abs(plane.phase)
        size = abs(y[2]) + abs(y[9] * t) + body.radius * (1.0 - spin * t) + plane.amplitude * phase
        if h >= -ROUNDING_BOUND * size:
            return t
        root = sqrt(v * v - 2.0 * bound * h)
        step = 2.0 * h / (v - root) if v < 0.0 else (v + root) / bound
        if spin > 0.0:
            step = min(step, MAX_TURN_RAD / spin)
        state_after_step(body, plane, back, time + t, -step, -1, -1, stages, now)
        back[:] = now
        t -= step
    return nan


@inner
def _with_one_vertex(body: AsymmetricBody, i: int) -> AsymmetricBody:
    """The same top, of whose vertices only one touches."""
    return AsymmetricBody(
        body.vertices[i : i + 1],
        body.normals,
        body.offsets,
        body.corners,
        body.edge_faces,
        body.edge_heights,
        body.edge_inertias,
        body.mass,
        body.moments,
        body.radius,
    )


@compiled
def run_asymmetric_tangent(
    body: AsymmetricBody,
    law: Law,
    plane: Plane,
    start: Array,
    start_time: float,
    times: Array,
    sequence: Indices,
    free: bool,
    impact_cap: int,
    seed: Array,
    sources: ParameterDerivatives,
) -> tuple[int, Array, Array, Array, Array]:
    """As `derivatives.run_tangent`, for smooth impacts of an asymmetric body.

    `start` (13,) as for `run_asymmetric_throw`. `seed` (12, 12 + m) and all derivatives are of the centre of mass, and of L
    where those of a spherical body are of ω.
    """
    y = to_angular_momentum(body, start)
    n, columns = times.shape[0], seed.shape[1]
    poses, jacobian = np.empty((n, 7)), np.empty((n, 6, columns))
    log, dtimes = np.empty((16, LOG_COLUMNS)), np.empty((16, columns))
    tangent, there, pose = seed.copy(), np.empty((12, columns)), np.empty(13)
    now, before, shown = np.empty(13), np.empty(13), np.empty(13)
    stages, room, pull = np.empty((14, 8)), np.empty((14, 22)), np.zeros(columns)
    pull[12:] = sources.inertia
    chi = law.parameters[0]
    slow = 0.0 if chi >= 1.0 else FINE.switch * sqrt(plane.g * body.radius)
    last = times[n - 1] if n > 0 else start_time
    time, done, impacts, ending, fresh = start_time, 0, 0, TIME_REACHED, True
    while True:
        hit, dt, ends = -1, inf, False
        if not free and impacts == sequence.shape[0]:
            ends = True
        elif free:
            ends = time >= last
            if not ends:
                dt, hit, velocity, acceleration = next_event(
                    body, plane, FINE, y, time, last - time, -1, -1, stages, now
                )
                if hit >= 0 and (velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)):
                    ends, ending = True, CHATTER
                elif hit >= 0 and impacts >= impact_cap:
                    ends, ending = True, IMPACT_CAP
        else:
            vertex = sequence[impacts]
            below = -1e-12 * body.radius
            sunk = clearance(body, plane, y, time, vertex) < below
            if fresh and sunk and vertex_velocity(body, plane, y, time, vertex) < 0.0:
                dt, hit = _earlier_crossing(body, plane, y, time, vertex, stages, now), vertex
                ends = not dt <= 0.0
            else:
                dt, hit, velocity, _ = next_event(
                    _with_one_vertex(body, vertex), plane, FINE, y, time, inf, -1, -1, stages, now
                )
                if hit >= 0:
                    hit = vertex
                    ends = velocity >= 0.0 or clearance(body, plane, now, time + dt, vertex) < below
            if ends:
                ending = NO_TOUCH
        while done < n and (ends or times[done] < time + dt):
            pose[:], there[:] = y, tangent
            _fly(body, plane, pose, times[done] - time, sources, there, pull, room)
            poses[done] = pose[:7]
            jacobian[done] = there[:6]
            done += 1
        if ends:
            return ending, poses, jacobian, log[:impacts], dtimes[:impacts]
        _fly(body, plane, y, dt, sources, tangent, pull, room)
        time += dt
        fresh = hit >= 0
        if hit < 0:
            continue
        if impacts == log.shape[0]:
            log, dtimes = room_for(log, impacts), room_for(dtimes, impacts)
        to_angular_velocity(body, y, before)
        _impact_tangent(body, plane, chi, y, time, hit, sources, tangent, pull, dtimes[impacts])
        to_angular_velocity(body, y, shown)
        log[impacts, 0], log[impacts, 1] = time, hit
        log[impacts, 2:15] = before
        log[impacts, 15:21] = shown[7:13]
        log[impacts, 21], log[impacts, 22] = -1.0, -1.0
        impacts += 1


@compiled
def attitudes_in_flight(body: AsymmetricBody, start: Array, delays: Array) -> Array:
    """Quaternions (n, 4) of the principal axes `delays` (n,) [s], of either sign, after a flight began with `start`
    (13,), a state as for `run_asymmetric_throw`."""
    y, plane, time = np.empty(13), LEVEL, 0.0
    out, stages, now = np.empty((delays.shape[0], 4)), np.empty((14, 8)), np.empty(13)
    for n in range(delays.shape[0]):
        y[:] = to_angular_momentum(body, start)
        spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
        steps = max(1, ceil(abs(delays[n]) * spin / MAX_TURN_RAD))
        for _ in range(steps):
            state_after_step(body, plane, y, time, delays[n] / steps, -1, -1, stages, now)
            y[:] = now
        out[n] = y[3:7]
    return out
