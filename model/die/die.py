"""A die: a solid with mass, rounded corners and marks, homogeneous or loaded.

`make_die` gives the five isohedral dice, `die_from_solid` any convex solid, `loaded_die` a solid with a point mass in
it. A die whose inertia is the same about every axis, with its centre of mass at the centroid, is a spherical top: one
number says how its mass is spread, and it turns at a constant rate in flight. All others carry an inertia tensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .mass_distribution import mass_distribution
from .solid import Array, Solid, check_positive, inner_vertices, isohedral_solid, numbered_solid

MAX_CORNER_RADIUS_FRACTION = 0.95
"""Largest corner radius as a fraction of the inscribed radius. A rounder die is a ball, which never comes to rest."""

MIN_INERTIA_FRACTION = 1e-3
"""Least moment of inertia of `make_die`, as a fraction of 2/3 m R² (all mass on the circumscribed sphere). A homogeneous die
has 0.20 to 0.46 of it; a value below this is in a wrong unit."""

ISOTROPY_TOLERANCE = 1e-12
"""Largest deviation of a tensor element from an isotropic tensor, in mean moments, at which a tensor counts as isotropic:
rounding of the volume integral."""

ROUNDINGS = 10.0
"""Errors of the corners of a solid (`Solid.rounding`) by which its centroid and inertia may be off."""

CENTRED_TOLERANCE = 1e-12
"""Distance of the centroid of a rounded body from that of the sharp one, in circumradii, at which it counts as the same:
rounding."""

NEARLY_CENTRED = 5e-3
"""Distance of the centre of mass from the centroid, in circumradii, at which poses of the centroid still show a flight and an
impact as those of the centre of mass would: some 50 micrometres on a die, about what its edges err by."""

TENSOR_TOLERANCE = 1e-9
"""Relative asymmetry, and relative violation of the triangle inequality, of a tensor that a user wrote with ten digits."""


@dataclass(frozen=True, eq=False)
class Die:
    """A solid with mass.

    A die with an anisotropic tensor, or with its centre of mass elsewhere than at the centroid, has
    `inertia_tensor_kg_m2`. Its `inertia_kg_m2` raises ValueError, because no one number would be right.
    """

    solid: Solid
    mass_kg: float
    inertia_kg_m2: float = field(repr=False)
    """About any axis through the centre of a spherical top. Give NaN (or the mean) with a tensor."""
    corner_radius_m: float = 0.0
    """Radius of the rounded corners and edges; `solid` stays the sharp polyhedron of the flat faces."""
    marks: str | None = None
    """`pips`, `numbers`, or None for plain faces."""
    inertia_tensor_kg_m2: Array | None = None
    """(3, 3) about the centre of mass, body axes; None for a spherical top."""
    centre_of_mass_m: Array | None = None
    """(3,) from the centroid of the solid, body axes; None if it is that."""
    is_homogeneous: bool = False
    """Whether inertia and centre of mass are those of the homogeneous rounded body, and follow its corner radius."""

    def __post_init__(self) -> None:
        centre = None if self.centre_of_mass_m is None else np.array(self.centre_of_mass_m, float)
        if centre is not None and not centre.any():
            centre = None
        tensor = None if self.inertia_tensor_kg_m2 is None else np.array(self.inertia_tensor_kg_m2, float)
        if tensor is None and centre is not None:
            tensor = self.inertia_kg_m2 * np.eye(3)
        object.__setattr__(self, "centre_of_mass_m", centre)
        object.__setattr__(self, "inertia_tensor_kg_m2", tensor)
        if tensor is not None:
            # Removed from the instance, so that reading it ends in __getattr__ below.
            object.__delattr__(self, "inertia_kg_m2")

    def __getattr__(self, name: str) -> float:
        """Raise the error for `inertia_kg_m2` of an asymmetric die; Python calls this for missing attributes only."""
        if name == "inertia_kg_m2":
            raise InputError(
                f"inertia_kg_m2 of a {self.solid.name} that is no spherical top: wanted a die with one moment of "
                "inertia and its centre of mass at the centroid; use inertia_tensor_kg_m2"
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def with_corner_radius(self, corner_radius_m: float) -> Die:
        """The same die with another radius of its corners. A homogeneous one keeps its mass, and its inertia follows.

        Raises ValueError for a radius that leaves no solid (`inner_vertices`)."""
        if self.is_homogeneous:
            return die_from_solid(self.solid, self.mass_kg, corner_radius_m=corner_radius_m, marks=self.marks)
        return self._changed(corner_radius_m=corner_radius_m)

    def with_marks(self, marks: str | None) -> Die:
        """The same die with other marks on its faces."""
        return self._changed(marks=marks)

    def with_numbers(self, numbers: Sequence[int]) -> Die:
        """The same die with its faces reordered by the numbers that they carry, as `numbered_solid`."""
        return self._changed(solid=numbered_solid(self.solid, numbers))

    def _changed(self, **changes: Any) -> Die:
        """`dataclasses.replace`, which does not find the moment of inertia of a die that has several."""
        given = {part.name: vars(self).get(part.name, np.nan) for part in fields(self)}
        return Die(**{**given, **changes})

    @property
    def is_spherical_top(self) -> bool:
        """Whether the inertia is the same about every axis and the centre of mass is the centroid."""
        return self.inertia_tensor_kg_m2 is None

    @property
    def isotropic_inertia_kg_m2(self) -> float | None:
        """The moment of inertia about every axis through the centre of mass, wherever that lies; None if they differ."""
        if self.inertia_tensor_kg_m2 is None:
            return self.inertia_kg_m2
        return _isotropic_moment(self.inertia_tensor_kg_m2)

    @property
    def is_nearly_centred(self) -> bool:
        """Whether the centroid moves as the centre of mass does, to NEARLY_CENTRED: a body without symmetry whose corners are
        rounded has it a little beside."""
        offset_m = float(np.linalg.norm(self.centre_of_mass_offset_m))
        return offset_m <= NEARLY_CENTRED * self.solid.circumradius

    @property
    def centre_of_mass_offset_m(self) -> Array:
        """(3,) centre of mass from the centroid, body axes; zeros if it is the centroid."""
        return np.zeros(3) if self.centre_of_mass_m is None else self.centre_of_mass_m

    @property
    def tensor_kg_m2(self) -> Array:
        """(3, 3) inertia tensor about the centre of mass, body axes, of any die."""
        return self.inertia_kg_m2 * np.eye(3) if self.inertia_tensor_kg_m2 is None else self.inertia_tensor_kg_m2


def make_die(
    shape: str,
    edge_m: float,
    mass_kg: float,
    *,
    inertia_kg_m2: float | None = None,
    corner_radius_m: float = 0.0,
    marks: str | None = None,
) -> Die:
    """One of the five isohedral dice. Its inertia follows from shape, edge, corner radius and mass unless it is given.

    Raises ValueError for an unknown shape, and for an edge, mass, inertia or corner radius that no such die has.
    """
    for name, value in (("edge_m", edge_m), ("mass_kg", mass_kg), ("inertia_kg_m2", inertia_kg_m2)):
        if value is not None:
            check_positive(name, value)
    solid = isohedral_solid(shape, edge_m)
    if not 0 <= corner_radius_m <= MAX_CORNER_RADIUS_FRACTION * solid.inradius:
        raise InputError(
            f"corner_radius_m = {corner_radius_m}: wanted 0 or more, "
            f"and at most {MAX_CORNER_RADIUS_FRACTION:g} times the inscribed radius of {solid.inradius:.6g} m"
        )
    largest = 2.0 / 3.0 * mass_kg * solid.circumradius**2
    if inertia_kg_m2 is not None and not MIN_INERTIA_FRACTION * largest <= inertia_kg_m2 <= largest:
        raise InputError(
            f"inertia_kg_m2 = {inertia_kg_m2}: wanted {MIN_INERTIA_FRACTION * largest:.3g} to {largest:.3g}, which is the "
            "moment with all of the mass at the distance of the corners"
        )
    if inertia_kg_m2 is None:
        return die_from_solid(solid, mass_kg, corner_radius_m=corner_radius_m, marks=marks)
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

    `inertia_tensor_kg_m2` (3, 3) is about the centre of mass, in body axes. `centre_of_mass_m` (3,) counts from the
    centroid and needs a tensor with it. A tensor that is isotropic to `ISOTROPY_TOLERANCE`, about the centroid, makes a
    spherical top. Raises ValueError for a tensor that is not symmetric or whose principal moments violate the triangle
    inequality, a centre of mass outside the solid, and a corner radius that splits a corner.
    """
    check_positive("mass_kg", mass_kg)
    centre = None if centre_of_mass_m is None else _point_inside(solid, "centre_of_mass_m", centre_of_mass_m)
    is_homogeneous = inertia_tensor_kg_m2 is None
    if inertia_tensor_kg_m2 is not None:
        tensor = _checked_tensor(inertia_tensor_kg_m2)
        inner_vertices(solid, corner_radius_m)
    elif centre is not None and centre.any():
        raise InputError(
            f"centre_of_mass_m = {centre.tolist()} without an inertia tensor: wanted both, because the centre of mass "
            "alone does not give the inertia; give inertia_tensor_kg_m2, or use loaded_die"
        )
    else:
        spread = mass_distribution(solid, corner_radius_m)
        tensor, centre = mass_kg * spread.unit_inertia_m2, spread.centroid_m
        if np.linalg.norm(centre) <= max(CENTRED_TOLERANCE, ROUNDINGS * solid.rounding) * solid.circumradius:
            centre = None
    mean = float(np.trace(tensor)) / 3.0
    tolerance = max(ISOTROPY_TOLERANCE, ROUNDINGS * solid.rounding) if is_homogeneous else ISOTROPY_TOLERANCE
    is_isotropic = _isotropic_moment(tensor, tolerance) is not None
    tensor_given = None if is_isotropic else tensor
    return Die(solid, mass_kg, mean, corner_radius_m, marks, tensor_given, centre, is_homogeneous)


