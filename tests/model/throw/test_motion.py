"""Free flight and the throw as a value."""

import numpy as np
import pytest
from random_throws import DICE, random_release

from diethrow.model.die.die import loaded_die
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import Flight, Throw, energy_J
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.model.world import GRAVITY_M_S2

RNG_SEED = 7


def test_the_centre_follows_a_parabola_and_the_die_turns_at_a_constant_rate():
    release = random_release(np.random.default_rng(RNG_SEED), DICE["cube"])
    flight = Flight(release, release.time_s + 0.3)
    dt = np.linspace(-0.1, 0.3, 40)
    positions, quaternions = flight.poses(release.time_s + dt)
    gravity = np.array([0, 0, -GRAVITY_M_S2])
    expected = release.position_m + np.outer(dt, release.velocity_m_s) + 0.5 * np.outer(dt**2, gravity)
    np.testing.assert_allclose(positions, expected, atol=1e-15)
    steps = rotation_between(quaternions[:-1], quaternions[1:]) / np.diff(dt)[:, None]
    np.testing.assert_allclose(steps, np.tile(release.omega_rad_s, (39, 1)), rtol=1e-11, atol=1e-11)


def test_a_flight_keeps_energy_and_angular_velocity_and_can_restart_at_any_instant():
    die = DICE["octahedron"]
    release = random_release(np.random.default_rng(RNG_SEED + 1), die)
    flight = Flight(release, release.time_s + 0.2)
    middle = flight.at(release.time_s + 0.08)
    assert energy_J(die, middle) == pytest.approx(energy_J(die, release), rel=1e-14)
    np.testing.assert_array_equal(middle.omega_rad_s, release.omega_rad_s)
    one, two = flight.at(release.time_s + 0.2), Flight(middle, flight.end_s).at(release.time_s + 0.2)
    np.testing.assert_allclose(one.position_m, two.position_m, atol=1e-15)
    np.testing.assert_allclose(rotation_between(one.quaternion, two.quaternion), 0, atol=1e-14)


def test_a_throw_is_continuous_in_pose_across_its_impacts():
    die = DICE["dodecahedron"]
    throw = throw_die(
        die, random_release(np.random.default_rng(2), die), SmoothImpact(0.6), until=Until(impacts=5)
    ).throw
    for k, impact in enumerate(throw.impacts):
        before, after = throw.flights[k].at(impact.time_s), throw.flights[k + 1].start
        np.testing.assert_allclose(before.position_m, after.position_m, atol=1e-14)
        np.testing.assert_allclose(rotation_between(before.quaternion, after.quaternion), 0, atol=1e-12)
        assert throw.flight_at(impact.time_s) == k + 1
    times = np.linspace(throw.flights[0].start.time_s, throw.flights[-1].end_s, 30)
    positions, quaternions = throw.poses(times)
    rates = throw.rates(times)
    for k, time in enumerate(times):
        state = throw.at(time)
        np.testing.assert_allclose(rates[k], np.concatenate([state.velocity_m_s, state.omega_rad_s]), atol=1e-13)
        np.testing.assert_allclose(throw.at(time).position_m, positions[k], atol=1e-14)
        np.testing.assert_allclose(rotation_between(throw.at(time).quaternion, quaternions[k]), 0, atol=1e-12)


@pytest.mark.parametrize("die", [DICE["cube"], loaded_die(DICE["cube"].solid, 0.016, 0.004, [0.0, 0.0, 0.008])])
def test_rates_of_a_whole_throw_are_those_of_its_states_in_held_contact_too(die):
    throw = throw_die(die, random_release(np.random.default_rng(2), die), SmoothImpact(0.0)).throw
    times = np.linspace(throw.flights[0].start.time_s, throw.flights[-1].end_s, 40)
    states = [throw.at(time) for time in times]
    expected = [np.concatenate([state.velocity_m_s, state.omega_rad_s]) for state in states]
    np.testing.assert_allclose(throw.rates(times), expected, atol=1e-13)
    positions, quaternions = throw.poses(times)
    np.testing.assert_allclose(positions, [state.position_m for state in states], atol=1e-14)
    np.testing.assert_allclose(quaternions, [state.quaternion for state in states], atol=1e-14)


def test_rotating_the_start_rotates_the_flight():
    release = random_release(np.random.default_rng(4), DICE["cube"], spin_rad_s=0.0)
    turn = quat_from_rotvec([0.1, -0.2, 0.3])
    end = Flight(release, 1.0).at(release.time_s + 0.1)
    np.testing.assert_allclose(end.quaternion, release.quaternion, atol=1e-16)
    np.testing.assert_allclose(
        rotation_between(end.quaternion, quat_multiply(turn, release.quaternion)), [0.1, -0.2, 0.3], atol=1e-14
    )


def test_a_throw_needs_one_flight_more_than_impacts():
    with pytest.raises(ValueError, match="0 flights and 0 impacts"):
        Throw((), ())
