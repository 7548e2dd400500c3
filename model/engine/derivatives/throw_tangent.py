"""A throw with derivatives by its start and by the parameters of die, law, table and air: the kernel of every fit.

The throw touches in the order that it takes by itself, or with prescribed vertices. Then each flight lasts until that vertex
comes down, and the poses are a smooth function of the start. Held contact is not followed. Method: `throw.tangent`.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ...compiled import compiled, inner
from ..air import (
    FLOW_SIZE,
    MOTION_SIZE,
    Air,
    FreeDie,
    Vacuum,
    drag_acceleration,
    first_touch_in_air,
    integrate_flow,
    start_flow,
    touch_of_vertex_in_air,
)
from ..flight import (
    FallingDie,
    advance,
    first_touch,
    height_terms,
    is_in_range,
    spin_rate,
    table_acceleration,
    table_velocity,
    touch_of_vertex,
)
from ..log import copy_to, fill_with_nan, with_room, write_event
from ..rest import chatter_speed
from ..types import (
    CHATTER,
    IMPACT_CAP,
    LOG_COLUMNS,
    NO_TOUCH,
    NONE,
    TIME_REACHED,
    Array,
    Plane,
    Setup,
)
from .growth import impact_at_vertex
from .impulse_gradient import INPUTS, ParameterDerivatives
from .linearised_motion import (
    SHIFTS,
    ImpactKinematics,
    flight_tangent,
    impact_derivatives,
    impact_tangent,
    shifts_at_impact,
)

FIRST_ROWS = 16
"""Rows of the log that are allocated first; doubled where they are used up."""


class ImpactSequence(NamedTuple):
    """Which vertices strike."""

    vertices: NDArray[np.int64]
    """(k,) in their order, if they are prescribed."""
    free: bool
    """Whether the first touch counts instead."""
    cap: int
    """Impacts after which such a throw is stopped."""


class FlightStart(NamedTuple):
    """The state in which a flight begins."""

    state: Array
    """(13,)."""
    spin: float
    """|ω| [rad/s]."""
    flow: Array
    """(FLOW_SIZE,) of `air`, as far as it has been integrated; not used in vacuum."""


@inner
def fly_in_vacuum(
    air: Vacuum,
    plane: Plane,
    start: FlightStart,
    dt: float,
    tangent: Array,
    sources: ParameterDerivatives,
    pose: Array,
    moved: Array,
) -> None:
    """`fly` without drag."""
    copy_to(pose, start.state)
    advance(pose, start.spin, dt, plane)
    flight_tangent(tangent, tangent.shape[1], start.state, start.spin, dt, moved)
    for p in range(sources.gravity.shape[0]):
        for k in range(3):
            moved[k, 12 + p] += 0.5 * sources.gravity[p, k] * dt * dt
            moved[6 + k, 12 + p] += sources.gravity[p, k] * dt


@inner
def fly_in_air(
    air: Air,
    plane: Plane,
    start: FlightStart,
    dt: float,
    tangent: Array,
    sources: ParameterDerivatives,
    pose: Array,
    moved: Array,
) -> None:
    """`fly` against drag; the flow goes on from where the last call has left it, unless that was before the start, where the
    speed may have grown beyond all bounds."""
    state, spin, flow = start
    if flow[48] < 0.0:
        start_flow(state, flow)
    integrate_flow(air.drag, plane, flow, dt - flow[48])
    copy_to(pose, state)
    advance(pose, spin, dt, plane)  # for its attitude
    for k in range(3):
        pose[k], pose[7 + k] = flow[k], flow[3 + k]
    flight_tangent(tangent, tangent.shape[1], state, spin, dt, moved)
    for j in range(tangent.shape[1]):
        for k in range(3):
            place, speed = tangent[k, j], 0.0
            for m in range(3):
                place += flow[12 + 6 * m + k] * tangent[6 + m, j]
                speed += flow[15 + 6 * m + k] * tangent[6 + m, j]
            if j >= 12:
                p = j - 12
                place += flow[6 + k] * air.by_drag[p]
                speed += flow[9 + k] * air.by_drag[p]
                for m in range(3):
                    place += flow[30 + 6 * m + k] * sources.gravity[p, m]
                    speed += flow[33 + 6 * m + k] * sources.gravity[p, m]
            moved[k, j], moved[6 + k, j] = place, speed


def fly(
    air: Vacuum | Air,
    plane: Plane,
    start: FlightStart,
    dt: float,
    tangent: Array,
    sources: ParameterDerivatives,
    pose: Array,
    moved: Array,
) -> None:
    """State and derivatives `dt` [s] after the start of a flight, into `pose` (13,) and `moved` (12, 12 + m)."""
    if isinstance(air, Air):
        fly_in_air(air, plane, start, dt, tangent, sources, pose, moved)
    else:
        fly_in_vacuum(air, plane, start, dt, tangent, sources, pose, moved)


@overload(fly, strict=False)
def _fly_of(air: Any, plane: Any, start: Any, dt: Any, tangent: Any, sources: Any, pose: Any, moved: Any) -> Any:
    """The branch of `fly` that the type of the air asks for, chosen when it is compiled."""
    chosen = fly_in_air if air.instance_class is Air else fly_in_vacuum
    return chosen.py_func


@inner
def touch_in_vacuum(
    air: Vacuum, plane: Plane, start: FlightStart, terms: Array, radius: float, clock: float, limit: float
) -> tuple[float, int, float, float]:
    """`touch_ahead` without drag."""
    falling = FallingDie(start.state[2], start.state[9], start.spin, radius)
    if limit < inf:
        dt, hit, velocity, acceleration, _ = first_touch(terms, falling, plane, clock, 0.0, limit)
        return dt, hit, velocity, acceleration
    dt, found, velocity, acceleration = touch_of_vertex(terms, falling, plane, clock)
    return dt, 0 if found else -1, velocity, acceleration


@inner
def touch_in_air(
    air: Air, plane: Plane, start: FlightStart, terms: Array, radius: float, clock: float, limit: float
) -> tuple[float, int, float, float]:
    """`touch_ahead` against drag."""
    die, room = FreeDie(start.state, start.spin, radius, terms), np.empty((14, MOTION_SIZE))
    if limit < inf:
        dt, hit, velocity, acceleration, _ = first_touch_in_air(air.drag, die, plane, clock, 0.0, limit, room)
        return dt, hit, velocity, acceleration
    dt, found, velocity, acceleration = touch_of_vertex_in_air(air.drag, die, plane, clock, room)
    return dt, 0 if found else -1, velocity, acceleration


def touch_ahead(
    air: Vacuum | Air, plane: Plane, start: FlightStart, terms: Array, radius: float, clock: float, limit: float
) -> tuple[float, int, float, float]:
    """The first touch of the vertices of `terms` up to `limit` [s], as `first_touch`; for an infinite limit the touch of the
    one vertex in `terms`, as `touch_of_vertex`. Returns time, row (-1: none), velocity and acceleration."""
    if isinstance(air, Air):
        return touch_in_air(air, plane, start, terms, radius, clock, limit)
    return touch_in_vacuum(air, plane, start, terms, radius, clock, limit)


@overload(touch_ahead, strict=False)
def _touch_ahead_of(air: Any, plane: Any, start: Any, terms: Any, radius: Any, clock: Any, limit: Any) -> Any:
    """The branch of `touch_ahead` that the type of the air asks for, chosen when it is compiled."""
    chosen = touch_in_air if air.instance_class is Air else touch_in_vacuum
    return chosen.py_func


@compiled
def run_tangent(
    setup: Setup,
    air: Vacuum | Air,
    start: Array,
    start_time: float,
    times: Array,
    sequence: ImpactSequence,
    seed: Array,
    sources: ParameterDerivatives,
) -> tuple[int, Array, Array, Array, Array]:
    """Poses at `times` (n,) [s], ascending, of a throw with its derivatives by 12 + m parameters.

    `seed` (12, 12 + m) are the derivatives of the start, `sources` those of
    what else the m parameters change. Returns an ending (TIME_REACHED, CHATTER, IMPACT_CAP or NO_TOUCH), poses (n, 7), their
    derivatives (n, 6, 12 + m), the log (k, LOG_COLUMNS), and the derivatives (k, 12 + m) of the instants of the impacts.
    """
    body, law, plane, precision = setup
    n, columns = times.shape[0], seed.shape[1]
    poses, jacobian = np.empty((n, 7)), np.empty((n, 6, columns))
    log, dtimes = np.empty((FIRST_ROWS, LOG_COLUMNS)), np.empty((FIRST_ROWS, columns))
    state, before, pose = start.copy(), np.empty(13), np.empty(13)
    tangent, moved, flow = seed.copy(), np.empty((12, columns)), np.empty(FLOW_SIZE)
    shifts = np.empty((columns - 12, SHIFTS))
    derivatives = impact_derivatives(law, INPUTS, np.any(sources.chi), np.any(sources.mu), shifts, inf)
    terms = np.empty((body.vertices.shape[0], 4))
    slow = chatter_speed(law, plane, precision, body.radius)
    last = times[n - 1] if n > 0 else start_time
    time, done, impacts, ending = start_time, 0, 0, TIME_REACHED
    while True:
        spin = spin_rate(state)
        height_terms(body.vertices, state, spin, terms)
        start_flow(state, flow)
        flight = FlightStart(state, spin, flow)
        hit, dt = NONE, 0.0
        if not is_in_range(state):
            fill_with_nan(poses, jacobian, done)
            return NO_TOUCH, poses, jacobian, log[:impacts], dtimes[:impacts]
        if sequence.free:
            dt, hit, velocity, acceleration = touch_ahead(air, plane, flight, terms, body.radius, time, last - time)
            if hit >= 0 and (velocity == 0.0 or (-velocity <= slow and acceleration < 0.0)):
                hit, ending = -1, CHATTER
            elif hit >= 0 and impacts >= sequence.cap:
                hit, ending = -1, IMPACT_CAP
        elif impacts < sequence.vertices.shape[0]:
            hit = sequence.vertices[impacts]
            dt, found, velocity, _ = touch_ahead(air, plane, flight, terms[hit : hit + 1], body.radius, time, inf)
            if found < 0 or velocity >= 0.0:
                hit, ending = -1, NO_TOUCH
        while done < n and (hit < 0 or times[done] < time + dt):
            fly(air, plane, flight, times[done] - time, tangent, sources, pose, moved)
            for k in range(7):
                poses[done, k] = pose[k]
            for k in range(6):
                for m in range(columns):
                    jacobian[done, k, m] = moved[k, m]
            done += 1
        if hit < 0:
            return ending, poses, jacobian, log[:impacts], dtimes[:impacts]
        log, dtimes = with_room(log, impacts), with_room(dtimes, impacts)
        fly(air, plane, flight, dt, tangent, sources, before, moved)
        tangent, moved = moved, tangent
        time += dt
        copy_to(state, before)
        impact_at_vertex(body, law, plane, time, hit, state)
        kinematics = _flight_kinematics(plane, time, air.drag, before, state)
        shifts_at_impact(sources, plane, time, hit, before, shifts)
        impact_tangent(setup, hit, before, kinematics, derivatives, tangent, columns, dtimes[impacts])
        write_event(log[impacts], time, hit, before, state, -1.0, NONE, 0.0)
        impacts += 1


@inner
def _flight_kinematics(plane: Plane, time: float, drag: float, before: Array, after: Array) -> ImpactKinematics:
    """Motion around an impact between two flights, whose states there are `before` and `after`."""
    bx, by, bz = drag_acceleration(drag, before[7], before[8], before[9])
    fx, fy, fz = drag_acceleration(drag, after[7], after[8], after[9])
    return ImpactKinematics(
        table_velocity(plane, time),
        table_acceleration(plane, time),
        plane.gx + bx,
        plane.gy + by,
        bz - plane.g,
        0.0,
        0.0,
        bx - fx,
        by - fy,
        bz - fz,
    )
