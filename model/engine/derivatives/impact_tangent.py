"""model.engine.derivatives.impact_tangent."""

from __future__ import annotations

from math import cos, inf, sin, sqrt
from typing import NamedTuple

import numpy as np

from ...compiled import inner
from ..air import braking
from ..flight import lever_arm, spin_axis, table_acceleration, table_velocity
from ..impact import CHI, INERTIA, INPUTS, MU, SPEED_SCALE, ParameterDerivatives, impulse_gradient
from ..types import Array, Body, Law, Plane


@inner
def flight_tangent(tangent: Array, columns: int, state: Array, spin: float, dt: float, moved: Array) -> None:
    """Carry derivatives (12, columns) of a state along `dt` [s] of its flight into `moved`; see `tangent`."""
    ux, uy, uz = spin_axis(state, spin)
    angle = spin * dt
    c, s = cos(angle), sin(angle)
    half = sin(0.5 * angle)
    # sin θ/θ and (1 - cos θ)/θ keep their digits for every θ but zero itself: no series is needed.
    mean_c = s / angle if angle != 0.0 else 1.0
    mean_s = 2.0 * half * half / angle if angle != 0.0 else 0.0
    for j in range(columns):
        for k in range(3):
            moved[k, j] = tangent[k, j] + dt * tangent[6 + k, j]
            moved[6 + k, j] = tangent[6 + k, j]
            moved[9 + k, j] = tangent[9 + k, j]
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        wx, wy, wz = dt * tangent[9, j], dt * tangent[10, j], dt * tangent[11, j]
        along_r = (1.0 - c) * (ux * rx + uy * ry + uz * rz)
        along_w = (1.0 - mean_c) * (ux * wx + uy * wy + uz * wz)
        along = along_r + along_w
        # exp(ωt) δ by Rodrigues' formula, and the left Jacobian of exp applied to t δω.
        px, py, pz = s * rx + mean_s * wx, s * ry + mean_s * wy, s * rz + mean_s * wz
        moved[3, j] = c * rx + mean_c * wx + along * ux + uy * pz - uz * py
        moved[4, j] = c * ry + mean_c * wy + along * uy + uz * px - ux * pz
        moved[5, j] = c * rz + mean_c * wz + along * uz + ux * py - uy * px


class ImpactKinematics(NamedTuple):
    """Motion around the instant of an impact, besides the state's own: vertical speeds [m/s], accelerations [m/s²]."""

    table_velocity: float
    table_acceleration: float
    rise: float
    """Acceleration of the centre before the impact; more than -g where other vertices are held."""
    turn_x: float
    """[rad/s²] what the held vertices do to ω_x before the impact."""
    turn_y: float
    fall: float
    """Acceleration of the centre after the impact."""


@inner
def touch_delay(tangent: Array, j: int, arm: tuple[float, float, float], normal_velocity: float, reach: float) -> float:
    """How much later [s] the vertex at `arm` touches for the disturbance in column j: its height stays zero there.

    No later or earlier than √(reach × height): with reach 2/a that is how long a vertex at rest would fall for that
    height, and the derivative is no use beyond. For derivatives proper `reach` is infinite.
    """
    lift = tangent[2, j] + tangent[3, j] * arm[1] - tangent[4, j] * arm[0]
    late = -lift / normal_velocity
    if reach < inf:
        longest = sqrt(reach * abs(lift))
        late = min(max(late, -longest), longest)
    return late


@inner
def bounce_tangent(
    tangent: Array,
    columns: int,
    chi: float,
    mass: float,
    inertia: float,
    arm: tuple[float, float, float],
    state: Array,
    kinematics: ImpactKinematics,
    reach: float,
    dtime: Array,
) -> None:
    """Carry disturbances (12, columns) at the instant of a smooth impact through it, in place.

    `state` is the state before. `dtime` (columns,) receives the derivative of the instant of the impact; for `reach`
    see `touch_delay`.
    """
    x, y, z = arm
    vz, wx, wy, wz = state[9], state[10], state[11], state[12]
    normal_velocity = vz + wx * y - wy * x - kinematics.table_velocity
    softness = 1.0 / mass + (x * x + y * y) / inertia
    s = -(1.0 + chi) * normal_velocity / softness
    closing = kinematics.rise - kinematics.table_acceleration
    for j in range(columns):
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        dt = touch_delay(tangent, j, arm, normal_velocity, reach)
        dtime[j] = dt
        # To the instant of the disturbed touch ...
        rx, ry, rz = rx + wx * dt, ry + wy * dt, rz + wz * dt
        dx, dy = ry * z - rz * y, rz * x - rx * z
        dwx, dwy = tangent[9, j] + kinematics.turn_x * dt, tangent[10, j] + kinematics.turn_y * dt
        dv = tangent[8, j] + closing * dt + dwx * y + wx * dy - dwy * x - wy * dx
        dsoftness = 2.0 * (x * dx + y * dy) / inertia
        ds = -(1.0 + chi) * dv / softness - s * dsoftness / softness
        dsx, dsy = (y * ds + dy * s) / inertia, -(x * ds + dx * s) / inertia
        # ... and back: between the two instants the die moved with the velocities before, not those after.
        tangent[2, j] -= s / mass * dt
        tangent[3, j] -= y * s / inertia * dt
        tangent[4, j] += x * s / inertia * dt
        tangent[8, j] += ds / mass + (kinematics.rise - kinematics.fall) * dt
        tangent[9, j] = dwx + dsx
        tangent[10, j] = dwy + dsy


