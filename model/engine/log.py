"""The log of a throw: rows of events and of knots, and copies of arrays without numba's check of shapes."""

from __future__ import annotations

from math import nan

import numpy as np
from numpy.typing import NDArray

from ..compiled import inner
from .types import Array, Indices, Knots


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
def fill_with_nan(poses: Array, jacobian: Array, first: int) -> None:
    """Make the poses (n, 7) and derivatives (n, 6, m) from row `first` on NaN."""
    for k in range(first, poses.shape[0]):
        for m in range(7):
            poses[k, m] = nan
        for m in range(6):
            for c in range(jacobian.shape[2]):
                jacobian[k, m, c] = nan


@inner
def with_room(rows: Array, used: int) -> Array:
    """The same rows, or a copy with twice as many where all are used."""
    if used < rows.shape[0]:
        return rows
    larger = np.empty((2 * rows.shape[0], rows.shape[1]))
    for k in range(rows.shape[0]):
        for m in range(rows.shape[1]):
            larger[k, m] = rows[k, m]
    return larger


@inner
def write_event(
    row: Array, time: float, vertex: int, before: Array, after: Array, i: float, j: int, struck: float
) -> None:
    """Write one event into a row (LOG_COLUMNS,): the states (13,) before and after, the contact (i, j) from then on, and the bits
    of the vertices that struck together."""
    row[0] = time
    row[1] = vertex
    for k in range(13):
        row[2 + k] = before[k]
    for k in range(6):
        row[15 + k] = after[7 + k]
    row[21] = i
    row[22] = j
    row[23] = struck


@inner
def state_after(row: Array, state: Array) -> None:
    """Fill `state` (13,) with that after a logged event (LOG_COLUMNS,)."""
    for k in range(7):
        state[k] = row[2 + k]
    for k in range(6):
        state[7 + k] = row[15 + k]


@inner
def with_knot(knots: Knots, time: float, state: Array) -> Knots:
    """The knots with one more, the state at `time` [s], if any are kept."""
    if not knots.keep:
        return knots
    rows = with_room(knots.rows, knots.used)
    row = rows[knots.used]
    row[0], row[1] = knots.event, time
    for k in range(13):
        row[2 + k] = state[k]
    return Knots(rows, knots.used + 1, knots.event, knots.keep)


@inner
def bits_of(active: NDArray[np.bool_]) -> float:
    """The active vertices as one number, 2^k for vertex k."""
    bits = 0.0
    for k in range(active.shape[0]):
        bits += 2.0**k if active[k] else 0.0
    return bits


@inner
def bits_of_rows(rows: Indices, n: int) -> float:
    """The first n vertices of a list as one number, 2^k for vertex k."""
    bits = 0.0
    for m in range(n):
        bits += 2.0 ** rows[m]
    return bits
