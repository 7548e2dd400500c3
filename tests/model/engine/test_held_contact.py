"""Held contact: motion on a vertex, an edge and a face against other formulations; chatter against its series; endings."""

from dataclasses import replace

import numpy as np
import pytest
from random_throws import DICE, exact_octahedron, random_quaternion, random_release, turned_down
from scipy.integrate import quad, solve_ivp

from diethrow.model import engine
from diethrow.model.die.die import Die, die_from_solid
from diethrow.model.die.solid import convex_solid
from diethrow.model.ensembles.landings import ENDING_OF_INDEX, Landings, ThrowSetup
from diethrow.model.laws import CoulombImpact, SmoothImpact, Table
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from diethrow.model.throw.held_contact import HeldContact
from diethrow.model.throw.motion import State, energy_J, rotated_state
from diethrow.model.throw.simulate import EXACT, Ending, Precision, Until, throw_die
from diethrow.model.world import GRAVITY_M_S2

G = GRAVITY_M_S2
UP = np.array([0.0, 0.0, 1.0])

each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())


def on_vertex(die, vertex: int, tilt_rad: float, omega) -> State:
    """A die on one vertex at rest vertically, the line to the centre tilted by an angle, with a horizontal velocity."""
    quaternion, omega = turned_down(die.solid.vertices[vertex], tilt_rad), np.asarray(omega, float)
    arm = matrix_from_quat(quaternion) @ die.solid.vertices[vertex]
    rise = -np.cross(omega, arm)[2]
    return State(0.0, np.array([0.0, 0.0, -arm[2]]), quaternion, np.array([0.3, -0.2, rise]), omega)


def on_edge(die, tilt_rad: float, omega_z: float) -> State:
    """A die on its first edge, tilted about it by an angle from balance, turning about z only."""
    a, b = die.solid.vertices[die.solid.edges[0]]
    middle, along = a + b, (b - a) / np.linalg.norm(b - a)
    down = middle / np.linalg.norm(middle)
    upright = quat_from_matrix([along, np.cross(-down, along), -down])
    quaternion = quat_multiply(quat_from_rotvec([tilt_rad, 0.0, 0.0]), upright)
    height = -(matrix_from_quat(quaternion) @ a)[2]
    return State(0.0, np.array([0, 0, height]), quaternion, np.zeros(3), np.array([0.0, 0.0, omega_z]))


def held_contacts(result) -> list[HeldContact]:
    return [flight for flight in result.throw.flights if isinstance(flight, HeldContact)]


