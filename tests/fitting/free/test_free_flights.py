"""Laws of free flights: their derivatives, and the errors of frames that they show."""

from __future__ import annotations

import numpy as np
import pytest
from throws import random_release, roughly_measured, seen, true_throw

from diethrow.fitting.estimation.observations import flight_observations
from diethrow.fitting.free.flights import fit_flights
from diethrow.model.die.die import make_die
from diethrow.model.rotations import quat_from_rotvec, rotation_between
from diethrow.model.throw.motion import Flight, State
from diethrow.tracking.flights.single_flights import left_jacobians, perturbed, pose_jacobian

CUBE = make_die("cube", 0.016, 0.0048)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.99e-3, 1.01e-3, 0.3, 3.0], ids=str)
def test_the_left_jacobian_is_the_derivative_of_the_exponential(angle: float) -> None:
    v = angle * np.array([0.6, -0.48, 0.64])
    step = 1e-6
    for k in range(3):
        d = step * np.eye(3)[k]
        moved = rotation_between(quat_from_rotvec(v - d), quat_from_rotvec(v + d)) / (2.0 * step)
        # Rounding of a quaternion over the step: 1e-16/1e-6.
        assert left_jacobians(v[None])[0, :, k] == pytest.approx(moved, abs=3e-9)


def test_the_pose_jacobian_is_the_derivative_of_the_poses() -> None:
    state = random_release(CUBE, np.random.default_rng(0))
    times = np.array([-0.01, 0.0, 0.04])
    jacobian = pose_jacobian(Flight(state, 1.0), times)
    for k, step in enumerate(np.repeat([1e-6, 1e-6, 1e-5, 1e-4], 3)):
        change = step * np.eye(12)[k]
        ends = [Flight(perturbed(state, sign * change), 1.0).poses(times) for sign in (-1.0, 1.0)]
        moved = np.hstack([ends[1][0] - ends[0][0], rotation_between(ends[0][1], ends[1][1])]) / (2.0 * step)
        assert jacobian[:, :, k] == pytest.approx(moved, abs=1e-8)


def test_perturbeds_are_displaced_in_world_axes() -> None:
    state = random_release(CUBE, np.random.default_rng(9))
    change = 1e-3 * np.arange(1.0, 13.0)
    moved: State = perturbed(state, change)
    assert rotation_between(state.quaternion, moved.quaternion) == pytest.approx(change[3:6])
    assert moved.velocity_m_s - state.velocity_m_s == pytest.approx(change[6:9])


def test_free_flights_measure_the_variance_of_the_frames() -> None:
    rng = np.random.default_rng(1)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.58, impacts=2)
    track, measured = seen(throw, rng, stated=0.5), roughly_measured(throw, rng)
    free = fit_flights(flight_observations(track, measured), measured)
    # From the medians of some 100 frames: the variance is known to 15 %.
    assert free.variance == pytest.approx(4.0, rel=0.3)
    assert free.outliers == 0
