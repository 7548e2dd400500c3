"""Motion of an asymmetric body: energy, vertices, forces that hold them, and steps of the integration.

States y (13,) have the angular momentum L in place of ω. In held contact vertices i and j are on the table, j = -1 where there
is only one; with j = -2 the die lies on the face i.
"""

from __future__ import annotations

from math import cos, sin, sqrt

from ...compiled import inner
from ..flight import table_acceleration, table_height, table_velocity
from ..inertia import attitude_rates, body_angular_velocity, to_table_axes, vertical_in_body
from ..runge_kutta import NODES, STAGES, START, VALUES, stage_values
from ..types import Array, AsymmetricBody, Contact, Plane

MAX_TURN_RAD = 0.2
"""Largest turn in one step: the energy of a flight then stays within 1e-13 of itself, as the tests measure."""


@inner
def rotational_energy(body: AsymmetricBody, y: Array) -> float:
    """½ ω·Iω [J]."""
    a, b, c = body_angular_velocity(body, y)
    return 0.5 * (body.moments[0] * a * a + body.moments[1] * b * b + body.moments[2] * c * c)


@inner
def unit_torque(body: AsymmetricBody, y: Array, i: int) -> tuple[float, float, float]:
    """t = r × u of a vertex in body axes: the torque of a unit vertical force."""
    x, z, v = vertical_in_body(y)
    a, b, c = body.vertices[i, 0], body.vertices[i, 1], body.vertices[i, 2]
    return b * v - c * z, c * x - a * v, a * z - b * x


@inner
def response(body: AsymmetricBody, y: Array, i: int, j: int) -> float:
    """Aᵢⱼ: vertical acceleration of vertex i by a unit vertical force on vertex j."""
    a, b, c = unit_torque(body, y, i)
    d, e, f = unit_torque(body, y, j)
    return 1.0 / body.mass + a * d / body.moments[0] + b * e / body.moments[1] + c * f / body.moments[2]


@inner
def clearance(body: AsymmetricBody, plane: Plane, y: Array, time: float, i: int) -> float:
    """Height of a vertex above the table."""
    x, z, v = vertical_in_body(y)
    swung = x * body.vertices[i, 0] + z * body.vertices[i, 1] + v * body.vertices[i, 2]
    return y[2] + swung - table_height(plane, time)


@inner
def vertex_velocity(body: AsymmetricBody, plane: Plane, y: Array, time: float, i: int) -> float:
    """Vertical velocity of a vertex relative to the table."""
    a, b, c = unit_torque(body, y, i)
    p, q, r = body_angular_velocity(body, y)
    return y[9] + a * p + b * q + c * r - table_velocity(plane, time)


@inner
def free_acceleration(body: AsymmetricBody, plane: Plane, y: Array, time: float, i: int) -> float:
    """b: vertical acceleration [m/s²] of a vertex relative to the table, without forces of the table."""
    x, z, v = vertical_in_body(y)
    p, q, r = body_angular_velocity(body, y)
    i1, i2, i3 = body.moments[0], body.moments[1], body.moments[2]
    a, b, c = body.vertices[i, 0], body.vertices[i, 1], body.vertices[i, 2]
    # (u × ω) × ω · r, and ω' · t by Euler's equations.
    along = x * p + z * q + v * r
    w2 = p * p + q * q + r * r
    centripetal = (p * a + q * b + r * c) * along - w2 * (x * a + z * b + v * c)
    d, e, f = unit_torque(body, y, i)
    euler = d * (i2 - i3) / i1 * q * r + e * (i3 - i1) / i2 * r * p + f * (i1 - i2) / i3 * p * q
    return centripetal + euler - plane.g - table_acceleration(plane, time)


