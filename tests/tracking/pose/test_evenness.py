"""Laws of the evenness of poses: they scatter about a flight as their errors say, or lie on none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, studio

from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec
from diethrow.model.throw.motion import Flight, State
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.pose.evenness import log_scatter


def poses_of(
    flight: Flight, times_s: np.ndarray, sigma_m: float, sigma_rad: float, rng: np.random.Generator
) -> ClipPoses:
    """Poses of a flight with errors of these standard deviations, which they state."""
    poses = ClipPoses.empty(len(times_s))
    poses.known[:] = True
    for k, time_s in enumerate(times_s.tolist()):
        state = flight.at(time_s)
        turn = matrix_from_quat(quat_from_rotvec(sigma_rad * rng.standard_normal(3)))
        poses.position_m[k], poses.rotation[k] = (
            state.position_m + sigma_m * rng.standard_normal(3),
            turn @ state.rotation,
        )
    poses.H[:, range(6), range(6)] = [sigma_m**-2] * 3 + [sigma_rad**-2] * 3
    return poses


def test_the_scatter_about_a_flight_is_that_of_the_stated_errors() -> None:
    """Of honest poses its logarithm is 0 within its own error, and of poses whose errors are larger by a factor that of the
    factor."""
    view, times_s = studio().view(DICE["cube"]), np.arange(16) / 500.0
    release = State(
        0.0, np.array([0.0, 0.0, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.2, 0.1, -0.3]), np.ones(3)
    )
    flight, rows = Flight(replace(release, omega_rad_s=np.array([20.0, -30.0, 10.0])), np.inf), np.arange(16)
    for factor in (1.0, 4.0):
        found = []
        for k in range(40):
            poses = poses_of(flight, times_s, factor * 3e-4, factor * 0.02, np.random.default_rng([6, k]))
            poses.H *= factor**2
            found.append(log_scatter(view, poses, times_s, rows))
        # A sum of 84 squares has a relative standard deviation of 0.15, its root half of that; below 0 none is counted.
        assert np.mean(found) == pytest.approx(np.log(factor), abs=0.05)


def test_poses_that_an_impact_parts_lie_on_no_flight() -> None:
    view, times_s, rng = studio().view(DICE["cube"]), np.arange(16) / 500.0, np.random.default_rng(2)
    still = State(
        0.0, np.array([0.0, 0.0, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.2, 0.1, -0.3]), np.ones(3)
    )
    before = poses_of(Flight(still, np.inf), times_s, 3e-4, 0.02, rng)
    turned = replace(Flight(still, np.inf).at(8 / 500.0), omega_rad_s=np.array([60.0, 0.0, 0.0]))
    behind = poses_of(Flight(turned, np.inf), times_s, 3e-4, 0.02, rng)
    before.take(np.arange(9, 16), behind)
    assert log_scatter(view, before, times_s, np.arange(8)) < 0.4
    assert log_scatter(view, before, times_s, np.arange(9, 16)) < 0.4
    assert log_scatter(view, before, times_s, np.arange(16)) > 1.0


def test_pictures_that_leave_a_direction_open_say_nothing_of_the_scatter() -> None:
    view, times_s = studio().view(DICE["cube"]), np.arange(8) / 500.0
    still = State(0.0, np.array([0.0, 0.0, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.ones(3))
    poses = poses_of(Flight(still, np.inf), times_s, 3e-4, 0.02, np.random.default_rng(0))
    poses.H[:, 5, 5] = 0.0
    assert log_scatter(view, poses, times_s, np.arange(8)) == 0.0
