"""Derivatives of the motion: along a flight, and the jump across an impact (the saltation matrix).

A disturbance is a column (12,): of position δp, rotation vector δ in table axes, velocity δv, and angular velocity δω; of an
asymmetric body, of angular momentum δL in place of δω. Over a flight of t

    δp → δp + t δv,    δ → exp(ωt) δ + t J(ωt) δω,    J the left Jacobian of exp (Barfoot, State Estimation for Robotics,
                                                      2017, Eq. 7.77).

**Impact.** The disturbed vertex touches later, at h = 0, by

    δt = -(δp_z + (δ × r)_z + (R δb)_z - δs)/u,

u the normal velocity, r = R b the arm, δb and δs what a parameter changes of the vertex and of the table's height. The column is
carried to that instant with the motion before, through the derivative of the impulse S(r, c, ...), c the contact velocity,

    δS = ∂S/∂r δr + ∂S/∂c δc + ...,    δv → δv + δS/m,    δL → δL + δr × S + r × δS,

and back with the motion after (Aizerman & Gantmacher, Q. J. Mech. Appl. Math. 11, 225, 1958; Müller, Chaos Solitons Fractals
5, 1671, 1995). One kernel, `saltation`, does this for every law, for both kinds of body, and with or without parameters. Its
derivative has no bound as u → 0.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ...compiled import inner
from ..flight import lever_arm, spin_axis
from ..inertia import EvenInertia, angular_velocity_of
from ..types import Array, AsymmetricBody, Body, Law, Plane, Setup, has_friction
from .impulse_gradient import (
    ARM,
    ATTITUDE,
    CHI,
    INPUTS,
    MATRIX_CHANGES,
    VELOCITY,
    ParameterDerivatives,
    impulse_gradient,
    wanted_columns,
)

RAISED, LIFTED, ROUNDER, BY_CHI, BY_MU, BY_INERTIA, BY_SPEED_SCALE, SHIFTS = 3, 4, 5, 6, 7, 8, 9, 10
"""What a parameter changes at an impact: the vertex (3) in table axes, height and velocity of the table, corner radius, and χ,
μ, inertia and speed scale in the order of the gradient's columns."""


# --- Flight ---


@inner
def flight_tangent(tangent: Array, columns: int, state: Array, spin: float, dt: float, moved: Array) -> None:
    """Carry disturbances (12, columns) of a state along `dt` [s] of its flight into `moved`."""
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


# --- Impact ---


class ImpactKinematics(NamedTuple):
    """Motion of table and die around the instant of an impact, besides the state: velocities [m/s], accelerations [m/s²]."""

    table_velocity: float
    table_acceleration: float
    before_x: float
    before_y: float
    before_z: float
    """Acceleration of the centre before the impact; more than -g where other vertices are held."""
    turn_x: float
    turn_y: float
    """[rad/s²] by which held vertices change ω_x and ω_y before the impact."""
    change_x: float
    change_y: float
    change_z: float
    """Acceleration of the centre before the impact less that after it."""


class Impact(NamedTuple):
    """The undisturbed impact, in table axes."""

    x: float
    y: float
    z: float
    """Arm [m] of the touching point."""
    level: float
    """[m] vertical arm of the vertex itself, which lies the corner radius above the touching point."""
    normal_velocity: float
    """[m/s] relative to the table, below 0."""
    sx: float
    sy: float
    sz: float
    """Impulse [N s]."""
    wx: float
    wy: float
    wz: float
    """ω before [rad/s]."""
    kx: float
    ky: float
    kz: float
    """Change of ω [rad/s]."""
    mass: float
    inertia: float
    """[kg m²] by which a change of angular momentum is divided: 1 where the column has δL."""
    stiffening: float
    """1 where a change of inertia changes the column of the angular velocity, 0 where it has δL."""


class ImpactDerivatives(NamedTuple):
    """Derivatives of the impulse, of what parameters change, and the bound of those of the instant."""

    gradient: Array
    """(3, INPUTS or ASYMMETRIC_INPUTS) of the impulse; only the last row is used unless `rough`."""
    changes: Array
    """(4 or 7, 6) of the contact matrix; see `inertia.matrix_changes`."""
    wanted: tuple[bool, bool]
    """Columns that are used; see `wanted_columns`."""
    rough: bool
    """Whether the law has friction."""
    shifts: Array
    """(m, SHIFTS) what the parameters in the columns from 12 on change."""
    reach: float
    """See `touch_delay`."""


@inner
def impact_derivatives(law: Law, inputs: int, chi: bool, mu: bool, shifts: Array, reach: float) -> ImpactDerivatives:
    """Room for the derivatives of impacts, which have so many `inputs`; `chi` and `mu` as in `wanted_columns`."""
    gradient, changes = np.empty((3, inputs)), np.empty((inputs - INPUTS + MATRIX_CHANGES, 6))
    return ImpactDerivatives(gradient, changes, wanted_columns(law, chi, mu), has_friction(law), shifts, reach)


