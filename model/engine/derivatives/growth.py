"""model.engine.derivatives.growth."""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ...compiled import compiled, inner
from ..event_loop import run_throw
from ..flight import lever_arm, spin_rate, table_acceleration, table_height, table_velocity
from ..held_contact import (
    centripetal_acceleration,
    clearance,
    contact_forces,
    held_step,
    project_on_contact,
    remove_normal_velocity,
)
from ..impact import apply_impact
from ..log import copy_columns, copy_to, state_after
from ..sliding_contact import sliding_step
from ..types import (
    FALSE,
    FINE,
    FRICTION_STANDING_HEIGHT,
    IMPACTS_REACHED,
    NO_LIMIT,
    NONE,
    SMOOTH,
    TANGENT_ROWS,
    TRUE,
    ZERO,
    Array,
    Body,
    Law,
    Plane,
    Precision,
    RoughLaw,
)
from .impact_tangent import ImpactKinematics, bounce_tangent, flight_tangent, touch_delay

MAX_COLUMNS = 40
"""Room for columns of errors; they are brought back to twelve when it is full."""

MAX_BRANCHES = 16
"""Other orders of touches that are followed before a throw is given up as undecidable."""

SAFETY_FACTOR = 3.0
"""How many times its estimate an error may come to where the order of touches is asked for: the estimate adds up
independent errors by their squares."""

UNDECIDABLE_ERROR = 0.05
"""Error, in units of `scales_of`, beyond which another outcome must be reckoned with. Of 3700 throws whose face changed
with the tolerance of touches, none had reached less than 0.23."""

NEGLIGIBLE_DIFFERENCE = 1e-4
"""Difference that the order of two touches may make, in the same units, to be carried as an error; larger ones are
followed as throws of their own."""

_SMALL = 1e-5
"""Size of the differences that stand for derivatives, in the same units: their square, and rounding over it, are both
1e-10."""


@compiled
def scales_of(body: Body, plane: Plane) -> Array:
    """Units (12,) of the twelve disturbances: R, 1 rad, √(g R), √(g/R)."""
    scale = np.empty(12)
    for k in range(3):
        scale[k], scale[3 + k] = body.radius, 1.0
        scale[6 + k], scale[9 + k] = sqrt(plane.g * body.radius), sqrt(plane.g / body.radius)
    return scale


@inner
def scaled_length(tangent: Array, j: int, scale: Array) -> float:
    """Length of a column in units of `scale`."""
    square = 0.0
    for k in range(12):
        square += (tangent[k, j] / scale[k]) * (tangent[k, j] / scale[k])
    return sqrt(square)


@compiled
def displaced(state: Array, tangent: Array, j: int, step: float, out: Array) -> None:
    """The state moved by `step` times column j into `out`, to the second order."""
    for k in range(3):
        out[k] = state[k] + step * tangent[k, j]
        out[7 + k] = state[7 + k] + step * tangent[6 + k, j]
        out[10 + k] = state[10 + k] + step * tangent[9 + k, j]
    x, y, z = 0.5 * step * tangent[3, j], 0.5 * step * tangent[4, j], 0.5 * step * tangent[5, j]
    qw, qx, qy, qz = state[3], state[4], state[5], state[6]
    norm = sqrt(1.0 + x * x + y * y + z * z)
    out[3] = (qw - x * qx - y * qy - z * qz) / norm
    out[4] = (qx + x * qw + y * qz - z * qy) / norm
    out[5] = (qy - x * qz + y * qw + z * qx) / norm
    out[6] = (qz + x * qy - y * qx + z * qw) / norm


@inner
def tangent_between(a: Array, b: Array, weight: float, tangent: Array, j: int) -> None:
    """Write `weight` times the small disturbance that takes state b to state a into column j."""
    for k in range(3):
        tangent[k, j] = weight * (a[k] - b[k])
        tangent[6 + k, j] = weight * (a[7 + k] - b[7 + k])
        tangent[9 + k, j] = weight * (a[10 + k] - b[10 + k])
    w = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]
    twice = 2.0 * weight if w >= 0.0 else -2.0 * weight
    tangent[3, j] = twice * (a[4] * b[3] - a[3] * b[4] + a[6] * b[5] - a[5] * b[6])
    tangent[4, j] = twice * (a[5] * b[3] - a[3] * b[5] + a[4] * b[6] - a[6] * b[4])
    tangent[5, j] = twice * (a[6] * b[3] - a[3] * b[6] + a[5] * b[4] - a[4] * b[5])


