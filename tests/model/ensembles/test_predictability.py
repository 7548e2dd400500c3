"""Uncertainty exponents and measures of known basins, and of a die."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from diethrow.model.die.die import make_die
from diethrow.model.ensembles.basins import Axis, Window, final_configurations
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.ensembles.predictability import (
    JACKKNIFE_GROUPS,
    fairness_by_dynamics,
    final_state_sensitivity,
    uncertainty_exponent,
)
from diethrow.model.laws import SmoothImpact

Array = NDArray[np.float64]

WINDOW = Window(Axis("z0", 0.1, 0.4, 24), Axis("omega_eta", 0.0, 50.0, 30))
TETRAHEDRON = ThrowSetup(make_die("tetrahedron", 0.040793, 0.016), SmoothImpact(0.2))


def halves(points: Array) -> NDArray[np.int64]:
    """A smooth boundary: a circle."""
    return 1 + (((points - 0.5) ** 2).sum(1) < 0.09).astype(np.int64)


def cantor(points: Array) -> NDArray[np.int64]:
    """Gaps of the middle-third Cantor set, by the parity of the step at which they were cut out."""
    x, label = points[:, 0].copy(), np.zeros(len(points), np.int64)
    for step in range(40):
        x *= 3.0
        digit = np.floor(x)
        label[(label == 0) & (digit == 1)] = 1 + step % 2
        x -= digit
    return np.where(label == 0, 1, label)


def test_a_smooth_boundary_has_uncertainty_exponent_1() -> None:
    sensitivity = final_state_sensitivity(halves, [0, 0], [1, 1], np.logspace(-3.5, -1.5, 9), conditions=40_000, seed=5)
    exponent = uncertainty_exponent(sensitivity)
    assert exponent is not None
    assert exponent.standard_error < 0.03
    assert abs(exponent.value - 1.0) < 3 * exponent.standard_error + 0.01  # the circle is not straight at 0.03
    assert exponent.boundary_dimension == 2.0 - exponent.value
    # f is the area of the points within ε of the circle along either axis: 2 ε times the two projections, less overlap.
    assert sensitivity.shares[0].interval[0] < 2.4 * np.sqrt(2) * 10**-3.5 < sensitivity.shares[0].interval[1] * 1.1


def test_the_cantor_set_has_its_known_exponent() -> None:
    # Sizes over whole periods of 1/3, in which f of this basin is a power of ε times a periodic function of log ε.
    sizes = 3.0 ** -np.arange(3.0, 11.0, 0.25)
    exponent = uncertainty_exponent(final_state_sensitivity(cantor, [0], [1], sizes, conditions=60_000, seed=2))
    assert exponent is not None
    # D = ln 2/ln 3 in one dimension; 0.02 for the range, which does not hold a whole number of periods of every size.
    assert abs(exponent.value - (1.0 - np.log(2) / np.log(3))) < 3 * exponent.standard_error + 0.02
    assert exponent.standard_error < 0.03


def test_sensitivity_does_not_depend_on_threads_and_gives_the_deciding_size() -> None:
    one = final_state_sensitivity(halves, [0, 0], [1, 1], [1e-3, 1e-2, 0.1, 1.0], conditions=2000, seed=3)
    three = final_state_sensitivity(halves, [0, 0], [1, 1], [1.0, 1e-3, 1e-2, 0.1], conditions=2000, seed=3, threads=3)
    np.testing.assert_array_equal(one.uncertain, three.uncertain)
    np.testing.assert_array_equal(one.decided, three.decided)
    assert one.decided.sum() == JACKKNIFE_GROUPS * one.conditions >= 2000
    # At most 2 × 1.2 × 2 ε of the square lies as near as that to the circle, along either axis.
    assert one.deciding_epsilon(0.9) == 1e-2
    assert one.deciding_epsilon(0.99) == 1e-3
    # Even at 1e-3, some 0.3 % lie across.
    assert one.deciding_epsilon(0.9999) is None


def test_without_a_boundary_there_is_no_exponent() -> None:
    def all_alike(points: Array) -> NDArray[np.int64]:
        return np.ones(len(points), np.int64)

    sensitivity = final_state_sensitivity(all_alike, [0, 0], [1, 1], [1e-3, 1e-2, 1e-1], conditions=100)
    assert uncertainty_exponent(sensitivity) is None
    assert sensitivity.deciding_epsilon(1.0) == 0.1


def test_measures_of_balls_are_areas() -> None:
    ball = fairness_by_dynamics(halves, [0.8, 0.5], [1.0, 1.0], 2, [1e-4, 0.05], throws=20_000, seed=1)
    assert ball.counts.sum(1).tolist() == [20_000, 20_000]
    # On the circle a small ball is cut in halves; 5 standard errors of a share of one half.
    assert np.abs(ball.measures[0] - 0.5).max() < 5 * 0.5 / np.sqrt(20_000)
    assert ball.p_value[0] > 1e-4
    away = fairness_by_dynamics(halves, [0.1, 0.1], [1.0, 1.0], 2, [0.05], throws=200)
    assert away.counts.tolist() == [[200, 0]]
    # All on one of two: χ² = n exactly.
    assert away.chi_square.tolist() == [200.0]
    assert away.p_value[0] < 1e-40


def test_what_lands_on_no_face_has_no_measure() -> None:
    def none(points: Array) -> NDArray[np.int64]:
        return np.full(len(points), -3)

    ball = fairness_by_dynamics(none, [0.0], [1.0], 6, [0.1], throws=50)
    assert ball.none.tolist() == [50]
    assert np.isnan(ball.measures).all()
    assert ball.chi_square.tolist() == [0.0]


def test_sizes_of_zero_raise() -> None:
    with pytest.raises(ValueError, match="epsilons"):
        final_state_sensitivity(halves, [0, 0], [1, 1], [1e-3, 0.0])


def test_a_throw_at_small_restitution_is_predictable_as_the_paper_defines_it() -> None:
    # Few bounces, so that basins are open sets: at 1e-6 of the window nearly every neighbour lands on the same face.
    setup = ThrowSetup(TETRAHEDRON.die, SmoothImpact(0.05))

    def outcome(points: Array) -> NDArray[np.int64]:
        return final_configurations(setup, WINDOW, points)

    sensitivity = final_state_sensitivity(outcome, [0.1, 0.0], [0.4, 50.0], [1e-6], conditions=256)
    assert sensitivity.shares[0].value < 0.02
