"""Laws of a chain of flights: derivatives agree with the motion, and covariances of the fit with its errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from random_throws import random_quaternion, state_difference
from throws import BRICK, FPS, random_release, seen, true_throw

from diethrow.model.die.die import Die, make_die
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import EVEN, Flight, State, Throw, Turning, turning_of
from diethrow.tracking.covariance import scaled_inverse
from diethrow.tracking.flights.flight_chain import FlightChain, Link, fit_chain
from diethrow.tracking.flights.single_flights import (
    UNMODELLED_POSITION_M,
    UNMODELLED_ROTATION_RAD,
    WeightedPoses,
    fit_flight,
    left_jacobians,
    perturbed,
    transition_matrix,
)
from diethrow.tracking.track import Track

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.016, 0.0048)


TURNING = {"cube": EVEN, "brick": turning_of(BRICK)}
turning_alike = pytest.mark.parametrize("turning", TURNING.values(), ids=TURNING)


def flight_of(rng: np.random.Generator, turning: Turning, spin_rad_s: float = 80.0) -> Flight:
    state = State(0.3, rng.normal(size=3), random_quaternion(rng), rng.normal(size=3), rng.normal(size=3) * spin_rad_s)
    return Flight(state, np.inf, turning=turning)


@turning_alike
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("after_s", [-0.01, 0.0, 1e-6, 0.02, 0.1])
def test_the_transition_is_the_derivative_of_the_motion(seed: int, after_s: float, turning: Turning) -> None:
    flight = flight_of(np.random.default_rng(seed), turning)
    end = flight.at(0.3 + after_s)
    # The change is small against the angle over which the motion curves, and large against rounding: central differences
    # at 1e-5 are then accurate to 1e-9 of a derivative of order one.
    steps = 1e-5 * np.eye(12)
    measured = np.empty((12, 12))
    for a, step in enumerate(steps):
        starts = (perturbed(flight.start, sign * step) for sign in (1.0, -1.0))
        ahead, behind = (replace(flight, start=start).at(end.time_s) for start in starts)
        measured[:, a] = (state_difference(end, ahead) - state_difference(end, behind)) / 2e-5
    # A spin of a hundred radians a second changes with a turn of the attitude by as much, and its differences err accordingly.
    unit = np.where(turning is EVEN, 1.0, np.repeat([1.0, 1.0, 1.0, 100.0], 3))[:, None]
    np.testing.assert_allclose(transition_matrix(flight, end.time_s) / unit, measured / unit, atol=1e-8)


@turning_alike
@pytest.mark.parametrize("first_s", [0.0, 0.004, 0.03])
def test_transition_matrices_compose(first_s: float, turning: Turning) -> None:
    flight = flight_of(np.random.default_rng(9), turning)
    begin, middle, end = 0.3, 0.3 + first_s, 0.36
    onward = replace(flight, start=flight.at(middle))
    whole = transition_matrix(onward, end) @ transition_matrix(flight, middle)
    # Products of a handful of numbers of order one, rounding only; where the spin varies its integration errs by 1e-13 of a turn.
    atol = 1e-12 if turning is EVEN else 1e-9
    np.testing.assert_allclose(whole, transition_matrix(flight, end), atol=atol)
    np.testing.assert_allclose(
        transition_matrix(flight, begin), np.eye(12), atol=1e-3 * atol if turning is EVEN else 1e-12
    )


def jacobian_by_quadrature(v: Array) -> Array:
    """J(v) = ∫₀¹ exp(s v) ds, by Gauss and Legendre with 24 points: exact to rounding for turns of a few radians."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    turns = quat_from_rotvec(np.outer((nodes + 1.0) / 2.0, v))
    identity = np.eye(3)
    rotations = [
        np.stack([quat_multiply(quat_multiply(q, [0.0, *axis]), q * [1, -1, -1, -1])[1:] for axis in identity], axis=1)
        for q in turns
    ]
    return np.asarray(np.einsum("k,kij->ij", weights / 2.0, rotations))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 0.999e-3, 1.001e-3, 0.1, np.pi - 1e-7, np.pi, 4.0, 2.0 * np.pi])
def test_the_left_jacobian_is_the_mean_of_the_rotation_along_its_path(angle: float) -> None:
    axis = np.array([0.48, -0.6, 0.64])
    # At the switch the series lacks 1e-9 / 24 and (v - sin v) / v³ has seven digits chi2, times v² = 1e-6.
    np.testing.assert_allclose(left_jacobians(angle * axis[None])[0], jacobian_by_quadrature(angle * axis), atol=1e-12)


@pytest.mark.parametrize("angle", [1e-4, 0.999e-3, 1.001e-3, 0.5, 3.0])
def test_the_left_jacobian_takes_a_change_of_the_vector_to_a_rotation(angle: float) -> None:
    v = angle * np.array([-0.36, 0.48, 0.8])
    change = 1e-6 * np.array([0.3, 0.5, -0.7])
    ahead, behind = quat_from_rotvec(v + change), quat_from_rotvec(v - change)
    # Second differences cancel: the third order of 1e-6 remains, below rounding.
    np.testing.assert_allclose(left_jacobians(v[None])[0] @ change, rotation_between(behind, ahead) / 2.0, atol=1e-15)


