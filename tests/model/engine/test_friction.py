"""Laws of friction: one impact with Coulomb's cone, and one step of held contact."""

import numpy as np
import pytest
from random_throws import DICE, random_quaternion

from diethrow.model import engine
from diethrow.model.laws import LEVEL, CoulombImpact, RestitutionBySpeed, SmoothImpact
from diethrow.model.rotations import matrix_from_quat
from diethrow.model.throw.body import body_of
from diethrow.model.throw.motion import State
from diethrow.model.throw.touch import Touch, impulse_N_s
from diethrow.model.world import GRAVITY_M_S2

ENDINGS = {"newton": engine.NEWTON, "poisson": engine.POISSON, "stronge": engine.STRONGE}
each_ending = pytest.mark.parametrize("ending", ENDINGS.values(), ids=ENDINGS.keys())
"""Of those that end a course of the slip."""
ALL = ENDINGS | {"algebraic": engine.ALGEBRAIC}
each_law = pytest.mark.parametrize("ending", ALL.values(), ids=ALL.keys())


def contacts(seed: int, n: int):
    """Contact matrices (six numbers), χ, μ and incoming velocities: dice of all shapes, general bodies, and extremes
    (rods and discs, slips from 1e-6 to 1e3 times the normal velocity, μ from 1e-3 to 1e3)."""
    rng = np.random.default_rng(seed)
    for k in range(n):
        die = DICE[list(DICE)[k % 5]]
        arm = matrix_from_quat(random_quaternion(rng)) @ die.solid.vertices[0]
        matrix = engine.spherical_contact_matrix(die.mass_kg, die.inertia_kg_m2, *arm)
        if k % 3 == 2:
            axes = matrix_from_quat(random_quaternion(rng))
            inertia = die.inertia_kg_m2 * 10.0 ** rng.uniform(-1.5, 1.5, 3)
            matrix = engine.contact_matrix(die.mass_kg, axes @ np.diag(1.0 / inertia) @ axes.T, *arm)
        velocity = rng.normal(size=3)
        velocity[:2] *= 10.0 ** (rng.uniform(-6, 3) if k % 2 else rng.uniform(-1, 1))
        velocity[2] = -abs(velocity[2])
        yield matrix, rng.uniform(), 10.0 ** (rng.uniform(-3, 3) if k % 5 == 4 else rng.uniform(-1.5, 0.7)), velocity


def full(matrix) -> np.ndarray:
    """(3, 3) of six numbers."""
    xx, xy, xz, yy, yz, zz = matrix
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def energies(matrix, velocity, impulse) -> tuple[float, float]:
    """What of the kinetic energy the contact can reach, cᵀM⁻¹c/2, before; and its change, S·(c + c')/2, exactly."""
    after = velocity + full(matrix) @ impulse
    return 0.5 * velocity @ np.linalg.solve(full(matrix), velocity), 0.5 * impulse @ (velocity + after)


def test_the_contact_matrix_is_the_change_of_contact_velocity_by_a_unit_impulse():
    rng = np.random.default_rng(1)
    for _ in range(20):
        arm, root = rng.normal(size=3), rng.normal(size=(3, 3))
        inertia = root @ root.T + 0.1 * np.eye(3)
        columns = [e / 2.0 + np.cross(np.linalg.solve(inertia, np.cross(arm, e)), arm) for e in np.eye(3)]
        matrix = full(engine.contact_matrix(2.0, np.linalg.inv(inertia), *arm))
        np.testing.assert_allclose(matrix, np.array(columns).T, rtol=1e-9, atol=1e-9 * np.abs(matrix).max())
        spherical = engine.spherical_contact_matrix(2.0, 0.3, *arm)
        np.testing.assert_allclose(
            spherical, engine.contact_matrix(2.0, np.eye(3) / 0.3, *arm), atol=1e-14 * max(spherical)
        )


