"""Held contact without friction: what is held, how it moves, and what ends it.

A die on one vertex is Lagrange's top on a smooth table; on an edge it is a rod that falls over while it turns about the
vertical; on a face it lies. The horizontal velocity of the centre and ω_z stay constant. Orientation, ω_x and ω_y are
integrated by the method of order 8 of `runge_kutta`, in steps of a given turn, and the height follows from the contact. A step
ends where a force falls through zero or another vertex touches; that instant is found by shorter steps of the same method
from the same state, so that it is as accurate as the motion. Equations: `throw.held_contact`.

In air the drag on the centre of mass adds to the weight on the contact and slows the horizontal motion, so position and
horizontal velocity are integrated too. It has no moment about the centre.

Forces are per mass [m/s²]. Vertices i and j are held, j = -1 where there is only one.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np
from numba.extending import overload

from ..compiled import compiled, inner
from .flight import (
    advance,
    centripetal_acceleration,
    clearance,
    lever_arm,
    spin_rate,
    table_acceleration,
    table_height,
    table_velocity,
    vertex_velocity,
)
from .impact import solve_normal_forces
from .log import copy_to, with_knot
from .rest import lowest_face_row
from .runge_kutta import NODES, STAGES, START, VALUES, stage_values
from .types import (
    BALANCED,
    FORCE_I,
    FORCE_J,
    NO_EVENT,
    NONE,
    NOT_ENDED,
    ROUNDING_BOUND,
    STANDING_HEIGHT,
    TIME_REACHED,
    Array,
    Body,
    Contact,
    Indices,
    Knots,
    Plane,
    PlaneInAir,
    Precision,
)

RESTING_ACCELERATION = 1e-9
"""Acceleration in units of g below which a vertex rests, and part of the largest force below which another force is none. It
lies far above what the sweeps leave and far below what lifts a vertex."""

MAX_BRACKETING_STEPS = 100
"""Of the search for the instant of an event; some ten are used."""

BRACKET_GUARD = 0.001
"""Part of the bracket that a step of that search keeps from either end."""

INSTANT_TOLERANCE = 4e-16
"""Relative width of the bracket at which the search ends: two units in the last place."""

SHORTEST_RISE = 1e-12
"""Part of a step within which a released vertex is looked for above the table."""

RISES_TRIED = (0.125, 0.25, 0.5)
"""Parts of a step at which a vertex that stands on the table, and is not held, is looked for below it."""

CUBIC_ALLOWANCE = 0.05
"""Largest height of the minimum of the cubic through both ends of a step, as a part of the heights there, for which the step
is searched for a touch. The cubic misses the true minimum by far less."""

MAX_DIP_STEPS = 50
DIP_GUARD = 0.05
DIP_TOLERANCE = 1e-7
"""Steps of the search for the lowest instant of a vertex, the part of the bracket kept from either end, and the width of the
bracket, as a part of the step, at which the search ends."""

STEP_SIZE, STEP_SIZE_IN_AIR = 6, 10
"""What a step integrates: the quaternion, ω_x and ω_y; in air also x, y, and their velocities."""


@compiled
def step_workspace() -> Array:
    """Room for one step of the integration; see `runge_kutta`."""
    return np.empty((14, STEP_SIZE_IN_AIR))


# --- The weight, and one step ---


@inner
def weight_in_air(plane: PlaneInAir, state: Array, time: float) -> float:
    """`weight` against drag."""
    speed = sqrt(state[7] * state[7] + state[8] * state[8] + state[9] * state[9])
    return plane.g + table_acceleration(plane, time) + plane.drag * speed * state[9]


def weight(plane: Plane | PlaneInAir, state: Array, time: float) -> float:
    """What presses a die that moves as the table does onto it, per mass [m/s²]: g, the table's acceleration, and the drag."""
    if isinstance(plane, PlaneInAir):
        return float(weight_in_air(plane, state, time))
    return float(plane.g + table_acceleration(plane, time))


@overload(weight, strict=False)
def _weight_of(plane: Any, state: Any, time: Any) -> Any:
    """The branch of `weight` that the type of the plane asks for, chosen when it is compiled."""
    if plane.instance_class is PlaneInAir:
        return weight_in_air.py_func
    return lambda plane, state, time: plane.g + table_acceleration(plane, time)


