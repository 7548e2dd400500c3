"""model.engine.event_loop."""

from __future__ import annotations

from math import inf, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled, inner
from .flight import (
    advance,
    first_touch,
    height_terms,
    lever_arm,
    spin_rate,
    table_acceleration,
    table_height,
    table_velocity,
)
from .held_contact import (
    clearance,
    contact_forces,
    event_instant,
    held_step,
    lay_on_face,
    pressed_set,
    project_on_contact,
    remove_normal_velocity,
    simultaneous_inelastic_impact,
    spins_forever,
    touching_set,
)
from .impact import apply_impact
from .log import (
    copy_to,
    decided_face,
    doubled_rows,
    energy_per_mass,
    has_friction,
    lowest_face_row,
    state_after,
    write_event,
    write_knot,
)
from .sliding_contact import follow_sliding_contact, move_freely
from .types import (
    BALANCED,
    FALSE,
    FORCE_I,
    FORCE_J,
    FRICTION_STANDING_HEIGHT,
    FRICTION_STEP_PART,
    IMPACT_CAP,
    IMPACTS_REACHED,
    LOG_COLUMNS,
    NO_EVENT,
    NO_LIMIT,
    NONE,
    NOT_ENDED,
    RESTED,
    ROUNDING_BOUND,
    SPINNING,
    STANDING_HEIGHT,
    TIME_REACHED,
    TIMED_OUT,
    TIMEOUT,
    TRUE,
    ZERO,
    Array,
    Body,
    Indices,
    Law,
    Plane,
    Precision,
)


@inner
def chatter_speed(law: Law, plane: Plane, precision: Precision, radius: float) -> float:
    """Speed [m/s] below which a vertex that accelerates into the table bounces on without end; see `contact`."""
    # With χ = 1 the bounces do not shrink, so nothing collapses.
    return 0.0 if law.parameters[0] >= 1.0 else precision.switch * sqrt(plane.g * radius)


@inner
def face_contact_duration(plane: Plane, time: float, limit: float) -> float:
    """How long [s] a face stays pressed on the table, no longer than `limit`."""
    strongest = plane.amplitude * plane.rate * plane.rate
    if strongest <= plane.g:
        return limit
    full = 2.0 * np.pi
    ahead = (np.arcsin(plane.g / strongest) - plane.rate * time - plane.phase) % full
    # At the very instant, rounding must not make a whole period of nothing.
    return min(limit, ahead / plane.rate) if ahead < full * (1.0 - 1e-12) else 0.0


@inner
def follow_held_contact(
    body: Body,
    plane: Plane,
    precision: Precision,
    state: Array,
    time: float,
    limit: float,
    i: int,
    j: int,
    for_ever: bool,
    segment: int,
    knots: Array,
    known: int,
    keep: bool,
    rates: Array,
    after: Array,
) -> tuple[int, float, int, Array, int]:
    """Carry the state in place through held contact of vertex i alone (j = -1), or i and j, to its end.

    Returns FLIES or another ending, the duration [s], the vertex that touches (-1: a held one is let go, or the limit
    came), and the knots with their number. `for_ever` asks whether the motion has no end, which costs a little.
    """
    begin = time
    fixed = plane.amplitude == 0.0
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    while True:
        if keep:
            if known == knots.shape[0]:
                knots = doubled_rows(knots)
            write_knot(knots[known], segment, time, state)
            known += 1
        pull = plane.g + table_acceleration(plane, time)
        if for_ever and fixed and is_balanced(body, state, i, j, pull):
            return BALANCED, time - begin, -1, knots, known
        dt = precision.turn / (
            spin_rate(state)
            + sqrt((plane.g + peak_table_acceleration) * body.radius * body.mass / body.inertia)
            + (0.0 if fixed else plane.rate)
        )
        dt = min(dt, begin + limit - time)
        held_step(body, plane, state, time, dt, i, j, rates, after)
        first, event = dt, NO_EVENT
        pull = plane.g + table_acceleration(plane, time + dt)
        n_i, n_j, _, _ = contact_forces(body, after, i, j, pull)
        if n_i <= 0.0:
            first, event = earlier_event(body, plane, state, time, dt, i, j, FORCE_I, first, event, rates)
        if j >= 0 and n_j <= 0.0:
            first, event = earlier_event(body, plane, state, time, dt, i, j, FORCE_J, first, event, rates)
        z_table = table_height(plane, time + dt)
        for k in range(body.vertices.shape[0]):
            if k != i and k != j:
                within = dt
                if clearance(body.vertices[k], after, z_table) > 0.0:
                    within = instant_below_table(body, plane, state, after, time, dt, i, j, k, rates)
                if within > 0.0:
                    first, event = earlier_event(body, plane, state, time, within, i, j, k, first, event, rates)
        if event != NO_EVENT:
            if first > 0.0:
                held_step(body, plane, state, time, first, i, j, rates, after)
                copy_to(state, after)
            return NOT_ENDED, time + first - begin, max(event, -1), knots, known
        copy_to(state, after)
        time += dt
        if time >= begin + limit:
            return TIME_REACHED, limit, -1, knots, known


