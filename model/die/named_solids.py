"""Solids by name and dimensions, as a `[die]` table gives them: `named_solid` has all of them, `SOLID_KINDS` describes them.

The d10 is a pentagonal trapezohedron: ten kites, five at each tip, between which a ring of ten corners goes up and down by
z₀ = h tan²(π/10), with h the height of a tip, because a kite is flat. Its long edges (from tip to ring) and its short ones (along
the ring) measure, with the ring at the distance r from the axis,

    long² = r² + (h - z₀)²,    short² = 4 r² sin²(π/10) + 4 z₀².
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .solid import SHAPES, Solid, check_positive, convex_solid, isohedral_solid, renumbered, solid_of_rounded_points

MIN_CUT = 1e-6
"""Least part of a tip that may be cut off, or left. With less, rounding cannot separate a face from a vertex, or the solid
from a disc."""
MESH_SUFFIXES = (".stl", ".obj", ".ply", ".off")
"""Files of meshes that `solid_from_mesh` reads."""

MOST_FACES = 200
"""Faces of a solid from a mesh. A mesh with more of them has rounded corners or engraved marks."""

CONVEX_SHARE = 1e-4
"""Volume that a mesh may lack of its convex hull, as a share."""


@dataclass(frozen=True)
class SolidKind:
    """How solids of one name are described."""

    build: Callable[..., Solid]
    """From its dimensions, by name."""
    dimensions: dict[str, str]
    """What each of them is."""
    optional: tuple[str, ...] = ()
    """Those that may be left out."""


def truncated_dipyramid(sides: int, radius_m: float, half_height_m: float, cut: float) -> Solid:
    """A dipyramid over a regular polygon with both tips cut off (the paper's Fig. 2): 2n congruent side faces.

    `sides` is n, the number of corners of the polygon in the plane z = 0, and `radius_m` its circumscribed radius. The tips of
    the uncut dipyramid stand at z = ±`half_height_m`. `cut` in [0, 1) is the part of each tip's height that the planes
    z = ±(1 - cut) half_height_m remove, 0 for the plain dipyramid. Faces 1 to n are the upper side faces, counter-clockwise
    seen from above and beginning at the x axis; n + 1 to 2n are the lower ones below them. If the tips are cut, 2n + 1 is the
    upper and 2n + 2 the lower cut. Raises ValueError for fewer than three sides, a length that is not above 0, or another cut.
    """
    if sides < 3:
        raise InputError(f"sides = {sides}: wanted a polygon of three sides or more")
    check_positive("radius_m", radius_m)
    check_positive("half_height_m", half_height_m)
    if cut != 0.0 and not MIN_CUT <= cut <= 1.0 - MIN_CUT:
        raise InputError(f"cut = {cut}: wanted 0, or a part of the tip's height from {MIN_CUT:g} to 1 - {MIN_CUT:g}")
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
    return renumbered(hull, [int(np.argmax(hull.normals @ n)) for n in wanted])


def cuboid(edges_m: Sequence[float]) -> Solid:
    """A cuboid with edges of three lengths along x, y and z. Faces as on the cube: 1 is +z, 2 +x, 3 +y, and opposite faces add
    up to seven. Raises ValueError for other than three lengths above 0."""
    if len(edges_m) != 3:
        raise InputError(f"edges_m = {list(edges_m)}: wanted 3 lengths")
    for edge_m in edges_m:
        check_positive("edges_m", edge_m)
    half = 0.5 * np.array(edges_m, float)
    hull = convex_solid([half * (x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], "cuboid")
    wanted = np.array([(0, 0, 1), (1, 0, 0), (0, 1, 0), (0, -1, 0), (-1, 0, 0), (0, 0, -1)])
    return renumbered(hull, [int(np.argmax(hull.normals @ n)) for n in wanted])


def pentagonal_trapezohedron(edge_m: float, short_edge_m: float) -> Solid:
    """The d10, with its tips on the z axis, `edge_m` long from a tip to the ring of corners between them, and `short_edge_m` from
    one of these to the next. Faces 1 to 5 are the upper ones, counter-clockwise seen from above, and opposite faces add up to
    eleven. Raises ValueError for lengths that no such solid has: the shorter is 0.24 to 0.62 of the longer."""
    check_positive("edge_m", edge_m)
    check_positive("short_edge_m", short_edge_m)
    sine2, rise = np.sin(np.pi / 10.0) ** 2, np.tan(np.pi / 10.0) ** 2
    by_squares = np.array([[1.0, (1.0 - rise) ** 2], [4.0 * sine2, 4.0 * rise**2]])
    ring2, height2 = np.linalg.solve(by_squares, [edge_m**2, short_edge_m**2])
    low, high = 2.0 * rise / (1.0 - rise), 2.0 * np.sqrt(sine2)
    if not (ring2 > 0.0 and height2 > 0.0):
        raise InputError(
            f"short_edge_m = {short_edge_m} beside edge_m = {edge_m}: wanted {low:.3g} to {high:.3g} of it, as a d10 with flat "
            "faces has"
        )
    ring_m, height_m = np.sqrt(ring2), np.sqrt(height2)
    angles = np.pi / 5.0 * np.arange(10)
    corners = np.column_stack(
        [ring_m * np.cos(angles), ring_m * np.sin(angles), rise * height_m * (-1.0) ** (np.arange(10) + 1)]
    )
    hull = convex_solid(np.vstack([corners, [[0.0, 0.0, height_m], [0.0, 0.0, -height_m]]]), "d10")
    # A kite at the upper tip has its lowest corner, one of even number, at its middle.
    slope = height_m * (1.0 + rise) / ring_m
    upper = [np.array([slope * np.cos(a), slope * np.sin(a), 1.0]) for a in angles[::2]]
    wanted = [*upper, *(-n for n in reversed(upper))]
    return renumbered(hull, [int(np.argmax(hull.normals @ n)) for n in wanted])


def polyhedron(corners_m: ArrayLike) -> Solid:
    """The convex solid with these corners (n, 3). Raises ValueError for a point that is no corner, and points in one plane."""
    solid = convex_solid(corners_m)
    given = len(np.asarray(corners_m))
    if len(solid.vertices) < given:
        raise InputError(
            f"corners_m: {given - len(solid.vertices)} of {given} points lie inside the others; wanted corners only"
        )
    return solid


def solid_from_mesh(path: Path, unit_m: float) -> Solid:
    """The solid in a file of a mesh (MESH_SUFFIXES), whose unit measures `unit_m` metres: 0.001 for millimetres.

    The body axes are those of the file. Raises ValueError for a file that is no mesh, a mesh that is not closed or not convex,
    and one of more than MOST_FACES faces.
    """
    import trimesh

    check_positive("unit_m", unit_m)
    try:
        mesh = trimesh.load(path, force="mesh")
    except Exception as error:  # trimesh raises whatever its parsers meet
        raise InputError(f"{path.name} cannot be read as a mesh ({type(error).__name__}: {error})") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) < 4 or not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path.name} holds no mesh of triangles")
    if not mesh.is_watertight:
        raise InputError(
            f"{path.name}: the surface has holes; wanted a closed surface; repair it in the program that made it"
        )
    solid = solid_of_rounded_points(unit_m * np.asarray(mesh.vertices, float), path.name)
    missing = 1.0 - abs(float(mesh.volume)) * unit_m**3 / solid.volume_m3
    if missing > CONVEX_SHARE:
        raise InputError(
            f"{path.name}: the body fills {1.0 - missing:.4f} of its convex hull; wanted a convex body, without engraved marks"
        )
    if len(solid.faces) > MOST_FACES:
        raise InputError(
            f"{path.name}: {len(solid.faces)} faces; wanted {MOST_FACES} at most: the sharp polyhedron of the flat faces, with "
            "corner_radius_m for its rounded corners"
        )
    return solid


def named_solid(shape: str, **dimensions: Any) -> Solid:
    """The solid of a name in SOLID_KINDS with its dimensions, [m]. Raises ValueError for another name, for dimensions that are
    missing or not of this shape, and as its builder does."""
    if shape not in SOLID_KINDS:
        raise InputError(f"shape = {shape!r}: wanted one of {', '.join(SOLID_KINDS)}")
    kind = SOLID_KINDS[shape]
    missing = [name for name in kind.dimensions if name not in dimensions and name not in kind.optional]
    if missing:
        raise InputError(f"{missing[0]} is missing; wanted {kind.dimensions[missing[0]]}")
    unknown = [name for name in dimensions if name not in kind.dimensions]
    if unknown:
        raise InputError(f"{unknown[0]} = {dimensions[unknown[0]]} of a {shape}: wanted {', '.join(kind.dimensions)}")
    return replace(kind.build(**dimensions), name=shape, dimensions=dimensions)


def _dipyramid(sides: int, radius_m: float, half_height_m: float, cut: float = 0.0) -> Solid:
    return truncated_dipyramid(sides, radius_m, half_height_m, cut)


def _isohedral(shape: str) -> SolidKind:
    def build(edge_m: float) -> Solid:
        return isohedral_solid(shape, edge_m)

    return SolidKind(build, {"edge_m": "the edge of the sharp polyhedron in metres, above 0"})


SOLID_KINDS = {
    **{shape: _isohedral(shape) for shape in SHAPES},
    "d10": SolidKind(
        pentagonal_trapezohedron,
        {
            "edge_m": "the longer edge of a d10, from a tip to the ring of corners between the tips, in metres, above 0",
            "short_edge_m": "the shorter edge of a d10, between neighbouring corners of the ring, in metres, above 0",
        },
    ),
    "cuboid": SolidKind(cuboid, {"edges_m": "3 lengths in metres, along x, y and z of the body"}),
    "dipyramid": SolidKind(
        _dipyramid,
        {
            "sides": "the number of corners of the polygon between the tips, 3 or more",
            "radius_m": "the distance of these corners from the axis in metres, above 0",
            "half_height_m": "the height of the uncut tips above the polygon in metres, above 0",
            "cut": "the part of the height of each tip that is cut off, 0 or more and below 1",
        },
        ("cut",),
    ),
    "polyhedron": SolidKind(polyhedron, {"corners_m": "4 or more corners, each of 3 numbers in metres"}),
}
"""Solids by name; lengths are those of the sharp polyhedron."""
