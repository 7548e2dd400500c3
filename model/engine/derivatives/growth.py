"""Growth of small disturbances along a logged throw: through flights, impacts and held contact.

A disturbance is a column (12,) as in `linearised_motion`, and its size is measured in units of `scales_of`. Flights and
impacts have derivatives. Held contact, with or without friction, is differenced through its own steps, which keeps the
disturbed vertices on the table. Equations of the exponents: `ensembles.chaos`.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ...compiled import compiled, inner
from ..event_loop import run_throw
from ..flight import (
    centripetal_acceleration,
    clearance,
    lever_arm,
    spin_rate,
    table_acceleration,
    table_height,
    table_velocity,
)
from ..held_contact import contact_forces, held_step, project_on_contact, remove_normal_velocity, step_workspace
from ..impact import apply_impact
from ..log import copy_columns, copy_to, state_after
from ..sliding_contact import FRICTION_STANDING_HEIGHT, SlidingBody, room_to_slide, sliding_step
from ..types import (
    FALSE,
    FINE,
    IMPACTS_REACHED,
    NO_LIMIT,
    NONE,
    TANGENT_ROWS,
    TRUE,
    ZERO,
    Array,
    Body,
    Contact,
    Law,
    Limits,
    Plane,
    RoughLaw,
    Setup,
    has_friction,
)
from .impulse_gradient import INPUTS
from .linearised_motion import SHIFTS, ImpactKinematics, flight_tangent, impact_derivatives, impact_tangent

NEGLIGIBLE_ROW = 1e-26
"""Square of what is left of a row, as a part of its square, below which it is rounding."""

RANGE_EXPONENT = 100.0
"""A derivative with an entry above ten to this power is divided by that; the power is returned beside it."""

ORBIT_BLOCK = 256
"""Impacts of an orbit that are simulated, and logged, at a time."""

_SMALL = 1e-5
"""Size of the differences that stand for derivatives, in units of `scales_of`: their square, and rounding over it, are both
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
    """The state moved by `step` times column j, into `out`, right to second order."""
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
    """Write `weight` times the small disturbance from state b to state a into column j."""
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
    apply_impact(body, law, (x, y, z - body.corner_radius), table_velocity(plane, time), state)


@inner
def is_held(vertex: int, i: int, j: int) -> bool:
    """Whether the contact (i, j) of a logged event holds a vertex."""
    if j == -3:
        return (i >> vertex) & 1 == 1
    return i >= 0 and vertex in (i, j)


@inner
def impact_kinematics(body: Body, plane: Plane, state: Array, time: float, i: int, j: int) -> ImpactKinematics:
    """Motion around an impact at `time` [s]; (i, j) was the contact until then."""
    v_table, a_table = table_velocity(plane, time), table_acceleration(plane, time)
    before, turn_x, turn_y = -plane.g, 0.0, 0.0
    if j == -3:
        before = a_table  # friction carried the die; it is taken to have done so without any acceleration
    elif i >= 0 and j != -2:
        n_i, n_j, turn_x, turn_y = contact_forces(body, state, i, j, plane.g + a_table)
        before = n_i + n_j - plane.g
    return ImpactKinematics(v_table, a_table, plane.gx, plane.gy, before, turn_x, turn_y, 0.0, 0.0, before + plane.g)


class TouchInContact(NamedTuple):
    """A vertex that touches the table, perhaps while others are held."""

    state: Array
    """(13,) before the impact."""
    time: float
    """[s]."""
    vertex: int
    i: int
    j: int
    """The contact until then."""


class Stretch(NamedTuple):
    """The motion between two events: a flight, or held contact."""

    state: Array
    """(13,) after the first event."""
    time: float
    """[s] of the first event."""
    until: float
    """[s] of the second."""
    i: int
    j: int
    """The contact."""
    knots: Array
    """(k, KNOT_COLUMNS) those of held contact."""


class Disturbances(NamedTuple):
    """Disturbances of a state, in the first columns of an array."""

    tangent: Array
    """(12, room)."""
    columns: int
    """How many there are."""
    scale: Array
    """(12,) their units."""


