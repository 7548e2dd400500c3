"""Flight against the quadratic drag of the air, its next touch, and sliding on a face.

The centre of mass obeys v' = g - k |v| v, and a disturbance (δp, δv) of it

    δp' = δv,    δv' = -k (|v| δv + (v·δv)/|v| v) - δk |v| v + δg.

Drag does not turn the die. The motion is integrated by the method of order 8 of `runge_kutta`, alone for throws, and together
with seven disturbances for derivatives. Two rates limit the steps: that at which the velocity turns, |v'|/|v|, and k |v|, by
which it decays. The error is some 1e-14 m in a flight, and up to 1e-11 m at k = 10/m where the die nearly stands still at the
top: there |v| is no smooth function of time.

**The next touch** is found as in vacuum (`throw.touch`): no step is longer than the parabola allows that bounds the height of
each vertex from below, nor than a step of the integration. Drag pulls a die down only while it rises. Within a step of s its
speed stays below V = |v| + |g| s, because drag only slows, so its downward acceleration exceeds g by at most k V². A die that
falls goes on falling, and drag holds it up.
"""

from __future__ import annotations

from math import copysign, cos, hypot, inf, log1p, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compiled import compiled, inner
from .flight import (
    BELOW_TABLE,
    LEAST_BOUND,
    FallingDie,
    advance,
    first_touch,
    table_acceleration,
    table_height,
    table_velocity,
)
from .held_contact import carry_on_face, weight_in_air
from .log import copy_to
from .rest import face_contact_duration
from .runge_kutta import NODES, STAGES, START, VALUES, stage_values
from .types import ROUNDING_BOUND, STANDING_HEIGHT, Array, Plane, PlaneInAir


class Vacuum(NamedTuple):
    """Nothing but gravity acts in flight."""

    drag: float
    """0 [1/m]."""


class Air(NamedTuple):
    """Quadratic drag, for derivatives: a type of its own, so that a flight without it does not compile it."""

    drag: float
    """k [1/m]."""
    by_drag: Array
    """(m,) derivatives of k by the parameters."""


TURN_OF_STEP = 0.2
"""Change of the velocity in one step by gravity and drag, as a part of the velocity. At 0.4 the error of a flight is 1e-12 m."""

DECAY_OF_STEP = 0.1
"""The part of the velocity that drag takes in one step."""

LEAST_STEP_S = 5e-4
"""[s] of a step where the velocity turns faster than that: about the top of a flight straight up. Its error there is 1e-14 m at
k = 0.03/m."""

FLOW_SIZE = 49
"""Numbers that a flight with derivatives carries along: p, v, seven pairs (δp, δv), and the time [s] since its start. The
pairs are the derivatives by k, by v at the start (3), and by gravity (3)."""

MOTION_SIZE = 6
"""Numbers of a flight alone: p and v."""

BACKWARD_GROWTH = 1.5
"""More than the factor by which the speed grows in one step back in time."""

BACKWARD_STEP = 1e-3
"""Least step back in time, as a part of the whole way: 1/(k |v|) ago, the speed was beyond all bounds."""

FACE_STEP_PART = 0.1
"""Step of a die that slides on a face in air, as a part of the time in which the table's motion turns by 1 rad."""

HALVINGS = 60
"""Of the step in which the table throws such a die off."""


# --- The motion of the centre of mass ---


