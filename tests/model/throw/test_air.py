"""Laws of throws against the drag of the air, from the release to rest."""

from dataclasses import replace

import numpy as np
import pytest
from random_throws import DICE, random_release
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from diethrow.model.die import Die, make_die
from diethrow.model.ensembles import ThrowSetup, decidable_in_double_precision, error_growth
from diethrow.model.laws import (
    CoulombImpact,
    FrictionBySpeed,
    ImpactLaw,
    RestitutionBySpeed,
    SmoothImpact,
    Table,
)
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw import Ending, HeldContact, State, Until, energy_J, packed_state, propagate, throw_die

G = 9.81
CUBE = DICE["cube"]
ROUNDED = make_die("cube", 0.016, 0.0045, corner_radius_m=0.0015)
LAWS: dict[str, ImpactLaw] = {
    "smooth": SmoothImpact(0.6),
    "rough": CoulombImpact(0.6, 0.2),
    "smooth by speed": RestitutionBySpeed(SmoothImpact(0.7), 2.0),
    "rough by speed": FrictionBySpeed(RestitutionBySpeed(CoulombImpact(0.7, 0.3), 2.0), 2.0),
}
TABLES = {"level": Table(), "tilted": Table(tilt_rad=0.2), "oscillating": Table(amplitude_m=1e-3, frequency_hz=30.0)}
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
SHAPES = ("tetrahedron", "cube", "icosahedron")
each_die = pytest.mark.parametrize("die", [*(DICE[s] for s in SHAPES), ROUNDED], ids=[*SHAPES, "rounded cube"])
each_drag = pytest.mark.parametrize("k", [1e-3, 0.03, 0.5, 10.0])


def released(rng, die, **given):
    """A random release at time 0."""
    return replace(random_release(rng, die, **given), time_s=0.0)


def sampled(throw, count=5):
    """States along all flights."""
    return [f.at(t) for f in throw.flights for t in np.linspace(f.start.time_s, f.end_s, count)]


def flat(speed_m_s: float, height_m: float = 0.0, spin_rad_s: float = 0.0) -> State:
    """The cube, level, at a height of its lower face, moving along x and turning about the vertical."""
    z = CUBE.solid.inradius + height_m
    return State(
        0.0, np.array([0, 0, z]), np.array([1.0, 0, 0, 0]), np.array([speed_m_s, 0, 0]), np.array([0, 0, spin_rad_s])
    )


# ---- the flight ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [1e-6, 0.03, 1.0, 10.0])
@pytest.mark.parametrize("height", [0.1, 10.0, 300.0])
def test_a_die_that_is_dropped_falls_as_long_and_as_fast_as_the_closed_form_says(k, height):
    """h = log cosh(√(g k) t)/k and v = √(g/k) tanh(√(g k) t)."""
    first = throw_die(CUBE, flat(0.0, height), SmoothImpact(0.5), until=Until(impacts=1), drag_per_m=k).throw.impacts[0]
    fallen = k * height
    seconds = (fallen + np.log1p(np.sqrt(-np.expm1(-2.0 * fallen)))) / np.sqrt(G * k)  # acosh(exp(k h))
    assert first.time_s == pytest.approx(seconds, rel=1e-11)
    assert first.normal_velocity_before_m_s == pytest.approx(-np.sqrt(-np.expm1(-2.0 * fallen) * G / k), rel=1e-11)


@pytest.mark.parametrize("k", [0.03, 1.0, 10.0, 1000.0])
@pytest.mark.parametrize("down_m_s", [0.0, 50.0])
def test_a_long_fall_ends_at_the_terminal_velocity(k, down_m_s):
    """k v² = g, from below and from above."""
    release = replace(flat(3.0, 20.0 / k), velocity_m_s=np.array([3.0, 0, -down_m_s]))
    throw = throw_die(CUBE, release, SmoothImpact(0.5), until=Until(impacts=1), drag_per_m=k).throw
    velocity = throw.flights[0].at(throw.impacts[0].time_s).velocity_m_s
    # exp(-2 k h) of the difference is left; of the motion along the table the part exp(-k h).
    np.testing.assert_allclose(velocity, [0.0, 0.0, -np.sqrt(G / k)], atol=1e-7 * np.sqrt(G / k))


@pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())
@each_drag
def test_several_bounces_agree_with_another_integrator(die, k):
    """The whole throw by scipy, with its events and the impulse of a smooth impact written once more."""
    chi, tolerance = 0.7, 1e-8
    release = released(np.random.default_rng(5), die, clearance_m=0.1)
    throw = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=4), drag_per_m=k).throw
    vertices = die.solid.vertices

    def arms(y, t):
        return (Rotation.from_rotvec(t * y[6:9]) * turn).apply(vertices)

    def rates(_, y):
        return np.concatenate([y[3:6], -np.array([0, 0, G]) - k * np.linalg.norm(y[3:6]) * y[3:6], np.zeros(3)])

    def event(v):
        def height(t, y):
            return y[2] + arms(y, t)[v, 2]

        height.terminal, height.direction = True, -1
        return height

    events = [event(v) for v in range(len(vertices))]
    y = np.concatenate([release.position_m, release.velocity_m_s, release.omega_rad_s])
    turn, clock = Rotation.from_quat(release.quaternion, scalar_first=True), 0.0
    for impact in throw.impacts[:4]:
        found = solve_ivp(rates, (0.0, 2.0), y, method="DOP853", rtol=1e-12, atol=1e-14, events=events, max_step=2e-3)
        (hit,) = [v for v in range(len(vertices)) if len(found.t_events[v])]
        t, y = found.t[-1], found.y[:, -1]
        arm, clock = arms(y, t)[hit], clock + t
        turn = Rotation.from_rotvec(t * y[6:9]) * turn
        assert impact.vertices == (hit,)
        assert impact.time_s == pytest.approx(clock, abs=tolerance)
        u = y[5] + np.cross(y[6:9], arm)[2]
        impulse = -(1.0 + chi) * u / (1.0 / die.mass_kg + (arm[0] ** 2 + arm[1] ** 2) / die.inertia_kg_m2)
        y[5] += impulse / die.mass_kg
        y[6:9] += np.cross(arm, [0.0, 0.0, impulse]) / die.inertia_kg_m2
        after = throw.flights[throw.impacts.index(impact) + 1].start
        np.testing.assert_allclose(after.position_m, y[:3], atol=tolerance)
        np.testing.assert_allclose(after.velocity_m_s, y[3:6], atol=100.0 * tolerance)
        np.testing.assert_allclose(after.omega_rad_s, y[6:9], atol=1e4 * tolerance)


@each_law
@each_drag
@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES.keys())
def test_a_throw_agrees_with_its_propagation_through_the_same_bounces(law, k, table):
    differentiable = not isinstance(law, FrictionBySpeed)
    rng, compared = np.random.default_rng(9), 0
    for die in (CUBE, ROUNDED):
        for _ in range(3 if differentiable else 0):
            release = released(rng, die, clearance_m=0.1)
            throw = throw_die(die, release, law, until=Until(impacts=4), drag_per_m=k, table=table).throw
            if any(impact.contact != "vertex" for impact in throw.impacts):
                continue  # held contact, which has no derivatives
            vertices = [impact.vertices[0] for impact in throw.impacts]
            end_s = throw.impacts[-1].time_s
            times = np.linspace(0.0, end_s, 30)
            given = propagate(die, release, law, times, vertices=vertices, table=table, parameters=(), drag_per_m=k)
            np.testing.assert_allclose(given.impact_times_s, [i.time_s for i in throw.impacts], atol=1e-9)
            np.testing.assert_allclose(throw.poses(times)[0], given.positions_m, atol=1e-9)
            np.testing.assert_allclose(rotation_between(throw.poses(times)[1], given.quaternions), 0.0, atol=1e-6)
            compared += 1
    assert compared >= 4 or not differentiable


# ---- drag that vanishes, and symmetry ---------------------------------------------------------------------------------


@each_law
@each_die
def test_drag_of_zero_is_a_throw_in_vacuum_bit_for_bit_and_little_drag_nearly(law, die):
    release = released(np.random.default_rng(3), die, clearance_m=0.05)
    vacuum, none, little = (
        throw_die(die, release, law, until=Until(impacts=5), **given)
        for given in ({}, {"drag_per_m": 0.0}, {"drag_per_m": 1e-12})
    )
    times = np.linspace(0.0, vacuum.throw.flights[-1].end_s, 50)
    for one, other in zip(none.throw.poses(times), vacuum.throw.poses(times), strict=True):
        np.testing.assert_array_equal(one, other)
    assert [i.vertices for i in little.throw.impacts] == [i.vertices for i in vacuum.throw.impacts]
    # 1e-12 per m of 10 m²/s², over 0.2 s, grown by five impacts.
    np.testing.assert_allclose(little.throw.poses(times)[0], vacuum.throw.poses(times)[0], atol=1e-9)


