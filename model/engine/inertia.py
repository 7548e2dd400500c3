"""What the inertia of a die does: how it turns, how it answers the impulse at a corner, and how it moves without one.

The state of an asymmetric body has the angular momentum L in place of ω in the kernels of `asymmetric`. With the rotation R from
its principal axes to table axes and the principal moments I, ω = W L with W = R I⁻¹ Rᵀ. Functions of both kinds of dice have a
branch for `Body` and one for `AsymmetricBody`, chosen by the type, so that a kernel compiles only the one that it is called with;
their states have ω.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compiled import compiled, inner
from .flight import advance, spin_rate
from .runge_kutta import STAGES, START, VALUES, stage_values
from .types import Array, AsymmetricBody, Body, Matrix6, Plane, Vector

TURN_SIZE = 4
"""Numbers that a step of the free rotation integrates: the quaternion."""


# --- Axes and angular velocity of an asymmetric body ---


@inner
def to_table_axes(y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """A vector of body axes in table axes, by the quaternion of a state (13,)."""
    w, x, z, v = y[3], y[4], y[5], y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return a + w * tx + z * tz - v * ty, b + w * ty + v * tx - x * tz, c + w * tz + x * ty - z * tx


@inner
def to_body_axes(y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """A vector of table axes in body axes, by the quaternion of a state (13,)."""
    w, x, z, v = y[3], -y[4], -y[5], -y[6]
    tx, ty, tz = 2.0 * (z * c - v * b), 2.0 * (v * a - x * c), 2.0 * (x * b - z * a)
    return a + w * tx + z * tz - v * ty, b + w * ty + v * tx - x * tz, c + w * tz + x * ty - z * tx


@inner
def vertical_in_body(y: Array) -> tuple[float, float, float]:
    """The vertical in body axes: third row of the rotation."""
    w, a, b, c = y[3], y[4], y[5], y[6]
    return 2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b)


@inner
def body_angular_velocity(body: AsymmetricBody, y: Array) -> tuple[float, float, float]:
    """ω [rad/s] in body axes: I⁻¹ Rᵀ L."""
    a, b, c = to_body_axes(y, y[10], y[11], y[12])
    return a / body.moments[0], b / body.moments[1], c / body.moments[2]


@inner
def angular_velocity_of(body: AsymmetricBody, y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W x, in table axes: the angular velocity that an angular momentum x = (a, b, c) makes."""
    p, q, r = to_body_axes(y, a, b, c)
    return to_table_axes(y, p / body.moments[0], q / body.moments[1], r / body.moments[2])


@inner
def attitude_rates(body: AsymmetricBody, y: Array, out: Array) -> None:
    """Fill out[:4] with the rates of the quaternion of a state: q' = q ω/2."""
    p, q, r = body_angular_velocity(body, y)
    w, a, b, c = y[3], y[4], y[5], y[6]
    out[0] = 0.5 * (-a * p - b * q - c * r)
    out[1] = 0.5 * (w * p + b * r - c * q)
    out[2] = 0.5 * (w * q + c * p - a * r)
    out[3] = 0.5 * (w * r + a * q - b * p)


@inner
def to_angular_velocity(body: AsymmetricBody, y: Array, out: Array) -> None:
    """The state with ω [rad/s, table axes] in place of L, into `out` (13,)."""
    p, q, r = body_angular_velocity(body, y)
    out[:] = y
    out[10], out[11], out[12] = to_table_axes(y, p, q, r)


@inner
def to_angular_momentum(body: AsymmetricBody, state: Array) -> Array:
    """The inverse of `to_angular_velocity`, as a new state."""
    y = state.copy()
    p, q, r = to_body_axes(y, y[10], y[11], y[12])
    y[10], y[11], y[12] = to_table_axes(state, body.moments[0] * p, body.moments[1] * q, body.moments[2] * r)
    return y


# --- Contact matrices ---


