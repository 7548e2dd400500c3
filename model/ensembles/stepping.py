"""Throws in fixed time steps, as general physics engines compute them: a comparison for the event-driven simulation.

In each step of length h the die moves freely (v += h g, then x += h v, the symplectic Euler method; the orientation
turns by h ω). Then the lowest vertex, if it is below the table and still sinks, receives the paper's smooth impulse,
repeatedly until no vertex below the table sinks, and the die is lifted out of the table. An impact is late by up to h
and has the wrong arm, so the error of a throw is proportional to h until rounding dominates. A throw ends when its
energy no longer suffices to lift the die over an edge of its lowest face, exactly as in `throw.simulate`.

The state can be kept in single precision. It is then rounded after every step, as by an engine that stores float32.

Only smooth impacts of a sharp spherical top on a level table at rest.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from ..die import Die
from ..engine import Body
from ..errors import InputError
from ..throw import body_of
from ..world import GRAVITY_M_S2

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_STEPS = 10_000_000
"""Steps after which a throw is stopped without a face: 10 s in steps of a microsecond."""

IMPULSES_PER_VERTEX = 4
"""Impulses in one step, for each vertex of the die, after which the step ends even if a vertex below the table still sinks."""


def stepped_landings(die: Die, chi: float, starts: Array, step_s: float, *, single: bool = False) -> Indices:
    """Numbers (n,) of the faces on which throws from `starts` (n, 13) land, in steps of `step_s` [s]; 0 for none.

    A start is position [m], quaternion wxyz, velocity [m/s] and angular velocity [rad/s], world axes. `single` keeps the
    state in float32. Raises ValueError for a loaded or rounded die, a χ outside 0 to 1, and a step that is not above 0.
    """
    if not die.is_spherical_top or die.corner_radius_m > 0.0:
        raise InputError(f"a {die.solid.name} that is loaded or rounded: wanted a sharp spherical top; use throw_die")
    if not 0.0 <= chi <= 1.0:
        raise InputError(f"chi = {chi}: wanted 0 to 1")
    if not (np.isfinite(step_s) and step_s > 0.0):
        raise InputError(f"step_s = {step_s}: wanted a time above 0 s")
    body = body_of(die)
    states = np.array(starts, np.float32 if single else np.float64)
    landed = np.empty(len(states), np.int64)
    _step_many(body, chi, step_s, states, landed)
    return landed


@compiled(nogil=True)
def _step_many(body: Body, chi: float, h: float, states: Array, landed: Indices) -> None:
    """Step every row of `states` (n, 13), by steps of h [s], until its face is decided."""
    arms, inertia = np.empty((body.vertices.shape[0], 3)), body.inertia / body.mass
    for k in range(states.shape[0]):
        landed[k] = 0
        state = states[k]
        for _ in range(MAX_STEPS):
            _move_freely(state, h)
            _lever_arms(body.vertices, state, arms)
            _apply_impulses(arms, state, chi, inertia)
            face = _decided_face(body, state)
            if face >= 0:
                landed[k] = face + 1
                break


@compiled
def _move_freely(state: Array, h: float) -> None:
    """Free motion over one step."""
    state[9] -= h * GRAVITY_M_S2
    for j in range(3):
        state[j] += h * state[7 + j]
    x, y, z = 0.5 * h * state[10], 0.5 * h * state[11], 0.5 * h * state[12]
    w, a, b, c = state[3], state[4], state[5], state[6]
    # A first-order step of the quaternion, normalised, as engines do.
    w, a, b, c = (
        w - x * a - y * b - z * c,
        a + x * w + y * c - z * b,
        b + y * w + z * a - x * c,
        c + z * w + x * b - y * a,
    )
    size = sqrt(w * w + a * a + b * b + c * c)
    state[3], state[4], state[5], state[6] = w / size, a / size, b / size, c / size


@compiled
def _lever_arms(vertices: Array, state: Array, arms: Array) -> None:
    """Vertices (n, 3) from the centre, in world axes."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    for i in range(vertices.shape[0]):
        a, b, c = vertices[i]
        tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        arms[i, 0] = a + w * tx + y * tz - z * ty
        arms[i, 1] = b + w * ty + z * tx - x * tz
        arms[i, 2] = c + w * tz + x * ty - y * tx


@compiled
def _apply_impulses(arms: Array, state: Array, chi: float, inertia: float) -> None:
    """Apply smooth impulses to the sinking vertices below the table, the lowest first, then lift the die out of the table."""
    deepest = 0.0
    for _ in range(IMPULSES_PER_VERTEX * arms.shape[0]):
        lowest, at = 0.0, -1
        for i in range(arms.shape[0]):
            height = state[2] + arms[i, 2]
            deepest = min(deepest, height)
            if height < lowest and state[9] + state[10] * arms[i, 1] - state[11] * arms[i, 0] < 0.0:
                lowest, at = height, i
        if at < 0:
            break
        x, y = arms[at, 0], arms[at, 1]
        sinking = state[9] + state[10] * y - state[11] * x
        impulse = -(1.0 + chi) * sinking / (1.0 + (x * x + y * y) / inertia)
        state[9] += impulse
        state[10] += impulse * y / inertia
        state[11] -= impulse * x / inertia
    state[2] -= deepest


@compiled
def _decided_face(body: Body, state: Array) -> int:
    """Row of the face that the die can no longer leave, or -1; see `throw.simulate`."""
    turning = body.inertia / body.mass * (state[10] * state[10] + state[11] * state[11])
    energy = GRAVITY_M_S2 * state[2] + 0.5 * (state[9] * state[9] + turning)
    if energy >= GRAVITY_M_S2 * body.barrier_heights.max():
        return -1
    w, x, y, z = state[3], state[4], state[5], state[6]
    up_x, up_y, up_z = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    best, face = 0.0, -1
    for k in range(body.plumb_normals.shape[0]):
        nx, ny, nz = body.plumb_normals[k]
        down = -(up_x * nx + up_y * ny + up_z * nz)
        if down > best:
            best, face = down, k
    return face if energy < GRAVITY_M_S2 * body.barrier_heights[face] else -1