@inner
def contact_forces(body: Body, state: Array, i: int, j: int, weight: float) -> tuple[float, float, float, float]:
    """Normal forces on the held vertices, and the ω̇_x and ω̇_y [rad/s²] that they cause.

    `weight` [m/s²] is g and the acceleration of the table. A force below 0 would have to pull.
    """
    k = body.inertia / body.mass
    a = lever_arm(body.vertices[i], state)
    free_i = weight - centripetal_acceleration(state, a)
    a_ii = 1.0 + (a[0] * a[0] + a[1] * a[1]) / k
    if j < 0:
        n = free_i / a_ii
        return n, 0.0, n * a[1] / k, -n * a[0] / k
    b = lever_arm(body.vertices[j], state)
    free_j = weight - centripetal_acceleration(state, b)
    a_jj = 1.0 + (b[0] * b[0] + b[1] * b[1]) / k
    a_ij = 1.0 + (a[0] * b[0] + a[1] * b[1]) / k
    # Two vertices never stand above each other, so that the determinant is positive.
    inverse = 1.0 / (a_ii * a_jj - a_ij * a_ij)
    n_i, n_j = (a_jj * free_i - a_ij * free_j) * inverse, (a_ii * free_j - a_ij * free_i) * inverse
    return n_i, n_j, (n_i * a[1] + n_j * b[1]) / k, -(n_i * a[0] + n_j * b[0]) / k


@compiled
def held_step(contact: Contact, state: Array, time: float, dt: float, room: Array, after: Array) -> None:
    """Carry a state in held contact over dt [s] into `after`; `room` is a `step_workspace`.

    The horizontal velocity changes only by a tilt of the table.
    """
    body, plane, i, j = contact
    for m in range(4):
        room[START, m] = state[3 + m]
    room[START, 4], room[START, 5] = state[10], state[11]
    after[12] = state[12]
    for stage in range(STAGES + 1):
        stage_values(room, stage, dt, STEP_SIZE)
        for m in range(4):
            after[3 + m] = room[VALUES, m]
        after[10], after[11] = room[VALUES, 4], room[VALUES, 5]
        if stage < STAGES:
            pull = plane.g + table_acceleration(plane, time + NODES[stage] * dt)
            _, _, room[stage, 4], room[stage, 5] = contact_forces(body, after, i, j, pull)
            quaternion_rates(after, room[stage])
    after[0] = state[0] + (state[7] + 0.5 * plane.gx * dt) * dt
    after[1] = state[1] + (state[8] + 0.5 * plane.gy * dt) * dt
    after[7], after[8] = state[7] + plane.gx * dt, state[8] + plane.gy * dt
    project_on_contact(contact, after, time + dt)


@inner
def quaternion_rates(state: Array, out: Array) -> None:
    """Fill out[:4] with the rates of the quaternion of a state."""
    x, y, z = 0.5 * state[10], 0.5 * state[11], 0.5 * state[12]
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    out[0] = -x * qx - y * qy - z * qz
    out[1] = x * qw + y * qz - z * qy
    out[2] = -x * qz + y * qw + z * qx
    out[3] = x * qy - y * qx + z * qw


@compiled
def held_step_in_air(contact: Contact, state: Array, time: float, dt: float, room: Array, after: Array) -> None:
    """`held_step` against drag."""
    body, plane, i, j = contact
    for m in range(4):
        room[START, m] = state[3 + m]
    for m in range(2):
        room[START, 4 + m], room[START, 6 + m], room[START, 8 + m] = state[10 + m], state[m], state[7 + m]
    after[12] = state[12]
    for stage in range(STAGES + 1):
        stage_values(room, stage, dt, STEP_SIZE_IN_AIR)
        for m in range(4):
            after[3 + m] = room[VALUES, m]
        for m in range(2):
            after[10 + m], after[m], after[7 + m] = room[VALUES, 4 + m], room[VALUES, 6 + m], room[VALUES, 8 + m]
        if stage < STAGES:
            at = time + NODES[stage] * dt
            x, y, _ = lever_arm(body.vertices[i], after)
            after[9] = table_velocity(plane, at) - after[10] * y + after[11] * x
            drag = plane.drag * sqrt(after[7] * after[7] + after[8] * after[8] + after[9] * after[9])
            pull = plane.g + table_acceleration(plane, at) + drag * after[9]
            _, _, room[stage, 4], room[stage, 5] = contact_forces(body, after, i, j, pull)
            quaternion_rates(after, room[stage])
            room[stage, 6], room[stage, 7] = after[7], after[8]
            room[stage, 8], room[stage, 9] = plane.gx - drag * after[7], plane.gy - drag * after[8]
    project_on_contact(contact, after, time + dt)