def lagrange_top(die, start: State, vertex: int, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights (n,) of the centre and rotations (n, 3, 3) of a die on a vertex of a smooth table, by Euler angles.

    R = Rz(φ) Ry(ϑ) Rz(ψ) R₀ with ϑ the angle of the line from the vertex to the centre (l long) from the vertical; its
    spin n = ω·e and ω_z are conserved, so φ' = (ω_z - n cos ϑ)/sin² ϑ, ψ' = n - φ' cos ϑ, and
    (J + m l² sin² ϑ) ϑ'' = m g l sin ϑ - m l² ϑ'² sin ϑ cos ϑ + J φ' sin ϑ (φ' cos ϑ - n).
    """
    m, inertia, tip = die.mass_kg, die.inertia_kg_m2, start.rotation @ die.solid.vertices[vertex]
    length = np.linalg.norm(tip)
    e = -tip / length
    theta, phi = np.arccos(e[2]), np.arctan2(e[1], e[0])
    node = np.array([-np.sin(phi), np.cos(phi), 0.0])
    n, omega_z, theta_dot = start.omega_rad_s @ e, start.omega_rad_s[2], start.omega_rad_s @ node

    def rates(_, y):
        s, c = np.sin(y[0]), np.cos(y[0])
        phi_dot = (omega_z - n * c) / s**2
        push = m * G * length * s - m * length**2 * y[1] ** 2 * s * c + inertia * phi_dot * s * (phi_dot * c - n)
        return [y[1], push / (inertia + m * length**2 * s**2), phi_dot, n - phi_dot * c]

    way = solve_ivp(rates, (0, times[-1]), [theta, theta_dot, phi, 0.0], "DOP853", times, rtol=1e-13, atol=1e-14).y
    turned = [_euler(p, t, s) @ _euler(phi, theta, 0.0).T @ start.rotation for t, _, p, s in way.T]
    return length * np.cos(way[0]), np.array(turned)


def _euler(phi: float, theta: float, psi: float) -> np.ndarray:
    return matrix_from_quat(
        quat_multiply(
            quat_from_rotvec(phi * UP), quat_multiply(quat_from_rotvec([0.0, theta, 0.0]), quat_from_rotvec(psi * UP))
        )
    )


VERTEX_MOTIONS = [
    ("tetrahedron", 0.3, (0.0, 0.0, 0.0)),
    ("tetrahedron", 0.2, (3.0, 2.0, 150.0)),
    ("cube", 0.1, (0.0, 1.0, -80.0)),
    ("octahedron", 0.05, (20.0, 0.0, 300.0)),
    ("dodecahedron", 0.02, (1.0, -1.0, 400.0)),
    ("icosahedron", 0.03, (-5.0, 8.0, -600.0)),
]


@pytest.mark.parametrize(("shape", "tilt", "omega"), VERTEX_MOTIONS)
def test_a_die_on_a_vertex_moves_as_lagranges_top_on_a_smooth_table(shape, tilt, omega):
    die = DICE[shape]
    start = on_vertex(die, 0, tilt, omega)
    held = throw_die(die, start, SmoothImpact(0.0), until=Until(time_s=0.3)).throw.flights[1]
    assert held.vertices == (0,)
    times = np.linspace(0.0, held.end_s, 60)
    heights, rotations = lagrange_top(die, start, 0, times)
    positions, quaternions = held.poses(times)
    # The step of 0.3 rad makes 1e-11 a step in a method of order 8; up to 500 steps, and gravity's own growth.
    np.testing.assert_allclose(positions[:, 2], heights, atol=1e-9 * die.solid.circumradius)
    np.testing.assert_allclose(matrix_from_quat(quaternions), rotations, atol=1e-8)
    np.testing.assert_allclose(positions[:, :2], np.outer(times, [0.3, -0.2]), atol=1e-15)


@pytest.mark.parametrize(("shape", "tilt", "omega"), VERTEX_MOTIONS)
def test_a_die_on_a_vertex_keeps_its_energy_its_vertical_spin_and_the_spin_about_its_own_axis(shape, tilt, omega):
    die = DICE[shape]
    start = on_vertex(die, 0, tilt, omega)
    held = throw_die(die, start, SmoothImpact(0.0), until=Until(time_s=0.3)).throw.flights[1]
    states = [held.at(t) for t in np.linspace(0.0, held.end_s, 60)]
    axes = np.array([s.rotation @ die.solid.vertices[0] for s in states])
    own = np.sum(axes * [s.omega_rad_s for s in states], axis=1)
    spin = np.linalg.norm(start.omega_rad_s) + np.sqrt(G / die.solid.circumradius)
    # The longest step, where a die has fallen far, makes 2e-9.
    np.testing.assert_allclose([energy_J(die, s) for s in states], energy_J(die, start), rtol=3e-9)
    np.testing.assert_allclose(own, own[0], atol=1e-9 * spin * die.solid.circumradius)
    assert {s.omega_rad_s[2] for s in states} == {start.omega_rad_s[2]}


@each_die
@pytest.mark.parametrize(("turn", "accuracy"), [(0.3, 1e-9), (0.1, 1e-12)])
@pytest.mark.parametrize("omega_z", [0.0, 3.0])
def test_a_die_released_on_an_edge_falls_with_constant_energy_until_the_next_vertex_touches(
    die, omega_z, turn, accuracy
):
    """With d from edge to centre and α its tilt, (J + m d² sin² α) α'²/2 + m g d cos α is kept; ω_z is no part of it.

    The accuracies are those of a method of order 8 at its usual step and at a third of it (measured: 3e-10, 1e-13).
    """
    released = 1e-3
    start = on_edge(die, released, omega_z)
    a, b = die.solid.vertices[die.solid.edges[0]]
    d, k = np.linalg.norm(a + b) / 2, die.inertia_kg_m2 / die.mass_kg
    flat = np.arccos(die.solid.inradius / d)

    def seconds(u):
        """dt/du for α = α₀ + u², which takes away the root of α' at the release."""
        tilt = released + u * u
        fall = 4 * G * d * np.sin(0.5 * (tilt + released)) * np.sin(0.5 * u * u)
        return 2 * u * np.sqrt((k + (d * np.sin(tilt)) ** 2) / fall)

    expected = quad(seconds, 0, np.sqrt(flat - released), epsabs=0, epsrel=1e-12, limit=200)[0]
    fine = Precision(step_turn_rad=turn)
    held = throw_die(die, start, SmoothImpact(0.0), until=Until(time_s=2 * expected), precision=fine).throw.flights[1]
    assert set(held.vertices) == set(die.solid.edges[0].tolist())
    assert held.end_s == pytest.approx(expected, rel=accuracy)
    for t in np.linspace(0, held.end_s, 20):
        state = held.at(t)
        tilt = np.arccos(min(state.position_m[2] / d, 1.0))
        level = state.rotation @ (b - a) / np.linalg.norm(b - a)
        turning = 0.5 * (k + (d * np.sin(tilt)) ** 2) * (state.omega_rad_s @ level) ** 2
        assert turning + G * d * np.cos(tilt) == pytest.approx(G * d * np.cos(released), rel=accuracy)
        assert state.omega_rad_s[2] == omega_z


def random_held(rng, die, chi: float, spin: float):
    """A random throw, 0.6 s of it, and its held contacts on a vertex or an edge."""
    release = random_release(rng, die, spin_rad_s=spin, clearance_m=0.02)
    result = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=release.time_s + 0.6))
    return result, [held for held in held_contacts(result) if len(held.vertices) < 3]


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.3])
def test_held_contact_obeys_newton_and_euler_with_forces_that_never_pull(die, chi):
    """m z̈ = Σ N - m g and J ω̇ = Σ r × N ẑ, from the differences of the motion alone, with N ≥ 0 at the held vertices."""
    rng, seen = np.random.default_rng(71), 0
    for _ in range(6):
        _, contacts = random_held(rng, die, chi, float(rng.uniform(0, 60)))
        for held in contacts:
            begin, h = held.start.time_s, 1e-5
            if held.end_s - begin < 4 * h:
                continue
            for t in np.linspace(begin + 1.5 * h, held.end_s - 1.5 * h, 5):
                early, state, late = (held.at(t + dt) for dt in (-h, 0.0, h))
                arms = state.rotation @ die.solid.vertices[list(held.vertices)].T
                law = np.array([np.ones(len(held.vertices)), arms[1], -arms[0]])
                k = die.inertia_kg_m2 / die.mass_kg
                turning = k * (late.omega_rad_s - early.omega_rad_s) / (2 * h)
                felt = np.array([G + (late.velocity_m_s[2] - early.velocity_m_s[2]) / (2 * h), *turning[:2]])
                forces, *_ = np.linalg.lstsq(law, felt, rcond=None)
                # Central differences: 1e-12/h of the motion's own accuracy, and (ω h)² of some 100 m/s².
                assert np.linalg.norm(law @ forces - felt) < 1e-4
                assert forces.min() > -1e-4
                seen += 1
    assert seen > 20


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.1, 0.5, 0.9])
def test_held_vertices_stay_on_the_table_and_no_vertex_goes_below_it(die, chi):
    rng, seen = np.random.default_rng(72), 0
    for _ in range(5):
        release = random_release(rng, die, spin_rad_s=float(rng.uniform(0, 60)), clearance_m=0.02)
        for flight in throw_die(die, release, SmoothImpact(chi)).throw.flights:
            if flight.end_s - flight.start.time_s < 1e-6:
                continue
            times = np.linspace(flight.start.time_s, flight.end_s, 10)
            positions, quaternions = flight.poses(times)
            heights = positions[:, 2, None] + matrix_from_quat(quaternions)[:, 2] @ die.solid.vertices.T
            # A vertex counts as standing on the table within 1e-10 R.
            assert heights.min() > -1.001e-10 * die.solid.circumradius
            if isinstance(flight, HeldContact) and len(flight.vertices) < 3:
                assert np.abs(heights[:, list(flight.vertices)]).max() < 1e-17 + 1e-15 * die.solid.circumradius
                seen += 1
    assert seen > 0 or chi > 0.0


