"""Tilted and oscillating tables: a level table at rest is a special case, and no touch of an oscillating one is missed."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from random_throws import DICE, exact_octahedron, lowest_vertex_m, random_release
from scipy.optimize import brentq

from diethrow.model import engine
from diethrow.model.laws import LEVEL, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from diethrow.model.throw.held_contact import HeldContact
from diethrow.model.throw.motion import Flight, State, energy_J
from diethrow.model.throw.simulate import Ending, Until, throw_die
from diethrow.model.world import GRAVITY_M_S2

G = GRAVITY_M_S2
each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())
TILTED = Table(tilt_rad=0.4, downhill_rad=1.1)


def turned(state: State, table: Table) -> State:
    """The same state relative to a tilted table as this one relative to the level table."""
    turn = table.world_from_table
    matrix = matrix_from_quat(turn)
    return State(
        state.time_s,
        matrix @ state.position_m,
        quat_multiply(turn, state.quaternion),
        matrix @ state.velocity_m_s,
        matrix @ state.omega_rad_s,
    )


def assert_same_history(one, two) -> None:
    """The same impacts and ends to the last bit."""
    assert one.ending is two.ending
    assert one.landed_face == two.landed_face
    assert [i.vertices for i in one.throw.impacts] == [i.vertices for i in two.throw.impacts]
    assert [i.time_s for i in one.throw.impacts] == [i.time_s for i in two.throw.impacts]
    np.testing.assert_array_equal(one.end.quaternion, two.end.quaternion)
    np.testing.assert_array_equal(one.end.position_m, two.end.position_m)
    np.testing.assert_array_equal(one.end.velocity_m_s, two.end.velocity_m_s)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.6])
def test_a_table_without_amplitude_or_frequency_is_the_table_at_rest_bit_for_bit(die, chi):
    rng = np.random.default_rng(81)
    for table in (Table(amplitude_m=0.0, frequency_hz=50.0, phase_rad=1.0), Table(amplitude_m=0.01, phase_rad=1.0)):
        release = random_release(rng, die)
        assert_same_history(*(throw_die(die, release, SmoothImpact(chi), table=t) for t in (LEVEL, table)))
    no_tilt = Table(tilt_rad=0.0, downhill_rad=2.0)
    assert_same_history(*(throw_die(die, release, SmoothImpact(chi), table=t) for t in (LEVEL, no_tilt)))


@each_die
def test_a_tilted_table_is_a_level_one_under_weaker_gravity_and_a_pull_downhill(die):
    """Normal motion with g cos α: the throw in the table's axes is the level throw with that gravity, slower by √cos α;
    along the table it gains g sin α t²/2, which touches nothing else."""
    release = random_release(np.random.default_rng(82), die, spin_rad_s=20.0, clearance_m=0.05)
    slower = np.sqrt(np.cos(TILTED.tilt_rad))
    weak = replace(release, velocity_m_s=slower * release.velocity_m_s, omega_rad_s=slower * release.omega_rad_s)
    level = throw_die(die, release, SmoothImpact(0.4), until=Until(impacts=6))
    start = turned(weak, TILTED)
    tilted = throw_die(die, start, SmoothImpact(0.4), until=Until(impacts=6), table=TILTED)
    assert [i.vertices for i in tilted.throw.impacts] == [i.vertices for i in level.throw.impacts]
    after = np.array([[i.time_s - release.time_s for i in r.throw.impacts] for r in (level, tilted)])
    # Rounding of 1e-15, grown by six impacts.
    np.testing.assert_allclose(slower * after[1], after[0], rtol=1e-9)
    matrix = matrix_from_quat(TILTED.world_from_table)
    time = 0.5 * (after[1][2] + after[1][3])
    there = tilted.throw.at(release.time_s + time)
    along = matrix.T @ there.position_m
    expected = (
        release.position_m[:2]
        + slower * release.velocity_m_s[:2] * time
        # The way down of the table is the world's downhill direction, dipped below the horizon: x of an untwisted table.
        + 0.5 * G * np.sin(TILTED.tilt_rad) * time**2 * np.array([np.cos(1.1), np.sin(1.1)])
    )
    np.testing.assert_allclose(along[:2], expected, atol=1e-13)
    normal = level.throw.at(release.time_s + slower * time).position_m[2]
    assert along[2] == pytest.approx(normal, abs=1e-11)


@each_die
def test_an_elastic_throw_on_a_tilted_table_keeps_its_energy_in_world_axes_and_touches_it_in_its_plane(die):
    release = turned(random_release(np.random.default_rng(83), die, clearance_m=0.05), TILTED)
    result = throw_die(die, release, SmoothImpact(1.0), until=Until(impacts=60), table=TILTED)
    normal = matrix_from_quat(TILTED.world_from_table)[:, 2]
    assert normal[2] == pytest.approx(np.cos(0.4))
    assert normal[:2] @ [np.cos(1.1), np.sin(1.1)] == pytest.approx(np.sin(0.4))
    ends = [energy_J(die, f.at(t)) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
    # Sums of 1e3 larger parts once the die has slid down the slope for some seconds.
    np.testing.assert_allclose(ends, ends[0], rtol=0, atol=1e-12 * max(map(abs, kinetic(die, result))))
    for impact, flight in zip(result.throw.impacts, result.throw.flights, strict=False):
        state = flight.at(flight.end_s)
        points = state.position_m + die.solid.vertices @ state.rotation.T
        distance = np.linalg.norm(state.position_m) + G * state.time_s**2
        assert abs(normal @ points[impact.vertices[0]]) < 1e-14 * (1 + distance)
        np.testing.assert_allclose(impact.point_m, points[impact.vertices[0]][:2], atol=1e-14 * (1 + distance))
        assert (points @ normal).min() > -1e-13 * (1 + distance)


def kinetic(die, result) -> list[float]:
    """Kinetic energies [J] at the ends of the flights."""
    ends = [f.at(f.end_s) for f in result.throw.flights]
    return [0.5 * die.mass_kg * float(s.velocity_m_s @ s.velocity_m_s) for s in ends]


@each_die
def test_held_contact_on_a_tilted_table_stays_in_its_plane_and_obeys_the_energy_in_world_axes(die):
    rng, seen = np.random.default_rng(84), 0
    normal = matrix_from_quat(TILTED.world_from_table)[:, 2]
    while seen < 3:
        release = turned(random_release(rng, die, spin_rad_s=10.0, clearance_m=0.01), TILTED)
        until = Until(time_s=release.time_s + 0.5)
        for held in throw_die(die, release, SmoothImpact(0.0), until=until, table=TILTED).throw.flights:
            if not isinstance(held, HeldContact) or held.end_s - held.start.time_s < 1e-3:
                continue
            states = [held.at(t) for t in np.linspace(held.start.time_s, held.end_s, 10)]
            for state in states:
                points = state.position_m + die.solid.vertices[list(held.vertices)] @ state.rotation.T
                assert np.abs(points @ normal).max() < 1e-13
            # The table's force does no work; the integration makes 1e-9.
            energies = [energy_J(die, s) for s in states]
            assert np.ptp(energies) < 3e-9 * die.mass_kg * G * 0.1
            seen += 1


OSCILLATIONS = [(1.0, 0.05), (25.0, 1e-3), (150.0, 1e-4), (2000.0, 1e-5), (1e4, 1e-6), (1e4, 1e-3)]


def relative_heights(die, release: State, table: Table, dt: np.ndarray) -> np.ndarray:
    """Heights (n, vertices) above the moving table, by the plainest way."""
    positions, quaternions = Flight(release, np.inf).poses(release.time_s + dt)
    heights = positions[:, 2, None] + matrix_from_quat(quaternions)[:, 2] @ die.solid.vertices.T
    phase = 2 * np.pi * table.frequency_hz * (release.time_s + dt) + table.phase_rad
    return heights - (table.amplitude_m * np.sin(phase))[:, None]


@pytest.mark.parametrize(("frequency", "amplitude"), OSCILLATIONS)
def test_the_first_touch_of_a_oscillating_table_is_the_one_that_dense_sampling_finds(frequency, amplitude):
    rng = np.random.default_rng(85)
    for shape in DICE:
        die = DICE[shape]
        for _ in range(12):
            table = Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=float(rng.uniform(0, 2 * np.pi)))
            spin = float(rng.choice([0.0, 30.0, 600.0]))
            release = random_release(rng, die, spin_rad_s=spin, clearance_m=amplitude + float(rng.choice([1e-6, 2e-3])))
            first = throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=1), table=table).throw.impacts[0]
            touch = first.time_s - release.time_s
            # Sixty samples a period of the faster motion, as far as the touch and one period beyond.
            period = 1 / max(frequency, spin / (2 * np.pi), 20.0)
            dt = np.linspace(0.0, touch, min(int(60 * touch / period) + 60, 60_000))
            heights = relative_heights(die, release, table, dt)
            # The phase is rounded to 1e-16 of itself, up to 6e4, and with it the height of the table.
            limit = 1e-15 + 1e-14 * (0.2 + amplitude * (1 + 2 * np.pi * frequency))
            assert heights.min() > -limit
            assert abs(heights[-1, first.vertices[0]]) < limit
            assert first.normal_velocity_before_m_s < 0
            # The touch is a crossing, not only a near miss: brentq finds it between before and after.
            after = min(0.01 * period, amplitude / abs(first.normal_velocity_before_m_s) + 1e-7)

            def height(t, i=first.vertices[0], die=die, release=release, table=table):
                return float(relative_heights(die, release, table, np.array([t]))[0, i])

            if height(touch + after) < 0 < height(touch - min(after, touch)):
                crossing = brentq(height, touch - min(after, touch), touch + after, xtol=1e-16)
                assert crossing == pytest.approx(touch, abs=limit / abs(first.normal_velocity_before_m_s) + 1e-15)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
def test_an_impact_on_a_oscillating_table_reverses_the_velocity_relative_to_it(die, chi):
    rng = np.random.default_rng(86)
    table = Table(amplitude_m=2e-3, frequency_hz=30.0, phase_rad=0.3)
    release = random_release(rng, die, clearance_m=0.02)
    throw = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=12), table=table).throw
    rate = 2 * np.pi * table.frequency_hz
    for k, impact in enumerate(throw.impacts):
        if impact.contact == "held":
            continue
        # From the flights on both sides and the table's own formula.
        before, after = throw.flights[k].at(impact.time_s), throw.flights[k + 1].at(impact.time_s)
        arm = before.rotation @ die.solid.vertices[impact.vertices[0]]
        of_table = table.amplitude_m * rate * np.cos(rate * impact.time_s + table.phase_rad)
        u, v = (s.velocity_m_s[2] + np.cross(s.omega_rad_s, arm)[2] - of_table for s in (before, after))
        assert u < 0
        # An instant is rounded to 1e-16 s of some seconds, times up to 1000 m/s² at the vertex.
        assert v == pytest.approx(-chi * u, abs=1e-12 * (1 + abs(u)))
        assert impact.normal_velocity_before_m_s == pytest.approx(u, abs=1e-12)
        height = before.position_m[2] + arm[2]
        assert height == pytest.approx(table.amplitude_m * np.sin(rate * impact.time_s + table.phase_rad), abs=1e-14)


@pytest.mark.parametrize(("chi", "frequency"), [(0.2, 30.0), (0.5, 60.0), (0.8, 100.0)])
def test_a_die_on_its_tip_bounces_in_step_with_the_table_as_a_ball_does(chi, frequency):
    """One bounce a period T: landing and leaving at the phase p with relative velocities ∓g T/(1 + χ), so that the table's
    own velocity there is A ω cos p = (1 - χ)/(1 + χ) g T/2 (Guckenheimer & Holmes, Nonlinear Oscillations, 1983, 2.4)."""
    die = exact_octahedron()
    rate, period = 2 * np.pi * frequency, 1 / frequency
    needed = (1 - chi) / (1 + chi) * G * period / 2
    amplitude = 1.2 * needed / rate
    phase = np.arccos(needed / (amplitude * rate))
    table = Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase)
    # At t = 0 the table stands at A sin p and the tip has just left it, with the velocity g T/2 of a flight of T.
    position = np.array([0, 0, amplitude * np.sin(phase) + die.solid.circumradius])
    velocity = np.array([0, 0, G * period / 2])
    release = State(0.0, position, np.array([1.0, 0, 0, 0]), velocity, np.zeros(3))
    impacts = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=30), table=table).throw.impacts
    assert {i.vertices for i in impacts} == {(5,)}
    # A neighbouring orbit comes nearer or oscillates about this one for cos p so near 1; rounding stays rounding.
    np.testing.assert_allclose([i.time_s for i in impacts], period * np.arange(1, 31), rtol=1e-10)
    np.testing.assert_allclose([i.normal_velocity_after_m_s for i in impacts], chi * G * period / (1 + chi), rtol=1e-9)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.3])
def test_a_die_comes_to_rest_on_a_table_that_oscillates_too_weakly_to_throw_it_up(die, chi):
    """A (2πf)² = 0.9 g; afterwards the face stays down and the die moves with the table."""
    weak = Table(amplitude_m=0.9 * G / (2 * np.pi * 20) ** 2, frequency_hz=20.0)
    release = random_release(np.random.default_rng(87), die, spin_rad_s=5.0, clearance_m=0.01)
    result = throw_die(die, release, SmoothImpact(chi), table=weak)
    assert result.ending is Ending.RESTED
    assert result.landed_face is not None
    on = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=result.end.time_s + 0.3), table=weak).throw
    for t in result.end.time_s + np.linspace(0.0, 0.3, 30):
        above = on.at(t).position_m[2] - weak.amplitude_m * np.sin(2 * np.pi * 20 * t)
        assert above == pytest.approx(die.solid.inradius, abs=1e-11)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_a_die_flat_on_a_oscillating_table_is_thrown_up_when_the_table_falls_faster_than_it(die, chi):
    """A ω² = 2 g: it leaves at the phase p with A ω² sin p = g, flies with the velocity it had, and lands again."""
    frequency = 20.0
    rate = 2 * np.pi * frequency
    table = Table(amplitude_m=2.0 * G / rate**2, frequency_hz=frequency)
    face = die.solid.normals[0]
    x = np.cross(face, die.solid.vertices[die.solid.faces[0][0]])
    x /= np.linalg.norm(x)
    quaternion = quat_from_matrix([x, np.cross(-face, x), -face])
    # At t = 0 the table rises at its fastest and the die with it.
    velocity = np.array([0.0, 0.0, table.amplitude_m * rate])
    release = State(0.0, np.array([0, 0, die.solid.inradius]), quaternion, velocity, np.zeros(3))
    throw = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=0.5), table=table).throw
    flat = [f for f in throw.flights if isinstance(f, HeldContact) and len(f.vertices) > 2]
    assert flat[0].end_s == pytest.approx(np.arcsin(0.5) / rate, rel=1e-9)
    for held in flat:
        for t in np.linspace(held.start.time_s, held.end_s, 5):
            height = held.at(t).position_m[2] - die.solid.inradius
            assert height == pytest.approx(table.amplitude_m * np.sin(rate * t), abs=1e-12)
            # The table pushes, never pulls.
            assert table.amplitude_m * rate**2 * np.sin(rate * t) <= G * (1 + 1e-9)


@each_die
def test_a_die_never_rests_on_a_table_that_throws_it_up(die):
    strong = Table(amplitude_m=2.0 * G / (2 * np.pi * 20) ** 2, frequency_hz=20.0)
    release = random_release(np.random.default_rng(87), die, spin_rad_s=5.0, clearance_m=0.01)
    for chi in (0.0, 0.5):
        result = throw_die(die, release, SmoothImpact(chi), table=strong)
        assert (result.ending, result.landed_face) == (Ending.BOUNCING, None)


@each_die
def test_whole_periods_of_the_clock_and_whole_turns_of_the_phase_change_nothing(die):
    table = Table(amplitude_m=1e-3, frequency_hz=32.0, phase_rad=0.7)
    release = random_release(np.random.default_rng(88), die, clearance_m=0.02)
    until = Until(impacts=6)
    usual = throw_die(die, release, SmoothImpact(0.5), until=until, table=table).throw.impacts
    later = replace(release, time_s=release.time_s + 3 / 32.0)
    moved = throw_die(die, later, SmoothImpact(0.5), until=until, table=table).throw.impacts
    whole = replace(table, phase_rad=table.phase_rad + 4 * np.pi)
    again = throw_die(die, release, SmoothImpact(0.5), until=until, table=whole).throw.impacts
    for impacts, shift in ((moved, 3 / 32.0), (again, 0.0)):
        assert [i.vertices for i in impacts] == [i.vertices for i in usual]
        # A phase of up to 200 rad is rounded to 3e-14; six impacts multiply it.
        np.testing.assert_allclose([i.time_s - shift for i in impacts], [i.time_s for i in usual], atol=1e-9)


@each_die
def test_a_turn_of_the_throw_about_the_vertical_with_the_slope_turns_the_result(die):
    release = turned(random_release(np.random.default_rng(89), die, clearance_m=0.02), TILTED)
    turn = quat_from_rotvec([0.0, 0.0, 0.8])
    matrix = matrix_from_quat(turn)
    other = State(
        release.time_s, matrix @ release.position_m, quat_multiply(turn, release.quaternion),
        matrix @ release.velocity_m_s, matrix @ release.omega_rad_s,
    )  # fmt: skip
    slope = replace(TILTED, downhill_rad=TILTED.downhill_rad + 0.8)
    until = Until(impacts=4)
    one = throw_die(die, release, SmoothImpact(0.5), until=until, table=TILTED)
    two = throw_die(die, other, SmoothImpact(0.5), until=until, table=slope)
    assert [i.vertices for i in one.throw.impacts] == [i.vertices for i in two.throw.impacts]
    np.testing.assert_allclose(two.end.position_m, matrix @ one.end.position_m, atol=1e-10)


def test_energy_on_a_oscillating_table_changes_only_by_impacts_and_by_the_work_of_the_table():
    """In flight it is kept, whatever the table does."""
    die = DICE["cube"]
    table = Table(amplitude_m=1e-3, frequency_hz=60.0)
    release = random_release(np.random.default_rng(90), die)
    impacts = throw_die(die, release, SmoothImpact(0.9), until=Until(impacts=40), table=table).throw.impacts
    for one, two in pairwise(impacts):
        assert two.energy_before_J == pytest.approx(one.energy_after_J, rel=1e-12)


def test_a_tilt_turns_the_kernels_gravity_and_keeps_its_size():
    plane = TILTED.plane
    assert np.hypot(np.hypot(plane.gx, plane.gy), plane.g) == pytest.approx(G, rel=1e-15)
    assert plane.g == pytest.approx(G * np.cos(0.4), rel=1e-15)
    assert np.arctan2(plane.gy, plane.gx) == pytest.approx(1.1, rel=1e-14)
    assert LEVEL.plane == engine.LEVEL
    assert lowest_vertex_m(DICE["cube"], State(0.0, np.ones(3), np.array([1.0, 0, 0, 0]), *np.zeros((2, 3)))) == (
        pytest.approx(0.99)
    )
