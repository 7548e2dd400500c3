"""Several vertices that touch at one instant: the motion depends on no numbering of the vertices, and keeps the energy law."""

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model.die import Die, symmetry_rotations
from diethrow.model.die.die import die_from_solid, loaded_die, make_die
from diethrow.model.die.solid import convex_solid, isohedral_solid
from diethrow.model.laws import CoulombImpact, RestitutionBySpeed, SmoothImpact
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from diethrow.model.throw import State, Until, throw_die
from diethrow.model.throw.motion import energy_J

UP = np.array([0.0, 0.0, 1.0])
HEIGHT_M = 0.05
BOX_CORNERS = np.array([(x, y, z) for x in (-0.004, 0.004) for y in (-0.01, 0.01) for z in (-0.02, 0.02)])
each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())


def turned_up(direction: np.ndarray) -> np.ndarray:
    """(4,) a quaternion that turns a body direction (3,) straight down."""
    down = direction / np.linalg.norm(direction)
    axis = np.cross(down, -UP)
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0]) if down[2] < 0 else np.array([0.0, 1.0, 0.0, 0.0])
    return quat_from_rotvec(np.arctan2(size, -down[2]) * axis / size)


def on_faces_and_edges(die: Die) -> dict[str, np.ndarray]:
    """Body directions (3,) that point down where the die falls on its first face, and on its first edge along its length."""
    corners = die.solid.vertices[die.solid.edges[0]]
    return {"face": die.solid.normals[0], "edge": corners.mean(axis=0)}


def dropped(die: Die, down: np.ndarray, vertical_spin_rad_s: float = 3.0) -> State:
    """A release with a body direction straight down, moving sideways and turning about the vertical."""
    start = turned_up(down)
    return State(0.0, HEIGHT_M * UP, start, np.array([0.3, -0.1, -0.4]), vertical_spin_rad_s * UP)


def relabelled(release: State, symmetry: np.ndarray) -> State:
    """The same body, with its vertices numbered as a rotation (3, 3) onto itself permutes them."""
    q = quat_multiply(release.quaternion, quat_from_matrix(symmetry))
    return State(release.time_s, release.position_m, q, release.velocity_m_s, release.omega_rad_s)


@each_die
@pytest.mark.parametrize("on", ["face", "edge"])
@pytest.mark.parametrize("law", [SmoothImpact(0.6), SmoothImpact(1.0), RestitutionBySpeed(SmoothImpact(0.7), 1.0)])
def test_a_die_on_a_face_or_an_edge_moves_the_same_however_its_vertices_are_numbered(die, on, law):
    release = dropped(die, on_faces_and_edges(die)[on])
    until = Until(impacts=3)
    end = throw_die(die, release, law, until=until).end
    for symmetry in symmetry_rotations(die.solid):
        other = throw_die(die, relabelled(release, symmetry), law, until=until)
        assert not other.depends_on_numbering
        np.testing.assert_allclose(other.end.position_m, end.position_m, atol=1e-9)
        np.testing.assert_allclose(other.end.rotation @ symmetry.T, end.rotation, atol=1e-7)
        np.testing.assert_allclose(other.end.omega_rad_s, end.omega_rad_s, atol=1e-6)


@each_die
@pytest.mark.parametrize("on", ["face", "edge"])
@pytest.mark.parametrize("chi", [0.0, 0.4, 1.0])
def test_vertices_that_strike_together_leave_with_chi_times_their_speed_and_turn_nothing(die, on, chi):
    down = on_faces_and_edges(die)[on]
    result = throw_die(die, dropped(die, down), SmoothImpact(chi), until=Until(impacts=1))
    impact, before, after = result.throw.impacts[0], result.throw.flights[0], result.throw.flights[1].start
    corners = die.solid.faces[0] if on == "face" else tuple(die.solid.edges[0])
    assert set(impact.vertices) == set(corners)
    assert impact.contact == ("edge" if len(corners) == 2 else "face")
    speed = before.at(impact.time_s).velocity_m_s[2]
    assert impact.normal_velocity_before_m_s == pytest.approx(speed)
    assert after.velocity_m_s[2] == pytest.approx(-chi * speed, abs=1e-12)
    np.testing.assert_allclose(after.omega_rad_s, before.start.omega_rad_s, atol=1e-9)
    lost = energy_J(die, before.start) - energy_J(die, after)
    assert lost == pytest.approx(0.5 * die.mass_kg * (1.0 - chi**2) * speed**2, abs=1e-12)


