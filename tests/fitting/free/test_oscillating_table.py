"""Laws of an oscillating table: found from the bounces, used where the scene states it, not detected where it is at rest."""

from __future__ import annotations

import pytest
from intervals import assert_inside
from throws import thrown

from diethrow.fitting.estimation.observations import flight_observations
from diethrow.fitting.free.flights import fit_flights
from diethrow.fitting.free.oscillating_table import TABLE_MOTION, table_motion_candidates
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import make_die
from diethrow.model.laws import LEVEL, SmoothImpact, Table

CUBE = make_die("cube", 0.016, 0.0048)
SHAKEN = Table(amplitude_m=1.1e-3, frequency_hz=34.0, phase_rad=0.4)


@pytest.mark.parametrize("seed", [5, 7])
def test_the_motion_of_a_table_is_found_without_a_statement_of_the_scene(seed: int) -> None:
    fit = fit_throw(*thrown(CUBE, SmoothImpact(0.6), seed, table=SHAKEN, impacts=5), CUBE)
    assert fit.chosen == ("smooth impact", "oscillating table")
    assert fit.bounces_fitted == 5
    for name, truth in zip(("chi", *TABLE_MOTION), (0.6, 1.1e-3, 34.0, 0.4), strict=True):
        assert_inside(fit, name, truth)


def test_a_motion_stated_by_the_scene_needs_no_parameter() -> None:
    fit = fit_throw(*thrown(CUBE, SmoothImpact(0.6), 5, table=SHAKEN, impacts=5), CUBE, SHAKEN)
    assert fit.chosen == ("smooth impact", "oscillating table")
    assert set(fit.parameters) == {"chi"}
    assert_inside(fit, "chi", 0.6)
    assert fit.bounces_fitted == 5


@pytest.mark.parametrize("seed", range(5))
def test_bounces_on_a_table_at_rest_show_no_motion(seed: int) -> None:
    track, measured = thrown(CUBE, SmoothImpact(0.6), seed, table=LEVEL, impacts=5)
    assert (
        table_motion_candidates(CUBE, fit_flights(flight_observations(track, measured), measured), measured.impacts)
        == []
    )


def test_three_bounces_are_too_few_to_detect_a_motion() -> None:
    track, measured = thrown(CUBE, SmoothImpact(0.6), 5, table=SHAKEN, impacts=5)
    free = fit_flights(flight_observations(track, measured), measured)
    assert table_motion_candidates(CUBE, free, measured.impacts[:3]) == []
