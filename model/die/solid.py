"""Convex polyhedra: vertices, faces, edges, and the inner polyhedron of a body with rounded corners.

The five isohedral dice are spherical tops if they are homogeneous (Kapitaniak et al., Chaos 22, 047504, 2012): their inertia
tensor is a multiple of the identity (`mass_distribution`). Any other convex solid can be a die as well (`named_solids`).

The body frame has its origin at the centroid. Face k carries the number k + 1. On the cube opposite faces add up to
seven, and 1, 2, 3 turn counter-clockwise round their common corner (the Western, right-handed die).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from ..errors import InputError

Array = NDArray[np.float64]

SHAPES = ("tetrahedron", "cube", "octahedron", "dodecahedron", "icosahedron")

MERGE_TOLERANCE = 1e-9
"""1 - cos of the angle between two facets, and distance of a vertex from a plane in sizes of the solid, within which facets
of the hull are one face."""

FLATNESS_TOLERANCE = 1e-9
"""Least ratio of the smallest to the largest extent of a set of points that spans a volume."""

CORNER_TOLERANCE = 1e-6
"""Distance, in circumradii, within which the moved planes of a corner still meet in one point: rounding of a mesh in single
precision. It is a hundredth of a micrometre on a die."""

FLAT_RAD = 2e-3
"""Angle [rad] between neighbouring facets of points in single precision, below which they are one face: slivers err by that."""

FLAT_SHARE = 1e-5
"""Distance of a corner of such a face from its plane, in sizes of the solid: rounding at a distance of ten sizes."""

SINGLE_PRECISION = 1e-6
"""Error of corners in single precision, in circumradii, at a distance of ten of them."""

RADIUS_STEP = 1e-6
"""Accuracy of the largest corner radius, in inscribed radii."""

CACHED_SOLIDS = 16
"""Solids whose largest corner radius is kept."""

EQUAL_EDGES = 1e-9
"""Range of the lengths of edges, as a share of one, within which they count as equal: rounding."""

INSPHERE_TOLERANCE = 1e-12
"""Range of face distances, in inscribed radii, within which all faces touch one sphere about the centroid: rounding."""


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
    """(e, 2) the two faces that meet in each edge. The first has the edge in the order written, the second reversed."""
    rounding: float = 0.0
    """Error of the corners, in circumradii, where it is larger than that of double precision."""
    dimensions: Mapping[str, Any] = field(default_factory=dict)
    """What `named_solid` was called with beside the name, in SI units; empty for a solid that was made otherwise."""

    @property
    def circumradius(self) -> float:
        """[m] largest distance of a vertex from the centroid."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @property
    def edge_m(self) -> float:
        """[m] length of every edge, or the mean length where edges differ."""
        lengths = np.linalg.norm(self.vertices[self.edges[:, 0]] - self.vertices[self.edges[:, 1]], axis=1)
        return float(lengths[0] if np.ptp(lengths) <= EQUAL_EDGES * lengths[0] else lengths.mean())

    @property
    def volume_m3(self) -> float:
        """[m³], as the sum of the tetrahedra from the centroid to triangles of the faces."""
        volume = 0.0
        for face in self.faces:
            corners = self.vertices[list(face)]
            for j in range(1, len(face) - 1):
                volume += float(corners[0] @ np.cross(corners[j], corners[j + 1])) / 6.0
        return volume

    @property
    def inradius(self) -> float:
        """[m] least distance of a face plane from the centroid."""
        return float(self.offsets.min())


def inner_vertices(solid: Solid, radius_m: float) -> Array:
    """Corners (n, 3) [m] of the solid whose face planes are moved inwards by `radius_m`, in the order of `vertices`.

    A die with rounded corners consists of all points within that radius of this inner solid. Raises ValueError for a
    radius below 0 or one that leaves no solid, for one at which a face vanishes, and for a corner of more than three
    faces that would split into several.
    """
    if not 0.0 <= radius_m < solid.inradius:
        raise InputError(
            f"corner_radius_m = {radius_m}: wanted 0 or more, and less than the inscribed radius {solid.inradius:.6g} m"
        )
    if np.ptp(solid.offsets) <= INSPHERE_TOLERANCE * solid.inradius:
        # All faces touch one sphere about the centroid, so moving them inwards shrinks the solid.
        return solid.vertices * (1.0 - radius_m / solid.inradius)
    moved = solid.offsets - radius_m
    corners = np.empty_like(solid.vertices)
    for i in range(len(corners)):
        meeting = [k for k, face in enumerate(solid.faces) if i in face]
        corners[i] = np.linalg.lstsq(solid.normals[meeting], moved[meeting], rcond=None)[0]
        gap = float(np.abs(solid.normals[meeting] @ corners[i] - moved[meeting]).max())
        if gap > CORNER_TOLERANCE * solid.circumradius:
            raise InputError(
                f"corner_radius_m = {radius_m} on a {solid.name}: the {len(meeting)} faces that meet in vertex {i} "
                "would no longer meet in one point; wanted a radius of 0, or a solid with three faces at that vertex"
            )
    if (corners @ solid.normals.T - moved).max() > CORNER_TOLERANCE * solid.circumradius:
        raise InputError(
            f"corner_radius_m = {radius_m} on a {solid.name}: a face would vanish; wanted a smaller radius"
        )
    return corners


