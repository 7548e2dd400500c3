"""What errors make of a throw: whether double precision decides its face.

Errors come from the start, from rounding at every event, from the height at which a touch was found, and from the steps of
held contact. They are columns E (12, n) of disturbances, E Eᵀ is their covariance, and they are carried along as in `growth`.
Where the errors leave open which of two vertices touches first, the throw with the other order is followed as a branch of its
own. The rules that make a throw undecidable: `ensembles.chaos`.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import compiled, inner
from ..event_loop import run_throw
from ..flight import (
    FallingDie,
    advance,
    centripetal_acceleration,
    clearance,
    first_touch,
    height_terms,
    lever_arm,
    spin_rate,
    table_acceleration,
    table_height,
    vertex_velocity,
)
from ..held_contact import step_workspace
from ..log import copy_columns, copy_to
from ..rest import energy_per_mass
from ..types import (
    BALANCED,
    NO_LIMIT,
    NONE,
    ONE,
    ROUNDING_BOUND,
    SMOOTH,
    TANGENT_ROWS,
    TRUE,
    ZERO,
    Array,
    Body,
    Contact,
    Law,
    Limits,
    Plane,
    Precision,
    Setup,
    has_friction,
)
from .growth import (
    Disturbances,
    Stretch,
    TouchInContact,
    carry_to_event,
    compressed,
    contact_onset_tangent,
    disturbed_impact,
    impact_at_vertex,
    is_held,
    knots_between,
    scaled_length,
    scales_of,
    tangent_between,
)
from .linearised_motion import flight_tangent, touch_delay

MAX_COLUMNS = 40
"""Columns of errors for which there is room; they are compressed to twelve when it is full."""

MAX_BRANCHES = 16
"""Other orders of touches that are followed before a throw is given up as undecidable."""

SAFETY_FACTOR = 3.0
"""An error is taken to reach this many times its estimate where the order of touches is asked for: the estimate adds up
independent errors by their squares."""

UNDECIDABLE_ERROR = 0.05
"""Error, in units of `scales_of`, beyond which another outcome is possible. Of 3700 throws whose face changed with the
tolerance of touches, none had reached less than 0.23."""

NEGLIGIBLE_DIFFERENCE = 1e-4
"""Difference that the order of two touches may make, in the same units, to be carried as an error; a larger one is followed as
a branch."""

MAX_ALTERNATING_IMPACTS = 40
"""Impacts of two vertices that touch together and strike by turns."""

GRAZE_BISECTIONS = 60
"""Halvings of the search for the instant at which a vertex passed the table closest: to the last bit."""

UNIT_ROUNDING = 2.220446049250313e-16


class Branches(NamedTuple):
    """Throws that the errors leave possible, by the order of their touches; the first is the throw itself."""

    states: Array
    """(MAX_BRANCHES + 1, 13) in which each begins."""
    times: Array
    """(MAX_BRANCHES + 1,) [s] at which it begins."""
    seeds: Array
    """(MAX_BRANCHES + 1, 12, 12) its errors there."""
    gaps: Array
    """(MAX_BRANCHES + 1,) height of the vertex that touches in the other order, as a part of what the errors allow."""


@inner
def add_rounding(
    body: Body, plane: Plane, state: Array, time: float, height: float, k: int, errors: Array, columns: int
) -> int:
    """Add two columns: an error `height` [m] of the touch, and rounding in all other numbers, its signs random by k."""
    errors[:, columns] = 0.0
    errors[2, columns] = height
    speed = 0.0
    for m in range(3):
        speed = max(speed, abs(state[7 + m]))
    spin = spin_rate(state)
    # A linear congruential generator (Knuth; Numerical Recipes' constants), which the log's row number seeds.
    bits = k * 2654435761 + 1013904223
    for m in range(12):
        bits = (bits * 1664525 + 1013904223) % 4294967296
        sign = UNIT_ROUNDING if bits >= 2147483648 else -UNIT_ROUNDING
        if m < 3:
            errors[m, columns + 1] = 0.0 if m < 2 else sign * (abs(state[2]) + body.radius)
        elif m < 6:
            errors[m, columns + 1] = 2.0 * sign
        elif m < 9:
            errors[m, columns + 1] = sign * speed
        else:
            errors[m, columns + 1] = sign * spin
    return columns + 2


@inner
def error_size(law: Law, errors: Array, columns: int, scale: Array) -> float:
    """Root of the sum of squares of the errors that matter, in units of `scale`.

    The place on the table does not matter, nor, without friction, the horizontal velocity.
    """
    square = 0.0
    for k in range(2, 12):
        if (k == 6 or k == 7) and law.code == SMOOTH:
            continue
        for c in range(columns):
            square += (errors[k, c] / scale[k]) * (errors[k, c] / scale[k])
    return sqrt(square)


@inner
def impacts_in_order(setup: Setup, state: Array, time: float, first: int, other: int, out: Array) -> None:
    """The state after the impacts of two vertices that touch together, `first` first, by turns as long as they sink."""
    body, law, plane, _ = setup
    copy_to(out, state)
    vertex = first
    for _ in range(MAX_ALTERNATING_IMPACTS):
        if vertex_velocity(body, plane, out, time, vertex) < 0.0:
            impact_at_vertex(body, law, plane, time, vertex, out)
        vertex = other if vertex == first else first
        if vertex_velocity(body, plane, out, time, vertex) >= 0.0:
            break


@inner
def touch_height_error(body: Body, plane: Plane, precision: Precision, state: Array, time: float, dt: float) -> float:
    """How far [m] from the table `first_touch` may find a touch, after dt [s] of motion from `state`."""
    turned = body.radius * (1.0 + spin_rate(state) * dt)
    size = abs(state[2]) + (abs(state[9]) + plane.g * dt) * dt + turned
    if plane.amplitude != 0.0:
        size += plane.amplitude * (1.0 + abs(plane.rate * (time + dt) + plane.phase))
    return precision.contact_tolerance + ROUNDING_BOUND * size


@inner
def other_touch_orders(
    setup: Setup,
    touch: TouchInContact,
    floor: float,
    size: float,
    disturbances: Disturbances,
    branches: Branches,
    known: int,
) -> tuple[int, int]:
    """Find the vertices that may touch before that of `touch`, within the errors `disturbances`.

    `floor` [m] is the error of the height at which a touch is found. A difference below NEGLIGIBLE_DIFFERENCE, or below the
    `size` that the errors have already, joins the errors. A larger one becomes a branch; `known` are known so far. Returns the
    number of columns and the number of branches, more than MAX_BRANCHES where there was no room.
    """
    body, law, plane, _ = setup
    state, time, hit, i, j = touch
    errors, columns, scale = disturbances
    arm = lever_arm(body.vertices[hit], state)
    u = vertex_velocity(body, plane, state, time, hit)
    reach = 2.0 / plane.g
    z_table = table_height(plane, time)
    heights, tilts, delays = 0.0, 0.0, 0.0
    for c in range(columns):
        heights += errors[2, c] * errors[2, c]
        tilts += errors[3, c] * errors[3, c] + errors[4, c] * errors[4, c]
        late = touch_delay(errors, c, arm[0], arm[1], u, reach, 0.0)
        delays += late * late
    heights, tilts, delays = sqrt(heights), sqrt(tilts), sqrt(delays)
    fresh = columns
    first, last = np.empty(13), np.empty(13)
    room, dtime = np.empty((12, MAX_COLUMNS)), np.empty(MAX_COLUMNS)
    for k in range(body.vertices.shape[0]):
        if k == hit or is_held(k, i, j):
            continue
        other = lever_arm(body.vertices[k], state)
        h = state[2] + other[2] - z_table
        v = vertex_velocity(body, plane, state, time, k)
        if v >= 0.0 or h > SAFETY_FACTOR * (heights + body.radius * tilts - v * delays) + floor:
            continue
        square = 0.0
        for c in range(columns):
            lift = errors[2, c] + errors[3, c] * other[1] - errors[4, c] * other[0]
            lift += v * touch_delay(errors, c, arm[0], arm[1], u, reach, 0.0)
            square += lift * lift
        limit = SAFETY_FACTOR * sqrt(square) + floor
        if h > limit:
            continue
        impacts_in_order(setup, state, time, hit, k, first)
        impacts_in_order(setup, state, time, k, hit, last)
        if fresh == errors.shape[1]:
            return fresh, MAX_BRANCHES + 1
        tangent_between(last, first, 1.0, errors, fresh)
        if scaled_length(errors, fresh, scale) <= max(NEGLIGIBLE_DIFFERENCE, size):
            fresh += 1
            continue
        if known >= MAX_BRANCHES:
            return fresh, MAX_BRANCHES + 1
        copy_columns(room, errors, columns)
        disturbed_impact(setup, TouchInContact(state, time, k, i, j), TRUE, room, columns, dtime)
        branches.seeds[known] = 0.0
        used = compressed(room, columns, np.empty((12, MAX_COLUMNS)))
        copy_columns(branches.seeds[known], room, used)
        branches.states[known] = state
        impact_at_vertex(body, law, plane, time, k, branches.states[known])
        branches.times[known], branches.gaps[known] = time, h / limit if limit > 0.0 else 0.0
        known += 1
    return fresh, known


@inner
def add_grazing_touch(
    setup: Setup, state: Array, time: float, dt: float, hit: int, floor: float, errors: Array, columns: int
) -> int:
    """Look for a vertex that passed the table within its error during a flight of dt [s] from `state`, and rose again.

    `errors` are those at the end of the flight, where vertex `hit` touches; it is left out. Had the other vertex touched, it
    would have done so no faster than it falls through its error. The effect of that impulse on the velocities joins the errors
    as a column. Returns the number of columns.
    """
    body, law, plane, _ = setup
    heights, tilts = 0.0, 0.0
    for c in range(columns):
        heights += errors[2, c] * errors[2, c]
        tilts += errors[3, c] * errors[3, c] + errors[4, c] * errors[4, c]
    band = SAFETY_FACTOR * (sqrt(heights) + body.radius * sqrt(tilts)) + floor
    spin, terms = spin_rate(state), np.empty((body.vertices.shape[0], 4))
    height_terms(body.vertices, state, spin, terms)
    falling = FallingDie(state[2], state[9], spin, body.radius)
    low, k, _, _, _ = first_touch(terms, falling, plane, time, band, dt)
    there = state.copy()
    advance(there, spin, dt, plane)
    if k < 0 or k == hit or vertex_velocity(body, plane, there, time + dt, k) < 0.0:
        return columns
    high = dt
    for _ in range(GRAZE_BISECTIONS):
        middle = 0.5 * (low + high)
        copy_to(there, state)
        advance(there, spin, middle, plane)
        if vertex_velocity(body, plane, there, time + middle, k) < 0.0:
            low = middle
        else:
            high = middle
    early = np.empty((12, columns))
    end = there.copy()
    advance(end, spin, dt - high, plane)
    flight_tangent(errors, columns, end, spin, high - dt, early)
    x, y, z = lever_arm(body.vertices[k], there)
    square = 0.0
    for c in range(columns):
        lift = early[2, c] + early[3, c] * y - early[4, c] * x
        square += lift * lift
    deep = SAFETY_FACTOR * sqrt(square) + floor - clearance(body.vertices[k], there, table_height(plane, time + high))
    if deep <= 0.0:
        return columns
    rising = abs(centripetal_acceleration(there, (x, y, z)) - plane.g - table_acceleration(plane, time + high))
    speed = sqrt(2.0 * max(rising, plane.g) * deep)
    s = (1.0 + law.parameters[0]) * speed / (1.0 / body.mass + (x * x + y * y) / body.inertia)
    kick = np.zeros((12, 1))
    kick[8, 0], kick[9, 0], kick[10, 0] = s / body.mass, y * s / body.inertia, -x * s / body.inertia
    flight_tangent(kick, ONE, there, spin, dt - high, early)
    for k in range(12):
        errors[k, columns] = early[k, 0]
    return columns + 1


@inner
def follow_errors(
    setup: Setup, branches: Branches, branch: int, known: int, log: Array, knots: Array, end: Array, face: int
) -> tuple[float, float, int]:
    """Carry the errors of one of the `known` branches, with its log and knots, to its end.

    `end` (13,) is its last state, `face` the row of the face on which it lands, or -1. New branches are added. Returns the
    error at the end in units of `scales_of`, the margin (how many times larger the errors might be), and the number of
    branches. A margin of 1 or less ends the search at once.
    """
    body, law, plane, precision = setup
    scale = scales_of(body, plane)
    errors, moved = np.empty((12, MAX_COLUMNS)), np.empty((12, MAX_COLUMNS))
    dtime, step_room = np.empty(MAX_COLUMNS), step_workspace()
    copy_columns(errors, branches.seeds[branch], TANGENT_ROWS)
    columns = compressed(errors, TANGENT_ROWS, moved)
    state, time, i, j, last = branches.states[branch].copy(), branches.times[branch], NONE, NONE, ZERO
    margin, size = inf, 0.0
    for k in range(log.shape[0]):
        row = log[k]
        first, last = knots_between(knots, last, k - 1)
        stretch = Stretch(state, time, row[0], i, j, knots[first:last])
        carried, moved = carry_to_event(setup, stretch, TRUE, Disturbances(errors, columns, scale), moved, step_room)
        errors, columns, _ = carried
        floor = touch_height_error(body, plane, precision, state, time, row[0] - time if i < 0 else 0.0)
        if columns + 3 + body.vertices.shape[0] > MAX_COLUMNS:
            columns = compressed(errors, columns, moved)
        hit = int(row[1])
        if i < 0 and row[0] > time:
            columns = add_grazing_touch(setup, state, time, row[0] - time, hit, floor, errors, columns)
        copy_to(state, row[2:15])
        time = row[0]
        if hit >= 0:
            # A finer tolerance finds the touch at this instant or later, so that the height left is the whole error.
            missed = (
                abs(clearance(body.vertices[hit], state, table_height(plane, time)))
                + floor
                - precision.contact_tolerance
            )
            touch_column = columns
            columns = add_rounding(body, plane, state, time, -missed, k, errors, columns)
            touch = TouchInContact(state, time, hit, i, j)
            columns, known = other_touch_orders(
                setup, touch, floor, size, Disturbances(errors, columns, scale), branches, known
            )
            if known > MAX_BRANCHES:
                return size, 0.0, known
            disturbed_impact(setup, touch, TRUE, errors, columns, dtime)
            errors[2, touch_column] += missed  # it is the table that stands too high by this, not the die
            i, j = NONE, NONE
        else:
            i, j = int(row[21]), int(row[22])
            columns = add_rounding(body, plane, state, time, 0.0, k, errors, columns)
            if i >= 0 and j != -3:
                contact_onset_tangent(Contact(body, plane, i, j), state, time, Disturbances(errors, columns, scale))
        for m in range(6):
            state[7 + m] = row[15 + m]
        size = error_size(law, errors, columns, scale)
        margin = min(margin, UNDECIDABLE_ERROR / size)
        if not margin > 1.0:
            return size, margin, known
    if face >= 0 and (i < 0 or j != -2) and plane.amplitude == 0.0:
        square, per_mass = 0.0, body.inertia / body.mass
        for c in range(columns):
            change = plane.g * errors[2, c] + end[9] * errors[8, c]
            change += per_mass * (end[10] * errors[9, c] + end[11] * errors[10, c])
            if has_friction(law):
                change += end[7] * errors[6, c] + end[8] * errors[7, c] + per_mass * end[12] * errors[11, c]
            square += change * change
        spare = plane.g * body.barrier_heights[face] - energy_per_mass(body, plane, end)
        if has_friction(law):
            spare -= 0.5 * (end[7] * end[7] + end[8] * end[8] + per_mass * end[12] * end[12])
        if square > 0.0 and spare > 0.0:
            margin = min(margin, spare / (SAFETY_FACTOR * sqrt(square)))
    return size, margin, known


@compiled(nogil=True)
def decide(
    setup: Setup, start: Array, start_time: float, start_error: Array, impact_cap: int
) -> tuple[int, int, int, float, float]:
    """Follow a throw to its decision, with its errors; `start_error` (12,) are those of the start.

    Returns the row of the face (-1: none), impacts, code of the ending, the error at the end, and the margin (above 1:
    decidable).
    """
    most = MAX_BRANCHES + 1
    branches = Branches(np.empty((most, 13)), np.empty(most), np.zeros((most, 12, 12)), np.empty(most))
    for k in range(12):
        branches.seeds[0, k, k] = start_error[k]
    branches.states[0], branches.times[0] = start, start_time
    face, impacts, ending, error, margin = -1, 0, -1, 0.0, inf
    branch, known = ZERO, ONE
    while branch < known:
        code, count, landed, _, end, log, knots = run_throw(
            setup, branches.states[branch], branches.times[branch], Limits(inf, NO_LIMIT, impact_cap, TRUE), TRUE
        )
        if branch == 0:
            face, impacts, ending = landed, count, code
        elif landed != face or (face < 0 and code != ending):
            return face, impacts, ending, error, min(margin, branches.gaps[branch])
        if code == BALANCED:
            return face, impacts, ending, inf, 0.0
        size, spare, known = follow_errors(setup, branches, branch, known, log, knots, end, landed)
        if branch == 0:
            error = size
        margin = min(margin, spare)
        if not margin > 1.0:
            return face, impacts, ending, error, margin
        branch += 1
    return face, impacts, ending, error, margin


@compiled(nogil=True)
def decide_many(
    setup: Setup, starts: Array, start_error: Array, impact_cap: int, landed: NDArray[np.int64], figures: Array
) -> None:
    """`decide` from every row of `starts` (n, 13).

    Fills `landed` (n, 3): row of the face or -1, impacts, code of the ending; and `figures` (n, 2): error at the end, margin.
    """
    for k in range(starts.shape[0]):
        face, impacts, ending, error, margin = decide(setup, starts[k], 0.0, start_error, impact_cap)
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, ending
        figures[k, 0], figures[k, 1] = error, margin
