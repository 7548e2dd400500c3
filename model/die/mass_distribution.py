"""Volume, centroid and inertia of a homogeneous body with rounded edges and corners, in closed form.

A body of corner radius r consists of all points within r of an inner polyhedron (`inner_vertices`). It has four kinds of parts,
each with a closed integral of 1, x and x xᵀ:

| part | points | volume |
| --- | --- | --- |
| the inner polyhedron | tetrahedra from the origin to triangles of the faces | |
| a plate on each face | y + t n, 0 <= t <= r, y on the face of area A | A r |
| a wedge of a cylinder along each edge | y + ρ u, u from one normal to the other, y on the edge of length L | L θ r²/2 |
| a cone of a ball at each corner | v + ρ w, w in the spherical polygon of the normals there | Ω r³/3 |

With θ the angle between the normals beside an edge, m the unit vector midway and k that at a right angle to m and to the edge,

    ∫ u = 2 sin(θ/2) m,      ∫ u uᵀ = (θ + sin θ)/2 m mᵀ + (θ - sin θ)/2 k kᵀ.

The solid angle Ω is the sum of those of triangles (van Oosterom & Strackee, IEEE Trans. Biomed. Eng. 30, 125, 1983). ∫ w over
a spherical polygon is half the sum of its arcs, each times the unit normal of its plane that points inwards. The polygons of all
corners tile the sphere, so that their ∫ w wᵀ add up to 4π/3. No part is a difference of larger ones: nothing cancels at any
radius from 0 to that of the inscribed ball.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from .solid import Array, Solid, inner_vertices

REMEMBERED = 64
"""Results that are kept: a fit asks for the same radius at every derivative by another parameter."""


@dataclass(frozen=True, eq=False)
class MassDistribution:
    """How the mass of a homogeneous body is spread, in its body axes."""

    volume_m3: float
    centroid_m: Array
    """(3,) from the origin of the solid, the centroid of the sharp body."""
    unit_inertia_m2: Array
    """(3, 3) inertia tensor about the centroid for a mass of 1 kg."""


@lru_cache(REMEMBERED)
def mass_distribution(solid: Solid, corner_radius_m: float = 0.0) -> MassDistribution:
    """That of a solid with rounded edges and corners. Raises ValueError for a radius that `inner_vertices` refuses."""
    inner, r = inner_vertices(solid, corner_radius_m), corner_radius_m
    sums = _Sums()
    for face, normal in zip(solid.faces, solid.normals, strict=True):
        corners = inner[list(face)]
        for b, c in pairwise(corners[1:]):
            _add_tetrahedron(sums, corners[0], b, c)
            _add_plate(sums, np.array([corners[0], b, c]), normal, r)
    if r > 0.0:
        for ends, faces in zip(solid.edges, solid.edge_faces, strict=True):
            _add_wedge(sums, inner[ends], solid.normals[faces], r)
        for i, corner in enumerate(inner):
            _add_cone(sums, corner, _normals_about(solid, i), r)
        sums.second += 4.0 * np.pi / 15.0 * r**5 * np.eye(3)
    centroid = sums.first / sums.volume
    second = sums.second / sums.volume - np.outer(centroid, centroid)
    return MassDistribution(sums.volume, centroid, np.asarray(np.trace(second) * np.eye(3) - second))


class _Sums:
    """The integrals of 1, x and x xᵀ over the parts so far."""

    def __init__(self) -> None:
        self.volume, self.first, self.second = 0.0, np.zeros(3), np.zeros((3, 3))

    def add(self, volume: float, first: Array, second: Array) -> None:
        self.volume += volume
        self.first += first
        self.second += second


def _add_tetrahedron(sums: _Sums, a: Array, b: Array, c: Array) -> None:
    """The tetrahedron from the origin to a triangle: V/20 (Σ pᵢ pᵢᵀ + s sᵀ), with s the sum of its corners."""
    volume, total = float(a @ np.cross(b, c)) / 6.0, a + b + c
    points = np.array([a, b, c, total])
    sums.add(volume, volume / 4.0 * total, volume / 20.0 * points.T @ points)


def _add_plate(sums: _Sums, corners: Array, normal: Array, r: float) -> None:
    """The plate of thickness r on a triangle (3, 3)."""
    area, total = (
        0.5 * float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))),
        corners.sum(0),
    )
    on_face = area / 12.0 * (corners.T @ corners + np.outer(total, total))
    lever = np.outer(area / 3.0 * total, normal)
    second = r * on_face + 0.5 * r**2 * (lever + lever.T) + r**3 / 3.0 * area * np.outer(normal, normal)
    sums.add(r * area, area * (r / 3.0 * total + 0.5 * r**2 * normal), second)


def _add_wedge(sums: _Sums, ends: Array, normals: Array, r: float) -> None:
    """The wedge of a cylinder along an edge (2, 3) between two normals (2, 3)."""
    length, total = float(np.linalg.norm(ends[1] - ends[0])), ends.sum(0)
    middle, across = normals.sum(0), normals[1] - normals[0]
    theta = 2.0 * float(np.arctan2(np.linalg.norm(across), np.linalg.norm(middle)))
    middle, across = middle / np.linalg.norm(middle), across / np.linalg.norm(across)
    along = length / 6.0 * (ends.T @ ends + np.outer(total, total))
    mean = 2.0 * np.sin(0.5 * theta) * middle
    turned = 0.5 * (theta + np.sin(theta)) * np.outer(middle, middle)
    turned += 0.5 * (theta - np.sin(theta)) * np.outer(across, across)
    lever = np.outer(0.5 * length * total, mean)
    second = 0.5 * r**2 * theta * along + r**3 / 3.0 * (lever + lever.T) + 0.25 * r**4 * length * turned
    first = 0.25 * r**2 * theta * length * total + r**3 / 3.0 * length * mean
    sums.add(0.5 * r**2 * theta * length, first, second)


def _add_cone(sums: _Sums, corner: Array, normals: Array, r: float) -> None:
    """The cone of a ball at a corner (3,) whose normals (n, 3) run counter-clockwise, without its ∫ w wᵀ."""
    after = np.roll(normals, -1, axis=0)
    planes = np.cross(normals, after)
    sines = np.linalg.norm(planes, axis=1)
    arcs = np.arctan2(sines, (normals * after).sum(1))
    mean = 0.5 * (arcs / sines) @ planes
    a, solid_angle = normals[0], 0.0
    for b, c in pairwise(normals[1:]):
        solid_angle += 2.0 * float(np.arctan2(a @ np.cross(b, c), 1.0 + a @ b + b @ c + c @ a))
    lever = np.outer(corner, mean)
    first = r**3 / 3.0 * solid_angle * corner + 0.25 * r**4 * mean
    second = r**3 / 3.0 * solid_angle * np.outer(corner, corner) + 0.25 * r**4 * (lever + lever.T)
    sums.add(r**3 / 3.0 * solid_angle, first, second)


def _normals_about(solid: Solid, vertex: int) -> Array:
    """(n, 3) normals of the faces that meet in a vertex, counter-clockwise seen from outside."""
    normals = solid.normals[[k for k, face in enumerate(solid.faces) if vertex in face]]
    outward = normals.mean(0)
    x = normals[0] - outward * (normals[0] @ outward) / (outward @ outward)
    y = np.cross(outward, x)
    return np.asarray(normals[np.argsort(np.arctan2(normals @ y * np.linalg.norm(x), normals @ x * np.linalg.norm(y)))])
