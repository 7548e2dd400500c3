"""A die as geometry and mass: a convex polyhedron, its faces, edges and inertia.

The five isohedral dice are homogeneous and sharp, and so spherical tops (Kapitaniak et al., Chaos 22, 047504, 2012):
their inertia tensor is a multiple of the identity. Here it is not typed in but integrated over the volume, which the
tests compare with the paper's formulas. Any other convex solid (the paper's truncated dipyramids among them) and a
die with a load in it are dice too: they carry an inertia tensor and, where it is not the centroid, a centre of mass.

The body frame has its origin at the centroid. Face k carries the number k + 1; on the cube opposite faces add up to
seven and 1, 2, 3 turn counter-clockwise round their common corner (the Western, right-handed die).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

Array = NDArray[np.float64]

ROUNDEST = 0.95
"""Largest corner radius, as a part of the inscribed radius: beyond it a die is a ball that never comes to rest."""

SHAPES = ("tetrahedron", "cube", "octahedron", "dodecahedron", "icosahedron")


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex polyhedron, in its body frame."""

    name: str
    vertices: Array
    """(n, 3) [m], origin at the centroid of the homogeneous solid."""
    faces: tuple[tuple[int, ...], ...]
    """Vertex indices of each face, counter-clockwise seen from outside."""
    normals: Array
    """(faces, 3) outward unit normals."""
    offsets: Array
    """(faces,) [m], distance of each face plane from the origin."""
    edges: NDArray[np.int64]
    """(e, 2) vertex indices."""
    edge_faces: NDArray[np.int64]
    """(e, 2) the two faces that meet in each edge: the first runs along the edge as written, the second against."""

    @property
    def circumradius(self) -> float:
        """[m] distance of the farthest vertex from the centroid."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @property
    def edge_m(self) -> float:
        """[m] length of the first edge: of every edge, on the five dice."""
        return float(np.linalg.norm(np.subtract(*self.vertices[self.edges[0]])))

    @property
    def inradius(self) -> float:
        """[m] distance of the nearest face plane from the centroid."""
        return float(self.offsets.min())


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
    def moment_kg_m2(self) -> float | None:
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
            _check_positive(name, value)
    solid = isohedral_solid(shape, edge_m)
    if not 0 <= corner_radius_m <= ROUNDEST * solid.inradius:
        raise ValueError(
            f"corner_radius_m = {corner_radius_m}: wanted 0 or more, "
            f"and at most {ROUNDEST:g} of the inscribed radius {solid.inradius:.6g}"
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
    _check_positive("mass_kg", mass_kg)
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
    _check_positive("mass_kg", mass_kg)
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


def truncated_dipyramid(sides: int, radius_m: float, half_height_m: float, cut: float) -> Solid:
    """A dipyramid over a regular polygon with both tips cut off (the paper's Fig. 2): 2n congruent side faces.

    `sides` is n, the corners of the polygon in the plane z = 0; `radius_m` its circumscribed circle; the tips of the
    uncut dipyramid stand at ±`half_height_m` on the z axis; `cut` in [0, 1) is the part of each tip's height that the
    planes z = ±(1 - cut) half_height_m take away, 0 for the plain dipyramid. Faces 1 to n are the upper side faces,
    counter-clockwise seen from above and beginning at the x axis, n + 1 to 2n the lower ones below them, and where the
    tips are cut 2n + 1 is the upper and 2n + 2 the lower cut.
    """
    if sides < 3:
        raise ValueError(f"sides = {sides}: wanted a polygon of three sides or more")
    _check_positive("radius_m", radius_m)
    _check_positive("half_height_m", half_height_m)
    if cut != 0.0 and not 1e-6 <= cut <= 1.0 - 1e-6:
        # Smaller faces could not be told from a vertex, or the solid from a disc, within rounding.
        raise ValueError(f"cut = {cut}: wanted 0, or a part of the tip's height from 1e-6 to 1 - 1e-6")
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = radius_m * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sides)])
    height = (1.0 - cut) * half_height_m
    if cut == 0.0:
        ends = np.array([[0.0, 0.0, height], [0.0, 0.0, -height]])
    else:
        ends = np.vstack([ring * cut + [0.0, 0.0, height], ring * cut - [0.0, 0.0, height]])
    hull = convex_solid(np.vstack([ring, ends]), f"dipyramid-{2 * sides}" + (f"-cut-{cut:g}" if cut else ""))
    middle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    apothem = radius_m * np.cos(np.pi / sides)
    outward = np.column_stack([half_height_m * np.cos(middle), half_height_m * np.sin(middle), np.full(sides, apothem)])
    wanted = [*outward, *(outward * [1.0, 1.0, -1.0])]
    if cut:
        wanted += [np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])]
    return _renumbered(hull, [int(np.argmax(hull.normals @ n)) for n in wanted])


def inner_vertices(solid: Solid, radius_m: float) -> Array:
    """Corners (n, 3) [m] of the solid whose face planes are moved in by `radius_m`, in the order of `vertices`.

    A die with rounded corners is all points within that radius of this inner solid. Raises ValueError where the radius
    is below 0 or leaves no solid, where a face would vanish, and where more than three faces meet in a corner that
    would split into several.
    """
    if not 0.0 <= radius_m < solid.inradius:
        raise ValueError(
            f"corner_radius_m = {radius_m}: wanted 0 or more, and less than the inscribed radius {solid.inradius:.6g}"
        )
    if np.ptp(solid.offsets) <= 1e-12 * solid.inradius:
        # All faces touch one sphere about the centroid: moving them in is the same as shrinking the solid.
        return solid.vertices * (1.0 - radius_m / solid.inradius)
    moved = solid.offsets - radius_m
    corners = np.empty_like(solid.vertices)
    for i in range(len(corners)):
        meeting = [k for k, face in enumerate(solid.faces) if i in face]
        corners[i] = np.linalg.lstsq(solid.normals[meeting], moved[meeting], rcond=None)[0]
        gap = float(np.abs(solid.normals[meeting] @ corners[i] - moved[meeting]).max())
        if gap > 1e-9 * solid.circumradius:
            raise ValueError(
                f"corner_radius_m = {radius_m} on a {solid.name}: the {len(meeting)} faces that meet in vertex {i} "
                "would no longer meet in one point; wanted a radius of 0, or a solid with three faces at that vertex"
            )
    if (corners @ solid.normals.T - moved).max() > 1e-9 * solid.circumradius:
        raise ValueError(
            f"corner_radius_m = {radius_m} on a {solid.name}: a face would vanish; wanted a smaller radius"
        )
    return corners


def isohedral_solid(shape: str, edge_m: float) -> Solid:
    """A regular solid with the given edge length [m]. Raises ValueError for a shape that is not in SHAPES."""
    if shape not in SHAPES:
        raise ValueError(f"shape = {shape!r}: wanted one of {', '.join(SHAPES)}")
    unit = _unit_solid(shape)
    return Solid(
        unit.name, unit.vertices * edge_m, unit.faces, unit.normals, unit.offsets * edge_m, unit.edges, unit.edge_faces
    )


def convex_solid(points: ArrayLike, name: str = "polyhedron") -> Solid:
    """The convex hull of points (n, 3) [m] as a solid about its centroid; coplanar facets become one face.

    Raises ValueError where the points do not span a volume.
    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
        raise ValueError(f"vertices of shape {points.shape}: wanted at least four finite points (n, 3)")
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if spread[2] < 1e-9 * spread[0]:
        raise ValueError("vertices lie in one plane: wanted points that span a volume")
    hull = ConvexHull(points)
    kept = np.sort(hull.vertices)
    vertices = points[kept]
    vertices = vertices - _centroid(vertices, _merged_faces(vertices)[0])
    faces, normals = _merged_faces(vertices)
    offsets = np.array([float((vertices[list(f)] @ n).mean()) for f, n in zip(faces, normals, strict=True)])
    edges, edge_faces = _edges(faces)
    return Solid(name, vertices, faces, normals, offsets, edges, edge_faces)


def numbered_solid(solid: Solid, numbers: Sequence[int]) -> Solid:
    """The same solid with its faces in the order of the numbers that they carry: `numbers` (faces,) of the faces as they are,
    1, 2, … each once. Vertices stay as they are. Raises ValueError for anything else."""
    if sorted(numbers) != list(range(1, len(solid.faces) + 1)):
        raise ValueError(
            f"numbers = {list(numbers)} for a {solid.name}: wanted each of 1 to {len(solid.faces)} once, one a face"
        )
    return _renumbered(solid, [int(k) for k in np.argsort(numbers)])


def unit_inertia(solid: Solid) -> Array:
    """Inertia tensor (3, 3) [m²] about the centroid of the homogeneous solid, for a mass of 1 kg.

    Volume integral over the tetrahedra spanned by the origin and the triangulated faces:
    ∫ x xᵀ dV = V/20 (Σ pᵢ pᵢᵀ + s sᵀ), with s the sum of the corners.
    """
    second = np.zeros((3, 3))
    volume = 0.0
    for face in solid.faces:
        a = solid.vertices[face[0]]
        for j in range(1, len(face) - 1):
            b, c = solid.vertices[face[j]], solid.vertices[face[j + 1]]
            part = float(a @ np.cross(b, c)) / 6.0
            total = a + b + c
            second += part / 20.0 * (np.outer(a, a) + np.outer(b, b) + np.outer(c, c) + np.outer(total, total))
            volume += part
    second /= volume
    return np.asarray(np.trace(second) * np.eye(3) - second)


def lowest_face(solid: Solid, rotation: ArrayLike) -> int:
    """Number (1, 2, …) of the face that looks down most: the largest -ẑ·nᵢ. `rotation` (3, 3) is body to world."""
    return int(np.argmin(solid.normals @ np.asarray(rotation)[2])) + 1


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
    own = _frame(V[first], V[second])
    found = []
    for p in others:
        for q in others:
            alike = abs(p @ p - V[first] @ V[first]) + abs(q @ q - V[second] @ V[second])
            if alike + abs(p @ q - V[first] @ V[second]) > 1e-9 * size**2:
                continue
            turn = _frame(p, q) @ own.T
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


def _check_positive(name: str, value: float) -> None:
    """Raise ValueError, naming the quantity, unless it is finite and above 0."""
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value}: wanted a finite number above 0")


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


