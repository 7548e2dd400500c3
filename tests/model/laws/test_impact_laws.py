"""Conservation laws and kinematics that hold for every impact law."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_throws import DICE, random_release

from diethrow.model.laws import CoulombImpact, FrictionBySpeed, RestitutionBySpeed, SmoothImpact
from diethrow.model.rotations import matrix_from_quat, quat_from_euler
from diethrow.model.throw.motion import State, energy_J
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.model.throw.touch import Touch, impulse_N_s, next_touch

SMOOTH = [SmoothImpact(chi) for chi in (0.0, 0.1, 0.5, 0.9, 1.0)]
NEWTON = [CoulombImpact(0.5, 0.3, "newton"), CoulombImpact(1.0, 0.1, "newton")]
DISSIPATIVE = [
    *SMOOTH,
    CoulombImpact(0.5, 0.2),
    CoulombImpact(0.0, 1.5),
    CoulombImpact(0.8, 0.3, "poisson"),
    RestitutionBySpeed(SmoothImpact(0.9), 0.2),
    RestitutionBySpeed(CoulombImpact(0.9, 0.2), 0.2),
    FrictionBySpeed(CoulombImpact(0.5, 0.4), 0.3),
    FrictionBySpeed(RestitutionBySpeed(CoulombImpact(0.9, 0.4), 0.2), 0.3),
]
LAWS = [*DISSIPATIVE, *NEWTON]
each_law = pytest.mark.parametrize("law", LAWS, ids=str)
each_dissipative_law = pytest.mark.parametrize("law", DISSIPATIVE, ids=str)
each_kinematic_law = pytest.mark.parametrize("law", [*SMOOTH, *NEWTON], ids=str)
each_smooth_law = pytest.mark.parametrize("law", SMOOTH, ids=str)
each_die = pytest.mark.parametrize("die", DICE.values(), ids=DICE.keys())


def impacts_of(die, law, seed: int):
    """Impacts with the states before and after, over ten releases of up to six impacts each."""
    rng = np.random.default_rng(seed)
    for _ in range(10):
        release = random_release(rng, die, spin_rad_s=float(rng.choice([5.0, 60.0, 600.0])))
        throw = throw_die(die, release, law, until=Until(impacts=6)).throw
        for k, impact in enumerate(throw.impacts):
            if impact.contact == "held":
                continue
            yield impact, throw.flights[k].at(impact.time_s), throw.flights[k + 1].start


@each_dissipative_law
@each_die
def test_an_impact_never_adds_energy(die, law):
    for impact, before, after in impacts_of(die, law, 31):
        # Rounding of one energy.
        assert impact.energy_after_J <= impact.energy_before_J * (1 + 1e-14)
        assert impact.energy_before_J == pytest.approx(energy_J(die, before), rel=1e-12)
        assert impact.energy_after_J == pytest.approx(energy_J(die, after), rel=1e-14)


@each_kinematic_law
@each_die
def test_the_normal_velocity_of_the_contact_is_reversed_by_exactly_chi(die, law):
    for impact, _, after in impacts_of(die, law, 32):
        arm = after.rotation @ die.solid.vertices[impact.vertices[0]]
        speed = after.velocity_m_s[2] + np.cross(after.omega_rad_s, arm)[2]
        # Two velocities of metres a second (ωR = 10 m/s at most) that nearly cancel.
        assert speed == pytest.approx(-law.chi * impact.normal_velocity_before_m_s, abs=1e-13)
        assert impact.normal_velocity_after_m_s == pytest.approx(speed, abs=1e-13)
        np.testing.assert_allclose(impact.point_m, (after.position_m + arm)[:2], atol=1e-16)
        # At 600 rad/s a die can fly for seconds, through a thousand radians: 16 ε of metres is 1e-13 m.
        assert after.position_m[2] + arm[2] == pytest.approx(0.0, abs=3e-13)


@each_smooth_law
@each_die
def test_a_smooth_impact_keeps_horizontal_momentum_and_vertical_spin_to_the_last_digit(die, law):
    for impact, before, after in impacts_of(die, law, 33):
        np.testing.assert_array_equal(after.velocity_m_s[:2], before.velocity_m_s[:2])
        assert after.omega_rad_s[2] == before.omega_rad_s[2]
        np.testing.assert_array_equal(impact.impulse_N_s[:2], 0.0)
        assert impact.impulse_N_s[2] > 0


@each_law
@each_die
def test_momentum_and_angular_momentum_change_by_the_impulse_and_its_moment(die, law):
    for impact, before, after in impacts_of(die, law, 34):
        arm = after.rotation @ die.solid.vertices[impact.vertices[0]]
        momentum = die.mass_kg * (after.velocity_m_s - before.velocity_m_s)
        turning = die.inertia_kg_m2 * (after.omega_rad_s - before.omega_rad_s)
        np.testing.assert_allclose(momentum, impact.impulse_N_s, atol=1e-15)
        np.testing.assert_allclose(turning, np.cross(arm, impact.impulse_N_s), atol=1e-16)


@each_smooth_law
@each_die
def test_the_vector_form_solves_the_equations_of_the_paper(die, law):
    """Eqs 6 to 8 as they stand, seven linear equations for v', ω' and S, solved with no algebra of ours."""
    rng = np.random.default_rng(35)
    for _ in range(20):
        touch = next_touch(die, random_release(rng, die))
        v, w, r = touch.state.velocity_m_s, touch.state.omega_rad_s, touch.arm_m
        lever = np.array([r[1], -r[0], 0.0])  # r × ẑ, and also the row that takes ω to (ω × r)_z
        matrix = np.zeros((7, 7))
        matrix[:3, :3], matrix[3:6, 3:6] = die.mass_kg * np.eye(3), die.inertia_kg_m2 * np.eye(3)
        matrix[2, 6], matrix[3:6, 6] = -1.0, -lever
        matrix[6, 2], matrix[6, 3:6] = 1.0, lever
        known = [*(die.mass_kg * v), *(die.inertia_kg_m2 * w), -law.chi * touch.normal_velocity_m_s]
        # Rows of sizes 1 to 1e-6: the solve keeps some ten digits.
        assert impulse_N_s(die, touch, law)[2] == pytest.approx(np.linalg.solve(matrix, known)[6], rel=1e-9)


@each_smooth_law
@each_die
def test_the_vector_form_equals_the_paper_in_euler_angles(die, law):
    """Eqs 6 to 8 in the paper's own variables: z-x-z Euler angles ψ, ϑ, φ and the body components ω_ξ, ω_η, ω_ζ.

    The vertical in body axes is k = (sin ϑ sin φ, sin ϑ cos φ, cos ϑ), so that with S vertical at (ξ, η, ζ)
    m Δż = S,  J Δω_ξ = S (η k_ζ - ζ k_η),  J Δω_η = S (ζ k_ξ - ξ k_ζ),  J Δω_ζ = S (ξ k_η - η k_ξ),
    and the vertex falls with ż + ω_ξ (η k_ζ - ζ k_η) + ω_η (ζ k_ξ - ξ k_ζ) + ω_ζ (ξ k_η - η k_ξ) = v, then -χ v.
    """
    rng = np.random.default_rng(36)
    for _ in range(20):
        psi, theta, phi = rng.uniform(0, 2 * np.pi), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        vertex, rise = int(rng.integers(len(die.solid.vertices))), rng.normal()
        body = rng.normal(size=3) * 40.0
        xi, eta, zeta = die.solid.vertices[vertex]
        k_xi, k_eta, k_zeta = np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)
        levers = np.array([eta * k_zeta - zeta * k_eta, zeta * k_xi - xi * k_zeta, xi * k_eta - eta * k_xi])
        v = rise + body @ levers
        if v > 0.0:  # the vertex must come down
            rise, body, v = -rise, -body, -v
        S = -(1.0 + law.chi) * v / (1.0 / die.mass_kg + levers @ levers / die.inertia_kg_m2)

        quaternion = quat_from_euler([psi, theta, phi])
        rotation = matrix_from_quat(quaternion)
        velocity = np.array([*rng.normal(size=2), rise])
        state = State(0.0, np.zeros(3), quaternion, velocity, rotation @ body)
        touch = Touch(state, vertex, rotation @ die.solid.vertices[vertex], v)
        impulse = impulse_N_s(die, touch, law)
        assert impulse[2] == pytest.approx(S, rel=1e-12)
        turned = rotation.T @ (state.omega_rad_s + np.cross(touch.arm_m, impulse) / die.inertia_kg_m2)
        np.testing.assert_allclose(turned, body + S * levers / die.inertia_kg_m2, atol=1e-12 * np.abs(body).max())


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    chi=st.floats(0.0, 1.0),
    spin=st.one_of(st.just(0.0), st.floats(1e-12, 1e4)),
    shape=st.sampled_from(list(DICE)),
)
def test_no_smooth_impact_adds_energy_at_any_chi_and_spin(seed, chi, spin, shape):
    die = DICE[shape]
    release = random_release(np.random.default_rng(seed), die, spin_rad_s=spin)
    for impact in throw_die(die, release, SmoothImpact(chi), until=Until(impacts=3)).throw.impacts:
        assert impact.energy_after_J <= impact.energy_before_J * (1 + 1e-14)


@pytest.mark.parametrize("chi", [-0.01, 1.01, float("nan")])
def test_a_restitution_outside_zero_to_one_is_refused(chi):
    with pytest.raises(ValueError, match=r"chi = .*from 0 to 1"):
        SmoothImpact(chi)