@pytest.mark.parametrize("ending", [engine.STRONGE, engine.ALGEBRAIC], ids=["stronge", "algebraic"])
def test_an_impact_never_creates_energy(ending):
    for matrix, chi, mu, c in contacts(2, 4000):
        for x in (chi, 0.0, 1.0):
            energy, change = energies(matrix, c, np.array(engine.friction_impulse(matrix, x, mu, ending, *c)))
            # Rounding of the matrices of rods (condition up to 1e5) in the sum that tests it.
            assert change <= 1e-14 * energy


def test_newtons_restitution_can_create_energy():
    """The reason for Stronge's restitution, and proof that the test above can see a gain of energy."""
    created = []
    for matrix, _, mu, c in contacts(3, 2000):
        energy, change = energies(matrix, c, np.array(engine.friction_impulse(matrix, 1.0, mu, engine.NEWTON, *c)))
        created.append(change / energy)
    assert max(created) > 0.02


@each_law
def test_the_impulse_lies_within_the_cone_and_the_contact_leaves(ending):
    for matrix, chi, mu, c in contacts(4, 2000):
        sx, sy, sz = engine.friction_impulse(matrix, chi, mu, ending, *c)
        assert sz > 0.0
        assert np.hypot(sx, sy) <= mu * sz * (1 + 1e-14)
        # The end is w ≥ 0; a velocity is a sum of terms of this size.
        terms = abs(c).max() + np.abs(full(matrix) @ np.diag([sx, sy, sz])).max()
        assert (c + full(matrix) @ [sx, sy, sz])[2] >= -1e-14 * terms


@each_law
def test_without_friction_the_impulse_equals_the_smooth_one_to_the_last_digit(ending):
    for matrix, chi, _, c in contacts(5, 200):
        smooth = (0.0, 0.0, -(1.0 + chi) * c[2] / matrix[5])
        assert engine.friction_impulse(matrix, chi, 0.0, ending, *c) == smooth
        nearly = engine.friction_impulse(matrix, chi, 1e-12, ending, *c)
        # Friction of 1e-12 may count by the ratio of slip to normal velocity, 1e3, and of the matrix, 1e2.
        np.testing.assert_allclose(nearly, smooth, atol=1e-6 * smooth[2])


@pytest.mark.parametrize("ending", [engine.NEWTON, engine.ALGEBRAIC], ids=["newton", "algebraic"])
def test_the_restitution_of_velocities_reverses_the_normal_one(ending):
    for matrix, chi, mu, c in contacts(6, 1000):
        impulse = np.array(engine.friction_impulse(matrix, chi, mu, ending, *c))
        terms = abs(c).max() + np.abs(full(matrix) @ np.diag(impulse)).max()
        assert (c + full(matrix) @ impulse)[2] == pytest.approx(-chi * c[2], abs=1e-13 * terms)


def test_the_algebraic_impulse_stops_the_slip_or_lies_on_the_friction_cone_along_what_would():
    """Its definition, by the full matrix: (1 + χ) P + κ D with P + D = -M⁻¹ c."""
    stopped = 0
    for matrix, chi, mu, c in contacts(7, 2000):
        M = full(matrix)
        impulse = np.array(engine.friction_impulse(matrix, chi, mu, engine.ALGEBRAIC, *c))
        P = np.array([0.0, 0.0, -c[2] / M[2, 2]])
        D = np.linalg.solve(M, -c) - P
        kappa = (impulse - (1.0 + chi) * P) @ D / (D @ D)
        terms = np.abs(D).max() + (1.0 + chi) * P[2]
        np.testing.assert_allclose(impulse, (1.0 + chi) * P + kappa * D, atol=1e-9 * terms)
        assert 0.0 <= kappa <= 1.0 + 1e-9
        on_cone = np.hypot(*impulse[:2]) == pytest.approx(mu * impulse[2], rel=1e-12)
        assert on_cone or kappa == pytest.approx(1.0, abs=1e-9)
        stopped += not on_cone
    assert 200 < stopped < 1800


