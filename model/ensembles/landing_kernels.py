"""Compiled loops over many throws, one release after another, for `landings.ThrowSetup`.

They stand in a file of their own, because the kernels are compiled again whenever anything that their file imports
changes.
"""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from .. import engine
from ..compiled import compiled, inner
from ..engine import asymmetric
from ..throw import RELEASE_DEPTH_TOLERANCE

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

BELOW_TABLE = -1
"""Code of a release below the table, in the place of the code of an ending."""


@compiled(nogil=True)
def land_releases(setup: engine.Setup, starts: Array, impact_cap: int, landed: Indices, lowest: Indices) -> None:
    """Throw a die from every row of `starts` (n, 13) until its face is decided.

    The starts of an asymmetric die are of the centre of mass, in principal axes. Fills `landed` (n, 3) with the row of the
    face or -1, the number of impacts, and the code of the ending or BELOW_TABLE, and `lowest` (n, 1 + after) with the rows of
    the lowest faces at release and at each impact.
    """
    body = setup.body
    z_table, after = engine.table_height(setup.plane, 0.0), lowest.shape[1] - 1
    for k in range(starts.shape[0]):
        lowest[k, 0] = engine.lowest_face_row(body.normals, starts[k])
        if _lowest_clearance(body.vertices, starts[k], z_table) < -RELEASE_DEPTH_TOLERANCE * body.radius:
            landed[k, 0], landed[k, 1], landed[k, 2] = -1, 0, BELOW_TABLE
            continue
        limits = engine.Limits(inf, engine.NO_LIMIT, impact_cap, engine.TRUE)
        code, impacts, face, _, _, _, _ = _run(setup, starts[k], 0.0, limits, engine.FALSE)
        landed[k, 0], landed[k, 1], landed[k, 2] = face, impacts, code
        if after > 0:
            limits = engine.Limits(inf, after, impact_cap, engine.TRUE)
            _, _, _, _, end, log, _ = _run(setup, starts[k], 0.0, limits, engine.TRUE)
            _record_lowest_faces(body.normals, log, end, lowest[k, 1:])


def _run(setup: engine.Setup, start: Array, start_time: float, limits: engine.Limits, keep: bool) -> Any:
    """The event loop of the body."""
    if isinstance(setup.body, engine.AsymmetricBody):
        return asymmetric.run_asymmetric_throw(setup, start, start_time, limits, keep)
    return engine.run_throw(setup, start, start_time, limits, keep)


@overload(_run, strict=False, inline="always")
def _run_of(setup: Any, start: Any, start_time: Any, limits: Any, keep: Any) -> Any:
    """The branch of `_run` that the type of the body asks for, chosen when it is compiled."""

    def run_asymmetric(setup: Any, start: Any, start_time: Any, limits: Any, keep: Any) -> Any:
        return asymmetric.run_asymmetric_throw(setup, start, start_time, limits, keep)

    def run(setup: Any, start: Any, start_time: Any, limits: Any, keep: Any) -> Any:
        return engine.run_throw(setup, start, start_time, limits, keep)

    return run_asymmetric if setup[0].instance_class is engine.AsymmetricBody else run


@inner
def _lowest_clearance(vertices: Array, state: Array, z_table: float) -> float:
    """Height [m] of the lowest vertex above the table."""
    lowest = inf
    for i in range(vertices.shape[0]):
        lowest = min(lowest, engine.clearance(vertices[i], state, z_table))
    return lowest


@inner
def _record_lowest_faces(normals: Array, log: Array, end: Array, lowest: Indices) -> None:
    """Rows of the lowest faces (after,) at the logged impacts; at the end of the throw if there are fewer."""
    known = 0
    for event in range(log.shape[0]):
        if log[event, 1] >= 0.0 and known < lowest.shape[0]:
            lowest[known] = engine.lowest_face_row(normals, log[event, 2:15])
            known += 1
    for k in range(known, lowest.shape[0]):
        lowest[k] = engine.lowest_face_row(normals, end)
