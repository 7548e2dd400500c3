"""model.engine.asymmetric.event_loop."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from ...compiled import compiled, inner
from ..types import (
    BALANCED,
    IMPACT_CAP,
    IMPACTS_REACHED,
    LOG_COLUMNS,
    RESTED,
    SPINNING,
    TIME_REACHED,
    Law,
    Plane,
    Precision,
)
from .contact import (
    apply_vertical_impulse,
    decided_face,
    face_contact_duration,
    lay_on_face,
    project_on_contact,
    resolve_contacts,
    spin_growth_bound,
)
from .motion import (
    MAX_TURN_RAD,
    ROUNDING_BOUND,
    Array,
    AsymmetricBody,
    body_angular_velocity,
    clearance,
    contact_forces,
    free_acceleration,
    response,
    rotational_energy,
    state_after_step,
    to_world,
    vertex_velocity,
)

MAX_CONTACT_STEPS = 10_000
"""Steps in contact without an impact after which a throw with no time limit is reported as spinning for ever."""

_FLIGHT_STEP, _LET_GO = -1, -2
"""What ends a step that no touch ends: its length, or a held vertex that is no longer pressed."""


@inner
def next_event(
    body: AsymmetricBody,
    plane: Plane,
    precision: Precision,
    y: Array,
    time: float,
    limit: float,
    i: int,
    j: int,
    stages: Array,
    now: Array,
) -> tuple[float, int, float, float]:
    """One step of the motion, or less where something ends it first; `now` (13,) becomes the state there.

    Returns the time [s] from `y`, the vertex that touches (or _FLIGHT_STEP, _LET_GO), its velocity and acceleration
    relative to the table (0 for a velocity that is only rounding).
    """
    g, mass, radius = plane.g, body.mass, body.radius
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    growth = spin_growth_bound(body)
    if i < 0:
        push = 0.0
    else:
        # The spin changes in held contact: this step ends before it could outgrow its allowance.
        before = spin
        spin = 1.25 * spin + 0.25 * sqrt((g + peak_table_acceleration) / radius)
        push = g + peak_table_acceleration + radius * spin * spin * (1.0 + growth / sqrt(3.0))
        rate = push * sqrt(mass / body.moments[0]) + growth * spin * spin / sqrt(3.0)
        limit = min(limit, (spin - before) / rate)
    angular = growth * spin * spin / sqrt(3.0) + push * sqrt(mass / body.moments[0])
    longest = min(limit, min(precision.turn, MAX_TURN_RAD) / spin) if spin > 0.0 else limit
    if i >= 0 and plane.rate > 0.0 and plane.amplitude != 0.0:
        longest = min(longest, MAX_TURN_RAD / plane.rate)  # the table's motion enters the right side
    bound = g + peak_table_acceleration + push + radius * (spin * spin + angular)
    if i < 0:
        jerk = (
            radius * spin * ((1.0 + 2.0 * growth) * angular + 3.0 * angular + spin * spin)
            + peak_table_acceleration * plane.rate
        )
    else:
        jerk = 10.0 * (spin + sqrt((g + peak_table_acceleration) / radius) + plane.rate) * bound
    weightless = -1e-10 * mass * bound
    t, last, safe = 0.0, 0.0, 0.0
    space = y[2] - radius - plane.amplitude
    if i < 0 and space > 0.0:
        # No vertex reaches farther down than the circumscribed sphere: fall with it.
        safe = (y[9] + sqrt(y[9] * y[9] + 2.0 * g * space)) / g
    now[:] = y
    t = min(safe, longest)
    while True:
        if t > 0.0:
            state_after_step(body, plane, y, time, t, i, j, stages, now)
        if i >= 0:
            n, o = contact_forces(body, plane, now, time + t, i, j)
            if min(n, o) < weightless:
                for _ in range(60):
                    middle = 0.5 * (last + t)
                    if middle in (last, t):
                        break
                    state_after_step(body, plane, y, time, middle, i, j, stages, now)
                    n, o = contact_forces(body, plane, now, time + middle, i, j)
                    if min(n, o) < weightless:
                        t = middle
                    else:
                        last = middle
                state_after_step(body, plane, y, time, t, i, j, stages, now)
                return t, _LET_GO, 0.0, 0.0
        turned = 1.0 + spin * t
        phase = 1.0 + abs(plane.rate * (time + t)) + abs(plane.phase)
        h_tol = ROUNDING_BOUND * (abs(y[2]) + (abs(y[9]) + g * t) * t + radius * turned + plane.amplitude * phase)
        v_tol = ROUNDING_BOUND * (abs(y[9]) + g * t + spin * radius * turned + plane.amplitude * plane.rate * phase)
        h_tol = max(h_tol, precision.root)
        a_tol = (ROUNDING_BOUND * turned if i < 0 else 2e-14) * bound
        hit, hit_v, hit_a, step = -1, 0.0, 0.0, inf
        for k in range(body.vertices.shape[0]):
            if k in (i, j):
                continue
            h = clearance(body, plane, now, time + t, k)
            v = vertex_velocity(body, plane, now, time + t, k)
            ahead = inf
            if h > h_tol:
                root = sqrt(v * v + 2.0 * bound * h)
                ahead = (v + root) / bound if v > 0.0 else 2.0 * h / (root - v)
                if v <= 0.0 or ahead > 0.1 * longest:
                    step = min(step, ahead)
                    continue
            acceleration = free_acceleration(body, plane, now, time + t, k)
            if i >= 0:
                n, o = contact_forces(body, plane, now, time + t, i, j)
                acceleration += response(body, now, k, i) * n
                if j >= 0:
                    acceleration += response(body, now, k, j) * o
            if h <= h_tol:
                if v < -v_tol or (v <= v_tol and acceleration <= a_tol):
                    v = v if v < -v_tol else 0.0
                    if hit < 0 or v < hit_v:
                        hit, hit_v, hit_a = k, v, acceleration
                    continue
                v = max(v, 0.0)
                ahead = 2.0 * v / bound
            # Nor before the root of v s + h'' s²/2 - J s³/6: a vertex that was let go, with v and h'' small but growing,
            # so moves on by a multiple of the time since. The parabola alone took a thousand steps there.
            half = 0.5 * acceleration
            root = sqrt(half * half + 2.0 / 3.0 * v * jerk)
            ahead = max(ahead, 3.0 * (half + root) / jerk if half > 0.0 else 2.0 * v / (root - half))
            step = min(step, ahead)
        if hit >= 0:
            return t, hit, hit_v, hit_a
        if t >= longest:
            return longest, _FLIGHT_STEP, 0.0, 0.0
        last = t
        t = min(t + step, longest)


@inner
def to_angular_velocity(body: AsymmetricBody, y: Array, out: Array) -> None:
    """The state as others have it, with ω [rad/s, table axes] for L, into `out` (13,)."""
    p, q, r = body_angular_velocity(body, y)
    out[:] = y
    out[10], out[11], out[12] = to_world(y, p, q, r)


@inner
def to_angular_momentum(body: AsymmetricBody, state: Array) -> Array:
    """The inverse of `to_angular_velocity`."""
    y = state.copy()
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    a, b, c = y[10], y[11], y[12]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    y[10], y[11], y[12] = to_world(
        state,
        body.moments[0] * (a + w * tx + z * tz - v * ty),
        body.moments[1] * (b + w * ty + v * tx - x * tz),
        body.moments[2] * (c + w * tz + x * ty - z * tx),
    )
    return y


@inner
def room_for(rows: Array, used: int) -> Array:
    """The same rows, with room for as many again where all are used."""
    if used < rows.shape[0]:
        return rows
    larger = np.empty((2 * rows.shape[0], rows.shape[1]))
    larger[: rows.shape[0]] = rows
    return larger


@compiled
def run_asymmetric_throw(
    body: AsymmetricBody,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    duration: float,
    impact_limit: int,
    stop_when_decided: bool,
    impact_cap: int,
    keep: bool,
) -> tuple[int, int, int, float, Array, Array, Array]:
    """The event loop, like `kernels.run_throw`, for smooth impacts. Nothing is changed in its arguments.

    `start` (13,) and all states have the centre of mass's position, the quaternion of the principal axes, and ω.
    Returns the code of the ending, the number of impacts, the row of the face decided on (-1: none), the time [s] at
    which it ends, the state there, the log (events, ROW), and the knots (k, 15): event that began the motion (-1: the
    release), time, state at the beginning of each step. Both stay empty unless `keep`. In the log a vertex of -1 says
    that nothing strikes; the first held vertex of a die on a face is the row of the face.
    """
    y = to_angular_momentum(body, start)
    now, before, shown, stages = np.empty(13), np.empty(13), np.empty(13), np.empty((14, 8))
    chosen, room = np.empty(body.vertices.shape[0], np.int64), np.empty((2, body.vertices.shape[0]))
    log, knots = np.empty((64 if keep else 1, LOG_COLUMNS)), np.empty((64 if keep else 1, 15))
    chi = law.parameters[0]
    slow = 0.0 if chi >= 1.0 else precision.switch * sqrt(plane.g * body.radius)
    at_rest = plane.amplitude == 0.0
    time, end, impacts, events, known, steps, zero_step_count = start_time, start_time + duration, 0, 0, 0, 0, 0
    i, j, face, ending = -1, -1, -1, -1
    begins = True  # whether an event has just been: only then can the face become decided
    while True:
        if begins and at_rest:
            face = decided_face(body, plane, y)
        if keep:
            knots = room_for(knots, known)
            knots[known, 0], knots[known, 1] = events - 1, time
            to_angular_velocity(body, y, knots[known, 2:])
            known += 1
        dt, hit, velocity, acceleration = 0.0, _FLIGHT_STEP, 0.0, 0.0
        if j == -2:
            dt = face_contact_duration(body, plane, y, time, i)
            if dt == inf:
                face = i
            if dt == inf and (stop_when_decided or end == inf):
                ending = RESTED
                dt = 0.0
            elif dt >= end - time:
                ending, dt = TIME_REACHED, end - time
            state_after_step(body, plane, y, time, dt, i, j, stages, now)
            hit = _LET_GO
        elif face >= 0 and stop_when_decided and (i >= 0 or not keep):
            ending = RESTED
            now[:] = y
        else:
            dt, hit, velocity, acceleration = next_event(body, plane, precision, y, time, end - time, i, j, stages, now)
            if hit == _FLIGHT_STEP and time + dt >= end:
                ending = TIME_REACHED
            elif hit >= 0 and face >= 0 and stop_when_decided:
                ending = RESTED
        y[:] = now
        time += dt
        zero_step_count = zero_step_count + 1 if dt == 0.0 else 0
        reorder = hit == _LET_GO or (
            hit >= 0 and -velocity <= slow and (velocity == 0.0 or acceleration < 0.0 or i >= 0)
        )
        if ending < 0 and hit >= 0 and not reorder:
            if impacts >= impact_limit:
                ending = IMPACTS_REACHED
            elif impacts >= impact_cap:
                ending = IMPACT_CAP
        steps = steps + 1 if i >= 0 or reorder else 0
        if ending < 0 and steps > MAX_CONTACT_STEPS and end == inf:
            ending = BALANCED if rotational_energy(body, y) < 1e-9 * body.mass * plane.g * body.radius else SPINNING
        if ending >= 0:
            to_angular_velocity(body, y, shown)
            return ending, impacts, face, time, shown, log[: events if keep else 0], knots[: known if keep else 0]
        if i >= 0 and j != -2:
            project_on_contact(body, plane, y, time, i, j)
        begins = hit != _FLIGHT_STEP
        if not begins:
            continue
        to_angular_velocity(body, y, before)
        if reorder:
            hit = -1
            i, j = resolve_contacts(body, plane, y, time, slow, chosen, room)
            if j == -2:
                lay_on_face(body, plane, y, time, i)
            elif i >= 0:
                project_on_contact(body, plane, y, time, i, j)
            if zero_step_count > 20:
                # Rounding finds a touch where nothing presses, or the reverse, again and again: pass over the instant.
                skipped = 1e-9 * sqrt(body.radius / plane.g)
                state_after_step(body, plane, y, time, skipped, i, j, stages, now)
                y[:] = now
                time += skipped
        else:
            approach = vertex_velocity(body, plane, y, time, hit)
            apply_vertical_impulse(body, y, hit, -(1.0 + chi) * approach / response(body, y, hit, hit))
            i, j = -1, -1
            impacts += 1
        if keep:
            log = room_for(log, events)
            log[events, 0], log[events, 1] = time, hit
            log[events, 2:15] = before
            to_angular_velocity(body, y, shown)
            log[events, 15:21] = shown[7:13]
            log[events, 21], log[events, 22] = i, j
        events += 1


@compiled
def asymmetric_states_at(body: AsymmetricBody, plane: Plane, held: Array, knots: Array, times: Array) -> Array:
    """States (n, 13) at times (n,) [s] from the knots of `run_asymmetric_throw`.

    `held` (events, 2) are the last two columns of the log.
    """
    out, stages, now = np.empty((times.shape[0], 13)), np.empty((14, 8)), np.empty(13)
    for n in range(times.shape[0]):
        k = max(0, np.searchsorted(knots[:, 1], times[n], side="right") - 1)
        event = int(knots[k, 0])
        i, j = (int(held[event, 0]), int(held[event, 1])) if event >= 0 else (-1, -1)
        state_after_step(
            body, plane, to_angular_momentum(body, knots[k, 2:]), knots[k, 1], times[n] - knots[k, 1], i, j, stages, now
        )
        to_angular_velocity(body, now, out[n])
    return out