@inner
def table_derivatives(plane: Plane, time: float, source: Array) -> tuple[float, float]:
    """Derivatives of the table's height and velocity at a fixed time; `source` (3,) those of amplitude, rate, phase."""
    phase = plane.rate * time + plane.phase
    s, c = sin(phase), cos(phase)
    turned = source[1] * time + source[2]
    height = source[0] * s + plane.amplitude * c * turned
    velocity = plane.rate * (source[0] * c - plane.amplitude * s * turned) + plane.amplitude * c * source[1]
    return height, velocity


@inner
def impact_tangent(
    body: Body,
    law: Law,
    plane: Plane,
    time: float,
    vertex: int,
    state: Array,
    drag: float,
    sources: ParameterDerivatives,
    wanted: Array,
    tangent: Array,
    gradient: Array,
    dtime: Array,
) -> None:
    """Carry derivatives (12, 12 + m) at the instant of an impact through it, in place; see `tangent`.

    `state` is the state before, `drag` [1/m] that of the air. `dtime` (12 + m,) receives the derivative of the instant
    of the impact, `gradient` (3, INPUTS) is room.
    """
    x, y, level = lever_arm(body.vertices[vertex], state)
    z = level - body.rounding
    wx, wy, wz = state[10], state[11], state[12]
    mass, inertia = body.mass, body.inertia
    c = np.empty(3)
    c[0] = state[7] + wy * z - wz * y
    c[1] = state[8] + wz * x - wx * z
    c[2] = state[9] + wx * y - wy * x - table_velocity(plane, time)
    lift_rate = table_acceleration(plane, time)
    sx, sy, sz = impulse_gradient(law, mass, inertia, (x, y, z), c, wanted, gradient)
    kx, ky, kz = (y * sz - z * sy) / inertia, (z * sx - x * sz) / inertia, (x * sy - y * sx) / inertia
    bx, by, bz = braking(drag, state[7], state[8], state[9])
    fx, fy, fz = braking(drag, state[7] + sx / mass, state[8] + sy / mass, state[9] + sz / mass)
    given = np.zeros(INPUTS)
    for j in range(tangent.shape[1]):
        rx, ry, rz = tangent[3, j], tangent[4, j], tangent[5, j]
        ex, ey, ez, raised, lifted, stiffer, rounder = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if j >= 12:
            p = j - 12
            ex, ey, ez = lever_arm(sources.vertices[p, vertex], state)
            raised, lifted = table_derivatives(plane, time, sources.table[p])
            stiffer, rounder = sources.inertia[p], sources.rounding[p]
            given[CHI], given[MU], given[INERTIA] = sources.chi[p], sources.mu[p], stiffer
            given[SPEED_SCALE] = sources.speed_scale[p]
        late = -(tangent[2, j] + rx * y - ry * x + ez - raised) / c[2]
        dtime[j] = late
        # To the instant of the disturbed touch: the arm, then what the contact moves at ...
        rx, ry, rz = rx + wx * late, ry + wy * late, rz + wz * late
        dx, dy = ry * level - rz * y + ex, rz * x - rx * level + ey
        dz = rx * y - ry * x + ez - rounder
        vx, vy, vz = tangent[9, j], tangent[10, j], tangent[11, j]
        given[0], given[1], given[2] = dx, dy, dz
        given[3] = tangent[6, j] + (plane.gx + bx) * late + vy * z - vz * y + wy * dz - wz * dy
        given[4] = tangent[7, j] + (plane.gy + by) * late + vz * x - vx * z + wz * dx - wx * dz
        given[5] = (
            tangent[8, j] - (plane.g - bz) * late + vx * y - vy * x + wx * dy - wy * dx - lifted - lift_rate * late
        )
        dsx, dsy, dsz = 0.0, 0.0, 0.0
        for k in range(INPUTS):
            dsx += gradient[0, k] * given[k]
            dsy += gradient[1, k] * given[k]
            dsz += gradient[2, k] * given[k]
        # ... and back: between the two instants the die moved with the velocities before, not those after.
        for k in range(3):
            tangent[3 + k, j] -= (kx, ky, kz)[k] * late
            tangent[k, j] -= (sx, sy, sz)[k] / mass * late
        tangent[6, j] += dsx / mass + (bx - fx) * late
        tangent[7, j] += dsy / mass + (by - fy) * late
        tangent[8, j] += dsz / mass + (bz - fz) * late
        tangent[9, j] += (y * dsz - z * dsy + dy * sz - dz * sy - stiffer * kx) / inertia
        tangent[10, j] += (z * dsx - x * dsz + dz * sx - dx * sz - stiffer * ky) / inertia
        tangent[11, j] += (x * dsy - y * dsx + dx * sy - dy * sx - stiffer * kz) / inertia