@inner
def is_balanced(body: Body, state: Array, i: int, j: int, pull: float) -> bool:
    """Whether a held die neither leans over nor begins to, but for rounding: it stands on its vertex or edge for ever."""
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
def instant_below_table(
    body: Body,
    plane: Plane,
    state: Array,
    after: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    k: int,
    rates: Array,
) -> float:
    """An instant [s] within a step from `state` to `after` at which vertex k, up at its end, is below the table; 0
    where there is none. It is the lowest of a vertex that sinks and rises again."""
    h0, h1 = (
        clearance(body.vertices[k], state, table_height(plane, time)),
        clearance(body.vertices[k], after, table_height(plane, time + dt)),
    )
    v0, v1 = vertex_velocity(body, plane, state, time, k), vertex_velocity(body, plane, after, time + dt, k)
    if v1 <= 0.0:
        return 0.0
    trial = np.empty(13)
    if h0 <= STANDING_HEIGHT * body.radius:
        # It stands on the table and is not held: whatever its velocity says, look.
        for part in (0.125, 0.25, 0.5):
            held_step(body, plane, state, time, part * dt, i, j, rates, trial)
            if (
                clearance(body.vertices[k], trial, table_height(plane, time + part * dt))
                < -ROUNDING_BOUND * body.radius
            ):
                return part * dt
        return 0.0
    # A cubic through both ends misses the lowest height by far less than a twentieth of what it spans.
    t, lowest = cubic_minimum(h0, v0 * dt, h1, v1 * dt)
    if lowest > 0.05 * max(h0, h1):
        return 0.0
    t *= dt
    low, high, v_low, v_high = 0.0, dt, v0, v1
    for step in range(50):
        if step > 0:
            if v_low >= 0.0:
                return 0.0
            t = (low * v_high - high * v_low) / (v_high - v_low)
            t = min(max(t, low + 0.05 * (high - low)), high - 0.05 * (high - low))
        held_step(body, plane, state, time, t, i, j, rates, trial)
        if clearance(body.vertices[k], trial, table_height(plane, time + t)) < 0.0:
            return t
        v = vertex_velocity(body, plane, trial, time + t, k)
        if v < 0.0:
            low, v_low = t, v
        else:
            high, v_high = t, v
        if high - low <= 1e-7 * dt:
            break
    return 0.0


@inner
def vertex_velocity(body: Body, plane: Plane, state: Array, time: float, k: int) -> float:
    """Vertical velocity [m/s] of vertex k relative to the table."""
    x, y, _ = lever_arm(body.vertices[k], state)
    return float(state[9] + state[10] * y - state[11] * x - table_velocity(plane, time))


@inner
def cubic_minimum(h0: float, d0: float, h1: float, d1: float) -> tuple[float, float]:
    """Where the least of seven values of the cubic with these ends and slopes on [0, 1] lies, and what it is."""
    lowest, where = inf, 0.5
    for m in range(1, 8):
        t = m / 8.0
        u = 1.0 - t
        h = u * u * ((1.0 + 2.0 * t) * h0 + t * d0) + t * t * ((1.0 + 2.0 * u) * h1 - u * d1)
        if h < lowest:
            lowest, where = h, t
    return where, lowest