@inner
def touch_delay(
    tangent: Array, j: int, x: float, y: float, normal_velocity: float, reach: float, shift: float
) -> float:
    """How much later [s] the vertex at the arm (x, y) touches for the disturbance in column j: its height stays zero there.

    `shift` [m] is what a parameter adds to its height. The delay is no longer than √(reach × height) either way: with reach
    2/a that is how long a vertex at rest would fall for that height, and the derivative is of no use beyond. For
    derivatives proper `reach` is infinite.
    """
    lift = tangent[2, j] + tangent[3, j] * y - tangent[4, j] * x + shift
    late = -lift / normal_velocity
    if reach < inf:
        longest = sqrt(reach * abs(lift))
        late = min(max(late, -longest), longest)
    return late


def spin_disturbance(
    body: Body | AsymmetricBody,
    state: Array,
    impact: Impact,
    rotation: tuple[float, float, float],
    momentum: tuple[float, float, float],
    stiffer: float,
) -> tuple[float, float, float]:
    """δω at the disturbed instant, from the rows 9 to 11 of a column there, and the rotation vector δ there."""
    if isinstance(body, AsymmetricBody):
        return asymmetric_spin_disturbance(body, state, impact, rotation, momentum, stiffer)
    return momentum


@inner
def asymmetric_spin_disturbance(
    body: AsymmetricBody,
    state: Array,
    impact: Impact,
    rotation: tuple[float, float, float],
    momentum: tuple[float, float, float],
    stiffer: float,
) -> tuple[float, float, float]:
    """δω = δ × ω + W (δL - δ × L - δI ω)."""
    dx, dy, dz = rotation
    lx, ly, lz = state[10], state[11], state[12]
    kx = momentum[0] - (dy * lz - dz * ly) - stiffer * impact.wx
    ky = momentum[1] - (dz * lx - dx * lz) - stiffer * impact.wy
    kz = momentum[2] - (dx * ly - dy * lx) - stiffer * impact.wz
    ox, oy, oz = angular_velocity_of(body, state, kx, ky, kz)
    return (
        ox + dy * impact.wz - dz * impact.wy,
        oy + dz * impact.wx - dx * impact.wz,
        oz + dx * impact.wy - dy * impact.wx,
    )


@overload(spin_disturbance, strict=False)
def _spin_disturbance_of(body: Any, state: Any, impact: Any, rotation: Any, momentum: Any, stiffer: Any) -> Any:
    """The branch that the type of the body asks for, chosen when it is compiled."""
    if body.instance_class is AsymmetricBody:
        return asymmetric_spin_disturbance.py_func
    return lambda body, state, impact, rotation, momentum, stiffer: momentum


@inner
def saltation(
    body: Body | AsymmetricBody,
    state: Array,
    impact: Impact,
    kinematics: ImpactKinematics,
    derivatives: ImpactDerivatives,
    tangent: Array,
    columns: int,
    dtime: Array,
) -> None:
    """Carry disturbances (12, columns) at the instant of an impact through it, in place.

    `state` is the state before. `dtime` (columns,) receives the derivative of the instant.
    """
    gradient, shifts, rough, reach = derivatives.gradient, derivatives.shifts, derivatives.rough, derivatives.reach
    x, y, z, level = impact.x, impact.y, impact.z, impact.level
    wx, wy, wz = impact.wx, impact.wy, impact.wz
    sx, sy, sz = impact.sx, impact.sy, impact.sz
    mass, inertia = impact.mass, impact.inertia
    for j in range(columns):
        p = j - 12
        ex, ey, ez, raised, lifted, rounder, stiffer = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        parameter = 0 <= p < shifts.shape[0]
        if parameter:
            ex, ey, ez = shifts[p, 0], shifts[p, 1], shifts[p, 2]
            raised, lifted, rounder = shifts[p, RAISED], shifts[p, LIFTED], shifts[p, ROUNDER]
            stiffer = shifts[p, BY_INERTIA]
        late = touch_delay(tangent, j, x, y, impact.normal_velocity, reach, ez - raised)
        dtime[j] = late
        # To the instant of the disturbed touch: the arm, then the contact velocity ...
        rx, ry, rz = tangent[3, j] + wx * late, tangent[4, j] + wy * late, tangent[5, j] + wz * late
        dx, dy = ry * level - rz * y + ex, rz * x - rx * level + ey
        dz = rx * y - ry * x + ez - rounder
        mx, my = tangent[9, j] + kinematics.turn_x * late, tangent[10, j] + kinematics.turn_y * late
        mz = tangent[11, j]
        vx, vy, vz = spin_disturbance(body, state, impact, (rx, ry, rz), (mx, my, mz), stiffer)
        cz = tangent[8, j] + kinematics.before_z * late + vx * y - vy * x + wx * dy - wy * dx - lifted
        cz -= kinematics.table_acceleration * late
        cx, cy, dsx, dsy = 0.0, 0.0, 0.0, 0.0
        if rough:
            cx = tangent[6, j] + kinematics.before_x * late + vy * z - vz * y + wy * dz - wz * dy
            cy = tangent[7, j] + kinematics.before_y * late + vz * x - vx * z + wz * dx - wx * dz
            dsx = _impulse_change(gradient, 0, dx, dy, dz, cx, cy, cz)
            dsy = _impulse_change(gradient, 1, dx, dy, dz, cx, cy, cz)
        dsz = _impulse_change(gradient, 2, dx, dy, dz, cx, cy, cz)
        if parameter:
            for k in range(CHI, INPUTS):
                shift = shifts[p, BY_CHI + k - CHI]
                dsx += gradient[0, k] * shift
                dsy += gradient[1, k] * shift
                dsz += gradient[2, k] * shift
        if gradient.shape[1] > INPUTS:
            dsx += _along(gradient, 0, ATTITUDE, rx, ry, rz)
            dsy += _along(gradient, 1, ATTITUDE, rx, ry, rz)
            dsz += _along(gradient, 2, ATTITUDE, rx, ry, rz)
        # ... and back: between the two instants the die moved with the velocities before, not those after.
        tangent[0, j] -= sx / mass * late
        tangent[1, j] -= sy / mass * late
        tangent[2, j] -= sz / mass * late
        tangent[3, j] -= impact.kx * late
        tangent[4, j] -= impact.ky * late
        tangent[5, j] -= impact.kz * late
        tangent[6, j] += dsx / mass + kinematics.change_x * late
        tangent[7, j] += dsy / mass + kinematics.change_y * late
        tangent[8, j] += dsz / mass + kinematics.change_z * late
        stiffer *= impact.stiffening
        tangent[9, j] = mx + (y * dsz - z * dsy + dy * sz - dz * sy - stiffer * impact.kx) / inertia
        tangent[10, j] = my + (z * dsx - x * dsz + dz * sx - dx * sz - stiffer * impact.ky) / inertia
        tangent[11, j] = mz + (x * dsy - y * dsx + dx * sy - dy * sx - stiffer * impact.kz) / inertia


