"""Derivatives of the throw of a die that is no spherical top; `tangent` has the method, this what is different.

The kernel (`tops.run_asymmetric_tangent`) has the centre of mass, the attitude and the angular momentum L, which is constant in
flight. With W = R I⁻¹ Rᵀ, so that ω = W L, a turn δ of the attitude obeys

    δω = δ × ω + W (δL - δ × L),    δ' = δω - δ × ω = W (δL - δ × L),

linear equations with the same step and the same method as the attitude itself. At an impact, with the lever t = r × ẑ,
S = -(1 + χ) u/(1/m + t·W t) and ΔL = S t, where δ(t·W t) = 2 δt·W t + 2 t·(δ × W t).

From the state of the centroid, where everything else counts from: with s the centre of mass in the body, a = R s and
K = R I Rᵀ,

    p + a,    v + ω × a,    L = K ω;    δL = K δω + δ × L - K (δ × ω).

When s changes by δs, the centre of mass moves by R δs and, in principal axes, every corner by -δs. The tensor stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import engine
from ..die import Die
from ..engine import asymmetric
from ..laws import Table
from ..rotations import matrix_from_quat, quat_conjugate, quat_multiply
from ..world import GRAVITY_M_S2
from . import asymmetric_throw
from .history import asymmetric_impacts, rotated_state
from .motion import Flight, State, Throw
from .touch import packed_state, unpacked_state

Array = NDArray[np.float64]

SHIFTS = {
    "centre_of_mass_x_m": np.array([1.0, 0.0, 0.0]),
    "centre_of_mass_y_m": np.array([0.0, 1.0, 0.0]),
    "centre_of_mass_z_m": np.array([0.0, 0.0, 1.0]),
}
"""Body axes along which the centre of mass moves, by parameter."""

_top = lru_cache(maxsize=16)(asymmetric_throw.asymmetric_body_of)
"""A fit asks for the same die again and again."""


def run_tangent(
    die: Die,
    parameters: Sequence[str],
    law: engine.Law,
    plane: engine.Plane,
    air: engine.Vacuum | engine.Air,
    start: Array,
    start_time: float,
    times: Array,
    sequence: NDArray[np.int64],
    free: bool,
    impact_cap: int,
    seed: Array,
    sources: engine.ParameterDerivatives,
) -> tuple[int, Array, Array, Array, Array]:
    """As `kernels.run_tangent`, in and out in terms of the centroid and ω. The log alone is that of `tops.AsymmetricThrow`."""
    if law.code != engine.SMOOTH:
        raise ValueError(
            f"impact law {law.code} on a {die.solid.name} that is no spherical top: wanted the smooth impact; "
            "use SmoothImpact, or a die with one moment of inertia and no parameter of its centre of mass"
        )
    if isinstance(air, engine.Air):
        raise ValueError(
            f"drag_per_m on a {die.solid.name} that is no spherical top: wanted no drag; leave it out, or use a die with "
            "one moment of inertia and no parameter of its centre of mass"
        )
    top, turn = _top(die)
    axes = matrix_from_quat(turn)
    first = packed_state(asymmetric_throw.centre_of_mass_state(die, unpacked_state(start, start_time)))
    first[3:7] = quat_multiply(first[3:7], turn)
    code, poses, jacobian, log, impact_jacobian = asymmetric.run_asymmetric_tangent(
        top,
        law,
        plane,
        first,
        start_time,
        times,
        sequence,
        free,
        impact_cap,
        _of_centre(die, parameters, start, seed, sources),
        sources._replace(vertices=sources.vertices @ axes),
    )
    poses[:, 3:] = quat_multiply(poses[:, 3:], quat_conjugate(turn))
    log[:, 4] += die.corner_radius_m
    log[:, 5:9] = quat_multiply(log[:, 5:9], quat_conjugate(turn))
    _to_centroid(die, parameters, poses, jacobian)
    return code, poses, jacobian, log, impact_jacobian


def _of_centre(
    die: Die, parameters: Sequence[str], start: Array, seed: Array, sources: engine.ParameterDerivatives
) -> Array:
    """Derivatives (12, 12 + m) of centre of mass, attitude, its velocity and L, from those of the centroid and ω."""
    rotation, omega = matrix_from_quat(start[3:7]), start[10:13]
    tensor = rotation @ _tensor(die) @ rotation.T
    spinning, levering = cross_matrix(omega), cross_matrix(rotation @ _shift(die))
    out = seed.copy()
    out[:3] -= levering @ seed[3:6]
    out[6:9] -= levering @ seed[9:12] + spinning @ levering @ seed[3:6]
    out[9:12] = tensor @ seed[9:12] + (tensor @ spinning - cross_matrix(tensor @ omega)) @ seed[3:6]
    for column, name in enumerate(parameters, 12):
        if name in SHIFTS:
            out[:3, column] += rotation @ SHIFTS[name]
            out[6:9, column] += spinning @ rotation @ SHIFTS[name]
    out[9:12, 12:] += np.outer(omega, sources.inertia)
    return out


def _to_centroid(die: Die, parameters: Sequence[str], poses: Array, jacobian: Array) -> None:
    """Poses (n, 7) and derivatives (n, 6, 12 + m) of the centre of mass become those of the centroid, in place."""
    rotations = matrix_from_quat(poses[:, 3:])
    arms = rotations @ _shift(die)
    poses[:, :3] -= arms
    jacobian[:, :3] += cross_matrix(arms) @ jacobian[:, 3:]
    for column, name in enumerate(parameters, 12):
        if name in SHIFTS:
            jacobian[:, :3, column] -= rotations @ SHIFTS[name]


def _shift(die: Die) -> Array:
    """(3,) [m] of the centre of mass from the centroid, body axes."""
    return np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m


def _tensor(die: Die) -> Array:
    """(3, 3) [kg m²], body axes."""
    return die.inertia_kg_m2 * np.eye(3) if die.inertia_tensor_kg_m2 is None else die.inertia_tensor_kg_m2


def cross_matrix(vectors: Array) -> Array:
    """Matrices (..., 3, 3) that take a vector to the cross product of `vectors` (..., 3) with it."""
    out = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -vectors[..., k], vectors[..., k]
    return out


@dataclass(frozen=True, eq=False, kw_only=True)
class AsymmetricFlight(Flight):
    """Free flight of a die that is no spherical top; before and after it, where the same motion would lead."""

    die: Die
    table: Table

    def at(self, time_s: float) -> State:
        """The state at any instant."""
        centre = asymmetric_throw.centre_of_mass_state(self.die, self.start)
        delay = time_s - self.start.time_s
        position = centre.position_m + centre.velocity_m_s * delay
        position[2] -= 0.5 * GRAVITY_M_S2 * delay**2
        velocity = centre.velocity_m_s - np.array([0.0, 0.0, GRAVITY_M_S2 * delay])
        quaternion = self._quaternions(np.array([delay]))[0]
        before, after = matrix_from_quat(centre.quaternion), matrix_from_quat(quaternion)
        momentum = before @ _tensor(self.die) @ before.T @ centre.omega_rad_s
        omega = after @ np.linalg.solve(_tensor(self.die), after.T @ momentum)
        return asymmetric_throw.centroid_state(self.die, State(time_s, position, quaternion, velocity, omega))

    def poses(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and quaternions (n, 4) wxyz at times (n,) [s]."""
        centre = asymmetric_throw.centre_of_mass_state(self.die, self.start)
        delays = np.atleast_1d(np.asarray(times_s, float)) - self.start.time_s
        positions = centre.position_m + np.outer(delays, centre.velocity_m_s)
        positions[:, 2] -= 0.5 * GRAVITY_M_S2 * delays**2
        quaternions = self._quaternions(delays)
        return positions - matrix_from_quat(quaternions) @ _shift(self.die), quaternions

    def _quaternions(self, delays: Array) -> Array:
        """Attitudes (n, 4) that many seconds after the start."""
        top, turn = _top(self.die)
        packed = packed_state(self.start)
        packed[3:7] = quat_multiply(packed[3:7], turn)
        return quat_multiply(asymmetric.attitudes_in_flight(top, packed, delays), quat_conjugate(turn))


def throw_from_flights(die: Die, start: State, table: Table, log: Array, end_s: float) -> Throw:
    """The Throw of a start and a log of impacts, as `run_tangent` returns it."""
    after = [
        asymmetric_throw.centroid_state(die, unpacked_state(np.concatenate([row[2:9], row[15:21]]), row[0]))
        for row in log
    ]
    starts = [start, *(rotated_state(state, table.world_from_table) if table.tilt_rad else state for state in after)]
    ends = [*(float(t) for t in log[:, 0]), end_s]
    flights = tuple(AsymmetricFlight(start=s, end_s=e, die=die, table=table) for s, e in zip(starts, ends, strict=True))
    return Throw(flights, asymmetric_impacts(die, table, log, flights))
