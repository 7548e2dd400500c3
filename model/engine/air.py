"""Flight against the quadratic drag of the air, with its derivatives.

The centre of mass obeys v' = g - k |v| v, and a disturbance (δp, δv) of it

    δp' = δv,    δv' = -k (|v| δv + (v·δv)/|v| v) - δk |v| v + δg.

Both are integrated together by the method of order 8 of `runge_kutta`. Drag does not turn the die.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inner
from .runge_kutta import STAGES, START, VALUES, stage_values
from .types import Array, Plane


class Vacuum(NamedTuple):
    """Nothing but gravity acts in flight."""

    drag: float
    """0 [1/m]."""


class Air(NamedTuple):
    """Quadratic drag: a type of its own, so that a flight without it does not compile it."""

    drag: float
    """k [1/m]."""
    by_drag: Array
    """(m,) derivatives of k by the parameters."""


AIR_STEP_S = 0.005
"""[s] of a step through the air, at most. The velocity of a throw changes its direction in some 0.1 s, and drag is a tenth of
gravity or less. The error is 1e-14 m in a flight, and 1e-11 m where the die nearly stands still at the top, where |v| is no
smooth function of time."""

FLOW_SIZE = 49
"""Numbers that a flight through the air carries along: p, v, seven pairs (δp, δv), and the time [s] since its start. The
pairs are the derivatives by k, by v at the start (3), and by gravity (3)."""


@inner
def drag_acceleration(drag: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """-k |v| v [m/s²] at a velocity [m/s], by the drag k [1/m]."""
    rate = 0.0 if drag == 0.0 else -drag * sqrt(vx * vx + vy * vy + vz * vz)
    return rate * vx, rate * vy, rate * vz


@inner
def start_flow(state: Array, flow: Array) -> None:
    """Make `flow` (FLOW_SIZE,) that of a flight that begins with `state` (13,)."""
    for k in range(FLOW_SIZE):
        flow[k] = 0.0
    for k in range(3):
        flow[k], flow[3 + k] = state[k], state[7 + k]
    flow[15], flow[22], flow[29] = 1.0, 1.0, 1.0


@inner
def integrate_flow(drag: float, plane: Plane, flow: Array, dt: float) -> None:
    """Carry `flow` (FLOW_SIZE,) through `dt` [s] of flight, of either sign, in place."""
    steps = max(1, ceil(abs(dt) / AIR_STEP_S))
    room = np.empty((14, FLOW_SIZE))
    for _ in range(steps):
        for k in range(FLOW_SIZE):
            room[START, k] = flow[k]
        for stage in range(STAGES + 1):
            stage_values(room, stage, dt / steps, FLOW_SIZE)
            if stage < STAGES:
                _flow_rates(drag, plane, room[VALUES], room[stage])
        for k in range(FLOW_SIZE):
            flow[k] = room[VALUES, k]


@inner
def _flow_rates(drag: float, plane: Plane, flow: Array, out: Array) -> None:
    """Fill `out` (FLOW_SIZE,) with the rates of `flow`."""
    vx, vy, vz = flow[3], flow[4], flow[5]
    speed = sqrt(vx * vx + vy * vy + vz * vz)
    out[0], out[1], out[2] = vx, vy, vz
    out[3] = plane.gx - drag * speed * vx
    out[4] = plane.gy - drag * speed * vy
    out[5] = -plane.g - drag * speed * vz
    for c in range(7):
        at = 6 + 6 * c
        dx, dy, dz = flow[at + 3], flow[at + 4], flow[at + 5]
        along = (vx * dx + vy * dy + vz * dz) / speed if speed > 0.0 else 0.0
        out[at], out[at + 1], out[at + 2] = dx, dy, dz
        out[at + 3] = -drag * (speed * dx + along * vx)
        out[at + 4] = -drag * (speed * dy + along * vy)
        out[at + 5] = -drag * (speed * dz + along * vz)
        if c == 0:
            out[9] -= speed * vx
            out[10] -= speed * vy
            out[11] -= speed * vz
        elif c >= 4:
            out[at + c - 1] += 1.0
    out[48] = 1.0


@compiled
def drag_trajectory(drag: float, gravity: float, start: Array, delays: Array) -> Array:
    """Positions and velocities (n, 6) `delays` (n,) [s] after a flight began with `start` (13,), in world axes."""
    level = Plane(0.0, 0.0, gravity, 0.0, 0.0, 0.0)
    flow, out = np.empty(FLOW_SIZE), np.empty((delays.shape[0], 6))
    for n in range(delays.shape[0]):
        start_flow(start, flow)
        integrate_flow(drag, level, flow, delays[n])
        for k in range(6):
            out[n, k] = flow[k]
    return out