@inner
def disturbed_impact(
    setup: Setup, touch: TouchInContact, capped: bool, tangent: Array, columns: int, dtime: Array
) -> None:
    """Carry disturbances (12, columns) through an impact, in place; `capped` bounds the delays, see `touch_delay`."""
    body, _, plane, _ = setup
    state, time, vertex, i, j = touch
    kinematics = impact_kinematics(body, plane, state, time, i, j)
    reach = inf
    if capped:
        arm = lever_arm(body.vertices[vertex], state)
        falling = abs(
            kinematics.before_z
            + kinematics.turn_x * arm[1]
            - kinematics.turn_y * arm[0]
            + centripetal_acceleration(state, arm)
        )
        reach = 2.0 / max(abs(falling - kinematics.table_acceleration), plane.g)
    derivatives = impact_derivatives(setup.law, INPUTS, FALSE, FALSE, np.empty((0, SHIFTS)), reach)
    impact_tangent(setup, vertex, state, kinematics, derivatives, tangent, columns, dtime)


@inner
def contact_onset_tangent(contact: Contact, state: Array, time: float, disturbances: Disturbances) -> None:
    """Carry disturbances into a contact, in place: what would lift or move the held vertices is lost."""
    tangent, columns, scale = disturbances
    ahead, behind = np.empty(13), np.empty(13)
    for c in range(columns):
        if contact.j == -2:
            for k in (2, 3, 4, 8, 9, 10):
                tangent[k, c] = 0.0
            continue
        size = scaled_length(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, ahead)
            displaced(state, tangent, c, -step, behind)
            for other in (ahead, behind):
                remove_normal_velocity(contact, other, time)
                project_on_contact(contact, other, time)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)


@inner
def held_tangent(
    contact: Contact, state: Array, time: float, dt: float, disturbances: Disturbances, step_room: Array
) -> None:
    """Carry disturbances through dt [s] of held contact, in place, by differences of the integration."""
    tangent, columns, scale = disturbances
    there, ahead, behind = np.empty(13), np.empty(13), np.empty(13)
    for c in range(columns):
        size = scaled_length(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, there)
            held_step(contact, there, time, dt, step_room, ahead)
            displaced(state, tangent, c, -step, there)
            held_step(contact, there, time, dt, step_room, behind)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)


@inner
def frictional_tangent(
    setup: Setup, active: NDArray[np.bool_], state: Array, time: float, dt: float, disturbances: Disturbances
) -> None:
    """`sliding_tangent` of a law with friction."""
    body, law, plane, _ = setup
    tangent, columns, scale = disturbances
    n, sliding = body.vertices.shape[0], SlidingBody(body, law.parameters[1], plane, active)
    there, ahead, behind = np.empty(13), np.empty(13), np.empty(13)
    room = room_to_slide(n)
    for c in range(columns):
        size = scaled_length(tangent, c, scale)
        if size > 0.0:
            step = _SMALL / size
            displaced(state, tangent, c, step, there)
            sliding_step(sliding, there, time, dt, room, ahead, FINE.sweep_tolerance)
            displaced(state, tangent, c, -step, there)
            sliding_step(sliding, there, time, dt, room, behind, FINE.sweep_tolerance)
            tangent_between(ahead, behind, 0.5 / step, tangent, c)
    sliding_step(sliding, state, time, dt, room, ahead, FINE.sweep_tolerance)
    place, z_table = 0, table_height(plane, time + dt)
    for k in range(n):
        if active[k]:
            if (
                room.impulses[place, 2] <= 0.0
                and clearance(body.vertices[k], ahead, z_table) > FRICTION_STANDING_HEIGHT * body.radius
            ):
                active[k] = False
            place += 1


def sliding_tangent(
    setup: Setup, active: NDArray[np.bool_], state: Array, time: float, dt: float, disturbances: Disturbances
) -> None:
    """As `held_tangent`, for sliding contact. Vertices that no longer press leave `active`."""
    assert has_friction(setup.law)
    return frictional_tangent(setup, active, state, time, dt, disturbances)


@overload(sliding_tangent, strict=False)
def _sliding_tangent_of(setup: Any, active: Any, state: Any, time: Any, dt: Any, disturbances: Any) -> Any:
    """For a law without friction, which never gets here, a function that does nothing."""
    if setup[1].instance_class is RoughLaw:
        return frictional_tangent.py_func
    return lambda setup, active, state, time, dt, disturbances: None


