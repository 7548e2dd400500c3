"""The impulse of an impact on a die with one moment of inertia, and its derivatives.

Smooth: S_z = -(1 + χ) u/(1/m + (x² + y²)/J) for an arm (x, y, z) and a normal velocity u relative to the table. With friction
the impulse is that of `friction_impulse`. In laws by speed χ, and μ, fade with |u|. The velocities change by Δv = S/m, Δω =
(r × S)/J. At the end stand impacts of several vertices at once, without friction (`throw.touch`).
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ..compiled import compiled, inner
from .flight import lever_arm, table_height, table_velocity
from .friction_impulse import coefficient_at_speed, friction_impulse
from .inertia import spherical_contact_matrix
from .types import (
    COULOMB,
    COULOMB_BY_SPEED,
    COULOMB_FADING,
    SMOOTH_BY_SPEED,
    Array,
    Body,
    Indices,
    Law,
    Plane,
    RoughLaw,
    Vector,
)

MAX_NORMAL_SWEEPS = 1000
"""Of the Gauss-Seidel method for normal forces."""

NORMAL_SWEEP_TOLERANCE = 1e-15
"""Change of a force in one sweep, as a part of the largest, at which the sweeps end: rounding."""


@inner
def restitution_at(law: Law, u: float) -> float:
    """χ of a law without friction at a normal velocity u [m/s]."""
    if law.code == SMOOTH_BY_SPEED:
        return coefficient_at_speed(law.parameters[0], max(-u, 0.0), law.parameters[1], law.parameters[2])
    return law.parameters[0]


@compiled
def smooth_impulse(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> tuple[float, float, float]:
    """`impulse` of a law without friction."""
    x, y, _ = arm
    u = state[9] + state[10] * y - state[11] * x - v_table
    return 0.0, 0.0, -(1.0 + restitution_at(law, u)) * u / (1.0 / mass + (x * x + y * y) / inertia)


@compiled
def rough_impulse(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> tuple[float, float, float]:
    """`impulse` of a law with friction."""
    x, y, z = arm
    u = state[9] + state[10] * y - state[11] * x - v_table
    chi = law.parameters[0]
    mu = law.parameters[1]
    if law.code != COULOMB:
        chi = coefficient_at_speed(chi, max(-u, 0.0), law.parameters[3], law.parameters[4])
    if law.code == COULOMB_FADING:
        mu = coefficient_at_speed(mu, max(-u, 0.0), law.parameters[5], law.parameters[6])
    cx, cy = state[7] + state[11] * z - state[12] * y, state[8] + state[12] * x - state[10] * z
    matrix = spherical_contact_matrix(mass, inertia, x, y, z)
    return friction_impulse(matrix, chi, mu, int(law.parameters[2]), cx, cy, u)


def impulse(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> tuple[float, float, float]:
    """Impulse [N s] of the table on a touching point at `arm` [m] from the centre of mass; `v_table` [m/s] is vertical."""
    if isinstance(law, RoughLaw):
        return rough_impulse(law, mass, inertia, arm, v_table, state)
    return smooth_impulse(law, mass, inertia, arm, v_table, state)


@overload(impulse, strict=False)
def _impulse_of(law: Any, mass: Any, inertia: Any, arm: Any, v_table: Any, state: Any) -> Any:
    """The branch of `impulse` that the type of the law asks for, chosen when it is compiled."""
    chosen = rough_impulse if law.instance_class is RoughLaw else smooth_impulse
    return chosen.py_func


@inner
def apply_impact(
    law: Law, mass: float, inertia: float, arm: tuple[float, float, float], v_table: float, state: Array
) -> None:
    """Apply the law to the velocities of the state, in place: Δv = S/m, Δω = (r × S)/J."""
    sx, sy, sz = impulse(law, mass, inertia, arm, v_table, state)
    x, y, z = arm
    state[7] += sx / mass
    state[8] += sy / mass
    state[9] += sz / mass
    state[10] += (y * sz - z * sy) / inertia
    state[11] += (z * sx - x * sz) / inertia
    state[12] += (x * sy - y * sx) / inertia


class ParameterDerivatives(NamedTuple):
    """Derivatives of what the kernels are given, by each of the m parameters of a throw."""

    chi: Array
    """(m,) of the restitution, of the slowest impacts where it fades with speed."""
    mu: Array
    """(m,) of the coefficient of friction."""
    speed_scale: Array
    """(m,) [m/s] of the speed scale of χ."""
    inertia: Array
    """(m,) [kg m²]."""
    corner_radius: Array
    """(m,) [m]."""
    vertices: Array
    """(m, n, 3) [m] of the vertices, body axes."""
    gravity: Array
    """(m, 3) [m/s²], axes of the table."""
    table: Array
    """(m, 3) of amplitude, rate and phase of the table's motion."""