@inner
def _along(gradient: Array, row: int, column: int, x: float, y: float, z: float) -> float:
    """Change of one component of the impulse by a vector, whose three columns begin with `column`."""
    return float(gradient[row, column] * x + gradient[row, column + 1] * y + gradient[row, column + 2] * z)


@inner
def _impulse_change(
    gradient: Array, row: int, dx: float, dy: float, dz: float, cx: float, cy: float, cz: float
) -> float:
    """Change of one component of the impulse by changes of the arm and of the contact velocity."""
    return float(_along(gradient, row, ARM, dx, dy, dz) + _along(gradient, row, VELOCITY, cx, cy, cz))


@inner
def impact_tangent(
    setup: Setup,
    vertex: int,
    state: Array,
    kinematics: ImpactKinematics,
    derivatives: ImpactDerivatives,
    tangent: Array,
    columns: int,
    dtime: Array,
) -> None:
    """`saltation` of a die with one moment of inertia at the impact of a vertex; fills the gradient of `derivatives`."""
    body = setup.body
    x, y, level = lever_arm(body.vertices[vertex], state)
    z = level - body.corner_radius
    wx, wy, wz = state[10], state[11], state[12]
    c = (
        state[7] + wy * z - wz * y,
        state[8] + wz * x - wx * z,
        state[9] + wx * y - wy * x - kinematics.table_velocity,
    )
    inertia = body.inertia
    sx, sy, sz = impulse_gradient(
        setup.law, EvenInertia(body.mass, inertia), (x, y, z), c, derivatives.wanted, derivatives.changes,
        derivatives.gradient,
    )  # fmt: skip
    kx, ky, kz = (y * sz - z * sy) / inertia, (z * sx - x * sz) / inertia, (x * sy - y * sx) / inertia
    impact = Impact(x, y, z, level, c[2], sx, sy, sz, wx, wy, wz, kx, ky, kz, body.mass, inertia, 1.0)
    saltation(body, state, impact, kinematics, derivatives, tangent, columns, dtime)


@inner
def shifts_at_impact(
    sources: ParameterDerivatives, plane: Plane, time: float, vertex: int, state: Array, shifts: Array
) -> None:
    """Fill `shifts` (m, SHIFTS) with what the parameters change at the impact of a vertex at `time` [s]."""
    phase = plane.rate * time + plane.phase
    s, c = sin(phase), cos(phase)
    for p in range(shifts.shape[0]):
        shifts[p, 0], shifts[p, 1], shifts[p, 2] = lever_arm(sources.vertices[p, vertex], state)
        by_amplitude, by_rate, by_phase = sources.table[p, 0], sources.table[p, 1], sources.table[p, 2]
        turned = by_rate * time + by_phase
        shifts[p, RAISED] = by_amplitude * s + plane.amplitude * c * turned
        velocity = plane.rate * (by_amplitude * c - plane.amplitude * s * turned)
        shifts[p, LIFTED] = velocity + plane.amplitude * c * by_rate
        shifts[p, ROUNDER], shifts[p, BY_CHI], shifts[p, BY_MU] = (
            sources.corner_radius[p],
            sources.chi[p],
            sources.mu[p],
        )
        shifts[p, BY_INERTIA], shifts[p, BY_SPEED_SCALE] = sources.inertia[p], sources.speed_scale[p]
