"""From a die and its states to the records and arrays of the compiled kernels, and back.

**Rounded corners** touch the table with spheres about the corners of the inner polyhedron (the face planes moved
inwards by the radius ρ). Without friction that is the sharp die of the inner polyhedron with all heights counted from
ρ, because a vertical force has the same moment at the lowest point of a sphere as at its centre. With friction the arm
is ρ longer downwards.

**Centre of mass.** The kernels follow the centre of mass. A die with an isotropic tensor about another point than the
centroid flies as a spherical top: its vertices count from the centre of mass, `kernel_states` gives the states of that
point, and `world_poses` gives back the poses of the centroid. A die with an anisotropic tensor becomes an
`AsymmetricBody` in its principal axes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import INSPHERE_TOLERANCE, Die, Solid, inner_vertices
from ..errors import InputError
from ..laws import LEVEL, Table
from ..rotations import matrix_from_quat, quat_conjugate, quat_from_matrix, quat_multiply
from .motion import State, rotated_state

Array = NDArray[np.float64]

MAX_STATE_COMPONENT = {"position_m": 9e12, "velocity_m_s": 1e8, "omega_rad_s": 1e10}
"""Largest component of a state. Beyond it, rounding of a height or of the turn in a flight exceeds the size of a die."""

QUATERNION_LENGTH_TOLERANCE = 1e-6
"""Deviation from length 1 within which a quaternion is normalised; a larger one is not a rotation written with six digits."""

CACHED_DICE = 64
"""Dice whose touching vertices are kept, because fits ask for those of the same die again and again."""

EQUAL_MOMENTS = 1e-12
"""Difference of two moments of inertia, as a share of the largest, that is rounding."""

RELEASE_DEPTH_TOLERANCE = 1e-9
"""Depth, in circumradii, at which a vertex may start below the table: rounding of a pose written with ten digits."""


def body_of(die: Die) -> engine.Body:
    """The record of a die for the kernels of spherical tops, seen from its centre of mass.

    Raises ValueError for a centre of mass in the rounded shell, and for a die with an anisotropic tensor.
    """
    moment = die.isotropic_inertia_kg_m2
    centre = die.centre_of_mass_offset_m
    vertices = np.ascontiguousarray(touching_vertices(die) - centre)
    return engine.Body(
        vertices,
        die.solid.normals,
        plumb_normals(die.solid, die.corner_radius_m, centre),
        edge_barriers_m(die.solid, vertices),
        die.mass_kg,
        die.inertia_kg_m2 if moment is None else moment,
        float(np.linalg.norm(vertices, axis=1).max()),
        safe_tilt_cosines(vertices),
        die.corner_radius_m,
    )


def asymmetric_body_of(die: Die) -> tuple[engine.AsymmetricBody, Array]:
    """The record of any die for the kernels of asymmetric dice, and the quaternion (4,) from principal to body axes.

    Vertices are those of the inner solid, and heights count from `corner_radius_m` above the table. Raises ValueError for
    a centre of mass in the rounded shell.
    """
    solid, centre = die.solid, die.centre_of_mass_offset_m
    moments, axes = np.linalg.eigh(die.tensor_kg_m2)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    vertices = (inner_vertices(solid, die.corner_radius_m) - centre) @ axes
    corners = np.full((len(solid.faces), max(len(face) for face in solid.faces)), -1, np.int64)
    for k, face in enumerate(solid.faces):
        corners[k, : len(face)] = face
    barriers = np.array([_edge_barrier(a, b, moments) for a, b in vertices[solid.edges]])
    body = engine.AsymmetricBody(
        np.ascontiguousarray(vertices),
        np.ascontiguousarray(solid.normals @ axes),
        _plane_distances(solid, die.corner_radius_m, centre),
        corners,
        solid.edge_faces,
        np.ascontiguousarray(barriers[:, 0]),
        np.ascontiguousarray(barriers[:, 1]),
        float(die.mass_kg),
        moments,
        float(np.linalg.norm(vertices, axis=1).max()),
        np.where(_on_axis_of_symmetry(vertices, moments), safe_tilt_cosines(vertices), np.inf),
        float(die.corner_radius_m),
    )
    return body, quat_from_matrix(axes)


def packed_state(state: State) -> Array:
    """The array (13,) of a state: position, unit quaternion, velocity, angular velocity.

    Raises ValueError, naming the field, for a wrong shape, a number that is not finite or larger than MAX_STATE_COMPONENT, and
    a quaternion not of length 1.
    """
    fields = (("position_m", 3), ("quaternion", 4), ("velocity_m_s", 3), ("omega_rad_s", 3))
    parts = []
    for name, size in (("time_s", 0), *fields):
        value = np.asarray(getattr(state, name), float)
        if value.shape != ((size,) if size else ()) or not np.isfinite(value).all():
            raise InputError(f"{name} = {value.tolist()}: wanted {size or 1} finite numbers")
        if name in MAX_STATE_COMPONENT and float(np.abs(value).max()) > MAX_STATE_COMPONENT[name]:
            raise InputError(
                f"{name} = {value.tolist()}: wanted at most {MAX_STATE_COMPONENT[name]:g}, beyond which double precision does "
                "not resolve the motion"
            )
        parts.append(value)
    length = float(np.linalg.norm(parts[2]))
    if abs(length - 1.0) > QUATERNION_LENGTH_TOLERANCE:
        raise InputError(f"quaternion of length {length:.9g}: wanted a unit quaternion wxyz; divide it by its length")
    parts[2] = parts[2] / length
    return np.concatenate(parts[1:])


def unpacked_state(packed: Array, time_s: float) -> State:
    """The State of an array (13,) at an instant [s]."""
    return State(float(time_s), packed[0:3].copy(), packed[3:7].copy(), packed[7:10].copy(), packed[10:13].copy())


def packed_start(die: Die, start: State, table: Table = LEVEL) -> Array:
    """The array (13,) of a state in the table's axes, with the height less the corner radius, wherever it lies.

    Raises ValueError as `packed_state` does.
    """
    packed = packed_state(start)
    if table.tilt_rad:
        packed = packed_state(rotated_state(start, quat_conjugate(table.world_from_table)))
    packed[2] -= die.corner_radius_m
    return packed


def checked_release(die: Die, release: State, table: Table = LEVEL) -> Array:
    """`packed_start` of a release from which a throw can begin.

    Raises ValueError as `packed_state` does, and for a release with a vertex below the table.
    """
    start = packed_start(die, release, table)
    heights = touching_vertices(die) @ matrix_from_quat(start[3:7])[2] + start[2]
    check_above_table(release, float(heights.min()), die.solid.circumradius, table.plane)
    return start


def check_above_table(release: State, lowest_m: float, radius_m: float, plane: engine.Plane) -> None:
    """Raise ValueError if the lowest vertex of a release, at the height `lowest_m` in the table's axes, is below the table."""
    clearance_m = lowest_m - engine.table_height(plane, float(release.time_s))
    if clearance_m < -RELEASE_DEPTH_TOLERANCE * radius_m:
        raise InputError(
            f"position_m = {np.asarray(release.position_m).tolist()}: the lowest vertex lies {-clearance_m:.3g} m below the "
            "table; raise the die"
        )


