"""The event loop: fly or stay in contact until the next event, apply it, and go on until something ends the throw.

An event is an impact, or a change of what is held. Bounces slower than `Precision.slowest_bounce` are not simulated: the
vertices on the table are stopped and those are held on which the die presses (`throw.held_contact`). The rules that end a
throw are in `rest`.
"""

from __future__ import annotations

from math import inf, nan, sqrt

import numpy as np

from ..compiled import compiled, inner
from .air import FreeDie, fly, fly_to_touch, next_touch, pressed_on_face_s, slide_on_face
from .flight import (
    height_terms,
    lever_arm,
    spin_rate,
    table_velocity,
    vertex_velocity,
)
from .held_contact import (
    contact_step,
    follow_held_contact,
    lay_on_face,
    pressed_set,
    project_on_contact,
    remove_normal_velocity,
    step_workspace,
)
from .impact import (
    apply_impact,
    restitution_at,
    simultaneous_impact,
    simultaneous_inelastic_impact,
    touching_set,
    without_held,
)
from .inertia import move_freely
from .log import bits_of, bits_of_rows, copy_to, state_after, with_knot, with_room, write_event
from .rest import (
    MAX_ZERO_STEPS,
    chatter_speed,
    decided_face,
    is_energetic,
    lowest_face_row,
    nudge_s,
    spins_forever,
    timeout_s,
)
from .sliding_contact import FRICTION_STANDING_HEIGHT, FRICTION_STEP_PART, follow_sliding_contact
from .types import (
    APPROACHING,
    FALSE,
    IMPACT_CAP,
    IMPACTS_REACHED,
    KNOT_COLUMNS,
    LOG_COLUMNS,
    NO_LIMIT,
    NONE,
    NOT_ENDED,
    RESTED,
    SPINNING,
    STANDING_HEIGHT,
    TIME_REACHED,
    TIMED_OUT,
    TRUE,
    ZERO,
    Array,
    Contact,
    Indices,
    Knots,
    Limits,
    Setup,
    has_air,
    has_friction,
)

FIRST_ROWS = 64
"""Rows of the log, and of the knots, that are allocated first; doubled where they are used up."""


