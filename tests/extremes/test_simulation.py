"""Simulated throws at extreme sizes, masses, spins, heights, times, poses, restitutions and table frequencies."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from random_throws import DICE, exact_octahedron, random_release, turned_down
from scipy.optimize import brentq

from diethrow.model.die.die import Die, loaded_die, make_die
from diethrow.model.die.solid import isohedral_solid
from diethrow.model.laws import CoulombImpact, ImpactLaw, RestitutionBySpeed, SmoothImpact, Table
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
)
from diethrow.model.throw.held_contact import HeldContact
from diethrow.model.throw.motion import State, energy_J
from diethrow.model.throw.simulate import Ending, ThrowResult, Until, throw_die
from diethrow.model.world import GRAVITY_M_S2

G = GRAVITY_M_S2
UP = np.array([0.0, 0.0, 1.0])
LEVEL_POSE = np.array([1.0, 0.0, 0.0, 0.0])
STILL = np.zeros(3)

each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())


def heights(die: Die, states: list[State]) -> np.ndarray:
    """Heights (states, vertices) [m] of the vertices above a level table."""
    return np.array([s.position_m[2] + die.solid.vertices @ s.rotation[2] for s in states])


def clear(die: Die, release: State, clearance_m: float) -> State:
    """The release with its lowest vertex `clearance_m` above the table."""
    low = heights(die, [release])[0].min()
    return replace(release, position_m=release.position_m + (clearance_m - low) * UP)


# ---- scaling ---------------------------------------------------------------------------------------------------------


def loaded(edge_m: float, mass_kg: float) -> Die:
    place = edge_m * np.array([0.1, 0.25, -0.15])
    return loaded_die(isohedral_solid("cube", edge_m), 0.75 * mass_kg, 0.25 * mass_kg, place)


def rounded(edge_m: float, mass_kg: float) -> Die:
    return make_die("cube", edge_m, mass_kg, corner_radius_m=0.125 * edge_m)


MAKERS: dict[str, Callable[[float, float], Die]] = {
    **{shape: lambda edge, mass, shape=shape: make_die(shape, edge, mass) for shape in DICE},
    "rounded cube": rounded,
    "loaded cube": loaded,
}
TABLES = {
    "at rest": lambda s: Table(),
    "tilted": lambda s: Table(tilt_rad=0.3, downhill_rad=1.1),
    "oscillating": lambda s: Table(amplitude_m=1e-3 * s, frequency_hz=32.0 / np.sqrt(s), phase_rad=0.4),
}
LAWS: dict[str, Callable[[float, float], ImpactLaw]] = {
    "smooth": lambda chi, s: SmoothImpact(chi),
    "friction": lambda chi, s: CoulombImpact(chi, 0.3),
    "by speed": lambda chi, s: RestitutionBySpeed(SmoothImpact(chi), 0.5 * np.sqrt(s)),
}


def thrown(make, law, table, chi: float, s: float, m: float, until: Until, seed: int = 91) -> ThrowResult:
    """One throw, all its lengths times s, its times times √s and its masses times m; g stays."""
    small, root = make(0.02, 0.016), np.sqrt(s)
    one = clear(small, random_release(np.random.default_rng(seed), small, spin_rad_s=20.0), 0.05)
    tilt = TABLES[table](s).world_from_table
    release = State(
        0.25 * root,
        s * (matrix_from_quat(tilt) @ one.position_m),
        quat_multiply(tilt, one.quaternion),
        root * (matrix_from_quat(tilt) @ one.velocity_m_s),
        matrix_from_quat(tilt) @ one.omega_rad_s / root,
    )
    die = make(0.02 * s, 0.016 * m)
    return throw_die(die, release, LAWS[law](chi, s), table=TABLES[table](s), until=until)


LENGTH, MASS = 2.0**-6, 2.0**-6
"""[m] and [kg], about those of the smallest dice here; powers of two, so that they add no rounding."""


def dimensionless(result: ThrowResult, s: float, m: float) -> np.ndarray:
    """Numbers of the impacts and of the states after them, (impacts, 23): lengths in units of s/64 m, times in
    those of √s/8 s (about √(R/g) and less), masses in those of m/64 kg."""
    s, m, root = s * LENGTH, m * MASS, np.sqrt(s * LENGTH)
    rows = []
    for impact, flight in zip(result.throw.impacts, result.throw.flights[1:], strict=True):
        after = flight.start
        rows.append([
            impact.time_s / root, impact.normal_velocity_before_m_s / root, impact.normal_velocity_after_m_s / root,
            impact.energy_before_J / (m * s), impact.energy_after_J / (m * s), *impact.impulse_N_s / (m * root),
            *impact.point_m / s, *after.position_m / s, *after.quaternion, *after.velocity_m_s / root,
            *after.omega_rad_s * root,
        ])  # fmt: skip
    return np.array(rows)


def discrete_results(result: ThrowResult) -> tuple:
    """The dimensionless results."""
    return result.ending, result.landed_face, [(i.contact, i.vertices) for i in result.throw.impacts]


def possible(law: str, make: str) -> bool:
    return law == "smooth" or make != "loaded cube"


CASES = [(m, law, t) for m in MAKERS for law in LAWS for t in TABLES if possible(law, m)]


@pytest.mark.parametrize(("make", "law", "table"), CASES)
@pytest.mark.parametrize("chi", [0.1, 0.5, 0.9])
def test_a_throw_in_millimetres_is_the_throw_in_metres(make, law, table, chi):
    """Every event up to the third impact: later ones would only show how chaos multiplies the rounding of √1000. The
    attitude of a loaded die is integrated, to 1e-12, rather than known in closed form: two impacts of it."""
    until = Until(impacts=2 if make == "loaded cube" else 3)
    one = thrown(MAKERS[make], law, table, chi, 1.0, 1.0, until)
    expected = dimensionless(one, 1.0, 1.0)
    for s in (1e-3, 1e3):
        other = thrown(MAKERS[make], law, table, chi, s, s**3, until)
        assert discrete_results(other) == discrete_results(one)
        np.testing.assert_allclose(dimensionless(other, s, s**3), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_powers_of_two_scale_a_whole_throw_bit_for_bit(make, law, chi):
    """A length, time or mass that is fixed anywhere in the model would break the equality."""
    if not possible(law, make):
        return
    one = thrown(MAKERS[make], law, "at rest", chi, 1.0, 1.0, Until())
    expected = dimensionless(one, 1.0, 1.0)
    for s, m in ((4.0**5, 2.0**30), (4.0**-5, 2.0**-40), (1.0, 2.0**20)):
        other = thrown(MAKERS[make], law, "at rest", chi, s, m, Until())
        assert discrete_results(other) == discrete_results(one)
        np.testing.assert_array_equal(dimensionless(other, s, m), expected)


@pytest.mark.parametrize("mass", [1e-9, 1e3])
@pytest.mark.parametrize(("make", "law"), [(m, law) for m in MAKERS for law in LAWS if possible(law, m)])
def test_a_mass_scales_impulses_and_energies_and_nothing_else(make, law, mass):
    one = thrown(MAKERS[make], law, "at rest", 0.5, 1.0, 1.0, Until(impacts=4))
    m = mass / 0.016
    other = thrown(MAKERS[make], law, "at rest", 0.5, 1.0, m, Until(impacts=4))
    assert discrete_results(other) == discrete_results(one)
    # Four impacts multiply the rounding of the inertia.
    np.testing.assert_allclose(dimensionless(other, 1.0, m), dimensionless(one, 1.0, 1.0), rtol=1e-9, atol=1e-9)


# ---- falls and bounces with a closed form ----------------------------------------------------------------------------


@pytest.mark.parametrize("edge", [1e-4, 0.02, 10.0])
@pytest.mark.parametrize("drop", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize("shape", DICE)
def test_a_die_without_spin_falls_for_the_root_of_two_heights_over_g(shape, drop, edge):
    die = make_die(shape, edge, 1e-9)
    release = replace(random_release(np.random.default_rng(92), die), velocity_m_s=STILL, omega_rad_s=STILL, time_s=0.0)
    release = clear(die, release, drop)
    first = throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=1)).throw.impacts[0]
    # The height is rounded to 4e-15 of its terms, the centre's and the vertex's.
    known = 4e-15 * (drop + 2 * die.solid.circumradius) / drop
    assert first.time_s == pytest.approx(np.sqrt(2 * drop / G), rel=known)
    assert first.normal_velocity_before_m_s == pytest.approx(-np.sqrt(2 * G * drop), rel=known)
    assert first.normal_velocity_after_m_s == pytest.approx(np.sqrt(2 * G * drop) / 2, rel=known)


@pytest.mark.parametrize(("edge", "mass"), [(1e-4, 1e-9), (0.02, 0.016), (10.0, 1e3)])
@pytest.mark.parametrize("drop", [0.05, 1e3])
@pytest.mark.parametrize("chi", [0.5, 1.0])
def test_a_die_on_its_tip_bounces_like_a_ball(edge, mass, drop, chi):
    die = exact_octahedron(edge, mass)
    release = State(0.0, np.array([0, 0, die.solid.circumradius + drop]), LEVEL_POSE, STILL, STILL)
    throw = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=12)).throw
    fall = np.sqrt(2 * drop / G)
    times = fall * (1 + 2 * np.cumsum([0.0, *chi ** np.arange(1.0, 12.0)]))
    # Of the drop 1e-15 (drop + 2 R) is rounding, and as much after each of twelve impacts.
    rounding = 1e-14 * (1 + die.solid.circumradius / drop)
    np.testing.assert_allclose([i.time_s for i in throw.impacts], times, rtol=rounding)
    speeds = chi ** np.arange(1, 13) * G * fall
    np.testing.assert_allclose([i.normal_velocity_after_m_s for i in throw.impacts], speeds, rtol=12 * rounding * 2**12)
    impulses = [i.impulse_N_s[2] for i in throw.impacts]
    np.testing.assert_allclose(impulses, mass * (1 + 1 / chi) * speeds, rtol=12 * rounding * 2**12)


def on(die: Die, what: str, velocity_m_s: float) -> tuple[State, tuple[int, ...]]:
    """A die that touches with a vertex, an edge or a face exactly down, and its vertices there."""
    solid = die.solid
    down = {
        "vertex": solid.vertices[0],
        "edge": solid.vertices[solid.edges[0]].sum(0),
        "face": solid.normals[0],
    }[what]
    state = State(0.7, STILL, turned_down(down), np.array([0.0, 0.0, velocity_m_s]), STILL)
    state = clear(die, state, 0.0)
    corners = {"vertex": (0,), "edge": tuple(solid.edges[0]), "face": tuple(solid.faces[0])}
    return state, corners[what]


@each_die
@pytest.mark.parametrize("what", ["vertex", "edge", "face"])
@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
def test_a_die_released_on_the_table_strikes_at_once_with_the_impulse_of_all_that_touches(die, what, chi):
    release, corners = on(die, what, -0.8)
    result = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=1))
    impact = result.throw.impacts[0]
    # Two vertices that are level but for 1e-17 m, and a fall at 0.8 m/s.
    assert impact.time_s == pytest.approx(0.7, abs=1e-15)
    assert set(impact.vertices) == set(corners)
    # Below the centre, or about the point below it, so that the die does not turn.
    assert impact.impulse_N_s[2] == pytest.approx((1 + chi) * 0.8 * die.mass_kg, rel=1e-13)
    assert impact.normal_velocity_after_m_s == pytest.approx(0.8 * chi, abs=1e-14)


@each_die
@pytest.mark.parametrize(
    ("what", "speed"), [("vertex", 0.0), ("vertex", -0.3), ("edge", -0.3), ("face", 0.0), ("face", -0.3)]
)
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_a_die_released_on_the_table_rests_or_balances(die, what, chi, speed):
    release, _ = on(die, what, speed)
    result = throw_die(die, release, SmoothImpact(chi))
    assert result.ending in ((Ending.RESTED,) if what == "face" else (Ending.RESTED, Ending.BALANCED))
    if what == "face" and speed == 0.0:
        assert (result.landed_face, result.impact_count) == (1, 0)
    ends = [energy_J(die, f.at(t)) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
    assert np.diff(ends).max() <= 1e-10 * ends[0]


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("tilt", [0.0, 1e-17, 1e-15, 1e-13])
def test_all_vertices_of_a_face_within_a_femtosecond(die, chi, tilt):
    """They strike at once, each where it is: no energy is made, nothing goes below the table, and a fall of a micrometre
    does not turn the die over."""
    turn = quat_multiply(quat_from_rotvec([tilt, 0.3 * tilt, 0.2]), turned_down(die.solid.normals[0]))
    drop = 1e-6
    release = clear(die, State(0.0, STILL, turn, STILL, STILL), drop)
    until = Until(impacts=50) if chi == 1.0 else Until()
    result = throw_die(die, release, SmoothImpact(chi), until=until)
    assert result.landed_face == 1
    assert (result.ending is Ending.RESTED) == (chi < 1.0)
    first = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=1)).throw.bounces[0]
    assert set(first.vertices) == set(die.solid.faces[0])
    # They fall at 4 mm/s: 1e-15 s is 4e-18 m, and heights are known to 1e-17 m.
    assert first.time_s == pytest.approx(np.sqrt(2 * drop / G), abs=1e-14 + 10 * tilt * 0.02 / 4e-3)
    states = [f.at(t) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
    assert heights(die, states).min() > -1e-10 * die.solid.circumradius
    energies = np.array([energy_J(die, s) for s in states])
    assert np.diff(energies).max() < 1e-14 * energies[0]
    if chi == 1.0:
        np.testing.assert_allclose(energies, energies[0], rtol=1e-13)


# ---- spins -----------------------------------------------------------------------------------------------------------


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_a_spin_of_a_picoradian_a_second_acts_as_no_spin(die, chi):
    release = replace(random_release(np.random.default_rng(93), die, clearance_m=0.02), omega_rad_s=STILL)
    slow = replace(release, omega_rad_s=np.array([0.6e-12, 0.0, 0.8e-12]))
    histories = [throw_die(die, r, SmoothImpact(chi), until=Until(impacts=2)) for r in (release, slow)]
    assert discrete_results(histories[0]) == discrete_results(histories[1])
    still, turning = (dimensionless(r, 1.0, 1.0) for r in histories)
    # It turns the die by 6e-14 and changes ω by 1e-12, which two impacts grow by some ten each.
    np.testing.assert_allclose(turning, still, atol=3e-10)
    whole = [throw_die(die, r, SmoothImpact(chi)) for r in (release, slow)]
    assert all(r.ending is Ending.RESTED for r in whole)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
def test_no_touch_is_missed_at_ten_thousand_radians_a_second(die, chi):
    """1600 turns a second. No sample of its fall, 300 a turn, lies below the table, and the touch is a touch."""
    for seed in range(3):
        release = random_release(np.random.default_rng(94 + seed), die, spin_rad_s=1e4, clearance_m=0.05)
        throw = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=1)).throw
        impact, flight = throw.impacts[0], throw.flights[0]
        duration = flight.end_s - flight.start.time_s
        times = np.linspace(flight.start.time_s, flight.end_s, int(duration * 1e4 / 2 / np.pi * 300))
        positions, quaternions = flight.poses(times)
        above = positions[:, 2, None] + matrix_from_quat(quaternions)[:, 2] @ die.solid.vertices.T
        # 16 ε of R ω t = 30 m, and an instant on a clock of 1 s, known to 2e-16 s, at 170 m/s.
        limit = 16 * 2.3e-16 * die.solid.circumradius * (1 + 1e4 * duration) + 1e-13
        assert above.min() > -limit
        assert abs(above[-1, impact.vertices[0]]) < limit
        assert impact.normal_velocity_before_m_s < 0
        assert impact.normal_velocity_after_m_s == pytest.approx(-chi * impact.normal_velocity_before_m_s, abs=1e-12)


def test_a_cube_that_falls_flat_at_ten_thousand_radians_a_second_turns_by_omega_t_and_stays_flat():
    die, drop, spin = DICE["cube"], 0.3, 1e4
    release = State(0.0, np.array([0, 0, die.solid.inradius + drop]), LEVEL_POSE, STILL, spin * UP)
    result = throw_die(die, release, SmoothImpact(0.0))
    touch = result.throw.impacts[0]
    assert touch.time_s == pytest.approx(np.sqrt(2 * drop / G), rel=1e-15)
    turned = result.throw.flights[0].at(touch.time_s).rotation
    # 2473 rad, known to 5e-13.
    angle = np.remainder(spin * np.sqrt(2 * drop / G), 2 * np.pi)
    np.testing.assert_allclose(turned[0, :2], [np.cos(angle), -np.sin(angle)], atol=2e-12)
    assert result.ending is Ending.RESTED
    np.testing.assert_array_equal(result.end.omega_rad_s[2], spin)


@each_die
def test_an_elastic_die_keeps_its_energy_at_every_size_mass_spin_and_height(die):
    rng = np.random.default_rng(95)
    shape = die.solid.name
    for edge, mass in ((1e-4, 1e-9), (0.02, 0.016), (10.0, 1e3)):
        for spin in (0.0, 1e-12, 1e4):
            for drop in (edge, 1e3):
                made = make_die(shape, edge, mass)
                release = random_release(rng, made, spin_rad_s=spin, clearance_m=drop)
                end = throw_die(made, release, SmoothImpact(1.0), until=Until(impacts=100)).end
                # 2e-16 an impact, and at 10 m and 1e4 rad/s the instants, known to 1e-16 of 1e4 s.
                assert energy_J(made, end) == pytest.approx(energy_J(made, release), rel=1e-12)


# ---- grazing ---------------------------------------------------------------------------------------------------------


def grazing(die: Die, depth_m: float, spin_rad_s: float = 150.0) -> tuple[State, float]:
    """A die whose vertex 0 would reach its lowest point, at -depth, straight below the centre; and when.

    There its height is R (1 - cos ωs) - g s²/2 - depth, and it turns up because ω² R > g.
    """
    before = 0.2 / spin_rad_s
    omega = np.array([spin_rad_s, 0.0, 0.0])
    turn = quat_multiply(quat_from_rotvec(-before * omega), turned_down(die.solid.vertices[0]))
    position = np.array([0.0, 0.0, die.solid.circumradius - depth_m - 0.5 * G * before**2])
    return State(0.0, position, turn, np.array([0.0, 0.0, G * before]), omega), before


@each_die
@pytest.mark.parametrize("depth", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
def test_a_grazing_vertex_strikes_with_the_velocity_that_its_depth_gives_it(die, depth, chi):
    release, lowest = grazing(die, depth)
    radius, spin = die.solid.circumradius, 150.0

    def height(s):
        return 2 * radius * np.sin(0.5 * spin * s) ** 2 - 0.5 * G * s * s - depth

    sinks = brentq(height, -1.0 / spin, 0.0, xtol=1e-18, rtol=1e-14)
    velocity = radius * spin * np.sin(spin * sinks) - G * sinks
    result = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=1))
    impact = result.throw.impacts[0]
    # The height is known to 16 ε R (1 + 0.2) = 7e-17 m: a part 7e-17/(2 depth) of the velocity.
    known = 1e-10 + 2e-16 / depth
    # And velocities are differences of ω R = 4 m/s.
    assert impact.vertices == (0,)
    assert impact.time_s - lowest == pytest.approx(sinks, rel=known, abs=1e-17)
    assert impact.normal_velocity_before_m_s == pytest.approx(velocity, rel=known)
    assert impact.normal_velocity_after_m_s == pytest.approx(-chi * velocity, rel=known, abs=3e-15)


@each_die
@pytest.mark.parametrize("depth", [-1e-12, -1e-15, 0.0, 1e-17])
def test_a_vertex_that_passes_the_table_by_less_than_rounding_changes_little(die, depth):
    """A touch at 1e-17 m below would have 4e-8 m/s: whether it happens is rounding, what follows is the same to that."""
    release, lowest = grazing(die, depth)
    for law in (SmoothImpact(0.0), SmoothImpact(1.0), CoulombImpact(0.5, 0.3)):
        throw = throw_die(die, release, law, until=Until(time_s=2 * lowest)).throw
        if depth < -1e-14:
            assert not throw.impacts
        assert not [f for f in throw.flights if isinstance(f, HeldContact) and f.end_s - f.start.time_s > 1e-6]
        end, free = throw.at(2 * lowest), replace(throw.flights[0], end_s=np.inf).at(2 * lowest)
        np.testing.assert_allclose(end.velocity_m_s, free.velocity_m_s, atol=1e-6)
        np.testing.assert_allclose(end.omega_rad_s, free.omega_rad_s, atol=1e-6 / die.solid.circumradius * 10)


# ---- poles of the Euler angles ---------------------------------------------------------------------------------------


@each_die
@pytest.mark.parametrize("omega", [(0.0, 0.0, 0.0), (0.0, 60.0, 0.0)])
def test_at_the_poles_of_the_euler_angles_only_the_sum_or_difference_of_the_other_two_counts(die, omega):
    def throw(psi, theta, phi):
        quaternion = quat_from_euler([psi, theta, phi])
        state = State(0.0, np.array([0.0, 0.0, 0.3]), quaternion, np.array([0.6, 0.0, -0.7]), np.array(omega))
        return throw_die(die, state, SmoothImpact(0.5), until=Until(impacts=3))

    for theta, sign in ((0.0, 1), (np.pi, -1)):
        one, two = throw(0.7, theta, 0.4), throw(0.7 + sign * 0.4, theta, 0.0)
        if any(omega):
            assert discrete_results(one) == discrete_results(two)
            # Rounding of 1e-16, grown by three impacts.
            np.testing.assert_allclose(quat_free(one), quat_free(two), atol=1e-9)
        else:
            # Flat: which vertex of a face strikes first is rounding; when it does and how hard is not.
            assert one.throw.impacts[0].time_s == pytest.approx(two.throw.impacts[0].time_s, abs=1e-15)
        near = throw(0.7, theta + 1e-12, 0.4)
        assert near.throw.impacts[0].time_s == pytest.approx(one.throw.impacts[0].time_s, abs=1e-12)


def quat_free(result: ThrowResult) -> np.ndarray:
    """The history, with quaternions of one sign: q and -q are the same pose."""
    rows = dimensionless(result, 1.0, 1.0)
    rows[:, 13:17] *= np.sign(rows[:, 13:17][np.arange(len(rows)), np.abs(rows[:, 13:17]).argmax(1)])[:, None]
    return rows


@pytest.mark.parametrize("chi", [0.0, 0.5])
@pytest.mark.parametrize("theta", [0.0, 1e-5, np.pi - 1e-5, np.pi])
def test_the_papers_nearly_flat_release_without_spin_rests_on_its_lowest_face(theta, chi):
    """Its angle of 1e-5, and the poles themselves: a cube that is dropped flat from 1 mm does not turn over."""
    die = DICE["cube"]
    turn = quat_from_euler([0.001, theta, 0.0001])
    release = clear(die, State(0.0, STILL, turn, np.array([0.6, 0.0, 0.0]), STILL), 1e-3)
    result = throw_die(die, release, SmoothImpact(chi))
    lowest = int(np.argmin(die.solid.normals @ matrix_from_quat(turn)[2])) + 1
    assert (result.ending, result.landed_face) == (Ending.RESTED, lowest)


# ---- long flights and high drops -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("edge", "fall", "up"), [(1e-4, 50.0, 0.0), (0.02, 1.0, 9.81e6 / 2)])
def test_a_long_flight_is_not_mistaken_for_a_spinning_die(edge, fall, up):
    """Grains of 0.1 mm dropped from 50 m, and a cube that flies for a million seconds, still strike the table."""
    omega = np.array([0.0, 0.3, 0.1])
    release = State(0.0, np.array([0, 0, fall]), LEVEL_POSE, np.array([0, 0, up]), omega)
    die = make_die("cube", edge, 1e-9)
    result = throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=3))
    assert (result.ending, result.impact_count) == (Ending.IMPACTS_REACHED, 3)
    assert throw_die(die, release, SmoothImpact(0.0)).ending is not Ending.SPUN_LONG


@each_die
def test_a_flight_of_a_million_seconds_follows_its_parabola_and_its_rotation_to_the_end(die):
    up, spin = 9.81e6 / 2, 0.3
    quaternion = turned_down(die.solid.normals[0])
    state = State(0.0, STILL, quaternion, np.array([0.0, 0.0, up]), spin * UP)
    release = clear(die, state, 1.0)
    throw = throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=1)).throw
    duration = (up + np.sqrt(up**2 + 2 * G)) / G
    # 16 ε of heights that pass through 5e12 m, at 5e6 m/s: a few ns in 1e6 s.
    assert throw.impacts[0].time_s == pytest.approx(duration, rel=1e-14)
    assert throw.impacts[0].normal_velocity_before_m_s == pytest.approx(-np.sqrt(up**2 + 2 * G), rel=1e-14)
    # 3e5 rad, known to 1e-10.
    turned = matrix_from_quat(throw.flights[0].at(duration).quaternion)
    angle = np.remainder(spin * duration, 2 * np.pi)
    expected = matrix_from_quat(quat_multiply(quat_from_rotvec(angle * UP), quaternion))
    np.testing.assert_allclose(turned, expected, atol=1e-9)


@each_die
def test_a_die_at_rest_stays_on_its_face_for_a_million_seconds_and_drifts_without_friction(die):
    release = random_release(np.random.default_rng(96), die, spin_rad_s=5.0, clearance_m=0.01)
    result = throw_die(die, release, SmoothImpact(0.3), until=Until(time_s=1e6))
    end = result.end
    assert (result.ending, end.time_s) == (Ending.TIME_REACHED, 1e6)
    face = throw_die(die, release, SmoothImpact(0.3)).landed_face
    assert result.landed_face == face
    assert end.position_m[2] == pytest.approx(die.solid.inradius, rel=1e-9)
    np.testing.assert_allclose(end.rotation @ die.solid.normals[face - 1], -UP, atol=1e-9)
    drift = release.position_m[:2] + release.velocity_m_s[:2] * (1e6 - release.time_s)
    np.testing.assert_allclose(end.position_m[:2], drift, rtol=1e-9)


@each_die
@pytest.mark.parametrize("law", [SmoothImpact(0.0), SmoothImpact(0.5), CoulombImpact(0.5, 0.3)], ids=str)
def test_a_die_dropped_from_a_kilometre_with_spin_lands_with_the_energy_of_its_fall_and_comes_to_rest(die, law):
    release = random_release(np.random.default_rng(97), die, spin_rad_s=10.0, clearance_m=1e3)
    result = throw_die(die, release, law)
    assert result.ending in (Ending.RESTED, Ending.SPINNING, Ending.SPUN_LONG)
    first, start = result.throw.impacts[0], energy_J(die, release)
    assert first.energy_before_J == pytest.approx(start, rel=1e-14)
    before = result.throw.flights[0].at(first.time_s)
    # A clock of 14 s is known to 2e-15 s, at 140 m/s.
    assert abs(heights(die, [before])[0].min()) < 1e-12


# ---- tables ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("chi", [0.2, 0.5, 0.8])
def test_a_die_on_its_tip_bounces_in_step_with_a_table_of_ten_thousand_hertz(chi):
    """Twenty periods T a bounce: A ω cos p = (1 - χ)/(1 + χ) g · 20 T/2 at the phase p of every impact."""
    die, rate, period = exact_octahedron(), 2e4 * np.pi, 20e-4
    needed = (1 - chi) / (1 + chi) * G * period / 2
    amplitude, phase = 1.2 * needed / rate, np.arccos(1 / 1.2)
    table = Table(amplitude_m=amplitude, frequency_hz=1e4, phase_rad=phase)
    position = np.array([0, 0, amplitude * np.sin(phase) + die.solid.circumradius])
    release = State(0.0, position, LEVEL_POSE, np.array([0, 0, G * period / 2]), STILL)
    impacts = throw_die(die, release, SmoothImpact(chi), until=Until(impacts=3), table=table).throw.impacts
    assert {i.vertices for i in impacts} == {(5,)}
    # The orbit of such long hops is unstable: an error of 1e-15 s grows by A ω² T/g, up to 600 a bounce.
    np.testing.assert_allclose([i.time_s for i in impacts], period * np.arange(1, 4), rtol=1e-6)
    assert impacts[0].time_s == pytest.approx(period, rel=1e-11)
    assert impacts[0].normal_velocity_before_m_s == pytest.approx(-G * period / (1 + chi), rel=1e-9)


@pytest.mark.parametrize("make", MAKERS)
def test_ten_thousand_hertz_without_amplitude_is_a_table_at_rest_bit_for_bit(make):
    die = MAKERS[make](0.02, 0.016)
    release = clear(die, random_release(np.random.default_rng(98), die), 0.05)
    tables = (Table(), Table(amplitude_m=0.0, frequency_hz=1e4, phase_rad=1.0))
    one, two = (throw_die(die, release, SmoothImpact(0.5), table=t) for t in tables)
    assert discrete_results(one) == discrete_results(two)
    np.testing.assert_array_equal(dimensionless(one, 1.0, 1.0), dimensionless(two, 1.0, 1.0))


@pytest.mark.parametrize("make", MAKERS)
def test_an_amplitude_of_a_femtometre_is_a_table_at_rest(make):
    """1e-15 m at 1e4 Hz, 6e-11 m/s, 4e-6 of g: two impacts see 1e-10 of it."""
    die = MAKERS[make](0.02, 0.016)
    release = clear(die, random_release(np.random.default_rng(98), die), 0.05)
    tables = (Table(), Table(amplitude_m=1e-15, frequency_hz=1e4))
    one, two = (throw_die(die, release, SmoothImpact(0.5), until=Until(impacts=2), table=t) for t in tables)
    assert discrete_results(one) == discrete_results(two)
    rows = [np.delete(dimensionless(r, 1.0, 1.0), 2, axis=1) for r in (one, two)]
    np.testing.assert_allclose(*rows, atol=1e-7)


# ---- loaded and rounded dice, friction -------------------------------------------------------------


OTHERS = {
    "rounded": lambda edge, mass: (rounded(edge, mass), SmoothImpact),
    "loaded": lambda edge, mass: (loaded(edge, mass), SmoothImpact),
    "with friction": lambda edge, mass: (make_die("cube", edge, mass), lambda chi: CoulombImpact(chi, 0.3)),
    "rounded, with friction": lambda edge, mass: (rounded(edge, mass), lambda chi: CoulombImpact(chi, 0.3)),
}
each_other = pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS.keys())


@each_other
@pytest.mark.parametrize(("edge", "mass"), [(1e-4, 1e-9), (0.02, 0.016), (10.0, 1e3)])
@pytest.mark.parametrize("chi", [0.0, 0.5, 0.9])
def test_every_throw_ends_at_every_size_and_never_gains_energy(other, edge, mass, chi):
    die, law = other(edge, mass)
    spin = 5.0 / np.sqrt(edge)
    release = random_release(np.random.default_rng(99), die, spin_rad_s=spin, clearance_m=2 * edge)
    release = replace(release, velocity_m_s=np.sqrt(edge / 0.02) * release.velocity_m_s)
    result = throw_die(die, release, law(chi))
    assert result.ending in (Ending.RESTED, Ending.SPINNING, Ending.SPUN_LONG)
    ends = [energy_J(die, f.at(t)) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
    # Held contact with friction is integrated by steps of low order.
    assert np.diff(ends).max() <= (1e-6 if isinstance(law(chi), CoulombImpact) else 1e-10) * ends[0]


@each_other
@pytest.mark.parametrize("spin", [0.0, 1e-12, 1e4])
@pytest.mark.parametrize("chi", [0.0, 1.0])
def test_every_die_obeys_its_impact_law_at_every_spin(other, spin, chi):
    die, law = other(0.02, 0.016)
    release = clear(die, random_release(np.random.default_rng(100), die, spin_rad_s=spin), 0.02)
    # A loaded die at 1e4 rad/s takes ten thousand steps for a second of flight.
    impacts = throw_die(die, release, law(chi), until=Until(impacts=1 if spin > 1.0 else 5)).throw.bounces
    for impact in impacts:
        u, v = impact.normal_velocity_before_m_s, impact.normal_velocity_after_m_s
        if isinstance(law(chi), SmoothImpact):
            assert v == pytest.approx(-chi * u, abs=1e-12 * (1 + abs(u)))
            assert impact.energy_after_J == pytest.approx(impact.energy_before_J, rel=1e-13) or chi < 1
        # Friction only removes energy; 1e-13 of it is rounding.
        assert impact.energy_after_J <= impact.energy_before_J * (1 + 1e-13)
        assert v >= -1e-12 * abs(u)


@each_other
def test_every_die_falls_a_kilometre_in_the_root_of_two_heights_over_g(other):
    die, law = other(0.02, 0.016)
    quaternion = turned_down(die.solid.normals[2])
    arm = np.zeros(3) if die.centre_of_mass_m is None else matrix_from_quat(quaternion) @ die.centre_of_mass_m
    position = np.array([0.0, 0.0, die.solid.inradius + 1e3])
    first = throw_die(die, State(0.0, position, quaternion, STILL, STILL), law(0.5), until=Until(impacts=1)).throw
    assert first.impacts[0].time_s == pytest.approx(np.sqrt(2e3 / G), rel=2e-15)
    touching = first.flights[0].at(first.impacts[0].time_s)
    np.testing.assert_allclose(touching.quaternion, quaternion, atol=1e-15)
    assert first.impacts[0].energy_before_J == pytest.approx(die.mass_kg * G * (position[2] + arm[2]), rel=1e-14)


@each_other
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_every_die_laid_on_a_face_stays_on_it(other, chi):
    die, law = other(0.02, 0.016)
    for face, normal in enumerate(die.solid.normals):
        position = np.array([0.0, 0.0, die.solid.inradius])
        result = throw_die(die, State(0.0, position, turned_down(normal), STILL, STILL), law(chi))
        assert (result.ending, result.landed_face, result.impact_count) == (Ending.RESTED, face + 1, 0)


@pytest.mark.parametrize("chi", [0.0, 0.5, 1.0])
def test_boundless_friction_sticks_and_vanishing_friction_is_the_smooth_impact(chi):
    die = DICE["cube"]
    release = random_release(np.random.default_rng(102), die, clearance_m=0.02)
    until = Until(impacts=2)
    smooth, faint = (
        throw_die(die, release, law, until=until) for law in (SmoothImpact(chi), CoulombImpact(chi, 1e-300))
    )
    np.testing.assert_allclose(dimensionless(faint, 1.0, 1.0), dimensionless(smooth, 1.0, 1.0), atol=1e-11)
    for mu in (1e6, 1e300):
        throw = throw_die(die, release, CoulombImpact(chi, mu), until=Until(impacts=1)).throw
        after = throw.flights[1].start
        arm = after.rotation @ die.solid.vertices[throw.impacts[0].vertices[0]]
        slip = (after.velocity_m_s + np.cross(after.omega_rad_s, arm))[:2]
        np.testing.assert_allclose(slip, 0.0, atol=1e-12)


@each_die
@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.1, 2.0])
def test_a_die_at_rest_on_an_edge_to_rounding_rests_or_balances(die, yaw):
    for edge in die.solid.edges:
        turn = quat_multiply(quat_from_rotvec(yaw * UP), turned_down(die.solid.vertices[edge].sum(0)))
        release = clear(die, State(0.0, STILL, turn, STILL, STILL), 0.0)
        assert throw_die(die, release, SmoothImpact(0.0)).ending in (Ending.RESTED, Ending.BALANCED)
