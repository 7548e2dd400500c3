"""Laws of estimation: observations and their weights, the robust loss, compressed equations, and intervals."""

from __future__ import annotations

import numpy as np
import pytest
from throws import random_release, seen, true_throw

from diethrow.fitting.estimation.intervals import profile_interval
from diethrow.fitting.estimation.least_squares import (
    HUBER_THRESHOLD,
    compressed,
    huber,
    levenberg_marquardt,
    triangular_factor,
)
from diethrow.fitting.estimation.observations import flight_observations, whiteners
from diethrow.model.die.die import make_die

CUBE = make_die("cube", 0.016, 0.0048)


def test_frames_within_half_an_interval_of_an_impact_are_left_out() -> None:
    rng = np.random.default_rng(1)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.58, impacts=2)
    observations = flight_observations(seen(throw, rng), throw)
    for impact in throw.impacts:
        assert np.abs(observations.time_s - impact.time_s).min() >= 0.5 / 1500.0


def test_singular_and_missing_covariances_give_no_whitener() -> None:
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
        return float((huber(offset + matrix @ x, matrix, HUBER_THRESHOLD)[0] ** 2).sum())

    residuals, jacobian = huber(offset, matrix, HUBER_THRESHOLD)
    assert ((offset**2).sum(1) > HUBER_THRESHOLD).any()
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        slope = (loss(step) - loss(-step)) / 2e-6
        assert 2.0 * np.einsum("ni,ni->", residuals, jacobian[:, :, k]) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("rows", [3, 13, 200])
def test_compressed_rows_keep_all_squares_and_products(rows: int) -> None:
    rng = np.random.default_rng(rows)
    jacobian, residuals = rng.standard_normal((rows, 12)), rng.standard_normal(rows)
    whole = np.column_stack([jacobian, residuals])
    rows_left = compressed(residuals, jacobian)
    assert rows_left.shape == (13, 13)
    assert rows_left.T @ rows_left == pytest.approx(whole.T @ whole, abs=1e-12)
    root = triangular_factor(jacobian)
    assert np.tril(root, -1) == pytest.approx(0.0)
    assert (np.diag(root) >= 0.0).all()


@pytest.mark.parametrize(("chi", "sigma"), [(0.5, 0.01), (0.99, 0.02), (1.0, 0.02), (0.01, 0.02), (0.0, 0.05)])
def test_intervals_of_chi_stay_between_its_bounds(chi: float, sigma: float) -> None:
    low, high = profile_interval(chi, sigma, (0.0, 1.0), lambda x: ((x - chi) / sigma) ** 2)
    assert 0.0 <= low <= chi <= high <= 1.0
    # Where χ² is a parabola, profile and covariance agree but for the bounds.
    assert low == pytest.approx(max(0.0, chi - 1.96 * sigma), abs=1e-4)
    assert high == pytest.approx(min(1.0, chi + 1.96 * sigma), abs=1e-4)


def test_a_descent_stops_at_a_bound_and_solves_for_the_rest() -> None:
    """Least squares of two correlated unknowns, of which the unbounded solution has the first below its bound."""
    matrix, target = np.array([[2.0, 1.0], [1.0, 2.0], [0.0, 1.0]]), np.array([-3.0, 1.0, 2.0])

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return matrix @ x - target, matrix

    x = levenberg_marquardt(evaluate, np.eye(2), np.array([-0.5, -np.inf]), np.array([np.inf, np.inf]))
    rest = np.linalg.lstsq(matrix[:, 1:], target + 0.5 * matrix[:, 0], rcond=None)[0]
    assert np.linalg.lstsq(matrix, target, rcond=None)[0][0] < -0.5
    assert x == pytest.approx([-0.5, rest[0]], abs=1e-12)


def test_an_unknown_that_does_not_move_and_is_beyond_its_bound_by_rounding_harms_nothing() -> None:
    def evaluate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[1:] - 1.0, np.array([[0.0, 1.0]])

    x = levenberg_marquardt(evaluate, np.eye(2), np.array([1e-18, -np.inf]), np.array([np.inf, np.inf]))
    assert x == pytest.approx([0.0, 1.0], abs=1e-12)
