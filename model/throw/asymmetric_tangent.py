"""Derivatives of the throw of an asymmetric die: what differs from `tangent`, which has the method.

The kernel (`engine.asymmetric.run_asymmetric_tangent`) follows the centre of mass, the attitude and the angular
momentum L, which is constant in flight. With W = R I⁻¹ Rᵀ, so that ω = W L, a turn δ of the attitude obeys

    δω = δ × ω + W (δL - δ × L),    δ' = δω - δ × ω = W (δL - δ × L).

These linear equations are integrated with the same steps and the same method as the attitude itself. At an impact, with
the lever t = r × ẑ, S = -(1 + χ) u/(1/m + t·W t) and ΔL = S t, where δ(t·W t) = 2 δt·W t + 2 t·(δ × W t);
with friction, see `engine.asymmetric.impact`.

Everything else counts from the state of the centroid. With s the centre of mass in body axes, a = R s and K = R I Rᵀ,

    p + a,    v + ω × a,    L = K ω;    δL = K δω + δ × L - K (δ × ω).

If s changes by δs, the centre of mass moves by R δs, and every corner by -δs in the kernel's axes. The tensor stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die
from ..engine import asymmetric, derivatives
from ..laws import Table
from ..rotations import cross_matrix, matrix_from_quat, quat_conjugate, quat_multiply
from .body import asymmetric_body_of, centre_of_mass_state, packed_state, unpacked_state
from .history import asymmetric_impacts, free_flight, states_after_events
from .motion import State, Throw

Array = NDArray[np.float64]

CENTRE_OF_MASS_AXES = {
    "centre_of_mass_x_m": np.array([1.0, 0.0, 0.0]),
    "centre_of_mass_y_m": np.array([0.0, 1.0, 0.0]),
    "centre_of_mass_z_m": np.array([0.0, 0.0, 1.0]),
}
"""Body axes along which the centre of mass moves, by parameter."""

CACHED_BODIES = 16
"""Dice whose kernel records are kept, because a fit asks for the same die again and again."""

_body = lru_cache(maxsize=CACHED_BODIES)(asymmetric_body_of)


class TangentRun(NamedTuple):
    """Law and table, and the arguments of the tangent kernels after the setup, in their order."""

    law: engine.Law
    plane: engine.Plane
    air: engine.Vacuum | engine.Air
    start: Array
    """(13,) packed, in the table's axes."""
    start_time_s: float
    times_s: Array
    """(n,) ascending."""
    sequence: derivatives.ImpactSequence
    start_jacobian: Array
    """(12, 12 + m) derivatives of the packed start by the start in world axes and the parameters."""
    parameter_derivatives: derivatives.ParameterDerivatives


def run_asymmetric_tangent(
    die: Die, parameters: Sequence[str], run: TangentRun
) -> tuple[int, Array, Array, Array, Array]:
    """As `engine.derivatives.run_tangent`, with input and output of the centroid and ω. The log is that of `AsymmetricThrow`.

    Without drag (`supported`).
    """
    body, body_from_principal = _body(die)
    by_parameter = run.parameter_derivatives
    start = packed_state(centre_of_mass_state(die, unpacked_state(run.start, run.start_time_s)))
    start[3:7] = quat_multiply(start[3:7], body_from_principal)
    code, poses, jacobian, log, impact_jacobian = asymmetric.run_asymmetric_tangent(
        engine.Setup(body, run.law, run.plane, engine.FINE),
        start,
        run.start_time_s,
        run.times_s,
        run.sequence,
        _jacobian_of_centre(die, parameters, run),
        by_parameter._replace(vertices=by_parameter.vertices @ matrix_from_quat(body_from_principal)),
    )
    poses[:, 3:] = quat_multiply(poses[:, 3:], quat_conjugate(body_from_principal))
    log[:, 4] += die.corner_radius_m
    log[:, 5:9] = quat_multiply(log[:, 5:9], quat_conjugate(body_from_principal))
    _to_centroid(die, parameters, poses, jacobian)
    return code, poses, jacobian, log, impact_jacobian


def _jacobian_of_centre(die: Die, parameters: Sequence[str], run: TangentRun) -> Array:
    """Derivatives (12, 12 + m) of centre of mass, attitude, its velocity and L, from those of the centroid and ω."""
    rotation, omega = matrix_from_quat(run.start[3:7]), run.start[10:13]
    tensor = rotation @ die.tensor_kg_m2 @ rotation.T
    cross_omega, cross_arm = cross_matrix(omega), cross_matrix(rotation @ die.centre_of_mass_offset_m)
    given = run.start_jacobian
    out = given.copy()
    out[:3] -= cross_arm @ given[3:6]
    out[6:9] -= cross_arm @ given[9:12] + cross_omega @ cross_arm @ given[3:6]
    out[9:12] = tensor @ given[9:12] + (tensor @ cross_omega - cross_matrix(tensor @ omega)) @ given[3:6]
    for column, name in enumerate(parameters, 12):
        if name in CENTRE_OF_MASS_AXES:
            out[:3, column] += rotation @ CENTRE_OF_MASS_AXES[name]
            out[6:9, column] += cross_omega @ rotation @ CENTRE_OF_MASS_AXES[name]
    out[9:12, 12:] += np.outer(omega, run.parameter_derivatives.inertia)
    return out


def _to_centroid(die: Die, parameters: Sequence[str], poses: Array, jacobian: Array) -> None:
    """Turn poses (n, 7) and derivatives (n, 6, 12 + m) of the centre of mass into those of the centroid, in place."""
    rotations = matrix_from_quat(poses[:, 3:])
    arms = rotations @ die.centre_of_mass_offset_m
    poses[:, :3] -= arms
    jacobian[:, :3] += cross_matrix(arms) @ jacobian[:, 3:]
    for column, name in enumerate(parameters, 12):
        if name in CENTRE_OF_MASS_AXES:
            jacobian[:, :3, column] -= rotations @ CENTRE_OF_MASS_AXES[name]


def throw_from_flights(die: Die, start: State, table: Table, log: Array, end_s: float) -> Throw:
    """The Throw of a start and a log of impacts, as `run_asymmetric_tangent` returns it."""
    starts = [start, *states_after_events(die, table, log)]
    ends = [*(float(t) for t in log[:, 0]), end_s]
    flights = tuple(free_flight(die, s, e, table.gravity_m_s2) for s, e in zip(starts, ends, strict=True))
    return Throw(flights, asymmetric_impacts(die, table, log, flights))