def loaded_die(
    solid: Solid,
    mass_kg: float,
    load_kg: float,
    load_position_m: ArrayLike,
    *,
    corner_radius_m: float = 0.0,
    marks: str | None = None,
) -> Die:
    """A homogeneous solid of `mass_kg` with a point mass of `load_kg` at `load_position_m` (3,) from its centroid.

    With M the mass of the solid, m that of the load and d its position from the centroid of the rounded body, the centre of
    mass lies by m d/(M + m) from there. The tensor about it is that of the solid plus μ (d² 1 - d dᵀ), with
    μ = M m/(M + m), by the parallel axis theorem for both parts. Raises ValueError for a mass that is not above 0, a load
    below 0, or a load outside the solid.
    """
    check_positive("mass_kg", mass_kg)
    if not (np.isfinite(load_kg) and load_kg >= 0.0):
        raise InputError(f"load_kg = {load_kg}: wanted a finite number, 0 or more")
    position = _point_inside(solid, "load_position_m", load_position_m)
    body = mass_distribution(solid, corner_radius_m)
    lever, share = position - body.centroid_m, load_kg / (mass_kg + load_kg)
    spread = float(lever @ lever) * np.eye(3) - np.outer(lever, lever)
    return die_from_solid(
        solid,
        mass_kg + load_kg,
        inertia_tensor_kg_m2=mass_kg * (body.unit_inertia_m2 + share * spread),
        centre_of_mass_m=body.centroid_m + share * lever,
        corner_radius_m=corner_radius_m,
        marks=marks,
    )


