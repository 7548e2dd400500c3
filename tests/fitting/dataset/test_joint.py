"""Laws of joint fits: shared parameters of simulated throws are found, with the effects that those throws have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from intervals import assert_inside
from throws import FPS, random_release, seen

from diethrow.fitting.dataset.data_set import Entry, entry_of
from diethrow.fitting.dataset.flight_evidence import clock_from_flights, offset_from_flights, with_flight_effects
from diethrow.fitting.dataset.joint_fit import JointFit, fit_jointly
from diethrow.fitting.dataset.search import Spread
from diethrow.fitting.predict.prediction import simulated_poses
from diethrow.fitting.throw.physics import CENTRE_OF_MASS, Physics
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw.simulate import Until
from diethrow.tracking.track import TRACKED, Track

CUBE = make_die("cube", 0.016, 0.0048)
TRUTH = {"chi": 0.45, "mu": 0.25}
LOAD_TRUTH = dict(zip(CENTRE_OF_MASS, (2e-4, 0.0, 8e-4), strict=True))
COUNT = 10


def entries(values: dict[str, float], *, scatter: float = 0.0, noise: float = 0.2, count: int = COUNT) -> list[Entry]:
    rng = np.random.default_rng(5)
    found = []
    for k in range(count):
        own = {**values, "chi": values["chi"] + scatter * rng.standard_normal()}
        release = random_release(CUBE, rng)
        throw = Physics(CUBE, LEVEL, own).throw(release, Until(time_s=0.16)).throw
        found.append(entry_of(f"throw_{k}", seen(throw, rng, noise=noise), CUBE))
    return found


@pytest.fixture(scope="module")
def frictional_fit() -> JointFit:
    return fit_jointly(entries(TRUTH), CUBE, threads=2, effects=("friction", "clock", "rounded corners"))


def test_shared_parameters_come_back_within_their_intervals(frictional_fit: JointFit) -> None:
    assert [effect.name for effect in frictional_fit.chosen] == ["friction"]
    for name, value in TRUTH.items():
        # The bootstrap of ten throws is a tenth too narrow; a correct method does not miss twice the interval.
        assert_inside(frictional_fit, name, value, 0.02)


def test_an_effect_without_evidence_is_refused_with_a_reason(frictional_fit: JointFit) -> None:
    clock = next(effect for effect in frictional_fit.considered if effect.name == "clock")
    assert clock.why_not is not None
    assert clock.why_not.startswith("The flights before the first bounce show none: clock_scale 1")
    assert "clock_scale" not in frictional_fit.parameters
    radius = next(effect for effect in frictional_fit.considered if effect.name == "rounded corners")
    assert radius.why_not is not None
    assert "left out of the fit" in radius.why_not


def test_minima_are_reported_with_their_cost_the_best_first(frictional_fit: JointFit) -> None:
    costs = [minimum.cost_m for minimum in frictional_fit.minima]
    assert costs == sorted(costs)
    best = frictional_fit.minima[0].physics.values
    assert best == {name: parameter.value for name, parameter in frictional_fit.parameters.items()}


def test_the_spread_of_halves_has_the_covariance_of_its_draws() -> None:
    rng, truth = np.random.default_rng(0), np.array([[4.0, -1.8], [-1.8, 1.0]])
    draws = rng.multivariate_normal(np.zeros(2), truth, 4000)
    spread = Spread(("a", "b"), np.zeros(2), draws, np.zeros((2, 2)), 12, 60)
    np.testing.assert_allclose(spread.covariance, truth, atol=0.2)
    assert spread.trade_offs(0.8) == [("a", "b", pytest.approx(-0.9, abs=0.02))]
    assert spread.trade_offs(0.95) == []
    # Student's t of 12 degrees of freedom.
    np.testing.assert_allclose(spread.half_widths(0.95), 2.179 * np.sqrt(np.diag(truth)), rtol=0.03)


def test_the_scatter_of_chi_between_throws_is_estimated(frictional_fit: JointFit) -> None:
    assert frictional_fit.chi_scatter is not None
    assert frictional_fit.chi_scatter < 0.01
    scattered = fit_jointly(entries(TRUTH, scatter=0.05, count=12), CUBE, threads=2, effects=("friction",))
    assert scattered.chi_scatter is not None
    # A median deviation of twelve has a relative error of a third.
    assert 0.02 < scattered.chi_scatter < 0.1


def test_throws_without_friction_need_no_effect() -> None:
    fit = fit_jointly(entries({"chi": 0.6}, count=6), CUBE, threads=2, effects=("friction",))
    assert fit.chosen == ()
    assert fit.parameters["chi"].value == pytest.approx(0.6, abs=0.005)


def test_threads_do_not_change_the_result() -> None:
    some = entries({"chi": 0.6}, count=3)
    one, two = (fit_jointly(some, CUBE, threads=n, effects=()) for n in (1, 2))
    assert one.parameters == two.parameters


def loaded_entries(count: int) -> list[Entry]:
    """Throws with friction of a die whose centre of mass lies 0.8 mm off, on frames with little noise."""
    rng, found = np.random.default_rng(8), []
    physics = Physics(CUBE, LEVEL, {**TRUTH, **LOAD_TRUTH})
    times = np.arange(0, 240) / FPS
    for k in range(count):
        positions, quaternions = simulated_poses(physics, random_release(CUBE, rng), times)
        noisy = positions + 3e-6 * rng.standard_normal(positions.shape)
        turned = quat_multiply(quat_from_rotvec(2e-4 * rng.standard_normal(positions.shape)), quaternions)
        status = np.full(len(times), TRACKED)
        track = Track(np.arange(len(times)), times, noisy, turned, np.full((len(times), 6, 6), np.nan), status)
        found.append(entry_of(f"throw_{k}", track, CUBE))
    return found


def test_a_loaded_die_is_found_by_its_flights_and_by_the_joint_fit() -> None:
    throws = loaded_entries(8)
    truth = np.array(list(LOAD_TRUTH.values()))
    # Some 70 frames of 3 µs in each flight, through half a turn: 0.05 mm.
    shown = offset_from_flights(throws, Physics(CUBE, LEVEL, {"chi": 0.5}))
    assert shown.values == pytest.approx(truth, abs=5e-5)
    assert (np.abs(shown.values - truth) < 4.0 * np.sqrt(np.diag(shown.covariance))).all()
    fit = fit_jointly(throws, CUBE, threads=2, effects=("friction", "loaded die"))
    assert {effect.name for effect in fit.chosen} == {"friction", "loaded die"}
    for name, value in LOAD_TRUTH.items():
        assert fit.parameters[name].value == pytest.approx(value, abs=5e-5)
    assert fit.parameters["mu"].value == pytest.approx(TRUTH["mu"], abs=0.02)


def test_a_track_that_cannot_be_fitted_is_named() -> None:
    track = entries(TRUTH, count=1)[0].track
    with pytest.raises(ValueError, match="toss_7: the die never bounces"):
        entry_of("toss_7", replace(track, status=np.where(track.time_s < 0.01, track.status, "lost")), CUBE)
    with pytest.raises(ValueError, match="1 throws"):
        fit_jointly(entries(TRUTH, count=1), CUBE)


def test_free_fall_measures_the_clock() -> None:
    right, physics = entries(TRUTH), Physics(CUBE, LEVEL, {"chi": 0.5})
    found = clock_from_flights(right, physics)
    error = float(np.sqrt(found.covariance[0, 0]))
    assert abs(found.values[0] - 1.0) < 4.0 * error < 0.02
    slow = [entry_of(e.name, replace(e.track, time_s=e.track.time_s / 1.05), CUBE) for e in right]
    assert clock_from_flights(slow, physics).values[0] == pytest.approx(1.05, abs=0.01)
    with_clock, estimates, accepted, refused = with_flight_effects(slow, physics, ("clock",), lambda k: 5.0)
    assert with_clock.clock == pytest.approx(1.05, abs=0.01)
    assert "clock_scale" in with_clock.held
    assert [effect.name for effect in accepted] == list(estimates) == ["clock"]
    assert refused == []