@inner
def impact_at_vertex(body: Body, law: Law, plane: Plane, time: float, vertex: int, state: Array) -> None:
    """Apply the law to a vertex on the table, in place."""
    x, y, z = lever_arm(body.vertices[vertex], state)
    apply_impact(law, body.mass, body.inertia, (x, y, z - body.rounding), table_velocity(plane, time), state)


@inner
def is_held(vertex: int, i: int, j: int) -> bool:
    """Whether the columns i and j of a logged event hold a vertex; a face holds all that touch."""
    if j == -3:
        return (i >> vertex) & 1 == 1
    return i >= 0 and vertex in (i, j)


@inner
def impact_kinematics(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> ImpactKinematics:
    """What moves around an impact at `time`; i and j were held until then (-1: none)."""
    v_table, a_table = table_velocity(plane, time), table_acceleration(plane, time)
    if j == -3:
        # Friction has carried the die; it is taken to have done so with no acceleration.
        return ImpactKinematics(v_table, a_table, a_table, 0.0, 0.0, -plane.g)
    if i < 0 or j == -2:
        return ImpactKinematics(v_table, a_table, -plane.g, 0.0, 0.0, -plane.g)
    n_i, n_j, wx, wy = contact_forces(body, state, i, j, plane.g + a_table)
    return ImpactKinematics(v_table, a_table, n_i + n_j - plane.g, wx, wy, -plane.g)


@inner
def impact_tangent_of_errors(
    body: Body,
    law: Law,
    plane: Plane,
    time: float,
    vertex: int,
    state: Array,
    i: int,
    j: int,
    capped: bool,
    scale: Array,
    tangent: Array,
    columns: int,
    dtime: Array,
) -> None:
    """Carry disturbances (12, columns) through the impact of a vertex, in place; i and j were held until then.

    Smooth impacts have derivatives; of other laws differences are taken. `capped` bounds the delays, see `touch_delay`.
    """
    arm = lever_arm(body.vertices[vertex], state)
    kinematics = impact_kinematics(body, plane, state, time, i, j)
    reach = inf
    if capped:
        falling = abs(
            kinematics.rise
            + kinematics.turn_x * arm[1]
            - kinematics.turn_y * arm[0]
            + centripetal_acceleration(state, arm)
        )
        reach = 2.0 / max(abs(falling - kinematics.table_acceleration), plane.g)
    if law.code == SMOOTH:
        chi = law.parameters[0]
        bounce_tangent(tangent, columns, chi, body.mass, body.inertia, arm, state, kinematics, reach, dtime)
        return
    normal_velocity = state[9] + state[10] * arm[1] - state[11] * arm[0] - kinematics.table_velocity
    ahead, behind, after, there = np.empty(13), np.empty(13), state.copy(), np.empty((12, 1))
    impact_at_vertex(body, law, plane, time, vertex, after)
    for c in range(columns):
        dt = touch_delay(tangent, c, arm, normal_velocity, reach)
        dtime[c] = dt
        for k in range(3):
            there[k, 0] = tangent[k, c] + state[7 + k] * dt
            there[3 + k, 0] = tangent[3 + k, c] + state[10 + k] * dt
            there[6 + k, 0], there[9 + k, 0] = tangent[6 + k, c], tangent[9 + k, c]
        there[6, 0] += plane.gx * dt
        there[7, 0] += plane.gy * dt
        there[8, 0] += kinematics.rise * dt
        there[9, 0] += kinematics.turn_x * dt
        there[10, 0] += kinematics.turn_y * dt
        size = scaled_length(there, ZERO, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, there, ZERO, step, ahead)
            displaced(state, there, ZERO, -step, behind)
            impact_at_vertex(body, law, plane, time + step * dt, vertex, ahead)
            impact_at_vertex(body, law, plane, time - step * dt, vertex, behind)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)
        for k in range(3):
            tangent[k, c] -= after[7 + k] * dt
            tangent[3 + k, c] -= after[10 + k] * dt
        tangent[6, c] -= plane.gx * dt
        tangent[7, c] -= plane.gy * dt
        tangent[8, c] -= kinematics.fall * dt


