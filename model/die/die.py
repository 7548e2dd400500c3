"""model.die.die."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from .solid import Array, Solid, check_positive, inner_vertices, isohedral_solid, unit_inertia

MAX_CORNER_RADIUS_FRACTION = 0.95
"""Largest corner radius, as a part of the inscribed radius: beyond it a die is a ball that never comes to rest."""


@dataclass(frozen=True, eq=False)
class Die:
    """A solid with mass.

    Most dice are spherical tops: one moment of inertia about every axis through the centroid. A die with another
    tensor, or with its centre of mass elsewhere, has `inertia_tensor_kg_m2` instead; asking such a die for
    `inertia_kg_m2` raises ValueError, because no one number would be right.
    """

    solid: Solid
    mass_kg: float
    inertia_kg_m2: float = field(repr=False)
    """About any axis through the centre of a spherical top. Give NaN (or the mean) where a tensor is given."""
    corner_radius_m: float = 0.0
    """Radius of the rounded corners and edges; `solid` stays the sharp polyhedron of the flat faces."""
    marks: str | None = None
    """`pips`, `numbers`, or None for plain faces."""
    inertia_tensor_kg_m2: Array | None = None
    """(3, 3) about the centre of mass, body axes; None for a spherical top."""
    centre_of_mass_m: Array | None = None
    """(3,) from the centroid, body axes; None where it is the centroid."""

    def __post_init__(self) -> None:
        shift = None if self.centre_of_mass_m is None else np.array(self.centre_of_mass_m, float)
        if shift is not None and not shift.any():
            shift = None
        tensor = None if self.inertia_tensor_kg_m2 is None else np.array(self.inertia_tensor_kg_m2, float)
        if tensor is None and shift is not None:
            tensor = self.inertia_kg_m2 * np.eye(3)
        object.__setattr__(self, "centre_of_mass_m", shift)
        object.__setattr__(self, "inertia_tensor_kg_m2", tensor)
        if tensor is not None:
            # Left out of the instance, so that reading it ends in __getattr__ below.
            object.__delattr__(self, "inertia_kg_m2")

    def __getattr__(self, name: str) -> float:
        """Called only for what an instance does not have."""
        if name == "inertia_kg_m2":
            raise ValueError(
                f"inertia_kg_m2 of a {self.solid.name} that is no spherical top: wanted a die with one moment of "
                "inertia and its centre of mass at the centroid; use inertia_tensor_kg_m2"
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def is_spherical_top(self) -> bool:
        """Whether the inertia is the same about every axis and the centre of mass is the centroid."""
        return self.inertia_tensor_kg_m2 is None

    @property
    def isotropic_inertia_kg_m2(self) -> float | None:
        """The one moment of inertia about every axis through the centre of mass, wherever that lies; None where the axes
        differ."""
        if self.inertia_tensor_kg_m2 is None:
            return self.inertia_kg_m2
        moment = float(np.trace(self.inertia_tensor_kg_m2)) / 3.0
        even = np.abs(self.inertia_tensor_kg_m2 - moment * np.eye(3)).max() <= 1e-12 * moment
        return moment if even else None


def make_die(
    shape: str,
    edge_m: float,
    mass_kg: float,
    *,
    inertia_kg_m2: float | None = None,
    corner_radius_m: float = 0.0,
    marks: str | None = None,
) -> Die:
    """One of the five isohedral dice; its inertia follows from shape, edge and mass unless given.

    Raises ValueError for an unknown shape and for an edge, mass, inertia or radius that no die has.
    """
    for name, value in (("edge_m", edge_m), ("mass_kg", mass_kg), ("inertia_kg_m2", inertia_kg_m2)):
        if value is not None:
            check_positive(name, value)
    solid = isohedral_solid(shape, edge_m)
    if not 0 <= corner_radius_m <= MAX_CORNER_RADIUS_FRACTION * solid.inradius:
        raise ValueError(
            f"corner_radius_m = {corner_radius_m}: wanted 0 or more, "
            f"and at most {MAX_CORNER_RADIUS_FRACTION:g} of the inscribed radius {solid.inradius:.6g}"
        )
    most = 2.0 / 3.0 * mass_kg * solid.circumradius**2
    if inertia_kg_m2 is not None and not 1e-3 * most <= inertia_kg_m2 <= most:
        raise ValueError(
            f"inertia_kg_m2 = {inertia_kg_m2}: wanted {1e-3 * most:.3g} to {most:.3g}, the most that this mass can have "
            "within the corners"
        )
    if inertia_kg_m2 is None:
        inertia_kg_m2 = mass_kg * float(np.trace(unit_inertia(solid))) / 3.0
    return Die(solid, mass_kg, inertia_kg_m2, corner_radius_m, marks)


def die_from_solid(
    solid: Solid,
    mass_kg: float,
    *,
    inertia_tensor_kg_m2: ArrayLike | None = None,
    centre_of_mass_m: ArrayLike | None = None,
    corner_radius_m: float = 0.0,
    marks: str | None = None,
) -> Die:
    """Any convex solid as a die, homogeneous unless its inertia tensor is given.

    `inertia_tensor_kg_m2` (3, 3) is about the centre of mass, in body axes; `centre_of_mass_m` (3,) counts from the
    centroid and needs a tensor with it. A tensor that is the same about every axis to 1e-12, about the centroid, makes
    a spherical top. Raises ValueError for what no body has: a tensor that is not symmetric or whose principal moments
    break the triangle inequality, a centre of mass outside the solid, a corner radius that splits a corner.
    """
    check_positive("mass_kg", mass_kg)
    shift = None if centre_of_mass_m is None else _point_inside(solid, "centre_of_mass_m", centre_of_mass_m)
    if inertia_tensor_kg_m2 is not None:
        tensor = _checked_tensor(inertia_tensor_kg_m2)
    elif shift is not None and shift.any():
        raise ValueError(
            f"centre_of_mass_m = {shift.tolist()} without an inertia tensor: wanted both, because the place alone does "
            "not say how the mass is spread; give inertia_tensor_kg_m2, or use loaded_die"
        )
    else:
        tensor = mass_kg * unit_inertia(solid)
    inner_vertices(solid, corner_radius_m)
    mean = float(np.trace(tensor)) / 3.0
    is_isotropic = float(np.abs(tensor - mean * np.eye(3)).max()) <= 1e-12 * mean
    return Die(solid, mass_kg, mean, corner_radius_m, marks, None if is_isotropic else tensor, shift)


def loaded_die(
    solid: Solid,
    mass_kg: float,
    load_kg: float,
    load_position_m: ArrayLike,
    *,
    corner_radius_m: float = 0.0,
    marks: str | None = None,
) -> Die:
    """A homogeneous solid of `mass_kg` with a point of `load_kg` more at `load_position_m` (3,) from its centroid.

    With M the body, μ = M m/(M + m) and p the place of the load, the centre of mass lies at m p/(M + m) and the tensor
    about it is that of the body plus μ (p² 1 - p pᵀ) (the parallel axis theorem for both parts). Raises ValueError for
    a mass that is not above 0, a load below 0, or a load outside the solid.
    """
    check_positive("mass_kg", mass_kg)
    if not (np.isfinite(load_kg) and load_kg >= 0.0):
        raise ValueError(f"load_kg = {load_kg}: wanted a finite number, 0 or more")
    place = _point_inside(solid, "load_position_m", load_position_m)
    total = mass_kg + load_kg
    spread = float(place @ place) * np.eye(3) - np.outer(place, place)
    return die_from_solid(
        solid,
        total,
        inertia_tensor_kg_m2=mass_kg * unit_inertia(solid) + mass_kg * (load_kg / total) * spread,
        centre_of_mass_m=(load_kg / total) * place,
        corner_radius_m=corner_radius_m,
        marks=marks,
    )


def _point_inside(solid: Solid, name: str, point: ArrayLike) -> Array:
    """The point (3,) as an array. Raises ValueError unless it lies inside the solid."""
    place = np.asarray(point, float)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ValueError(f"{name} = {place.tolist()}: wanted 3 finite numbers")
    if (solid.normals @ place >= solid.offsets).any():
        raise ValueError(
            f"{name} = {place.tolist()}: wanted a place inside the {solid.name}, counted from its centroid"
        )
    return place


def _checked_tensor(given: ArrayLike) -> Array:
    """The tensor (3, 3), made exactly symmetric. Raises ValueError unless some body has it."""
    tensor = np.asarray(given, float)
    if tensor.shape != (3, 3) or not np.isfinite(tensor).all():
        raise ValueError(f"inertia_tensor_kg_m2 of shape {tensor.shape}: wanted (3, 3) finite numbers")
    size = float(np.abs(tensor).max())
    if np.abs(tensor - tensor.T).max() > 1e-9 * size:
        raise ValueError(f"inertia_tensor_kg_m2 = {tensor.tolist()}: wanted a symmetric tensor")
    tensor = 0.5 * (tensor + tensor.T)
    small, middle, large = np.linalg.eigvalsh(tensor)
    if small <= 0.0 or large > (small + middle) * (1.0 + 1e-9):
        raise ValueError(
            f"inertia_tensor_kg_m2 with principal moments {small:.6g}, {middle:.6g}, {large:.6g}: wanted all above 0 "
            "and none larger than the sum of the other two"
        )
    return tensor
