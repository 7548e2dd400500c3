"""The surface of a die for a renderer: a triangle mesh with exact normals, and one texture with the paint of all faces.

**Shape.** A die with rounded corners of radius r is the set of all points within r of the inner polyhedron
(`inner_vertices`). Its surface consists of flat faces at distance r from the inner ones, a piece of a cylinder along every
inner edge, and a piece of a sphere around every inner corner. Each is divided into triangles whose vertices lie on the
surface and carry its normal, so that the shading is that of the smooth body. A sharp die has its faces only.

**Paint.** Every face has a square tile of one texture (the atlas). The paint of a face covers its bevels up to their middle, by
projection onto the plane of the face.
Pips are placed as on a Western die; numbers are upright towards a corner of their face, or towards an edge on the cube.
Recessed marks are a second texture of heights, by which the renderer turns the normals; the mesh stays flat there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from ...model.die import Die, Solid, inner_vertices

Array = NDArray[np.float64]

BEVEL_STEPS = 8
"""Steps of a bevel from face to face: at a radius of 4 px the polyline deviates 0.005 px from a right-angled bevel."""
TILE_PX = 192
"""Size of a tile in the atlas; a face in an image is rarely more than half as large."""
TILE_MARGIN = 1.06
"""Half width of a tile in circumradii of its face: the texture filter must not reach the next tile."""
FINER = 4
"""Marks are drawn at this multiple of the resolution and averaged."""
PIP_STEP = 0.25
"""Distance of neighbouring pips in edges, as on ordinary 16 mm dice."""
PIP_RADIUS = 0.09
"""Radius of a pip in edges, likewise."""
GRAIN_PX = 1.5
"""Standard deviation of the blur of the grain, in pixels of the atlas: specks of a few hundredths of a face."""
NUMBER_WIDTH = 1.35
"""Diagonal of a number's bounding box in inradii of its face: clear of the edges."""
SPECK_PX = 4.0
"""Standard deviation of the blur of the specks, in pixels of the atlas: flakes of a tenth of a face."""
SPECK_REFLECTANCE = 0.25
"""Of dark specks, as a share of the die's reflectance."""

PIPS: dict[int, tuple[tuple[int, int], ...]] = {
    1: ((0, 0),),
    2: ((-1, -1), (1, 1)),
    3: ((-1, -1), (0, 0), (1, 1)),
    4: ((-1, -1), (-1, 1), (1, -1), (1, 1)),
    5: ((-1, -1), (-1, 1), (0, 0), (1, -1), (1, 1)),
    6: ((-1, -1), (-1, 0), (-1, 1), (1, -1), (1, 0), (1, 1)),
}
"""Positions of the pips of each face, in steps."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in the body frame, counter-clockwise from outside."""

    vertices_m: Array
    """(n, 3)."""
    normals: Array
    """(n, 3) outward, unit."""
    texture_uv: Array
    """(n, 2) position in the atlas, 0 to 1 from its upper left corner."""
    triangles: NDArray[np.int64]
    """(m, 3)."""


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """The plane of one face with the axes of its marks."""

    middle_m: Array
    """(3,) centre of the face of the sharp solid, body frame."""
    right: Array
    """(3,) unit."""
    up: Array
    """(3,) unit; right × up looks outward."""
    half_m: float
    """Half the width of its tile."""
    inscribed_m: float


def face_frame(solid: Solid, face: int) -> FaceFrame:
    """The plane of a face; up is towards its first corner, or on a square towards its first edge."""
    corners = solid.vertices[list(solid.faces[face])]
    middle, normal = corners.mean(0), solid.normals[face]
    towards = (corners[0] + corners[1]) / 2 if len(corners) == 4 else corners[0]
    up = towards - middle
    up /= np.linalg.norm(up)
    reach = float(np.linalg.norm(corners - middle, axis=1).max())
    sides = (corners + np.roll(corners, -1, 0)) / 2 - middle
    return FaceFrame(middle, np.cross(up, normal), up, TILE_MARGIN * reach, float(np.linalg.norm(sides, axis=1).min()))


# --- shape ---


def stretched(mesh: Mesh, factors: tuple[float, float, float]) -> Mesh:
    """The mesh with its body axes stretched, as a die whose edges are not equal."""
    by = np.array(factors)
    return Mesh(mesh.vertices_m * by, _unit(mesh.normals / by), mesh.texture_uv, mesh.triangles)