@pytest.mark.parametrize("b", [0.3, 0.0, -0.3])
def test_a_slip_that_keeps_its_direction_and_goes_on_has_the_same_impulse_by_either_law_of_velocities(b):
    """A fast slip in one plane, on which friction acts against it throughout."""
    for mu in (0.05, 0.2):
        c = np.array([3.0, 0.0, -1.0])
        algebraic, newton = (
            engine.friction_impulse(planar(b), 0.6, mu, ending, *c) for ending in (engine.ALGEBRAIC, engine.NEWTON)
        )
        np.testing.assert_allclose(algebraic, newton, rtol=1e-13)


def planar(b: float, tangential: float = 1.0, normal: float = 1.0):
    """A contact whose slip along x stays along x: T diagonal, coupling `b` [1/kg]."""
    return (tangential, 0.0, b, 1.7 * tangential, 0.0, normal)


@each_ending
def test_slip_that_continues_gives_an_impulse_on_the_friction_cone(ending):
    """w' = a - μ b all the way, so the three restitutions agree: p = -(1 + χ) w/(a - μ b), S_t = -μ p."""
    a, b, mu, chi, slip, w = 1.0, 0.3, 0.2, 0.6, 5.0, -1.0
    p = -(1 + chi) * w / (a - mu * b)
    expected = (-mu * p, 0.0, p)
    np.testing.assert_allclose(engine.friction_impulse(planar(b), chi, mu, ending, slip, 0.0, w), expected, rtol=1e-15)


def stopped_impulse(b: float, mu: float, chi: float, slip: float, w: float, ending: int) -> np.ndarray:
    """Routh's cases on paper: slip along +x stops within compression at p₁, then sticks or goes on along ±x."""
    stop = slip / (mu - b)
    w1 = w + (1.0 - mu * b) * stop
    assert w1 < 0.0
    stay = abs(b) <= mu
    tangential = -b if stay else -mu * np.sign(b)
    slope = 1.0 + b * tangential
    compression = stop - w1 / slope
    work = 0.5 * (w + w1) * stop - 0.5 * w1**2 / slope
    more = {
        engine.NEWTON: -chi * w / slope,
        engine.POISSON: chi * compression,
        engine.STRONGE: chi * np.sqrt(-2.0 * work / slope),
    }[ending]
    return np.array([-mu * stop + tangential * (compression + more - stop), 0.0, compression + more])


@each_ending
@pytest.mark.parametrize(("b", "mu"), [(0.3, 0.5), (-0.3, 0.5), (-0.6, 0.4), (-0.6, 0.0401)])
def test_slip_that_stops_sticks_or_reverses(b, mu, ending):
    """Sticks where |b| ≤ μ (T = 1), else it sets out the other way."""
    got = engine.friction_impulse(planar(b), 0.7, mu, ending, 0.1, 0.0, -1.0)
    np.testing.assert_allclose(got, stopped_impulse(b, mu, 0.7, 0.1, -1.0, ending), rtol=1e-14, atol=1e-15)


@each_ending
def test_slip_that_stops_during_restitution_follows_rouths_diagram(ending):
    """b = 0.3, μ = 0.5, s = 0.3: compression ends at p = 1/0.85, the slip at 0.3/0.2 after it."""
    b, mu, chi, slip, w = 0.3, 0.5, 0.9, 0.3, -1.0
    slide, stick, stop = 1.0 - mu * b, 1.0 - b * b, slip / (mu - b)
    compression, w1 = -w / slide, w + slide * stop
    assert w1 > 0.0
    end = {
        engine.NEWTON: stop + (-chi * w - w1) / stick,
        engine.POISSON: (1 + chi) * compression,
        engine.STRONGE: stop - w1 / stick + np.sqrt(w1**2 + stick * (chi**2 * w**2 - w1**2) / slide) / stick,
    }[ending]
    expected = [-mu * stop - b * (end - stop), 0.0, end]
    np.testing.assert_allclose(
        engine.friction_impulse(planar(b), chi, mu, ending, slip, 0.0, w), expected, rtol=1e-14, atol=1e-15
    )


