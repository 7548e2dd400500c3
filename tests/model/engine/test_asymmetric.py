"""Throws of asymmetric bodies: Euler's equations, impacts with any inertia tensor, held contact, rest."""

from collections import Counter

import numpy as np
import pytest
from random_throws import DICE, random_quaternion, random_release
from scipy.integrate import quad, solve_ivp

from diethrow.model import throw
from diethrow.model.die.die import die_from_solid, loaded_die
from diethrow.model.die.named_solids import truncated_dipyramid
from diethrow.model.die.solid import convex_solid, isohedral_solid
from diethrow.model.engine.types import (
    IMPACTS_REACHED,
    LEVEL,
    RESTED,
    SPINNING,
    TIME_REACHED,
    TIMED_OUT,
    Law,
    Plane,
    SmoothLaw,
)
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    rotation_between,
)
from diethrow.model.throw.asymmetric_throw import throw_asymmetric_die
from diethrow.model.throw.body import centre_of_mass_state, centroid_state
from diethrow.model.throw.motion import State, energy_J
from diethrow.model.throw.simulate import throw_die
from diethrow.model.world import GRAVITY_M_S2

LOADED = loaded_die(isohedral_solid("cube", 0.02), 0.011, 0.005, [0.003, 0.002, 0.008])
BOX = die_from_solid(
    convex_solid([(x, y, z) for x in (-0.004, 0.004) for y in (-0.01, 0.01) for z in (-0.02, 0.02)]), 0.01
)
DIPYRAMID = die_from_solid(truncated_dipyramid(5, 0.012, 0.02, 0.3), 0.016)
ASYMMETRIC = {"loaded cube": LOADED, "box": BOX, "dipyramid": DIPYRAMID}

each_die = pytest.mark.parametrize("die", ASYMMETRIC.values(), ids=ASYMMETRIC.keys())


def smooth(chi: float) -> Law:
    return SmoothLaw(SmoothImpact(chi).code, SmoothImpact(chi).parameters)