def kernel_states(die: Die, table: Table, states: Array) -> Array:
    """States (n, 13) as the kernels take them, from states (n, 13) of the centroid in world axes.

    The result is of the centre of mass, in the table's axes, with heights less the corner radius.
    """
    converted = np.array(states, float)
    if table.tilt_rad:
        table_from_world = quat_conjugate(table.world_from_table)
        matrix = matrix_from_quat(table_from_world)
        converted[:, 3:7] = quat_multiply(table_from_world, converted[:, 3:7])
        for k in (0, 7, 10):
            converted[:, k : k + 3] = converted[:, k : k + 3] @ matrix.T
    if die.centre_of_mass_m is not None:
        arms = matrix_from_quat(converted[:, 3:7]) @ die.centre_of_mass_m
        converted[:, 0:3] += arms
        converted[:, 7:10] += np.cross(converted[:, 10:13], arms)
    converted[:, 2] -= die.corner_radius_m
    return converted


def world_poses(die: Die, table: Table, poses: Array) -> tuple[Array, Array]:
    """Positions (n, 3) and quaternions (n, 4) of the centroid in world axes.

    `poses` (n, 7) are of the centre of mass in the table's axes.
    """
    positions, quaternions = poses[:, :3], poses[:, 3:]
    if die.centre_of_mass_m is not None:
        positions = positions - matrix_from_quat(quaternions) @ die.centre_of_mass_m
    if table.tilt_rad:
        positions = positions @ matrix_from_quat(table.world_from_table).T
        quaternions = quat_multiply(table.world_from_table, quaternions)
    return positions, quaternions


def centre_of_mass_state(die: Die, state: State) -> State:
    """The state with position and velocity of the centre of mass, from one of the centroid."""
    return _shifted_state(die, state, 1.0)


def centroid_state(die: Die, state: State) -> State:
    """The state with position and velocity of the centroid, from one of the centre of mass."""
    return _shifted_state(die, state, -1.0)


@lru_cache(maxsize=CACHED_DICE)
def touching_vertices(die: Die) -> Array:
    """The points (n, 3) [m, body axes] whose heights decide what touches: the inner polyhedron's if corners are rounded."""
    vertices = inner_vertices(die.solid, die.corner_radius_m) if die.corner_radius_m else die.solid.vertices.copy()
    vertices.flags.writeable = False
    return vertices


