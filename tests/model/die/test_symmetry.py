"""Symmetry rotations of dice, and the nearest of equivalent orientations."""

import numpy as np
import pytest
from random_throws import DICE, random_quaternion

from diethrow.model.die.die import die_from_solid, loaded_die, make_die
from diethrow.model.die.named_solids import truncated_dipyramid
from diethrow.model.die.solid import SHAPES, convex_solid, isohedral_solid
from diethrow.model.die.symmetry import (
    die_symmetries,
    inversion_rotation,
    nearest_equivalent_rotation,
    symmetry_rotations,
)
from diethrow.model.rotations import matrix_from_quat

EDGE_M = 0.02


@pytest.mark.parametrize("shape", SHAPES)
def test_the_nearest_equivalent_rotation_draws_the_same_die_and_has_the_smallest_angle(shape):
    rng = np.random.default_rng(6)
    solid = DICE[shape].solid
    symmetries = symmetry_rotations(solid)
    rotations, wanted = (matrix_from_quat([random_quaternion(rng) for _ in range(20)]) for _ in range(2))
    nearest = nearest_equivalent_rotation(rotations, wanted, symmetries)
    for rotation, target, found in zip(rotations, wanted, nearest, strict=True):
        gaps = np.linalg.norm((solid.vertices @ found.T)[:, None] - (solid.vertices @ rotation.T)[None], axis=2).min(1)
        # The symmetries are computed from the vertices: rounding only.
        assert gaps.max() < 1e-12
        traces = [float(np.trace(target.T @ rotation @ s)) for s in symmetries]
        assert np.trace(target.T @ found) == pytest.approx(max(traces), abs=1e-12)
        np.testing.assert_array_equal(nearest_equivalent_rotation(rotation, target, symmetries), found)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_orientation_that_is_equivalent_to_the_wanted_one_is_taken_to_it(shape):
    rng = np.random.default_rng(7)
    symmetries = symmetry_rotations(DICE[shape].solid)
    wanted = matrix_from_quat(random_quaternion(rng))
    nearest = nearest_equivalent_rotation(wanted @ symmetries, wanted, symmetries)
    np.testing.assert_allclose(nearest, np.broadcast_to(wanted, nearest.shape), atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_rotation_does_what_reflection_through_the_centre_does(shape):
    solid = make_die(shape, 0.02, 0.01).solid
    turn = inversion_rotation(solid)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    away = np.linalg.norm((solid.vertices @ turn.T)[:, None] + solid.vertices, axis=2).min(1)
    assert away.max() < 1e-15
    angle = np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0))
    assert angle == pytest.approx(90.0 if shape == "tetrahedron" else 0.0, abs=1e-5)


def test_a_solid_without_symmetry_has_no_rotation_for_its_reflection():
    points = np.random.default_rng(5).normal(size=(7, 3))
    assert inversion_rotation(convex_solid(points)) is None


@pytest.mark.parametrize(("sides", "cut"), [(3, 0.0), (4, 0.2), (5, 0.0), (6, 0.4), (9, 0.1)])
def test_a_dipyramid_has_the_rotations_of_its_polygon_on_both_sides(sides, cut):
    turns = symmetry_rotations(truncated_dipyramid(sides, 0.01, 0.017, cut))
    assert len(turns) == 2 * sides
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)


def test_a_load_leaves_only_the_rotations_that_keep_the_centre_of_mass():
    cube = isohedral_solid("cube", EDGE_M)
    for place, order in (
        ([0, 0, 0.005], 4),
        ([0.003, 0.003, 0.003], 3),
        ([0.004, 0.004, 0], 2),
        ([0.001, 0.002, 0.004], 1),
    ):
        assert len(die_symmetries(loaded_die(cube, 0.01, 0.002, place))) == order
    box = die_from_solid(
        convex_solid(cube.vertices * [1, 1, 1]), 0.01, inertia_tensor_kg_m2=np.diag([1e-6, 1e-6, 1.5e-6])
    )
    # The tensor has an axis: four turns about it and four half turns across it.
    assert len(die_symmetries(box)) == 8
    assert len(die_symmetries(DICE["cube"])) == 24