def test_a_throw_turned_about_the_vertical_is_the_turned_throw():
    turn, law = quat_from_rotvec([0.0, 0.0, 1.1]), CoulombImpact(0.5, 0.3)
    release = released(np.random.default_rng(4), CUBE, clearance_m=0.05)
    matrix = Rotation.from_rotvec([0.0, 0.0, 1.1]).as_matrix()
    turned = State(
        0.0,
        matrix @ release.position_m,
        quat_multiply(turn, release.quaternion),
        matrix @ release.velocity_m_s,
        matrix @ release.omega_rad_s,
    )
    until = Until(impacts=4)
    one, other = (throw_die(CUBE, s, law, until=until, drag_per_m=0.5).throw for s in (release, turned))
    times = np.linspace(0.0, one.impacts[-1].time_s, 40)
    np.testing.assert_allclose(other.poses(times)[0], one.poses(times)[0] @ matrix.T, atol=1e-9)


# ---- energy and rest -------------------------------------------------------------------------------------------------


@each_law
@each_die
@each_drag
def test_energy_never_grows_and_every_die_comes_to_rest(law, die, k):
    release = released(np.random.default_rng(11), die, clearance_m=0.05)
    result = throw_die(die, release, law, until=Until(time_s=1.5), drag_per_m=k)
    is_rough = "mu" in repr(law)
    energies = np.array([energy_J(die, state) for state in sampled(result.throw, 2 if is_rough else 5)])
    # Steps with friction add some 1e-6 in vacuum, too (`throw.held_contact`); all else is rounding.
    assert np.diff(energies).max() < (1e-5 if is_rough else 1e-12) * energies[0]
    ended = throw_die(die, release, law, drag_per_m=k)
    assert ended.ending in (Ending.RESTED, Ending.SPINNING, Ending.SPUN_LONG)
    if ended.landed_face is not None:
        assert ended.landed_face == result.landed_face


@pytest.mark.parametrize("law", [SmoothImpact(0.5), CoulombImpact(0.5, 0.3)], ids=["smooth", "rough"])
def test_a_face_that_counts_as_decided_is_the_face_of_rest(law):
    """The proof by energy, asked of throws that go on for a second after their decision."""
    rng = np.random.default_rng(13)
    for _ in range(30):
        release = released(rng, CUBE, clearance_m=0.05)
        k = 10.0 ** rng.uniform(-3, 1)
        decided = throw_die(CUBE, release, law, drag_per_m=k)
        later = throw_die(CUBE, release, law, until=Until(time_s=decided.end.time_s + 1.0), drag_per_m=k)
        assert decided.ending is Ending.RESTED
        down = later.end.rotation @ CUBE.solid.normals[decided.landed_face - 1]
        assert down[2] < -0.9
        assert later.landed_face == decided.landed_face


def test_an_ensemble_lands_as_its_throws_do_and_a_few_per_cent_land_otherwise_than_in_vacuum():
    law, rng = SmoothImpact(0.4), np.random.default_rng(15)
    releases = [released(rng, CUBE, clearance_m=0.1) for _ in range(100)]
    states = np.array([packed_state(release) for release in releases])
    faces = ThrowSetup(CUBE, law, drag_per_m=0.03).throw(states).face
    assert [throw_die(CUBE, r, law, drag_per_m=0.03).landed_face or 0 for r in releases] == faces.tolist()
    assert (faces != ThrowSetup(CUBE, law).throw(states).face).any()


# ---- on the table ----------------------------------------------------------------------------------------------------


def test_a_die_that_slides_on_a_face_without_friction_is_slowed_by_the_air_alone():
    """v = v₀/(1 + k v₀ t) and x = log(1 + k v₀ t)/k."""
    k, speed = 0.5, 2.0
    for spin in (0.0, 7.0):
        throw = throw_die(CUBE, flat(speed, 0.0, spin), SmoothImpact(0.5), until=Until(time_s=3.0), drag_per_m=k).throw
        for t in (0.5, 3.0):
            state = throw.at(t)
            assert state.position_m[0] == pytest.approx(np.log1p(k * speed * t) / k, rel=1e-9)
            assert state.velocity_m_s[0] == pytest.approx(speed / (1.0 + k * speed * t), rel=1e-9)
            assert state.omega_rad_s[2] == spin