def contact_step(contact: Contact, state: Array, time: float, dt: float, room: Array, after: Array) -> None:
    """`held_step`, in vacuum or against drag."""
    if isinstance(contact.plane, PlaneInAir):
        held_step_in_air(contact, state, time, dt, room, after)
    else:
        held_step(contact, state, time, dt, room, after)


@overload(contact_step, strict=False)
def _contact_step_of(contact: Any, state: Any, time: Any, dt: Any, room: Any, after: Any) -> Any:
    """The branch of `contact_step` that the type of the plane asks for, chosen when it is compiled. Python calls the same
    kernels, so that each is compiled once."""

    def in_air(contact: Any, state: Any, time: Any, dt: Any, room: Any, after: Any) -> None:
        held_step_in_air(contact, state, time, dt, room, after)

    def in_vacuum(contact: Any, state: Any, time: Any, dt: Any, room: Any, after: Any) -> None:
        held_step(contact, state, time, dt, room, after)

    return in_air if contact[1].instance_class is PlaneInAir else in_vacuum


@inner
def project_on_contact(contact: Contact, state: Array, time: float) -> None:
    """Put the state exactly on its contact, in place; this only removes rounding.

    The quaternion gets length 1, the held vertices stand on the table and at rest relative to it, an edge lies level.
    """
    body, plane, i, j = contact
    norm = sqrt(state[3] * state[3] + state[4] * state[4] + state[5] * state[5] + state[6] * state[6])
    for m in range(3, 7):
        state[m] /= norm
    a = lever_arm(body.vertices[i], state)
    if j >= 0:
        b = lever_arm(body.vertices[j], state)
        ex, ey = b[0] - a[0], b[1] - a[1]
        length = sqrt(ex * ex + ey * ey)
        ex, ey = ex / length, ey / length
        # A turn about the horizontal normal (-e_y, e_x) of the edge lifts its far end by -angle × length.
        angle = 0.5 * (b[2] - a[2]) / length
        qw, qx, qy, qz = state[3], state[4], state[5], state[6]
        x, y = -ey * angle, ex * angle
        state[3] = qw - x * qx - y * qy
        state[4] = qx + x * qw + y * qz
        state[5] = qy - x * qz + y * qw
        state[6] = qz + x * qy - y * qx
        along = state[10] * ex + state[11] * ey
        state[10], state[11] = along * ex, along * ey
        a = lever_arm(body.vertices[i], state)
    state[2] = table_height(plane, time) - a[2]
    state[9] = table_velocity(plane, time) - state[10] * a[1] + state[11] * a[0]


@compiled
def carry_on_face(state: Array, plane: Plane, time: float, dt: float) -> None:
    """Carry a die that lies on a face through dt [s], in place: it moves horizontally and turns about the vertical."""
    spin = abs(state[12])
    advance(state, spin, dt, Plane(plane.gx, plane.gy, 0.0, 0.0, 0.0, 0.0))
    state[2] += table_height(plane, time + dt) - table_height(plane, time) - state[9] * dt
    state[9] = table_velocity(plane, time + dt)


@inner
def lay_on_face(body: Body, plane: Plane, state: Array, time: float, i: int) -> None:
    """Lay the die exactly on its lowest face, to which vertex i belongs, in place; only its turn about the vertical stays.

    This removes the rest of a tilt within which all corners count as touching.
    """
    face = lowest_face_row(body.normals, state)
    nx, ny, _ = lever_arm(body.normals[face], state)
    # The turn that brings the normal to -z, about (-n_y, n_x): its tilt is below 1e-9, so half the sine is exact.
    x, y = -0.5 * ny, 0.5 * nx
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    state[3] = qw - x * qx - y * qy
    state[4] = qx + x * qw + y * qz
    state[5] = qy - x * qz + y * qw
    state[6] = qz + x * qy - y * qx
    norm = sqrt(state[3] * state[3] + state[4] * state[4] + state[5] * state[5] + state[6] * state[6])
    for m in range(3, 7):
        state[m] /= norm
    state[2] = table_height(plane, time) - lever_arm(body.vertices[i], state)[2]
    state[9], state[10], state[11] = table_velocity(plane, time), 0.0, 0.0


