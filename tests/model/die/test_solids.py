"""Dice as geometry and mass."""

import pickle

import numpy as np
import pytest
from random_throws import DICE, random_quaternion

from diethrow.model.die.die import Die, die_from_solid, loaded_die, make_die
from diethrow.model.die.mass_distribution import mass_distribution
from diethrow.model.die.named_solids import truncated_dipyramid
from diethrow.model.die.solid import (
    SHAPES,
    convex_solid,
    inner_vertices,
    isohedral_solid,
    lowest_face,
)
from diethrow.model.die.symmetry import symmetry_rotations
from diethrow.model.rotations import matrix_from_quat
from diethrow.model.throw.body import edge_barriers_m

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
    inertia = mass_distribution(isohedral_solid(shape, EDGE_M)).unit_inertia_m2
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
        expected = rotation @ mass_distribution(solid).unit_inertia_m2 @ rotation.T
        # A solid of centimetres a metre from the origin loses two digits, and the inertia is quadratic in it.
        np.testing.assert_allclose(mass_distribution(moved).unit_inertia_m2, expected, atol=1e-11 * np.trace(expected))
        np.testing.assert_allclose(moved.vertices, solid.vertices @ rotation.T, atol=1e-14)


def test_a_turned_cube_has_the_inertia_of_the_cube_and_points_inside_it_do_not_matter():
    rng = np.random.default_rng(6)
    cube = isohedral_solid("cube", EDGE_M)
    rotation = matrix_from_quat(random_quaternion(rng))
    inside = rng.uniform(-0.4, 0.4, (20, 3)) * EDGE_M
    solid = convex_solid(np.vstack([cube.vertices, inside]) @ rotation.T + [0.3, -0.2, 0.1])
    np.testing.assert_allclose(
        mass_distribution(solid).unit_inertia_m2, EDGE_M**2 / 6 * np.eye(3), atol=1e-12 * EDGE_M**2
    )
    assert (len(solid.vertices), len(solid.faces), len(solid.edges)) == (8, 6, 12)


def test_a_box_has_the_inertia_of_a_box():
    a, b, c = 0.01, 0.02, 0.05
    corners = np.array([(x, y, z) for x in (0, a) for y in (0, b) for z in (0, c)])
    expected = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 12
    np.testing.assert_allclose(mass_distribution(convex_solid(corners)).unit_inertia_m2, expected, atol=1e-12 * c * c)


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
    solid = isohedral_solid(shape, EDGE_M)
    np.testing.assert_allclose(edge_barriers_m(solid, solid.vertices), midradius * EDGE_M, rtol=1e-13)


def test_a_corner_radius_that_leaves_no_flat_face_raises():
    with pytest.raises(ValueError, match=r"corner_radius_m = 0\.01"):
        make_die("cube", 0.02, 0.016, corner_radius_m=0.01)
    with pytest.raises(ValueError, match="inertia_kg_m2 = -1"):
        make_die("cube", 0.02, 0.016, inertia_kg_m2=-1.0)