DIFFERENCE_STEP = 1e-5
"""Step of the differences through an impact with friction, in units of radius of gyration, contact velocity, or 1. Its
square, and rounding over it, are both 1e-10. A higher order would take twice the impacts, and longer steps, which more often
reach across where the course of the slip changes."""

ARM, VELOCITY, CHI, MU, INERTIA, SPEED_SCALE, INPUTS = 0, 3, 6, 7, 8, 9, 10
"""Columns of the gradient of an impulse: arm (3), contact velocity (3), and numbers of law and die."""


@inner
def coefficient_gradient(law: Law, at: int, u: float) -> tuple[float, float, float]:
    """χ/χ₀ (or μ/μ₀) of an impact with normal velocity u, and its derivatives by u and by the speed scale.

    Scale and exponent are the parameters `at` and `at` + 1 of the law.
    """
    scale, exponent = law.parameters[at], law.parameters[at + 1]
    ratio = coefficient_at_speed(1.0, max(-u, 0.0), scale, exponent)
    slope = exponent * ratio / (scale + max(-u, 0.0))
    return ratio, slope, -slope * u / scale


@compiled
def smooth_gradient(
    law: Law, mass: float, inertia: float, arm: Vector, c: Vector, wanted: tuple[bool, bool], out: Array
) -> tuple[float, float, float]:
    """`impulse_gradient` of a law without friction."""
    x, y, _ = arm
    u, chi = c[2], law.parameters[0]
    ratio, by_u, by_scale = 1.0, 0.0, 0.0
    if law.code == SMOOTH_BY_SPEED:
        ratio, by_u, by_scale = coefficient_gradient(law, 1, u)
    softness = 1.0 / mass + (x * x + y * y) / inertia
    s = -(1.0 + chi * ratio) * u / softness
    out[:] = 0.0
    out[2, ARM], out[2, ARM + 1] = -2.0 * s * x / (inertia * softness), -2.0 * s * y / (inertia * softness)
    out[2, VELOCITY + 2] = -(1.0 + chi * ratio + chi * by_u * u) / softness
    out[2, CHI] = -ratio * u / softness
    out[2, INERTIA] = s * (x * x + y * y) / (inertia * inertia * softness)
    out[2, SPEED_SCALE] = -chi * by_scale * u / softness
    return 0.0, 0.0, s


class RoughNow(NamedTuple):
    """A law with friction at one normal velocity u."""

    chi: float
    mu: float
    ratio: float
    """χ/χ₀."""
    by_u: float
    """Derivatives of that ratio by u, and by the speed scale."""
    by_scale: float
    mu_by_u: float


@inner
def rough_law_at(law: Law, u: float) -> RoughNow:
    """χ and μ at a normal velocity u [m/s], with their derivatives."""
    chi, mu, ratio, by_u, by_scale, mu_by_u = law.parameters[0], law.parameters[1], 1.0, 0.0, 0.0, 0.0
    if law.code != COULOMB:
        ratio, by_u, by_scale = coefficient_gradient(law, 3, u)
        chi *= ratio
    if law.code == COULOMB_FADING:
        mu_ratio, mu_by_u, _ = coefficient_gradient(law, 5, u)
        mu, mu_by_u = mu * mu_ratio, mu * mu_by_u
    return RoughNow(chi, mu, ratio, by_u, by_scale, mu_by_u)