@inner
def drag_acceleration(drag: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """-k |v| v [m/s²] at a velocity [m/s], by the drag k [1/m]."""
    rate = 0.0 if drag == 0.0 else -drag * sqrt(vx * vx + vy * vy + vz * vz)
    return rate * vx, rate * vy, rate * vz


@inner
def longest_step_s(drag: float, plane: Plane, motion: Array) -> float:
    """Length [s] of a step of the integration that begins with `motion`, p and v first."""
    vx, vy, vz = motion[3], motion[4], motion[5]
    speed = sqrt(vx * vx + vy * vy + vz * vz)
    rate = drag * speed
    ax, ay, az = plane.gx - rate * vx, plane.gy - rate * vy, -plane.g - rate * vz
    pull = sqrt(ax * ax + ay * ay + az * az)
    step = LEAST_STEP_S
    if TURN_OF_STEP * speed > LEAST_STEP_S * pull:
        step = inf if pull == 0.0 else TURN_OF_STEP * speed / pull
    return DECAY_OF_STEP / rate if DECAY_OF_STEP < rate * step < inf else step


@inner
def start_flow(state: Array, flow: Array) -> None:
    """Make `flow` (FLOW_SIZE,) that of a flight that begins with `state` (13,)."""
    for k in range(FLOW_SIZE):
        flow[k] = 0.0
    for k in range(3):
        flow[k], flow[3 + k] = state[k], state[7 + k]
    flow[15], flow[22], flow[29] = 1.0, 1.0, 1.0


@inner
def integrate_flow(drag: float, plane: Plane, flow: Array, dt: float) -> None:
    """Carry `flow` (FLOW_SIZE,) through `dt` [s] of flight, of either sign, in place."""
    room, left = np.empty((14, FLOW_SIZE)), dt
    while left != 0.0:
        step = min(abs(left), max(longest_step_s(drag, plane, flow), -BACKWARD_STEP * dt))
        left = 0.0 if step == abs(left) else left - copysign(step, dt)
        for k in range(FLOW_SIZE):
            room[START, k] = flow[k]
        for stage in range(STAGES + 1):
            stage_values(room, stage, copysign(step, dt), FLOW_SIZE)
            if stage < STAGES:
                _flow_rates(drag, plane, room[VALUES], room[stage])
        for k in range(FLOW_SIZE):
            flow[k] = room[VALUES, k]


@inner
def _flow_rates(drag: float, plane: Plane, flow: Array, out: Array) -> None:
    """Fill `out` (FLOW_SIZE,) with the rates of `flow`."""
    vx, vy, vz = flow[3], flow[4], flow[5]
    speed = sqrt(vx * vx + vy * vy + vz * vz)
    out[0], out[1], out[2] = vx, vy, vz
    out[3] = plane.gx - drag * speed * vx
    out[4] = plane.gy - drag * speed * vy
    out[5] = -plane.g - drag * speed * vz
    for c in range(7):
        at = 6 + 6 * c
        dx, dy, dz = flow[at + 3], flow[at + 4], flow[at + 5]
        along = (vx * dx + vy * dy + vz * dz) / speed if speed > 0.0 else 0.0
        out[at], out[at + 1], out[at + 2] = dx, dy, dz
        out[at + 3] = -drag * (speed * dx + along * vx)
        out[at + 4] = -drag * (speed * dy + along * vy)
        out[at + 5] = -drag * (speed * dz + along * vz)
        if c == 0:
            out[9] -= speed * vx
            out[10] -= speed * vy
            out[11] -= speed * vz
        elif c >= 4:
            out[at + c - 1] += 1.0
    out[48] = 1.0


@inner
def start_motion(state: Array, room: Array) -> None:
    """Make room[START, :MOTION_SIZE] the motion of a flight that begins with `state` (13,); `room` as in `runge_kutta`."""
    for k in range(3):
        room[START, k], room[START, 3 + k] = state[k], state[7 + k]


@inner
def motion_step(drag: float, plane: Plane, room: Array, dt: float) -> None:
    """Carry the motion in room[START] through one step of dt [s], of either sign, in place."""
    for stage in range(STAGES + 1):
        stage_values(room, stage, dt, MOTION_SIZE)
        if stage < STAGES:
            vx, vy, vz = room[VALUES, 3], room[VALUES, 4], room[VALUES, 5]
            rate = drag * sqrt(vx * vx + vy * vy + vz * vz)
            room[stage, 0], room[stage, 1], room[stage, 2] = vx, vy, vz
            room[stage, 3] = plane.gx - rate * vx
            room[stage, 4] = plane.gy - rate * vy
            room[stage, 5] = -plane.g - rate * vz
    for k in range(MOTION_SIZE):
        room[START, k] = room[VALUES, k]


@inner
def integrate_motion(drag: float, plane: Plane, room: Array, dt: float) -> None:
    """Carry the motion in room[START] through `dt` [s] of flight, of either sign, in place."""
    left = dt
    while left != 0.0:
        step = min(abs(left), max(longest_step_s(drag, plane, room[START]), -BACKWARD_STEP * dt))
        motion_step(drag, plane, room, copysign(step, dt))
        left = 0.0 if step == abs(left) else left - copysign(step, dt)


@compiled
def drag_trajectory(drag: float, gravity: float, start: Array, delays: Array) -> Array:
    """Positions and velocities (n, 6) `delays` (n,) [s] after a flight began with `start` (13,), in world axes."""
    level = Plane(0.0, 0.0, gravity, 0.0, 0.0, 0.0)
    room, out = np.empty((14, MOTION_SIZE)), np.empty((delays.shape[0], MOTION_SIZE))
    for n in range(delays.shape[0]):
        start_motion(start, room)
        integrate_motion(drag, level, room, delays[n])
        for k in range(MOTION_SIZE):
            out[n, k] = room[START, k]
    return out


# --- The next touch ---


class FreeDie(NamedTuple):
    """A die at the start of a flight."""

    state: Array
    """(13,)."""
    spin: float
    """|ω| [rad/s]."""
    radius: float
    """[m] of the vertex farthest from the centre."""
    terms: Array
    """(n, 4) of `flight.height_terms`."""


@inner
def first_touch_in_air(
    drag: float, die: FreeDie, plane: Plane, clock: float, tolerance: float, limit: float, room: Array
) -> tuple[float, int, float, float, int]:
    """As `flight.first_touch`, against drag. In room[START] it leaves the motion at the touch."""
    state, spin, radius, terms = die
    start_motion(state, room)
    motion, g, t = room[START], plane.g, 0.0
    strongest = sqrt(plane.gx * plane.gx + plane.gy * plane.gy + g * g)
    moving = plane.amplitude != 0.0
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    near = tolerance + STANDING_HEIGHT * radius
    z_table, v_table, a_table, j_table, rounded = 0.0, 0.0, 0.0, 0.0, 0.0
    while True:
        c, s = cos(spin * t), sin(spin * t)
        vx, vy, vz = motion[3], motion[4], motion[5]
        speed, longest = sqrt(vx * vx + vy * vy + vz * vz), longest_step_s(drag, plane, motion)
        top = speed + strongest * longest
        push = drag * top * top if vz > 0.0 else 0.0
        if moving:
            phase = plane.rate * (clock + t) + plane.phase
            z_table, v_table = plane.amplitude * sin(phase), plane.amplitude * plane.rate * cos(phase)
            a_table, j_table = -plane.rate * plane.rate * z_table, -plane.rate * plane.rate * v_table
            rounded = ROUNDING_BOUND * plane.amplitude * (1.0 + abs(phase))
        turned = 1.0 + spin * t  # the phase ωt is rounded as well
        h_tol = tolerance + rounded + ROUNDING_BOUND * (abs(motion[2]) + radius * turned)
        v_tol = rounded * plane.rate + ROUNDING_BOUND * (speed + spin * radius * turned)
        hit, hit_v, hit_a, step, together = -1, 0.0, 0.0, longest, 0
        for i in range(terms.shape[0]):
            a, b, amplitude = terms[i, 0], terms[i, 1], terms[i, 3]
            h = motion[2] + a * c + b * s + terms[i, 2] - z_table
            v = vz + spin * (b * c - a * s) - v_table
            bound = g + push + spin * spin * amplitude + peak_table_acceleration
            if h <= near and v < 0.0:
                together += 1
            if h > h_tol:
                ahead = _root_of_parabola(h, v, bound)
                if moving and h + z_table > plane.amplitude:
                    # No touch before the table's highest position, as in vacuum.
                    high = h + z_table - plane.amplitude
                    ahead = max(ahead, _root_of_parabola(high, v + v_table, bound - peak_table_acceleration))
            elif v > v_tol:
                # No less than a step in which the height changes by rounding alone: where a vertex below the table hardly ceases
                # to rise, the first shrinks with v, and the integration's rounding keeps v above its tolerance.
                ahead = max(2.0 * v / bound, sqrt(2.0 * h_tol / bound))
            else:
                # The derivatives of -k |v| v are at most 2 k V A and 4 k A (A + k V²), with V and A those of v and v'.
                fastest = strongest + drag * top * top
                braking = drag * speed * vz
                along = vx * plane.gx + vy * plane.gy - vz * g - drag * speed * speed * speed  # v·v'
                jolt = drag * (speed * (g + braking) - (along / speed * vz if speed > 0.0 else 0.0))
                acceleration = -g - braking - spin * spin * (a * c + b * s) - a_table
                jerk = spin * spin * spin * (a * s - b * c) - j_table + jolt
                third = (
                    spin * spin * spin * amplitude + peak_table_acceleration * plane.rate + 2.0 * drag * top * fastest
                )
                fourth = spin * spin * spin * spin * amplitude + peak_table_acceleration * plane.rate * plane.rate
                fourth += 4.0 * drag * fastest * (fastest + drag * top * top)
                a_tol = rounded * plane.rate * plane.rate
                a_tol += ROUNDING_BOUND * (g + drag * speed * speed + spin * spin * radius * turned)
                if v >= -v_tol and acceleration >= -a_tol and jerk > ROUNDING_BOUND * third:
                    ahead = max(3.0 * max(acceleration, 0.0) / third, 4.0 * jerk / fourth)
                elif v < -v_tol or acceleration <= a_tol:
                    v = v if v < -v_tol else 0.0
                    if hit < 0 or v < hit_v:
                        hit, hit_v, hit_a = i, v, acceleration
                    continue
                else:
                    ahead = 3.0 * acceleration / third
            step = min(step, ahead)
        if hit >= 0:
            return t, hit, hit_v, hit_a, together
        free = motion[2] - radius - plane.amplitude
        if free > 0.0:
            # No vertex reaches farther down than the circumscribed sphere: fall with it.
            step = min(longest, max(step, _root_of_parabola(free, vz, g + push)))
        if t + step > limit:
            return limit, -1, 0.0, 0.0, 0
        motion_step(drag, plane, room, step)
        t += step


@inner
def _root_of_parabola(h: float, v: float, bound: float) -> float:
    """The time [s] in which a point at h > 0 [m] with v [m/s] comes down at the acceleration -bound [m/s²]."""
    root = sqrt(v * v + 2.0 * bound * h)
    # Two forms of one root, each free of cancellation for its sign of v.
    return (v + root) / bound if v > 0.0 else 2.0 * h / (root - v)


@inner
def touch_of_vertex_in_air(
    drag: float, die: FreeDie, plane: Plane, clock: float, room: Array
) -> tuple[float, bool, float, float]:
    """As `flight.touch_of_vertex`, against drag."""
    state, spin, radius, terms = die
    below = BELOW_TABLE * radius
    h = state[2] + terms[0, 0] + terms[0, 2] - table_height(plane, clock)
    if h < below and state[9] + spin * terms[0, 1] < table_velocity(plane, clock):
        return _touch_before_in_air(drag, die, plane, clock, room)
    t, _, v, acceleration, _ = first_touch_in_air(drag, die, plane, clock, 0.0, inf, room)
    swung = terms[0, 0] * cos(spin * t) + terms[0, 1] * sin(spin * t) + terms[0, 2]
    return t, room[START, 2] + swung - table_height(plane, clock + t) >= below, v, acceleration


@inner
def _touch_before_in_air(
    drag: float, die: FreeDie, plane: Plane, clock: float, room: Array
) -> tuple[float, bool, float, float]:
    """The instant before the flight at which a vertex that is below the table crossed it; as `touch_of_vertex_in_air`."""
    state, spin, radius, terms = die
    start_motion(state, room)
    motion, t, g = room[START], 0.0, plane.g
    strongest, farthest = sqrt(plane.gx * plane.gx + plane.gy * plane.gy + g * g), sqrt(2.0 * radius / g)
    swing_most = spin * spin * terms[0, 3] + plane.amplitude * plane.rate * plane.rate
    speed = 0.0
    while t > -farthest and speed < inf:
        swung, swept = cos(spin * t), sin(spin * t)
        h = motion[2] + terms[0, 0] * swung + terms[0, 1] * swept + terms[0, 2] - table_height(plane, clock + t)
        v = motion[5] + spin * (terms[0, 1] * swung - terms[0, 0] * swept) - table_velocity(plane, clock + t)
        size = abs(motion[2]) + radius * (1.0 - spin * t)
        if plane.amplitude != 0.0:
            size += plane.amplitude * (1.0 + abs(plane.rate * (clock + t) + plane.phase))
        speed = sqrt(motion[3] * motion[3] + motion[4] * motion[4] + motion[5] * motion[5])
        if h >= -ROUNDING_BOUND * size:
            acceleration = -g - drag * speed * motion[5] - spin * spin * (terms[0, 0] * swung + terms[0, 1] * swept)
            return t, True, v, acceleration - table_acceleration(plane, clock + t)
        longest = max(longest_step_s(drag, plane, motion), BACKWARD_STEP * farthest)
        top = BACKWARD_GROWTH * (speed + strongest * longest)
        bound = max(swing_most + drag * top * top - g, LEAST_BOUND * g)  # h'' is no larger
        root = sqrt(v * v - 2.0 * bound * h)
        step = min(longest, 2.0 * h / (v - root) if v < 0.0 else (v + root) / bound)
        motion_step(drag, plane, room, -step)
        t -= step
    return t, False, 0.0, 0.0


# --- By the type of the plane: in vacuum or in air ---


@inner
def next_touch_in_vacuum(
    die: FreeDie, plane: Plane, clock: float, tolerance: float, limit: float, room: Array
) -> tuple[float, int, float, float, int]:
    """`next_touch` without drag."""
    falling = FallingDie(die.state[2], die.state[9], die.spin, die.radius)
    touch: tuple[float, int, float, float, int] = first_touch(die.terms, falling, plane, clock, tolerance, limit)
    return touch


@inner
def next_touch_in_air(
    die: FreeDie, plane: PlaneInAir, clock: float, tolerance: float, limit: float, room: Array
) -> tuple[float, int, float, float, int]:
    """`next_touch` against drag."""
    touch: tuple[float, int, float, float, int] = first_touch_in_air(
        plane.drag, die, plane, clock, tolerance, limit, room
    )
    return touch


def next_touch(
    die: FreeDie, plane: Plane | PlaneInAir, clock: float, tolerance: float, limit: float, room: Array
) -> tuple[float, int, float, float, int]:
    """The next touch of a flight, as `flight.first_touch`. `room` is a workspace of `runge_kutta`; against drag it keeps the
    motion at the touch for `fly_to_touch`."""
    if isinstance(plane, PlaneInAir):
        return next_touch_in_air(die, plane, clock, tolerance, limit, room)
    return next_touch_in_vacuum(die, plane, clock, tolerance, limit, room)


@overload(next_touch, strict=False)
def _next_touch_of(die: Any, plane: Any, clock: Any, tolerance: Any, limit: Any, room: Any) -> Any:
    """The branch of `next_touch` that the type of the plane asks for, chosen when it is compiled."""
    chosen = next_touch_in_air if plane.instance_class is PlaneInAir else next_touch_in_vacuum
    return chosen.py_func


@inner
def fly_to_touch_in_air(die: FreeDie, plane: PlaneInAir, dt: float, room: Array) -> None:
    """`fly_to_touch` against drag."""
    advance(die.state, die.spin, dt, plane)  # for its attitude
    for k in range(3):
        die.state[k], die.state[7 + k] = room[START, k], room[START, 3 + k]


def fly_to_touch(die: FreeDie, plane: Plane | PlaneInAir, dt: float, room: Array) -> None:
    """Move the state in place to the touch that `next_touch` has just found, `dt` [s] ahead, with its `room`."""
    if isinstance(plane, PlaneInAir):
        fly_to_touch_in_air(die, plane, dt, room)
    else:
        advance(die.state, die.spin, dt, plane)


@overload(fly_to_touch, strict=False)
def _fly_to_touch_of(die: Any, plane: Any, dt: Any, room: Any) -> Any:
    """The branch of `fly_to_touch` that the type of the plane asks for, chosen when it is compiled."""
    if plane.instance_class is PlaneInAir:
        return fly_to_touch_in_air.py_func
    return lambda die, plane, dt, room: advance(die.state, die.spin, dt, plane)


@inner
def fly_in_air(state: Array, spin: float, dt: float, plane: PlaneInAir, room: Array) -> None:
    """`fly` against drag."""
    start_motion(state, room)
    integrate_motion(plane.drag, plane, room, dt)
    advance(state, spin, dt, plane)  # for its attitude
    for k in range(3):
        state[k], state[7 + k] = room[START, k], room[START, 3 + k]


def fly(state: Array, spin: float, dt: float, plane: Plane | PlaneInAir, room: Array) -> None:
    """Move the state through dt [s] of flight, in place; `room` is a workspace of `runge_kutta`."""
    if isinstance(plane, PlaneInAir):
        fly_in_air(state, spin, dt, plane, room)
    else:
        advance(state, spin, dt, plane)


@overload(fly, strict=False)
def _fly_of(state: Any, spin: Any, dt: Any, plane: Any, room: Any) -> Any:
    """The branch of `fly` that the type of the plane asks for, chosen when it is compiled."""
    if plane.instance_class is PlaneInAir:
        return fly_in_air.py_func
    return lambda state, spin, dt, plane, room: advance(state, spin, dt, plane)


# --- Lying on a face ---


@compiled
def carry_on_face_in_air(state: Array, plane: PlaneInAir, time: float, dt: float) -> None:
    """`carry_on_face` against drag: in closed form on a level table at rest, where |v| = v₀/(1 + k v₀ t)."""
    x, y, vx, vy = state[0], state[1], state[7], state[8]
    carry_on_face(state, Plane(0.0, 0.0, plane.g, plane.amplitude, plane.rate, plane.phase), time, dt)
    if plane.gx == 0.0 and plane.gy == 0.0 and plane.amplitude == 0.0:
        rate = plane.drag * hypot(vx, vy)
        far = log1p(rate * dt) / rate if rate > 0.0 else dt
        state[0], state[1] = x + vx * far, y + vy * far
        state[7], state[8] = vx / (1.0 + rate * dt), vy / (1.0 + rate * dt)
        return
    room, left, flat = np.empty((14, 4)), dt, Plane(plane.gx, plane.gy, 0.0, 0.0, 0.0, 0.0)
    motion = np.zeros(MOTION_SIZE)
    while left > 0.0:
        motion[3], motion[4] = vx, vy
        step = longest_step_s(plane.drag, flat, motion)
        step = min(left, step if plane.amplitude == 0.0 else min(step, FACE_STEP_PART / plane.rate))
        room[START, 0], room[START, 1], room[START, 2], room[START, 3] = x, y, vx, vy
        for stage in range(STAGES + 1):
            stage_values(room, stage, step, 4)
            if stage < STAGES:
                ux, uy = room[VALUES, 2], room[VALUES, 3]
                up = table_velocity(plane, time + dt - left + NODES[stage] * step)
                drag = plane.drag * sqrt(ux * ux + uy * uy + up * up)
                room[stage, 0], room[stage, 1] = ux, uy
                room[stage, 2], room[stage, 3] = plane.gx - drag * ux, plane.gy - drag * uy
        x, y, vx, vy = room[VALUES, 0], room[VALUES, 1], room[VALUES, 2], room[VALUES, 3]
        left = 0.0 if step == left else left - step
    state[0], state[1], state[7], state[8] = x, y, vx, vy


def slide_on_face(state: Array, plane: Plane | PlaneInAir, time: float, dt: float) -> None:
    """`carry_on_face`, in vacuum or against drag."""
    if isinstance(plane, PlaneInAir):
        carry_on_face_in_air(state, plane, time, dt)
    else:
        carry_on_face(state, plane, time, dt)


@overload(slide_on_face, strict=False)
def _slide_on_face_of(state: Any, plane: Any, time: Any, dt: Any) -> Any:
    """The branch of `slide_on_face` that the type of the plane asks for, chosen when it is compiled."""

    def in_air(state: Any, plane: Any, time: Any, dt: Any) -> None:
        carry_on_face_in_air(state, plane, time, dt)

    def in_vacuum(state: Any, plane: Any, time: Any, dt: Any) -> None:
        carry_on_face(state, plane, time, dt)

    return in_air if plane.instance_class is PlaneInAir else in_vacuum


@inner
def pressed_on_face_s_in_air(plane: PlaneInAir, state: Array, time: float, limit: float) -> float:
    """`pressed_on_face_s` against drag, which lifts the die that sinks with the table.

    On a table that moves hard it is looked for within one turn of the motion; then the die counts as free, and is held again.
    """
    strongest, fastest = plane.amplitude * plane.rate * plane.rate, plane.amplitude * plane.rate
    if strongest == 0.0:
        return limit
    # Along the table the die never gets faster than it is or, on a slope, than its terminal velocity there.
    along = max(state[7] * state[7] + state[8] * state[8], hypot(plane.gx, plane.gy) / plane.drag)
    if strongest + plane.drag * sqrt(along + fastest * fastest) * fastest <= plane.g:
        return limit
    here, there = state.copy(), np.empty(13)
    done, end, step = 0.0, min(limit, 2.0 * np.pi / plane.rate), FACE_STEP_PART / plane.rate
    while done < end:
        copy_to(there, here)
        carry_on_face_in_air(there, plane, time + done, step)
        if weight_in_air(plane, there, time + done + step) <= 0.0:
            low, high = 0.0, step
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                copy_to(there, here)
                carry_on_face_in_air(there, plane, time + done, middle)
                if weight_in_air(plane, there, time + done + middle) > 0.0:
                    low = middle
                else:
                    high = middle
            return min(done + high, limit)
        copy_to(here, there)
        done += step
    return end


def pressed_on_face_s(plane: Plane | PlaneInAir, state: Array, time: float, limit: float) -> float:
    """How long [s] the face stays pressed on the table, no longer than `limit`."""
    if isinstance(plane, PlaneInAir):
        return float(pressed_on_face_s_in_air(plane, state, time, limit))
    return float(face_contact_duration(plane, time, limit))


@overload(pressed_on_face_s, strict=False)
def _pressed_on_face_s_of(plane: Any, state: Any, time: Any, limit: Any) -> Any:
    """The branch of `pressed_on_face_s` that the type of the plane asks for, chosen when it is compiled."""
    if plane.instance_class is PlaneInAir:
        return pressed_on_face_s_in_air.py_func
    return lambda plane, state, time, limit: face_contact_duration(plane, time, limit)
