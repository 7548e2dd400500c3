"""Laws of sequential estimates: they become more certain with every bounce and end as the whole fit."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from throws import random_release, roughly_measured, seen, true_throw

from diethrow.fitting.predict.sequential import Estimate, physics_of_fit, sequential_estimates
from diethrow.fitting.results import Choices, Fit, IntervalMethod
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL
from diethrow.model.throw.motion import Throw
from diethrow.tracking.throw import frames_in_flight

CUBE = make_die("cube", 0.016, 0.0048)
CHI = 0.58


@pytest.fixture(scope="module")
def estimated() -> tuple[tuple[Estimate, ...], Fit, Throw]:
    rng = np.random.default_rng(2)
    throw = true_throw(CUBE, random_release(CUBE, rng), CHI, impacts=3)
    track, measured = seen(throw, rng), roughly_measured(throw, rng)
    fit = fit_throw(track, measured, CUBE)
    return sequential_estimates(track, measured, CUBE, fit), fit, measured


def test_each_bounce_has_one_estimate_at_its_instant(estimated: tuple[tuple[Estimate, ...], Fit, Throw]) -> None:
    found, fit, measured = estimated
    assert [estimate.bounces for estimate in found] == list(range(1, fit.bounces_fitted + 1))
    assert [e.time_s for e in found] == [impact.time_s for impact in measured.impacts[: fit.bounces_fitted]]


def test_the_last_estimate_is_that_of_the_whole_fit(estimated: tuple[tuple[Estimate, ...], Fit, Throw]) -> None:
    found, fit, _ = estimated
    assert found[-1].chi == fit.parameters["chi"]


@pytest.mark.parametrize("intervals", ["profile", "covariance"])
def test_an_estimate_is_that_of_a_fit_to_the_frames_so_far(intervals: IntervalMethod) -> None:
    rng = np.random.default_rng(2)
    throw = true_throw(CUBE, random_release(CUBE, rng), CHI, impacts=3)
    track, measured = seen(throw, rng), roughly_measured(throw, rng)
    fit = fit_throw(track, measured, CUBE, choices=Choices(intervals))
    found = sequential_estimates(track, measured, CUBE, fit)
    for estimate in found[:-1]:
        shorter = Throw(measured.flights[: estimate.bounces + 1], measured.impacts[: estimate.bounces])
        own = fit_throw(frames_in_flight(track, shorter), shorter, CUBE, choices=Choices(intervals))
        chi = own.parameters["chi"]
        assert chi.value is not None
        assert chi.high is not None
        assert chi.low is not None
        width = chi.high - chi.low
        assert estimate.chi.value == pytest.approx(chi.value, abs=0.1 * width)
        assert estimate.chi.low == pytest.approx(chi.low, abs=0.1 * width)
        assert estimate.chi.high == pytest.approx(chi.high, abs=0.1 * width)


def test_every_interval_holds_the_truth_and_none_is_wider_than_the_one_before(
    estimated: tuple[tuple[Estimate, ...], Fit, Throw],
) -> None:
    """Three 95 % intervals, with one seed: widened by a half: one in 300 misses."""
    widths = []
    for estimate in estimated[0]:
        low, high, value = estimate.chi.low, estimate.chi.high, estimate.chi.value
        assert low is not None
        assert high is not None
        assert value is not None
        margin = 0.25 * (high - low)
        assert low - margin <= CHI <= high + margin
        widths.append(high - low)
    assert all(later < earlier for earlier, later in pairwise(widths))


def test_odds_are_shares_of_all_faces(estimated: tuple[tuple[Estimate, ...], Fit, Throw]) -> None:
    for estimate in estimated[0]:
        if estimate.face_odds is not None:
            assert sum(estimate.face_odds.values()) == pytest.approx(1.0)
            assert set(estimate.face_odds) <= set(range(1, 7))


def test_a_throw_without_explained_bounces_has_no_estimate(estimated: tuple[tuple[Estimate, ...], Fit, Throw]) -> None:
    rng = np.random.default_rng(2)
    throw = true_throw(CUBE, random_release(CUBE, rng), CHI, impacts=1)
    assert sequential_estimates(seen(throw, rng), throw, CUBE, replace(estimated[1], bounces_fitted=0)) == ()


def test_the_physics_of_a_fit_has_its_values(estimated: tuple[tuple[Estimate, ...], Fit, Throw]) -> None:
    fit = estimated[1]
    assert physics_of_fit(fit, CUBE, LEVEL).values["chi"] == fit.parameters["chi"].value