def _isotropic_moment(tensor: Array, tolerance: float = ISOTROPY_TOLERANCE) -> float | None:
    """The mean moment of an isotropic tensor (3, 3); None for any other."""
    mean = float(np.trace(tensor)) / 3.0
    is_isotropic = np.abs(tensor - mean * np.eye(3)).max() <= tolerance * mean
    return mean if is_isotropic else None


def _point_inside(solid: Solid, name: str, point: ArrayLike) -> Array:
    """The point (3,) as an array. Raises ValueError, naming it, unless it lies inside the solid."""
    position = np.asarray(point, float)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InputError(f"{name} = {position.tolist()}: wanted 3 finite numbers")
    if (solid.normals @ position >= solid.offsets).any():
        raise InputError(
            f"{name} = {position.tolist()}: wanted a point inside the {solid.name}, measured from its centroid"
        )
    return position


def _checked_tensor(given: ArrayLike) -> Array:
    """The tensor (3, 3), made exactly symmetric. Raises ValueError for a tensor that no body has."""
    tensor = np.asarray(given, float)
    if tensor.shape != (3, 3) or not np.isfinite(tensor).all():
        raise InputError(f"inertia_tensor_kg_m2 of shape {tensor.shape}: wanted (3, 3) finite numbers")
    size = float(np.abs(tensor).max())
    if np.abs(tensor - tensor.T).max() > TENSOR_TOLERANCE * size:
        raise InputError(f"inertia_tensor_kg_m2 = {tensor.tolist()}: wanted a symmetric tensor")
    tensor = 0.5 * (tensor + tensor.T)
    small, middle, large = np.linalg.eigvalsh(tensor)
    if small <= 0.0 or large > (small + middle) * (1.0 + TENSOR_TOLERANCE):
        raise InputError(
            f"inertia_tensor_kg_m2 with principal moments {small:.6g}, {middle:.6g}, {large:.6g}: wanted all above 0 "
            "and none larger than the sum of the other two"
        )
    return tensor
