"""Laws of single shooting: no step of a fit leaves the states that the model resolves."""

from __future__ import annotations

import numpy as np
import pytest
from random_throws import random_quaternion

from diethrow.fitting.throw.shooting import displacement_bounds
from diethrow.model.throw.body import packed_state
from diethrow.model.throw.motion import State, rotated_state
from diethrow.tracking.flights.single_flights import perturbed


@pytest.mark.parametrize("speed_m_s", [0.0, 3.0, 1e7])
def test_every_displacement_within_the_bounds_is_a_state_that_the_model_takes(speed_m_s: float) -> None:
    rng = np.random.default_rng(4)
    state = State(0.0, rng.normal(size=3), random_quaternion(rng), speed_m_s * np.ones(3), 30.0 * rng.normal(size=3))
    low, high = displacement_bounds(state)
    for bound in (low, high):
        moved = perturbed(state, np.where(np.isfinite(bound), bound, 0.0))
        packed_state(moved)
        packed_state(rotated_state(moved, random_quaternion(rng)))
