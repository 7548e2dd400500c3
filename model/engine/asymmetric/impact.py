"""An impact on a body with any inertia tensor, and its impulse with derivatives: `engine.impact` with W = R I⁻¹ Rᵀ for 1/J.

A turn of the attitude, apart from what it does to the arm and to the contact velocity, changes W. Its columns follow those that
the gradient of a die with one moment of inertia has.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

import numpy as np
from numba.extending import overload

from ...compiled import compiled, inner
from ..flight import lever_arm
from ..friction_impulse import friction_impulse
from ..impact import (
    ARM,
    CHI,
    DIFFERENCE_STEP,
    INERTIA,
    INPUTS,
    MU,
    SPEED_SCALE,
    VELOCITY,
    coefficient_gradient,
    complete_columns,
    difference_weight,
    restitution_at,
    rough_law_at,
)
from ..inertia import angular_velocity_of, contact_matrix, tensor_inertia, tensor_matrix, to_body_axes, to_table_axes
from ..types import NONE, SMOOTH_BY_SPEED, Array, AsymmetricBody, Contact, Indices, Law, RoughLaw, Setup, Vector
from .contact import simultaneous_impact

ATTITUDE, ASYMMETRIC_INPUTS = INPUTS, INPUTS + 3
"""Columns of the gradient: those of `impact.impulse_gradient`, then a rotation vector (3) that turns W."""


@inner
def smooth_strike(
    setup: Setup, y: Array, time: float, hit: int, velocity: float, chosen: Indices, n: int, room: Array
) -> None:
    """`strike` of a law without friction: all n at once."""
    body, law, plane, _ = setup
    contact = Contact(body, plane, hit, NONE)
    simultaneous_impact(contact, y, time, velocity, restitution_at(law, velocity), chosen, n, room)


@inner
def rough_strike(
    setup: Setup, y: Array, time: float, hit: int, velocity: float, chosen: Indices, n: int, room: Array
) -> None:
    """`strike` of a law with friction: the one vertex, and the others after it."""
    body, law, _, _ = setup
    now, ending = rough_law_at(law, velocity), int(law.parameters[2])
    arm = np.empty(3)
    arm[0], arm[1], level = lever_arm(body.vertices[hit], y)
    arm[2] = level - body.corner_radius
    ox, oy, oz = angular_velocity_of(body, y, y[10], y[11], y[12])
    cx, cy = y[7] + oy * arm[2] - oz * arm[1], y[8] + oz * arm[0] - ox * arm[2]
    matrix = tensor_matrix(tensor_inertia(body, y), arm[0], arm[1], arm[2])
    sx, sy, sz = friction_impulse(matrix, now.chi, now.mu, ending, cx, cy, velocity)
    y[7] += sx / body.mass
    y[8] += sy / body.mass
    y[9] += sz / body.mass
    y[10] += arm[1] * sz - arm[2] * sy
    y[11] += arm[2] * sx - arm[0] * sz
    y[12] += arm[0] * sy - arm[1] * sx


def strike(
    setup: Setup, y: Array, time: float, hit: int, velocity: float, chosen: Indices, n: int, room: Array
) -> None:
    """The impact, in place, of vertex `hit`, which comes down with `velocity` [m/s], on a state y (13,) with L.

    `chosen` has the n vertices that touch at that instant, of which no law with friction strikes more than one."""
    if isinstance(setup.law, RoughLaw):
        rough_strike(setup, y, time, hit, velocity, chosen, n, room)
    else:
        smooth_strike(setup, y, time, hit, velocity, chosen, n, room)


@overload(strike, strict=False)
def _strike_of(setup: Any, y: Any, time: Any, hit: Any, velocity: Any, chosen: Any, n: Any, room: Any) -> Any:
    """The branch of `strike` that the type of the law asks for, chosen when it is compiled."""
    return (rough_strike if setup[1].instance_class is RoughLaw else smooth_strike).py_func


@compiled
def smooth_gradient(
    law: Law, body: AsymmetricBody, y: Array, arm: Vector, c: Vector, wanted: tuple[bool, bool], out: Array
) -> Vector:
    """`impulse_gradient` of a law without friction."""
    x, r, _ = arm
    u, chi = c[2], law.parameters[0]
    ratio, by_u, by_scale = 1.0, 0.0, 0.0
    if law.code == SMOOTH_BY_SPEED:
        ratio, by_u, by_scale = coefficient_gradient(law, 1, u)
    # W t with the torque t = r × ẑ = (r_y, -r_x, 0) of a unit impulse.
    ax, ay, az = angular_velocity_of(body, y, r, -x, 0.0)
    softness = 1.0 / body.mass + r * ax - x * ay
    s = -(1.0 + chi * ratio) * u / softness
    by_softness = -s / softness
    for i in range(3):
        for k in range(ASYMMETRIC_INPUTS):
            out[i, k] = 0.0
    # δ(t·W t) = 2 δt·W t + 2 t·(δ × W t) - δI |W t|².
    out[2, ARM], out[2, ARM + 1] = -2.0 * by_softness * ay, 2.0 * by_softness * ax
    out[2, VELOCITY + 2] = -(1.0 + chi * ratio + chi * by_u * u) / softness
    out[2, CHI] = -ratio * u / softness
    out[2, SPEED_SCALE] = -chi * by_scale * u / softness
    out[2, INERTIA] = -by_softness * (ax * ax + ay * ay + az * az)
    out[2, ATTITUDE], out[2, ATTITUDE + 1] = 2.0 * by_softness * x * az, 2.0 * by_softness * r * az
    out[2, ATTITUDE + 2] = -2.0 * by_softness * (r * ay + x * ax)
    return 0.0, 0.0, s


@inner
def _response(body: AsymmetricBody, y: Array, stiffer: float, axis: int, angle: float, out: Array) -> None:
    """Fill W (3, 3) with all moments larger by `stiffer`, turned by an angle about an axis of the table (0, 1, 2)."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    a, b = cos(angle), sin(angle)
    for column in range(3):
        v = (1.0 if column == 0 else 0.0, 1.0 if column == 1 else 0.0, 1.0 if column == 2 else 0.0)
        # E W Eᵀ v: the vector turned back, W, and turned.
        back = np.empty(3)
        back[axis], back[j], back[k] = v[axis], a * v[j] + b * v[k], a * v[k] - b * v[j]
        p, q, r = to_body_axes(y, back[0], back[1], back[2])
        i1, i2, i3 = body.moments[0] + stiffer, body.moments[1] + stiffer, body.moments[2] + stiffer
        answer = to_table_axes(y, p / i1, q / i2, r / i3)
        out[axis, column] = answer[axis]
        out[j, column] = a * answer[j] - b * answer[k]
        out[k, column] = a * answer[k] + b * answer[j]