@compiled
def spherical_contact_matrix(mass: float, inertia: float, x: float, y: float, z: float) -> Matrix6:
    """Contact matrix M [1/kg] of a die with one moment of inertia, for a contact at (x, y, z) [m] from its centre of mass."""
    free = 1.0 / mass
    return (
        free + (y * y + z * z) / inertia,
        -x * y / inertia,
        -x * z / inertia,
        free + (x * x + z * z) / inertia,
        -y * z / inertia,
        free + (x * x + y * y) / inertia,
    )


@compiled
def contact_matrix(mass: float, inverse_inertia: Array, x: float, y: float, z: float) -> Matrix6:
    """The same for any body; `inverse_inertia` (3, 3) [1/(kg m²)] in world axes: M = 1/m - [r]× I⁻¹ [r]×."""
    i = inverse_inertia
    # The columns A, B, C of I⁻¹ [r]×, as far as [r]× in front of them asks for them.
    ay, az = i[1, 1] * z - i[1, 2] * y, i[1, 2] * z - i[2, 2] * y
    bx, by, bz = i[0, 2] * x - i[0, 0] * z, i[1, 2] * x - i[0, 1] * z, i[2, 2] * x - i[0, 2] * z
    cx, cy, cz = i[0, 0] * y - i[0, 1] * x, i[0, 1] * y - i[1, 1] * x, i[0, 2] * y - i[1, 2] * x
    free = 1.0 / mass
    return (
        free + z * ay - y * az,
        z * by - y * bz,
        z * cy - y * cz,
        free + x * bz - z * bx,
        x * cz - z * cx,
        free + y * cx - x * cy,
    )


# --- Both kinds of dice ---


class EvenInertia(NamedTuple):
    """Mass and inertia of a die with one moment of inertia."""

    mass: float
    """[kg]."""
    moment: float
    """[kg m²]."""


class TensorInertia(NamedTuple):
    """Mass and inertia of any die, in one attitude."""

    mass: float
    """[kg]."""
    inverse: Array
    """W (3, 3) [1/(kg m²)], axes of the table."""


@inner
def even_inertia(body: Body, state: Array) -> EvenInertia:
    """`inertia_of` a die with one moment of inertia."""
    return EvenInertia(body.mass, body.inertia)


