"""A throw of an asymmetric body with its derivatives; equations in `throw.asymmetric_tangent`.

Derivatives are of the centre of mass, the attitude, the velocity and the angular momentum L. With ω = W L and W = R I⁻¹ Rᵀ a
turn δ of the attitude obeys δ' = W (δL - δ × L): linear equations that are integrated with the attitude itself. The jump across
an impact is `derivatives.saltation`.
"""

from __future__ import annotations

from math import ceil, inf, nan, sqrt

import numpy as np

from ...compiled import compiled, inner
from ..derivatives import (
    ASYMMETRIC_INPUTS,
    SHIFTS,
    Impact,
    ImpactDerivatives,
    ImpactKinematics,
    ImpactSequence,
    ParameterDerivatives,
    impact_derivatives,
    impulse_gradient,
    saltation,
    shifts_at_impact,
)
from ..flight import BELOW_TABLE, LEAST_BOUND, is_in_range, lever_arm, table_acceleration, table_velocity
from ..inertia import (
    angular_velocity_of,
    attitude_rates,
    tensor_inertia,
    to_angular_momentum,
    to_angular_velocity,
)
from ..log import fill_with_nan, with_room, write_event
from ..rest import chatter_speed
from ..runge_kutta import STAGES, START, VALUES, stage_values
from ..types import (
    CHATTER,
    IMPACT_CAP,
    LOG_COLUMNS,
    NO_TOUCH,
    NONE,
    ROUNDING_BOUND,
    TIME_REACHED,
    Array,
    AsymmetricBody,
    Contact,
    Plane,
    Setup,
)
from .contact import spin_growth_bound
from .event_loop import next_event
from .motion import MAX_TURN_RAD, clearance, rotational_energy, state_after_step, vertex_velocity

FIRST_ROWS = 16
"""Rows of the log that are allocated first; doubled where they are used up."""


@inner
def _attitude_rates(body: AsymmetricBody, y: Array, values: Array, out: Array) -> None:
    """Fill `out` (22,) with the rates of `values`: quaternion (4), Φ (3 × 3) and Ψ (3 × 3) row by row.

    δ' = W (δL - δ × L) for a turn δ of the attitude, so Φ' = W [L]× Φ and Ψ' = W [L]× Ψ + W.
    """
    y[3:7] = values[:4]
    attitude_rates(body, y, out)
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
def attitude_step(body: AsymmetricBody, y: Array, flow: Array, dt: float, room: Array) -> None:
    """One step of the attitude in flight, in place in `y` and in `flow` (22,): the quaternion, Φ and Ψ.

    `room` (14, 22). Of the body only the moments count.
    """
    start, values = room[START], room[VALUES]
    for k in range(22):
        start[k] = flow[k]
    for stage in range(STAGES + 1):
        stage_values(room, stage, dt, 22)
        if stage < STAGES:
            _attitude_rates(body, y, values, room[stage])
    length = sqrt(values[0] * values[0] + values[1] * values[1] + values[2] * values[2] + values[3] * values[3])
    for k in range(22):
        flow[k] = values[k] / length if k < 4 else values[k]
    for k in range(4):
        y[3 + k] = flow[k]


