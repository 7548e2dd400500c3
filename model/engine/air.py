"""model.engine.air."""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inner
from .log import copy_to
from .types import LEVEL, RUNGE_KUTTA_A, RUNGE_KUTTA_B, Array, Plane


@inner
def braking(drag: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """Acceleration [m/s²] by quadratic drag [1/m]: -k |v| v."""
    rate = 0.0 if drag == 0.0 else -drag * sqrt(vx * vx + vy * vy + vz * vz)
    return rate * vx, rate * vy, rate * vz


class Vacuum(NamedTuple):
    """Nothing but gravity acts in flight."""

    drag: float
    """0."""


class Air(NamedTuple):
    """Quadratic drag, v' = g - k |v| v: a type of its own, so that a flight without it does not even compile it."""

    drag: float
    """k [1/m]."""
    by_drag: Array
    """(m,) derivatives of k by the parameters."""


AIR_STEP_S = 0.005
"""[s] of a step of the method of order 8 through the air, at most. A throw's velocity changes its direction in some
0.1 s, and drag is a tenth of gravity or less: an error of 1e-14 m in a flight, and of 1e-11 m where the die nearly
stands still at the top, where |v| is no smooth function of time."""

FLOW_SIZE = 49
"""Numbers that a flight through the air carries along: p, v, seven pairs of disturbances of p and of v, and the time
[s] since its start. The pairs are the derivatives by k, by v at the start (3), and by gravity (3)."""


@inner
def flow_rates(drag: float, plane: Plane, flow: Array, out: Array) -> None:
    """Fill `out` (FLOW,) with the rates of `flow`."""
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


@inner
def integrate_flow(drag: float, plane: Plane, flow: Array, dt: float) -> None:
    """Carry `flow` (FLOW,) through `dt` [s] of flight, of either sign, in place."""
    steps = max(1, ceil(abs(dt) / AIR_STEP_S))
    stages, now = np.empty((12, FLOW_SIZE)), np.empty(FLOW_SIZE)
    for _ in range(steps):
        for s in range(13):
            copy_to(now, flow)
            for n in range(s):
                weight = dt / steps * (RUNGE_KUTTA_A[s, n] if s < 12 else RUNGE_KUTTA_B[n])
                if weight != 0.0:
                    for k in range(FLOW_SIZE):
                        now[k] += weight * stages[n, k]
            if s < 12:
                flow_rates(drag, plane, now, stages[s])
        copy_to(flow, now)


@inner
def start_flow(state: Array, flow: Array) -> None:
    """Make `flow` (FLOW,) that of a flight that begins with `state`."""
    for k in range(FLOW_SIZE):
        flow[k] = 0.0
    for k in range(3):
        flow[k], flow[3 + k] = state[k], state[7 + k]
    flow[15], flow[22], flow[29] = 1.0, 1.0, 1.0


@compiled
def drag_trajectory(drag: float, start: Array, delays: Array) -> Array:
    """Positions and velocities (n, 6) that many seconds (n,) after a flight began with `start` (13,), world axes."""
    flow, out = np.empty(FLOW_SIZE), np.empty((delays.shape[0], 6))
    for n in range(delays.shape[0]):
        start_flow(start, flow)
        integrate_flow(drag, LEVEL, flow, delays[n])
        for k in range(6):
            out[n, k] = flow[k]
    return out
