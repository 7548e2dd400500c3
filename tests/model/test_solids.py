"""Dice as geometry and mass."""

import numpy as np
import pytest
from random_throws import DICE, random_quaternion

from diethrow.model.rotations import matrix_from_quat
from diethrow.model.simulate import edge_barriers_m
from diethrow.model.solids import SHAPES, convex_solid, isohedral_solid, lowest_face, make_die, unit_inertia

EDGE_M = 0.02

# Kapitaniak et al., Chaos 22, 047504: J/(m a²).
PAPER_INERTIA = {
    "tetrahedron": 1 / 20,
    "cube": 1 / 6,
    "octahedron": 1 / 10,
    "dodecahedron": (95 + 39 * np.sqrt(5)) / 300,
    "icosahedron": (3 + np.sqrt(5)) / 20,
}

# Vertices, faces, corners of a face.
COUNTS = {
    "tetrahedron": (4, 4, 3),
    "cube": (8, 6, 4),
    "octahedron": (6, 8, 3),
    "dodecahedron": (20, 12, 5),
    "icosahedron": (12, 20, 3),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_inertia_is_that_of_the_paper_about_every_axis(shape):
    inertia = unit_inertia(isohedral_solid(shape, EDGE_M))
    # Rounding of a sum over some thirty tetrahedra.
    np.testing.assert_allclose(inertia, PAPER_INERTIA[shape] * EDGE_M**2 * np.eye(3), rtol=0, atol=1e-13 * EDGE_M**2)
    assert DICE[shape].inertia_kg_m2 == pytest.approx(0.016 * PAPER_INERTIA[shape] * EDGE_M**2, rel=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_solids_have_their_corners_faces_and_edges_and_satisfy_euler(shape):
    solid = isohedral_solid(shape, EDGE_M)
    vertices, faces, corners = COUNTS[shape]
    assert (len(solid.vertices), len(solid.faces)) == (vertices, faces)
    assert all(len(face) == corners for face in solid.faces)
    assert len(solid.edges) == vertices + faces - 2
    lengths = np.linalg.norm(solid.vertices[solid.edges[:, 0]] - solid.vertices[solid.edges[:, 1]], axis=1)
    np.testing.assert_allclose(lengths, EDGE_M, rtol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_faces_run_counter_clockwise_and_their_planes_bound_the_solid(shape):
    solid = isohedral_solid(shape, EDGE_M)
    heights = solid.vertices @ solid.normals.T - solid.offsets
    assert heights.max() < 1e-15
    for face, normal in zip(solid.faces, solid.normals, strict=True):
        a, b, c = solid.vertices[list(face[:3])]
        assert np.cross(b - a, c - b) @ normal > 0
    np.testing.assert_allclose(solid.vertices.mean(0), 0.0, atol=1e-16)


@pytest.mark.parametrize("shape", SHAPES)
def test_each_edge_runs_along_its_first_face_and_against_its_second(shape):
    solid = isohedral_solid(shape, EDGE_M)
    for (a, b), (along, against) in zip(solid.edges, solid.edge_faces, strict=True):
        pairs = [set(zip(f, f[1:] + f[:1], strict=True)) for f in (solid.faces[along], solid.faces[against])]
        assert (a, b) in pairs[0]
        assert (b, a) in pairs[1]


def test_opposite_faces_of_the_cube_add_to_seven_and_one_two_three_turn_counter_clockwise():
    normals = DICE["cube"].solid.normals
    for k in range(6):
        np.testing.assert_array_equal(normals[k], -normals[5 - k])
    # Seen from outside on their common corner, 1 → 2 → 3 turns to the left.
    assert np.linalg.det(normals[:3]) == pytest.approx(1.0)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_lowest_face_is_the_one_turned_down(shape):
    solid = isohedral_solid(shape, EDGE_M)
    for k, normal in enumerate(solid.normals):
        x = np.cross(normal, solid.vertices[solid.faces[k][0]])
        x /= np.linalg.norm(x)
        # Rows are the world axes in the body: the third is up, against the normal.
        rotation = np.array([x, np.cross(-normal, x), -normal])
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert lowest_face(solid, rotation) == k + 1


def test_a_moved_and_turned_solid_keeps_its_size_and_turns_its_inertia():
    rng = np.random.default_rng(5)
    points = rng.normal(size=(14, 3)) * [0.01, 0.02, 0.03]
    solid = convex_solid(points)
    for _ in range(5):
        rotation = matrix_from_quat(random_quaternion(rng))
        moved = convex_solid(points @ rotation.T + rng.normal(size=3))
        expected = rotation @ unit_inertia(solid) @ rotation.T
        # A solid of centimetres a metre from the origin loses two digits, and the inertia is quadratic in it.
        np.testing.assert_allclose(unit_inertia(moved), expected, atol=1e-11 * np.trace(expected))
        np.testing.assert_allclose(moved.vertices, solid.vertices @ rotation.T, atol=1e-14)


def test_a_turned_cube_has_the_inertia_of_the_cube_and_points_inside_it_do_not_matter():
    rng = np.random.default_rng(6)
    cube = isohedral_solid("cube", EDGE_M)
    rotation = matrix_from_quat(random_quaternion(rng))
    inside = rng.uniform(-0.4, 0.4, (20, 3)) * EDGE_M
    solid = convex_solid(np.vstack([cube.vertices, inside]) @ rotation.T + [0.3, -0.2, 0.1])
    np.testing.assert_allclose(unit_inertia(solid), EDGE_M**2 / 6 * np.eye(3), atol=1e-12 * EDGE_M**2)
    assert (len(solid.vertices), len(solid.faces), len(solid.edges)) == (8, 6, 12)


def test_a_box_has_the_inertia_of_a_box():
    a, b, c = 0.01, 0.02, 0.05
    corners = np.array([(x, y, z) for x in (0, a) for y in (0, b) for z in (0, c)])
    expected = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 12
    np.testing.assert_allclose(unit_inertia(convex_solid(corners)), expected, atol=1e-12 * c * c)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_barrier_of_a_regular_solid_is_its_midradius(shape):
    # Of edge a: the sphere that touches all edges (Coxeter, Regular Polytopes, Table I).
    golden = (1 + np.sqrt(5)) / 2
    midradius = {
        "tetrahedron": np.sqrt(1 / 8),
        "cube": np.sqrt(1 / 2),
        "octahedron": 1 / 2,
        "dodecahedron": golden**2 / 2,
        "icosahedron": golden / 2,
    }[shape]
    np.testing.assert_allclose(edge_barriers_m(isohedral_solid(shape, EDGE_M)), midradius * EDGE_M, rtol=1e-13)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("disc", 0.02, 0.016), "shape = 'disc'.*tetrahedron, cube"),
        (("cube", 0.0, 0.016), "edge_m = 0.0"),
        (("cube", 0.02, float("nan")), "mass_kg = nan"),
    ],
)
def test_a_die_that_cannot_be_is_refused_by_name(arguments, said):
    with pytest.raises(ValueError, match=said):
        make_die(*arguments)


def test_a_corner_radius_must_leave_a_die():
    with pytest.raises(ValueError, match=r"corner_radius_m = 0\.01: wanted 0 or more"):
        make_die("cube", 0.02, 0.016, corner_radius_m=0.01)
    with pytest.raises(ValueError, match="inertia_kg_m2 = -1"):
        make_die("cube", 0.02, 0.016, inertia_kg_m2=-1.0)


def test_points_that_span_no_volume_are_refused():
    with pytest.raises(ValueError, match="one plane"):
        convex_solid([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
    with pytest.raises(ValueError, match="at least four finite points"):
        convex_solid(np.eye(3))
