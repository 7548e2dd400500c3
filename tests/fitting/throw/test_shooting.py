"""Laws of single shooting: no step of a fit leaves the states that the model resolves."""

from __future__ import annotations

import numpy as np
import pytest
from random_throws import DICE, random_quaternion

from diethrow.fitting.throw.shooting import displacement_bounds
from diethrow.model.throw import propagate
from diethrow.model.throw.body import packed_state
from diethrow.model.throw.motion import State, rotated_state
from diethrow.tracking.flights.single_flights import perturbed


@pytest.mark.parametrize("speed_m_s", [0.0, 3.0, 1e7])
def test_every_displacement_within_the_bounds_is_a_state_that_the_model_takes(speed_m_s: float) -> None:
    rng = np.random.default_rng(4)
    state = State(0.0, rng.normal(size=3), random_quaternion(rng), speed_m_s * np.ones(3), 30.0 * rng.normal(size=3))
    low, high = displacement_bounds(state, np.zeros(1))
    for bound in (low, high):
        moved = perturbed(state, np.where(np.isfinite(bound), bound, 0.0))
        packed_state(moved)
        packed_state(rotated_state(moved, random_quaternion(rng)))


def test_no_step_leads_beyond_what_frames_can_tell() -> None:
    """A throw from miles above the table that spins hundreds of millions of times a second cannot be followed."""
    state = State(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([30.0, -20.0, 10.0]))
    low, high = displacement_bounds(state, np.array([0.0, 0.0, 0.002, 0.004, 0.008]))
    assert high[:3] == pytest.approx(100.0)
    assert high[6:9] == pytest.approx(1.0 / 0.002)
    assert high[9:] == pytest.approx(2.0 * np.pi / 0.002)
    assert (low == -high).all()


def test_the_farthest_step_can_be_followed() -> None:
    die = DICE["cube"]
    times_s = np.arange(100) / 1500.0
    state = State(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    _, high = displacement_bounds(state, times_s)
    moved = perturbed(state, np.where(np.isfinite(high), high, 0.0))
    assert np.isfinite(propagate(die, moved, 0.5, times_s, vertices=[0, 3] * 15).positions_m).all()