def test_no_vertex_sinks_below_the_table_within_a_step_of_held_contact():
    """A vertex just released 1e-6 m above the table once sank 1e-3 R below it and rose again within one step."""
    die, rng = DICE["cube"], np.random.default_rng(72)
    for _ in range(20):
        release = random_release(rng, die, spin_rad_s=float(rng.uniform(0, 60)), clearance_m=0.02)
        for held in throw_die(die, release, SmoothImpact(0.0)).throw.flights:
            if isinstance(held, HeldContact) and len(held.vertices) < 3:
                positions, quaternions = held.poses(np.linspace(held.start.time_s, held.end_s, 300))
                heights = positions[:, 2, None] + matrix_from_quat(quaternions)[:, 2] @ die.solid.vertices.T
                # A vertex counts as standing on the table within 1e-10 R, and the motion between is known to as much.
                assert heights.min() > -2e-10 * die.solid.circumradius


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.1, 0.5, 0.9])
def test_energy_never_rises_in_flight_impact_or_held_contact(die, chi):
    rng = np.random.default_rng(73)
    for spin in (0.0, 5.0, 40.0, 150.0):
        release = random_release(rng, die, spin_rad_s=spin, clearance_m=0.03)
        result = throw_die(die, release, SmoothImpact(chi), until=Until(time_s=release.time_s + 0.4))
        ends = [energy_J(die, f.at(t)) for f in result.throw.flights for t in (f.start.time_s, f.end_s)]
        # A long fall in held contact gains or loses up to 3e-9 of the energy that is left.
        assert np.diff(ends).max() <= 1e-10 * energy_J(die, release)


