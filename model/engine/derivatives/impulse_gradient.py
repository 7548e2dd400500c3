"""The derivatives of an impulse: by the contact velocity, by the numbers of the law, and by all that changes the contact matrix.

An impulse S is a function of the contact matrix M, of the contact velocity c, and of χ and μ (`engine.impact`). M changes with
the arm, with the inertia, and with the attitude of a die whose moments of inertia differ; `inertia.matrix_changes` has these
derivatives, and the rest is the same for both kinds of dice. A law without friction has S_z = -(1 + χ) c_z/M_zz. One with
friction is differenced, to second order, along each change of M, c_x, c_y, χ and μ. S is proportional to c, which spares one.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

from numba.extending import overload

from ...compiled import compiled, inner
from ..friction_impulse import friction_impulse
from ..impact import RoughNow, coefficient_gradient, rough_law_at
from ..inertia import EvenInertia, TensorInertia, matrix_at, matrix_changes
from ..types import COULOMB_BY_SPEED, COULOMB_FADING, SMOOTH_BY_SPEED, Array, Law, Matrix6, RoughLaw, Vector

ARM, VELOCITY, CHI, MU, INERTIA, SPEED_SCALE, INPUTS = 0, 3, 6, 7, 8, 9, 10
"""Columns of the gradient of an impulse: arm (3), contact velocity (3), and numbers of law and die."""
ATTITUDE, ASYMMETRIC_INPUTS = INPUTS, INPUTS + 3
"""Columns of one with a turn of W: those, then a rotation vector (3) that turns W apart from the arm."""
MATRIX_CHANGES = INPUTS - 6
"""Columns among the INPUTS that change the contact matrix: arm and inertia."""

DIFFERENCE_STEP = 1e-5
"""Step of the differences through an impact with friction, in units of the mean of the diagonal of M, contact velocity, or 1.
Its square, and rounding over it, are both 1e-10. A higher order would take twice the impacts, and longer steps, which more often
reach across where the course of the slip changes."""


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


@inner
def _column_of(change: int) -> int:
    """The column of a change of the contact matrix, in the order of `inertia.matrix_changes`."""
    if change < VELOCITY:
        return change
    return INERTIA if change == VELOCITY else ATTITUDE + change - VELOCITY - 1


@compiled
def smooth_gradient(
    law: Law, inertia: EvenInertia | TensorInertia, arm: Vector, c: Vector, wanted: tuple[bool, bool], changes: Array,
    out: Array,
) -> Vector:  # fmt: skip
    """`impulse_gradient` of a law without friction."""
    u, chi = c[2], law.parameters[0]
    ratio, by_u, by_scale = 1.0, 0.0, 0.0
    if law.code == SMOOTH_BY_SPEED:
        ratio, by_u, by_scale = coefficient_gradient(law, 1, u)
    softness = matrix_at(inertia, arm[0], arm[1], arm[2])[5]
    s = -(1.0 + chi * ratio) * u / softness
    out[:] = 0.0
    out[2, VELOCITY + 2] = -(1.0 + chi * ratio + chi * by_u * u) / softness
    out[2, CHI] = -ratio * u / softness
    out[2, SPEED_SCALE] = -chi * by_scale * u / softness
    matrix_changes(inertia, arm, changes)
    for k in range(changes.shape[0]):
        out[2, _column_of(k)] = -s / softness * changes[k, 5]
    return 0.0, 0.0, s


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


@inner
def _moved(matrix: Matrix6, change: Array, step: float) -> Matrix6:
    """A contact matrix farther along a change (6,) of it."""
    return (
        matrix[0] + step * change[0],
        matrix[1] + step * change[1],
        matrix[2] + step * change[2],
        matrix[3] + step * change[3],
        matrix[4] + step * change[4],
        matrix[5] + step * change[5],
    )


@compiled
def rough_gradient(
    law: Law, inertia: EvenInertia | TensorInertia, arm: Vector, c: Vector, wanted: tuple[bool, bool], changes: Array,
    out: Array,
) -> Vector:  # fmt: skip
    """`impulse_gradient` of a law with friction."""
    now, ending = rough_law_at(law, c[2]), int(law.parameters[2])
    matrix = matrix_at(inertia, arm[0], arm[1], arm[2])
    found = friction_impulse(matrix, now.chi, now.mu, ending, c[0], c[1], c[2])
    out[:] = 0.0
    matrix_changes(inertia, arm, changes)
    mean = (matrix[0] + matrix[3] + matrix[5]) / 3.0
    for k in range(changes.shape[0]):
        size = 0.0
        for i in range(6):
            size = max(size, abs(changes[k, i]))
        if size == 0.0:
            continue
        step = DIFFERENCE_STEP * mean / size
        for n in (0, 2):
            weight, at = difference_weight(False, n, step)
            there = friction_impulse(_moved(matrix, changes[k], at), now.chi, now.mu, ending, c[0], c[1], c[2])
            for m in range(3):
                out[m, _column_of(k)] += weight * there[m]
    speed, given = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), (c[0], c[1], now.chi, now.mu)
    for k in range(4):
        if (k == 2 and not wanted[0]) or (k == 3 and not wanted[1]):
            continue
        step = DIFFERENCE_STEP * (speed if k < 2 else 1.0)
        # Neither χ nor μ can be less than 0: forward from there.
        forward = k >= 2 and given[k] < step
        for n in range(3):
            weight, at = difference_weight(forward, n, step)
            if weight == 0.0:
                continue
            cx, cy = c[0] + (at if k == 0 else 0.0), c[1] + (at if k == 1 else 0.0)
            chi, mu = now.chi + (at if k == 2 else 0.0), now.mu + (at if k == 3 else 0.0)
            there = friction_impulse(matrix, chi, mu, ending, cx, cy, c[2])
            for m in range(3):
                out[m, (VELOCITY, VELOCITY + 1, CHI, MU)[k]] += weight * there[m]
    complete_columns(law, now, c, found, out)
    return found


def impulse_gradient(
    law: Law, inertia: EvenInertia | TensorInertia, arm: Vector, c: Vector, wanted: tuple[bool, bool], changes: Array,
    out: Array,
) -> Vector:  # fmt: skip
    """The impulse [N s] on a contact at `arm` [m] with velocity `c` [m/s] relative to the table, and its derivatives in `out`.

    `out` is (3, INPUTS), or (3, ASYMMETRIC_INPUTS) for a tensor of inertia, with the columns above; χ is that of the slowest
    impacts. `wanted` says whether the columns of χ and of μ are used; see `wanted_columns`. `changes`, with a row for each of the
    columns that change the contact matrix, is room to work in.
    """
    if isinstance(law, RoughLaw):
        return rough_gradient(law, inertia, arm, c, wanted, changes, out)
    return smooth_gradient(law, inertia, arm, c, wanted, changes, out)


@overload(impulse_gradient, strict=False)
def _impulse_gradient_of(law: Any, inertia: Any, arm: Any, c: Any, wanted: Any, changes: Any, out: Any) -> Any:
    """The branch of `impulse_gradient` that the type of the law asks for, chosen when it is compiled."""
    return (rough_gradient if law.instance_class is RoughLaw else smooth_gradient).py_func


@inner
def wanted_columns(law: Law, chi: bool, mu: bool) -> tuple[bool, bool]:
    """`wanted` of `impulse_gradient`: whether parameters change χ or μ, or the law makes them change with speed."""
    by_speed = law.code == SMOOTH_BY_SPEED or law.code == COULOMB_BY_SPEED or law.code == COULOMB_FADING
    return by_speed or chi, law.code == COULOMB_FADING or mu
