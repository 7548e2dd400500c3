"""A die that hops is not at rest, although one camera hardly sees its height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import random_release, seen, true_throw

from diethrow.model.die import Die, make_die
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw import State
from diethrow.tracking.flights import WeightedPoses
from diethrow.tracking.throw import measurement
from diethrow.tracking.throw.measurement import NoFlightError, measure_throw
from diethrow.tracking.throw.rest import SupportedMotion, first_supported_row

ICOSAHEDRON = make_die("icosahedron", 0.011, 0.0036)
CUBE = make_die("cube", 0.0106, 0.0015)
HOP_FPS = 490.0
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


@pytest.mark.parametrize("sigma_m", [5e-6, 2e-5])
def test_hops_of_ten_frames_are_flights_to_the_last(sigma_m: float) -> None:
    """Windows of eight frames across an impact follow no motion: about half of all. Where most had to follow one, a quarter of
    these dice were at rest from the first hop on."""
    for seed in range(THROWS):
        frames, rest_s = even_hops(seed, sigma_m)
        first = first_supported_row(frames, CUBE)
        # What remains may be too short to show that the table carries the die.
        assert first == len(frames) or abs(frames.time_s[first] - rest_s) * HOP_FPS < 8.0


def test_a_flight_behind_hops_too_short_to_be_tested_is_found() -> None:
    """A hop of 24 frames shows its fall, but not over eight frames or sixteen. Where the first length of window that decided any
    was the last, and each twice as long as the one before, the table carried most of these dice from the first hop on."""
    durations, fps = np.array([1.5, 3.5, 5.0, 24.0]), 2250.0
    early = []
    for seed in range(THROWS):
        frames, rest_s = hops_of(durations, seed, sigma_m=2e-5, fps=fps, frames=110, spin_rad_s=20.0)
        first = first_supported_row(frames, CUBE)
        early.append(first < len(frames) and (frames.time_s[first] - rest_s) * fps < -8.0)
    assert np.mean(early) <= 0.1


def even_hops(seed: int, sigma_m: float) -> tuple[WeightedPoses, float]:
    """Frames of a cube that hops seven times, always as high."""
    return hops_of(np.full(7, 10.0), seed, sigma_m=sigma_m, fps=HOP_FPS, frames=94, spin_rad_s=60.0)


def hops_of(
    durations_frames: np.ndarray, seed: int, *, sigma_m: float, fps: float, frames: int, spin_rad_s: float
) -> tuple[WeightedPoses, float]:
    """Frames of a cube that hops, turns one way and the other about the vertical, and then lies; and the instant [s] from which
    it does."""
    rng = np.random.default_rng([11, seed])
    hop_s = durations_frames / fps
    begin_s = np.append(0.0, np.cumsum(hop_s))
    time_s = (np.arange(frames) + rng.uniform()) / fps
    hop = np.minimum(np.searchsorted(begin_s, time_s, side="right") - 1, len(hop_s))
    flies = hop < len(hop_s)
    since_s = np.where(flies, time_s - begin_s[hop], 0.0)
    height_m = CUBE.solid.inradius + 0.5 * 9.81 * since_s * np.where(flies, np.append(hop_s, 0.0)[hop] - since_s, 0.0)
    sign = np.where(np.arange(len(hop_s)) % 2 == 0, 1.0, -1.0)
    turned_at_begin = spin_rad_s * np.append(0.0, np.cumsum(sign * hop_s))
    turned = turned_at_begin[hop] + spin_rad_s * np.append(sign, 0.0)[hop] * since_s
    position = np.stack([0.3 * np.minimum(time_s, begin_s[-1]), 0.0 * time_s, height_m], axis=1)
    quaternion = quat_from_rotvec(turned[:, None] * np.array([0.0, 0.0, 1.0]))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = sigma_m**2 * np.eye(3) + 2e-3**2 * np.outer(SIGHT, SIGHT)
    covariance[3:, 3:] = (1e-2 * np.radians(sigma_m * 1e6)) ** 2 * np.eye(3)
    errors = rng.multivariate_normal(np.zeros(6), covariance, len(time_s))
    poses = position + errors[:, :3], quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternion)
    return WeightedPoses.from_poses(time_s, *poses, np.tile(covariance, (len(time_s), 1, 1))), float(begin_s[-1])


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


def test_a_supported_die_moves_as_its_frames_show() -> None:
    """A cube that rolls ever more slowly until it lies still: velocity and spin are the derivatives of its poses, not a fall."""
    time_s = 0.2 + np.arange(200) / 1000.0
    left_s = np.maximum(0.35 - time_s, 0.0)
    angle = 100.0 * left_s**2
    quaternion = quat_from_rotvec(angle[:, None] * [0.0, 1.0, 0.0])
    position = np.stack([0.01 * angle, np.zeros(200), np.full(200, 0.005)], axis=1)
    start = State(0.19, position[0], quaternion[0], np.zeros(3), np.zeros(3))
    moving = SupportedMotion(start, 0.4, times_s=time_s, positions_m=position, quaternions=quaternion)
    some_s = np.linspace(0.21, 0.39, 37)
    rates = moving.rates(some_s)
    spin_rad_s = -200.0 * np.maximum(0.35 - some_s, 0.0)
    # A mean over five milliseconds departs by 0.13 rad/s where the die comes to lie, and nowhere else.
    assert rates[:, 4] == pytest.approx(spin_rad_s, abs=0.2)
    assert rates[:, 0] == pytest.approx(0.01 * spin_rad_s, abs=2e-3)
    np.testing.assert_allclose(rates[:, [1, 2, 3, 5]], 0.0, atol=1e-9)
    np.testing.assert_array_equal(rates[some_s > 0.36], 0.0)
    (here_m, here), (there_m, there) = moving.poses(some_s - 1e-3), moving.poses(some_s + 1e-3)
    assert rates[:, :3] == pytest.approx((there_m - here_m) / 2e-3, abs=2e-3)
    assert rates[:, 3:] == pytest.approx(rotation_between(here, there) / 2e-3, abs=0.2)
    assert moving.at(0.3).omega_rad_s == pytest.approx([0.0, -10.0, 0.0], abs=1e-6)
    np.testing.assert_array_equal(moving.rates([0.1, 0.5]), 0.0)