@pytest.mark.parametrize("chi", [0.1, 0.5, 0.9])
def test_the_chatter_of_a_die_dropped_on_its_tip_lasts_as_long_as_the_geometric_series(chi):
    die, drop = exact_octahedron(), 0.1
    release = State(0.0, np.array([0, 0, die.solid.circumradius + drop]), np.array([1.0, 0, 0, 0]), *np.zeros((2, 3)))
    result = throw_die(die, release, SmoothImpact(chi))
    fall = np.sqrt(2 * drop / G)
    assert result.ending is Ending.BALANCED
    assert result.landed_face is None
    speed, slowest = G * fall, EXACT.slowest_bounce * np.sqrt(G * die.solid.circumradius)
    assert result.impact_count == int(np.ceil(np.log(slowest / speed) / np.log(chi)))
    # What is left out: the bounces that are slower.
    left_out = 2 * slowest / G / (1 - chi)
    assert 0 <= fall + 2 * fall * chi / (1 - chi) - result.end.time_s <= left_out


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_a_die_laid_or_dropped_on_any_of_its_faces_rests_on_it(die, chi):
    for face, normal in enumerate(die.solid.normals):
        for drop in (0.0, 0.003):
            position = np.array([0, 0, die.solid.inradius + drop])
            release = State(0.0, position, turned_down(normal), np.zeros(3), np.zeros(3))
            result = throw_die(die, release, SmoothImpact(chi))
            assert (result.ending, result.landed_face) == (Ending.RESTED, face + 1)