@each_ending
def test_a_jam_drives_the_contact_into_the_table_until_the_slip_stops(ending):
    """b = 0.9, μ = 2: w' = 1 - 1.8 < 0 while it slides (s' = 0.9 - 2), and 1 - 0.81 once it sticks."""
    got = engine.friction_impulse(planar(0.9), 0.5, 2.0, ending, 0.4, 0.0, -1.0)
    np.testing.assert_allclose(got, stopped_impulse(0.9, 2.0, 0.5, 0.4, -1.0, ending), rtol=1e-14, atol=1e-15)


@each_ending
def test_a_contact_without_slip_sticks_or_slides_along_its_one_direction(ending):
    for matrix, chi, mu, c in contacts(7, 500):
        impulse = np.array(engine.friction_impulse(matrix, chi, mu, ending, 0.0, 0.0, c[2]))
        M = full(matrix)
        after = M @ impulse
        hold = np.linalg.solve(M[:2, :2], -M[:2, 2])
        if np.linalg.norm(hold) <= mu:
            np.testing.assert_allclose(impulse[:2], hold * impulse[2], rtol=1e-12, atol=1e-14 * impulse[2])
        else:
            slip = after[:2] / np.linalg.norm(after[:2])
            np.testing.assert_allclose(impulse[:2], -mu * impulse[2] * slip, atol=1e-9 * mu * impulse[2])
        # Straight from the start: the restitutions agree.
        assert after[2] + c[2] == pytest.approx(-chi * c[2], rel=1e-11)
        # And the smallest slip changes nothing.
        nudged = engine.friction_impulse(matrix, chi, mu, ending, *(1e-12 * c[:2] / np.linalg.norm(c[:2])), c[2])
        np.testing.assert_allclose(nudged, impulse, atol=1e-9 * np.abs(impulse).max())


def midpoint_impulse(cases, ending: int, steps: int) -> np.ndarray:
    """dc/dp in equal steps of p by the midpoint rule, all cases at once.

    Slip stays at zero once a step would carry it past, if the friction cone holds it.
    """
    M = np.array([full(case[0]) for case in cases])
    chi, mu = np.array([case[1] for case in cases]), np.array([case[2] for case in cases])
    c = np.array([case[3] for case in cases])
    incoming = c[:, 2].copy()
    hold = np.linalg.solve(M[:, :2, :2], -M[:, :2, 2][..., None])[..., 0]
    held = np.linalg.norm(hold, axis=1) <= mu
    S, down, up = np.zeros_like(c), np.zeros(len(c)), np.zeros(len(c))
    dp = np.array([engine.friction_impulse(*case[:3], ending, *case[3])[2] for case in cases]) / steps
    open_ = np.ones(len(c), bool)

    def force(v, stuck):
        size = np.maximum(np.linalg.norm(v, axis=1), 1e-300)
        sliding = -mu[:, None] * v / size[:, None]
        return np.concatenate([np.where(stuck[:, None], hold, sliding), np.ones((len(v), 1))], axis=1)

    stuck = np.zeros(len(c), bool)
    for _ in range(2 * steps):
        reach = dp * (np.abs(M[:, :2, 2]).sum(1) + mu * M[:, :2, :2].sum((1, 2)).clip(0) + mu * M[:, 0, 0])
        stuck |= held & (np.hypot(c[:, 0], c[:, 1]) < reach)
        middle = c + 0.5 * dp[:, None] * np.einsum("kij,kj->ki", M, force(c[:, :2], stuck))
        push = dp[:, None] * force(middle[:, :2], stuck) * open_[:, None]
        after = c + np.einsum("kij,kj->ki", M, push)
        w = 0.5 * (c[:, 2] + after[:, 2])
        weight = push[:, 2] if ending == engine.POISSON else push[:, 2] * np.abs(w)
        down, up = down + weight * (w < 0), up + weight * (w >= 0)
        c, S = after, S + push
        if ending == engine.NEWTON:
            open_ &= c[:, 2] < -chi * incoming
        else:
            open_ &= (c[:, 2] < 0) | (up < (chi if ending == engine.POISSON else chi**2) * down)
        if not open_.any():
            return S
    raise AssertionError("the midpoint integration did not end within twice the expected impulse")