@inner
def knots_between(knots: Array, first: int, event: int) -> tuple[int, int]:
    """The rows of the knots of the motion that `event` began, from and to, of which none is before row `first`."""
    while first < knots.shape[0] and knots[first, 0] < event:
        first += 1
    last = first
    while last < knots.shape[0] and knots[last, 0] == event:
        last += 1
    return first, last


@inner
def carry_to_event(
    setup: Setup, stretch: Stretch, add_error: bool, disturbances: Disturbances, moved: Array, step_room: Array
) -> tuple[Disturbances, Array]:
    """Carry disturbances from an event to the next, through flight or through contact.

    With `add_error` the error of the integration joins as a column; not with friction, where it is set by
    `Precision.step_turn`. Returns the disturbances and the spare room.
    """
    state, time, until, i, j, knots = stretch
    tangent, columns, scale = disturbances
    if i < 0 or j == -2:
        if until > time:
            flight_tangent(tangent, columns, state, spin_rate(state), until - time, moved)
            return Disturbances(moved, columns, scale), tangent
        return disturbances, moved
    whole, half, halves = np.empty(13), np.empty(13), np.empty(13)
    contact = Contact(setup.body, setup.plane, i, j)
    active = np.zeros(setup.body.vertices.shape[0], np.bool_)
    for k in range(active.shape[0]):
        active[k] = is_held(k, i, j)
    for knot in range(knots.shape[0]):
        begin, end = knots[knot, 1], knots[knot + 1, 1] if knot + 1 < knots.shape[0] else until
        here, dt = knots[knot, 2:15].copy(), end - begin
        if add_error and columns == tangent.shape[1]:
            columns = compressed(tangent, columns, moved)
        disturbances = Disturbances(tangent, columns, scale)
        if dt > 0.0 and j == -3:
            sliding_tangent(setup, active, here, begin, dt, disturbances)
        elif dt > 0.0:
            held_tangent(contact, here, begin, dt, disturbances, step_room)
            if add_error:
                held_step(contact, here, begin, dt, step_room, whole)
                held_step(contact, here, begin, 0.5 * dt, step_room, half)
                held_step(contact, half, begin + 0.5 * dt, 0.5 * dt, step_room, halves)
                tangent_between(whole, halves, 1.0, tangent, columns)
                columns += 1
    return Disturbances(tangent, columns, scale), moved


@inner
def compressed(errors: Array, columns: int, room: Array) -> int:
    """Replace the columns by at most twelve with the same sums of squares in every direction, L of E = L Q; their number."""
    factor = np.zeros((12, 12))
    copy_columns(room, errors, columns)
    used = ZERO
    for r in range(12):
        square, left = 0.0, 0.0
        for c in range(columns):
            square += errors[r, c] * errors[r, c]
            left += room[r, c] * room[r, c]
        if left <= NEGLIGIBLE_ROW * square or left == 0.0:
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
    setup: Setup, row: Array, i: int, j: int, disturbances: Disturbances, dtime: Array
) -> tuple[int, int]:
    """Carry disturbances through a logged event, in place; (i, j) was the contact until then. Returns the contact after."""
    state, time, hit = row[2:15].copy(), row[0], int(row[1])
    next_i, next_j = int(row[21]), int(row[22])
    if hit >= 0:
        touch = TouchInContact(state, time, hit, i, j)
        disturbed_impact(setup, touch, FALSE, disturbances.tangent, disturbances.columns, dtime)
    elif next_i >= 0 and next_j != -3:
        contact_onset_tangent(Contact(setup.body, setup.plane, next_i, next_j), state, time, disturbances)
    return next_i, next_j