@inner
def remove_normal_velocity(contact: Contact, state: Array, time: float) -> None:
    """Remove the vertical velocity of the held vertices, in place, by impulses on them.

    This is a projection in the metric of the kinetic energy, which therefore cannot rise.
    """
    body, plane, i, j = contact
    k = body.inertia / body.mass
    v_table = table_velocity(plane, time)
    a = lever_arm(body.vertices[i], state)
    u_i = state[9] + state[10] * a[1] - state[11] * a[0] - v_table
    a_ii = 1.0 + (a[0] * a[0] + a[1] * a[1]) / k
    if j < 0:
        p = -u_i / a_ii
        state[9] += p
        state[10] += p * a[1] / k
        state[11] -= p * a[0] / k
        return
    b = lever_arm(body.vertices[j], state)
    u_j = state[9] + state[10] * b[1] - state[11] * b[0] - v_table
    a_jj = 1.0 + (b[0] * b[0] + b[1] * b[1]) / k
    a_ij = 1.0 + (a[0] * b[0] + a[1] * b[1]) / k
    inverse = 1.0 / (a_ii * a_jj - a_ij * a_ij)
    p, q = (a_ij * u_j - a_jj * u_i) * inverse, (a_ij * u_i - a_ii * u_j) * inverse
    state[9] += p + q
    state[10] += (p * a[1] + q * b[1]) / k
    state[11] -= (p * a[0] + q * b[0]) / k


@inner
def pressed_set(
    body: Body, plane: Plane, state: Array, time: float, touching: Indices, n: int, room: Array
) -> tuple[int, int]:
    """The contact of the touching vertices at rest that the die presses on: (-1, -1), (i, -1), (i, j), or (i, -2) for a face.

    One or two are decided exactly, by the signs of their forces. Three or more are decided by projected Gauss-Seidel, whose
    accelerations are unique though its forces are not.
    """
    pull = weight(plane, state, time)
    if n == 0:
        return -1, -1
    if n == 1:
        force, _, _, _ = contact_forces(body, state, touching[0], NONE, pull)
        return (touching[0], -1) if force > 0.0 else (-1, -1)
    motion, drive, forces = room[0], room[1], room[2]
    if n >= 3:
        motion[0], motion[1], motion[2] = -pull, 0.0, 0.0
        for m in range(n):
            drive[m] = centripetal_acceleration(state, lever_arm(body.vertices[touching[m]], state))
        solve_normal_forces(body, state, touching, n, motion, drive, forces)
        resting, first, second = 0, -1, -1
        for m in range(n):
            x, y, _ = lever_arm(body.vertices[touching[m]], state)
            if abs(motion[0] + motion[1] * y - motion[2] * x + drive[m]) <= RESTING_ACCELERATION * plane.g:
                resting += 1
            if forces[m] > 0.0:
                if first < 0 or forces[m] > forces[first]:
                    first, second = m, first
                elif second < 0 or forces[m] > forces[second]:
                    second = m
        if first < 0:
            return -1, -1
        if resting >= 3:
            return touching[first], -2
        if second < 0 or forces[second] <= RESTING_ACCELERATION * forces[first]:
            return touching[first], -1
        return touching[first], touching[second]
    i, j = touching[0], touching[1]
    n_i, n_j, _, _ = contact_forces(body, state, i, j, pull)
    if n_i > 0.0 and n_j > 0.0:
        return i, j
    # One is released: the one that rises when only the other is held.
    for p in range(2):
        held, other = touching[p], touching[1 - p]
        force, _, wx, wy = contact_forces(body, state, held, NONE, pull)
        x, y, _ = lever_arm(body.vertices[other], state)
        rises = force - pull + wx * y - wy * x + centripetal_acceleration(state, lever_arm(body.vertices[other], state))
        if force > 0.0 and rises >= 0.0:
            return held, -1
    return -1, -1


