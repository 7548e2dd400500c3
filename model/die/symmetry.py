"""Rotations that leave a die unchanged, and the choice among the orientations that they make indistinguishable.

An unmarked die in the orientation R looks the same in every orientation R S, with S a symmetry rotation of its solid. A
measured orientation is therefore known up to such an S. `nearest_equivalent_rotation` chooses the one that agrees best
with another orientation, and so labels the faces consistently.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .die import Die
from .solid import Array, Solid, plane_axes

VERTEX_TOLERANCE = 1e-7
"""Distance, in circumradii, within which a rotated vertex counts as equal to another. Rounding is 1e-15; the smallest
distance between vertices that `named_solids.MIN_CUT` allows is 1e-6."""

ROUNDINGS = 10.0
"""Errors of the corners of a solid (`Solid.rounding`) within which they, and scalar products of them, count as equal."""

CONGRUENCE_TOLERANCE = 1e-9
"""Difference of scalar products, in squared circumradii, within which two pairs of vertices are tried as congruent."""

IDENTITY_TOLERANCE = 1e-7
"""Largest element of S - 1 at which a rotation S is the identity."""

INERTIA_TOLERANCE = 1e-7
"""Change of a tensor element, in traces of the tensor, at which a rotation still preserves the inertia."""


@lru_cache(maxsize=16)
def symmetry_rotations(solid: Solid) -> Array:
    """The rotations (order, 3, 3) that map the solid's vertices onto themselves, the identity first.

    12 for the tetrahedron, 24 for cube and octahedron, 60 for dodecahedron and icosahedron, 1 for a solid without symmetry.
    """
    rotations = np.concatenate([np.eye(3)[None], _rotations_onto(solid, solid.vertices, other_than=np.eye(3))])
    rotations.setflags(write=False)
    return rotations


@lru_cache(maxsize=16)
def inversion_rotation(solid: Solid) -> Array | None:
    """A rotation T (3, 3) that maps the solid onto its reflection through the centre: -V = V Tᵀ as sets of vertices V.

    The identity for a solid with a centre of symmetry. For a tetrahedron a quarter turn about an axis through the midpoints
    of two edges. Of several rotations the one with the smallest angle; None if there is none.
    """
    rotations = _rotations_onto(solid, -solid.vertices)
    if not len(rotations):
        return None
    least = rotations[np.argmax(np.trace(rotations, axis1=1, axis2=2))]
    least.setflags(write=False)
    return least


def die_symmetries(die: Die) -> Array:
    """The symmetry rotations (order, 3, 3) of the solid that preserve the die's centre of mass and inertia as well."""
    rotations = symmetry_rotations(die.solid)
    if die.is_spherical_top:
        return rotations
    centre, tensor = die.centre_of_mass_offset_m, die.tensor_kg_m2
    moved = np.linalg.norm(rotations @ centre - centre, axis=1)
    changed = np.abs(rotations @ tensor @ rotations.transpose(0, 2, 1) - tensor).max(axis=(1, 2))
    rounding = ROUNDINGS * die.solid.rounding
    keeps_centre = moved <= max(VERTEX_TOLERANCE, rounding) * die.solid.circumradius
    keeps_inertia = changed <= max(INERTIA_TOLERANCE, rounding) * float(np.trace(tensor))
    return np.asarray(rotations[keeps_centre & keeps_inertia])


def nearest_equivalent_rotation(rotation: Array, wanted: Array, symmetries: Array) -> Array:
    """Of the orientations that draw the same body as `rotation` (..., 3, 3), the one nearest to `wanted` (..., 3, 3).

    `symmetries` (order, 3, 3) are those of the body, from `symmetry_rotations` or `die_symmetries`. The smallest angle
    between R S and `wanted` is the largest trace of (R S)ᵀ `wanted`; of equal ones the first S is taken.
    """
    equivalent = rotation[..., None, :, :] @ symmetries
    nearest = np.einsum("...nij,...ij->...n", equivalent, wanted).argmax(-1)
    return np.asarray(np.take_along_axis(equivalent, nearest[..., None, None, None], axis=-3)[..., 0, :, :])


def _rotations_onto(solid: Solid, others: Array, *, other_than: Array | None = None) -> Array:
    """The rotations (n, 3, 3) that map the solid's vertices onto `others` (v, 3), which are as far from the centre.

    A rotation is fixed by where it takes two vertices, so every pair of `others` that is congruent to one such pair is tried.
    """
    V = solid.vertices
    size, rounding = solid.circumradius, ROUNDINGS * solid.rounding
    congruent, equal = max(CONGRUENCE_TOLERANCE, rounding), max(VERTEX_TOLERANCE, rounding)
    first = int(np.argmax(np.linalg.norm(V, axis=1)))
    second = int(np.argmax(np.linalg.norm(np.cross(V[first], V), axis=1)))
    own = plane_axes(V[first], V[second])
    found = []
    for p in others:
        for q in others:
            mismatch = abs(p @ p - V[first] @ V[first]) + abs(q @ q - V[second] @ V[second])
            if mismatch + abs(p @ q - V[first] @ V[second]) > congruent * size**2:
                continue
            rotation = plane_axes(p, q) @ own.T
            gaps = np.linalg.norm((V @ rotation.T)[:, None] - others[None], axis=2).min(1)
            is_excluded = other_than is not None and np.abs(rotation - other_than).max() <= max(
                IDENTITY_TOLERANCE, rounding
            )
            if gaps.max() < equal * size and not is_excluded:
                found.append(rotation)
    return np.array(found).reshape(-1, 3, 3)
