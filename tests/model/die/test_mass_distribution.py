"""Volume, centroid and inertia of rounded bodies."""

import numpy as np
import pytest
from random_throws import random_quaternion
from scipy.stats import qmc

from diethrow.model.die.die import die_from_solid, loaded_die, make_die
from diethrow.model.die.mass_distribution import mass_distribution
from diethrow.model.die.named_solids import truncated_dipyramid
from diethrow.model.die.solid import SHAPES, convex_solid, inner_vertices, isohedral_solid
from diethrow.model.rotations import matrix_from_quat

CORNERED = convex_solid([(0, 0, 0), (1, 0, 0), (0, 1.5, 0), (0, 0, 2)], "cornered")
BODIES = [
    (isohedral_solid("cube", 1.0), 0.2),
    (isohedral_solid("octahedron", 1.0), 0.15),
    (isohedral_solid("icosahedron", 1.0), 0.3),
    (truncated_dipyramid(3, 1.0, 2.0, 0.4), 0.1),
    (CORNERED, 0.1),
]


def points_within(solid, radius, count):
    """Evenly spread points of the box about a solid that belong to the rounded body, and the volume of each."""
    low, high = solid.vertices.min(0), solid.vertices.max(0)
    x = low + qmc.Sobol(3, seed=7).random(count) * (high - low)
    inner, depth = inner_vertices(solid, radius), x @ solid.normals.T - (solid.offsets - radius)
    gap = np.where((depth <= 0.0).all(1), 0.0, np.inf)
    for face, normal, h in zip(solid.faces, solid.normals, depth.T, strict=True):
        corners = inner[list(face)]
        on_face = (h > 0.0) & np.logical_and.reduce(
            [(x - a) @ np.cross(b - a, normal) <= 0.0 for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
        )
        gap[on_face] = np.minimum(gap[on_face], h[on_face])
    for a, b in inner[solid.edges]:
        share = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        gap = np.minimum(gap, np.linalg.norm(x - a - share[:, None] * (b - a), axis=1))
    return x[gap <= radius], float(np.prod(high - low)) / count


@pytest.mark.parametrize(("solid", "radius"), BODIES, ids=lambda value: getattr(value, "name", value))
def test_integrals_are_those_over_the_points_of_the_body(solid, radius):
    body = mass_distribution(solid, radius)
    points, volume = points_within(solid, radius, 2**17)
    assert body.volume_m3 == pytest.approx(len(points) * volume, rel=1e-3)
    np.testing.assert_allclose(body.centroid_m, points.mean(0), atol=1e-3 * solid.circumradius)
    spread = np.cov(points.T, bias=True)
    inertia = np.trace(spread) * np.eye(3) - spread
    np.testing.assert_allclose(body.unit_inertia_m2, inertia, atol=2e-3 * np.trace(inertia) / 3.0)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_roundest_body_is_the_inscribed_ball_and_the_sharpest_the_solid(shape):
    solid = isohedral_solid(shape, 0.016)
    r = solid.inradius
    ball = mass_distribution(solid, (1.0 - 1e-9) * r)
    assert ball.volume_m3 == pytest.approx(4.0 / 3.0 * np.pi * r**3, rel=1e-7)
    np.testing.assert_allclose(ball.unit_inertia_m2, 0.4 * r**2 * np.eye(3), atol=1e-7 * r**2)
    sharp, hardly = mass_distribution(solid), mass_distribution(solid, 1e-9 * r)
    np.testing.assert_allclose(hardly.unit_inertia_m2, sharp.unit_inertia_m2, atol=1e-13 * r**2)


def test_a_rounded_cube_has_the_volume_of_its_parts():
    a, r = 0.016, 0.0021
    inner = a - 2.0 * r
    expected = inner**3 + 6.0 * inner**2 * r + 3.0 * np.pi * inner * r**2 + 4.0 / 3.0 * np.pi * r**3
    assert mass_distribution(isohedral_solid("cube", a), r).volume_m3 == pytest.approx(expected, rel=1e-14)


def test_a_turned_body_has_the_turned_inertia():
    rotation = matrix_from_quat(random_quaternion(np.random.default_rng(3)))
    turned = convex_solid(CORNERED.vertices @ rotation.T)
    here, there = mass_distribution(CORNERED, 0.15), mass_distribution(turned, 0.15)
    np.testing.assert_allclose(there.unit_inertia_m2, rotation @ here.unit_inertia_m2 @ rotation.T, atol=1e-13)
    np.testing.assert_allclose(there.centroid_m, rotation @ here.centroid_m, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
def test_rounding_a_homogeneous_die_takes_its_inertia_along_and_a_stated_one_stays(shape):
    edge, mass = 0.016, 0.005
    radius = 0.4 * isohedral_solid(shape, edge).inradius
    rounded = make_die(shape, edge, mass, corner_radius_m=radius, marks="numbers")
    followed = make_die(shape, edge, mass, marks="numbers").with_corner_radius(radius)
    assert followed.inertia_kg_m2 == rounded.inertia_kg_m2 < 0.998 * make_die(shape, edge, mass).inertia_kg_m2
    assert (followed.corner_radius_m, followed.marks, followed.is_homogeneous) == (radius, "numbers", True)
    stated = make_die(shape, edge, mass, inertia_kg_m2=1.1 * rounded.inertia_kg_m2).with_corner_radius(radius)
    assert stated.inertia_kg_m2 == 1.1 * rounded.inertia_kg_m2
    assert not stated.is_homogeneous


def test_a_body_that_rounding_shifts_keeps_its_centre_of_mass_and_a_load_shifts_it_further():
    die = die_from_solid(CORNERED, 0.01, corner_radius_m=0.15)
    body = mass_distribution(CORNERED, 0.15)
    np.testing.assert_array_equal(die.centre_of_mass_m, body.centroid_m)
    np.testing.assert_allclose(die.with_corner_radius(0.0).centre_of_mass_offset_m, 0.0, atol=1e-12)
    loaded = loaded_die(CORNERED, 0.01, 0.03, [0.05, 0.0, 0.0], corner_radius_m=0.15)
    np.testing.assert_allclose(loaded.centre_of_mass_m, 0.25 * body.centroid_m + 0.75 * np.array([0.05, 0.0, 0.0]))
    # Of a load without mass nothing remains, and the tensor is kept for another radius: it was not derived from this one.
    bare = loaded_die(CORNERED, 0.01, 0.0, [0.05, 0.0, 0.0], corner_radius_m=0.15)
    np.testing.assert_allclose(bare.tensor_kg_m2, die.tensor_kg_m2, rtol=1e-12)
    np.testing.assert_array_equal(bare.with_corner_radius(0.1).tensor_kg_m2, bare.tensor_kg_m2)
