"""Friction on dice with several moments of inertia: impacts, vertices that stick or slide, and rest."""

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model import engine
from diethrow.model.die.die import Die, die_from_solid, loaded_die
from diethrow.model.die.named_solids import truncated_dipyramid
from diethrow.model.die.solid import convex_solid, isohedral_solid
from diethrow.model.ensembles import ThrowSetup
from diethrow.model.laws import CoulombImpact, FrictionBySpeed, ImpactLaw, RestitutionBySpeed, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from diethrow.model.throw import Ending, State, Until, energy_J, packed_state, propagate, throw_die, touching_vertices
from diethrow.model.throw.asymmetric_throw import throw_asymmetric_die
from diethrow.model.throw.body import centre_of_mass_state
from diethrow.model.world import GRAVITY_M_S2

HALF = np.array([0.004, 0.01, 0.02])
BOX = die_from_solid(
    convex_solid([(x, y, z) for x in (-HALF[0], HALF[0]) for y in (-HALF[1], HALF[1]) for z in (-HALF[2], HALF[2])]),
    0.01,
)
LOADED = loaded_die(isohedral_solid("cube", 0.02), 0.011, 0.005, [0.003, 0.002, 0.008], corner_radius_m=0.001)
DIPYRAMID = die_from_solid(truncated_dipyramid(5, 0.012, 0.02, 0.3), 0.016)
ASYMMETRIC = {"loaded cube": LOADED, "box": BOX, "dipyramid": DIPYRAMID}
LAWS = {
    "slippery": CoulombImpact(0.5, 0.05),
    "rough": CoulombImpact(0.5, 0.8),
    "inelastic": CoulombImpact(0.0, 0.3),
    "by speed": FrictionBySpeed(RestitutionBySpeed(CoulombImpact(0.7, 0.3), 1.0), 1.0),
}

each_die = pytest.mark.parametrize("die", ASYMMETRIC.values(), ids=ASYMMETRIC.keys())
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())


def packed(law: ImpactLaw) -> engine.Law:
    return engine.law_of(law.code, law.parameters)


def on_side(die: Die, axis: int, velocity_m_s=(0.0, 0.0, 0.0), omega_rad_s=(0.0, 0.0, 0.0)) -> State:
    """A box on the face whose normal is this body axis."""
    rotation = np.roll(np.eye(3), axis - 2, axis=1)  # that axis points up
    height = -float((rotation @ die.solid.vertices.T)[2].min())
    return State(
        0.0, np.array([0.0, 0.0, height]), quat_from_matrix(rotation), np.array(velocity_m_s), np.array(omega_rad_s)
    )


@pytest.mark.parametrize("shape", ["tetrahedron", "cube", "icosahedron"])
@each_law
def test_a_die_with_one_moment_of_inertia_lands_alike_in_both_engines(shape, law):
    die, rng = DICE[shape], np.random.default_rng(1)
    for _ in range(10):
        release = random_release(rng, die)
        one, two = throw_die(die, release, law), throw_asymmetric_die(die, release, packed(law))
        first = [impact for impact in one.throw.impacts if impact.contact != "held"][:4]
        assert [impact.vertices[0] for impact in first] == two.impacts[:4, 1].astype(int).tolist()
        # Rounding of 1e-16, grown by up to four impacts.
        np.testing.assert_allclose(two.impacts[:4, 0], [impact.time_s for impact in first], atol=1e-10)
        assert one.landed_face == two.landed_face


@each_die
@each_law
def test_an_impact_is_one_impulse_within_the_cone_of_friction(die, law):
    rng = np.random.default_rng(3)
    centre = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    for row in throw_asymmetric_die(
        die, random_release(rng, die), packed(law), impacts=4, stop_when_decided=False
    ).impacts:
        rotation = matrix_from_quat(row[5:9])
        tensor = rotation @ die.inertia_tensor_kg_m2 @ rotation.T
        arm = rotation @ (touching_vertices(die)[int(row[1])] - centre) - np.array([0.0, 0.0, die.corner_radius_m])
        impulse = die.mass_kg * (row[15:18] - row[9:12])
        spun = tensor @ (row[18:21] - row[12:15])
        np.testing.assert_allclose(spun, np.cross(arm, impulse), atol=1e-13 * np.linalg.norm(spun))
        assert np.hypot(*impulse[:2]) <= law.parameters[1] * impulse[2] * (1.0 + 1e-12)
        before, after = (v + np.cross(w, arm) for v, w in ((row[9:12], row[12:15]), (row[15:18], row[18:21])))
        assert before[2] < 0.0 <= after[2] + 1e-14
        assert impulse @ (before + after) <= 1e-12 * np.linalg.norm(impulse)  # twice the change of energy