@each_ending
def test_a_midpoint_integration_in_1e5_steps_agrees(ending):
    rng = np.random.default_rng(8)
    cases = [
        (matrix, chi, float(rng.uniform(0.05, 2.0)), np.array([*rng.normal(size=2) * rng.choice([0.3, 3.0]), c[2]]))
        for matrix, chi, _, c in contacts(9, 45)
    ]
    exact = np.array([engine.friction_impulse(*case[:3], ending, *case[3]) for case in cases])
    plain = midpoint_impulse(cases, ending, 100_000)
    # The end falls within a step, 1e-5, and where it sticks the slip was cut short by some steps.
    errors = np.abs(plain - exact).max(1) / np.abs(exact).max(1)
    assert errors.max() < 3e-3
    assert np.median(errors) < 5e-5


@each_law
def test_the_impulse_does_not_depend_on_the_units(ending):
    for matrix, chi, mu, c in contacts(10, 300):
        impulse = np.array(engine.friction_impulse(matrix, chi, mu, ending, *c))
        scaled = tuple(1e9 * m for m in matrix)
        other = np.array(engine.friction_impulse(scaled, chi, mu, ending, *(1e-7 * c)))
        # A rounding of the inputs; near a jam or its stop it grows.
        np.testing.assert_allclose(other * 1e16, impulse, atol=1e-10 * np.abs(impulse).max())


@each_law
def test_rotating_everything_about_the_vertical_rotates_the_impulse(ending):
    rng = np.random.default_rng(11)
    for matrix, chi, mu, c in contacts(12, 300):
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
        impulse = np.array(engine.friction_impulse(matrix, chi, mu, ending, *c))
        turned = tuple((turn @ full(matrix) @ turn.T)[np.triu_indices(3)])
        other = np.array(engine.friction_impulse(turned, chi, mu, ending, *(turn @ c)))
        np.testing.assert_allclose(other, turn @ impulse, atol=1e-9 * np.abs(impulse).max())


@each_law
def test_extreme_arguments_give_a_finite_impulse(ending):
    matrix, _, _, c = next(iter(contacts(13, 1)))
    for mu, chi, velocity in (
        (1e6, 0.5, c),
        (1e12, 1.0, c),
        (0.3, 0.0, c),
        (0.3, 1.0, c),
        (0.3, 0.5, (1.0, 2.0, -1e-200)),
        (0.3, 0.5, (1e-200, 0.0, -1.0)),
        (0.3, 0.5, (1e-300, 1e-300, -1e-290)),
        (0.3, 0.5, (0.0, 0.0, -1e150)),
    ):
        impulse = np.array(engine.friction_impulse(matrix, chi, mu, ending, *velocity))
        assert np.isfinite(impulse).all()
        assert impulse[2] > 0.0
    for resting in ((1.0, 2.0, 0.0), (1.0, 2.0, 1e-3), (1.0, 2.0, -0.0)):
        assert engine.friction_impulse(matrix, 0.5, 0.3, ending, *resting) == (0.0, 0.0, 0.0)
    assert np.isnan(engine.friction_impulse(matrix, 0.5, 0.3, ending, np.nan, 0.0, -1.0)).all()


def test_a_grazing_impact_slides_and_its_impulse_vanishes_with_its_speed():
    for matrix, chi, _, c in contacts(14, 100):
        ux, uy = c[:2] / np.linalg.norm(c[:2])
        slope = matrix[5] - 0.05 * (matrix[2] * ux + matrix[4] * uy)
        p = (1 + chi) * 1e-9 / slope
        got = engine.friction_impulse(matrix, chi, 0.05, engine.STRONGE, ux, uy, -1e-9)
        # The slip turns by p M/s, 1e-9 times the anisotropy of the matrix.
        np.testing.assert_allclose(got, (-0.05 * p * ux, -0.05 * p * uy, p), atol=1e-6 * p)


