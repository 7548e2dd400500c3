"""When a throw is over: rules of rest, of spinning and of balance, each proved in `throw.simulate`.

The energy that vertical forces can change, E' = m g z + m v_z²/2 + J (ω_x² + ω_y²)/2, decides. Once it is less than the
height of the barriers around a face, the die cannot leave that face. Friction can turn all of the energy into what lifts the
die, so that with friction the whole of it counts.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np
from numba.extending import overload

from ..compiled import compiled, inner
from .flight import lever_arm
from .inertia import to_body_axes, vertical_in_body
from .types import Array, AsymmetricBody, Body, Law, Plane, Precision, has_friction

TIMEOUT = 1000.0
"""A throw is given up as spinning after this many √(R/g) without the energy to stand up and more, where no proof shows that it
spins for ever. A larger value costs time, a smaller one gives up throws that would land."""

SLOW_DECAY = 0.1
"""Above χ = 1 - SLOW_DECAY, where every die takes long to lose its energy, the timeout is SLOW_DECAY/(1 - χ) times as long."""

ENERGETIC = 3.0
"""Energy in units of m g R above which a die counts as energetic: three times that of a die balanced on its farthest vertex."""

MARGIN_OF_PROOF = 1e-12
"""Relative rounding that a proof of endless spinning must exceed. A die laid on an edge has both sides equal."""

MAX_ZERO_STEPS = 3
"""Events in a row at one instant after which rounding is taken to repeat them, and the die is moved on by a nudge. With 20, 3000
random throws of asymmetric bodies land on the same faces; one in a hundred logs more events."""

NUDGE = 1e-9
"""Time of that nudge in units of √(R/g), for each event at that instant."""


@inner
def chatter_speed(law: Law, plane: Plane, precision: Precision, radius: float) -> float:
    """Speed [m/s] below which a vertex that accelerates into the table bounces without end; see `throw.held_contact`."""
    # With χ = 1 the bounces do not shrink, so that nothing collapses.
    return 0.0 if law.parameters[0] >= 1.0 else precision.slowest_bounce * sqrt(plane.g * radius)


@inner
def timeout_s(law: Law, plane: Plane, radius: float, open_end: bool) -> float:
    """Time [s] without energy after which a throw is given up; infinite where the throw has a limit, or χ = 1."""
    unit = sqrt(radius / plane.g)
    if open_end and plane.amplitude != 0.0:
        return TIMEOUT * unit
    if open_end and law.parameters[0] < 1.0:
        return TIMEOUT * max(1.0, SLOW_DECAY / (1.0 - law.parameters[0])) * unit
    return inf


@inner
def nudge_s(zero_step_count: int, plane: Plane, radius: float) -> float:
    """Time [s] by which a die is moved on after so many events at one instant."""
    return NUDGE * zero_step_count * sqrt(radius / plane.g)


@compiled
def lowest_face_row(normals: Array, state: Array) -> int:
    """Row of the face normal (faces, 3) that points down most."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    # Third row of the rotation matrix.
    a, b, c = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    best, lowest = 0, inf
    for k in range(normals.shape[0]):
        down = normals[k, 0] * a + normals[k, 1] * b + normals[k, 2] * c
        if down < lowest:
            best, lowest = k, down
    return best


@inner
def energy_per_mass(body: Body, plane: Plane, state: Array) -> float:
    """The energy per mass [m²/s²] that vertical forces can change: without ω_z and the horizontal velocity."""
    turning = body.inertia / body.mass * (state[10] * state[10] + state[11] * state[11])
    return plane.g * state[2] + 0.5 * (state[9] * state[9] + turning)


@inner
def is_energetic(body: Body, plane: Plane, state: Array) -> bool:
    """Whether the die has the energy to stand up and more."""
    return energy_per_mass(body, plane, state) > ENERGETIC * plane.g * body.radius