def test_a_die_that_slides_on_a_face_with_friction_stops_where_friction_and_air_stop_it():
    """v' = -μ g - k v²: it stops after atan(v₀ √(k/(μ g)))/√(μ g k), at log(1 + k v₀²/(μ g))/(2 k)."""
    k, mu, speed = 1.0, 0.3, 1.5
    throw = throw_die(CUBE, flat(speed), CoulombImpact(0.5, mu), until=Until(time_s=1.0), drag_per_m=k).throw
    far = np.log1p(k * speed**2 / (mu * G)) / (2.0 * k)
    seconds = np.arctan(speed * np.sqrt(k / (mu * G))) / np.sqrt(mu * G * k)
    # Steps of about 1 ms, of first order in the drag.
    assert throw.at(1.0).position_m[0] == pytest.approx(far, rel=2e-3)
    assert abs(throw.at(seconds + 0.005).velocity_m_s[0]) < 1e-12
    assert throw.at(seconds - 0.005).velocity_m_s[0] > 0.0


def test_a_die_on_a_slope_slides_at_the_terminal_velocity_of_the_slope():
    """Without friction: k v² = g sin(tilt)."""
    k, tilt = 1.0, 0.1
    table = Table(tilt_rad=tilt)
    release = replace(flat(0.0), quaternion=table.world_from_table)
    up = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    release = replace(release, position_m=CUBE.solid.inradius * up)
    throw = throw_die(CUBE, release, SmoothImpact(0.5), until=Until(time_s=8.0), drag_per_m=k, table=table).throw
    velocity = throw.at(8.0).velocity_m_s
    assert np.linalg.norm(velocity) == pytest.approx(np.sqrt(G * np.sin(tilt) / k), rel=1e-6)
    assert velocity @ up == pytest.approx(0.0, abs=1e-12)


@each_drag
def test_in_held_contact_the_air_slows_the_die_and_weighs_on_its_corner(k):
    """v' = -k |v| v along the table; about the vertex, J ω' is the moment of the force m (z'' + g + k |v| z')."""
    release = replace(released(np.random.default_rng(1), CUBE), omega_rad_s=np.array([3.0, -2.0, 40.0]))
    lowest = (release.rotation @ CUBE.solid.vertices.T)[2]
    release = replace(release, position_m=np.array([0, 0, -lowest.min()]), velocity_m_s=np.array([2.0, 0.5, 0.0]))
    throw = throw_die(CUBE, release, SmoothImpact(0.0), until=Until(time_s=1.0), drag_per_m=k).throw
    checked, step = 0, 1e-5
    for flight in throw.flights:
        if (
            not isinstance(flight, HeldContact)
            or len(flight.vertices) != 1
            or flight.end_s - flight.start.time_s < 1e-3
        ):
            continue
        t = 0.5 * (flight.start.time_s + flight.end_s)
        before, at, after = (flight.at(t + d) for d in (-step, 0.0, step))
        slowing = (after.velocity_m_s - before.velocity_m_s) / (2.0 * step)
        drag = -k * np.linalg.norm(at.velocity_m_s) * at.velocity_m_s
        np.testing.assert_allclose(slowing[:2], drag[:2], rtol=1e-5, atol=1e-6)
        force = CUBE.mass_kg * (slowing - drag + np.array([0.0, 0.0, G]))
        moment = np.cross(at.rotation @ CUBE.solid.vertices[flight.vertices[0]], force)
        turning = CUBE.inertia_kg_m2 * (after.omega_rad_s - before.omega_rad_s) / (2.0 * step)
        np.testing.assert_allclose(turning, moment, atol=1e-5 * np.abs(moment).max())
        assert force[2] > 0.0
        checked += 1
    assert checked > 0


def test_a_table_throws_a_sliding_die_off_earlier_in_air():
    """It leaves where g + s'' + k |v| s' = 0 with the height s = A sin ωt, while it sinks."""
    k, speed, rate = 0.5, 3.0, 2.0 * np.pi * 25.0
    amplitude = 1.3 * G / rate**2
    table = Table(amplitude_m=amplitude, frequency_hz=25.0, phase_rad=-0.5 * np.pi)
    release = flat(speed)
    release = replace(release, position_m=release.position_m - np.array([0, 0, amplitude]))
    vacuum, air = (
        throw_die(CUBE, release, SmoothImpact(0.0), until=Until(time_s=0.03), table=table, drag_per_m=drag).throw
        for drag in (0.0, k)
    )
    leaves = [next(f.end_s for f in throw.flights if isinstance(f, HeldContact)) for throw in (vacuum, air)]
    assert np.sin(rate * leaves[0] - 0.5 * np.pi) == pytest.approx(G / (amplitude * rate**2), rel=1e-9)
    state = air.at(leaves[1] - 1e-9)
    rise = amplitude * rate * np.cos(rate * leaves[1] - 0.5 * np.pi)
    weight = G - amplitude * rate**2 * np.sin(rate * leaves[1] - 0.5 * np.pi)
    weight += k * np.hypot(state.velocity_m_s[0], rise) * rise
    assert weight == pytest.approx(0.0, abs=1e-4)
    assert air.at(leaves[1]).velocity_m_s[0] < speed


