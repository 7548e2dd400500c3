"""Whole throws: symmetries, conservation laws, endings and limits."""

from itertools import pairwise

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model.die.die import make_die
from diethrow.model.die.solid import lowest_face
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_from_euler,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    rotation_between,
)
from diethrow.model.throw import body, simulate
from diethrow.model.throw.motion import State, energy_J
from diethrow.model.throw.simulate import Ending, Until, throw_die
from diethrow.model.world import GRAVITY_M_S2

each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())


def vertices_of(result) -> list[int]:
    return [impact.vertices[0] for impact in result.throw.bounces]


def times_of(result) -> np.ndarray:
    return np.array([impact.time_s for impact in result.throw.bounces])


@each_die
def test_an_elastic_throw_run_backwards_returns_to_its_release(die):
    rng = np.random.default_rng(41)
    for _ in range(5):
        release = random_release(rng, die)
        end = throw_die(die, release, SmoothImpact(1.0), until=Until(time_s=release.time_s + 0.4))
        there = end.end
        back = State(0.0, there.position_m, there.quaternion, -there.velocity_m_s, -there.omega_rad_s)
        here = throw_die(die, back, SmoothImpact(1.0), until=Until(time_s=0.4))
        assert vertices_of(here) == vertices_of(end)[::-1]
        # Rounding of 1e-15, grown a hundredfold or so by each of up to six impacts of a chaotic motion.
        np.testing.assert_allclose(here.end.position_m, release.position_m, atol=1e-9)
        np.testing.assert_allclose(here.end.velocity_m_s, -release.velocity_m_s, atol=1e-7)
        np.testing.assert_allclose(rotation_between(here.end.quaternion, release.quaternion), 0, atol=1e-7)


@each_die
def test_turning_and_shifting_the_throw_on_the_table_turns_and_shifts_the_result(die):
    release = random_release(np.random.default_rng(42), die)
    turn, shift = quat_from_rotvec([0.0, 0.0, 1.1]), np.array([0.4, -0.7, 0.0])
    matrix = matrix_from_quat(turn)
    moved = State(
        release.time_s + 3.0,
        matrix @ release.position_m + shift,
        quat_multiply(turn, release.quaternion),
        matrix @ release.velocity_m_s,
        matrix @ release.omega_rad_s,
    )
    one, two = (throw_die(die, r, SmoothImpact(0.6), until=Until(impacts=5)) for r in (release, moved))
    assert vertices_of(one) == vertices_of(two)
    # Rounding, grown by five impacts.
    np.testing.assert_allclose(times_of(two) - 3.0, times_of(one), atol=1e-10)
    np.testing.assert_allclose(two.end.position_m, matrix @ one.end.position_m + shift, atol=1e-9)
    np.testing.assert_allclose(
        rotation_between(two.end.quaternion, quat_multiply(turn, one.end.quaternion)), 0, atol=1e-7
    )
    assert two.landed_face == one.landed_face


@pytest.mark.parametrize("shape", list(DICE))
def test_a_throw_scaled_in_size_and_mass_is_the_same_throw_more_slowly(shape):
    """Gravity sets the only scale: lengths by s, times and velocities by √s, spins by 1/√s; the mass drops out."""
    small, s = DICE[shape], 64.0
    large = make_die(shape, 0.02 * s, 7.0)
    release = random_release(np.random.default_rng(43), small)
    scaled = State(
        np.sqrt(s) * release.time_s,
        s * release.position_m,
        release.quaternion,
        np.sqrt(s) * release.velocity_m_s,
        release.omega_rad_s / np.sqrt(s),
    )
    one, two = throw_die(small, release, SmoothImpact(0.5)), throw_die(large, scaled, SmoothImpact(0.5))
    assert vertices_of(one)[:5] == vertices_of(two)[:5]
    # The edge is not scaled by a power of two exactly: 1e-16, grown by five impacts.
    np.testing.assert_allclose(times_of(two)[:5] / np.sqrt(s), times_of(one)[:5], atol=1e-10)
    energies = [[i.energy_after_J / (d.mass_kg * GRAVITY_M_S2 * d.solid.circumradius) for i in r.throw.impacts[:5]]
                for r, d in ((one, small), (two, large))]  # fmt: skip
    np.testing.assert_allclose(energies[0], energies[1], rtol=1e-8)


def test_elastic_impacts_keep_the_energy_ten_thousand_times():
    die = DICE["cube"]
    release = random_release(np.random.default_rng(44), die)
    result = throw_die(die, release, SmoothImpact(1.0), until=Until(impacts=10_000))
    assert result.impact_count == 10_000
    # Rounding of 1e-16 an impact would make 1e-14 as a random walk, and 1e-12 if it all went one way.
    assert energy_J(die, result.end) == pytest.approx(energy_J(die, release), rel=2e-12)
    assert np.linalg.norm(result.end.quaternion) == pytest.approx(1.0, abs=1e-14)