def plumb_normals(solid: Solid, radius_m: float, centre_m: Array) -> Array:
    """Face normals (faces, 3), each times the least distance of a touching plane over that of its own.

    Distances count from the centre of mass, `centre_m` (3,) from the centroid. A die stands over the face through which
    the plumb line from its centre of mass passes, and that is the face whose scaled normal points down most. If all
    distances are equal the normals are not scaled, so that rounding makes no difference between them. Raises ValueError
    for a centre of mass in the rounded shell.
    """
    distances = _plane_distances(solid, radius_m, centre_m)
    if np.ptp(distances) <= INSPHERE_TOLERANCE * solid.inradius:
        return solid.normals
    return solid.normals * (distances.min() / distances)[:, None]


def edge_barriers_m(solid: Solid, vertices: Array) -> Array:
    """Height (faces,) [m] of the centre above the nearest edge of each face, to which it must rise to leave the face.

    `vertices` (n, 3) are those that touch the table, from the centre of mass, in the order of the solid's.
    """
    a, b = vertices[solid.edges[:, 0]], vertices[solid.edges[:, 1]]
    along = b - a
    fraction = np.clip(-np.sum(a * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
    distances = np.linalg.norm(a + fraction[:, None] * along, axis=1)
    barriers = np.full(len(solid.faces), np.inf)
    np.minimum.at(barriers, solid.edge_faces, distances[:, None])
    return barriers


def safe_tilt_cosines(vertices: Array) -> Array:
    """Cosines (n,) of the largest safe tilt of each vertex (n, 3), counted from the centre of mass.

    The tilt is the angle between the vertical and the line from the vertex to the centre. Up to the safe tilt no other
    vertex can come as low, whatever the rotation about that line.
    """
    lengths = np.linalg.norm(vertices, axis=1)
    cosine = np.clip(vertices @ vertices.T / np.outer(lengths, lengths), -1.0, 1.0)
    sine = np.sqrt(1.0 - cosine**2)
    # Equally low where R_i cos θ = R_j cos(γ - θ), γ the angle between the two.
    tilt = np.arctan2(lengths[:, None] - lengths * cosine, lengths * sine)
    np.fill_diagonal(tilt, np.pi)
    return np.asarray(np.cos(tilt.min(1)))


def _on_axis_of_symmetry(vertices: Array, moments: Array) -> NDArray[np.bool_]:
    """(n,) whether the inertia is the same about all lines across that from the centre of mass to each vertex (n, 3), both in
    principal axes."""
    towards = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    along = np.sum(towards**2 * moments, axis=1)
    is_principal = np.linalg.norm(towards * moments - along[:, None] * towards, axis=1) < EQUAL_MOMENTS * moments.max()
    nearest = np.abs(moments - along[:, None]).argmin(axis=1)
    across = np.array([np.delete(moments, k) for k in nearest])
    return np.asarray(is_principal & (np.ptp(across, axis=1) < EQUAL_MOMENTS * moments.max()))


def _shifted_state(die: Die, state: State, sign: float) -> State:
    """The state of the point that lies `sign` times the centre-of-mass offset from the state's own point."""
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


def _plane_distances(solid: Solid, radius_m: float, centre_m: Array) -> Array:
    """Distances (faces,) [m] of the planes of the inner solid from a centre of mass. Raises ValueError for one outside it."""
    distances = np.asarray(solid.offsets - radius_m - solid.normals @ centre_m)
    if distances.min() <= 0.0:
        raise InputError(
            f"centre_of_mass_m = {centre_m.tolist()}: wanted it deeper inside the {solid.name} than its corner radius of "
            f"{radius_m:.6g} m"
        )
    return distances


def _edge_barrier(a: Array, b: Array, moments: Array) -> tuple[float, float]:
    """Least distance [m] of the edge from a to b, and the largest moment of inertia about a line through it."""
    along = b - a
    foot = a + np.clip(-(a @ along) / (along @ along), 0.0, 1.0) * along
    e1 = a / np.linalg.norm(a)
    e2 = b - (b @ e1) * e1
    e2 /= np.linalg.norm(e2)
    span = np.arctan2(b @ e2, b @ e1)
    # d = e1 cos θ + e2 sin θ has d·I d = mean + p cos 2θ + q sin 2θ: largest at 2θ = atan2(q, p), or at an end.
    stationary = 0.5 * np.arctan2(2.0 * (e1 @ (moments * e2)), e1 @ (moments * e1) - e2 @ (moments * e2)) % np.pi
    angles = np.array([0.0, span, stationary if stationary < span else 0.0])
    d = np.outer(np.cos(angles), e1) + np.outer(np.sin(angles), e2)
    return float(np.linalg.norm(foot)), float((d**2 @ moments).max())