@lru_cache(maxsize=CACHED_SOLIDS)
def largest_corner_radius(solid: Solid) -> float:
    """The largest radius [m] with which `inner_vertices` rounds a solid, to a millionth of the inscribed radius; 0 if corners of
    more than three faces split at any radius."""

    def can_be(radius_m: float) -> bool:
        try:
            inner_vertices(solid, radius_m)
        except ValueError:
            return False
        return True

    low, high = 0.0, solid.inradius
    if can_be((1.0 - RADIUS_STEP) * high):
        return (1.0 - RADIUS_STEP) * high
    while high - low > RADIUS_STEP * solid.inradius:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if can_be(middle) else (low, middle)
    return low


def isohedral_solid(shape: str, edge_m: float) -> Solid:
    """A regular solid with the given edge length [m]. Raises ValueError for a shape that is not in SHAPES."""
    if shape not in SHAPES:
        raise InputError(f"shape = {shape!r}: wanted one of {', '.join(SHAPES)}")
    unit = _unit_solid(shape)
    return Solid(
        unit.name, unit.vertices * edge_m, unit.faces, unit.normals, unit.offsets * edge_m, unit.edges, unit.edge_faces,
        dimensions={"edge_m": edge_m},
    )  # fmt: skip


def convex_solid(points: ArrayLike, name: str = "polyhedron") -> Solid:
    """The convex hull of points (n, 3) [m] as a solid about its centroid; coplanar facets become one face.

    Raises ValueError for points that do not span a volume.
    """
    points = _spanning(np.asarray(points, float))
    hull = ConvexHull(points)
    kept = np.sort(hull.vertices)
    vertices = points[kept]
    vertices = vertices - _centroid(vertices, _merged_faces(vertices)[0])
    return _with_faces(name, vertices, *_merged_faces(vertices))


def solid_of_rounded_points(points: ArrayLike, name: str) -> Solid:
    """As `convex_solid`, for points (n, 3) [m] in single precision, of which those of one face lie in one plane within their
    rounding only.

    Facets of the hull that meet at less than FLAT_RAD are one face; it is bounded by its edges to others. A point that is no
    corner of three faces is left out. Raises ValueError as `convex_solid` does, and for a face that is not flat.
    """
    points = np.asarray(points, float)
    hull = ConvexHull(_spanning(points))
    normals = hull.equations[:, :3]
    # The normal of a sliver is rounding: it belongs to the face across its longest side.
    corners = points[hull.simplices]
    sides = np.linalg.norm(
        corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]], axis=2
    )  # each opposite to a corner, as neighbours are
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    is_sliver = doubled / sides.max(axis=1) < FLAT_SHARE * np.ptp(points, axis=0).max()
    flat = [(int(k), int(hull.neighbors[k][sides[k].argmax()])) for k in np.flatnonzero(is_sliver)]
    for k, row in enumerate(hull.neighbors):
        plain = [n for n in row if not is_sliver[k] and not is_sliver[n]]
        flat += [(k, int(n)) for n in plain if normals[k] @ normals[n] > np.cos(FLAT_RAD)]
    links = coo_array((np.ones(len(flat)), np.array(flat, int).reshape(-1, 2).T), shape=(len(normals), len(normals)))
    count, face_of = connected_components(links, directed=False)
    loops = [_loop(points, hull.simplices[face_of == k], normals[face_of == k]) for k in range(count)]
    meeting = np.bincount(np.concatenate(loops), minlength=len(points))
    kept = np.flatnonzero(meeting >= 3)
    number = {int(v): k for k, v in enumerate(kept)}
    faces = tuple(tuple(number[v] for v in loop if v in number) for loop in loops)
    if min(len(face) for face in faces) < 3:
        raise InputError(f"{name}: a face has fewer than three corners; wanted a polyhedron of flat faces")
    vertices = points[kept] - _centroid(points[kept], faces)
    planes = [_plane(vertices[list(face)]) for face in faces]
    size = float(np.ptp(vertices, axis=0).max())
    if any(off > FLAT_SHARE * size for _, off in planes):
        raise InputError(f"{name}: a face is bent; wanted flat faces")
    solid = _with_faces(name, vertices, faces, np.array([normal for normal, _ in planes]))
    return replace(solid, rounding=SINGLE_PRECISION)


