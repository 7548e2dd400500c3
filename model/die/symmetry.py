"""model.die.symmetry."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .die import Die
from .solid import Array, Solid, plane_axes


@lru_cache(maxsize=16)
def symmetry_rotations(solid: Solid) -> Array:
    """The rotations (order, 3, 3) that carry the solid's vertices onto themselves, the identity first: 12 for the
    tetrahedron, 24 for cube and octahedron, 60 for dodecahedron and icosahedron, 1 for a solid without symmetry."""
    rotations = np.concatenate([np.eye(3)[None], _rotations_onto(solid, solid.vertices, other_than=np.eye(3))])
    rotations.setflags(write=False)
    return rotations


@lru_cache(maxsize=16)
def inversion_rotation(solid: Solid) -> Array | None:
    """A rotation (3, 3) that does to the solid what reflection through its centre does, -V = V Tᵀ as sets of vertices: the
    identity of a solid with such a centre, and for a tetrahedron a quarter turn about an axis through the middles of two
    edges; the least turn of several. None of a solid without any."""
    rotations = _rotations_onto(solid, -solid.vertices)
    if not len(rotations):
        return None
    least = rotations[np.argmax(np.trace(rotations, axis1=1, axis2=2))]
    least.setflags(write=False)
    return least


def _rotations_onto(solid: Solid, others: Array, *, other_than: Array | None = None) -> Array:
    """The rotations (n, 3, 3) that carry the solid's vertices onto others (v, 3) at the same distances."""
    V = solid.vertices
    size = solid.circumradius
    first = int(np.argmax(np.linalg.norm(V, axis=1)))
    second = int(np.argmax(np.linalg.norm(np.cross(V[first], V), axis=1)))
    own = plane_axes(V[first], V[second])
    found = []
    for p in others:
        for q in others:
            alike = abs(p @ p - V[first] @ V[first]) + abs(q @ q - V[second] @ V[second])
            if alike + abs(p @ q - V[first] @ V[second]) > 1e-9 * size**2:
                continue
            turn = plane_axes(p, q) @ own.T
            gaps = np.linalg.norm((V @ turn.T)[:, None] - others[None], axis=2).min(1)
            if gaps.max() < 1e-7 * size and (other_than is None or np.abs(turn - other_than).max() > 1e-7):
                found.append(turn)
    return np.array(found).reshape(-1, 3, 3)


def die_symmetries(die: Die) -> Array:
    """The rotations (order, 3, 3) of the solid that keep the die's centre of mass and inertia as well."""
    turns = symmetry_rotations(die.solid)
    if die.is_spherical_top:
        return turns
    shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    tensor = np.asarray(die.inertia_tensor_kg_m2)
    keeps_centre = np.linalg.norm(turns @ shift - shift, axis=1) <= 1e-7 * die.solid.circumradius
    turned = turns @ tensor @ turns.transpose(0, 2, 1)
    keeps_inertia = np.abs(turned - tensor).max(axis=(1, 2)) <= 1e-7 * float(np.trace(tensor))
    return np.asarray(turns[keeps_centre & keeps_inertia])