@each_die
@pytest.mark.parametrize("chi", [0.2, 0.5, 0.9])
def test_energy_falls_from_impact_to_impact_and_is_kept_between(die, chi):
    rng = np.random.default_rng(45)
    for _ in range(5):
        impacts = throw_die(die, random_release(rng, die), SmoothImpact(chi)).throw.impacts
        for one, two in pairwise(impacts):
            assert two.energy_before_J == pytest.approx(one.energy_after_J, rel=1e-12)
            assert two.energy_after_J <= two.energy_before_J * (1 + 1e-14)


def test_a_die_dropped_on_the_vertex_below_its_centre_bounces_like_a_ball():
    die, chi, clearance = DICE["tetrahedron"], 0.5, 0.1
    down = die.solid.vertices[0] / die.solid.circumradius
    x = np.cross(down, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    quaternion = quat_from_matrix([x, np.cross(-down, x), -down])
    release = State(0.0, np.array([0, 0, die.solid.circumradius + clearance]), quaternion, np.zeros(3), np.zeros(3))
    impacts = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=5)).throw.impacts
    fall = np.sqrt(2 * clearance / GRAVITY_M_S2)
    flights = [fall, *(2 * fall * chi ** np.arange(1, 5))]
    # It balances on its tip, so rounding grows fast: five bounces keep nine digits.
    np.testing.assert_allclose([i.time_s for i in impacts], np.cumsum(flights), rtol=1e-9)
    np.testing.assert_allclose([i.chi for i in impacts], chi, rtol=1e-9)


@each_die
def test_the_lowest_faces_of_an_impact_are_those_half_way_through_its_flights(die):
    throw = throw_die(die, random_release(np.random.default_rng(46), die), SmoothImpact(0.7)).throw
    for k, impact in enumerate(throw.impacts):
        faces = [
            lowest_face(die.solid, f.at(0.5 * (f.start.time_s + f.end_s)).rotation) for f in throw.flights[k : k + 2]
        ]
        assert [impact.lowest_face_before, impact.lowest_face_after] == faces


@each_die
@pytest.mark.parametrize("chi", [0.5, 0.9])
def test_a_decided_face_stays_the_lowest_until_the_die_is_at_rest(die, chi):
    rng = np.random.default_rng(47)
    decided = 0
    for _ in range(12):
        release = random_release(rng, die)
        result = throw_die(die, release, SmoothImpact(chi))
        if result.ending is not Ending.RESTED:
            continue
        rattling = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=result.impact_count + 40))
        assert vertices_of(rattling)[: result.impact_count] == vertices_of(result)
        times = np.linspace(result.throw.flights[-1].start.time_s, rattling.end.time_s, 300)
        ups = matrix_from_quat(rattling.throw.poses(times)[1])
        assert {lowest_face(die.solid, up) for up in ups} == {result.landed_face}
        assert rattling.landed_face == result.landed_face
        decided += 1
    assert decided >= 4


@each_die
def test_a_die_with_just_too_much_energy_is_undecided_and_with_just_too_little_is_decided(die):
    barrier = body.edge_barriers_m(die.solid, die.solid.vertices)[0]
    normal = die.solid.normals[0]
    x = np.cross(normal, die.solid.vertices[die.solid.faces[0][0]])
    x /= np.linalg.norm(x)
    quaternion = quat_from_matrix([x, np.cross(-normal, x), -normal])
    height = 0.5 * (barrier + die.solid.inradius)
    for share, face in ((1 - 1e-9, 1), (1 + 1e-9, None)):
        spare = GRAVITY_M_S2 * (barrier * share - height)  # J/kg beyond the height, as lift or as level spin
        lift, turn = np.sqrt(2 * spare), np.sqrt(2 * spare * die.mass_kg / die.inertia_kg_m2)
        for z, v_z, w_x in ((barrier * share, 0.0, 0.0), (height, lift, 0.0), (height, 0.0, turn)):
            # Drift and vertical spin hold far more energy and do not count.
            velocity, omega = np.array([5.0, 5.0, v_z]), np.array([w_x, 0.0, 99.0])
            release = State(0.0, np.array([0, 0, z]), quaternion, velocity, omega)
            assert throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=0)).landed_face == face


@pytest.mark.parametrize("chi", [0.0, 0.01, 0.3, 0.7, 0.95, 0.999])
@each_die
def test_every_throw_that_loses_energy_comes_to_rest_or_spins(die, chi):
    rng = np.random.default_rng(49)
    for spin in (0.0, 40.0, 1000.0):
        result = throw_die(die, random_release(rng, die, spin_rad_s=spin, clearance_m=0.05), SmoothImpact(chi))
        assert result.ending in ((Ending.RESTED,) if spin < 100 else (Ending.RESTED, Ending.SPINNING, Ending.SPUN_LONG))
        assert (result.landed_face is not None) == (result.ending is Ending.RESTED)


