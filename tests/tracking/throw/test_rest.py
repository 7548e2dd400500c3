"""A die that hops is not at rest, although one camera hardly sees its height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import random_release, seen, true_throw

from diethrow.model.die import Die, make_die
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.tracking.flights import WeightedPoses
from diethrow.tracking.throw import measurement
from diethrow.tracking.throw.measurement import NoFlightError, measure_throw
from diethrow.tracking.throw.rest import first_supported_row

ICOSAHEDRON = make_die("icosahedron", 0.011, 0.0036)
OCTAHEDRON = make_die("octahedron", 0.0154, 0.0036)
FPS = 250.0
THROWS = 20
DEPTH_SIGMA_M = 4e-3
"""Of single frames of a small, well-rounded die."""
SIGHT = np.array([0.3, 0.84, -0.45]) / np.linalg.norm([0.3, 0.84, -0.45])


def hopping(seed: int) -> WeightedPoses:
    """Frames of seven hops of five to fifteen frames, and of the flight after them."""
    return hops(ICOSAHEDRON, seed, spin_rad_s=20.0, chi=0.75, impacts=7)


def hops(
    die: Die,
    seed: int,
    *,
    spin_rad_s: float,
    chi: float,
    impacts: int,
    depth_sigma_m: float = DEPTH_SIGMA_M,
    turn_sigma_deg: float = 0.2,
    above_m: float = 0.006,
) -> WeightedPoses:
    """Frames of a die that is thrown down from a little above the table."""
    rng = np.random.default_rng(seed)
    low = np.array([0.0, 0.0, die.solid.circumradius + above_m])
    release = random_release(die, rng, spin_rad_s=spin_rad_s)
    release = replace(release, position_m=low, velocity_m_s=np.array([0.1, 0.0, -0.1]))
    throw = true_throw(die, release, chi, impacts=impacts)
    time_s = np.arange(0.0, throw.flights[-1].end_s, 1.0 / FPS)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 2e-5**2 * np.eye(3) + depth_sigma_m**2 * np.outer(SIGHT, SIGHT)
    covariance[3:, 3:] = np.radians(turn_sigma_deg) ** 2 * np.eye(3)
    errors = rng.multivariate_normal(np.zeros(6), covariance, len(time_s))
    position, quaternion = throw.poses(time_s)
    return WeightedPoses.from_poses(
        time_s,
        position + errors[:, :3],
        quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternion),
        np.tile(covariance, (len(time_s), 1, 1)),
    )


def test_hops_that_the_errors_of_heights_hide_are_flights() -> None:
    """Their mean height is level, and so is their mean fall. Without a test of what lies between, half of them were at rest."""
    at_rest = [first_supported_row(frames, ICOSAHEDRON) < len(frames) for frames in map(hopping, range(THROWS))]
    assert np.mean(at_rest) <= 0.15


def test_a_die_that_tumbles_too_fast_to_stay_on_the_table_flies() -> None:
    """Its heights err by more than it hops, and flights of fifteen frames do not show the fall. Where the spin was not looked at,
    a quarter of these were at rest."""
    thrown = (
        hops(
            OCTAHEDRON,
            seed,
            spin_rad_s=120.0,
            chi=0.8,
            impacts=3,
            depth_sigma_m=9e-3,
            turn_sigma_deg=1.0,
            above_m=0.012,
        )
        for seed in range(THROWS)
    )
    assert all(first_supported_row(frames, OCTAHEDRON) == len(frames) for frames in thrown)


def test_an_impact_behind_the_last_frame_in_flight_ends_the_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such an impact is part of coming to rest; the flights before it had the same frames again, without end."""
    rng = np.random.default_rng(3)
    throw = true_throw(ICOSAHEDRON, random_release(ICOSAHEDRON, rng), 0.6, impacts=1)
    track = seen(throw, rng)
    late = replace(throw.impacts[0], time_s=float(track.time_s[-1]) + 1.0)
    monkeypatch.setattr(measurement, "_impacts", lambda *arguments: (late,))
    monkeypatch.setattr(measurement, "_count_to_last_rebound", lambda impacts, low_s: 0)
    with pytest.raises(NoFlightError, match="show the die in flight"):
        measure_throw(track, ICOSAHEDRON, every=8)