def test_a_die_balanced_on_a_vertex_or_an_edge_stays_there_and_falls_if_disturbed():
    tip, edge = exact_octahedron(), DICE["tetrahedron"]
    for die, height in ((tip, tip.solid.circumradius), (edge, edge.solid.vertices[:, 2].max())):
        position, level = np.array([0, 0, height]), np.array([1.0, 0, 0, 0])
        result = throw_die(die, State(0.0, position, level, np.zeros(3), np.zeros(3)), SmoothImpact(0.2))
        assert (result.ending, result.landed_face, result.impact_count) == (Ending.BALANCED, None, 0)
        for omega in (1e-12, 1e-3):
            pushed = State(0.0, position, level, np.zeros(3), omega * np.array([1.0, -0.5, 0.0]))
            assert throw_die(die, pushed, SmoothImpact(0.2)).ending is Ending.RESTED


@each_die
def test_a_die_that_spins_on_a_vertex_stays_upright_above_the_critical_spin_and_falls_below_it(die):
    """A sleeping top on a smooth table is stable for n² > 4 m g R/J; below, its tilt grows as cosh √(m g R/J - n²/4) t."""
    radius = die.solid.circumradius
    critical = 2 * np.sqrt(die.mass_kg * G * radius / die.inertia_kg_m2)
    tilt = 1e-6
    for share in (0.5, 0.9, 1.1):
        n = share * critical
        start = on_vertex(die, 0, tilt, (0.0, 0.0, n))
        start = replace(start, omega_rad_s=n * start.rotation @ -die.solid.vertices[0] / radius)
        time = 5.0 / critical
        held = throw_die(die, start, SmoothImpact(0.0), until=Until(time_s=time)).throw.flights[1]
        axis = held.at(time).rotation @ -die.solid.vertices[0] / radius
        growth = np.sqrt(complex(critical**2 - n**2)) / 2 * time
        # In the frame that precesses with n/2 the tilt is that of an inverted pendulum with spring.
        at_start = start.rotation @ -die.solid.vertices[0] / radius
        turn = matrix_from_quat(quat_from_rotvec(0.5 * n * time * UP))
        turned, tangent = turn @ at_start, turn @ np.cross(-0.5 * n * UP, at_start)
        rate = growth / time
        expected = turned * np.cosh(growth).real + tangent * (np.sinh(growth) / rate).real
        # The motion itself is known to 1e-12, which is 1e-6 of the tilt.
        np.testing.assert_allclose(axis[:2], expected[:2], atol=1e-12)


@each_die
def test_a_die_proved_to_spin_forever_never_touches_with_another_vertex(die):
    rng, seen = np.random.default_rng(74), 0
    while seen < 4:
        release = random_release(rng, die, spin_rad_s=float(rng.uniform(150, 600)), clearance_m=0.02)
        law = SmoothImpact(float(rng.choice([0.0, 0.5, 0.9])))
        result = throw_die(die, release, law)
        if result.ending is not Ending.SPINNING:
            continue
        tip = result.throw.impacts[-1].vertices[0]
        proved = result.end.time_s
        seen += 1
        on = throw_die(die, release, law, until=Until(time_s=proved + 1.0)).throw
        assert {v for i in on.impacts if i.time_s > proved for v in i.vertices} <= {tip}
        positions, quaternions = on.poses(np.linspace(proved, proved + 1.0, 100))
        heights = positions[:, 2, None] + matrix_from_quat(quaternions)[:, 2] @ die.solid.vertices.T
        assert np.delete(heights, tip, axis=1).min() > 0


