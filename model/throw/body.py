"""A die as the kernels have it: which points touch, what a face must be left over, how far a top may lean.

Rounded corners touch the table with the spheres about the corners of the inner polyhedron (the face planes moved in by
the radius ρ). Without friction that is the sharp die of the inner polyhedron with all heights counted from ρ: a vertical
force has the same moment at the lowest point of a sphere as at its centre. With friction the arm is ρ longer downwards.

A die with one moment of inertia about a centre of mass that is not the centroid flies as any other with that moment: the
kernels know of the centroid only through the vertices. So they are given those from the centre of mass, and states of it
(`kernel_states`); poses come back as those of the centroid (`world_poses`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import engine
from ..die import Die, Solid, inner_vertices
from ..laws import Table
from ..rotations import matrix_from_quat, quat_conjugate, quat_multiply

Array = NDArray[np.float64]


def body_of(die: Die) -> engine.Body:
    """A die with one moment of inertia for the kernels, seen from its centre of mass.

    Raises ValueError for a centre of mass in the rounded shell, and for a die whose axes differ.
    """
    moment = die.isotropic_inertia_kg_m2
    centre = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
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


def kernel_states(die: Die, table: Table, states: Array) -> Array:
    """States (n, 13) of the centroid, in world axes, as the kernels have them: of the centre of mass, in the table's
    axes, heights less the corners' radius."""
    starts = np.array(states, float)
    if table.tilt_rad:
        back = quat_conjugate(table.world_from_table)
        turn = matrix_from_quat(back)
        starts[:, 3:7] = quat_multiply(back, starts[:, 3:7])
        for k in (0, 7, 10):
            starts[:, k : k + 3] = starts[:, k : k + 3] @ turn.T
    if die.centre_of_mass_m is not None:
        arms = matrix_from_quat(starts[:, 3:7]) @ die.centre_of_mass_m
        starts[:, 0:3] += arms
        starts[:, 7:10] += np.cross(starts[:, 10:13], arms)
    starts[:, 2] -= die.corner_radius_m
    return starts


def world_poses(die: Die, table: Table, poses: Array) -> tuple[Array, Array]:
    """Positions (n, 3) and quaternions (n, 4) of the centroid, in world axes, from poses (n, 7) of the centre of mass in
    the table's."""
    positions, quaternions = poses[:, :3], poses[:, 3:]
    if die.centre_of_mass_m is not None:
        positions = positions - matrix_from_quat(quaternions) @ die.centre_of_mass_m
    if table.tilt_rad:
        positions = positions @ matrix_from_quat(table.world_from_table).T
        quaternions = quat_multiply(table.world_from_table, quaternions)
    return positions, quaternions


def touching_vertices(die: Die) -> Array:
    """The points (n, 3) [m, body axes] whose heights decide what touches: of the inner polyhedron where corners are
    rounded."""
    return inner_vertices(die.solid, die.corner_radius_m) if die.corner_radius_m else die.solid.vertices


def plumb_normals(solid: Solid, radius_m: float, centre_m: Array) -> Array:
    """Normals (faces, 3) over the distances of the planes that touch the table from the centre of mass, the nearest one's
    taken for 1.

    A die stands over the face that the plumb line from its centre goes through, the one for which this points down
    most. On a solid whose faces are not all equally far from the centre another one can look down more. Where they are,
    rounding is kept from telling them apart.
    """
    offsets = solid.offsets - radius_m - solid.normals @ centre_m
    if offsets.min() <= 0.0:
        raise ValueError(
            f"centre_of_mass_m = {centre_m.tolist()}: wanted it deeper inside the {solid.name} than its corner radius of "
            f"{radius_m:.6g} m"
        )
    if np.ptp(offsets) <= 1e-12 * solid.inradius:
        return solid.normals
    return solid.normals * (offsets.min() / offsets)[:, None]


def edge_barriers_m(solid: Solid, vertices: Array) -> Array:
    """Height (faces,) [m] of the centre when the die stands on the nearest edge of each face: what it must climb.

    `vertices` (n, 3) are those that touch the table, in the order of the solid's.
    """
    a, b = vertices[solid.edges[:, 0]], vertices[solid.edges[:, 1]]
    along = b - a
    foot = np.clip(-np.sum(a * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
    distances = np.linalg.norm(a + foot[:, None] * along, axis=1)
    barriers = np.full(len(solid.faces), np.inf)
    np.minimum.at(barriers, solid.edge_faces, distances[:, None])
    return barriers


def safe_tilt_cosines(vertices: Array) -> Array:
    """Cosine (n,) of how far the line from each vertex to the centre may lean from the vertical before another vertex
    can come as low, however the die is turned about that line. Vertices (n, 3) from the centre."""
    lengths = np.linalg.norm(vertices, axis=1)
    cosine = np.clip(vertices @ vertices.T / np.outer(lengths, lengths), -1.0, 1.0)
    sine = np.sqrt(1.0 - cosine**2)
    # Equally low where R_i cos θ = R_j cos(γ - θ), γ the angle between the two.
    lean = np.arctan2(lengths[:, None] - lengths * cosine, lengths * sine)
    np.fill_diagonal(lean, np.pi)
    return np.asarray(np.cos(lean.min(1)))