@inner
def tensor_inertia(body: AsymmetricBody, state: Array) -> TensorInertia:
    """`inertia_of` any other die."""
    inverse = np.empty((3, 3))
    for k in range(3):
        a, b, c = to_body_axes(state, 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        inverse[0, k], inverse[1, k], inverse[2, k] = to_table_axes(
            state, a / body.moments[0], b / body.moments[1], c / body.moments[2]
        )
    return TensorInertia(body.mass, inverse)


def inertia_of(body: Body | AsymmetricBody, state: Array) -> EvenInertia | TensorInertia:
    """Mass and inertia of a die in the attitude of a state (13,)."""
    if isinstance(body, AsymmetricBody):
        return tensor_inertia(body, state)
    return even_inertia(body, state)


@overload(inertia_of, strict=False)
def _inertia_of(body: Any, state: Any) -> Any:
    """The branch of `inertia_of` that the type of the body asks for, chosen when it is compiled."""
    return (tensor_inertia if body.instance_class is AsymmetricBody else even_inertia).py_func


@inner
def even_matrix(inertia: EvenInertia, x: float, y: float, z: float) -> Matrix6:
    """`matrix_at` of a die with one moment of inertia."""
    return spherical_contact_matrix(inertia.mass, inertia.moment, x, y, z)


@inner
def tensor_matrix(inertia: TensorInertia, x: float, y: float, z: float) -> Matrix6:
    """`matrix_at` of any other die."""
    return contact_matrix(inertia.mass, inertia.inverse, x, y, z)


def matrix_at(inertia: EvenInertia | TensorInertia, x: float, y: float, z: float) -> Matrix6:
    """The contact matrix [1/kg] of a contact at (x, y, z) [m] from the centre of mass."""
    if isinstance(inertia, TensorInertia):
        return tensor_matrix(inertia, x, y, z)
    return even_matrix(inertia, x, y, z)


@overload(matrix_at, strict=False)
def _matrix_at(inertia: Any, x: Any, y: Any, z: Any) -> Any:
    """The branch of `matrix_at`, as that of `inertia_of`."""
    return (tensor_matrix if inertia.instance_class is TensorInertia else even_matrix).py_func


@inner
def even_matrix_changes(inertia: EvenInertia, arm: Vector, out: Array) -> None:
    """`matrix_changes` of a die with one moment of inertia."""
    x, y, z = arm[0] / inertia.moment, arm[1] / inertia.moment, arm[2] / inertia.moment
    out[0, 0], out[0, 1], out[0, 2], out[0, 3], out[0, 4], out[0, 5] = 0.0, -y, -z, 2.0 * x, 0.0, 2.0 * x
    out[1, 0], out[1, 1], out[1, 2], out[1, 3], out[1, 4], out[1, 5] = 2.0 * y, -x, 0.0, 0.0, -z, 2.0 * y
    out[2, 0], out[2, 1], out[2, 2], out[2, 3], out[2, 4], out[2, 5] = 2.0 * z, 0.0, -x, 2.0 * z, -y, 0.0
    for i in range(6):
        # M - 1/m is quadratic in the arm, over the moment of inertia.
        out[3, i] = -0.5 * (x * out[0, i] + y * out[1, i] + z * out[2, i])


@inner
def tensor_matrix_changes(inertia: TensorInertia, arm: Vector, out: Array) -> None:
    """`matrix_changes` of any other die."""
    (x, y, z), w = arm, inertia.inverse
    for k in range(7):
        for i in range(6):
            out[k, i] = 0.0
    # M is quadratic in the arm: a difference over any step is exact.
    step = sqrt(x * x + y * y + z * z)
    for side in (-1.0, 1.0):
        if step > 0.0:
            h, weight = side * step, 0.5 * side / step
            _add_to_row(out, 0, contact_matrix(inertia.mass, w, x + h, y, z), weight)
            _add_to_row(out, 1, contact_matrix(inertia.mass, w, x, y + h, z), weight)
            _add_to_row(out, 2, contact_matrix(inertia.mass, w, x, y, z + h), weight)
    # M - 1/m is linear in W. Larger moments change W by -W², a turn about an axis e by [e]× W - W [e]×.
    change = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            change[i, j] = -(w[i, 0] * w[0, j] + w[i, 1] * w[1, j] + w[i, 2] * w[2, j])
    _add_to_row(out, 3, contact_matrix(inf, change, x, y, z), 1.0)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        change[k, k], change[i, i], change[j, j] = 0.0, -2.0 * w[i, j], 2.0 * w[i, j]
        change[i, j], change[i, k], change[j, k] = w[i, i] - w[j, j], -w[j, k], w[i, k]
        change[j, i], change[k, i], change[k, j] = change[i, j], change[i, k], change[j, k]
        _add_to_row(out, 4 + k, contact_matrix(inf, change, x, y, z), 1.0)


@inner
def _add_to_row(out: Array, row: int, matrix: Matrix6, weight: float) -> None:
    """Add a matrix with a weight to a row (6,)."""
    for i in range(6):
        out[row, i] += weight * matrix[i]


def matrix_changes(inertia: EvenInertia | TensorInertia, arm: Vector, out: Array) -> None:
    """Fill `out` with the derivatives of the contact matrix of a contact at `arm` [m]: by the three components of the arm, by all
    moments of inertia [kg m²] alike and, of a tensor, by a rotation vector (3) that turns it: (4, 6) or (7, 6)."""
    if isinstance(inertia, TensorInertia):
        tensor_matrix_changes(inertia, arm, out)
    else:
        even_matrix_changes(inertia, arm, out)


@overload(matrix_changes, strict=False)
def _matrix_changes(inertia: Any, arm: Any, out: Any) -> Any:
    """The branch of `matrix_changes`, as that of `inertia_of`."""
    return (tensor_matrix_changes if inertia.instance_class is TensorInertia else even_matrix_changes).py_func


@inner
def apply_even_impulse(velocity: Array, arm: Array, inertia: EvenInertia, sx: float, sy: float, sz: float) -> None:
    """`apply_impulse` to a die with one moment of inertia."""
    velocity[0] += sx / inertia.mass
    velocity[1] += sy / inertia.mass
    velocity[2] += sz / inertia.mass
    velocity[3] += (arm[1] * sz - arm[2] * sy) / inertia.moment
    velocity[4] += (arm[2] * sx - arm[0] * sz) / inertia.moment
    velocity[5] += (arm[0] * sy - arm[1] * sx) / inertia.moment


@inner
def apply_tensor_impulse(velocity: Array, arm: Array, inertia: TensorInertia, sx: float, sy: float, sz: float) -> None:
    """`apply_impulse` to any other die."""
    w = inertia.inverse
    a, b, c = arm[1] * sz - arm[2] * sy, arm[2] * sx - arm[0] * sz, arm[0] * sy - arm[1] * sx
    velocity[0] += sx / inertia.mass
    velocity[1] += sy / inertia.mass
    velocity[2] += sz / inertia.mass
    for k in range(3):
        velocity[3 + k] += w[k, 0] * a + w[k, 1] * b + w[k, 2] * c


def apply_impulse(
    velocity: Array, arm: Array, inertia: EvenInertia | TensorInertia, sx: float, sy: float, sz: float
) -> None:
    """Change the velocity (6,) of centre and spin by an impulse [N s] at `arm` [m], in place: Δv = S/m, Δω = W (r × S)."""
    if isinstance(inertia, TensorInertia):
        apply_tensor_impulse(velocity, arm, inertia, sx, sy, sz)
    else:
        apply_even_impulse(velocity, arm, inertia, sx, sy, sz)


@overload(apply_impulse, strict=False)
def _apply_impulse(velocity: Any, arm: Any, inertia: Any, sx: Any, sy: Any, sz: Any) -> Any:
    """The branch of `apply_impulse`, as that of `inertia_of`."""
    return (apply_tensor_impulse if inertia.instance_class is TensorInertia else apply_even_impulse).py_func


@compiled
def move_freely(state: Array, dt: float) -> None:
    """Carry the pose of a die with one moment of inertia along its velocities over dt [s], in place, without any force."""
    height_velocity = state[9]
    advance(state, spin_rate(state), dt, Plane(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    state[9] = height_velocity


@inner
def _carry_even(body: Body, state: Array, dt: float, stages: Array) -> None:
    """`carry_freely` of a die with one moment of inertia."""
    move_freely(state, dt)


@inner
def _carry_tensor(body: AsymmetricBody, state: Array, dt: float, stages: Array) -> None:
    """`carry_freely` of any other die: L stays, and the attitude is integrated in one step of order 8."""
    for k in range(3):
        state[k] += state[7 + k] * dt
    if state[10] == 0.0 and state[11] == 0.0 and state[12] == 0.0:
        return
    y = to_angular_momentum(body, state)
    for k in range(TURN_SIZE):
        stages[START, k] = state[3 + k]
    for stage in range(STAGES + 1):
        stage_values(stages, stage, dt, TURN_SIZE)
        for k in range(TURN_SIZE):
            y[3 + k] = stages[VALUES, k]
        if stage < STAGES:
            attitude_rates(body, y, stages[stage])
    norm = sqrt(y[3] * y[3] + y[4] * y[4] + y[5] * y[5] + y[6] * y[6])
    for k in range(TURN_SIZE):
        y[3 + k] /= norm
    to_angular_velocity(body, y, state)


def carry_freely(body: Body | AsymmetricBody, state: Array, dt: float, stages: Array) -> None:
    """Carry a state (13,) over dt [s], in place, without any force; `stages` (14, TURN_SIZE) is room to work in."""
    if isinstance(body, AsymmetricBody):
        _carry_tensor(body, state, dt, stages)
    else:
        _carry_even(body, state, dt, stages)


@overload(carry_freely, strict=False)
def _carry_freely(body: Any, state: Any, dt: Any, stages: Any) -> Any:
    """The branch of `carry_freely`, as that of `inertia_of`."""
    return (_carry_tensor if body.instance_class is AsymmetricBody else _carry_even).py_func