def many_releases(rng, die, n: int, fastest_rad_s: float) -> np.ndarray:
    """States (n, 13): any orientation, spins up to the given one about any axis, 2 to 30 cm above the table."""
    axes = rng.normal(size=(n, 3))
    axes *= rng.uniform(0, fastest_rad_s, (n, 1)) / np.linalg.norm(axes, axis=1, keepdims=True)
    positions = np.column_stack([np.zeros((n, 2)), die.solid.circumradius + rng.uniform(0.02, 0.3, n)])
    quaternions = np.array([random_quaternion(rng) for _ in range(n)])
    return np.hstack([positions, quaternions, rng.normal(scale=0.5, size=(n, 3)), axes])


def landed(die, chi: float, starts: np.ndarray, precision: Precision = EXACT) -> Landings:
    """How throws end, from their starts (n, 13)."""
    return ThrowSetup(die, SmoothImpact(chi), precision=precision).throw(starts)


@each_die
@pytest.mark.parametrize("chi", [0.0, 0.1, 0.5, 0.9])
def test_thousands_of_throws_rest_or_spin_and_none_reaches_the_impact_cap(die, chi):
    landings = landed(die, chi, many_releases(np.random.default_rng(75), die, 1000, 300.0))
    endings = np.array([ENDING_OF_INDEX[index].name for index in landings.ending])
    assert set(endings) <= {Ending.RESTED.name, Ending.SPINNING.name, Ending.SPUN_LONG.name}
    np.testing.assert_array_equal(landings.face > 0, endings == Ending.RESTED.name)
    assert np.mean(endings == Ending.SPUN_LONG.name) < 0.05


@each_die
@pytest.mark.parametrize(("chi", "lost"), [(0.0, 0.0), (0.1, 0.005), (0.3, 0.02)])
def test_the_face_depends_neither_on_the_slowest_bounce_nor_on_the_step(die, chi, lost):
    """Exceptions are chaotic: 1e-6 of a velocity and 1e-9 of a pose grow at all later impacts."""
    starts = many_releases(np.random.default_rng(76), die, 400, 60.0)
    usual = landed(die, chi, starts).face
    for switch, turn in ((1e-6, 0.3), (1e-10, 0.3), (1e-8, 0.1), (1e-8, 0.4)):
        assert np.mean(landed(die, chi, starts, Precision(0.0, switch, turn)).face != usual) <= lost


@each_die
@pytest.mark.parametrize("chi", [0.1, 0.5])
def test_the_bounces_left_out_last_in_proportion_to_the_speed_of_the_slowest_bounce(die, chi):
    """The first vertex that is held is the same for every switch s, and held earlier by some s √(R/g)/(1 - χ)."""
    rng, scale = np.random.default_rng(77), np.sqrt(die.solid.circumradius / G)
    for _ in range(4):
        release = random_release(rng, die, spin_rad_s=10.0, clearance_m=0.005)
        firsts = []
        for switch in (1e-6, 1e-8, 1e-10):
            held = held_contacts(throw_die(die, release, SmoothImpact(chi), precision=Precision(slowest_bounce=switch)))
            firsts.append(held[0] if held else None)
        if None in firsts:
            continue
        slow, usual, fast = (held.start.time_s for held in firsts)
        assert len({held.vertices for held in firsts}) == 1
        assert 0 <= fast - usual < 10 * 1e-8 * scale / (1 - chi)
        assert 0 <= fast - slow < 10 * 1e-6 * scale / (1 - chi)


def cuboctahedron() -> Die:
    """Eight triangles farther from the centre than six squares, and yet one moment of inertia about every axis."""
    corners = [np.roll([0.0, a, b], k) for a in (-0.01, 0.01) for b in (-0.01, 0.01) for k in range(3)]
    return die_from_solid(convex_solid(np.array(corners), "cuboctahedron"), 0.016)