@inner
def difference_weight(forward: bool, n: int, step: float) -> tuple[float, float]:
    """Weight and place of the n-th of three points of a difference of the second order, central or forward."""
    if forward:
        return (-1.5, 2.0, -0.5)[n] / step, n * step
    return (-0.5, 0.0, 0.5)[n] / step, (n - 1) * step


@inner
def complete_columns(law: Law, now: RoughNow, c: Vector, impulse_now: Vector, out: Array) -> None:
    """Fill the columns that follow from the others: of the normal velocity, since S is proportional to c, of the speed scale,
    and of χ₀ for χ."""
    for m in range(3):
        along = c[0] * out[m, VELOCITY] + c[1] * out[m, VELOCITY + 1]
        out[m, VELOCITY + 2] = (impulse_now[m] - along) / c[2] + out[m, CHI] * law.parameters[0] * now.by_u
        if law.code == COULOMB_FADING:
            out[m, VELOCITY + 2] += out[m, MU] * now.mu_by_u
        out[m, SPEED_SCALE] = out[m, CHI] * law.parameters[0] * now.by_scale
        out[m, CHI] *= now.ratio


@compiled
def rough_gradient(
    law: Law, mass: float, inertia: float, arm: Vector, c: Vector, wanted: tuple[bool, bool], out: Array
) -> tuple[float, float, float]:
    """`impulse_gradient` of a law with friction: differences of the second order of this one impact.

    Two rules spare a quarter of them: S is proportional to c, and does not change when r grows with √J.
    """
    now, ending = rough_law_at(law, c[2]), int(law.parameters[2])
    chi, mu = now.chi, now.mu
    gyration, speed = sqrt(inertia / mass), sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    matrix = spherical_contact_matrix(mass, inertia, arm[0], arm[1], arm[2])
    sx, sy, sz = friction_impulse(matrix, chi, mu, ending, c[0], c[1], c[2])
    out[:] = 0.0
    there, input_of = np.empty(8), (arm[0], arm[1], arm[2], c[0], c[1], c[2], chi, mu)
    for k in range(8):
        if k == VELOCITY + 2 or (k == CHI and not wanted[0]) or (k == MU and not wanted[1]):
            continue
        step = DIFFERENCE_STEP * (gyration if k < VELOCITY else (speed if k < CHI else 1.0))
        # Neither χ nor μ can be less than 0: forward from there.
        forward = k >= CHI and input_of[k] < step
        for n in range(3):
            weight, at = difference_weight(forward, n, step)
            if weight == 0.0:
                continue
            for i in range(8):
                there[i] = input_of[i]
            there[k] += at
            if k < VELOCITY:
                matrix = spherical_contact_matrix(mass, inertia, there[0], there[1], there[2])
            else:
                matrix = spherical_contact_matrix(mass, inertia, arm[0], arm[1], arm[2])
            px, py, pz = friction_impulse(matrix, there[6], there[7], ending, there[3], there[4], there[5])
            out[0, k] += weight * px
            out[1, k] += weight * py
            out[2, k] += weight * pz
    complete_columns(law, now, c, (sx, sy, sz), out)
    for m in range(3):
        stretched = arm[0] * out[m, ARM] + arm[1] * out[m, ARM + 1] + arm[2] * out[m, ARM + 2]
        out[m, INERTIA] = -0.5 * stretched / inertia
    return sx, sy, sz


def impulse_gradient(
    law: Law, mass: float, inertia: float, arm: Vector, c: Vector, wanted: tuple[bool, bool], out: Array
) -> tuple[float, float, float]:
    """`impulse` on a contact with velocity `c` relative to the table, and its derivatives in `out` (3, INPUTS).

    The derivatives are by the arm (3), the contact velocity (3), χ₀, μ, inertia and speed scale. `wanted` says
    whether the columns of χ and of μ are used; see `wanted_columns`.
    """
    if isinstance(law, RoughLaw):
        return rough_gradient(law, mass, inertia, arm, c, wanted, out)
    return smooth_gradient(law, mass, inertia, arm, c, wanted, out)