def touch_of(die, seed: int) -> Touch:
    """The fastest sinking vertex at a random orientation."""
    rng = np.random.default_rng(seed)
    velocity = np.array([*rng.normal(size=2), -2.0])
    state = State(0.0, np.zeros(3), random_quaternion(rng), velocity, rng.normal(size=3) * 40.0)
    arms = die.solid.vertices @ state.rotation.T
    normal = (state.velocity_m_s + np.cross(state.omega_rad_s, arms))[:, 2]
    vertex = int(np.argmin(normal))
    return Touch(state, vertex, arms[vertex], float(normal[vertex]))


def test_the_laws_pass_the_velocity_of_their_contact_to_the_kernel():
    for die in DICE.values():
        touch = touch_of(die, 15)
        c = touch.state.velocity_m_s + np.cross(touch.state.omega_rad_s, touch.arm_m)
        matrix = engine.spherical_contact_matrix(die.mass_kg, die.inertia_kg_m2, *touch.arm_m)
        for name, ending in ENDINGS.items():
            expected = engine.friction_impulse(matrix, 0.4, 0.25, ending, *c)
            # c is summed in another order.
            np.testing.assert_allclose(impulse_N_s(die, touch, CoulombImpact(0.4, 0.25, name)), expected, rtol=1e-12)


@pytest.mark.parametrize("law", [SmoothImpact(0.8), CoulombImpact(0.8, 0.3)], ids=str)
def test_restitution_by_speed_equals_the_law_with_the_restitution_of_that_speed(law):
    fading = RestitutionBySpeed(law, speed_scale_m_s=0.5)
    for die in DICE.values():
        touch = touch_of(die, 16)
        chi = 0.8 * (1.0 + abs(touch.normal_velocity_m_s) / 0.5) ** -0.25
        assert fading.chi_at(-touch.normal_velocity_m_s) == pytest.approx(chi, rel=1e-15)
        same = SmoothImpact(chi) if isinstance(law, SmoothImpact) else CoulombImpact(chi, 0.3)
        np.testing.assert_allclose(impulse_N_s(die, touch, fading), impulse_N_s(die, touch, same), rtol=1e-12)


