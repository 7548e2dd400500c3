"""Of the states that are tried on the other side of an impact, one lies near the true one."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from random_throws import DICE, state_difference
from throws import random_release, true_throw

from diethrow.model.throw import Flight
from diethrow.tracking.quality import STANDARD
from diethrow.tracking.sequence.impact_trials import TRIAL_SPACING_RAD, beyond_impacts, different_rates

THROWS = 25
NEAR_RAD = 1.25 * TRIAL_SPACING_RAD
"""Half a spacing of restitutions, and half the turn that an instant off by half a share leaves, on either side."""
NEAR_EDGES = 0.12


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("fps", [240.0, 1500.0])
@pytest.mark.parametrize("shape", ["cube", "tetrahedron", "icosahedron"])
def test_one_trial_lies_near_the_state_beyond_a_smooth_impact(shape: str, fps: float, backwards: bool) -> None:
    die, rng = DICE[shape], np.random.default_rng(3)
    far = []
    for _ in range(THROWS):
        chi = rng.uniform(0.3, 0.8)
        release = random_release(die, rng, spin_rad_s=50.0)
        fast = replace(release, velocity_m_s=2.0 * release.velocity_m_s)
        throw = true_throw(die, fast, chi, impacts=1)
        before, after = throw.flights
        share = rng.uniform(0.05, 0.95)
        touch_s = throw.impacts[0].time_s
        earlier = Flight(before.start, np.inf).at(touch_s - (1.0 - share) / fps)
        later = Flight(after.start, np.inf).at(touch_s + share / fps)
        here, there = (later, earlier) if backwards else (earlier, later)
        trials = list(islice(beyond_impacts(die, here, there.time_s), STANDARD.max_hypotheses))
        assert all(trial.time_s == pytest.approx(there.time_s) for trial in trials)
        off = np.array([state_difference(there, trial) for trial in trials])
        near = np.linalg.norm(off[:, :3], axis=1) / die.solid.edge_m / NEAR_EDGES
        far.append(np.maximum(np.linalg.norm(off[:, 3:6], axis=1) / NEAR_RAD, near).min())
    assert np.mean(np.array(far) < 1.0) > 0.95, np.sort(far)[-5:]


def test_a_die_high_above_the_table_has_no_trials() -> None:
    die, rng = DICE["cube"], np.random.default_rng(1)
    release = random_release(die, rng)
    assert list(beyond_impacts(die, release, release.time_s + 1e-3)) == []


def test_rates_that_turn_the_die_alike_are_one() -> None:
    die, rng = DICE["cube"], np.random.default_rng(2)
    throw = true_throw(die, random_release(die, rng), 0.5, impacts=1)
    before = Flight(throw.flights[0].start, np.inf).at(throw.impacts[0].time_s - 1e-3)
    states = list(beyond_impacts(die, before, before.time_s + 1.0 / 240.0))
    rates = different_rates(states, 1.0 / 240.0)
    apart = np.linalg.norm(rates[:, None, 3:] - rates[None, :, 3:], axis=2) / 240.0
    assert 1 <= len(rates) < len(states)
    assert apart[~np.eye(len(rates), dtype=bool)].min(initial=np.inf) > 0.5 * TRIAL_SPACING_RAD
    assert different_rates([], 1.0).shape == (0, 6)