@inner
def contact_onset_tangent(
    body: Body, plane: Plane, state: Array, time: float, i: int, j: int, scale: Array, tangent: Array, columns: int
) -> None:
    """Carry disturbances into held contact of i and j, in place: what would lift or move the vertices is lost."""
    ahead, behind = np.empty(13), np.empty(13)
    for c in range(columns):
        if j == -2:
            for k in (2, 3, 4, 8, 9, 10):
                tangent[k, c] = 0.0
            continue
        size = scaled_length(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, ahead)
            displaced(state, tangent, c, -step, behind)
            for other in (ahead, behind):
                remove_normal_velocity(body, plane, other, time, i, j)
                project_on_contact(body, plane, other, time, i, j)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)


@inner
def held_tangent(
    body: Body,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    scale: Array,
    tangent: Array,
    columns: int,
    rates: Array,
) -> None:
    """Carry disturbances through dt [s] of held contact, in place, by differences of the integration itself."""
    there, ahead, behind = np.empty(13), np.empty(13), np.empty(13)
    for c in range(columns):
        size = scaled_length(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, there)
            held_step(body, plane, there, time, dt, i, j, rates, ahead)
            displaced(state, tangent, c, -step, there)
            held_step(body, plane, there, time, dt, i, j, rates, behind)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)


@inner
def frictional_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    active: NDArray[np.bool_],
    scale: Array,
    tangent: Array,
    columns: int,
) -> None:
    """`sliding_tangent` with friction."""
    n, mu = body.vertices.shape[0], law.parameters[1]
    there, ahead, behind = np.empty(13), np.empty(13), np.empty(13)
    arms, guess, impulses = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for c in range(columns):
        size = scaled_length(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, there)
            sliding_step(body, mu, plane, there, time, dt, active, arms, guess, impulses, ahead, FINE.sweep)
            displaced(state, tangent, c, -step, there)
            sliding_step(body, mu, plane, there, time, dt, active, arms, guess, impulses, behind, FINE.sweep)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)
    sliding_step(body, mu, plane, state, time, dt, active, arms, guess, impulses, ahead, FINE.sweep)
    place, z_table = 0, table_height(plane, time + dt)
    for k in range(n):
        if active[k]:
            if (
                impulses[place, 2] <= 0.0
                and clearance(body.vertices[k], ahead, z_table) > FRICTION_STANDING_HEIGHT * body.radius
            ):
                active[k] = False
            place += 1


def sliding_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    active: NDArray[np.bool_],
    scale: Array,
    tangent: Array,
    columns: int,
) -> None:
    """As `held_tangent`, with friction: differences of its steps. Vertices that no longer press leave `active`."""
    assert isinstance(law, RoughLaw)
    return frictional_tangent(body, law, plane, state, time, dt, active, scale, tangent, columns)


@overload(sliding_tangent, strict=False)
def _rubbed_tangent(
    body: Any, law: Any, plane: Any, state: Any, time: Any, dt: Any, active: Any, scale: Any, tangent: Any, columns: Any
) -> Any:
    """Nothing at all for a law without friction, which never gets here."""
    if law.instance_class is RoughLaw:
        return frictional_tangent.py_func
    return lambda body, law, plane, state, time, dt, active, scale, tangent, columns: None


