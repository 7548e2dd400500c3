"""Laws of the measurement of single bounces: ratios of normal velocities and their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import random_release, roughly_measured, seen, true_throw

from diethrow.fitting.estimation.observations import flight_observations
from diethrow.fitting.free.flights import fit_flights
from diethrow.fitting.free.impulses import Bounce, apparent_restitution, common_restitution, fieller, measure_bounces
from diethrow.model.die.die import make_die
from diethrow.model.laws import CoulombImpact
from diethrow.model.throw.motion import Flight, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.flights.single_flights import perturbed

CUBE = make_die("cube", 0.016, 0.0048)
SIGMA = np.repeat([5e-6, 5e-4, 2e-3, 0.3], 3)


def one_bounce(seed: int = 0, chi: float = 0.6) -> Throw:
    rng = np.random.default_rng(seed)
    return true_throw(CUBE, random_release(CUBE, rng), chi, impacts=1)


def measured(flight: Flight, time_s: float, rng: np.random.Generator | None) -> Flight:
    """The flight with its state at this instant perturbed by errors of SIGMA, and their covariance."""
    state = flight.at(time_s)
    if rng is not None:
        state = perturbed(state, SIGMA * rng.standard_normal(12))
    return Flight(state, flight.end_s, np.diag(SIGMA**2))


def test_exact_flights_give_the_exact_ratio_and_impulse() -> None:
    throw = one_bounce()
    impact = throw.impacts[0]
    flights = (measured(throw.flights[0], impact.time_s, None), measured(throw.flights[1], impact.time_s, None))
    # An error of the measured instant by a tenth of a frame has no effect: the flight gives the touch.
    bounce = apparent_restitution(CUBE, *flights, impact.time_s + 6e-5, impact.vertices[0])
    assert bounce.chi == pytest.approx(0.6, abs=1e-9)
    assert bounce.time_s == pytest.approx(impact.time_s, abs=1e-10)
    assert bounce.impulse_N_s == pytest.approx(impact.impulse_N_s, abs=1e-9)
    assert bounce.smooth_sigmas == pytest.approx(0.0, abs=1e-5)
    assert bounce.energy_after_J == pytest.approx(impact.energy_after_J, rel=1e-9)


def test_the_interval_of_a_ratio_has_its_stated_coverage() -> None:
    throw, rng, held, squares = one_bounce(), np.random.default_rng(3), [], []
    impact = throw.impacts[0]
    for _ in range(60):
        flights = [measured(f, impact.time_s, rng) for f in throw.flights]
        bounce = apparent_restitution(CUBE, flights[0], flights[1], impact.time_s, impact.vertices[0])
        held.append(bounce.chi_low <= 0.6 <= bounce.chi_high)
        squares.append(bounce.smooth_sigmas**2)
    # Fewer than 53 of 60 at a true 95 % has odds of 1 in 100.
    assert sum(held) >= 53
    # The mean of 60 values of χ² with five degrees of freedom, over five, has a standard deviation of 0.08.
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("mu", [0.0, 0.2])
def test_intervals_of_friction_and_energy_have_their_stated_coverage(mu: float) -> None:
    rng = np.random.default_rng(4)
    law = CoulombImpact(0.5, mu)
    throw = throw_die(CUBE, random_release(CUBE, rng), law, until=Until(impacts=1)).throw
    impact = throw.impacts[0]
    impulse = impact.impulse_N_s
    ratio = float(np.hypot(impulse[0], impulse[1]) / impulse[2])
    lost = impact.energy_before_J - impact.energy_after_J
    held = np.zeros(2, int)
    for _ in range(100):
        flights = [measured(f, impact.time_s, rng) for f in throw.flights]
        bounce = apparent_restitution(CUBE, flights[0], flights[1], impact.time_s, impact.vertices[0])
        held += [
            bounce.impulse_ratio_low <= ratio <= bounce.impulse_ratio_high,
            bounce.energy_lost_low_J <= lost <= bounce.energy_lost_high_J,
        ]
    # Fewer than 89 of 100 at a true 95 % has odds of 1 in 200.
    assert held.min() >= 89


def test_flights_without_covariance_give_a_ratio_without_interval() -> None:
    throw = one_bounce()
    impact = throw.impacts[0]
    bounce = apparent_restitution(CUBE, *throw.flights, impact.time_s, impact.vertices[0])
    assert bounce.chi == pytest.approx(0.6)
    assert np.isnan(bounce.chi_low)
    assert np.isnan(bounce.smooth_sigmas)
    assert common_restitution([bounce]) is None


def test_a_velocity_that_may_be_zero_gives_no_bounded_interval() -> None:
    assert np.isnan(fieller(-0.01, 0.006, np.diag([0.01**2, 0.01**2]), 0.95)[0])
    low, high = fieller(-1.0, 0.6, np.diag([1e-6, 1e-6]), 0.95)
    # For small errors Fieller's bounds are the linear ones, χ ± 1.96 σ √(1 + χ²).
    assert (high - low) / 2.0 == pytest.approx(1.96e-3 * np.sqrt(1.36), rel=1e-3)


def test_a_variance_between_bounces_widens_their_common_interval() -> None:
    throw = one_bounce()
    impact = throw.impacts[0]
    flights = [measured(f, impact.time_s, None) for f in throw.flights]
    bounce = apparent_restitution(CUBE, flights[0], flights[1], impact.time_s, impact.vertices[0])

    def shifted(by: float) -> Bounce:
        return replace(bounce, chi=bounce.chi + by, chi_low=bounce.chi_low + by, chi_high=bounce.chi_high + by)

    alike = common_restitution([bounce, shifted(0.0), None, shifted(0.0)])
    unlike = common_restitution([shifted(-0.05), bounce, shifted(0.05)])
    assert alike is not None
    assert unlike is not None
    assert alike[2] - alike[1] == pytest.approx((bounce.chi_high - bounce.chi_low) / np.sqrt(3.0), rel=0.01)
    # Three values 0.05 apart: standard error 0.05/√3, Student's t with two degrees of freedom 4.30.
    assert (unlike[2] - unlike[1]) / 2.0 == pytest.approx(4.303 * 0.05 / np.sqrt(3.0), rel=0.05)
    assert unlike[0] == pytest.approx(bounce.chi)


def test_a_vertex_that_the_die_does_not_have_is_refused() -> None:
    throw = one_bounce()
    with pytest.raises(ValueError, match="vertex = 8"):
        apparent_restitution(CUBE, *throw.flights, throw.impacts[0].time_s, 8)


def test_a_ratio_measured_by_tracking_is_kept() -> None:
    rng = np.random.default_rng(0)
    throw = one_bounce(seed=2)
    rough = roughly_measured(throw, rng)
    with_interval = replace(rough.impacts[0], chi=0.61, chi_low=0.58, chi_high=0.64)
    without_interval = replace(rough.impacts[0], chi=0.61, chi_low=np.nan, chi_high=np.nan)
    free = fit_flights(flight_observations(seen(throw, rng), rough), rough)
    kept, own = (measure_bounces(CUBE, free, [impact])[0] for impact in (with_interval, without_interval))
    assert kept is not None
    assert own is not None
    assert (kept.chi, kept.chi_low, kept.chi_high) == (0.61, 0.58, 0.64)
    assert own.chi_low <= 0.6 <= own.chi_high