@compiled(nogil=True)
def run_growth(setup: Setup, start: Array, start_time: float, log: Array, knots: Array) -> tuple[Array, Array]:
    """Derivatives of a logged throw after each of its events, by its start, in units of `scales_of`.

    Returns them (events, 12, 12), divided by 10^k, and the exponents k (events,) that keep them within range.
    """
    scale = scales_of(setup.body, setup.plane)
    moved, dtime, step_room = np.empty((12, 12)), np.empty(12), step_workspace()
    disturbances = Disturbances(np.zeros((12, 12)), TANGENT_ROWS, scale)
    for k in range(12):
        disturbances.tangent[k, k] = scale[k]
    maps, exponents = np.empty((log.shape[0], 12, 12)), np.zeros(log.shape[0])
    state, time, i, j, last, exponent = start.copy(), start_time, NONE, NONE, ZERO, 0.0
    for k in range(log.shape[0]):
        row = log[k]
        first, last = knots_between(knots, last, k - 1)
        stretch = Stretch(state, time, row[0], i, j, knots[first:last])
        disturbances, moved = carry_to_event(setup, stretch, FALSE, disturbances, moved, step_room)
        i, j = event_tangent(setup, row, i, j, disturbances, dtime)
        time = row[0]
        state_after(row, state)
        tangent = disturbances.tangent
        if np.max(np.abs(tangent)) > 10.0**RANGE_EXPONENT:
            tangent *= 10.0**-RANGE_EXPONENT
            exponent += RANGE_EXPONENT
        exponents[k] = exponent
        for c in range(12):
            maps[k, :, c] = tangent[:, c] / scale
    return maps, exponents


@inner
def orthonormalised(tangent: Array, scale: Array, logs: Array) -> None:
    """Make the columns (12, m) orthonormal in units of `scale`, in place, by the method of Gram and Schmidt.

    `logs` (m,) receives the logarithms of the lengths before the normalisation.
    """
    for c in range(tangent.shape[1]):
        tangent[:, c] /= scale
    for c in range(tangent.shape[1]):
        for _ in range(2):  # the second pass removes the rounding of the first
            for b in range(c):
                tangent[:, c] -= np.dot(tangent[:, b].copy(), tangent[:, c].copy()) * tangent[:, b]
        norm = sqrt(np.sum(tangent[:, c] * tangent[:, c]))
        logs[c] = np.log(norm)
        tangent[:, c] /= norm
    for c in range(tangent.shape[1]):
        tangent[:, c] *= scale


@compiled(nogil=True)
def run_exponents(
    setup: Setup, start: Array, start_time: float, tangent: Array, logs: Array, clock: Array
) -> tuple[int, int, float, Array]:
    """Follow a throw and m disturbances, `tangent` (12, m), which are made orthonormal at every impact (Benettin et al.).

    Fills `logs` (impacts, m) with the logarithms of their growth since the impact before, `clock` (impacts,) with the
    instants [s]. Returns the code of the ending, the number of impacts, and the time and state after the last.
    """
    scale, columns = scales_of(setup.body, setup.plane), tangent.shape[1]
    moved, dtime, step_room = np.empty(tangent.shape), np.empty(columns), step_workspace()
    disturbances = Disturbances(tangent, columns, scale)
    state, time, i, j, done, code = start.copy(), start_time, NONE, NONE, 0, IMPACTS_REACHED
    wanted = logs.shape[0]
    while done < wanted and code == IMPACTS_REACHED:
        limits = Limits(inf, min(ORBIT_BLOCK, wanted - done), NO_LIMIT, FALSE)
        code, _, _, until, end, log, knots = run_throw(setup, state, time, limits, TRUE)
        last = ZERO
        for k in range(log.shape[0]):
            row = log[k]
            first, last = knots_between(knots, last, k - 1)
            stretch = Stretch(state, time, row[0], i, j, knots[first:last])
            disturbances, moved = carry_to_event(setup, stretch, FALSE, disturbances, moved, step_room)
            i, j = event_tangent(setup, row, i, j, disturbances, dtime)
            time = row[0]
            state_after(row, state)
            if row[1] >= 0.0:
                orthonormalised(disturbances.tangent, scale, logs[done])
                clock[done] = time
                done += 1
        if i >= 0 and code == IMPACTS_REACHED:
            # The block ends within held contact, where the next vertex strikes.
            first, last = knots_between(knots, last, log.shape[0] - 1)
            stretch = Stretch(state, time, until, i, j, knots[first:last])
            disturbances, moved = carry_to_event(setup, stretch, FALSE, disturbances, moved, step_room)
            time = until
            copy_to(state, end)
    return code, done, time, state
