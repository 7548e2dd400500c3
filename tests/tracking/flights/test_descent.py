"""Parts of the compiled descent, against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from throws import BRICK

from diethrow.model.die.die import make_die
from diethrow.model.rotations import quat_from_rotvec
from diethrow.model.throw.motion import Flight, State, turning_of
from diethrow.tracking.flights import descent
from diethrow.tracking.flights.single_flights import packed, spin_rates


@njit
def median(values, begin, end):  # type: ignore[no-untyped-def]
    return descent._median(values, begin, end, np.empty(len(values)))


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 1000, 1001])
@pytest.mark.parametrize("kind", ["normal", "few values", "sorted", "all equal"])
def test_the_median_is_numpys(count: int, kind: str) -> None:
    rng = np.random.default_rng(count)
    values = {
        "normal": rng.normal(size=count + 5),
        "few values": rng.integers(0, 3, count + 5).astype(float),
        "sorted": np.arange(count + 5.0),
        "all equal": np.ones(count + 5),
    }[kind]
    before = values.copy()
    assert median(values, 3, 3 + count) == np.median(values[3 : 3 + count])
    np.testing.assert_array_equal(values, before)


def test_the_spin_of_a_body_without_torque_changes_as_eulers_equations_say() -> None:
    """Against differences along the motion."""
    rng = np.random.default_rng(1)
    turning = turning_of(BRICK)
    for _ in range(20):
        state = State(
            0.1, rng.normal(size=3), quat_from_rotvec(rng.normal(size=3)), rng.normal(size=3), 60.0 * rng.normal(size=3)
        )
        (found,) = spin_rates(turning, packed(state)[None])
        flight, step_s = Flight(state, np.inf, turning=turning), 1e-6
        behind, ahead = flight.rates(np.array([0.1 - step_s, 0.1 + step_s]))[:, 3:]
        np.testing.assert_allclose(found, (ahead - behind) / (2.0 * step_s), rtol=1e-5, atol=1e-2)


def test_the_spin_of_a_cube_stays() -> None:
    state = State(0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([3.0, 4.0, 5.0]))
    assert not spin_rates(turning_of(make_die("cube", 0.02, 0.016)), packed(state)[None]).any()
