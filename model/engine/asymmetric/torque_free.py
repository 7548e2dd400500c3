"""How a die turns in flight: at a constant rate if it is a spherical top, else by Euler's equations, with the derivatives.

`EvenTurning` and `TorqueFree` are types of their own, so that kernels which take either compile only the one they are called
with. A torque-free body keeps its angular momentum L. With the rotation R, the tensor K = R I Rᵀ and W = K⁻¹, a turn δθ of the
attitude (R_true = exp(δθ) R) and a change δL obey

    δθ' = W (δL - δθ × L),    δL = K δω + δθ × L - K (δθ × ω),    δω = δθ × ω + W (δL - δθ × L).

The first is integrated with the attitude itself (`tangent.attitude_step`), the others lead from ω at the start and back to it.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from ...compiled import compiled, inner_nogil
from ..inertia import angular_velocity_of, to_body_axes, to_table_axes
from ..types import Array
from .motion import MAX_TURN_RAD
from .tangent import attitude_step

FLOW = 22
"""Numbers that are integrated: the quaternion (4) of the principal axes, ∂θ/∂θ₀ (3 × 3) and ∂θ/∂L (3 × 3), row by row."""


class EvenTurning(NamedTuple):
    """A spherical top: its angular velocity is constant."""

    moment: float
    """Not read: a rotation at a constant rate needs none."""


class TorqueFree(NamedTuple):
    """A body with several moments of inertia."""

    moments: Array
    """(3,) [kg m²] principal moments, ascending."""
    axes: Array
    """(4,) quaternion from the principal axes to the body's."""


class TurnInFlight(NamedTuple):
    """A body that turns without torque, carried from one instant to the next; `begin_turn` makes one."""

    y: Array
    """(13,) a state of which the quaternion of the principal axes and L count."""
    flow: Array
    """(FLOW,) as far as it has been integrated."""
    elapsed: Array
    """(1,) time [s] since the start."""
    by_start: Array
    """(2, 3, 3) derivatives of L by a turn of the attitude and by ω, both at the start."""
    room: Array
    """(14, FLOW) for the integration."""


@inner_nogil
def begin_turn(die: TorqueFree, quaternion: Array, omega: Array) -> TurnInFlight:
    """The turn that begins with a quaternion (4,) from body to world axes and ω (3,) [rad/s]."""
    turn = TurnInFlight(np.zeros(13), np.zeros(FLOW), np.zeros(1), np.empty((2, 3, 3)), np.empty((14, FLOW)))
    y, flow = turn.y, turn.flow
    y[3], y[4], y[5], y[6] = _quaternion_product(quaternion, die.axes, 1.0)
    y[10], y[11], y[12] = _momentum_of(die, y, omega[0], omega[1], omega[2])
    for k in range(4):
        flow[k] = y[3 + k]
    flow[4], flow[8], flow[12] = 1.0, 1.0, 1.0
    for k in range(3):
        unit = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        by_omega = _momentum_of(die, y, unit[0], unit[1], unit[2])
        # K (ω × e) - L × e, the column of a turn about e.
        wx, wy, wz = _cross((omega[0], omega[1], omega[2]), unit)
        by_turn = _momentum_of(die, y, wx, wy, wz)
        swept = _cross((y[10], y[11], y[12]), unit)
        for i in range(3):
            turn.by_start[0, i, k] = by_turn[i] - swept[i]
            turn.by_start[1, i, k] = by_omega[i]
    return turn


@inner_nogil
def carry_turn(die: TorqueFree, turn: TurnInFlight, time: float) -> None:
    """Carry a turn, in place, to a time [s] after its start, which may lie before the present one."""
    y, flow, elapsed, _, room = turn
    dt = time - elapsed[0]
    wx, wy, wz = angular_velocity_of(die, y, y[10], y[11], y[12])
    # ω·L is constant, and ω never larger than with all of it about the axis of the least moment.
    spin = sqrt((wx * y[10] + wy * y[11] + wz * y[12]) / die.moments[0])
    steps = max(1, ceil(abs(dt) * spin / MAX_TURN_RAD))
    for _ in range(steps):
        attitude_step(die, y, flow, dt / steps, room)
    elapsed[0] = time