@inner
def _fly(
    body: AsymmetricBody,
    plane: Plane,
    y: Array,
    dt: float,
    sources: ParameterDerivatives,
    tangent: Array,
    stiffer: Array,
    room: Array,
) -> None:
    """Carry a state in flight and its derivatives (12, 12 + m) through `dt` [s], of either sign, in place.

    `stiffer` (12 + m,) [kg m²] is by how much each column changes the moments of inertia, and so ω for the same L.
    """
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    steps = max(1, ceil(abs(dt) * spin / MAX_TURN_RAD))
    now = np.empty(22)
    for _ in range(steps):
        ox, oy, oz = angular_velocity_of(body, y, y[10], y[11], y[12])
        for k in range(22):
            now[k] = y[3 + k] if k < 4 else 0.0
        now[4], now[8], now[12] = 1.0, 1.0, 1.0
        attitude_step(body, y, now, dt / steps, room)
        for j in range(tangent.shape[1]):
            dx, dy, dz = tangent[3, j], tangent[4, j], tangent[5, j]
            lx = tangent[9, j] - stiffer[j] * ox
            ly = tangent[10, j] - stiffer[j] * oy
            lz = tangent[11, j] - stiffer[j] * oz
            for k in range(3):
                i, n = 4 + 3 * k, 13 + 3 * k
                turned = now[i] * dx + now[i + 1] * dy + now[i + 2] * dz
                tangent[3 + k, j] = turned + now[n] * lx + now[n + 1] * ly + now[n + 2] * lz
    for k in range(3):
        for j in range(tangent.shape[1]):
            gravity_change = sources.gravity[j - 12, k] if j >= 12 else 0.0
            tangent[k, j] += (tangent[6 + k, j] + 0.5 * gravity_change * dt) * dt
            tangent[6 + k, j] += gravity_change * dt
    y[0] += (y[7] + 0.5 * plane.gx * dt) * dt
    y[1] += (y[8] + 0.5 * plane.gy * dt) * dt
    y[2] += (y[9] - 0.5 * plane.g * dt) * dt
    y[7] += plane.gx * dt
    y[8] += plane.gy * dt
    y[9] -= plane.g * dt


@inner
def _impact_with_tangent(
    setup: Setup, y: Array, time: float, i: int, derivatives: ImpactDerivatives, tangent: Array, dtime: Array
) -> None:
    """Carry state and derivatives through the impact of vertex i, in place; fills the gradient of `derivatives`.

    `dtime` (12 + m,) receives the derivative of the instant.
    """
    body, law, plane, _ = setup
    x, r, level = lever_arm(body.vertices[i], y)
    z = level - body.corner_radius
    ox, oy, oz = angular_velocity_of(body, y, y[10], y[11], y[12])
    v_table = table_velocity(plane, time)
    c = (y[7] + oy * z - oz * r, y[8] + oz * x - ox * z, y[9] + ox * r - oy * x - v_table)
    sx, sy, sz = impulse_gradient(
        law, tensor_inertia(body, y), (x, r, z), c, derivatives.wanted, derivatives.changes, derivatives.gradient
    )
    tx, ty, tz = r * sz - z * sy, z * sx - x * sz, x * sy - r * sx
    kx, ky, kz = angular_velocity_of(body, y, tx, ty, tz)
    impact = Impact(x, r, z, level, c[2], sx, sy, sz, ox, oy, oz, kx, ky, kz, body.mass, 1.0, 0.0)
    kinematics = ImpactKinematics(
        v_table, table_acceleration(plane, time), plane.gx, plane.gy, -plane.g, 0.0, 0.0, 0.0, 0.0, 0.0
    )
    saltation(body, y, impact, kinematics, derivatives, tangent, tangent.shape[1], dtime)
    y[7] += sx / body.mass
    y[8] += sy / body.mass
    y[9] += sz / body.mass
    y[10] += tx
    y[11] += ty
    y[12] += tz


@inner
def _earlier_crossing(flight: Contact, y: Array, time: float, i: int, stages: Array, now: Array) -> float:
    """How long ago [s, negative] vertex i, which is below the table and sinks, crossed it, as `flight.touch_of_vertex`.

    NaN for longer than the die takes to fall its own radius.
    """
    body, plane, _, _ = flight
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    bound = spin * spin * (1.0 + spin_growth_bound(body) / sqrt(3.0)) * body.radius + peak_table_acceleration - plane.g
    bound = max(bound, LEAST_BOUND * plane.g)  # h'' is no larger; kept above 0 for the division
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
        state_after_step(flight, back, time + t, -step, stages, now)
        back[:] = now
        t -= step
    return nan


@inner
def _with_one_vertex(body: AsymmetricBody, i: int) -> AsymmetricBody:
    """The same body with only one of its vertices."""
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
        body.safe_tilt_cosines[i : i + 1],
        body.corner_radius,
    )


