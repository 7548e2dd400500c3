"""Of the states that are tried on the other side of an impact, one lies near the true one."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from footage_of_throws import DICE as SEEN_DICE
from footage_of_throws import studio
from random_throws import DICE, random_quaternion, state_difference
from throws import random_release, true_throw

from diethrow.model.throw import Flight, State
from diethrow.model.world import GRAVITY_M_S2
from diethrow.tracking.frame_to_frame.impact_trials import (
    TRIAL_SPACING_RAD,
    beyond_impacts,
    different_rates,
    motion_of_poses,
)
from diethrow.tracking.picture import PARAMETERS, STATISTICS
from diethrow.tracking.pose import Pose
from diethrow.tracking.quality import STANDARD

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
        trials = list(islice(beyond_impacts(die, here, there.time_s, GRAVITY_M_S2), STANDARD.max_hypotheses))
        assert all(trial.time_s == pytest.approx(there.time_s) for trial in trials)
        off = np.array([state_difference(there, trial) for trial in trials])
        near = np.linalg.norm(off[:, :3], axis=1) / die.solid.edge_m / NEAR_EDGES
        far.append(np.maximum(np.linalg.norm(off[:, 3:6], axis=1) / NEAR_RAD, near).min())
    assert np.mean(np.array(far) < 1.0) > 0.95, np.sort(far)[-5:]


def test_a_die_high_above_the_table_has_no_trials() -> None:
    die, rng = DICE["cube"], np.random.default_rng(1)
    release = random_release(die, rng)
    assert list(beyond_impacts(die, release, release.time_s + 1e-3, GRAVITY_M_S2)) == []


def test_rates_that_turn_the_die_alike_are_one() -> None:
    die, rng = DICE["cube"], np.random.default_rng(2)
    throw = true_throw(die, random_release(die, rng), 0.5, impacts=1)
    before = Flight(throw.flights[0].start, np.inf).at(throw.impacts[0].time_s - 1e-3)
    states = list(beyond_impacts(die, before, before.time_s + 1.0 / 240.0, GRAVITY_M_S2))
    rates = different_rates(states, 1.0 / 240.0)
    apart = np.linalg.norm(rates[:, None, 3:] - rates[None, :, 3:], axis=2) / 240.0
    assert 1 <= len(rates) < len(states)
    assert apart[~np.eye(len(rates), dtype=bool)].min(initial=np.inf) > 0.5 * TRIAL_SPACING_RAD
    assert different_rates([], 1.0).shape == (0, 6)


def single_pose(state: State, cost: float) -> Pose:
    """A pose that one picture shows, as far as the motion needs it."""
    H, statistics = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(STATISTICS)
    sure, unbiased = 1e10 * np.eye(6), np.zeros((6, 1))
    return Pose(state.position_m, state.rotation, sure, unbiased, 0.0, 1.0, 1.0, 100.0, 0.0, cost, H, statistics)


def fast_flight(seed: int) -> Flight:
    """A die that turns by 60 degrees a frame at 240 frames per second."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    spin = np.radians(60.0) * 240.0 * axis / np.linalg.norm(axis)
    start = State(0.0, np.array([0.0, 0.0, 0.02]), random_quaternion(rng), rng.normal(scale=0.2, size=3), spin)
    return Flight(start, np.inf)


@pytest.mark.parametrize("shape", ["cube", "tetrahedron", "icosahedron"])
def test_of_the_poses_that_three_pictures_show_those_of_one_flight_give_the_motion(shape: str) -> None:
    """Wrong poses cost less on every picture, and lie on no flight."""
    view, times_s = studio().view(SEEN_DICE[shape]), np.arange(3) / 240.0
    for seed in range(5):
        flight, rng = fast_flight(seed), np.random.default_rng([7, seed])
        candidates = []
        for time_s in times_s:
            state = flight.at(float(time_s))
            wrong = replace(
                state, quaternion=random_quaternion(rng), position_m=state.position_m + rng.normal(scale=3e-3, size=3)
            )
            label = view.symmetries[rng.integers(len(view.symmetries))]
            relabelled = replace(single_pose(state, 3.0), rotation=state.rotation @ label)
            candidates.append([single_pose(wrong, 2.0), relabelled])
        found = motion_of_poses(view, times_s, candidates, 10.0)
        assert found is not None
        assert all(pose.cost == 3.0 for pose in found.poses)
        last = flight.at(float(times_s[-1]))
        np.testing.assert_allclose(found.motion[:3], last.position_m, atol=1e-6)
        np.testing.assert_allclose(found.motion[3:6], last.velocity_m_s, atol=1e-4)
        assert np.linalg.norm(found.motion[6:] - last.omega_rad_s) < 1e-6 * np.linalg.norm(last.omega_rad_s)


def test_poses_that_lie_on_two_flights_give_no_motion() -> None:
    view, times_s = studio().view(SEEN_DICE["tetrahedron"]), np.arange(3) / 240.0
    first, second = fast_flight(1), fast_flight(2)
    turned = Flight(
        replace(second.start, position_m=first.start.position_m, velocity_m_s=first.start.velocity_m_s), np.inf
    )
    candidates = [[single_pose(flight.at(float(t)), 2.0) for flight in (first, turned)] for t in times_s]
    assert motion_of_poses(view, times_s, candidates, 10.0) is None
    assert motion_of_poses(view, times_s, [some[:1] for some in candidates], 10.0) is not None
