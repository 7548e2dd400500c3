"""A die as the kernels have it: which points touch, what a face must be left over, how far a top may lean.

Rounded corners touch the table with the spheres about the corners of the inner polyhedron (the face planes moved in by
the radius ρ). Without friction that is the sharp die of the inner polyhedron with all heights counted from ρ: a vertical
force has the same moment at the lowest point of a sphere as at its centre. With friction the arm is ρ longer downwards.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import kernels
from .solids import Die, Solid, inner_vertices

Array = NDArray[np.float64]


def body_of(die: Die) -> kernels.Body:
    """A spherical top for the kernels."""
    vertices = touching_vertices(die)
    return kernels.Body(
        vertices,
        die.solid.normals,
        plumb_normals(die.solid, die.corner_radius_m),
        edge_barriers_m(die.solid, vertices),
        die.mass_kg,
        die.inertia_kg_m2,
        float(np.linalg.norm(vertices, axis=1).max()),
        safe_leans(vertices),
        die.corner_radius_m,
    )


def touching_vertices(die: Die) -> Array:
    """The points (n, 3) [m, body axes] whose heights decide what touches: of the inner polyhedron where corners are
    rounded."""
    return inner_vertices(die.solid, die.corner_radius_m) if die.corner_radius_m else die.solid.vertices


def plumb_normals(solid: Solid, radius_m: float) -> Array:
    """Normals (faces, 3) over the distances of the planes that touch the table, the nearest one's taken for 1.

    A die stands over the face that the plumb line from its centre goes through, the one for which this points down
    most. On a solid whose faces are not all equally far from the centre another one can look down more. Where they are,
    rounding is kept from telling them apart.
    """
    offsets = solid.offsets - radius_m
    if np.ptp(solid.offsets) <= 1e-12 * solid.inradius:
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


def safe_leans(vertices: Array) -> Array:
    """Cosine (n,) of how far the line from each vertex to the centre may lean from the vertical before another vertex
    can come as low, however the die is turned about that line. Vertices (n, 3) from the centre."""
    lengths = np.linalg.norm(vertices, axis=1)
    cosine = np.clip(vertices @ vertices.T / np.outer(lengths, lengths), -1.0, 1.0)
    sine = np.sqrt(1.0 - cosine**2)
    # Equally low where R_i cos θ = R_j cos(γ - θ), γ the angle between the two.
    lean = np.arctan2(lengths[:, None] - lengths * cosine, lengths * sine)
    np.fill_diagonal(lean, np.pi)
    return np.asarray(np.cos(lean.min(1)))