@inner(shared=True)
def follow_held_contact(
    contact: Contact,
    precision: Precision,
    state: Array,
    time: float,
    limit: float,
    check_balance: bool,
    knots: Knots,
    room: Array,
) -> tuple[int, float, int, Knots]:
    """Carry the state in place through held contact to its end, or to `limit` [s].

    Returns NOT_ENDED or another ending, the duration [s], the vertex that touches (-1: a held one is released, or the limit
    came), and the knots. `check_balance` asks whether the die stands balanced.
    """
    body, plane, i, j = contact
    begin, after = time, np.empty(13)
    fixed = plane.amplitude == 0.0
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    while True:
        knots = with_knot(knots, time, state)
        pull = weight(plane, state, time)
        if check_balance and fixed and is_balanced(body, state, i, j, pull):
            return BALANCED, time - begin, -1, knots
        dt = precision.step_turn / (
            spin_rate(state)
            + sqrt((plane.g + peak_table_acceleration) * body.radius * body.mass / body.inertia)
            + (0.0 if fixed else plane.rate)
        )
        dt = min(dt, begin + limit - time)
        contact_step(contact, state, time, dt, room, after)
        first, event = dt, NO_EVENT
        pull = weight(plane, after, time + dt)
        n_i, n_j, _, _ = contact_forces(body, after, i, j, pull)
        if n_i <= 0.0:
            first, event = earlier_event(contact, state, time, dt, FORCE_I, first, event, room)
        if j >= 0 and n_j <= 0.0:
            first, event = earlier_event(contact, state, time, dt, FORCE_J, first, event, room)
        z_table = table_height(plane, time + dt)
        for k in range(body.vertices.shape[0]):
            if k != i and k != j:
                within = dt
                if clearance(body.vertices[k], after, z_table) > 0.0:
                    within = instant_below_table(contact, state, after, time, dt, k, room)
                if within > 0.0:
                    first, event = earlier_event(contact, state, time, within, k, first, event, room)
        if event != NO_EVENT:
            if first > 0.0:
                contact_step(contact, state, time, first, room, after)
                copy_to(state, after)
            return NOT_ENDED, time + first - begin, max(event, -1), knots
        copy_to(state, after)
        time += dt
        if time >= begin + limit:
            return TIME_REACHED, limit, -1, knots


@inner
def is_balanced(body: Body, state: Array, i: int, j: int, pull: float) -> bool:
    """Whether a held die neither falls over nor begins to, but for rounding: it stands on its vertex or edge for ever."""
    rate = sqrt(pull / body.radius)
    if max(abs(state[10]), abs(state[11])) > ROUNDING_BOUND * rate:
        return False
    _, _, wx, wy = contact_forces(body, state, i, j, pull)
    if j < 0:
        return bool(max(abs(wx), abs(wy)) <= ROUNDING_BOUND * rate * rate)
    # An edge can only turn about itself.
    a, b = lever_arm(body.vertices[i], state), lever_arm(body.vertices[j], state)
    ex, ey = b[0] - a[0], b[1] - a[1]
    return bool(abs(wx * ex + wy * ey) <= ROUNDING_BOUND * rate * rate * sqrt(ex * ex + ey * ey))


@inner
def earlier_event(
    contact: Contact, state: Array, time: float, dt: float, event: int, first: float, best: int, room: Array
) -> tuple[float, int]:
    """The earlier of an event within dt [s] and the first one known so far, with its time [s]."""
    t = event_instant(contact, state, time, dt, event, room, np.empty(13))
    return (t, event) if t < first or best == NO_EVENT else (first, best)