@compiled
def run_asymmetric_tangent(
    setup: Setup,
    start: Array,
    start_time: float,
    times: Array,
    sequence: ImpactSequence,
    seed: Array,
    sources: ParameterDerivatives,
) -> tuple[int, Array, Array, Array, Array]:
    """As `derivatives.run_tangent`, for impacts of an asymmetric body.

    `start` (13,) as for `run_asymmetric_throw`. `seed` (12, 12 + m) and all derivatives are of the centre of mass, and of L
    where those of a spherical body are of ω.
    """
    body, law, plane, precision = setup
    flight = Contact(body, plane, NONE, NONE)
    y = to_angular_momentum(body, start)
    n, columns = times.shape[0], seed.shape[1]
    poses, jacobian = np.empty((n, 7)), np.empty((n, 6, columns))
    log, dtimes = np.empty((FIRST_ROWS, LOG_COLUMNS)), np.empty((FIRST_ROWS, columns))
    tangent, there, pose = seed.copy(), np.empty((12, columns)), np.empty(13)
    now, before, shown = np.empty(13), np.empty(13), np.empty(13)
    stages, room, stiffer = np.empty((14, 8)), np.empty((14, 22)), np.zeros(columns)
    stiffer[12:] = sources.inertia
    slow = chatter_speed(law, plane, precision, body.radius)
    shifts = np.empty((columns - 12, SHIFTS))
    derivatives = impact_derivatives(law, ASYMMETRIC_INPUTS, np.any(sources.chi), np.any(sources.mu), shifts, inf)
    last = times[n - 1] if n > 0 else start_time
    time, done, impacts, ending, fresh = start_time, 0, 0, TIME_REACHED, True
    while True:
        hit, dt, ends = -1, inf, False
        to_angular_velocity(body, y, shown)
        if not is_in_range(shown):
            fill_with_nan(poses, jacobian, done)
            return NO_TOUCH, poses, jacobian, log[:impacts], dtimes[:impacts]
        if not sequence.free and impacts == sequence.vertices.shape[0]:
            ends = True
        elif sequence.free:
            ends = time >= last
            if not ends:
                dt, hit, velocity, acceleration = next_event(flight, precision, y, time, last - time, stages, now)
                if hit >= 0 and (velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)):
                    ends, ending = True, CHATTER
                elif hit >= 0 and impacts >= sequence.cap:
                    ends, ending = True, IMPACT_CAP
        else:
            vertex = sequence.vertices[impacts]
            below = BELOW_TABLE * body.radius
            sunk = clearance(body, plane, y, time, vertex) < below
            if fresh and sunk and vertex_velocity(body, plane, y, time, vertex) < 0.0:
                dt, hit = _earlier_crossing(flight, y, time, vertex, stages, now), vertex
                ends = not dt <= 0.0
            else:
                alone = Contact(_with_one_vertex(body, vertex), plane, NONE, NONE)
                dt, hit, velocity, _ = next_event(alone, precision, y, time, inf, stages, now)
                if hit >= 0:
                    hit = vertex
                    ends = velocity >= 0.0 or clearance(body, plane, now, time + dt, vertex) < below
            if ends:
                ending = NO_TOUCH
        while done < n and (ends or times[done] < time + dt):
            pose[:], there[:] = y, tangent
            _fly(body, plane, pose, times[done] - time, sources, there, stiffer, room)
            poses[done] = pose[:7]
            jacobian[done] = there[:6]
            done += 1
        if ends:
            return ending, poses, jacobian, log[:impacts], dtimes[:impacts]
        _fly(body, plane, y, dt, sources, tangent, stiffer, room)
        time += dt
        fresh = hit >= 0
        if hit < 0:
            continue
        log, dtimes = with_room(log, impacts), with_room(dtimes, impacts)
        to_angular_velocity(body, y, before)
        shifts_at_impact(sources, plane, time, hit, y, shifts)
        _impact_with_tangent(setup, y, time, hit, derivatives, tangent, dtimes[impacts])
        to_angular_velocity(body, y, shown)
        write_event(log[impacts], time, hit, before, shown, -1, -1, 0.0)
        impacts += 1