def weighted_poses(track: Track) -> WeightedPoses:
    poses = track.time_s, track.position_m, track.quaternion, track.covariance
    return WeightedPoses.from_poses(*poses, turning=track.turning)


def with_unmodelled_errors(track: Track, rng: np.random.Generator) -> Track:
    """The track with the unmodelled errors that the fit adds to each frame's own sigma, so that the stated errors are correct."""
    aside = UNMODELLED_POSITION_M * rng.normal(size=(len(track), 3))
    turns = quat_from_rotvec(UNMODELLED_ROTATION_RAD * rng.normal(size=(len(track), 3)))
    quaternion = quat_multiply(turns, track.quaternion)
    return replace(track, position_m=track.position_m + aside, quaternion=quaternion)


def chain_through(throw: Throw, track: Track, rng: np.random.Generator) -> FlightChain:
    """The joint fit from guesses as inaccurate as single flights give them: 0.2 frames, 3 cm/s and 2 rad/s off."""
    rough = 0.03 * np.eye(12)[6:9].sum(0) + 2.0 * np.eye(12)[9:12].sum(0)
    starts = [perturbed(flight.start, rough * rng.normal(size=12)) for flight in throw.flights]
    links = [impact.time_s + rng.uniform(-0.2, 0.2) / FPS for impact in throw.impacts]
    return fit_chain(weighted_poses(track), starts, [Link(t) for t in links])


@pytest.mark.parametrize("die", [CUBE, BRICK], ids=["cube", "brick"])
def test_a_chain_without_noise_is_found_exactly(die: Die) -> None:
    rng = np.random.default_rng(4)
    throw = true_throw(die, random_release(die, rng), 0.6, impacts=2)
    chain = chain_through(throw, seen(throw, rng, noise=1e-9), rng)
    for fitted, true in zip(chain.flights, throw.flights, strict=True):
        errors = state_difference(fitted.at(true.start.time_s), true.start)
        # Only rounding and the stop of the fit (a relative 1e-9 of a cost that goes to zero) remain.
        np.testing.assert_allclose(errors, 0.0, atol=1e-3)
    np.testing.assert_allclose(chain.link_times_s, [i.time_s for i in throw.impacts], atol=1e-8)


def chains(die: Die) -> tuple[Array, Array]:
    """NEES (n,) of the first state and normalised errors (2n,) of the instants, over seeded throws of two bounces."""
    states, instants = [], []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        throw = true_throw(die, random_release(die, rng), 0.6, impacts=2)
        lasting = [flight.end_s - flight.start.time_s for flight in throw.flights]
        if min(lasting) < 8.0 / FPS:
            # A frame on the wrong side of a link is more likely if flights last for a frame or two.
            continue
        chain = chain_through(throw, with_unmodelled_errors(seen(throw, rng), rng), rng)
        first = chain.flights[0]
        assert first.covariance is not None
        errors = state_difference(first.start, throw.flights[0].at(first.start.time_s))
        unit = 1.0 / np.sqrt(np.diag(first.covariance))
        states.append(errors * unit @ np.linalg.solve(first.covariance * np.outer(unit, unit), errors * unit))
        instants.append((chain.link_times_s - [i.time_s for i in throw.impacts]) / chain.sigma_time_s)
    return np.array(states), np.concatenate(instants)


@pytest.mark.parametrize("die", [CUBE, BRICK], ids=["cube", "brick"])
def test_the_covariances_of_a_fitted_chain_are_true(die: Die) -> None:
    nees, instants = chains(die)
    # Nine throws at least: the mean of chi-square with twelve numbers is 12 ± 1.6, that of 18 squared normals 1 ± 0.33.
    assert len(nees) > 8
    assert 12.0 - 4.5 < nees.mean() < 12.0 + 4.5
    assert 0.3 < (instants**2).mean() < 1.9
    assert np.abs(instants).max() < 4.0


@pytest.mark.parametrize("die", [CUBE, BRICK], ids=["cube", "brick"])
@pytest.mark.parametrize("spin_rad_s", [0.5, 10.0])
def test_the_covariance_of_a_single_flight_is_true(spin_rad_s: float, die: Die) -> None:
    nees = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        throw = true_throw(die, random_release(die, rng, spin_rad_s=spin_rad_s), 0.6, impacts=0)
        state, covariance, _ = fit_flight(weighted_poses(with_unmodelled_errors(seen(throw, rng), rng)))
        errors = state_difference(state, throw.at(state.time_s))
        unit = 1.0 / np.sqrt(np.diag(covariance))
        nees.append(errors * unit @ np.linalg.solve(covariance * np.outer(unit, unit), errors * unit))
    # Sixty flights: chi-square with twelve numbers has a mean of 12 ± 0.63.
    assert 12.0 - 2.0 < np.mean(nees) < 12.0 + 2.0