@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
def test_a_die_dropped_flat_or_laid_on_the_table_ends_at_rest(chi):
    die = DICE["cube"]
    for height in (0.01, 0.0101, 0.1):
        release = State(0.0, np.array([0, 0, height]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
        result = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=0.2))
        assert result.ending is Ending.TIME_REACHED
        assert energy_J(die, result.end) <= energy_J(die, release) * (1 + 1e-13)
    assert throw_die(die, release_flat(0.01), SmoothImpact(chi)).landed_face == 6


def release_flat(height_m: float) -> State:
    """A cube level, at rest."""
    return State(0.0, np.array([0, 0, height_m]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))


def test_a_throw_stops_at_the_requested_time_or_impact():
    die = DICE["cube"]
    release = random_release(np.random.default_rng(50), die)
    whole = throw_die(die, release, SmoothImpact(0.8), until=Until(impacts=6))
    assert (whole.ending, whole.impact_count) == (Ending.IMPACTS_REACHED, 6)
    time = 0.5 * (times_of(whole)[3] + times_of(whole)[4])
    cut = throw_die(die, release, SmoothImpact(0.8), until=Until(time_s=time))
    assert (cut.ending, cut.impact_count) == (Ending.TIME_REACHED, 4)
    assert cut.end.time_s == pytest.approx(time, abs=1e-15)
    np.testing.assert_allclose(cut.end.position_m, whole.throw.at(time).position_m, atol=1e-14)


def test_a_throw_that_never_rests_ends_as_bouncing(monkeypatch):
    monkeypatch.setattr(simulate, "BOUNCING_CAP", 30)
    die = DICE["cube"]
    result = throw_die(die, random_release(np.random.default_rng(51), die), SmoothImpact(1.0))
    assert (result.ending, result.impact_count, result.landed_face) == (Ending.BOUNCING, 30, None)


def test_the_same_release_gives_the_same_throw_to_the_last_bit():
    die = DICE["icosahedron"]
    one, two = (throw_die(die, random_release(np.random.default_rng(52), die), SmoothImpact(0.7)) for _ in range(2))
    assert vertices_of(one) == vertices_of(two)
    np.testing.assert_array_equal(times_of(one), times_of(two))
    np.testing.assert_array_equal(one.end.quaternion, two.end.quaternion)


def test_a_throw_does_not_change_its_release():
    die = DICE["cube"]
    release = random_release(np.random.default_rng(53), die)
    copies = [release.position_m.copy(), release.quaternion.copy(), release.velocity_m_s.copy()]
    throw_die(die, release, SmoothImpact(0.7))
    for before, after in zip(copies, (release.position_m, release.quaternion, release.velocity_m_s), strict=True):
        np.testing.assert_array_equal(before, after)


def test_euler_angles_and_a_spin_in_the_body_frame_release_the_die_of_the_paper():
    """Fig. 5: the first impact is fixed by the release alone, so closed forms give it."""
    die = DICE["cube"]
    quaternion = quat_from_euler([0.001, 0.00001, 0.0001])
    omega = matrix_from_quat(quaternion) @ [0.0, 60.0, 0.0]
    release = State(0.0, np.array([0, 0, 0.3]), quaternion, np.array([0.6, 0.0, -0.7]), omega)
    first = throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=1)).throw.impacts[0]
    t = first.time_s
    # A level spin of 60 rad/s about an axis next to y: heights a/√2 cos(60 t - π/4) of the square section, to 1e-4.
    phase = (60 * t + np.pi / 4) % (np.pi / 2) - np.pi / 4
    half_diagonal = 0.01 * np.sqrt(2)
    reach = half_diagonal * max(np.cos(phase - np.pi / 4), np.cos(phase + np.pi / 4))
    assert 0.3 - 0.7 * t - 0.5 * GRAVITY_M_S2 * t * t == pytest.approx(reach, abs=1e-5)


def test_a_release_below_the_table_or_a_limit_before_it_raises():
    die = DICE["cube"]
    with pytest.raises(ValueError, match=r"0\.001 m below the table"):
        throw_die(die, release_flat(0.009), SmoothImpact(0.5))
    with pytest.raises(ValueError, match="until time_s"):
        throw_die(die, release_flat(0.1), SmoothImpact(0.5), until=Until(time_s=-1.0))
    with pytest.raises(ValueError, match="time_s = inf"):
        Until(time_s=np.inf)
    with pytest.raises(ValueError, match="impacts = -1"):
        Until(impacts=-1)
    with pytest.raises(ValueError, match="quaternion of length 2"):
        throw_die(
            die,
            State(0.0, np.array([0, 0, 1.0]), np.array([2.0, 0, 0, 0]), np.zeros(3), np.zeros(3)),
            SmoothImpact(0.5),
        )