@compiled
def decided_face(body: Body, law: Law, plane: Plane, state: Array) -> int:
    """Row of the face that the die can no longer leave, or -1."""
    return _face_held_by_energy(body, plane, state, has_friction(law))


@inner
def _face_held_by_energy(body: Body, plane: Plane, state: Array, rough: bool) -> int:
    """`decided_face` with friction or without."""
    energy = energy_per_mass(body, plane, state)
    if rough:
        if plane.gx != 0.0 or plane.gy != 0.0:
            return -1  # the slope goes on feeding the slip, so that only a die at rest has landed
        energy += 0.5 * (state[7] * state[7] + state[8] * state[8])
        energy += 0.5 * body.inertia / body.mass * state[12] * state[12]
    if energy >= plane.g * body.radius:
        return -1  # no edge is farther from the centre than a corner
    face = lowest_face_row(body.plumb_normals, state)
    return face if energy < plane.g * body.barrier_heights[face] else -1


@inner
def plumb_face_row(body: AsymmetricBody, state: Array) -> int:
    """Row of the face of an asymmetric body that the plumb line from its centre of mass goes through."""
    x, y, z = vertical_in_body(state)
    face, best = 0, -inf
    for k in range(body.normals.shape[0]):
        down = -(body.normals[k, 0] * x + body.normals[k, 1] * y + body.normals[k, 2] * z) / body.offsets[k]
        if down > best:
            face, best = k, down
    return face


@inner
def _decided_asymmetric(body: AsymmetricBody, plane: Plane, state: Array) -> int:
    """`decided_with_friction` of an asymmetric body: it must lift its centre of mass over an edge of its face."""
    if plane.gx != 0.0 or plane.gy != 0.0:
        return -1
    p, q, r = to_body_axes(state, state[10], state[11], state[12])
    energy = plane.g * state[2] + 0.5 * (state[7] * state[7] + state[8] * state[8] + state[9] * state[9])
    energy += 0.5 * (body.moments[0] * p * p + body.moments[1] * q * q + body.moments[2] * r * r) / body.mass
    face = plumb_face_row(body, state)
    for e in range(body.edge_faces.shape[0]):
        is_beside = body.edge_faces[e, 0] == face or body.edge_faces[e, 1] == face
        if is_beside and energy >= plane.g * body.edge_heights[e]:
            return -1
    return face


@inner
def _decided_even(body: Body, plane: Plane, state: Array) -> int:
    """`decided_with_friction` of a die with one moment of inertia."""
    return _face_held_by_energy(body, plane, state, True)


def decided_with_friction(body: Body | AsymmetricBody, plane: Plane, state: Array) -> int:
    """Row of the face that a die can no longer leave where friction may turn all of its energy into what lifts it, or -1. The
    state (13,) has ω."""
    if isinstance(body, AsymmetricBody):
        return int(_decided_asymmetric(body, plane, state))
    return int(_decided_even(body, plane, state))


@overload(decided_with_friction, strict=False)
def _decided_with_friction(body: Any, plane: Any, state: Any) -> Any:
    """The branch that the type of the body asks for, chosen when it is compiled."""
    return (_decided_asymmetric if body.instance_class is AsymmetricBody else _decided_even).py_func


@inner
def spins_forever(body: Body, plane: Plane, state: Array, i: int) -> bool:
    """Whether the die spins on vertex i and can never touch the table with another one."""
    x, y, z = lever_arm(body.vertices[i], state)
    size = sqrt(x * x + y * y + z * z)
    upright, limit = -z / size, body.safe_tilt_cosines[i]
    about_z, about_axis = state[12], -(state[10] * x + state[11] * y + state[12] * z) / size
    per_mass = body.inertia / body.mass
    across = about_axis - about_z * limit
    needed = plane.g * size * limit + 0.5 * per_mass * across * across / (1.0 - limit * limit)
    return bool(
        upright > limit + MARGIN_OF_PROOF and needed > energy_per_mass(body, plane, state) * (1.0 + MARGIN_OF_PROOF)
    )


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
