"""model.throw.asymmetric_throw."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..die import Die, inner_vertices
from ..engine import FINE, LEVEL, SMOOTH, AsymmetricBody, Law, Plane, Precision
from ..engine.asymmetric import asymmetric_states_at, run_asymmetric_throw
from ..rotations import matrix_from_quat, quat_from_matrix, quat_multiply
from .motion import State
from .touch import packed_state, unpacked_state

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AsymmetricThrow:
    """A throw of a die that is no spherical top; states can be asked for at any instant of it."""

    die: Die
    plane: Plane
    code: int
    """How it ended: a code of `kernels` (RESTED, TIME_REACHED, IMPACTS_REACHED, IMPACT_CAP, SPINNING, BALANCED)."""
    impact_count: int
    landed_face: int | None
    """Number of the face that the die can no longer leave; None while that is open."""
    end_s: float
    log: Array
    """(events, kernels.ROW), states of the centre of mass, quaternions of the die's own axes."""
    knots: Array
    """(k, 15): event that began the motion (-1: the release), time [s], state as in the log."""

    @property
    def impacts(self) -> Array:
        """The rows of the log at which a vertex strikes."""
        return self.log[self.log[:, 1] >= 0.0]

    def at(self, time_s: float) -> State:
        """The state at an instant between release and end: position and velocity are those of the centroid."""
        state = self.packed_states([time_s])[0]
        return centroid_state(self.die, unpacked_state(state, time_s))

    def packed_states(self, times_s: ArrayLike) -> Array:
        """States (n, 13) of the centre of mass at times (n,) [s]."""
        top, turn, knots = self._prepared
        states = asymmetric_states_at(top, self.plane, self.log[:, 21:23], knots, np.asarray(times_s, float))
        states[:, 2] += self.die.corner_radius_m
        states[:, 3:7] = quat_multiply(states[:, 3:7], turn * [1.0, -1.0, -1.0, -1.0])
        return states

    @cached_property
    def _prepared(self) -> tuple[AsymmetricBody, Array, Array]:
        """The die in its principal axes, the quaternion from those to its own, and the knots as the kernels have them.

        Kept, because a long throw is asked for one state a flight: a thousand flights took 40 s without.
        """
        top, turn = asymmetric_body_of(self.die)
        knots = self.knots.copy()
        knots[:, 4] -= self.die.corner_radius_m
        knots[:, 5:9] = quat_multiply(knots[:, 5:9], turn)
        return top, turn, knots


def throw_asymmetric_die(
    die: Die,
    release: State,
    law: Law,
    *,
    plane: Plane = LEVEL,
    precision: Precision = FINE,
    duration_s: float = inf,
    impacts: int | None = None,
    stop_when_decided: bool = True,
    impact_cap: int = 100_000,
) -> AsymmetricThrow:
    """Follow any die, spherical top or not, from its release until its face is decided or a limit is reached.

    `release` has the centroid's position and velocity, as everywhere; `law` is the smooth impact (`kernels.SMOOTH`,
    χ first), other laws raise ValueError; `duration_s` counts from the release. Raises ValueError for a release that
    no die has or that lies below the table.
    """
    if law.code != SMOOTH:
        raise ValueError(
            f"impact law {law.code} on a {die.solid.name} that is no spherical top: wanted the smooth impact; "
            "use SmoothImpact, or a die with one moment of inertia"
        )
    plane = Plane(*(float(value) for value in plane))  # kernels are compiled for floats
    top, turn = asymmetric_body_of(die)
    start = packed_state(centre_of_mass_state(die, release))
    start[2] -= die.corner_radius_m
    start[3:7] = quat_multiply(start[3:7], turn)
    low = start[2] + float((top.vertices @ matrix_from_quat(start[3:7])[2]).min())
    low -= plane.amplitude * float(np.sin(plane.rate * release.time_s + plane.phase))
    if low < -1e-9 * top.radius:
        raise ValueError(
            f"position_m = {release.position_m.tolist()}: the lowest vertex lies {-low:.3g} m below the table; "
            "raise the die"
        )
    most = np.iinfo(np.int64).max if impacts is None else impacts
    code, count, face, end, _, log, knots = run_asymmetric_throw(
        top, law, plane, precision, start, release.time_s, duration_s, most, stop_when_decided, impact_cap, True
    )
    back = turn * np.array([1.0, -1.0, -1.0, -1.0])
    for rows, first in ((log, 2), (knots, 2)):
        rows[:, first + 2] += die.corner_radius_m
        rows[:, first + 3 : first + 7] = quat_multiply(rows[:, first + 3 : first + 7], back)
    return AsymmetricThrow(die, plane, code, count, face + 1 if face >= 0 else None, end, log, knots)


