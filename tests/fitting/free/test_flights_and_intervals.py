"""Laws of the parts of a fit: free flights, robust loss, intervals, and landings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import random_release, roughly_measured, seen, true_throw

from diethrow.fitting.estimation.intervals import correlation_time, profile_interval
from diethrow.fitting.estimation.least_squares import compressed, huber, triangular_factor
from diethrow.fitting.estimation.observations import observations_of, whiteners
from diethrow.fitting.free.flights import fit_flights, flight_jacobian, left_jacobian, moved_state
from diethrow.fitting.throw.landing import resting_face
from diethrow.model.die.die import make_die
from diethrow.model.rotations import quat_from_matrix, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import Flight, State
from diethrow.tracking.track import TRACKED, Track

CUBE = make_die("cube", 0.016, 0.0048)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.99e-4, 1.01e-4, 0.3, 3.0], ids=str)
def test_left_jacobian_is_the_derivative_of_the_exponential(angle: float) -> None:
    v = angle * np.array([0.6, -0.48, 0.64])
    step = 1e-6
    for k in range(3):
        d = step * np.eye(3)[k]
        moved = rotation_between(quat_from_rotvec(v - d), quat_from_rotvec(v + d)) / (2.0 * step)
        # Rounding of a quaternion over the step: 1e-16/1e-6.
        assert left_jacobian(v)[:, k] == pytest.approx(moved, abs=3e-9)


def test_flight_jacobian_is_the_derivative_of_the_poses() -> None:
    state = random_release(CUBE, np.random.default_rng(0))
    times = np.array([-0.01, 0.0, 0.04])
    jacobian = flight_jacobian(state, times)
    for k, step in enumerate(np.repeat([1e-6, 1e-6, 1e-5, 1e-4], 3)):
        change = step * np.eye(12)[k]
        ends = [Flight(moved_state(state, sign * change), 1.0).poses(times) for sign in (-1.0, 1.0)]
        moved = np.hstack([ends[1][0] - ends[0][0], rotation_between(ends[0][1], ends[1][1])]) / (2.0 * step)
        assert jacobian[:, :, k] == pytest.approx(moved, abs=1e-8)


def test_free_flights_find_the_size_of_the_frames_errors() -> None:
    rng = np.random.default_rng(1)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.58, impacts=2)
    track, measured = seen(throw, rng, stated=0.5), roughly_measured(throw, rng)
    free = fit_flights(observations_of(track, measured), measured)
    # From the medians of some 100 frames: the variance is known to 15 %.
    assert free.variance == pytest.approx(4.0, rel=0.3)
    assert free.outliers == 0


def test_frames_within_half_an_interval_of_an_impact_are_left_out() -> None:
    rng = np.random.default_rng(1)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.58, impacts=2)
    observations = observations_of(seen(throw, rng), throw)
    for impact in throw.impacts:
        assert np.abs(observations.time_s - impact.time_s).min() >= 0.5 / 1500.0


def test_singular_and_missing_covariances_have_no_weight() -> None:
    good = np.diag([4e-10] * 3 + [1e-6] * 3)
    flat, missing = good.copy(), np.full((6, 6), np.nan)
    flat[0, 1] = flat[1, 0] = 4e-10
    weights = whiteners(np.array([good, flat, missing]))
    assert weights[0].T @ weights[0] @ good == pytest.approx(np.eye(6))
    assert np.isnan(weights[1:]).all()


def test_robust_residuals_have_the_gradient_of_their_loss() -> None:
    rng = np.random.default_rng(2)
    matrix, offset = rng.standard_normal((5, 6, 3)), 4.0 * rng.standard_normal((5, 6))

    def loss(x: np.ndarray) -> float:
        return float((huber(offset + matrix @ x, matrix, 22.46)[0] ** 2).sum())

    residuals, jacobian = huber(offset, matrix, 22.46)
    assert ((offset**2).sum(1) > 22.46).any()
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        slope = (loss(step) - loss(-step)) / 2e-6
        assert 2.0 * np.einsum("ni,ni->", residuals, jacobian[:, :, k]) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("rows", [3, 13, 200])
def test_condensed_rows_keep_all_squares_and_products(rows: int) -> None:
    rng = np.random.default_rng(rows)
    jacobian, residuals = rng.standard_normal((rows, 12)), rng.standard_normal(rows)
    whole = np.column_stack([jacobian, residuals])
    few = compressed(residuals, jacobian)
    assert few.T @ few == pytest.approx(whole.T @ whole, abs=1e-12)
    root = triangular_factor(jacobian)
    assert np.tril(root, -1) == pytest.approx(0.0)
    assert (np.diag(root) >= 0.0).all()


def test_independent_residuals_count_fully_and_repeated_ones_once() -> None:
    rng = np.random.default_rng(3)
    flight = np.zeros(200, int)
    assert correlation_time(rng.standard_normal((200, 6)), flight) < 1.15
    # Each value four times over: n values are worth n/4.
    repeated = np.repeat(rng.standard_normal((50, 6)), 4, axis=0)
    assert correlation_time(repeated, flight) == pytest.approx(4.0, rel=0.25)


@pytest.mark.parametrize(("chi", "sigma"), [(0.5, 0.01), (0.99, 0.02), (1.0, 0.02), (0.01, 0.02), (0.0, 0.05)])
def test_intervals_of_chi_stay_between_its_bounds(chi: float, sigma: float) -> None:
    low, high = profile_interval(chi, sigma, (0.0, 1.0), lambda x: ((x - chi) / sigma) ** 2)
    assert 0.0 <= low <= chi <= high <= 1.0
    # Where χ² is a parabola, profile and covariance agree but for the bounds.
    assert low == pytest.approx(max(0.0, chi - 1.96 * sigma), abs=1e-4)
    assert high == pytest.approx(min(1.0, chi + 1.96 * sigma), abs=1e-4)


def lying(rotation: np.ndarray, height_m: float, omega_rad_s: float = 0.0) -> Track:
    times = np.arange(20) / 1500.0
    turns = quat_from_rotvec(np.outer(times, [0.0, 0.0, omega_rad_s]))
    quaternions = quat_multiply(turns, quat_from_matrix(rotation))
    positions = np.tile([0.0, 0.0, height_m], (20, 1))
    return Track(np.arange(20), times, positions, quaternions, np.tile(np.eye(6), (20, 1, 1)), np.full(20, TRACKED))


def test_a_die_that_lies_flat_and_still_has_landed() -> None:
    upside_down = np.diag([1.0, -1.0, -1.0])
    assert resting_face(lying(np.eye(3), 0.008), CUBE) == 6
    assert resting_face(lying(upside_down, 0.008), CUBE) == 1


def test_a_die_that_turns_hangs_or_is_seen_for_a_moment_has_not() -> None:
    assert resting_face(lying(np.eye(3), 0.008, omega_rad_s=5.0), CUBE) is None
    assert resting_face(lying(np.eye(3), 0.02), CUBE) is None
    track = lying(np.eye(3), 0.008)
    assert resting_face(replace(track, status=np.where(track.frame < 5, TRACKED, "lost")), CUBE) is None


def test_moved_states_are_displaced_in_world_axes() -> None:
    state = random_release(CUBE, np.random.default_rng(9))
    change = 1e-3 * np.arange(1.0, 13.0)
    moved: State = moved_state(state, change)
    assert rotation_between(state.quaternion, moved.quaternion) == pytest.approx(change[3:6])
    assert moved.velocity_m_s - state.velocity_m_s == pytest.approx(change[6:9])