def die_mesh(die: Die) -> Mesh:
    """The surface of a die, sharp or rounded. Raises ValueError for a radius that leaves no inner polyhedron."""
    solid, radius = die.solid, die.corner_radius_m
    inner = inner_vertices(solid, radius)
    parts = [_face(solid, k, inner, radius) for k in range(len(solid.faces))]
    if radius > 0:
        parts += [part for e in range(len(solid.edges)) for part in _bevel(solid, e, inner, radius)]
        parts += [part for v in range(len(inner)) for part in _corner(solid, v, inner, radius)]
    starts = np.cumsum([0, *(len(part.vertices_m) for part in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices_m for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.texture_uv for part in parts]),
        np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=True)]),
    )


def _face(solid: Solid, face: int, inner: Array, radius: float) -> Mesh:
    """The flat part of a face, as a triangle fan from its first corner."""
    normal = solid.normals[face]
    corners = inner[list(solid.faces[face])] + radius * normal
    n = len(corners)
    fan = np.array([(0, j, j + 1) for j in range(1, n - 1)])
    return _painted(solid, face, corners, np.tile(normal, (n, 1)), fan)


def _painted(solid: Solid, face: int, vertices: Array, normals: Array, triangles: NDArray[np.int64]) -> Mesh:
    """Triangles with the paint of a face."""
    frame = face_frame(solid, face)
    across = (vertices - frame.middle_m) @ np.stack([frame.right, frame.up], 1) / frame.half_m
    return Mesh(vertices, normals, _tile_uv(face, len(solid.faces), across), triangles)


def _bevel(solid: Solid, edge: int, inner: Array, radius: float) -> list[Mesh]:
    """The piece of a cylinder between the two faces of an edge: a half with the paint of each."""
    (a, b), (f, g) = solid.edges[edge], solid.edge_faces[edge]
    middle = _unit(solid.normals[f] + solid.normals[g])
    # The edge runs from a to b counter-clockwise about its first face, so the second face lies to its right.
    halves = ((f, solid.normals[f], middle), (g, middle, solid.normals[g]))
    m = BEVEL_STEPS // 2 + 1
    low = np.arange(m - 1)
    triangles = np.concatenate([np.stack([low, low + 1, low + m], 1), np.stack([low + 1, low + m + 1, low + m], 1)])
    parts = []
    for face, begin, end in halves:
        share = np.linspace(0.0, 1.0, m)[:, None]
        normals = _unit((1.0 - share) * begin + share * end)
        vertices = np.concatenate([inner[a] + radius * normals, inner[b] + radius * normals])
        parts.append(_painted(solid, face, vertices, np.tile(normals, (2, 1)), triangles))
    return parts


def _corner(solid: Solid, vertex: int, inner: Array, radius: float) -> list[Mesh]:
    """The piece of a sphere around an inner corner: for every pair of neighbouring faces a sector with the paint of each."""
    pairs = [
        (f, g) if a == vertex else (g, f)
        for (a, b), (f, g) in zip(solid.edges, solid.edge_faces, strict=True)
        if vertex in (a, b)
    ]
    top = _unit(np.sum([solid.normals[f] for f, _ in pairs], 0))
    parts = []
    for f, g in pairs:
        middle = _unit(solid.normals[f] + solid.normals[g])
        for face, first, second in ((g, solid.normals[g], middle), (f, middle, solid.normals[f])):
            normals, triangles = _sector(top, first, second)
            parts.append(_painted(solid, face, inner[vertex] + radius * normals, normals, triangles))
    return parts