@turning_alike
def test_a_flight_of_many_turns_is_fitted(turning: Turning) -> None:
    spin = np.array([300.0, -500.0, 400.0])
    times = np.arange(60) / FPS
    start = State(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), spin)
    true = Flight(start, np.inf, turning=turning)
    p, q = true.poses(times)
    covariance = np.tile(np.diag([1e-10] * 3 + [1e-6] * 3), (60, 1, 1))
    state, _, chi2 = fit_flight(WeightedPoses.from_poses(times, p, q, covariance, turning=turning))
    # Four and a half turns in forty milliseconds; without noise only rounding remains.
    np.testing.assert_allclose(state.omega_rad_s, true.at(state.time_s).omega_rad_s, rtol=1e-9)
    assert chi2 < 1e-9


def test_an_outlier_has_no_weight() -> None:
    rng = np.random.default_rng(12)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=1)
    track = seen(throw, rng)
    clean = chain_through(throw, track, np.random.default_rng(1))
    quaternion, position = track.quaternion.copy(), track.position_m.copy()
    quaternion[10] = quat_multiply(quat_from_rotvec([0.4, 0.0, 0.2]), quaternion[10])
    position[40] += [0.0, 0.004, 0.0]
    with_outliers = Track(track.frame, track.time_s, position, quaternion, track.covariance, track.status)
    chain = chain_through(throw, with_outliers, np.random.default_rng(1))
    sigma = clean.sigma_time_s[0]
    # Two frames of some hundred change an estimate by a small share of its sigma.
    assert abs(chain.link_times_s[0] - clean.link_times_s[0]) < 0.5 * sigma
    assert chain.residual[10] > 20.0
    assert chain.residual[40] > 20.0
    assert (chain.weights[[10, 40]] == 0.0).all()


@pytest.mark.parametrize("seed", [5, 12])
def test_a_short_flight_whose_guess_is_far_off_is_found_beside_a_long_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=1)
    t = whole.impacts[0].time_s
    throw = Throw((whole.flights[0], replace(whole.flights[1], end_s=t + 12.0 / FPS)), whole.impacts)
    track = seen(throw, rng)
    # Half a metre a second and 60 rad/s: the last frames are 4 mm and half a radian away, hundreds of sigmas.
    aside = np.array([0, 0, 0, 0, 0, 0, 0.5, -0.3, 0.4, 60.0, -40.0, 30.0], float)
    far = fit_chain(
        weighted_poses(track), [throw.flights[0].start, perturbed(throw.flights[1].at(t), aside)], [Link(t)]
    )
    near = fit_chain(weighted_poses(track), [f.start for f in throw.flights], [Link(t)])
    assert far.weights[track.time_s > t].min() > 0.0
    assert far.link_times_s[0] == pytest.approx(near.link_times_s[0], abs=0.05 * float(near.sigma_time_s[0]))


def test_states_that_do_not_meet_stay_apart_at_an_open_link() -> None:
    rng = np.random.default_rng(5)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=1)
    t = throw.impacts[0].time_s
    after = throw.flights[1]
    aside = np.zeros(12)
    aside[:6] = [0.002, 0.0, 0.001, 0.1, 0.05, 0.0]
    apart = Throw((throw.flights[0], Flight(perturbed(after.start, aside), after.end_s)), throw.impacts)
    track = seen(apart, rng, noise=1e-9)
    chain = fit_chain(weighted_poses(track), [f.start for f in apart.flights], [Link(t, is_open=True)])
    np.testing.assert_allclose(state_difference(chain.flights[1].at(t), apart.flights[1].at(t)), 0.0, atol=1e-6)
    assert np.isnan(chain.sigma_time_s[0])
    assert np.isnan(chain.joint_covariance[0]).all()


def test_the_scaled_inverse_is_the_inverse_and_finite_for_undetermined_parameters() -> None:
    rng = np.random.default_rng(6)
    rows = rng.normal(size=(60, 12)) * np.geomspace(1e-5, 1e5, 12)
    matrix = rows.T @ rows
    inverse = scaled_inverse(matrix)
    # The factor loses as many digits as the scaled matrix has in its condition, below a hundred here.
    np.testing.assert_allclose(inverse @ matrix, np.eye(12), atol=1e-5)
    np.testing.assert_array_equal(inverse, inverse.T)
    rows[:, 3] = rows[:, 4] * 1e-3  # two parameters that no frame distinguishes
    singular = scaled_inverse(rows.T @ rows)
    assert np.isfinite(singular).all()
    # The variances of the others are those without the undetermined pair.
    np.testing.assert_allclose(
        np.delete(np.diag(singular), [3, 4]), np.delete(np.diag(scaled_inverse_without(rows, 3)), 3)
    )


def scaled_inverse_without(rows: Array, column: int) -> Array:
    fewer = np.delete(rows, column, axis=1)
    return scaled_inverse(fewer.T @ fewer)
