"""model.engine.log."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
from numba.extending import overload

from ..compiled import compiled, inner
from .types import Array, Body, Law, Plane, RoughLaw


@compiled
def lowest_face_row(normals: Array, state: Array) -> int:
    """Row of the face normal (faces, 3) that points down most."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    # Third row of the rotation matrix.
    a, b, c = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    best, lowest = 0, inf
    for k in range(normals.shape[0]):
        down = normals[k, 0] * a + normals[k, 1] * b + normals[k, 2] * c
        if down < lowest:
            best, lowest = k, down
    return best


@compiled
def decided_face(body: Body, law: Law, plane: Plane, state: Array) -> int:
    """Row of the face that the die can no longer leave, or -1; see `simulate`."""
    energy = energy_per_mass(body, plane, state)
    if has_friction(law):
        if plane.gx != 0.0 or plane.gy != 0.0:
            return -1  # the slope goes on feeding the slip, so that only a die at rest has landed
        # Friction can turn the rest of the energy into what lifts the die.
        energy += 0.5 * (state[7] * state[7] + state[8] * state[8])
        energy += 0.5 * body.inertia / body.mass * state[12] * state[12]
    if energy >= plane.g * body.radius:
        return -1  # no edge is farther from the centre than a corner
    face = lowest_face_row(body.plumb_normals, state)
    return face if energy < plane.g * body.barrier_heights[face] else -1


def has_friction(law: Law) -> bool:
    """Whether the law has friction."""
    return isinstance(law, RoughLaw)


@overload(has_friction, strict=False)
def _rubs(law: Any) -> Any:
    rough = law.instance_class is RoughLaw
    return lambda law: rough


@inner
def energy_per_mass(body: Body, plane: Plane, state: Array) -> float:
    """The energy per mass [m²/s²] that vertical forces can change: without ω_z and the horizontal velocity."""
    turning = body.inertia / body.mass * (state[10] * state[10] + state[11] * state[11])
    return plane.g * state[2] + 0.5 * (state[9] * state[9] + turning)


@inner
def copy_to(target: Array, source: Array) -> None:
    """Give every number of `target` (n,) the value that it has in `source` (n,)."""
    for k in range(target.shape[0]):
        target[k] = source[k]


@inner
def copy_columns(target: Array, source: Array, columns: int) -> None:
    """The same of the first `columns` of arrays with twelve rows."""
    for k in range(12):
        for c in range(columns):
            target[k, c] = source[k, c]


@inner
def state_after(row: Array, state: Array) -> None:
    """Fill `state` (13,) with that after a logged event (ROW,)."""
    for k in range(7):
        state[k] = row[2 + k]
    for k in range(6):
        state[7 + k] = row[15 + k]


@inner
def write_knot(row: Array, segment: int, time: float, state: Array) -> None:
    """Write a state in held contact into a row (15,)."""
    row[0], row[1] = segment, time
    for k in range(13):
        row[2 + k] = state[k]


@inner
def doubled_rows(rows: Array) -> Array:
    """The same rows with room for as many again."""
    larger = np.empty((2 * rows.shape[0], rows.shape[1]))
    for k in range(rows.shape[0]):
        for m in range(rows.shape[1]):
            larger[k, m] = rows[k, m]
    return larger


@inner
def write_event(row: Array, time: float, vertex: int, before: Array, after: Array, i: float, j: int) -> None:
    """Write one event into a row (ROW,)."""
    row[0] = time
    row[1] = vertex
    for k in range(13):
        row[2 + k] = before[k]
    for k in range(6):
        row[15 + k] = after[7 + k]
    row[21] = i
    row[22] = j