def _sector(a: Array, b: Array, c: Array) -> tuple[Array, NDArray[np.int64]]:
    """Directions on the spherical triangle a, b, c, divided BEVEL_STEPS / 2 times along each side, and the triangles between."""
    n = BEVEL_STEPS // 2
    number = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(n + 1) for j in range(n + 1 - i))}
    directions = _unit(np.array([(n - i - j) * a + i * b + j * c for i, j in number]))
    upright = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i in range(n) for j in range(n - i)]
    between = [
        (number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i in range(n - 1) for j in range(n - 1 - i)
    ]
    return directions, np.array(upright + between)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


# --- paint ---


def face_paint(
    die: Die, *, die_reflectance: float, mark_reflectance: float, grain: float, seed: int, speckle: float = 0.0
) -> NDArray[np.float32]:
    """The atlas (n, n): the reflectance of all faces, first row on top.

    `grain` is the relative standard deviation of the die's reflectance, in specks of a few hundredths of a face; `speckle` the
    share of the faces that dark flakes cover, marks excepted.
    """
    marked = _all_marks(die)
    rng = np.random.default_rng(seed)
    fine = cv2.GaussianBlur(rng.standard_normal(marked.shape).astype(np.float32), (0, 0), GRAIN_PX)
    paint = np.full(marked.shape, die_reflectance, np.float32)
    if speckle > 0:
        flakes = cv2.GaussianBlur(rng.standard_normal(marked.shape).astype(np.float32), (0, 0), SPECK_PX)
        paint[flakes < np.quantile(flakes, speckle)] *= SPECK_REFLECTANCE
    paint += (mark_reflectance - paint) * marked
    return np.asarray(np.clip(paint * (1.0 + grain * fine / fine.std()), 0.0, 1.0), np.float32)


def mark_heights(die: Die, depth_m: float) -> NDArray[np.float32]:
    """Heights (n, n) [m] of the atlas over the faces: marks are bowls, the deepest of them `depth_m` deep."""
    inside = cv2.distanceTransform((_all_marks(die) > 0.5).astype(np.uint8), cv2.DIST_L2, 5)
    share = inside / max(float(inside.max()), 1.0)
    return np.asarray(-depth_m * (1.0 - (1.0 - share) ** 2), np.float32)


def _all_marks(die: Die) -> NDArray[np.float32]:
    """Share (n, n) of each pixel of the atlas that marks cover."""
    count = len(die.solid.faces)
    across = _tiles_across(count)
    atlas = np.zeros((across * TILE_PX, across * TILE_PX), np.float32)
    for face in range(count):
        row, column = divmod(face, across)
        tile = slice(row * TILE_PX, (row + 1) * TILE_PX), slice(column * TILE_PX, (column + 1) * TILE_PX)
        atlas[tile] = _marks(die, face)
    return atlas


def _tiles_across(faces: int) -> int:
    """Tiles per row of the atlas, which has a tile for each face."""
    return int(np.ceil(np.sqrt(faces)))


def _tile_uv(tile: int, faces: int, across: Array) -> Array:
    """Positions (..., 2) in the atlas of points of a tile, given from -1 to 1 to the right and up."""
    row, column = divmod(tile, _tiles_across(faces))
    u = column + 0.5 + 0.5 * across[..., 0]
    v = row + 0.5 - 0.5 * across[..., 1]
    return np.asarray(np.stack([u, v], -1) / _tiles_across(faces))


def _marks(die: Die, face: int) -> NDArray[np.float32]:
    """Share (TILE_PX, TILE_PX) of each pixel of a face's tile that its marks cover."""
    size = FINER * TILE_PX
    fine = np.zeros((size, size), np.uint8)
    frame = face_frame(die.solid, face)
    for visible_edges in _mark_outlines(die, face, frame):
        # Sixteenths of a fine pixel; four fine pixels meet at the centre of the tile.
        points = [
            np.rint((size / 2 - 0.5 + size / 2 * outline * [1.0, -1.0]) * 16).astype(np.int32)
            for outline in visible_edges
        ]
        cv2.fillPoly(fine, points, 255, shift=4)
    shares = fine.reshape(TILE_PX, FINER, TILE_PX, FINER).mean((1, 3)) / 255.0
    return np.asarray(shares, np.float32)


def _mark_outlines(die: Die, face: int, frame: FaceFrame) -> list[list[Array]]:
    """The marks of a face, each as closed outlines (n, 2) in half tiles; an outline within another is a hole."""
    if die.marks == "pips" and face + 1 in PIPS:
        edge = die.solid.edge_m / frame.half_m
        angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        circle = PIP_RADIUS * edge * np.stack([np.cos(angle), np.sin(angle)], 1)
        return [[circle + PIP_STEP * edge * np.array(place)] for place in PIPS[face + 1]]
    if die.marks == "numbers":
        return [_number(face + 1, len(die.solid.faces), frame.inscribed_m / frame.half_m)]
    return []


def _number(number: int, faces: int, inscribed: float) -> list[Array]:
    """The outlines of a number; 6 and 9 are underlined on dice that have both."""
    path = TextPath((0, 0), str(number), size=1.0, prop=FontProperties(family="DejaVu Sans", weight="bold"))
    visible_edges = [np.asarray(polygon, float) for polygon in path.to_polygons()]
    everything = np.concatenate(visible_edges)
    low, high = everything.min(0), everything.max(0)
    if number in (6, 9) and faces >= 9:
        visible_edges.append(np.array([(low[0], -0.18), (high[0], -0.18), (high[0], -0.08), (low[0], -0.08)]))
        low = np.array([low[0], -0.18])
    # A narrow digit is no larger than a wide one.
    scale = NUMBER_WIDTH * inscribed / max(float(np.linalg.norm(high - low)), 1.0)
    return [(outline - (low + high) / 2) * scale for outline in visible_edges]