@each_die
def test_a_die_dropped_flat_bounces_flat_until_it_rests_on_that_face(die):
    result = throw_die(die, dropped(die, die.solid.normals[0]), SmoothImpact(0.5))
    assert result.landed_face == 1
    assert all(set(impact.vertices) == set(die.solid.faces[0]) for impact in result.throw.bounces)


@pytest.mark.parametrize("chi", [0.3, 1.0])
def test_a_box_of_three_moments_dropped_on_an_edge_moves_the_same_with_its_corners_in_any_order(chi):
    rng = np.random.default_rng(5)
    ends = []
    for _ in range(6):
        die = die_from_solid(convex_solid(rng.permutation(BOX_CORNERS)), 0.01)
        release = dropped(die, np.array([0.004, 0.0, -0.02]), vertical_spin_rad_s=0.0)
        result = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=0.14))
        strikes = result.throw.bounces[0]
        assert strikes.contact == "edge"
        ends.append(result.end)
        energies = [energy_J(die, flight.start) for flight in result.throw.flights]
        assert max(energies) <= energies[0] * (1.0 + 1e-12)
        if chi == 1.0:
            np.testing.assert_allclose(energies, energies[0], rtol=1e-12)
    for end in ends[1:]:
        np.testing.assert_allclose(end.position_m, ends[0].position_m, atol=1e-10)
        np.testing.assert_allclose(end.rotation, ends[0].rotation, atol=1e-8)


def test_an_uneven_load_on_several_vertices_keeps_the_energy_law_at_every_restitution():
    """A loaded cube that falls flat: its vertices carry different impulses, and at χ = 1 the energy stays."""
    die = loaded_die(isohedral_solid("cube", 0.02), 0.011, 0.005, [0.004, 0.002, 0.0])
    for chi in (0.0, 0.5, 1.0):
        release = dropped(die, np.array([0.0, 0.0, -1.0]), vertical_spin_rad_s=0.0)
        result = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=0.12))
        assert result.throw.impacts[0].contact in ("edge", "face")
        energies = np.array([energy_J(die, flight.start) for flight in result.throw.flights])
        assert (np.diff(energies) <= 1e-12 * energies[0]).all()
        if chi == 1.0:
            np.testing.assert_allclose(energies, energies[0], rtol=1e-11)


@each_die
def test_a_throw_to_rest_lands_the_same_however_its_vertices_are_numbered(die):
    """A die that tips over an edge comes down with several vertices at once."""
    rng = np.random.default_rng(31)
    symmetries = symmetry_rotations(die.solid)
    for _ in range(5):
        release = random_release(rng, die, spin_rad_s=15.0, clearance_m=0.01)
        one = throw_die(die, release, SmoothImpact(0.1))
        symmetry = symmetries[int(rng.integers(1, len(symmetries)))]
        two = throw_die(die, relabelled(release, symmetry), SmoothImpact(0.1))
        normal = die.solid.normals[one.landed_face - 1]
        assert die.solid.normals[two.landed_face - 1] @ symmetry.T @ normal == pytest.approx(1.0)
        np.testing.assert_allclose(two.end.position_m, one.end.position_m, atol=1e-6)


def test_with_friction_a_result_says_that_it_depends_on_the_numbers_of_its_vertices():
    die, law = make_die("cube", 0.016, 0.0045), CoulombImpact(0.5, 0.3)
    assert throw_die(die, dropped(die, die.solid.normals[0]), law, until=Until(impacts=4)).depends_on_numbering
    tilted = dropped(die, die.solid.normals[0] + np.array([0.1, 0.23, 0.05]))
    assert not throw_die(die, tilted, law, until=Until(impacts=4)).depends_on_numbering
    assert matrix_from_quat(tilted.quaternion)[2, 2] != 1.0