@compiled(nogil=True)
def run_throw(
    setup: Setup, start: Array, start_time: float, limits: Limits, keep: bool
) -> tuple[int, int, int, float, Array, Array, Array]:
    """Follow a throw from `start` (13,) at `start_time` [s] to its end. No argument is changed.

    Returns the code of the ending, the number of impacts, the row of the decided face (-1: none), the time [s] of the end, the
    state (13,) after the last event, the log (events, LOG_COLUMNS), and the knots of held contact (k, KNOT_COLUMNS). Log and
    knots stay empty unless `keep`.
    """
    body, law, plane, precision = setup
    duration, impact_limit, impact_cap, stop_when_decided = limits
    state, before, after, step_room = start.copy(), np.empty(13), np.empty(13), step_workspace()
    terms, room = np.empty((body.vertices.shape[0], 4)), np.empty((3, max(3, body.vertices.shape[0])))
    touching, rows = np.empty(body.vertices.shape[0], np.int64), FIRST_ROWS if keep else 1
    log, knots = np.empty((rows, LOG_COLUMNS)), Knots(np.empty((rows, KNOT_COLUMNS)), ZERO, NONE, keep)
    slow = chatter_speed(law, plane, precision, body.radius)
    fixed, rough = plane.amplitude == 0.0, has_friction(law)
    active = np.zeros(body.vertices.shape[0], np.bool_)
    time, end, impacts, events = start_time, start_time + duration, 0, 0
    i, j, zero_step_count = NONE, NONE, 0
    open_end = duration == inf
    timeout = timeout_s(law, plane, body.radius, open_end)
    # When the die last had the energy to stand up and more; on a table that moves, when it last bounced.
    last_energetic_time = start_time
    while True:
        face = decided_face(body, law, plane, state) if fixed else -1
        if fixed and is_energetic(body, plane, state):
            last_energetic_time = time
        ending, hit, dt, together, struck, slides = NOT_ENDED, NONE, 0.0, 1, 0.0, rough and i >= 0
        reorder = False  # whether what is held is to be found anew
        if i < 0:
            if face >= 0 and stop_when_decided and not keep:
                return RESTED, impacts, face, time, state, log[:0], knots.rows[:0]
            spin = spin_rate(state)
            height_terms(body.vertices, state, spin, terms)
            die = FreeDie(state, spin, body.radius, terms)
            dt, hit, velocity, acceleration, together = next_touch(
                die, plane, time, precision.contact_tolerance, end - time, step_room
            )
            if face >= 0 and stop_when_decided:
                ending = RESTED
            elif hit < 0:
                ending = TIME_REACHED
            elif impacts >= impact_limit:
                ending = IMPACTS_REACHED
            if ending != NOT_ENDED:
                return ending, impacts, face, time + dt, state, log[: events if keep else 0], knots.rows[: knots.used]
            fly_to_touch(die, plane, dt, step_room)
            if has_air(plane) and last_energetic_time == time:
                # A long fall takes the energy from a die that had it while it fell.
                last_energetic_time = time + dt
            time += dt
            reorder = velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)
        else:
            if (stop_when_decided and face >= 0) or (
                open_end and j == -2 and pressed_on_face_s(plane, state, time, inf) == inf
            ):
                face = lowest_face_row(body.plumb_normals, state)
                return RESTED, impacts, face, time, state, log[: events if keep else 0], knots.rows[: knots.used]
            knots = Knots(knots.rows, knots.used, events - 1, keep)
            limit = min(end, last_energetic_time + timeout) - time
            if rough:
                ending, dt, hit, knots = follow_sliding_contact(
                    setup, active, state, time, limit, open_end, stop_when_decided, knots
                )
                knots = with_knot(knots, time + dt, state)
                if ending == RESTED:
                    face = lowest_face_row(body.plumb_normals, state)
                elif ending != NOT_ENDED and fixed:
                    face = decided_face(body, law, plane, state)
            elif j == -2:
                dt = pressed_on_face_s(plane, state, time, end - time)
                slide_on_face(state, plane, time, dt)
                if time + dt >= end:
                    ending = TIME_REACHED
            else:
                ending, dt, hit, knots = follow_held_contact(
                    Contact(body, plane, i, j), precision, state, time, limit, open_end, knots, step_room
                )
            time += dt
            if ending == TIME_REACHED and time < end:
                ending = TIMED_OUT
            if ending != NOT_ENDED:
                return ending, impacts, face, time, state, log[: events if keep else 0], knots.rows[: knots.used]
            # A face that the table has thrown off, and a die that has left its sliding contact, fly.
            reorder = hit >= 0 or not (rough or j == -2)
            if not reorder:
                i, j = NONE, NONE
            if hit >= 0:
                velocity, together = vertex_velocity(body, plane, state, time, hit), 2
                reorder = velocity >= -slow
                if not reorder and impacts >= impact_limit:
                    return (
                        IMPACTS_REACHED,
                        impacts,
                        face,
                        time,
                        state,
                        log[: events if keep else 0],
                        knots.rows[: knots.used],
                    )
        zero_step_count = zero_step_count + 1 if dt == 0.0 else 0
        if stop_when_decided and fixed and not rough and hit >= 0 and spins_forever(body, plane, state, hit):
            ending = SPINNING
        elif time > last_energetic_time + timeout:
            bounces = hit >= 0 and not reorder
            if is_energetic(body, plane, state) or (bounces and not fixed):
                last_energetic_time = time
            else:
                ending = TIMED_OUT
        if ending != NOT_ENDED:
            return ending, impacts, face, time, state, log[: events if keep else 0], knots.rows[: knots.used]
        copy_to(before, state)
        if reorder:
            near, leaving = STANDING_HEIGHT * body.radius, slow
            if rough:
                # The steps of sliding contact leave the normal velocities right to first order only.
                near = FRICTION_STANDING_HEIGHT * body.radius
                rate = spin_rate(state) + sqrt(plane.g / body.radius)
                leaving = max(slow, FRICTION_STEP_PART * precision.step_turn * rate * body.radius)
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
                contact = Contact(body, plane, i, j)
                remove_normal_velocity(contact, state, time)
                project_on_contact(contact, state, time)
            if zero_step_count > MAX_ZERO_STEPS and j != -2 and not rough:
                # Rounding leaves open whether the die still presses. A little later it does not.
                nudge = nudge_s(zero_step_count, plane, body.radius)
                if i < 0:
                    fly(state, spin_rate(state), nudge, plane, step_room)
                else:
                    contact_step(Contact(body, plane, i, j), state, time, nudge, step_room, after)
                    copy_to(state, after)
                time += nudge
        elif hit >= 0:
            if impacts >= impact_cap:
                return IMPACT_CAP, impacts, face, time, state, log[: events if keep else 0], knots.rows[: knots.used]
            n = 1
            if together > 1:
                near = precision.contact_tolerance + STANDING_HEIGHT * body.radius
                n = touching_set(body, plane, state, time, near, APPROACHING * velocity, hit, touching)
                if slides:
                    n = without_held(touching, n, active, hit)
                struck = bits_of_rows(touching, n) if n > 1 else 0.0
            if n > 1 and not rough:
                simultaneous_impact(body, plane, state, time, restitution_at(law, velocity), touching, n, room)
            else:
                struck = -struck
                x, y, z = lever_arm(body.vertices[hit], state)
                apply_impact(body, law, (x, y, z - body.corner_radius), table_velocity(plane, time), state)
            i, j = NONE, NONE
            impacts += 1
            last_energetic_time = last_energetic_time if fixed else time
        if keep:
            # The pose is continuous, except for the height within which the vertex touched and is now held.
            for k in range(7):
                before[k] = state[k]
            log = with_room(log, events)
            held = bits_of(active) if j == -3 else float(i)
            write_event(log[events], time, hit, before, state, held, j, struck)
        events += 1