@inner_nogil
def turned_quaternion(die: TorqueFree, turn: TurnInFlight) -> tuple[float, float, float, float]:
    """The quaternion from body to world axes at the present instant of a turn."""
    return _quaternion_product(turn.y[3:7], die.axes, -1.0)


@inner_nogil
def turned_omega(die: TorqueFree, turn: TurnInFlight) -> tuple[float, float, float]:
    """ω [rad/s], world axes, at the present instant of a turn."""
    y = turn.y
    return angular_velocity_of(die, y, y[10], y[11], y[12])


@inner_nogil
def turn_transition(die: TorqueFree, turn: TurnInFlight, out: Array) -> None:
    """Fill `out` (6, 6): derivatives of the present attitude, and of ω, by those at the start."""
    y, flow, _, by_start, _ = turn
    omega = angular_velocity_of(die, y, y[10], y[11], y[12])
    momentum = (y[10], y[11], y[12])
    for k in range(6):
        source, column = k // 3, k % 3
        lx, ly, lz = by_start[source, 0, column], by_start[source, 1, column], by_start[source, 2, column]
        for i in range(3):
            turned = flow[13 + 3 * i] * lx + flow[14 + 3 * i] * ly + flow[15 + 3 * i] * lz
            out[i, k] = turned + (flow[4 + 3 * i + column] if source == 0 else 0.0)
        turned_by = (out[0, k], out[1, k], out[2, k])
        sx, sy, sz = _cross(turned_by, momentum)
        spun = angular_velocity_of(die, y, lx - sx, ly - sy, lz - sz)
        swept = _cross(turned_by, omega)
        for i in range(3):
            out[3 + i, k] = swept[i] + spun[i]


@compiled(nogil=True)
def torque_free_turns(
    die: TorqueFree, quaternion: Array, omega: Array, delays: Array, quaternions: Array, omegas: Array, transitions: Array
) -> None:  # fmt: skip
    """Fill quaternions (n, 4), angular velocities (n, 3) and their derivatives (n, 6, 6) by those at the start, `delays` (n,) [s]
    after it, of either sign."""
    turn = begin_turn(die, quaternion, omega)
    for n in range(delays.shape[0]):
        carry_turn(die, turn, delays[n])
        quaternions[n, 0], quaternions[n, 1], quaternions[n, 2], quaternions[n, 3] = turned_quaternion(die, turn)
        omegas[n, 0], omegas[n, 1], omegas[n, 2] = turned_omega(die, turn)
        turn_transition(die, turn, transitions[n])


@inner_nogil
def momentum_of_turn(die: TorqueFree, quaternion: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """L of a body with this attitude (4,) that turns with ω = (x, y, z)."""
    state = np.zeros(13)
    state[3], state[4], state[5], state[6] = _quaternion_product(quaternion, die.axes, 1.0)
    return _momentum_of(die, state, x, y, z)


@inner_nogil
def omega_of_momentum(die: TorqueFree, quaternion: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """ω of a body with this attitude (4,) whose angular momentum is (x, y, z)."""
    state = np.zeros(13)
    state[3], state[4], state[5], state[6] = _quaternion_product(quaternion, die.axes, 1.0)
    return angular_velocity_of(die, state, x, y, z)


@inner_nogil
def _momentum_of(die: TorqueFree, y: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """K x, in world axes."""
    p, q, r = to_body_axes(y, a, b, c)
    return to_table_axes(y, p * die.moments[0], q * die.moments[1], r * die.moments[2])


@inner_nogil
def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner_nogil
def _quaternion_product(a: Array, b: Array, sign: float) -> tuple[float, float, float, float]:
    """Hamilton product of two quaternions; with the sign -1 that of the first and the inverse of the second."""
    w, x, y, z = b[0], sign * b[1], sign * b[2], sign * b[3]
    return (
        a[0] * w - a[1] * x - a[2] * y - a[3] * z,
        a[0] * x + a[1] * w + a[2] * z - a[3] * y,
        a[0] * y - a[1] * z + a[2] * w + a[3] * x,
        a[0] * z + a[1] * y - a[2] * x + a[3] * w,
    )