@inner
def carry_to_event(
    body: Body,
    law: Law,
    plane: Plane,
    state: Array,
    time: float,
    until: float,
    i: int,
    j: int,
    knots: Array,
    knot: int,
    segment: int,
    own: bool,
    scale: Array,
    tangent: Array,
    moved: Array,
    columns: int,
    rates: Array,
) -> tuple[Array, Array, int, int]:
    """Carry disturbances from an event to the next, through flight or held contact.

    `knot` is the first of `knots` not passed yet, `segment` the event that began this stretch. With `own` the error of
    the integration joins as a column (not with friction, where it is that of the method, set by `Precision.turn`).
    Returns the disturbances, the spare room, the number of columns, and the knot.
    """
    if i < 0 or j == -2:
        if until > time:
            flight_tangent(tangent, columns, state, spin_rate(state), until - time, moved)
            tangent, moved = moved, tangent
        return tangent, moved, columns, knot
    whole, half, halves = np.empty(13), np.empty(13), np.empty(13)
    active = np.zeros(body.vertices.shape[0], np.bool_)
    for k in range(body.vertices.shape[0]):
        active[k] = is_held(k, i, j)
    while knot < knots.shape[0] and knots[knot, 0] <= segment:
        if knots[knot, 0] == segment:
            more = knot + 1 < knots.shape[0] and knots[knot + 1, 0] == segment
            begin, end = knots[knot, 1], knots[knot + 1, 1] if more else until
            here, dt = knots[knot, 2:15].copy(), end - begin
            if own and columns == tangent.shape[1]:
                columns = compressed(tangent, columns, moved)
            if dt > 0.0 and j == -3:
                sliding_tangent(body, law, plane, here, begin, dt, active, scale, tangent, columns)
            elif dt > 0.0:
                held_tangent(body, plane, here, begin, dt, i, j, scale, tangent, columns, rates)
                if own:
                    held_step(body, plane, here, begin, dt, i, j, rates, whole)
                    held_step(body, plane, here, begin, 0.5 * dt, i, j, rates, half)
                    held_step(body, plane, half, begin + 0.5 * dt, 0.5 * dt, i, j, rates, halves)
                    tangent_between(whole, halves, 1.0, tangent, columns)
                    columns += 1
        knot += 1
    return tangent, moved, columns, knot


@inner
def compressed(errors: Array, columns: int, room: Array) -> int:
    """At most twelve columns with the same sums of squares in every direction, in place: L of the rows' E = L Q."""
    factor = np.zeros((12, 12))
    copy_columns(room, errors, columns)
    used = ZERO
    for r in range(12):
        square, left = 0.0, 0.0
        for c in range(columns):
            square += errors[r, c] * errors[r, c]
            left += room[r, c] * room[r, c]
        if left <= 1e-26 * square or left == 0.0:
            continue  # the rest is rounding
        norm = sqrt(left)
        factor[r, used] = norm
        for c in range(columns):
            room[r, c] /= norm
        for s in range(r + 1, 12):
            along = 0.0
            for c in range(columns):
                along += room[s, c] * room[r, c]
            factor[s, used] = along
            for c in range(columns):
                room[s, c] -= along * room[r, c]
        used += 1
    copy_columns(errors, factor, used)
    return used


@inner
def event_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    row: Array,
    i: int,
    j: int,
    scale: Array,
    tangent: Array,
    columns: int,
    dtime: Array,
) -> tuple[int, int]:
    """Carry disturbances through a logged event, in place; i and j were held until then. Returns what is held after."""
    state, time, hit = row[2:15].copy(), row[0], int(row[1])
    if hit >= 0:
        impact_tangent_of_errors(body, law, plane, time, hit, state, i, j, FALSE, scale, tangent, columns, dtime)
    elif row[21] >= 0 and row[22] != -3:
        contact_onset_tangent(body, plane, state, time, int(row[21]), int(row[22]), scale, tangent, columns)
    return int(row[21]), int(row[22])