@inner
def event_instant(
    contact: Contact, state: Array, time: float, dt: float, event: int, room: Array, after: Array
) -> float:
    """The instant [s] within dt after `state` at which an event function falls through zero.

    Regula falsi on steps of the integration (Illinois: an end of the bracket that stays twice weighs half). Of a force the
    first value not above zero counts, of a height the last above zero. `after` is overwritten.
    """
    body, plane, _, _ = contact
    low, high = 0.0, dt
    f_low = event_function(contact, state, time, event)
    contact_step(contact, state, time, dt, room, after)
    f_high = event_function(contact, after, time + dt, event)
    if event >= 0 and f_low <= STANDING_HEIGHT * body.radius:
        # A vertex that has just been released rises first: step back to where it is up.
        t = 0.5 * dt
        while t > SHORTEST_RISE * dt:
            contact_step(contact, state, time, t, room, after)
            f_low = event_function(contact, after, time + t, event)
            if f_low > 0.0:
                low = t
                break
            high, f_high = t, f_low
            t *= 0.5
        if low == 0.0:
            return 0.0
    elif f_low <= 0.0:
        return 0.0
    side = 0
    for _ in range(MAX_BRACKETING_STEPS):
        if high - low <= INSTANT_TOLERANCE * (abs(time) + high):
            break
        t = (low * f_high - high * f_low) / (f_high - f_low)
        t = min(max(t, low + BRACKET_GUARD * (high - low)), high - BRACKET_GUARD * (high - low))
        contact_step(contact, state, time, t, room, after)
        f = event_function(contact, after, time + t, event)
        if f > 0.0:
            low, f_low = t, f
            if side == 1:
                f_high *= 0.5
            side = 1
            if event >= 0 and f <= ROUNDING_BOUND * body.radius:
                break
        else:
            high, f_high = t, f
            if side == -1:
                f_low *= 0.5
            side = -1
            if f >= -ROUNDING_BOUND * (plane.g if event < 0 else body.radius):
                low = t if event >= 0 else low
                break
    return low if event >= 0 else high


@inner
def event_function(contact: Contact, state: Array, time: float, event: int) -> float:
    """The height [m] of vertex `event`, or for FORCE_I and FORCE_J the force per mass [m/s²] on vertex i or j."""
    body, plane, i, j = contact
    if event >= 0:
        return clearance(body.vertices[event], state, table_height(plane, time))
    n_i, n_j, _, _ = contact_forces(body, state, i, j, weight(plane, state, time))
    return n_i if event == FORCE_I else n_j


@inner
def instant_below_table(
    contact: Contact, state: Array, after: Array, time: float, dt: float, k: int, room: Array
) -> float:
    """An instant [s] within a step from `state` to `after` at which vertex k is below the table, or 0 where there is none.

    At the end of the step the vertex is above the table. Where it sinks and rises again, its lowest instant is looked for.
    """
    body, plane, _, _ = contact
    h0, h1 = (
        clearance(body.vertices[k], state, table_height(plane, time)),
        clearance(body.vertices[k], after, table_height(plane, time + dt)),
    )
    v0, v1 = vertex_velocity(body, plane, state, time, k), vertex_velocity(body, plane, after, time + dt, k)
    if v1 <= 0.0:
        return 0.0
    trial = np.empty(13)
    if h0 <= STANDING_HEIGHT * body.radius:
        # It stands on the table and is not held. Its velocity is rounding, so that only its height decides.
        for part in RISES_TRIED:
            contact_step(contact, state, time, part * dt, room, trial)
            if (
                clearance(body.vertices[k], trial, table_height(plane, time + part * dt))
                < -ROUNDING_BOUND * body.radius
            ):
                return part * dt
        return 0.0
    t, lowest = cubic_minimum(h0, v0 * dt, h1, v1 * dt)
    if lowest > CUBIC_ALLOWANCE * max(h0, h1):
        return 0.0
    t *= dt
    low, high, v_low, v_high = 0.0, dt, v0, v1
    for step in range(MAX_DIP_STEPS):
        if step > 0:
            if v_low >= 0.0:
                return 0.0
            t = (low * v_high - high * v_low) / (v_high - v_low)
            t = min(max(t, low + DIP_GUARD * (high - low)), high - DIP_GUARD * (high - low))
        contact_step(contact, state, time, t, room, trial)
        if clearance(body.vertices[k], trial, table_height(plane, time + t)) < 0.0:
            return t
        v = vertex_velocity(body, plane, trial, time + t, k)
        if v < 0.0:
            low, v_low = t, v
        else:
            high, v_high = t, v
        if high - low <= DIP_TOLERANCE * dt:
            break
    return 0.0


@inner
def cubic_minimum(h0: float, d0: float, h1: float, d1: float) -> tuple[float, float]:
    """Where the least of seven values of the cubic with these ends and slopes on [0, 1] lies, and that value."""
    lowest, where = inf, 0.5
    for m in range(1, 8):
        t = m / 8.0
        u = 1.0 - t
        h = u * u * ((1.0 + 2.0 * t) * h0 + t * d0) + t * t * ((1.0 + 2.0 * u) * h1 - u * d1)
        if h < lowest:
            lowest, where = h, t
    return where, lowest