def test_restitution_by_speed_is_constant_when_slow_and_follows_johnsons_power_law_when_fast():
    law = RestitutionBySpeed(SmoothImpact(0.7), speed_scale_m_s=1e-3)
    assert law.chi_at(0.0) == 0.7
    assert law.chi_at(160.0) / law.chi_at(10.0) == pytest.approx(16**-0.25, rel=1e-4)
    assert RestitutionBySpeed(SmoothImpact(0.7), 1.0, exponent=0.0).chi_at(1e3) == 0.7


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CoulombImpact(0.5, -0.1), "mu = -0.1.*0 or more"),
        (lambda: CoulombImpact(0.5, float("inf")), "mu = inf.*finite"),
        (lambda: CoulombImpact(1.5, 0.1), "chi = 1.5.*from 0 to 1"),
        (lambda: CoulombImpact(0.5, 0.1, "elastic"), "restitution = 'elastic'.*'stronge'"),
        (lambda: RestitutionBySpeed(SmoothImpact(0.5), 0.0), "speed_scale_m_s = 0.0.*above 0"),
        (lambda: RestitutionBySpeed(SmoothImpact(0.5), 1.0, -1.0), "exponent = -1.0.*0 or more"),
    ],
)
def test_invalid_parameters_raise_an_error(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# ---- held contact ----------------------------------------------------------------------------------------------------

CUBE = DICE["cube"]
CUBE_INERTIA = engine.EvenInertia(CUBE.mass_kg, CUBE.inertia_kg_m2)
BOTTOM = np.ascontiguousarray(DICE["cube"].solid.vertices[DICE["cube"].solid.vertices[:, 2] < 0])


def slide(velocity, mu: float, gravity, steps: int, h: float = 1e-4, table_velocity: float = 0.0, corners=BOTTOM):
    """Velocities (steps, 6) of a cube on its bottom corners."""
    velocity, impulses, rows = np.array(velocity, float), np.zeros((len(corners), 3)), []
    for _ in range(steps):
        contact = engine.FrictionalCorners(corners, impulses, mu, table_velocity)
        engine.friction_step(velocity, contact, CUBE_INERTIA, h * np.array(gravity))
        rows.append(velocity.copy())
    return np.array(rows)


def sloping(angle: float, heading: float) -> np.ndarray:
    g = GRAVITY_M_S2
    return np.array([g * np.sin(angle) * np.cos(heading), g * np.sin(angle) * np.sin(heading), -g * np.cos(angle)])


@pytest.mark.parametrize("heading", [0.0, 0.4, np.pi / 4])
@pytest.mark.parametrize("mu", [0.1, 0.5, 0.9])
def test_a_block_on_a_slope_sticks_below_the_angle_of_friction_and_slides_above(mu, heading):
    critical = np.arctan(mu)
    stuck = slide(np.zeros(6), mu, sloping(0.98 * critical, heading), 100)
    np.testing.assert_array_equal(stuck, 0.0)  # no creep at all
    angle = 1.05 * critical
    end = slide(np.zeros(6), mu, sloping(angle, heading), 100)[-1]
    speed = GRAVITY_M_S2 * (np.sin(angle) - mu * np.cos(angle)) * 1e-2
    # A hundred steps, each to 1e-14 of its push of 1e-3 m/s; ω R counts as a velocity.
    expected = [speed * np.cos(heading), speed * np.sin(heading), 0.0]
    np.testing.assert_allclose(end[:3], expected, atol=1e-13)
    np.testing.assert_allclose(end[3:] * 0.01, 0.0, atol=1e-13)


def test_a_block_that_slides_on_a_level_table_stops_after_v_over_mu_g():
    rows = slide([0.3, 0.1, 0, 0, 0, 0], 0.2, (0, 0, -GRAVITY_M_S2), 2000)
    stopped = np.argmax(np.linalg.norm(rows, axis=1) == 0.0) * 1e-4
    # To one step.
    assert stopped == pytest.approx(np.hypot(0.3, 0.1) / (0.2 * GRAVITY_M_S2), abs=1.01e-4)


def test_a_die_that_spins_on_its_face_is_stopped_by_the_torque_at_its_corners():
    """Four corners at ρ = a/√2 from the axis press with m g in all: J dω/dt = -μ m g ρ."""
    rows = slide([0, 0, 0, 0, 0, 50.0], 0.3, (0, 0, -GRAVITY_M_S2), 1000)
    stopped = np.argmax(np.linalg.norm(rows, axis=1) == 0.0) * 1e-4
    torque = 0.3 * CUBE.mass_kg * GRAVITY_M_S2 * 0.02 / np.sqrt(2)
    assert stopped == pytest.approx(50.0 * CUBE.inertia_kg_m2 / torque, abs=1.01e-4)
    assert (np.diff(rows[:, 5]) <= 0).all()


def test_a_rising_table_carries_the_die():
    rows = slide(np.zeros(6), 0.3, (0, 0, -GRAVITY_M_S2), 3, table_velocity=0.2)
    np.testing.assert_array_equal(rows, [[0, 0, 0.2, 0, 0, 0]] * 3)
    falling = slide([0, 0, -0.2, 0, 0, 0], 0.3, (0, 0, -GRAVITY_M_S2), 3, table_velocity=-1.0)
    np.testing.assert_allclose(falling[:, 2], -0.2 - GRAVITY_M_S2 * 1e-4 * np.arange(1, 4), rtol=1e-14)


@pytest.mark.parametrize("touching", [1, 2, 3, 4])
def test_held_contact_never_gains_energy_and_never_sinks(touching):
    """Velocities are those at the end of the step, so that the kinetic energy grows by less than the work of gravity."""
    rng, mass, inertia = np.random.default_rng(17), CUBE.mass_kg, CUBE.inertia_kg_m2
    for _ in range(200):
        before = np.concatenate([rng.normal(size=3), rng.normal(size=3) * 30.0]) * 10.0 ** rng.uniform(-4, 0)
        push, mu, velocity = 1e-3 * rng.normal(size=3), rng.uniform(0.0, 0.8), before.copy()
        impulses = np.zeros((touching, 3))
        sweeps = engine.friction_step(
            velocity, engine.FrictionalCorners(BOTTOM[:touching], impulses, mu, 0.0), CUBE_INERTIA, push
        )
        weights = np.array([mass] * 3 + [inertia] * 3)
        gained = 0.5 * weights @ (velocity**2 - before**2) - mass * push @ velocity[:3]
        assert gained <= 1e-13 * (weights @ before**2 + mass * push @ push)
        assert (np.hypot(impulses[:, 0], impulses[:, 1]) <= mu * impulses[:, 2] * (1 + 1e-12) + 1e-300).all()
        corners = velocity[:3] + np.cross(velocity[3:], BOTTOM[:touching])
        size = np.linalg.norm(push) + np.abs(before[:3]).max() + 0.02 * np.abs(before[3:]).max()
        if sweeps < 1000:
            assert corners[:, 2].min() >= -1e-10 * size
            # Friction points against the slip, or there is none.
            against = np.sum(corners[:, :2] * impulses[:, :2], axis=1)
            sizes = np.linalg.norm(corners[:, :2], axis=1) * np.linalg.norm(impulses[:, :2], axis=1)
            np.testing.assert_allclose(against, -sizes, atol=1e-9 * size * impulses.max())


def test_one_contact_is_solved_exactly():
    for matrix, _, mu, c in contacts(18, 2000):
        impulse = np.array(engine.inelastic_impulse(matrix, mu, *c))
        after = c + full(matrix) @ impulse
        terms = np.abs(c).max() + np.abs(full(matrix) @ np.diag(impulse)).max()
        friction = np.linalg.norm(impulse[:2])
        assert friction <= mu * impulse[2] * (1 + 1e-13)
        assert abs(after[2]) <= 1e-13 * terms
        if friction < mu * impulse[2] * (1 - 1e-9):
            np.testing.assert_allclose(after, 0.0, atol=1e-13 * terms)
        else:
            assert after[:2] @ impulse[:2] == pytest.approx(
                -np.linalg.norm(after[:2]) * friction, abs=1e-10 * terms * friction
            )


def test_a_die_in_millimetres_slides_as_in_metres():
    rng = np.random.default_rng(19)
    for _ in range(50):
        velocity = np.concatenate([rng.normal(size=3), rng.normal(size=3) * 30.0]) * 1e-2
        small, push = velocity * [1, 1, 1, 1e3, 1e3, 1e3] * 1e-3, 1e-4 * rng.normal(size=3)
        a, b = np.zeros((4, 3)), np.zeros((4, 3))
        corners = engine.FrictionalCorners(BOTTOM, a, 0.3, 0.0)
        engine.friction_step(velocity, corners, CUBE_INERTIA, push)
        corners = engine.FrictionalCorners(1e-3 * BOTTOM, b, 0.3, 0.0)
        engine.friction_step(small, corners, engine.EvenInertia(1.6e-5, 1e-9 * CUBE.inertia_kg_m2), 1e-3 * push)
        np.testing.assert_allclose(small * [1e3, 1e3, 1e3, 1, 1, 1], velocity, atol=1e-10 * np.abs(velocity).max())


def test_a_die_at_rest_stays_where_it_is_in_a_throw_of_zero_duration():
    """Within no time nothing presses it onto the table. It must not fly off and touch without end."""
    poses = np.empty((1, 7))
    lying = np.zeros((1, 13))
    lying[0, 2], lying[0, 3] = 0.5 * DICE["cube"].solid.edge_m, 1.0
    law = CoulombImpact(chi=0.3, mu=0.2)
    coarse = engine.Precision(0.0, 1e-4, 1.0, 1e-4)
    setup = engine.Setup(body_of(DICE["cube"]), engine.law_of(law.code, law.parameters), LEVEL.plane, coarse)
    engine.poses_of_throws(setup, lying, np.zeros(1), np.zeros(1), np.array([0, 1]), 10**7, poses)
    np.testing.assert_array_equal(poses, lying[:, :7])