def energies_and_momenta(die, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies (n,), angular momenta (n, 3) and lowest corners (n,) of centre-of-mass states (n, 13)."""
    R = matrix_from_quat(states[:, 3:7])
    J = R @ die.inertia_tensor_kg_m2 @ R.transpose(0, 2, 1)
    L = np.einsum("nij,nj->ni", J, states[:, 10:13])
    energy = 0.5 * die.mass_kg * (states[:, 7:10] ** 2).sum(1) + 0.5 * (L * states[:, 10:13]).sum(1)
    shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    low = ((die.solid.vertices - shift) @ R[:, 2, :, None])[:, :, 0].min(1) + states[:, 2]
    return energy + die.mass_kg * GRAVITY_M_S2 * states[:, 2], L, low


@pytest.mark.parametrize("shape", list(DICE))
def test_a_die_with_one_moment_of_inertia_has_the_same_impacts_in_both_engines(shape):
    die = DICE[shape]
    rng = np.random.default_rng(1)
    for _ in range(4):
        release = random_release(rng, die)
        one = throw_die(die, release, SmoothImpact(0.5)).throw.impacts[:5]
        two = throw_asymmetric_die(die, release, smooth(0.5)).impacts[:5]
        assert [i.vertices[0] for i in one] == two[:, 1].astype(int).tolist()
        # Rounding of 1e-16, grown by up to five impacts.
        np.testing.assert_allclose(two[:, 0], [i.time_s for i in one], atol=1e-10)


def test_a_tumbling_box_follows_eulers_equations():
    """Spun about its middle axis a free body turns over again and again (Dzhanibekov)."""
    start = State(0.0, np.array([0.0, 0.0, 100.0]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0.3, 30.0, 0.0]))
    moments = np.diag(BOX.inertia_tensor_kg_m2)

    def rates(_, y):
        w, q = y[:3], y[3:]
        turn = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return [*(np.cross(moments * w, w) / moments), *turn]

    times = np.linspace(0.0, 1.0, 21)
    other = solve_ivp(rates, (0.0, 1.0), [*start.omega_rad_s, 1, 0, 0, 0], "DOP853", times, rtol=1e-13, atol=1e-13)
    states = throw_asymmetric_die(BOX, start, smooth(0.5), duration_s=1.0).packed_states(times)
    turned = np.array([rotation_between(a, b) for a, b in zip(states[:, 3:7], other.y[3:].T, strict=True)])
    # The middle axis is unstable: it has turned over, and the reference's 1e-13 has grown as the tilt has.
    assert other.y[1].min() < -29.0
    np.testing.assert_allclose(turned, 0.0, atol=1e-8)


@each_die
def test_free_flight_keeps_energy_and_angular_momentum(die):
    release = random_release(np.random.default_rng(2), die, spin_rad_s=200.0, clearance_m=30.0)
    states = throw_asymmetric_die(die, release, smooth(0.5), duration_s=2.0).packed_states(
        np.linspace(0, 2, 101) + release.time_s
    )
    energy, L, _ = energies_and_momenta(die, states)
    # Some two thousand steps.
    np.testing.assert_allclose(energy, energy[0], rtol=1e-13)
    np.testing.assert_allclose(L, L[:1].repeat(101, 0), atol=1e-13 * np.linalg.norm(L[0]))


@each_die
def test_an_impact_is_one_vertical_impulse_and_reverses_the_vertex_velocity_times_chi(die):
    rng = np.random.default_rng(3)
    shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    for chi in (0.0, 0.4, 1.0):
        throw = throw_asymmetric_die(die, random_release(rng, die), smooth(chi), impacts=3, stop_when_decided=False)
        for row in throw.impacts:
            R = matrix_from_quat(row[5:9])
            J = R @ die.inertia_tensor_kg_m2 @ R.T
            arm = R @ (die.solid.vertices[int(row[1])] - shift)
            impulse = die.mass_kg * (row[15:18] - row[9:12])
            np.testing.assert_allclose(impulse[:2], 0.0, atol=1e-17)
            spun = J @ (row[18:21] - row[12:15])
            np.testing.assert_allclose(spun, np.cross(arm, impulse), atol=1e-14 * np.linalg.norm(spun))
            before, after = (v[2] + np.cross(w, arm)[2] for v, w in ((row[9:12], row[12:15]), (row[15:18], row[18:21])))
            assert after == pytest.approx(-chi * before, abs=1e-13)
            # The corner stands on the table: position and attitude carry some ten roundings each.
            assert row[4] + arm[2] == pytest.approx(0.0, abs=1e-16)


@each_die
def test_an_elastic_throw_keeps_its_energy(die):
    release = random_release(np.random.default_rng(4), die)
    throw = throw_asymmetric_die(die, release, smooth(1.0), impacts=2000)
    assert (throw.code, throw.impact_count) == (IMPACTS_REACHED, 2000)
    end = throw.at(throw.end_s)
    # Rounding at each impact and step.
    assert energy_J(die, end) == pytest.approx(energy_J(die, release), rel=3e-12)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_a_throw_never_gains_energy_keeps_its_vertical_spin_momentum_and_stays_above_the_table(die, chi):
    rng = np.random.default_rng(5)
    for _ in range(6):
        release = random_release(rng, die)
        throw = throw_asymmetric_die(die, release, smooth(chi), duration_s=1.0, stop_when_decided=False)
        assert throw.code == TIME_REACHED
        states = throw.packed_states(release.time_s + np.linspace(0.0, 1.0, 700))
        energy, L, low = energies_and_momenta(die, states)
        # Held contact is integrated to 1e-14 a step and put back on its constraint.
        assert np.diff(energy).max() < 1e-12 * energy[0]
        np.testing.assert_allclose(L[:, 2], L[0, 2], atol=1e-12 * np.abs(L).max())
        assert low.min() > -1e-15
        speeds = states[:, 7:9]
        np.testing.assert_allclose(speeds, speeds[:1].repeat(700, 0), rtol=1e-12)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.1, 0.5, 0.9])
def test_every_throw_comes_to_rest_on_a_face_and_stays_there(die, chi):
    rng = np.random.default_rng(6)
    for k in range(25):
        release = random_release(rng, die)
        throw = throw_asymmetric_die(die, release, smooth(chi))
        assert throw.code == RESTED
        if k < 3:
            # The limit in time replaces the stop: the face that was decided must be the one it ends on.
            wait = throw.end_s - release.time_s + 0.3
            longer = throw_asymmetric_die(die, release, smooth(chi), duration_s=wait, stop_when_decided=False)
            assert longer.landed_face == throw.landed_face
            up = longer.at(longer.end_s).rotation[2]
            assert int(np.argmin(die.solid.normals @ up)) + 1 == throw.landed_face


def test_a_loaded_die_lands_on_its_heavy_side_more_often():
    heavy = loaded_die(isohedral_solid("cube", 0.02), 0.011, 0.005, [0.0, 0.0, 0.008])
    rng = np.random.default_rng(7)
    faces = Counter(
        throw_asymmetric_die(heavy, random_release(rng, heavy), smooth(0.5)).landed_face for _ in range(200)
    )
    # Face 1 is +z. A fair die would give 33 of 200, 5 more or less: these bounds are 4 and 3 of those away.
    assert faces[1] > 55
    assert faces[6] < 20


@each_die
@pytest.mark.parametrize(("length", "mass"), [(0.005, 1e-7), (500.0, 1e4)])
def test_the_same_throw_in_any_size_and_mass_has_the_same_history(die, length, mass):
    """Edges of 0.1 mm and 10 m, masses near 1e-9 and 1e3 kg: times by √s, spins by 1/√s, the mass drops out."""
    shift = None if die.centre_of_mass_m is None else die.centre_of_mass_m * length
    solid = convex_solid(die.solid.vertices * length)
    scaled = die_from_solid(
        solid,
        die.mass_kg * mass,
        inertia_tensor_kg_m2=die.inertia_tensor_kg_m2 * (mass * length**2),
        centre_of_mass_m=shift,
    )
    release, root = random_release(np.random.default_rng(8), die), np.sqrt(length)
    large = State(
        release.time_s * root,
        release.position_m * length,
        release.quaternion,
        release.velocity_m_s * root,
        release.omega_rad_s / root,
    )
    one, two = throw_asymmetric_die(die, release, smooth(0.3)), throw_asymmetric_die(scaled, large, smooth(0.3))
    assert one.impacts[:5, 1].tolist() == two.impacts[:5, 1].tolist()
    # Rounding of the scaling, grown by five impacts.
    np.testing.assert_allclose(two.impacts[:5, 0] / root, one.impacts[:5, 0], atol=1e-9)


def test_a_box_released_on_its_edge_falls_with_constant_energy():
    """Planar: with tilt θ the centre stands at h(θ) over the sliding edge, and m h'²θ'² + J θ'² = 2 m g (h0 - h)."""
    solid = BOX.solid
    edge = [i for i in range(8) if solid.vertices[i, 1] > 0 and solid.vertices[i, 2] < 0]
    far = np.hypot(0.01, 0.02)
    corner = np.arctan2(0.01, 0.02)  # of the diagonal from the long side; the edge is under the centre at θ = 0
    begin = 0.3
    rotation = matrix_from_quat(quat_from_rotvec([-(corner + begin), 0.0, 0.0]))
    height = -(solid.vertices @ rotation[2]).min()
    assert height == pytest.approx(far * np.cos(begin), rel=1e-12)
    release = State(0.0, np.array([0, 0, height]), quat_from_matrix(rotation), np.zeros(3), np.zeros(3))
    throw = throw_asymmetric_die(BOX, release, smooth(0.0), duration_s=0.2, stop_when_decided=False)
    assert sorted(throw.log[0, 21:23].astype(int)) == sorted(edge)
    J, m, g = BOX.inertia_tensor_kg_m2[0, 0], BOX.mass_kg, GRAVITY_M_S2
    end = np.pi / 2 - corner  # the broad side is down

    def slowness(s):
        # θ = begin + s² takes the square root from the start.
        theta = begin + s * s
        fallen = 2 * m * g * far * 2 * np.sin((theta + begin) / 2) * np.sin(s * s / 2) / (s * s)
        return 2 * np.sqrt((m * (far * np.sin(theta)) ** 2 + J) / fallen)

    expected = quad(slowness, 0.0, np.sqrt(end - begin), epsabs=1e-14, epsrel=1e-13)[0]
    # Rounding of the start pose alone may let an edge hang 1e-17 m high before it is held.
    assert throw.impacts[0, 0] == pytest.approx(expected, abs=1e-10)


@each_die
def test_an_oscillating_table_adds_the_energy_of_its_impulse(die):
    plane = Plane(0.0, 0.0, GRAVITY_M_S2, 0.001, 2 * np.pi * 40.0, 0.3)
    release = random_release(np.random.default_rng(9), die)
    throw = throw_asymmetric_die(die, release, smooth(0.6), plane=plane, duration_s=1.0, stop_when_decided=False)
    shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
    assert throw.code == TIME_REACHED
    for row in throw.impacts:
        phase = plane.rate * row[0] + plane.phase
        table = plane.amplitude * plane.rate * np.cos(phase)
        arm = matrix_from_quat(row[5:9]) @ (die.solid.vertices[int(row[1])] - shift)
        before, after = (v[2] + np.cross(w, arm)[2] for v, w in ((row[9:12], row[12:15]), (row[15:18], row[18:21])))
        assert after - table == pytest.approx(-0.6 * (before - table), abs=1e-13)
        assert row[4] + arm[2] == pytest.approx(plane.amplitude * np.sin(phase), abs=2e-15)
    times = release.time_s + np.linspace(0, 1, 500)
    low = energies_and_momenta(die, throw.packed_states(times))[2]
    assert (low - plane.amplitude * np.sin(plane.rate * times + plane.phase)).min() > -1e-14


def test_a_table_of_zero_amplitude_is_at_rest():
    release = random_release(np.random.default_rng(10), LOADED)
    one = throw_asymmetric_die(LOADED, release, smooth(0.5))
    two = throw_asymmetric_die(LOADED, release, smooth(0.5), plane=Plane(0.0, 0.0, GRAVITY_M_S2, 0.0, 1e5, 1.0))
    np.testing.assert_array_equal(one.log, two.log)


def test_a_gently_moving_table_keeps_a_die_on_its_face_and_a_hard_one_throws_it_up():
    rate = 2 * np.pi * 20.0
    for push, code in ((0.9, RESTED), (1.5, TIME_REACHED)):
        # At the release the table is lowest, and at rest.
        plane = Plane(0.0, 0.0, GRAVITY_M_S2, push * GRAVITY_M_S2 / rate**2, rate, -np.pi / 2)
        flat = State(0.0, np.array([0, 0, 0.02 - plane.amplitude]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.eye(3)[2])
        throw = throw_asymmetric_die(BOX, flat, smooth(0.5), plane=plane, duration_s=0.3, stop_when_decided=push < 1.0)
        assert throw.code == code
    held, released = throw.log[throw.log[:, 1] < 0][:2]
    assert held[22] == -2
    # On the table until its own acceleration reaches -g, where the sine is 1/1.5.
    assert released[0] == pytest.approx((np.pi / 2 + np.arcsin(1 / 1.5)) / rate, abs=1e-6 / rate)


def test_a_tilted_table_only_adds_a_horizontal_acceleration():
    release = random_release(np.random.default_rng(11), LOADED)
    tilt = 0.2
    g = GRAVITY_M_S2 * np.cos(tilt)
    level = throw_asymmetric_die(LOADED, release, smooth(0.5), plane=Plane(0, 0, g, 0, 0, 0))
    tilted = throw_asymmetric_die(LOADED, release, smooth(0.5), plane=Plane(GRAVITY_M_S2 * np.sin(tilt), 0, g, 0, 0, 0))
    np.testing.assert_allclose(level.impacts[:, :2], tilted.impacts[:, :2], atol=1e-12)
    drift = 0.5 * GRAVITY_M_S2 * np.sin(tilt) * (tilted.end_s - release.time_s) ** 2
    moved = tilted.at(tilted.end_s).position_m[0] - level.at(level.end_s).position_m[0]
    assert moved == pytest.approx(drift, rel=1e-9)


def test_a_rounded_die_moves_as_its_sharp_inner_die_on_a_raised_table():
    solid, radius = BOX.solid, 0.001
    rounded = die_from_solid(solid, 0.01, inertia_tensor_kg_m2=BOX.inertia_tensor_kg_m2, corner_radius_m=radius)
    inner = convex_solid(solid.vertices - radius * np.sign(solid.vertices))
    sharp = die_from_solid(inner, 0.01, inertia_tensor_kg_m2=BOX.inertia_tensor_kg_m2)
    release = random_release(np.random.default_rng(12), BOX)
    low = State(release.time_s, release.position_m - [0, 0, radius], *(getattr(release, n) for n in
                ("quaternion", "velocity_m_s", "omega_rad_s")))  # fmt: skip
    one, two = throw_asymmetric_die(rounded, release, smooth(0.5)), throw_asymmetric_die(sharp, low, smooth(0.5))
    np.testing.assert_allclose(one.impacts[:4, :2], two.impacts[:4, :2], atol=1e-10)
    assert one.landed_face == two.landed_face


def test_states_of_centroid_and_centre_of_mass_describe_one_motion():
    rng = np.random.default_rng(13)
    state = State(0.5, rng.normal(size=3), random_quaternion(rng), rng.normal(size=3), rng.normal(size=3))
    centre = centre_of_mass_state(LOADED, state)
    back = centroid_state(LOADED, centre)
    np.testing.assert_allclose(back.position_m, state.position_m, atol=1e-16)
    np.testing.assert_allclose(back.velocity_m_s, state.velocity_m_s, atol=1e-16)
    # The velocity of the centre of mass is the derivative of its place.
    dt = 1e-6
    turn = matrix_from_quat(quat_from_rotvec(dt * state.omega_rad_s))
    moved = state.position_m + dt * state.velocity_m_s + turn @ state.rotation @ LOADED.centre_of_mass_m
    np.testing.assert_allclose((moved - centre.position_m) / dt, centre.velocity_m_s, atol=1e-7)


def test_a_die_on_its_face_has_landed_at_rest_or_spinning():
    for spin in (0.0, 500.0):
        flat = State(0.0, np.array([0, 0, 0.02]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, spin]))
        throw = throw_asymmetric_die(BOX, flat, smooth(0.5))
        assert (throw.code, throw.impact_count) == (RESTED, 0)
        assert BOX.solid.normals[throw.landed_face - 1] == pytest.approx([0.0, 0.0, -1.0])


def test_a_die_held_on_one_vertex_follows_newtons_and_eulers_equations_with_a_contact_force():
    """The same equations with dense matrices in world axes, integrated by scipy."""
    die = LOADED
    m, J, shift = die.mass_kg, die.inertia_tensor_kg_m2, die.centre_of_mass_m
    corner = die.solid.vertices[0] - shift
    tilt = quat_from_rotvec([0.35, 0.1, 0.0])
    down = corner / np.linalg.norm(corner)
    x = np.cross(down, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    R0 = matrix_from_quat(tilt) @ np.array([x, np.cross(-down, x), -down])
    w0 = np.array([1.0, 2.0, 60.0])
    arm = R0 @ corner
    v0 = np.array([0.0, 0.0, -np.cross(w0, arm)[2]])
    # The release is given at the centroid.
    at, v = np.array([0.0, 0.0, -arm[2]]) - R0 @ shift, v0 - np.cross(w0, R0 @ shift)
    release = State(0.0, at, quat_from_matrix(R0), v, w0)
    throw = throw_asymmetric_die(die, release, smooth(0.0), duration_s=0.03, stop_when_decided=False)
    assert throw.impact_count == 0
    assert throw.log[0, 21:23].tolist() == [0, -1]

    def rates(_, y):
        R, w = y[:9].reshape(3, 3), y[9:12]
        W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        inverse = np.linalg.inv(R @ J @ R.T)
        arm, lever = R @ corner, np.cross(R @ corner, [0.0, 0.0, 1.0])
        free = -inverse @ np.cross(w, R @ J @ R.T @ w)
        lift = (np.cross(free, arm) + np.cross(w, np.cross(w, arm)))[2] - GRAVITY_M_S2
        force = -lift / (1 / m + lever @ inverse @ lever)
        assert force > 0
        return [*(W @ R).ravel(), *(free + force * inverse @ lever), y[13], force / m - GRAVITY_M_S2]

    start = [*R0.ravel(), *w0, -arm[2], v0[2]]
    other = solve_ivp(rates, (0.0, 0.03), start, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    end = throw.packed_states([0.03])[0]
    # The reference's own tolerance.
    np.testing.assert_allclose(matrix_from_quat(end[3:7]).ravel(), other[:9], atol=1e-10)
    np.testing.assert_allclose(end[10:13], other[9:12], atol=1e-8)
    assert end[2] == pytest.approx(other[12], abs=1e-12)
    assert end[9] == pytest.approx(other[13], abs=1e-11)


TOPS = {
    "dipyramid": die_from_solid(truncated_dipyramid(5, 0.012, 0.02, 0.0), 0.016),
    "flat dipyramid": die_from_solid(truncated_dipyramid(5, 0.02, 0.009, 0.0), 0.016),
    "cube loaded on its diagonal": loaded_die(isohedral_solid("cube", 0.02), 0.011, 0.005, [0.003, 0.003, 0.003]),
}
"""Bodies with an axis of symmetry of their inertia that goes through a vertex, and only there."""


def spun_on_its_lowest_vertex(die, up: np.ndarray, tilt_rad: float, spin_rad_s: float) -> State:
    """A release just above the table, turned so that a body axis `up` (3,) is tilted by an angle, with a spin about it."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    angle = np.arccos(up[2] / np.linalg.norm(up))
    upright = quat_from_rotvec(angle * axis / max(np.linalg.norm(axis), 1e-300))
    turned = quat_multiply(quat_from_rotvec([tilt_rad, 0.0, 0.0]), upright)
    rotation = matrix_from_quat(turned)
    low = float((die.solid.vertices @ rotation[2]).min())
    spin = spin_rad_s * (rotation @ up) / np.linalg.norm(up)
    return State(0.0, np.array([0.0, 0.0, 1e-5 - low]), turned, np.zeros(3), spin)


def tips(die) -> np.ndarray:
    """(k, 3) the vertices on an axis of symmetry of the inertia, from the centre of mass, in body axes."""
    body, axes = throw.asymmetric_body_of(die)
    return (body.vertices @ matrix_from_quat(axes).T)[np.isfinite(body.safe_tilt_cosines)]


@pytest.mark.parametrize("die", TOPS.values(), ids=TOPS.keys())
def test_a_top_that_is_proved_to_spin_forever_never_touches_with_another_vertex(die):
    """The sleeping top with a free foot is stable while L² > 4 m g h I, with the moment I across: far below 600 rad/s."""
    for tip in tips(die):
        release = spun_on_its_lowest_vertex(die, -tip, 0.05, 600.0)
        found = throw_asymmetric_die(die, release, smooth(0.3))
        assert found.code == SPINNING
        assert found.landed_face is None
        on = throw_asymmetric_die(die, release, smooth(0.3), duration_s=found.end_s + 2.0, stop_when_decided=False)
        states = on.packed_states(np.linspace(found.end_s, found.end_s + 2.0, 400))
        shift = np.zeros(3) if die.centre_of_mass_m is None else die.centre_of_mass_m
        heights = ((die.solid.vertices - shift) @ matrix_from_quat(states[:, 3:7])[:, 2, :, None])[..., 0]
        heights += states[:, 2, None]
        lowest = np.argsort(heights, axis=1)
        assert len(np.unique(lowest[:, 0])) == 1
        assert np.take_along_axis(heights, lowest, axis=1)[:, 1].min() > 1e-4


@pytest.mark.parametrize("die", TOPS.values(), ids=TOPS.keys())
def test_a_top_that_spins_too_slowly_falls_and_is_not_called_spinning(die):
    for tip in tips(die):
        release = spun_on_its_lowest_vertex(die, -tip, 0.05, 5.0)
        assert throw_asymmetric_die(die, release, smooth(0.3)).code == RESTED


def test_a_spin_that_no_proof_covers_is_given_up_after_a_time_and_not_called_endless():
    """A dipyramid a little wider one way: it spins on its tip, but what holds a symmetric top there is no longer constant."""
    corners = [(s * x, s * y, s * z) for x, y, z in ((0.012, 0, 0), (0, 0.0125, 0), (0, 0, 0.02)) for s in (-1, 1)]
    die = die_from_solid(convex_solid(corners), 0.01)
    assert not len(tips(die))
    release = spun_on_its_lowest_vertex(die, np.array([0.0, 0.0, 1.0]), 0.02, 600.0)
    found = throw_asymmetric_die(die, release, smooth(0.3))
    assert found.code == TIMED_OUT
    assert found.end_s > 1000.0 * np.sqrt(0.02 / GRAVITY_M_S2)


def test_an_unsupported_throw_raises_an_error():
    release = random_release(np.random.default_rng(14), LOADED)
    with pytest.raises(ValueError, match="law 7 by the kernels of asymmetric dice"):
        throw_asymmetric_die(LOADED, release, SmoothLaw(7, np.array([0.5])))
    below = State(0.0, np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="below the table"):
        throw_asymmetric_die(LOADED, below, smooth(0.5), plane=LEVEL)
    deep = loaded_die(isohedral_solid("cube", 0.02), 0.001, 1.0, [0.0, 0.0, 0.0099], corner_radius_m=0.001)
    with pytest.raises(ValueError, match="centre_of_mass_m"):
        throw.asymmetric_body_of(deep)