@overload(impulse_gradient, strict=False)
def _impulse_gradient_of(law: Any, mass: Any, inertia: Any, arm: Any, c: Any, wanted: Any, out: Any) -> Any:
    """The branch of `impulse_gradient` that the type of the law asks for, chosen when it is compiled."""
    chosen = rough_gradient if law.instance_class is RoughLaw else smooth_gradient
    return chosen.py_func


@inner
def wanted_columns(law: Law, chi: bool, mu: bool) -> tuple[bool, bool]:
    """`wanted` of `impulse_gradient`: whether parameters change χ or μ, or the law makes them change with speed."""
    by_speed = law.code == SMOOTH_BY_SPEED or law.code == COULOMB_BY_SPEED or law.code == COULOMB_FADING
    return by_speed or chi, law.code == COULOMB_FADING or mu


# --- Several vertices at once ---


@inner
def touching_set(
    body: Body, plane: Plane, state: Array, time: float, near: float, slow: float, also: int, touching: Indices
) -> int:
    """Fill `touching` with the vertices no higher than `near` [m] that do not rise faster than `slow` [m/s], and with `also`.

    Returns their number.
    """
    z_table, v_table = table_height(plane, time), table_velocity(plane, time)
    n = 0
    for i in range(body.vertices.shape[0]):
        arm = lever_arm(body.vertices[i], state)
        leaving = state[9] + state[10] * arm[1] - state[11] * arm[0] - v_table
        if i == also or (state[2] + arm[2] - z_table <= near and leaving <= slow):
            touching[n] = i
            n += 1
    return n


@inner
def without_held(touching: Indices, n: int, active: NDArray[np.bool_], also: int) -> int:
    """Leave of `touching` those that were not held, and `also`; returns their number."""
    left = 0
    for m in range(n):
        if touching[m] == also or not active[touching[m]]:
            touching[left] = touching[m]
            left += 1
    return left


@inner
def solve_normal_forces(
    body: Body, state: Array, touching: Indices, n: int, motion: Array, drive: Array, forces: Array
) -> None:
    """Solve 0 ≤ forces ⊥ (drive + effect of the forces) ≥ 0 over the touching vertices by projected Gauss-Seidel.

    `motion` (3,) is the centre's vertical motion and ω_x, ω_y, velocities or accelerations; the effect of the forces (n,)
    is added to it. `drive` (n,) is the motion that each vertex has besides.
    """
    k = body.inertia / body.mass
    for m in range(n):
        forces[m] = 0.0
    for _ in range(MAX_NORMAL_SWEEPS):
        largest, change = 0.0, 0.0
        for m in range(n):
            x, y, _ = lever_arm(body.vertices[touching[m]], state)
            rising = motion[0] + motion[1] * y - motion[2] * x + drive[m]
            new = max(0.0, forces[m] - rising / (1.0 + (x * x + y * y) / k))
            step = new - forces[m]
            forces[m] = new
            motion[0] += step
            motion[1] += step * y / k
            motion[2] -= step * x / k
            largest, change = max(largest, new), max(change, abs(step))
        if change <= NORMAL_SWEEP_TOLERANCE * largest:
            break


@inner
def simultaneous_inelastic_impact(
    body: Body, plane: Plane, state: Array, time: float, touching: Indices, n: int, room: Array
) -> None:
    """Stop the slow approach of the touching vertices, in place, as an impact with χ = 0 of all of them at once."""
    motion, drive, forces = room[0], room[1], room[2]
    motion[0], motion[1], motion[2] = state[9] - table_velocity(plane, time), state[10], state[11]
    for m in range(n):
        drive[m] = 0.0
    solve_normal_forces(body, state, touching, n, motion, drive, forces)
    state[9], state[10], state[11] = motion[0] + table_velocity(plane, time), motion[1], motion[2]


@inner
def simultaneous_impact(
    body: Body, plane: Plane, state: Array, time: float, chi: float, touching: Indices, n: int, room: Array
) -> None:
    """Apply the smooth impact of all touching vertices at once, in place; see `throw.touch`."""
    v, p, q = state[9], state[10], state[11]
    simultaneous_inelastic_impact(body, plane, state, time, touching, n, room)
    state[9] += chi * (state[9] - v)
    state[10] += chi * (state[10] - p)
    state[11] += chi * (state[11] - q)
