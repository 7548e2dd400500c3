"""The impulse of an impact of one vertex, by every law: a function of the contact matrix M and of the contact velocity c.

Smooth: S_z = -(1 + χ) c_z/M_zz; for an arm (x, y, z) of a die with one moment of inertia J, M_zz = 1/m + (x² + y²)/J. With
friction the impulse is that of `friction_impulse`. In laws by speed χ, and μ, fade with |c_z|. Its derivatives are in
`derivatives.impulse_gradient`. At the end stand impacts of several vertices at once, without friction (`throw.touch`).
"""

from __future__ import annotations

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
    COULOMB_FADING,
    SMOOTH_BY_SPEED,
    Array,
    Body,
    Indices,
    Law,
    Matrix6,
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


@inner
def coefficient_gradient(law: Law, at: int, u: float) -> tuple[float, float, float]:
    """χ/χ₀ (or μ/μ₀) of an impact with normal velocity u, and its derivatives by u and by the speed scale.

    Scale and exponent are the parameters `at` and `at` + 1 of the law.
    """
    scale, exponent = law.parameters[at], law.parameters[at + 1]
    ratio = coefficient_at_speed(1.0, max(-u, 0.0), scale, exponent)
    slope = exponent * ratio / (scale + max(-u, 0.0))
    return ratio, slope, -slope * u / scale


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


@compiled
def smooth_impulse(law: Law, matrix: Matrix6, c: Vector) -> Vector:
    """`impulse` of a law without friction."""
    return 0.0, 0.0, -(1.0 + restitution_at(law, c[2])) * c[2] / matrix[5]


@compiled
def rough_impulse(law: Law, matrix: Matrix6, c: Vector) -> Vector:
    """`impulse` of a law with friction."""
    now = rough_law_at(law, c[2])
    return friction_impulse(matrix, now.chi, now.mu, int(law.parameters[2]), c[0], c[1], c[2])


def impulse(law: Law, matrix: Matrix6, c: Vector) -> Vector:
    """Impulse [N s] of the table on a contact with the velocity c [m/s] relative to it, c_z < 0, and a contact matrix [1/kg]."""
    if isinstance(law, RoughLaw):
        return rough_impulse(law, matrix, c)
    return smooth_impulse(law, matrix, c)


@overload(impulse, strict=False)
def _impulse_of(law: Any, matrix: Any, c: Any) -> Any:
    """The branch of `impulse` that the type of the law asks for, chosen when it is compiled."""
    chosen = rough_impulse if law.instance_class is RoughLaw else smooth_impulse
    return chosen.py_func


@inner
def apply_impact(body: Body, law: Law, arm: Vector, v_table: float, state: Array) -> None:
    """Apply the law to the velocities of the state, in place, on a touching point at `arm` [m]: Δv = S/m, Δω = (r × S)/J."""
    x, y, z = arm
    wx, wy, wz = state[10], state[11], state[12]
    c = (state[7] + wy * z - wz * y, state[8] + wz * x - wx * z, state[9] + wx * y - wy * x - v_table)
    sx, sy, sz = impulse(law, spherical_contact_matrix(body.mass, body.inertia, x, y, z), c)
    state[7] += sx / body.mass
    state[8] += sy / body.mass
    state[9] += sz / body.mass
    state[10] += (y * sz - z * sy) / body.inertia
    state[11] += (z * sx - x * sz) / body.inertia
    state[12] += (x * sy - y * sx) / body.inertia


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