@compiled
def rough_gradient(
    law: Law, body: AsymmetricBody, y: Array, arm: Vector, c: Vector, wanted: tuple[bool, bool], out: Array
) -> Vector:
    """`impulse_gradient` of a law with friction: differences of the second order of this one impact. S is proportional to c."""
    now, ending = rough_law_at(law, c[2]), int(law.parameters[2])
    chi, mu = now.chi, now.mu
    moment = (body.moments[0] + body.moments[1] + body.moments[2]) / 3.0
    gyration, speed = sqrt(moment / body.mass), sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    response = np.empty((3, 3))
    _response(body, y, 0.0, 0, 0.0, response)
    matrix = contact_matrix(body.mass, response, arm[0], arm[1], arm[2])
    sx, sy, sz = friction_impulse(matrix, chi, mu, ending, c[0], c[1], c[2])
    for i in range(3):
        for k in range(ASYMMETRIC_INPUTS):
            out[i, k] = 0.0
    there, input_of = np.empty(8), (arm[0], arm[1], arm[2], c[0], c[1], c[2], chi, mu)
    for k in range(ASYMMETRIC_INPUTS):
        if k == VELOCITY + 2 or k == SPEED_SCALE or (k == CHI and not wanted[0]) or (k == MU and not wanted[1]):
            continue
        step = DIFFERENCE_STEP
        if k < VELOCITY:
            step *= gyration
        elif k < CHI:
            step *= speed
        elif k == INERTIA:
            step *= moment
        # Neither χ nor μ can be less than 0: forward from there.
        forward = (k == CHI and chi < step) or (k == MU and mu < step)
        for n in range(3):
            weight, at = difference_weight(forward, n, step)
            if weight == 0.0:
                continue
            for i in range(8):
                there[i] = input_of[i]
            if k < INERTIA:
                there[k] += at
                _response(body, y, 0.0, 0, 0.0, response)
            elif k == INERTIA:
                _response(body, y, at, 0, 0.0, response)
            else:
                _response(body, y, 0.0, k - ATTITUDE, at, response)
            matrix = contact_matrix(body.mass, response, there[0], there[1], there[2])
            px, py, pz = friction_impulse(matrix, there[6], there[7], ending, there[3], there[4], there[5])
            out[0, k] += weight * px
            out[1, k] += weight * py
            out[2, k] += weight * pz
    complete_columns(law, now, c, (sx, sy, sz), out)
    return sx, sy, sz


def impulse_gradient(
    law: Law, body: AsymmetricBody, y: Array, arm: Vector, c: Vector, wanted: tuple[bool, bool], out: Array
) -> Vector:
    """The impulse [N s] on a contact at `arm` with velocity `c` relative to the table, and its derivatives in `out` (3,
    ASYMMETRIC_INPUTS); `wanted` as in `impact.impulse_gradient`. `y` (13,) is a state whose quaternion counts."""
    if isinstance(law, RoughLaw):
        return rough_gradient(law, body, y, arm, c, wanted, out)
    return smooth_gradient(law, body, y, arm, c, wanted, out)


@overload(impulse_gradient, strict=False)
def _impulse_gradient_of(law: Any, body: Any, y: Any, arm: Any, c: Any, wanted: Any, out: Any) -> Any:
    """The branch of `impulse_gradient` that the type of the law asks for, chosen when it is compiled."""
    chosen = rough_gradient if law.instance_class is RoughLaw else smooth_gradient
    return chosen.py_func