@inner
def contact_forces(body: AsymmetricBody, plane: Plane, y: Array, time: float, i: int, j: int) -> tuple[float, float]:
    """The vertical forces [N] that keep vertices i and j (-1: i alone) on the table."""
    if i < 0:
        return 0.0, 0.0
    b = free_acceleration(body, plane, y, time, i)
    aii = response(body, y, i, i)
    if j < 0:
        return -b / aii, 0.0
    c = free_acceleration(body, plane, y, time, j)
    aij, ajj = response(body, y, i, j), response(body, y, j, j)
    det = aii * ajj - aij * aij
    return (aij * c - ajj * b) / det, (aij * b - aii * c) / det


@inner
def _state_rates(body: AsymmetricBody, plane: Plane, y: Array, time: float, i: int, j: int, out: Array) -> None:
    """Fill `out` (8,) with q' and, in held contact, z', v_z', L_x', L_y'."""
    attitude_rates(body, y, out)
    if i < 0:
        return
    n, o = contact_forces(body, plane, y, time, i, j)
    out[4] = y[9]
    out[5] = -plane.g + (n + o) / body.mass
    d, e, f = unit_torque(body, y, i)
    out[6], out[7], _ = to_table_axes(y, n * d, n * e, n * f)
    if j >= 0:
        d, e, f = unit_torque(body, y, j)
        dx, dy, _ = to_table_axes(y, o * d, o * e, o * f)
        out[6] += dx
        out[7] += dy


@inner
def _write_values(y: Array, values: Array) -> None:
    """Write the integrated components (8,) into a state."""
    y[3:7] = values[:4]
    y[2], y[9], y[10], y[11] = values[4], values[5], values[6], values[7]


@inner
def state_after_step(contact: Contact, y: Array, time: float, dt: float, stages: Array, out: Array) -> None:
    """The state `dt` [s] after `y`, in flight or in contact, into `out`: one step of the method, whatever `dt`.

    `stages` (14, 8) is room to work in.
    """
    body, plane, i, j = contact
    out[:] = y
    out[0] = y[0] + (y[7] + 0.5 * plane.gx * dt) * dt
    out[1] = y[1] + (y[8] + 0.5 * plane.gy * dt) * dt
    out[7] = y[7] + plane.gx * dt
    out[8] = y[8] + plane.gy * dt
    if j == -2:
        _turn_on_face(body, plane, y, time, dt, out)
        return
    size = 4 if i < 0 else 8
    start, values = stages[START], stages[VALUES]
    start[:4] = y[3:7]
    start[4], start[5], start[6], start[7] = y[2], y[9], y[10], y[11]
    values[:] = start
    for stage in range(STAGES + 1):
        stage_values(stages, stage, dt, size)
        _write_values(out, values)
        if stage < STAGES:
            _state_rates(body, plane, out, time + NODES[stage] * dt, i, j, stages[stage])
    values[:4] /= sqrt(values[0] * values[0] + values[1] * values[1] + values[2] * values[2] + values[3] * values[3])
    _write_values(out, values)
    if i < 0:
        out[2] = y[2] + (y[9] - 0.5 * plane.g * dt) * dt
        out[9] = y[9] - plane.g * dt


@inner
def _turn_on_face(body: AsymmetricBody, plane: Plane, y: Array, time: float, dt: float, out: Array) -> None:
    """A die that lies on a face turns about the vertical and moves up and down with the table."""
    p, q, r = body_angular_velocity(body, y)
    x, z, v = vertical_in_body(y)
    half = 0.5 * dt * (p * x + q * z + r * v)
    c, s = cos(half), sin(half)
    w, a, b, d = y[3], y[4], y[5], y[6]
    # A turn about the vertical of the table multiplies from the left, and turns L with it.
    out[3], out[4], out[5], out[6] = c * w - s * d, c * a - s * b, c * b + s * a, c * d + s * w
    c, s = cos(2.0 * half), sin(2.0 * half)
    out[10], out[11] = c * y[10] - s * y[11], s * y[10] + c * y[11]
    out[2] = y[2] + table_height(plane, time + dt) - table_height(plane, time)
    out[9] = table_velocity(plane, time + dt)