def _renumbered(solid: Solid, order: list[int]) -> Solid:
    """The same solid with its faces in the given order."""
    faces = tuple(solid.faces[k] for k in order)
    edges, edge_faces = _edges(faces)
    return Solid(solid.name, solid.vertices, faces, solid.normals[order], solid.offsets[order], edges, edge_faces)


def _frame(u: Array, v: Array) -> Array:
    """Right-handed axes (3, 3), in columns: along u, and across it in the plane of u and v."""
    x = u / np.linalg.norm(u)
    z = np.cross(u, v)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


@cache
def _unit_solid(shape: str) -> Solid:
    """The regular solid of edge 1, with its faces in numbered order."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    signs = np.array([-1.0, 1.0])
    cube = np.array([(x, y, z) for z in signs for y in signs for x in signs])
    if shape == "tetrahedron":
        corners = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)
    elif shape == "cube":
        corners = cube
    elif shape == "octahedron":
        corners = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
    elif shape == "icosahedron":
        ring = [(0.0, s, t * golden) for s in signs for t in signs]
        corners = np.array([np.roll(p, k) for k in range(3) for p in ring])
    else:
        ring = [(0.0, s / golden, t * golden) for s in signs for t in signs]
        corners = np.vstack([cube, [np.roll(p, k) for k in range(3) for p in ring]])
    solid = convex_solid(corners, shape)
    edge = solid.edge_m
    order = _cube_order(solid) if shape == "cube" else list(range(len(solid.faces)))
    ordered = _renumbered(solid, order)
    return Solid(
        shape,
        solid.vertices / edge,
        ordered.faces,
        ordered.normals,
        ordered.offsets / edge,
        ordered.edges,
        ordered.edge_faces,
    )


def _cube_order(solid: Solid) -> list[int]:
    """Faces as on the Western die: 1 +z, 2 +x, 3 +y, 4 -y, 5 -x, 6 -z."""
    wanted = np.array([(0, 0, 1), (1, 0, 0), (0, 1, 0), (0, -1, 0), (-1, 0, 0), (0, 0, -1)])
    return [int(np.argmax(solid.normals @ n)) for n in wanted]


def _merged_faces(vertices: Array) -> tuple[tuple[tuple[int, ...], ...], Array]:
    """Faces of the hull of `vertices`, coplanar triangles merged, each counter-clockwise from outside."""
    hull = ConvexHull(vertices)
    size = float(np.ptp(vertices, axis=0).max())
    faces: list[tuple[int, ...]] = []
    normals: list[Array] = []
    for equation in hull.equations:
        normal = equation[:3]
        if any(normal @ other > 1.0 - 1e-9 for other in normals):
            continue
        on = np.flatnonzero(np.abs(vertices @ normal + equation[3]) < 1e-9 * size)
        middle = vertices[on].mean(0)
        u = vertices[on[0]] - middle
        spokes = vertices[on] - middle
        angles = np.arctan2(spokes @ np.cross(normal, u), spokes @ u)
        faces.append(tuple(int(i) for i in on[np.argsort(angles)]))
        normals.append(normal)
    return tuple(faces), np.array(normals)


def _centroid(vertices: Array, faces: tuple[tuple[int, ...], ...]) -> Array:
    """Centroid of the solid, from tetrahedra about the mean vertex (well conditioned far from the origin)."""
    origin = vertices.mean(0)
    volume, moment = 0.0, np.zeros(3)
    for face in faces:
        a = vertices[face[0]] - origin
        for j in range(1, len(face) - 1):
            b, c = vertices[face[j]] - origin, vertices[face[j + 1]] - origin
            part = float(a @ np.cross(b, c)) / 6.0
            volume += part
            moment += part * (a + b + c) / 4.0
    return np.asarray(origin + moment / volume)


def _edges(faces: tuple[tuple[int, ...], ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Edges (e, 2) and their two faces (e, 2), in the order in which they are met."""
    runs_along = {(f[j], f[(j + 1) % len(f)]): k for k, f in enumerate(faces) for j in range(len(f))}
    once = [pair for pair in runs_along if pair[0] < pair[1]]
    sides = [(runs_along[a, b], runs_along[b, a]) for a, b in once]
    return np.array(once, np.int64), np.array(sides, np.int64)
