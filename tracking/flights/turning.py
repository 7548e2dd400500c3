"""How a die turns in flight, for the kernels of the fits: `EvenTurning` in closed form, `TorqueFree` step by step.

Each function here has two branches, of which a kernel compiles the one that the type of its `turning` asks for. A `Turned` is
carried from frame to frame, because a torque-free body is followed by integration.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from ...model.engine.asymmetric import (
    EvenTurning,
    TorqueFree,
    begin_turn,
    carry_turn,
    momentum_of_turn,
    omega_of_momentum,
    turn_transition,
    turned_omega,
    turned_quaternion,
)
from ...model.throw import Turning

Array = NDArray[np.float64]

JACOBIAN_SERIES_RAD = 1e-3
"""Angle [rad] below which exponential and left Jacobian are series: exact to rounding there, where (v - sin v)/v³ has lost seven
digits."""
TINY_ROTATION = 1e-12
"""Sine of half an angle, or an angle [rad], below which a rotation is converted to first order."""
SMALL_ANGLE_RAD = 1e-9
"""Angle [rad] of a flight below which sin(x/2)/x is 1/2."""


@inner
def _begin_even(turning: EvenTurning, state: Array) -> Array:
    """The spin (3,)."""
    return state[11:14]


@inner
def _begin_free(turning: TorqueFree, state: Array) -> Any:
    return begin_turn(turning, state[4:8], state[11:14])


@inner
def _even_quaternion(turning: EvenTurning, spin: Array, state: Array, dt: float) -> tuple[float, float, float, float]:
    x, y, z = spin[0] * dt, spin[1] * dt, spin[2] * dt
    angle = sqrt(x * x + y * y + z * z)
    half = sin(0.5 * angle) / angle if angle > SMALL_ANGLE_RAD else 0.5
    return quaternion_product(cos(0.5 * angle), half * x, half * y, half * z, state[4], state[5], state[6], state[7])


@inner
def _free_quaternion(turning: TorqueFree, carried: Any, state: Array, dt: float) -> tuple[float, float, float, float]:
    carry_turn(turning, carried, dt)
    return turned_quaternion(turning, carried)


@inner
def _even_transition(turning: EvenTurning, spin: Array, dt: float, out: Array) -> None:
    x, y, z = spin[0] * dt, spin[1] * dt, spin[2] * dt
    E, L = rotation_matrices(x, y, z, sqrt(x * x + y * y + z * z), dt)
    for i in range(3):
        for j in range(3):
            out[i, j], out[i, 3 + j] = E[i, j], L[i, j]


@inner
def _free_transition(turning: TorqueFree, carried: Any, dt: float, out: Array) -> None:
    carry_turn(turning, carried, dt)
    transition = np.empty((6, 6))
    turn_transition(turning, carried, transition)
    for i in range(out.shape[0]):
        for j in range(6):
            out[i, j] = transition[i, j]


@inner
def _even_omega(turning: EvenTurning, spin: Array, dt: float) -> tuple[float, float, float]:
    return spin[0], spin[1], spin[2]


@inner
def _free_omega(turning: TorqueFree, carried: Any, dt: float) -> tuple[float, float, float]:
    carry_turn(turning, carried, dt)
    return turned_omega(turning, carried)


@inner
def _even_mean_omega(turning: EvenTurning, times: Array, quaternions: Array, middle: int) -> tuple[float, float, float]:
    n = len(times)
    span = max(times[n - 1] - times[0], 1e-12)
    x, y, z = 0.0, 0.0, 0.0
    for k in range(n - 1):
        a, b, c = rotation_vector(quaternions[k], quaternions[k + 1])
        x, y, z = x + a / span, y + b / span, z + c / span
    return x, y, z


@inner
def _free_mean_omega(turning: TorqueFree, times: Array, quaternions: Array, middle: int) -> tuple[float, float, float]:
    n = len(times)
    span = max(times[n - 1] - times[0], 1e-12)
    x, y, z = 0.0, 0.0, 0.0
    for k in range(n - 1):
        a, b, c = rotation_vector(quaternions[k], quaternions[k + 1])
        # Halfway between two frames, by the mean of the momenta with the one attitude and with the other.
        for j in range(k, k + 2):
            p, q, r = momentum_of_turn(turning, quaternions[j], a, b, c)
            x, y, z = x + 0.5 * p / span, y + 0.5 * q / span, z + 0.5 * r / span
    return omega_of_momentum(turning, quaternions[middle], x, y, z)


@inner
def _even_spin_rate(turning: EvenTurning, state: Array) -> tuple[float, float, float]:
    return 0.0, 0.0, 0.0


@inner
def _free_spin_rate(turning: TorqueFree, state: Array) -> tuple[float, float, float]:
    """K⁻¹ (K ω × ω), in the principal axes and back."""
    q, moments = turning.axes, turning.moments
    w, x, y, z = quaternion_product(state[4], state[5], state[6], state[7], q[0], q[1], q[2], q[3])
    wx, wy, wz = _turned(w, -x, -y, -z, state[11], state[12], state[13])
    a = (moments[1] - moments[2]) * wy * wz / moments[0]
    b = (moments[2] - moments[0]) * wz * wx / moments[1]
    c = (moments[0] - moments[1]) * wx * wy / moments[2]
    return _turned(w, x, y, z, a, b, c)


def begin(turning: Turning, state: Array) -> Any:
    """What is carried through a flight from a packed state (14,) on."""
    return _begin_free(turning, state) if isinstance(turning, TorqueFree) else _begin_even(turning, state)


def quaternion_after(turning: Turning, carried: Any, state: Array, dt: float) -> tuple[float, float, float, float]:
    """The attitude `dt` [s] after the state."""
    if isinstance(turning, TorqueFree):
        return _free_quaternion(turning, carried, state, dt)
    return _even_quaternion(turning, carried, state, dt)


def transition_after(turning: Turning, carried: Any, dt: float, out: Array) -> None:
    """Fill `out` (3, 6) with the derivatives of the attitude `dt` [s] later by attitude and spin; of a torque-free body (6, 6)
    with those of the spin too."""
    if isinstance(turning, TorqueFree):
        _free_transition(turning, carried, dt, out)
    else:
        _even_transition(turning, carried, dt, out)


def omega_after(turning: Turning, carried: Any, dt: float) -> tuple[float, float, float]:
    """The spin `dt` [s] later."""
    return _free_omega(turning, carried, dt) if isinstance(turning, TorqueFree) else _even_omega(turning, carried, dt)


def mean_omega(turning: Turning, times: Array, quaternions: Array, middle: int) -> tuple[float, float, float]:
    """The spin at one of some frames: the mean between neighbours, of the angular momentum where the spin varies."""
    if isinstance(turning, TorqueFree):
        return _free_mean_omega(turning, times, quaternions, middle)
    return _even_mean_omega(turning, times, quaternions, middle)


def spin_rate_of(turning: Turning, state: Array) -> tuple[float, float, float]:
    """ω̇ [rad/s²] of a packed state (14,), world axes; 0 for a spherical top."""
    return _free_spin_rate(turning, state) if isinstance(turning, TorqueFree) else _even_spin_rate(turning, state)


@overload(begin, strict=False)
def _begin_of(turning: Any, state: Any) -> Any:
    return (_begin_free if turning.instance_class is TorqueFree else _begin_even).py_func


@overload(quaternion_after, strict=False)
def _quaternion_after_of(turning: Any, carried: Any, state: Any, dt: Any) -> Any:
    return (_free_quaternion if turning.instance_class is TorqueFree else _even_quaternion).py_func


@overload(transition_after, strict=False)
def _transition_after_of(turning: Any, carried: Any, dt: Any, out: Any) -> Any:
    return (_free_transition if turning.instance_class is TorqueFree else _even_transition).py_func


@overload(omega_after, strict=False)
def _omega_after_of(turning: Any, carried: Any, dt: Any) -> Any:
    return (_free_omega if turning.instance_class is TorqueFree else _even_omega).py_func


@overload(mean_omega, strict=False)
def _mean_omega_of(turning: Any, times: Any, quaternions: Any, middle: Any) -> Any:
    return (_free_mean_omega if turning.instance_class is TorqueFree else _even_mean_omega).py_func


@overload(spin_rate_of, strict=False)
def _spin_rate_of(turning: Any, state: Any) -> Any:
    return (_free_spin_rate if turning.instance_class is TorqueFree else _even_spin_rate).py_func


@compiled(nogil=True)
def fill_spin_rates(turning: Turning, states: Array, out: Array) -> None:
    """Fill ω̇ (n, 3) of packed states (n, 14)."""
    for k in range(len(states)):
        out[k, 0], out[k, 1], out[k, 2] = spin_rate_of(turning, states[k])


# --- rotations ---


@inner
def _turned(w: float, x: float, y: float, z: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion: v + 2 w (q × v) + 2 q × (q × v)."""
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx


@inner
def rotation_matrices(x: float, y: float, z: float, angle: float, dt: float) -> tuple[Array, Array]:
    """exp(v) and dt J(v) of v = (x, y, z); a series below JACOBIAN_SERIES_RAD."""
    square = angle * angle
    if angle < JACOBIAN_SERIES_RAD:
        sine, first, second = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        sine = sin(angle) / angle
        first, second = (1.0 - cos(angle)) / square, (angle - sin(angle)) / (square * angle)
    v = (x, y, z)
    E, L = np.empty((3, 3)), np.empty((3, 3))
    cross = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    for i in range(3):
        for j in range(3):
            straight = 1.0 if i == j else 0.0
            twice = v[i] * v[j] - square * straight
            E[i, j] = straight + sine * cross[i][j] + first * twice
            L[i, j] = dt * (straight + first * cross[i][j] + second * twice)
    return E, L


@inner
def rotation_vector(a: Array, b: Array) -> tuple[float, float, float]:
    """Of the rotation from one attitude (4,) to another, world axes [rad]."""
    w, x, y, z = quaternion_product(b[0], b[1], b[2], b[3], a[0], -a[1], -a[2], -a[3])
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = sqrt(x * x + y * y + z * z)
    factor = 2.0 * atan2(sine, w) / sine if sine > TINY_ROTATION else 2.0
    return factor * x, factor * y, factor * z


@inner
def quaternion_product(
    aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float]:
    """Hamilton product of two quaternions wxyz."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