def test_a_die_rides_on_a_table_that_moves_gently_whatever_the_air():
    table = Table(amplitude_m=1e-3, frequency_hz=10.0)
    for law in (SmoothImpact(0.3), CoulombImpact(0.3, 0.5)):
        for k in (0.03, 10.0):
            assert throw_die(CUBE, flat(0.3, 0.01), law, table=table, drag_per_m=k).ending is Ending.RESTED


# ---- flights as values -----------------------------------------------------------------------------------------------


def test_the_rates_of_a_dragged_flight_are_the_derivatives_of_its_poses():
    release = released(np.random.default_rng(6), CUBE, clearance_m=0.2)
    flight = throw_die(CUBE, release, SmoothImpact(0.5), until=Until(impacts=1), drag_per_m=0.5).throw.flights[0]
    times = np.linspace(0.01, flight.end_s - 0.01, 7)
    distance = [quad(lambda t, c=c: flight.rates(np.array([t]))[0, c], times[0], times[-1])[0] for c in range(3)]
    ends = flight.poses(times[[0, -1]])[0]
    np.testing.assert_allclose(distance, ends[1] - ends[0], atol=1e-12)
    np.testing.assert_array_equal(flight.rates(times)[:, 3:], np.tile(release.omega_rad_s, (7, 1)))


def test_a_flight_is_extrapolated_before_its_start_without_an_end():
    """1/(k v) before, the speed was beyond all bounds."""
    release = replace(flat(10.0, 1.0), velocity_m_s=np.array([10.0, 0, 0]))
    flight = throw_die(CUBE, release, SmoothImpact(0.5), until=Until(impacts=0), drag_per_m=1.0).throw.flights[0]
    np.testing.assert_allclose(flight.poses([-0.01])[0][0, 0], np.log1p(-0.1), rtol=1e-3)
    assert flight.poses([-0.5])[0].shape == (1, 3)


def test_poses_long_before_the_start_leave_those_after_it_as_they_are():
    release, k = released(np.random.default_rng(6), CUBE, clearance_m=0.05), 10.0
    throw = throw_die(CUBE, release, SmoothImpact(0.5), until=Until(impacts=2), drag_per_m=k).throw
    times = np.array([-1.0, -0.5, 0.0, 0.01, throw.impacts[1].time_s])
    given = propagate(CUBE, release, SmoothImpact(0.5), times, parameters=("drag_per_m",), drag_per_m=k)
    np.testing.assert_allclose(given.positions_m[2:], throw.poses(times[2:])[0], atol=1e-10)
    assert np.isfinite(given.jacobian[2:]).all()


# ---- what is refused -------------------------------------------------------------------------------------------------


def test_drag_out_of_range_and_on_other_dice_is_refused():
    loaded: Die = replace(CUBE, centre_of_mass_m=np.array([1e-3, 0, 0]), is_homogeneous=False)
    for k in (-1.0, np.nan, 2e3):
        with pytest.raises(ValueError, match=f"drag_per_m = {k}: wanted 0 to 1000"):
            throw_die(CUBE, flat(1.0, 0.1), SmoothImpact(0.5), drag_per_m=k)
    for law in (SmoothImpact(0.5), CoulombImpact(0.5, 0.3)):
        with pytest.raises(
            ValueError, match="air drag on a die with one moment of inertia about a centre of mass beside"
        ):
            throw_die(loaded, flat(1.0, 0.1), law, drag_per_m=0.1)
        with pytest.raises(
            ValueError, match="air drag on a die with one moment of inertia about a centre of mass beside"
        ):
            ThrowSetup(loaded, law, drag_per_m=0.1).throw(packed_state(flat(1.0, 0.1))[None])


def test_the_growth_of_errors_is_not_computed_in_air():
    setup = ThrowSetup(CUBE, SmoothImpact(0.5), drag_per_m=0.1)
    for of in (error_growth, decidable_in_double_precision):
        with pytest.raises(ValueError, match=r"drag_per_m = 0\.1: growth of errors, .* in vacuum; wanted 0"):
            of(setup, flat(1.0, 0.1))