@inner
def poses_of_throw(
    setup: Setup, start: Array, start_time: float, times: Array, impact_cap: int, poses: Array
) -> tuple[int, int]:
    """Position and quaternion of a throw at `times` (n,) [s], ascending and none before the start, into `poses` (n, 7).

    Heights are those of the centre of mass. Poses after the impact that exceeds `impact_cap` are NaN. Returns the code of
    the ending and the number of impacts.
    """
    body, plane = setup.body, setup.plane
    limits = Limits(times[times.shape[0] - 1] - start_time, NO_LIMIT, impact_cap, FALSE)
    ending, impacts, _, end, _, log, knots = run_throw(setup, start, start_time, limits, TRUE)
    step_room, state, after = step_workspace(), np.empty(13), np.empty(13)
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
            fly(state, spin_rate(state), time - begin, plane, step_room)
        elif j == -3:
            # The first half of a step goes with the old velocities, the second half with the new ones.
            ends = knot + 1 >= knots.shape[0] or knots[knot + 1, 0] != event
            if not ends and time - begin > 0.5 * (knots[knot + 1, 1] - begin):
                begin = knots[knot + 1, 1]
                copy_to(state, knots[knot + 1, 2:15])
            move_freely(state, time - begin)
        elif j == -2:
            slide_on_face(state, plane, begin, time - begin)
        elif time > begin:
            contact_step(Contact(body, plane, i, j), state, begin, time - begin, step_room, after)
            copy_to(state, after)
        for m in range(7):
            poses[k, m] = state[m]
        poses[k, 2] += body.corner_radius
    return ending, impacts


@compiled(nogil=True)
def poses_of_throws(
    setup: Setup,
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
            poses_of_throw(setup, starts[k], start_times[k], times[rows], impact_cap, poses[rows])