def _with_faces(name: str, vertices: Array, faces: tuple[tuple[int, ...], ...], normals: Array) -> Solid:
    offsets = np.array([float((vertices[list(f)] @ n).mean()) for f, n in zip(faces, normals, strict=True)])
    edges, edge_faces = _edges(faces)
    return Solid(name, vertices, faces, normals, offsets, edges, edge_faces)


def _spanning(points: Array) -> Array:
    """The points. Raises ValueError unless they span a volume."""
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
        raise InputError(f"vertices of shape {points.shape}: wanted at least four finite points (n, 3)")
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if spread[2] < FLATNESS_TOLERANCE * spread[0]:
        raise InputError("vertices lie in one plane: wanted points that span a volume")
    return points


def _loop(points: Array, triangles: NDArray[np.int64], normals: Array) -> list[int]:
    """The outline of a face that consists of triangles (n, 3), counter-clockwise from outside."""
    outer: set[tuple[int, int]] = set()
    for (a, b, c), normal in zip(triangles.tolist(), normals, strict=True):
        if np.cross(points[b] - points[a], points[c] - points[a]) @ normal < 0.0:
            b, c = c, b
        for u, v in ((a, b), (b, c), (c, a)):
            # An edge between two triangles of the face runs both ways.
            outer ^= {(v, u)} if (v, u) in outer else {(u, v)}
    follows = dict(outer)
    loop = [next(iter(follows))]
    while follows[loop[-1]] != loop[0]:
        loop.append(follows[loop[-1]])
    return loop


def _plane(corners: Array) -> tuple[Array, float]:
    """The outward normal (3,) of the plane nearest to corners (n, 3) about the centroid of their solid, and the largest distance
    of a corner from it."""
    middle = corners.mean(0)
    normal = np.linalg.svd(corners - middle)[2][2]
    normal = normal if normal @ middle > 0.0 else -normal
    return normal, float(np.abs((corners - middle) @ normal).max())


def numbered_solid(solid: Solid, numbers: Sequence[int]) -> Solid:
    """The same solid with its faces reordered, so that the face that carries the number k + 1 is face k.

    `numbers` (faces,) are those of the faces in their present order: 1, 2, … each once, otherwise ValueError. Vertices keep
    their order.
    """
    if sorted(numbers) != list(range(1, len(solid.faces) + 1)):
        raise InputError(f"numbers = {list(numbers)} for a {solid.name}: wanted each of 1 to {len(solid.faces)} once")
    return renumbered(solid, [int(k) for k in np.argsort(numbers)])


def lowest_face(solid: Solid, rotation: ArrayLike) -> int:
    """Number (1, 2, …) of the face whose normal n points down most, by the largest -ẑ·n. `rotation` (3, 3) is body to world."""
    return int(np.argmin(solid.normals @ np.asarray(rotation)[2])) + 1


def check_positive(name: str, value: float) -> None:
    """Raise ValueError, naming the quantity, unless it is finite and above 0."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} = {value}: wanted a finite number above 0")


def renumbered(solid: Solid, order: list[int]) -> Solid:
    """The same solid with its faces in the given order."""
    faces = tuple(solid.faces[k] for k in order)
    edges, edge_faces = _edges(faces)
    return replace(
        solid, faces=faces, normals=solid.normals[order], offsets=solid.offsets[order], edges=edges, edge_faces=edge_faces
    )  # fmt: skip


def plane_axes(u: Array, v: Array) -> Array:
    """Right-handed orthonormal axes (3, 3) in columns: x along u, y in the plane of u and v, z along u × v."""
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
    ordered = renumbered(solid, order)
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
        if any(normal @ other > 1.0 - MERGE_TOLERANCE for other in normals):
            continue
        on = np.flatnonzero(np.abs(vertices @ normal + equation[3]) < MERGE_TOLERANCE * size)
        middle = vertices[on].mean(0)
        u = vertices[on[0]] - middle
        spokes = vertices[on] - middle
        angles = np.arctan2(spokes @ np.cross(normal, u), spokes @ u)
        faces.append(tuple(int(i) for i in on[np.argsort(angles)]))
        normals.append(normal)
    return tuple(faces), np.array(normals)


def _centroid(vertices: Array, faces: tuple[tuple[int, ...], ...]) -> Array:
    """Centroid of the solid, from tetrahedra about the mean vertex, which is accurate far from the origin too."""
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
    """Edges (e, 2) and the two faces of each (e, 2), in the order of the faces."""
    runs_along = {(f[j], f[(j + 1) % len(f)]): k for k, f in enumerate(faces) for j in range(len(f))}
    once = [pair for pair in runs_along if pair[0] < pair[1]]
    sides = [(runs_along[a, b], runs_along[b, a]) for a, b in once]
    return np.array(once, np.int64), np.array(sides, np.int64)