@compiled(nogil=True)
def run_growth(
    body: Body, law: Law, plane: Plane, start: Array, start_time: float, log: Array, knots: Array
) -> tuple[Array, Array]:
    """Derivatives of a logged throw after each of its events, by its start, in units of `scales_of`.

    Returns them (events, 12, 12), divided by 10^k, and the k (events,) that keep them within range.
    """
    scale = scales_of(body, plane)
    tangent, moved, dtime, rates = np.zeros((12, 12)), np.empty((12, 12)), np.empty(12), np.empty((12, 6))
    for k in range(12):
        tangent[k, k] = scale[k]
    maps, exponents = np.empty((log.shape[0], 12, 12)), np.zeros(log.shape[0])
    state, time, i, j, knot, exponent = start.copy(), start_time, NONE, NONE, ZERO, 0.0
    for k in range(log.shape[0]):
        row = log[k]
        tangent, moved, _, knot = carry_to_event(
            body,
            law,
            plane,
            state,
            time,
            row[0],
            i,
            j,
            knots,
            knot,
            k - 1,
            FALSE,
            scale,
            tangent,
            moved,
            TANGENT_ROWS,
            rates,
        )
        i, j = event_tangent(body, law, plane, row, i, j, scale, tangent, TANGENT_ROWS, dtime)
        time = row[0]
        state_after(row, state)
        if np.max(np.abs(tangent)) > 1e100:
            tangent *= 1e-100
            exponent += 100.0
        exponents[k] = exponent
        for c in range(12):
            maps[k, :, c] = tangent[:, c] / scale
    return maps, exponents


@inner
def orthonormalised(tangent: Array, scale: Array, logs: Array) -> None:
    """Make the columns (12, m) orthonormal in units of `scale`, in place; `logs` (m,) receives the logarithms of the
    lengths that Gram and Schmidt's method took away."""
    for c in range(tangent.shape[1]):
        tangent[:, c] /= scale
    for c in range(tangent.shape[1]):
        for _ in range(2):  # once more, for the rounding of the first time
            for b in range(c):
                tangent[:, c] -= np.dot(tangent[:, b].copy(), tangent[:, c].copy()) * tangent[:, b]
        norm = sqrt(np.sum(tangent[:, c] * tangent[:, c]))
        logs[c] = np.log(norm)
        tangent[:, c] /= norm
    for c in range(tangent.shape[1]):
        tangent[:, c] *= scale


@compiled(nogil=True)
def run_exponents(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    tangent: Array,
    logs: Array,
    clock: Array,
) -> tuple[int, int, float, Array]:
    """Follow a throw and m disturbances, `tangent` (12, m), made orthonormal at every impact (Benettin et al.).

    Fills `logs` (impacts, m) with the logarithms of their growth since the impact before, `clock` (impacts,) with the
    instants [s]. Returns how the throw ended, the number of impacts reached, and the time and state after the last.
    """
    scale, columns = scales_of(body, plane), tangent.shape[1]
    moved, dtime, rates = np.empty(tangent.shape), np.empty(columns), np.empty((12, 6))
    state, time, i, j, done, code = start.copy(), start_time, NONE, NONE, 0, IMPACTS_REACHED
    wanted = logs.shape[0]
    while done < wanted and code == IMPACTS_REACHED:
        code, _, _, until, end, log, knots = run_throw(
            body, law, plane, precision, state, time, inf, min(256, wanted - done), FALSE, NO_LIMIT, TRUE
        )
        knot = 0
        for k in range(log.shape[0]):
            row = log[k]
            tangent, moved, _, knot = carry_to_event(
                body,
                law,
                plane,
                state,
                time,
                row[0],
                i,
                j,
                knots,
                knot,
                k - 1,
                False,
                scale,
                tangent,
                moved,
                columns,
                rates,
            )
            i, j = event_tangent(body, law, plane, row, i, j, scale, tangent, columns, dtime)
            time = row[0]
            state_after(row, state)
            if row[1] >= 0.0:
                orthonormalised(tangent, scale, logs[done])
                clock[done] = time
                done += 1
        if i >= 0 and code == IMPACTS_REACHED:
            # The block ends within held contact, where the next vertex strikes.
            tangent, moved, _, knot = carry_to_event(
                body, law, plane, state, time, until, i, j, knots, knot, log.shape[0] - 1, FALSE, scale, tangent, moved,
                columns, rates,
            )  # fmt: skip
            time = until
            copy_to(state, end)
    return code, done, time, state