def centre_of_mass_state(die: Die, state: State) -> State:
    """The state whose position and velocity are those of the centre of mass, from the centroid's."""
    return _shifted(die, state, 1.0)


def centroid_state(die: Die, state: State) -> State:
    """The state whose position and velocity are those of the centroid, from the centre of mass's."""
    return _shifted(die, state, -1.0)


def _shifted(die: Die, state: State, sign: float) -> State:
    """The state of the point that lies `sign` centre_of_mass_m from where the state's point does."""
    if die.centre_of_mass_m is None:
        return state
    arm = sign * (state.rotation @ die.centre_of_mass_m)
    return State(
        state.time_s,
        state.position_m + arm,
        state.quaternion,
        state.velocity_m_s + np.cross(state.omega_rad_s, arm),
        state.omega_rad_s,
    )


def asymmetric_body_of(die: Die) -> tuple[AsymmetricBody, Array]:
    """The die in its principal axes, and the quaternion (4,) that takes those axes to the die's.

    Corners are those of the inner solid; heights then count from `corner_radius_m` above the table, because a vertical
    force through the lowest point of a rounded corner passes through its centre. Raises ValueError where the centre of
    mass lies in the rounded shell.
    """
    solid = die.solid
    shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    tensor = die.inertia_kg_m2 * np.eye(3) if die.is_spherical_top else np.asarray(die.inertia_tensor_kg_m2)
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    vertices = (inner_vertices(solid, die.corner_radius_m) - shift) @ axes
    offsets = solid.offsets - die.corner_radius_m - solid.normals @ shift
    if offsets.min() <= 0.0:
        raise ValueError(
            f"centre_of_mass_m = {shift.tolist()}: wanted it deeper inside the {solid.name} than its corner radius "
            f"of {die.corner_radius_m:.6g} m"
        )
    corners = np.full((len(solid.faces), max(len(face) for face in solid.faces)), -1, np.int64)
    for k, face in enumerate(solid.faces):
        corners[k, : len(face)] = face
    ends = vertices[solid.edges]
    barriers = np.array([_edge_barrier(a, b, moments) for a, b in ends])
    top = AsymmetricBody(
        np.ascontiguousarray(vertices),
        np.ascontiguousarray(solid.normals @ axes),
        offsets,
        corners,
        solid.edge_faces,
        np.ascontiguousarray(barriers[:, 0]),
        np.ascontiguousarray(barriers[:, 1]),
        float(die.mass_kg),
        moments,
        float(np.linalg.norm(vertices, axis=1).max()),
    )
    return top, quat_from_matrix(axes)


def _edge_barrier(a: Array, b: Array, moments: Array) -> tuple[float, float]:
    """Least distance [m] of the edge from a to b, and the largest moment of inertia about a line through it."""
    along = b - a
    foot = a + np.clip(-(a @ along) / (along @ along), 0.0, 1.0) * along
    e1 = a / np.linalg.norm(a)
    e2 = b - (b @ e1) * e1
    e2 /= np.linalg.norm(e2)
    reach = np.arctan2(b @ e2, b @ e1)
    # d = e1 cos θ + e2 sin θ has d·I d = mean + p cos 2θ + q sin 2θ: largest at 2θ = atan2(q, p), or at an end.
    best = 0.5 * np.arctan2(2.0 * (e1 @ (moments * e2)), e1 @ (moments * e1) - e2 @ (moments * e2)) % np.pi
    angles = np.array([0.0, reach, best if best < reach else 0.0])
    d = np.outer(np.cos(angles), e1) + np.outer(np.sin(angles), e2)
    return float(np.linalg.norm(foot)), float((d**2 @ moments).max())