@pytest.mark.parametrize("toward", [-1.0, 1.0])
@pytest.mark.parametrize("tilt_rad", [0.03, 0.1])
@pytest.mark.parametrize("law", [SmoothImpact(0.3), CoulombImpact(0.3, 0.5)], ids=str)
def test_a_die_with_unequal_faces_lands_on_the_face_below_its_centre_even_if_another_points_down_more(
    toward, tilt_rad, law
):
    """On the edge of a square and a triangle, tilted by up to 8° towards the square, the triangle still looks down
    more: its normal is 19° from the plumb line of the edge, the square's 35°."""
    die = cuboctahedron()
    release = on_edge(die, toward * tilt_rad, 0.0)
    down = -(die.solid.normals @ release.rotation[2])
    under = int(np.argmax(down / die.solid.offsets)) + 1
    is_square = len(die.solid.faces[under - 1]) == 4
    assert (under != int(np.argmax(down)) + 1) == is_square
    result = throw_die(die, release, law)
    end = throw_die(die, release, law, until=Until(time_s=3.0)).end
    assert (result.ending, result.landed_face) == (Ending.RESTED, under)
    assert int(np.argmin(die.solid.normals @ end.rotation[2])) + 1 == under


@pytest.mark.parametrize("tilt_rad", [0.0, 0.1])
@pytest.mark.parametrize("chi", [0.0, 0.5])
def test_a_die_that_friction_holds_on_a_gently_shaking_table_has_come_to_rest(tilt_rad, chi):
    """0.16 g on a level table, and 0.1 g on a slope that friction holds ten times."""
    die, table = DICE["cube"], Table(tilt_rad=tilt_rad, amplitude_m=1e-4, frequency_hz=20.0)
    release = random_release(np.random.default_rng(7), die, spin_rad_s=20.0, clearance_m=0.03)
    law = CoulombImpact(chi, 1.0)
    result = throw_die(die, release, law, table=table)
    assert result.ending is Ending.RESTED
    later = throw_die(die, release, law, table=table, until=Until(time_s=result.end.time_s + 0.3)).end
    np.testing.assert_allclose(later.position_m[:2], result.end.position_m[:2], atol=1e-6 * die.solid.circumradius)
    assert int(np.argmin(die.solid.normals @ later.rotation[2])) + 1 == result.landed_face


def test_a_die_slides_on_a_slope_that_overcomes_friction_during_part_of_its_oscillation():
    """tan 0.2 = 0.203 needs more than μ = 0.22 of what is pressed while the table falls at 0.5 g."""
    die, rate = DICE["cube"], 2 * np.pi * 20.0
    table = Table(tilt_rad=0.2, amplitude_m=0.5 * G * np.cos(0.2) / rate**2, frequency_hz=20.0)
    down = die.solid.normals[0]
    release = State(0.0, np.array([0.0, 0.0, 0.0]), turned_down(down), np.zeros(3), np.zeros(3))
    lying = rotated_state(replace(release, position_m=die.solid.inradius * UP), table.world_from_table)
    moving = table.amplitude_m * rate * (matrix_from_quat(table.world_from_table) @ UP)
    release = replace(lying, velocity_m_s=moving)
    end = throw_die(die, release, CoulombImpact(0.0, 0.22), table=table, until=Until(time_s=1.0))
    assert end.ending is Ending.TIME_REACHED
    assert end.end.position_m[0] - release.position_m[0] > 1e-3
    held = throw_die(die, release, CoulombImpact(0.0, 1.0), table=table)
    assert (held.ending, held.landed_face) == (Ending.RESTED, 1)


def test_a_die_that_spins_on_a_gently_shaking_table_reaches_the_timeout():
    """No impact follows and nothing slows it, so that such a throw once went on without end."""
    die = DICE["cube"]
    table = Table(amplitude_m=1e-4, frequency_hz=5.0, phase_rad=0.5 * np.pi)
    release = on_vertex(die, 0, 0.05, [0.0, 0.0, 500.0])
    release = replace(release, position_m=release.position_m + table.amplitude_m * UP)
    result = throw_die(die, release, SmoothImpact(0.3), table=table)
    assert (result.ending, result.landed_face) == (Ending.SPUN_LONG, None)
    assert result.end.time_s >= engine.TIMEOUT * np.sqrt(die.solid.circumradius / G)
