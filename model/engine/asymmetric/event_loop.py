"""The event loop of an asymmetric body; equations in `asymmetric`.

It follows the rules of `engine.event_loop`: the same codes, log, knots, speed of the slowest bounce, and nudge. It stays apart
because a flight has no closed form: the motion goes by steps, each of which ends early where a vertex touches or is released.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from ...compiled import compiled, inner
from ..impact import without_held
from ..inertia import carry_freely, to_angular_momentum, to_angular_velocity
from ..log import bits_of, bits_of_rows, copy_to, with_knot, with_room, write_event
from ..rest import MAX_ZERO_STEPS, TIMEOUT, chatter_speed, decided_with_friction, nudge_s, plumb_face_row
from ..sliding_contact import FRICTION_STANDING_HEIGHT, FRICTION_STEP_PART, follow_sliding_contact
from ..types import (
    BALANCED,
    IMPACT_CAP,
    IMPACTS_REACHED,
    KNOT_COLUMNS,
    LOG_COLUMNS,
    NONE,
    NOT_ENDED,
    RESTED,
    ROUNDING_BOUND,
    SLIDING,
    SPINNING,
    TIME_REACHED,
    TIMED_OUT,
    ZERO,
    Array,
    AsymmetricBody,
    Contact,
    Knots,
    Limits,
    Plane,
    Precision,
    Setup,
    has_friction,
)
from .contact import (
    decided_face,
    face_contact_duration,
    lay_on_face,
    project_on_contact,
    resolve_contacts,
    spin_growth_bound,
    spins_forever,
    struck_together,
)
from .impact import strike
from .motion import (
    MAX_TURN_RAD,
    clearance,
    contact_forces,
    free_acceleration,
    response,
    rotational_energy,
    state_after_step,
    vertex_velocity,
)

BALANCED_ENERGY = 1e-9
"""Rotational energy in units of m g R below which a die that was in contact for TIMEOUT stands balanced."""

PULL_TOLERANCE = 1e-10
"""Force, in units of the mass times the largest acceleration, by which a held vertex must be pulled to be released: rounding."""

SPIN_ALLOWANCE = 1.25
RATE_ALLOWANCE = 0.25
"""A step in contact is bounded for a spin of SPIN_ALLOWANCE times the present one plus RATE_ALLOWANCE √((g + a)/R), and ends
before the spin could outgrow that."""

CONTACT_JERK = 10.0
"""Bound of the jerk of a vertex in contact, as a multiple of the rates of the motion times the bound of the acceleration."""

ACCELERATION_ROUNDING = 2e-14
"""Rounding of an acceleration in contact as a part of its bound: forces are quotients of determinants."""

SMALL_STEP = 0.1
"""Part of the longest step below which the parabola that bounds a height is replaced by the cubic, which allows more."""

RELEASE_BISECTIONS = 60
"""Halvings of the search for the instant at which a vertex is released: to the last bit."""

FIRST_ROWS = 64
"""Rows of the log, and of the knots, that are allocated first; doubled where they are used up."""

_FLIGHT_STEP, _RELEASED, _LEFT = -1, -2, -3
"""What ends a step that no touch ends: its length, a held vertex that is no longer pressed, or the last sliding vertex that
leaves the table."""


@inner
def next_event(
    contact: Contact, precision: Precision, y: Array, time: float, limit: float, stages: Array, now: Array
) -> tuple[float, int, float, float]:
    """One step of the motion, or less where something ends it first; `now` (13,) becomes the state there.

    Returns the time [s] from `y`, the vertex that touches (or _FLIGHT_STEP, _RELEASED), its velocity and acceleration
    relative to the table (0 for a velocity that is only rounding).
    """
    body, plane, i, j = contact
    g, mass, radius = plane.g, body.mass, body.radius
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    growth = spin_growth_bound(body)
    if i < 0:
        push = 0.0
    else:
        # The spin changes in held contact: this step ends before it could outgrow its allowance.
        before = spin
        spin = SPIN_ALLOWANCE * spin + RATE_ALLOWANCE * sqrt((g + peak_table_acceleration) / radius)
        push = g + peak_table_acceleration + radius * spin * spin * (1.0 + growth / sqrt(3.0))
        rate = push * sqrt(mass / body.moments[0]) + growth * spin * spin / sqrt(3.0)
        limit = min(limit, (spin - before) / rate)
    angular = growth * spin * spin / sqrt(3.0) + push * sqrt(mass / body.moments[0])
    longest = min(limit, min(precision.step_turn, MAX_TURN_RAD) / spin) if spin > 0.0 else limit
    if i >= 0 and plane.rate > 0.0 and plane.amplitude != 0.0:
        longest = min(longest, MAX_TURN_RAD / plane.rate)  # the table's motion enters the right side
    bound = g + peak_table_acceleration + push + radius * (spin * spin + angular)
    if i < 0:
        jerk = (
            radius * spin * ((1.0 + 2.0 * growth) * angular + 3.0 * angular + spin * spin)
            + peak_table_acceleration * plane.rate
        )
    else:
        jerk = CONTACT_JERK * (spin + sqrt((g + peak_table_acceleration) / radius) + plane.rate) * bound
    weightless = -PULL_TOLERANCE * mass * bound
    t, last, safe = 0.0, 0.0, 0.0
    space = y[2] - radius - plane.amplitude
    if i < 0 and space > 0.0:
        # No vertex reaches farther down than the circumscribed sphere: fall with it.
        safe = (y[9] + sqrt(y[9] * y[9] + 2.0 * g * space)) / g
    now[:] = y
    t = min(safe, longest)
    while True:
        if t > 0.0:
            state_after_step(contact, y, time, t, stages, now)
        if i >= 0:
            n, o = contact_forces(body, plane, now, time + t, i, j)
            if min(n, o) < weightless:
                for _ in range(RELEASE_BISECTIONS):
                    middle = 0.5 * (last + t)
                    if middle in (last, t):
                        break
                    state_after_step(contact, y, time, middle, stages, now)
                    n, o = contact_forces(body, plane, now, time + middle, i, j)
                    if min(n, o) < weightless:
                        t = middle
                    else:
                        last = middle
                state_after_step(contact, y, time, t, stages, now)
                return t, _RELEASED, 0.0, 0.0
        turned = 1.0 + spin * t
        phase = 1.0 + abs(plane.rate * (time + t)) + abs(plane.phase)
        h_tol = ROUNDING_BOUND * (abs(y[2]) + (abs(y[9]) + g * t) * t + radius * turned + plane.amplitude * phase)
        v_tol = ROUNDING_BOUND * (abs(y[9]) + g * t + spin * radius * turned + plane.amplitude * plane.rate * phase)
        h_tol = max(h_tol, precision.contact_tolerance)
        a_tol = (ROUNDING_BOUND * turned if i < 0 else ACCELERATION_ROUNDING) * bound
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
                if v <= 0.0 or ahead > SMALL_STEP * longest:
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
            # No touch before the root of v s + h'' s²/2 - J s³/6 either. After a release v and h'' are small but grow, and this
            # step is a multiple of the time since; the parabola alone took a thousand steps there.
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
def touch_to_slide(setup: Setup, y: Array, time: float, hit: int, slow: float, active: NDArray[np.bool_]) -> int:
    """Fill `active` with the vertices that are on the table and do not leave it, and `hit`; returns the first of them.

    The steps of sliding contact leave the normal velocities right to first order only."""
    body, _, plane, precision = setup
    near = FRICTION_STANDING_HEIGHT * body.radius
    rate = sqrt(2.0 * rotational_energy(body, y) / body.moments[0]) + sqrt(plane.g / body.radius)
    leaving = max(slow, FRICTION_STEP_PART * precision.step_turn * rate * body.radius)
    first = NONE
    for k in range(active.shape[0]):
        is_low = clearance(body, plane, y, time, k) <= near
        active[k] = k == hit or (is_low and vertex_velocity(body, plane, y, time, k) <= leaving)
        first = k if active[k] and first < 0 else first
    return first


@compiled
def run_asymmetric_throw(
    setup: Setup, start: Array, start_time: float, limits: Limits, keep: bool
) -> tuple[int, int, int, float, Array, Array, Array]:
    """As `engine.run_throw`. No argument is changed.

    `start` (13,) and all states have the position of the centre of mass, the quaternion of the principal axes, and ω. There
    is a knot at the beginning of each step, in flight as well; the event that began the motion is -1 for the release.
    """
    body, law, plane, precision = setup
    duration, impact_limit, impact_cap, stop_when_decided = limits
    y = to_angular_momentum(body, start)
    now, before, shown, stages = np.empty(13), np.empty(13), np.empty(13), np.empty((14, 8))
    chosen, room = np.empty(body.vertices.shape[0], np.int64), np.empty((2, body.vertices.shape[0]))
    rows = FIRST_ROWS if keep else 1
    log, knots = np.empty((rows, LOG_COLUMNS)), Knots(np.empty((rows, KNOT_COLUMNS)), ZERO, NONE, keep)
    active = np.zeros(body.vertices.shape[0], np.bool_)
    slow, rough = chatter_speed(law, plane, precision, body.radius), has_friction(law)
    at_rest = plane.amplitude == 0.0
    time, end, impacts, events, zero_step_count = start_time, start_time + duration, 0, 0, 0
    contact_since, timeout = start_time, TIMEOUT * sqrt(body.radius / plane.g)
    i, j, face, ending = -1, -1, -1, NOT_ENDED
    begins = True  # whether an event has just happened: only then can the face become decided
    while True:
        if begins and at_rest and not rough:
            face = decided_face(body, plane, y)
        if keep or rough:
            to_angular_velocity(body, y, shown)
        if begins and at_rest and rough:
            face = decided_with_friction(body, plane, shown)
        knots = Knots(knots.rows, knots.used, events - 1, keep)
        if j != SLIDING:
            knots = with_knot(knots, time, shown)
        contact = Contact(body, plane, i, j)
        is_on_one = begins and at_rest and stop_when_decided and i >= 0 and j == -1
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
            state_after_step(contact, y, time, dt, stages, now)
            hit = _RELEASED
        elif j == SLIDING:
            open_end = end == inf
            left = (contact_since + timeout if open_end else end) - time
            ending, dt, hit, knots = follow_sliding_contact(
                setup, active, shown, time, left, open_end, stop_when_decided, knots
            )
            knots = with_knot(knots, time + dt, shown)
            copy_to(now, to_angular_momentum(body, shown))
            hit = hit if hit >= 0 else _LEFT
            if ending == RESTED:
                face = plumb_face_row(body, now)
            elif ending == TIME_REACHED:
                face = decided_with_friction(body, plane, shown) if at_rest else face
                ending = TIMED_OUT if open_end else ending
            velocity = vertex_velocity(body, plane, now, time + dt, hit) if hit >= 0 else 0.0
        elif face >= 0 and stop_when_decided and (i >= 0 or not keep):
            ending = RESTED
            now[:] = y
        elif is_on_one and spins_forever(body, plane, y, i):
            ending = SPINNING
            now[:] = y
        else:
            dt, hit, velocity, acceleration = next_event(contact, precision, y, time, end - time, stages, now)
            if hit == _FLIGHT_STEP and time + dt >= end:
                ending = TIME_REACHED
            elif hit >= 0 and face >= 0 and stop_when_decided:
                ending = RESTED
        y[:] = now
        time += dt
        zero_step_count = zero_step_count + 1 if dt == 0.0 else 0
        reorder = hit == _RELEASED or (
            hit >= 0 and -velocity <= slow and (velocity == 0.0 or acceleration < 0.0 or i >= 0)
        )
        if ending == NOT_ENDED and hit >= 0 and not reorder:
            if impacts >= impact_limit:
                ending = IMPACTS_REACHED
            elif impacts >= impact_cap:
                ending = IMPACT_CAP
        if i < 0 and not reorder:
            contact_since = time
        if ending == NOT_ENDED and end == inf and time > contact_since + timeout:
            ending = (
                BALANCED
                if rotational_energy(body, y) < BALANCED_ENERGY * body.mass * plane.g * body.radius
                else TIMED_OUT
            )
        if ending != NOT_ENDED:
            to_angular_velocity(body, y, shown)
            return ending, impacts, face, time, shown, log[: events if keep else 0], knots.rows[: knots.used]
        if i >= 0 and j >= NONE:
            project_on_contact(contact, y, time)
        begins = hit != _FLIGHT_STEP
        if not begins:
            continue
        to_angular_velocity(body, y, before)
        struck = 0.0
        if reorder and rough:
            i, j = touch_to_slide(setup, y, time, hit, slow, active), SLIDING
            hit = -1
        elif reorder:
            hit = -1
            i, j = resolve_contacts(body, plane, y, time, slow, chosen, room)
            contact = Contact(body, plane, i, j)
            if j == -2:
                lay_on_face(body, plane, y, time, i)
            elif i >= 0:
                project_on_contact(contact, y, time)
            if zero_step_count > MAX_ZERO_STEPS:
                # Rounding leaves open whether the die still presses. A little later it does not.
                nudge = nudge_s(zero_step_count, plane, body.radius)
                state_after_step(contact, y, time, nudge, stages, now)
                y[:] = now
                time += nudge
        elif hit >= 0:
            approach = vertex_velocity(body, plane, y, time, hit)
            n, struck = struck_together(Contact(body, plane, hit, NONE), y, time, approach, chosen)
            if rough and j == SLIDING:
                n = without_held(chosen, n, active, hit)
                struck = bits_of_rows(chosen, n)
            strike(setup, y, time, hit, approach, chosen, n, room)
            struck = 0.0 if n == 1 else (-struck if rough else struck)
            i, j = -1, -1
            impacts += 1
        else:
            hit, i, j = -1, -1, -1
        if keep:
            log = with_room(log, events)
            to_angular_velocity(body, y, shown)
            write_event(log[events], time, hit, before, shown, bits_of(active) if j == SLIDING else float(i), j, struck)
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
        if j == SLIDING:
            # The first half of a step goes with the old velocities, the second half with the new ones.
            is_last = k + 1 >= knots.shape[0] or knots[k + 1, 0] != event
            if not is_last and times[n] - knots[k, 1] > 0.5 * (knots[k + 1, 1] - knots[k, 1]):
                k += 1
            out[n] = knots[k, 2:]
            carry_freely(body, out[n], times[n] - knots[k, 1], stages)
            continue
        y = to_angular_momentum(body, knots[k, 2:])
        state_after_step(Contact(body, plane, i, j), y, knots[k, 1], times[n] - knots[k, 1], stages, now)
        to_angular_velocity(body, now, out[n])
    return out