@inner
def earlier_event(
    body: Body,
    plane: Plane,
    state: Array,
    time: float,
    dt: float,
    i: int,
    j: int,
    event: int,
    first: float,
    best: int,
    rates: Array,
) -> tuple[float, int]:
    """The earlier of an event and the first one known so far."""
    t = event_instant(body, plane, state, time, dt, i, j, event, rates, np.empty(13))
    return (t, event) if t < first or best == NO_EVENT else (first, best)


@compiled(nogil=True)
def run_throw(
    body: Body,
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
    """The event loop. Nothing is changed in its arguments.

    Returns the code of the ending, the number of impacts, the row of the face decided on (-1: none), the time [s] at
    which it ends, the state (13,) after the last event, the log (events, ROW), and the knots of held contact (k, 15):
    event that began it, time, state. Both stay empty unless `keep`.
    """
    state, before, after, rates = start.copy(), np.empty(13), np.empty(13), np.empty((12, 6))
    terms, room = np.empty((body.vertices.shape[0], 4)), np.empty((3, max(3, body.vertices.shape[0])))
    touching = np.empty(body.vertices.shape[0], np.int64)
    log, knots = np.empty((64 if keep else 1, LOG_COLUMNS)), np.empty((64 if keep else 1, 15))
    slow = chatter_speed(law, plane, precision, body.radius)
    fixed, rough = plane.amplitude == 0.0, has_friction(law)
    active = np.zeros(body.vertices.shape[0], np.bool_)
    time, end, impacts, events, known = start_time, start_time + duration, 0, 0, ZERO
    i, j, zero_step_count = NONE, NONE, 0
    open_end = duration == inf
    timeout = inf
    if open_end and not fixed:
        timeout = TIMEOUT * sqrt(body.radius / plane.g)
    elif open_end and law.parameters[0] < 1.0:
        timeout = TIMEOUT * max(1.0, 0.1 / (1.0 - law.parameters[0])) * sqrt(body.radius / plane.g)
    # When the die last had the energy to stand up and more; on a table that moves, when it last bounced.
    last_energetic_time = start_time
    while True:
        face = decided_face(body, law, plane, state) if fixed else -1
        if fixed and energy_per_mass(body, plane, state) > 3.0 * plane.g * body.radius:
            last_energetic_time = time
        ending, hit, dt = NOT_ENDED, NONE, 0.0
        reorder = False  # whether the contact is to be found anew
        if i < 0:
            if face >= 0 and stop_when_decided and not keep:
                return RESTED, impacts, face, time, state, log[:0], knots[:0]
            spin = spin_rate(state)
            height_terms(body.vertices, state, spin, terms)
            dt, hit, velocity, acceleration = first_touch(
                terms, state[2], state[9], spin, body.radius, plane, time, precision.root, end - time
            )
            if face >= 0 and stop_when_decided:
                ending = RESTED
            elif hit < 0:
                ending = TIME_REACHED
            elif impacts >= impact_limit:
                ending = IMPACTS_REACHED
            if ending != NOT_ENDED:
                return ending, impacts, face, time + dt, state, log[: events if keep else 0], knots[:known]
            advance(state, spin, dt, plane)
            time += dt
            reorder = velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)
        else:
            if (stop_when_decided and face >= 0) or (
                open_end and j == -2 and face_contact_duration(plane, time, inf) == inf
            ):
                face = lowest_face_row(body.plumb_normals, state)
                return RESTED, impacts, face, time, state, log[: events if keep else 0], knots[:known]
            if rough:
                ending, dt, hit, knots, known = follow_sliding_contact(
                    body,
                    law,
                    plane,
                    precision,
                    state,
                    time,
                    min(end, last_energetic_time + timeout) - time,
                    active,
                    open_end,
                    stop_when_decided,
                    events - 1,
                    knots,
                    known,
                    keep,
                    after,
                )
                if keep:
                    if known == knots.shape[0]:
                        knots = doubled_rows(knots)
                    write_knot(knots[known], events - 1, time + dt, state)
                    known += 1
                if ending == RESTED:
                    face = lowest_face_row(body.plumb_normals, state)
                elif ending != NOT_ENDED and fixed:
                    face = decided_face(body, law, plane, state)
            elif j == -2:
                dt = face_contact_duration(plane, time, end - time)
                carry_on_face(state, plane, time, dt)
                if time + dt >= end:
                    ending = TIME_REACHED
            else:
                ending, dt, hit, knots, known = follow_held_contact(
                    body,
                    plane,
                    precision,
                    state,
                    time,
                    min(end, last_energetic_time + timeout) - time,
                    i,
                    j,
                    open_end,
                    events - 1,
                    knots,
                    known,
                    keep,
                    rates,
                    after,
                )
            time += dt
            if ending == TIME_REACHED and time < end:
                ending = TIMED_OUT
            if ending != NOT_ENDED:
                return ending, impacts, face, time, state, log[: events if keep else 0], knots[:known]
            # A face that the table has thrown off, and a die that no longer rubs, fly.
            reorder = hit >= 0 or not (rough or j == -2)
            if not reorder:
                i, j = NONE, NONE
            if hit >= 0:
                arm = lever_arm(body.vertices[hit], state)
                reorder = state[9] + state[10] * arm[1] - state[11] * arm[0] - table_velocity(plane, time) >= -slow
                if not reorder and impacts >= impact_limit:
                    return IMPACTS_REACHED, impacts, face, time, state, log[: events if keep else 0], knots[:known]
        zero_step_count = zero_step_count + 1 if dt == 0.0 else 0
        if stop_when_decided and fixed and not rough and hit >= 0 and spins_forever(body, plane, state, hit):
            ending = SPINNING
        elif time > last_energetic_time + timeout:
            strikes = hit >= 0 and not reorder
            if energy_per_mass(body, plane, state) > 3.0 * plane.g * body.radius or (strikes and not fixed):
                last_energetic_time = time
            else:
                ending = TIMED_OUT
        if ending != NOT_ENDED:
            return ending, impacts, face, time, state, log[: events if keep else 0], knots[:known]
        copy_to(before, state)
        if reorder:
            near, leaving = STANDING_HEIGHT * body.radius, slow
            if rough:
                # The last step of contact with friction leaves the normal velocities right to the first order only.
                near = FRICTION_STANDING_HEIGHT * body.radius
                rate = spin_rate(state) + sqrt(plane.g / body.radius)
                leaving = max(slow, FRICTION_STEP_PART * precision.turn * rate * body.radius)
            n = touching_set(body, plane, state, time, near, leaving, hit, touching)
            hit = -1
            if rough:
                for k in range(active.shape[0]):
                    active[k] = False
                for k in range(n):
                    active[touching[k]] = True
                i, j = (touching[0] if n > 0 else -1), -3
            else:
                simultaneous_inelastic_impact(body, plane, state, time, touching, n, room)
                i, j = pressed_set(body, plane, state, time, touching, n, room)
            if j == -2:
                lay_on_face(body, plane, state, time, i)
            elif i >= 0 and not rough:
                remove_normal_velocity(body, plane, state, time, i, j)
                project_on_contact(body, plane, state, time, i, j)
            if zero_step_count > 3 and j != -2 and not rough:
                # Rounding cannot tell whether the die still presses: carry it on a little, and it will be clear.
                nudge = 1e-9 * zero_step_count * sqrt(body.radius / plane.g)
                if i < 0:
                    advance(state, spin_rate(state), nudge, plane)
                else:
                    held_step(body, plane, state, time, nudge, i, j, rates, after)
                    copy_to(state, after)
                time += nudge
        elif hit >= 0:
            if impacts >= impact_cap:
                return IMPACT_CAP, impacts, face, time, state, log[: events if keep else 0], knots[:known]
            x, y, z = lever_arm(body.vertices[hit], state)
            arm = (x, y, z - body.rounding)
            apply_impact(law, body.mass, body.inertia, arm, table_velocity(plane, time), state)
            i, j = NONE, NONE
            impacts += 1
            last_energetic_time = last_energetic_time if fixed else time
        if keep:
            # The pose is continuous but for what holding a vertex takes away, within which it touched.
            for k in range(7):
                before[k] = state[k]
            if events == log.shape[0]:
                log = doubled_rows(log)
            held = float(i)
            if j == -3:
                held = 0.0
                for k in range(active.shape[0]):
                    held += 2.0**k if active[k] else 0.0
            write_event(log[events], time, hit, before, state, held, j)
        events += 1


