"""What residuals show: variance and correlation of the frames, how a parameter draws on them, and the misfit of a law."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from diethrow.fitting.estimation.residual_errors import ResidualErrors, not_below, residual_errors
from diethrow.tracking.flights import ErrorModel

Array = NDArray[np.float64]

FPS = 1500.0


def correlated(rng: np.random.Generator, flights: int, frames: int, over: float) -> Array:
    """Errors (flights frames, 6) of unit variance, correlated over so many frames within each flight."""
    keep = np.exp(-1.0 / over)
    errors = rng.standard_normal((flights, frames, 6))
    for k in range(1, frames):
        errors[:, k] = keep * errors[:, k - 1] + np.sqrt(1.0 - keep**2) * errors[:, k]
    return errors.reshape(-1, 6)


def frames_of(flights: int, frames: int) -> tuple[Array, NDArray[np.int64]]:
    return np.arange(flights * frames) / FPS, np.repeat(np.arange(flights), frames)


def test_white_errors_as_stated_widen_nothing_much() -> None:
    rng = np.random.default_rng(5)
    found = [residual_errors(rng.standard_normal((240, 6)), *frames_of(4, 60), 0) for _ in range(20)]
    assert np.mean([one.variance for one in found]) == pytest.approx(1.0, abs=0.03)
    assert np.median([one.scale for one in found]) < 1.15


@pytest.mark.parametrize("over", [2.0, 5.0, 10.0])
def test_the_long_run_variance_of_correlated_errors_is_found(over: float) -> None:
    """(1 + φ)/(1 - φ) times that of one frame, though the lines through the flights have absorbed a part of it; a fifth of it is
    not found where the correlation lasts a tenth of a flight."""
    rng, keep = np.random.default_rng(7), np.exp(-1.0 / over)
    found = [residual_errors(correlated(rng, 4, 100, over), *frames_of(4, 100), 0) for _ in range(20)]
    ratios = np.array([one.variance * one.correlation_time for one in found]) * (1.0 - keep) / (1.0 + keep)
    assert np.exp(np.log(ratios).mean()) == pytest.approx(1.0, abs=0.2)


def test_the_variance_of_a_parameter_is_that_of_its_sum_over_the_frames() -> None:
    rng = np.random.default_rng(2)
    model = ErrorModel(rng.uniform(0.5, 1.5, 6), rng.uniform(0.0, 4.0, 6), rng.uniform(1.0, 9.0, 6) / FPS)
    (time_s, flight), gains = frames_of(3, 8), rng.standard_normal((24, 6, 4))
    wanted = np.zeros((4, 4))
    for k in range(6):
        slow = model.variance_ratio[k] * np.exp(-abs(time_s[:, None] - time_s) / model.correlation_time_s[k])
        covariance = model.scale[k] ** 2 * (np.eye(24) + slow * (flight[:, None] == flight))
        wanted += gains[:, k].T @ covariance @ gains[:, k]
    found = ResidualErrors(model, 1.0 / FPS, 1.7).variance_of(gains, time_s, flight)
    np.testing.assert_allclose(found, 1.7 * wanted, rtol=1e-12)


def test_a_difference_of_neighbours_suffers_less_from_slow_errors_than_a_mean() -> None:
    model = ErrorModel(np.full(6, 0.3), np.full(6, 10.0), np.full(6, 8.0 / FPS))
    errors, (time_s, flight) = ResidualErrors(model, 1.0 / FPS, 1.0), frames_of(1, 40)
    mean, difference = np.zeros((40, 6, 1)), np.zeros((40, 6, 1))
    mean[:, 0, 0], difference[:2, 0, 0] = 1.0 / 40, (-1.0, 1.0)
    white = errors.variance * np.array([1.0 / 40, 2.0])
    found = [float(errors.variance_of(gains, time_s, flight)[0, 0]) for gains in (mean, difference)]
    assert found[0] > 8.0 * white[0]
    assert found[1] < 0.3 * white[1]


def test_innovations_are_white_and_make_the_errors_again() -> None:
    rng = np.random.default_rng(9)
    model = ErrorModel(np.full(6, 0.2), np.full(6, 24.0), np.full(6, 5.0 / FPS))
    errors, (time_s, flight) = ResidualErrors(model, 1.0 / FPS, 1.0), frames_of(4, 300)
    drawn = errors.errors_of(rng.standard_normal((1200, 6)), time_s, flight)
    assert drawn.var() == pytest.approx(1.0, rel=0.1)
    innovations = errors.innovations(drawn, time_s, flight)
    assert innovations.var() == pytest.approx(1.0, rel=0.03)
    assert abs((innovations[1:] * innovations[:-1]).mean()) < 0.04
    np.testing.assert_allclose(errors.errors_of(innovations, time_s, flight), drawn, atol=1e-12)


def test_flights_that_differ_from_the_law_by_more_than_their_errors_show_a_misfit() -> None:
    """Offsets of three standard errors of a flight's mean, in each of six components of six flights: ten times the variance in
    one of the two numbers of each, of which the mean is 5.5."""
    rng, (time_s, flight) = np.random.default_rng(11), frames_of(6, 80)
    offsets = 3.0 / np.sqrt(80) * rng.standard_normal((6, 6))
    found = [
        residual_errors(rng.standard_normal((480, 6)) + offsets[flight], time_s, flight, 0).misfit for _ in range(10)
    ]
    assert np.mean(found) == pytest.approx(1.0 + 0.5 * 80 * (offsets**2).mean(), rel=0.25)
    assert residual_errors(rng.standard_normal((480, 6)), time_s, flight, 0).misfit < 1.4


def test_correlated_errors_that_are_stated_as_larger_independent_ones_widen_nothing() -> None:
    rng = np.random.default_rng(3)
    errors, (time_s, flight) = correlated(rng, 4, 500, 9.5), frames_of(4, 500)
    # A mean over n frames has the variance (1 + φ)/((1 - φ) n) = 19/n.
    for stated, wanted in ((1.0, 19.0), (np.sqrt(19.0), 1.0), (19.0, 1.0)):
        assert residual_errors(errors / stated, time_s, flight, 0).scale == pytest.approx(wanted, rel=0.35)


@pytest.mark.parametrize("size", [0.0, 1e-160, 1e-9, 1e9])
def test_residuals_of_any_size_have_a_finite_error_model(size: float) -> None:
    rng, (time_s, flight) = np.random.default_rng(6), frames_of(2, 30)
    found = residual_errors(size * rng.standard_normal((60, 6)), time_s, flight, 13)
    assert np.isfinite([found.variance, found.correlation_time, found.misfit, found.scale]).all()
    assert found.scale == (1.0 if size < 1.0 else pytest.approx(found.variance * found.correlation_time * found.misfit))
    assert np.isfinite(found.innovations(size * rng.standard_normal((60, 6)), time_s, flight)).all()


@pytest.mark.parametrize("frames", [1, 2, 3, 9])
def test_flights_of_few_frames_are_taken_as_stated(frames: int) -> None:
    rng = np.random.default_rng(8)
    found = residual_errors(rng.standard_normal((2 * frames, 6)), *frames_of(2, frames), 13)
    assert (found.variance, found.correlation_time) == (1.0, 1.0)


def test_no_direction_of_a_covariance_falls_below_what_the_frames_state() -> None:
    rng = np.random.default_rng(4)
    root = np.triu(rng.standard_normal((5, 5))) + 4.0 * np.eye(5)
    stated = np.linalg.inv(root.T @ root)
    axes = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    half = np.linalg.solve(root, axes)
    found = not_below(half @ np.diag([0.2, 0.9, 1.0, 3.0, 7.0]) @ half.T, root)
    excess = np.sort(np.linalg.eigvalsh(root @ found @ root.T))
    np.testing.assert_allclose(excess, [1.0, 1.0, 1.0, 3.0, 7.0], rtol=1e-9)
    assert np.linalg.eigvalsh(found - stated)[0] > -1e-12
