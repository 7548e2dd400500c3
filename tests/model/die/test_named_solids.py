"""Laws of solids by name: their edges are as long as asked for, and a mesh is the solid that it was made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from random_throws import random_quaternion

from diethrow.model.die import (
    SOLID_KINDS,
    Die,
    Solid,
    die_from_solid,
    inner_vertices,
    largest_corner_radius,
    make_die,
    named_solid,
    solid_from_mesh,
)
from diethrow.model.die.symmetry import inversion_rotation, symmetry_rotations
from diethrow.model.rotations import matrix_from_quat

Array = NDArray[np.float64]

EXAMPLES = {
    **{shape: {"edge_m": 0.016} for shape in ("tetrahedron", "cube", "octahedron", "dodecahedron", "icosahedron")},
    "d10": {"edge_m": 0.0145, "short_edge_m": 0.0078},
    "cuboid": {"edges_m": [0.013, 0.0156, 0.0195]},
    "dipyramid": {"sides": 5, "radius_m": 0.01, "half_height_m": 0.012, "cut": 0.2},
    "polyhedron": {
        "corners_m": [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.04], [0.02, 0.03, 0.05]]
    },
}
INCH_M = 0.0254


def edge_lengths(solid: Solid) -> Array:
    return np.asarray(np.linalg.norm(solid.vertices[solid.edges[:, 0]] - solid.vertices[solid.edges[:, 1]], axis=1))


def written(solid: Solid, path: Path, unit_m: float) -> Path:
    """The solid as a mesh of triangles, in single precision where the format has it, away from the origin."""
    fans = [[face[0], face[j], face[j + 1]] for face in solid.faces for j in range(1, len(face) - 1)]
    trimesh.Trimesh(solid.vertices / unit_m + [3.0, -2.0, 5.0], fans, process=False).export(path)
    return path


def test_there_is_an_example_of_every_kind() -> None:
    assert set(EXAMPLES) == set(SOLID_KINDS)


@pytest.mark.parametrize("shape", EXAMPLES)
def test_faces_are_flat_point_outwards_and_meet_in_all_edges(shape: str) -> None:
    solid = named_solid(shape, **EXAMPLES[shape])
    assert len(solid.vertices) - len(solid.edges) + len(solid.faces) == 2  # Euler
    for face, normal, offset in zip(solid.faces, solid.normals, solid.offsets, strict=True):
        # Rounding of coordinates of some centimetres.
        np.testing.assert_allclose(solid.vertices[list(face)] @ normal, offset, atol=1e-16)
    assert (solid.offsets > 0.0).all()
    assert solid.dimensions == EXAMPLES[shape]
    assert solid.name == shape


@pytest.mark.parametrize("short_share", [0.24, 0.45, 0.54, 0.61])
def test_a_d10_has_ten_equal_kites_with_the_given_edges(short_share: float) -> None:
    solid = named_solid("d10", edge_m=0.015, short_edge_m=0.015 * short_share)
    assert (len(solid.vertices), len(solid.faces), len(solid.edges)) == (12, 10, 20)
    np.testing.assert_allclose(np.sort(edge_lengths(solid)), np.repeat([0.015 * short_share, 0.015], 10), rtol=1e-12)
    np.testing.assert_allclose(solid.offsets, solid.inradius, rtol=1e-12)
    # Five turns about the tips, and half a turn about each of five axes across.
    assert len(symmetry_rotations(solid)) == 10
    for number, normal in enumerate(solid.normals, 1):
        assert int(np.argmin(solid.normals @ normal)) + 1 == 11 - number


@pytest.mark.parametrize("short_share", [0.2, 0.63])
def test_edges_that_no_flat_kite_has_are_refused(short_share: float) -> None:
    with pytest.raises(ValueError, match=r"wanted 0\.236 to 0\.618 of it"):
        named_solid("d10", edge_m=0.015, short_edge_m=0.015 * short_share)


def test_a_cuboid_has_the_inertia_of_one() -> None:
    a, b, c = EXAMPLES["cuboid"]["edges_m"]
    die = die_from_solid(named_solid("cuboid", edges_m=[a, b, c]), 0.012)
    expected = 0.001 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    np.testing.assert_allclose(die.tensor_kg_m2, expected, rtol=1e-12, atol=1e-20)


def test_a_cuboid_of_equal_edges_is_the_cube_with_its_numbers() -> None:
    cuboid, cube = named_solid("cuboid", edges_m=[0.016] * 3), named_solid("cube", edge_m=0.016)
    np.testing.assert_allclose(cuboid.normals, cube.normals, atol=1e-15)
    np.testing.assert_allclose(cuboid.vertices, cube.vertices, atol=1e-17)
    assert die_from_solid(cuboid, 0.0048).is_spherical_top


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off"])
@pytest.mark.parametrize("shape", ["dodecahedron", "icosahedron", "d10", "cuboid", "polyhedron"])
def test_a_mesh_is_the_solid_that_it_was_made_from(shape: str, suffix: str, tmp_path: Path) -> None:
    true = named_solid(shape, **EXAMPLES[shape])
    found = solid_from_mesh(written(true, tmp_path / f"die{suffix}", INCH_M), INCH_M)
    counts = [len(true.vertices), len(true.faces), len(true.edges)]
    assert [len(found.vertices), len(found.faces), len(found.edges)] == counts
    # Single precision at five inches from the origin: 2.4e-7 of an inch, and more in a sum over corners.
    np.testing.assert_allclose(np.sort(edge_lengths(found)), np.sort(edge_lengths(true)), atol=2e-8)
    assert found.volume_m3 == pytest.approx(true.volume_m3, rel=1e-5)
    np.testing.assert_allclose(found.offsets.min(), true.offsets.min(), atol=2e-8)


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
@pytest.mark.parametrize("shape", ["icosahedron", "d10"])
def test_corners_of_a_mesh_can_be_rounded(shape: str, suffix: str, tmp_path: Path) -> None:
    """Where five faces meet, those of a mesh in single precision do so within its rounding only."""
    true = named_solid(shape, **EXAMPLES[shape])
    found = solid_from_mesh(written(true, tmp_path / f"die{suffix}", 1e-3), 1e-3)
    radius = 0.2 * true.inradius
    distances = [np.sort(np.linalg.norm(inner_vertices(solid, radius), axis=1)) for solid in (found, true)]
    np.testing.assert_allclose(*distances, atol=1e-8)


def moments(die: Die) -> Array:
    return np.asarray(np.linalg.eigvalsh(die.tensor_kg_m2))


def test_a_mesh_of_a_cube_has_its_inertia(tmp_path: Path) -> None:
    solid = solid_from_mesh(written(named_solid("cube", edge_m=0.016), tmp_path / "cube.obj", 1e-3), 1e-3)
    np.testing.assert_allclose(
        moments(die_from_solid(solid, 0.0048)), make_die("cube", 0.016, 0.0048).inertia_kg_m2, rtol=1e-6
    )


def test_meshes_that_are_no_dice_are_refused(tmp_path: Path) -> None:
    step = trimesh.creation.extrude_triangulation(
        np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float),
        np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]),
        1.0,
    )
    step.export(tmp_path / "step.stl")
    with pytest.raises(ValueError, match=r"step\.stl: the body fills 0\.857\d of its convex hull"):
        solid_from_mesh(tmp_path / "step.stl", 1e-2)
    trimesh.creation.icosphere(3).export(tmp_path / "ball.ply")
    with pytest.raises(ValueError, match=r"ball\.ply: \d+ faces; wanted 200 at most"):
        solid_from_mesh(tmp_path / "ball.ply", 1e-2)
    box = trimesh.creation.box()
    trimesh.Trimesh(box.vertices, box.faces[1:], process=False).export(tmp_path / "open.obj")
    with pytest.raises(ValueError, match="holes"):
        solid_from_mesh(tmp_path / "open.obj", 1e-2)
    (tmp_path / "text.stl").write_text("no mesh at all")
    with pytest.raises(ValueError, match=r"text\.stl"):
        solid_from_mesh(tmp_path / "text.stl", 1e-3)


WRONG = {
    "no such shape": ("d30", {"edge_m": 0.016}, "wanted one of tetrahedron"),
    "missing length": ("d10", {"edge_m": 0.016}, "short_edge_m is missing"),
    "length of another shape": ("cube", {"edge_m": 0.016, "edges_m": [1, 2, 3]}, "wanted edge_m"),
    "two lengths": ("cuboid", {"edges_m": [0.01, 0.02]}, "wanted 3 lengths"),
    "a flat cuboid": ("cuboid", {"edges_m": [0.01, 0.02, 0.0]}, "above 0"),
    "a point within": (
        "polyhedron",
        {"corners_m": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.1, 0.1, 0.1]]},
        "1 of 5",
    ),
    "points in a plane": ("polyhedron", {"corners_m": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}, "one plane"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_solid_is_refused(case: str) -> None:
    shape, dimensions, message = WRONG[case]
    with pytest.raises(ValueError, match=message):
        named_solid(shape, **dimensions)


def subdivided(solid: Solid, path: Path, turn: Array) -> Path:
    """A mesh of the solid, turned, whose triangles are cut in four: with vertices on edges and within faces."""
    fans = [[face[0], face[j], face[j + 1]] for face in solid.faces for j in range(1, len(face) - 1)]
    mesh = trimesh.Trimesh(1e3 * solid.vertices @ turn.T, fans, process=False).subdivide()
    mesh.export(path)
    return path


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", ["cube", "icosahedron", "d10", "cuboid"])
def test_a_finely_cut_mesh_is_the_same_solid_with_all_its_symmetries(shape: str, seed: int, tmp_path: Path) -> None:
    """Vertices in single precision along an edge make slivers, whose normals are rounding."""
    true = named_solid(shape, **EXAMPLES[shape])
    turn = matrix_from_quat(random_quaternion(np.random.default_rng(seed)))
    found = solid_from_mesh(subdivided(true, tmp_path / "die.stl", turn), 1e-3)
    assert [len(part) for part in (found.vertices, found.faces, found.edges)] == [
        len(part) for part in (true.vertices, true.faces, true.edges)
    ]
    assert len(symmetry_rotations(found)) == len(symmetry_rotations(true))
    assert (inversion_rotation(found) is None) == (inversion_rotation(true) is None)
    tops = [die_from_solid(solid, 0.005).is_spherical_top for solid in (found, true)]
    assert tops[0] == tops[1]


@pytest.mark.parametrize("cut", [0.05, 0.2, 0.5])
def test_the_largest_corner_radius_is_where_a_face_vanishes(cut: float) -> None:
    solid = named_solid("dipyramid", sides=5, radius_m=0.01, half_height_m=0.012, cut=cut)
    largest = largest_corner_radius(solid)
    inner_vertices(solid, largest)
    with pytest.raises(ValueError, match=r"vanish|inscribed"):
        inner_vertices(solid, largest + 2e-6 * solid.inradius)


def test_a_solid_whose_corners_split_has_no_corner_radius() -> None:
    corners = [[-0.01, -0.01, 0.0], [0.01, -0.01, 0.0], [0.01, 0.01, 0.0], [-0.01, 0.01, 0.0], [0.004, 0.001, 0.015]]
    solid = named_solid("polyhedron", corners_m=corners)
    # Within the tolerance with which planes still meet in one point.
    assert largest_corner_radius(solid) < 1e-3 * solid.inradius