@each_die
@each_law
def test_every_throw_comes_to_rest_without_ever_gaining_energy_or_sinking(die, law):
    rng, faces, setup = np.random.default_rng(5), set(), ThrowSetup(die, law)
    for _ in range(8):
        release = random_release(rng, die)
        result = throw_die(die, release, law)
        assert result.ending is Ending.RESTED
        faces.add(result.landed_face)
        assert setup.throw(packed_state(release)[None]).face[0] == result.landed_face
        energies = [energy_J(die, f.at(t)) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
        # Keeping turned vertices at the table's height adds to the energy in rolling contact (`held_contact`).
        assert np.diff(energies).max() < 1e-5 * energies[0]
        for flight in result.throw.flights:
            state = flight.at(flight.end_s)
            low = state.position_m[2] + (state.rotation @ touching_vertices(die).T)[2].min() - die.corner_radius_m
            assert low > -1e-3 * die.solid.circumradius
    assert len(faces) > 1


def test_a_landed_face_is_the_one_that_a_longer_throw_ends_on():
    rng, law = np.random.default_rng(6), CoulombImpact(0.4, 0.3)
    for _ in range(6):
        release = random_release(rng, BOX)
        found = throw_die(BOX, release, law)
        on = throw_die(BOX, release, law, until=Until(time_s=found.end.time_s + 1.0))
        assert on.landed_face == found.landed_face
        assert int(np.argmin(BOX.solid.normals @ on.end.rotation[2])) + 1 == found.landed_face
        np.testing.assert_array_equal(on.end.velocity_m_s, 0.0)  # friction holds it


@pytest.mark.parametrize("axis", [0, 1])
def test_a_box_sticks_on_a_slope_below_the_angle_of_friction_and_slides_above(axis):
    mu, law = 0.3, CoulombImpact(0.5, 0.3)
    for angle, downhill in ((0.98 * np.arctan(mu), 0.4), (1.1 * np.arctan(mu), 0.4)):
        table = Table(tilt_rad=angle, downhill_rad=downhill)
        turn = table.world_from_table
        flat = on_side(BOX, axis)
        start = State(
            0.0,
            matrix_from_quat(turn) @ flat.position_m,
            quat_from_matrix(matrix_from_quat(turn) @ flat.rotation),
            np.zeros(3),
            np.zeros(3),
        )
        end = throw_die(BOX, start, law, until=Until(time_s=0.1), table=table).throw.flights[-1].at(0.1)
        speed = max(0.0, GRAVITY_M_S2 * (np.sin(angle) - mu * np.cos(angle)) * 0.1)
        assert np.linalg.norm(end.velocity_m_s) == pytest.approx(speed, rel=1e-6, abs=1e-12)
        assert np.linalg.norm(rotation_between(start.quaternion, end.quaternion)) < 1e-9


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_box_that_spins_on_a_face_is_stopped_by_the_torque_at_its_corners(axis):
    """Four corners at ρ from the axis press with m g in all: I dω/dt = -μ m g ρ. No tensor but this one has the moment I."""
    mu, spin = 0.2, 20.0
    start = on_side(BOX, axis, omega_rad_s=(0.0, 0.0, spin))
    moment = float((start.rotation @ BOX.inertia_tensor_kg_m2 @ start.rotation.T)[2, 2])
    lever = float(np.linalg.norm(np.delete(HALF, axis)))
    expected = spin * moment / (mu * BOX.mass_kg * GRAVITY_M_S2 * lever)
    result = throw_die(BOX, start, CoulombImpact(0.5, mu), until=Until(time_s=2.0 * expected))
    motion = result.throw.flights[-1]
    # Its energy is that of the spin, which decreases evenly until it stops.
    for part in (0.25, 0.5, 0.75):
        # Steps take up to four per cent of it each.
        assert motion.at(part * expected).omega_rad_s[2] == pytest.approx((1.0 - part) * spin, abs=0.025 * spin)
    assert motion.at(1.02 * expected).omega_rad_s[2] == 0.0


def test_a_box_released_on_its_edge_tips_about_it_with_constant_energy_while_friction_holds():
    """With tilt θ about the edge that sticks: (J + m r²) θ'² = 2 m g r (cos θ₀ - cos θ)."""
    far, corner, begin = np.hypot(0.01, 0.02), np.arctan2(0.01, 0.02), 0.3
    rotation = matrix_from_quat(quat_from_rotvec([-(corner + begin), 0.0, 0.0]))
    height = -(BOX.solid.vertices @ rotation[2]).min()
    release = State(0.0, np.array([0, 0, height]), quat_from_matrix(rotation), np.zeros(3), np.zeros(3))
    throw = throw_asymmetric_die(BOX, release, packed(CoulombImpact(0.0, 50.0)), duration_s=0.06)
    tensor, mass = BOX.inertia_tensor_kg_m2[0, 0], BOX.mass_kg
    steps = throw.knots[throw.knots[:, 1] > 0.02]
    assert len(steps) > 10
    tilts = begin + np.linalg.norm(rotation_between(release.quaternion[None], steps[:, 5:9]), axis=1)
    rates = np.sqrt(2 * mass * GRAVITY_M_S2 * far * (np.cos(begin) - np.cos(tilts)) / (tensor + mass * far**2))
    # Steps of first order, of some milliseconds.
    np.testing.assert_allclose(np.linalg.norm(steps[:, 12:15], axis=1), rates, rtol=3e-3)
    np.testing.assert_allclose(np.linalg.norm(steps[:, 9:12], axis=1), rates * far, rtol=3e-3)


@each_die
def test_a_throw_agrees_with_its_propagation_through_the_same_bounces(die):
    """Two codes of impact: the event loop, and the kernel of the derivatives."""
    rng, law = np.random.default_rng(9), CoulombImpact(0.6, 0.25)
    for _ in range(3):
        release = random_release(rng, die)
        throw = throw_die(die, release, law, until=Until(impacts=4)).throw
        struck = [impact.vertices[0] for impact in throw.impacts]
        times = [0.5 * (flight.start.time_s + flight.end_s) for flight in throw.flights]
        other = propagate(die, release, law, times, vertices=struck).throw
        np.testing.assert_allclose([i.time_s for i in other.impacts], [i.time_s for i in throw.impacts], atol=1e-11)
        for (p, q), (r, s) in zip(
            (throw.poses([time]) for time in times), (other.poses([time]) for time in times), strict=True
        ):
            np.testing.assert_allclose(p, r, atol=1e-10)
            assert float(np.linalg.norm(rotation_between(q, s))) < 1e-7


@each_die
def test_vanishing_friction_moves_a_die_as_none(die):
    release = random_release(np.random.default_rng(10), die)
    smooth = throw_die(die, release, SmoothImpact(0.6), until=Until(impacts=4)).throw
    rough = throw_die(die, release, CoulombImpact(0.6, 1e-13), until=Until(impacts=4)).throw
    assert [i.vertices for i in rough.impacts] == [i.vertices for i in smooth.impacts]
    np.testing.assert_allclose([i.time_s for i in rough.impacts], [i.time_s for i in smooth.impacts], atol=1e-10)


def test_states_between_events_are_those_of_the_events_at_their_ends():
    release = random_release(np.random.default_rng(11), LOADED)
    throw = throw_asymmetric_die(LOADED, release, packed(CoulombImpact(0.4, 0.3)))
    assert (throw.log[:, 22] == engine.SLIDING).any()
    before = throw.packed_states(throw.log[:, 0] - 1e-9)
    np.testing.assert_allclose(before[:, :3], throw.log[:, 2:5], atol=1e-7)
    first = centre_of_mass_state(LOADED, release)
    np.testing.assert_allclose(throw.packed_states([release.time_s])[0, :3], first.position_m, atol=1e-15)