@compiled
def carry_on_face(state: Array, plane: Plane, time: float, dt: float) -> None:
    """Carry a die that lies on a face of the table through dt [s], in place: it drifts and turns about the vertical."""
    spin = abs(state[12])
    advance(state, spin, dt, Plane(plane.gx, plane.gy, 0.0, 0.0, 0.0, 0.0))
    state[2] += table_height(plane, time + dt) - table_height(plane, time) - state[9] * dt
    state[9] = table_velocity(plane, time + dt)


@compiled(nogil=True)
def land_many(
    body: Body, law: Law, plane: Plane, precision: Precision, starts: Array, impact_cap: int, landed: NDArray[np.int64]
) -> None:
    """Throw from every row of `starts` (n, 13) until its face is decided; fills `landed` (n, 3): face row or -1,
    impacts, ending."""
    for k in range(starts.shape[0]):
        ending, impacts, face, _, _, _, _ = run_throw(
            body, law, plane, precision, starts[k], 0.0, inf, NO_LIMIT, TRUE, impact_cap, FALSE
        )
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, ending


@inner
def poses_of_throw(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    start: Array,
    start_time: float,
    times: Array,
    impact_cap: int,
    poses: Array,
) -> tuple[int, int]:
    """Position and quaternion of a throw at `times` (n,) [s], in order and none before the start, into `poses` (n, 7).

    As `run_throw` and `history` would have them, without the objects in between: heights are those of the centre. NaN
    from the instant at which the impacts are too many. Returns how the throw ended and the number of its impacts.
    """
    last = times[times.shape[0] - 1]
    ending, impacts, _, end, _, log, knots = run_throw(
        body, law, plane, precision, start, start_time, last - start_time, NO_LIMIT, FALSE, impact_cap, TRUE
    )
    rates, state, after = np.empty((12, 6)), np.empty(13), np.empty(13)
    event, knot = -1, 0
    for k in range(times.shape[0]):
        time = times[k]
        if ending == IMPACT_CAP and time > end:
            poses[k] = nan
            continue
        while event + 1 < log.shape[0] and log[event + 1, 0] <= time:
            event += 1
        begin, i, j = start_time, -1, -1
        copy_to(state, start)
        if event >= 0:
            begin, i, j = log[event, 0], int(log[event, 21]), int(log[event, 22])
            state_after(log[event], state)
        while knot < knots.shape[0] and knots[knot, 0] < event:
            knot += 1
        while knot + 1 < knots.shape[0] and knots[knot + 1, 0] == event and knots[knot + 1, 1] <= time:
            knot += 1
        if knot < knots.shape[0] and knots[knot, 0] == event and knots[knot, 1] <= time:
            begin = knots[knot, 1]
            copy_to(state, knots[knot, 2:15])
        if j == -1 and i < 0:
            advance(state, spin_rate(state), time - begin, plane)
        elif j == -3:
            # Half of each step goes with the old velocities, half with the new ones; after the last nothing is known.
            ends = knot + 1 >= knots.shape[0] or knots[knot + 1, 0] != event
            if not ends and time - begin > 0.5 * (knots[knot + 1, 1] - begin):
                begin = knots[knot + 1, 1]
                copy_to(state, knots[knot + 1, 2:15])
            move_freely(state, time - begin)
        elif j == -2:
            carry_on_face(state, plane, begin, time - begin)
        elif time > begin:
            held_step(body, plane, state, begin, time - begin, i, j, rates, after)
            copy_to(state, after)
        for m in range(7):
            poses[k, m] = state[m]
        poses[k, 2] += body.rounding
    return ending, impacts


@compiled(nogil=True)
def poses_of_throws(
    body: Body,
    law: Law,
    plane: Plane,
    precision: Precision,
    starts: Array,
    start_times: Array,
    times: Array,
    firsts: Indices,
    impact_cap: int,
    poses: Array,
) -> None:
    """`poses_of_throw` for each of `starts` (m, 13): throw k at `times[firsts[k] : firsts[k + 1]]`, into those rows."""
    for k in range(starts.shape[0]):
        rows = slice(firsts[k], firsts[k + 1])
        if firsts[k + 1] > firsts[k]:
            poses_of_throw(body, law, plane, precision, starts[k], start_times[k], times[rows], impact_cap, poses[rows])