def test_points_that_span_no_volume_raise():
    with pytest.raises(ValueError, match="one plane"):
        convex_solid([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
    with pytest.raises(ValueError, match="at least four finite points"):
        convex_solid(np.eye(3))


@pytest.mark.parametrize(
    ("sides", "half_height_m", "cut"), [(3, 0.01, 0.0), (5, 0.02, 0.3), (7, 0.008, 0.5), (12, 0.02, 0.01)]
)
def test_a_truncated_dipyramid_has_congruent_side_faces_first_and_its_cuts_last(sides, half_height_m, cut):
    solid = truncated_dipyramid(sides, 0.01, half_height_m, cut)
    assert len(solid.faces) == 2 * sides + (2 if cut else 0)
    np.testing.assert_allclose(solid.offsets[: 2 * sides], solid.offsets[0], rtol=1e-13)
    assert {len(face) for face in solid.faces[: 2 * sides]} == {4 if cut else 3}
    upper, lower = solid.normals[:sides], solid.normals[sides : 2 * sides]
    np.testing.assert_allclose(upper * [1, 1, -1], lower, atol=1e-14)
    middle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    across = np.linalg.norm(upper[:, :2], axis=1)
    np.testing.assert_allclose(
        upper[:, :2], across[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), atol=1e-14
    )
    if cut:
        np.testing.assert_allclose(solid.normals[-2:], [[0, 0, 1], [0, 0, -1]], atol=1e-15)
        np.testing.assert_allclose(solid.offsets[-2:], (1 - cut) * half_height_m, rtol=1e-13)


def test_the_square_dipyramid_of_equal_edges_is_the_octahedron_and_so_a_spherical_top():
    edge = 0.02
    die = die_from_solid(truncated_dipyramid(4, edge / np.sqrt(2), edge / np.sqrt(2), 0.0), 0.016)
    assert die.is_spherical_top
    assert die.inertia_kg_m2 == pytest.approx(make_die("octahedron", edge, 0.016).inertia_kg_m2, rel=1e-13)
    assert len(symmetry_rotations(die.solid)) == 24


def test_a_loaded_die_has_the_mass_centre_and_inertia_of_its_two_parts():
    """Compared with the same body as a cloud of points, straight from the definitions."""
    rng = np.random.default_rng(7)
    solid, mass, load, place = truncated_dipyramid(5, 0.01, 0.02, 0.3), 0.01, 0.004, np.array([0.003, -0.002, 0.006])
    die = loaded_die(solid, mass, load, place)
    cloud = rng.uniform(-0.02, 0.02, (40_000, 3))
    cloud = cloud[(cloud @ solid.normals.T < solid.offsets).all(1)]
    # With all its turned copies the cloud has the solid's symmetry, and so its centroid exactly.
    cloud = np.vstack([cloud @ turn.T for turn in symmetry_rotations(solid)])
    weights = np.append(np.full(len(cloud), mass / len(cloud)), load)
    points = np.vstack([cloud, place])
    centre = weights @ points / weights.sum()
    arms = points - centre
    tensor = np.einsum("n,ij,nk,nk->ij", weights, np.eye(3), arms, arms) - np.einsum("n,ni,nj->ij", weights, arms, arms)
    assert die.mass_kg == pytest.approx(0.014)
    np.testing.assert_allclose(die.centre_of_mass_m, load * place / 0.014, rtol=1e-14)
    np.testing.assert_allclose(die.centre_of_mass_m, centre, atol=1e-14)
    # Some 5000 random points: their second moments scatter by one percent.
    np.testing.assert_allclose(die.inertia_tensor_kg_m2, tensor, atol=0.02 * np.trace(tensor))


@pytest.mark.parametrize(("edge", "mass"), [(1e-4, 1e-9), (1e-4, 1e3), (10.0, 1e-9), (10.0, 1e3)])
def test_mass_properties_scale_with_any_size_and_mass(edge, mass):
    for shape in SHAPES:
        die = die_from_solid(isohedral_solid(shape, edge), mass)
        assert die.is_spherical_top
        assert die.inertia_kg_m2 == pytest.approx(PAPER_INERTIA[shape] * mass * edge**2, rel=1e-13)
    small = loaded_die(truncated_dipyramid(5, 0.01, 0.02, 0.3), 0.01, 0.001, [0, 0, 0.005])
    large = loaded_die(truncated_dipyramid(5, edge, 2 * edge, 0.3), mass, 0.1 * mass, [0, 0, 0.5 * edge])
    scale = (mass / 0.01) * (edge / 0.01) ** 2
    expected = small.inertia_tensor_kg_m2 * scale
    np.testing.assert_allclose(large.inertia_tensor_kg_m2, expected, atol=1e-13 * np.trace(expected))


@pytest.mark.parametrize(
    "solid",
    [*(isohedral_solid(shape, EDGE_M) for shape in SHAPES), truncated_dipyramid(3, 0.01, 0.02, 0.4),
     truncated_dipyramid(6, 0.01, 0.02, 0.0), convex_solid(np.indices((2, 2, 2)).reshape(3, 8).T * [0.01, 0.02, 0.03])],
    ids=lambda solid: solid.name,
)  # fmt: skip
def test_inner_corners_lie_the_radius_below_each_of_their_faces(solid):
    radius = 0.1 * solid.inradius
    inner = inner_vertices(solid, radius)
    for face, normal, offset in zip(solid.faces, solid.normals, solid.offsets, strict=True):
        depths = offset - inner @ normal
        np.testing.assert_allclose(depths[list(face)], radius, atol=1e-14)
        assert depths.min() > radius - 1e-14
    np.testing.assert_allclose(inner_vertices(solid, 0.0), solid.vertices, atol=1e-16)


def test_a_radius_that_splits_a_corner_or_removes_a_face_raises():
    # Four unlike planes meet in the tip of a pyramid over an oblong.
    tip = convex_solid([(2, 1, 0), (2, -1, 0), (-2, 1, 0), (-2, -1, 0), (0, 0, 1.5)])
    with pytest.raises(ValueError, match="the 4 faces that meet in vertex 4"):
        inner_vertices(tip, 0.1)
    with pytest.raises(ValueError, match="a face would vanish"):
        inner_vertices(truncated_dipyramid(3, 0.01, 0.02, 0.01), 0.002)
    with pytest.raises(ValueError, match="corner_radius_m"):
        inner_vertices(tip, 1.0)


def test_the_one_moment_of_inertia_of_an_asymmetric_die_raises():
    die = loaded_die(isohedral_solid("cube", EDGE_M), 0.01, 0.002, [0, 0, 0.005])
    assert not die.is_spherical_top
    with pytest.raises(ValueError, match="inertia_kg_m2 of a cube"):
        _ = die.inertia_kg_m2
    with pytest.raises(AttributeError, match="no attribute 'colour'"):
        _ = die.colour
    assert not pickle.loads(pickle.dumps(die)).is_spherical_top
    shifted = Die(die.solid, 0.01, 1e-6, centre_of_mass_m=np.array([0, 0, 0.001]))
    np.testing.assert_array_equal(shifted.inertia_tensor_kg_m2, 1e-6 * np.eye(3))
    assert Die(die.solid, 0.01, 1e-6, centre_of_mass_m=np.zeros(3)).is_spherical_top
    assert loaded_die(die.solid, 0.01, 0.0, [0, 0, 0.005]).is_spherical_top


CUBE = isohedral_solid("cube", EDGE_M)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: make_die("disc", 0.02, 0.016), "shape = 'disc'.*tetrahedron, cube"),
        (lambda: make_die("cube", 0.0, 0.016), "edge_m = 0.0"),
        (lambda: make_die("cube", 0.02, np.nan), "mass_kg = nan"),
        (lambda: die_from_solid(CUBE, 0.01, centre_of_mass_m=[0, 0, 0.001]), "without an inertia tensor"),
        (lambda: die_from_solid(CUBE, -1.0), "mass_kg = -1"),
        (lambda: die_from_solid(CUBE, 1.0, inertia_tensor_kg_m2=np.eye(2)), r"shape \(2, 2\)"),
        (lambda: die_from_solid(CUBE, 1.0, inertia_tensor_kg_m2=np.tri(3)), "a symmetric tensor"),
        (lambda: die_from_solid(CUBE, 1.0, inertia_tensor_kg_m2=np.diag([1, 1, 3])), "none larger than the sum"),
        (lambda: loaded_die(CUBE, 0.01, 0.001, [0, 0, 0.02]), "inside the cube"),
        (lambda: loaded_die(CUBE, 0.01, 0.001, [0, 0]), "wanted 3 finite numbers"),
        (lambda: loaded_die(CUBE, 0.01, -0.001, [0, 0, 0]), "load_kg = -0.001"),
        (lambda: truncated_dipyramid(2, 0.01, 0.01, 0.0), "sides = 2"),
        (lambda: truncated_dipyramid(3, 0.01, 0.01, 1.0), "cut = 1.0"),
        (lambda: truncated_dipyramid(3, 0.0, 0.01, 0.1), "radius_m = 0.0"),
        (lambda: truncated_dipyramid(3, 0.01, np.inf, 0.1), "half_height_m = inf"),
    ],
)  # fmt: skip
def test_impossible_bodies_raise_and_name_the_value(make, named):
    with pytest.raises(ValueError, match=named):
        make()
