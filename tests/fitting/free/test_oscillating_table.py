"""Laws of an oscillating table: found from the bounces, used where the scene states it, not detected where it is at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import FPS, random_release, roughly_measured, seen

from diethrow.fitting.estimation.observations import flight_observations
from diethrow.fitting.free.flights import fit_flights
from diethrow.fitting.free.oscillating_table import TABLE_MOTION, table_motion_candidates
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL, SmoothImpact, Table
from diethrow.model.throw.motion import Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.track import Track

CUBE = make_die("cube", 0.016, 0.0048)
SHAKEN = Table(amplitude_m=1.1e-3, frequency_hz=34.0, phase_rad=0.4)


def thrown_on(table: Table, seed: int) -> tuple[Track, Throw]:
    """Track and measured throw through five bounces."""
    rng = np.random.default_rng(seed)
    whole = throw_die(CUBE, random_release(CUBE, rng), SmoothImpact(0.6), until=Until(impacts=5), table=table).throw
    last = whole.flights[-1]
    end_s = min(last.end_s, last.start.time_s + 60 / FPS)
    throw = Throw((*whole.flights[:-1], replace(last, end_s=end_s)), whole.impacts)
    return seen(throw, rng), roughly_measured(throw, rng)


@pytest.mark.parametrize("seed", [5, 7])
def test_the_motion_of_a_table_is_found_without_a_statement_of_the_scene(seed: int) -> None:
    fit = fit_throw(*thrown_on(SHAKEN, seed), CUBE)
    assert fit.chosen == ("smooth impact", "oscillating table")
    assert fit.bounces_fitted == 5
    truths = {"chi": 0.6, **dict(zip(TABLE_MOTION, (1.1e-3, 34.0, 0.4), strict=True))}
    for name, truth in truths.items():
        found = fit.parameters[name]
        assert found.value is not None
        assert found.low is not None
        assert found.high is not None
        # Twice the width of the 95 % interval: one in ten thousand lies outside.
        assert abs(found.value - truth) < found.high - found.low


def test_a_motion_stated_by_the_scene_needs_no_parameter() -> None:
    fit = fit_throw(*thrown_on(SHAKEN, 5), CUBE, SHAKEN)
    assert fit.chosen == ("smooth impact", "oscillating table")
    assert set(fit.parameters) == {"chi"}
    chi = fit.parameters["chi"]
    assert chi.low is not None
    assert chi.high is not None
    assert abs(0.6 - 0.5 * (chi.low + chi.high)) < chi.high - chi.low
    assert fit.bounces_fitted == 5


@pytest.mark.parametrize("seed", range(5))
def test_bounces_on_a_table_at_rest_show_no_motion(seed: int) -> None:
    track, measured = thrown_on(LEVEL, seed)
    assert (
        table_motion_candidates(CUBE, fit_flights(flight_observations(track, measured), measured), measured.impacts)
        == []
    )


def test_three_bounces_are_too_few_to_detect_a_motion() -> None:
    track, measured = thrown_on(SHAKEN, 5)
    free = fit_flights(flight_observations(track, measured), measured)
    assert table_motion_candidates(CUBE, free, measured.impacts[:3]) == []
