"""Laws of the impacts of a track, and of the track smoothed between them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE
from numpy.typing import NDArray
from random_throws import random_quaternion
from throws import BRICK, FPS, random_release, seen, true_throw

from diethrow.model.die.die import Die, make_die
from diethrow.model.rotations import angle_between, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import Flight, Impact, State, Throw
from diethrow.tracking.flights.single_flights import perturbed
from diethrow.tracking.throw.measurement import NoFlightError, measure, measure_throw
from diethrow.tracking.throw.smoothing import smooth
from diethrow.tracking.track import ABSENT, LOST, TRACKED, Track

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.016, 0.0048)
FAR_APART_S = 8.0 / FPS
"""Impacts with fewer frames between them share a flight too short to be judged one by one."""


def spaced(throw: Throw) -> bool:
    """Whether every flight lasts for some frames, so that impacts are separate."""
    ends = [f.end_s for f in throw.flights]
    return all(np.diff([0.0, *[i.time_s for i in throw.impacts], ends[-1]]) > FAR_APART_S)


def separate_impacts(die: Die, seed: int, count: int) -> tuple[Throw, np.random.Generator]:
    """A throw with separate impacts, of the first such seed from `seed` on."""
    while True:
        rng = np.random.default_rng(seed)
        throw = true_throw(die, random_release(die, rng), 0.6, impacts=count)
        if spaced(throw):
            return throw, rng
        seed += 1000


@cache
def measured() -> list[tuple[Throw, Throw]]:
    """True and measured throws of four dice, two impacts each."""
    pairs = []
    for die in (DICE["tetrahedron"], DICE["cube"], DICE["icosahedron"], BRICK):
        for seed in range(6):
            throw, rng = separate_impacts(die, seed, 2)
            pairs.append((throw, measure_throw(seen(throw, rng), die)))
    return pairs


def matches() -> list[tuple[Impact, Impact]]:
    """True and found impacts, those that are resolved."""
    pairs = [pair for true, found in measured() for pair in zip(true.impacts, found.impacts, strict=True)]
    return [(true, found) for true, found in pairs if found.contact != "unresolved"]


def test_every_impact_is_found_and_no_other() -> None:
    for true, found in measured():
        assert len(found.impacts) == len(true.impacts)
        for a, b in zip(found.impacts, true.impacts, strict=True):
            # Frames of 0.1 degrees and 0.02 mm determine an instant to a few hundredths of a frame, that of a weak impact less
            # well; an unresolved one only lies between two frames.
            assert abs(a.time_s - b.time_s) * FPS < (1.0 if a.contact == "unresolved" else 0.2)


def test_separate_impacts_are_resolved_and_their_vertex_is_named() -> None:
    # One throw in some fifty is left open to be safe.
    assert len(matches()) >= 2 * len(measured()) - 2
    assert all(found.contact == "vertex" and found.vertices == true.vertices for true, found in matches())


def test_the_standard_error_of_an_instant_is_true() -> None:
    z = np.array([(found.time_s - true.time_s) / found.sigma_time_s for true, found in matches()])
    # 34 squared normals: 1 ± 0.24, and less because the fit allows each frame more than its own sigma.
    assert 0.3 < (z**2).mean() < 1.7
    assert np.abs(z).max() < 4.0


def test_the_interval_of_the_restitution_covers_it() -> None:
    inside = np.array([found.chi_low <= 0.6 <= found.chi_high for _, found in matches()])
    # 95 % of 34: fewer than 29 would happen once in a hundred times.
    assert inside.sum() >= len(inside) - 5
    assert all(found.chi_low < found.chi < found.chi_high for _, found in matches())


def test_energies_and_velocities_are_those_of_the_throw() -> None:
    for true, found in matches():
        velocities = [found.normal_velocity_before_m_s, found.normal_velocity_after_m_s]
        wanted = [true.normal_velocity_before_m_s, true.normal_velocity_after_m_s]
        # A flight of eight frames or more determines the velocity of a corner to about 1 cm/s.
        np.testing.assert_allclose(velocities, wanted, atol=0.05)
        assert found.energy_before_J == pytest.approx(true.energy_before_J, rel=0.03)
        assert found.energy_after_J == pytest.approx(true.energy_after_J, rel=0.03)
        np.testing.assert_allclose(found.point_m, true.point_m, atol=2e-4)


@pytest.mark.parametrize("period", [6.0, 9.0])
def test_a_flight_on_which_few_of_its_frames_lie_is_not_believed(period: float) -> None:
    """A die that wobbles instead of flying: frames keep their own poses, and the contact before them names no vertex."""
    throw, rng = separate_impacts(CUBE, 2, 2)
    track = seen(throw, rng)
    last = np.flatnonzero(track.tracked)[-12:]
    assert throw.impacts[1].time_s < track.time_s[last[4]]
    turns = np.radians(3.0) * np.sin(2.0 * np.pi * np.arange(12) / period)
    quaternion = track.quaternion.copy()
    quaternion[last] = quat_multiply(quat_from_rotvec(turns[:, None] * [0.6, 0.0, 0.8]), quaternion[last])
    track = replace(track, quaternion=quaternion)
    found = measure(track, CUBE)
    assert [impact.contact for impact in found.throw.impacts] == ["vertex", "unresolved"]
    behind = track.time_s > found.throw.impacts[1].time_s
    smoothed = smooth(found.frames, found.throw_without_shared_errors, found.shared_covariance, found.unexplained)
    np.testing.assert_array_equal(smoothed.quaternion[behind], found.frames.quaternion[behind])


def free_flight(seed: int) -> tuple[Throw, np.random.Generator]:
    """Eighty frames of a flight whose lowest corner is soon nearer to the table than a corner of a bouncing die."""
    rng = np.random.default_rng(seed)
    omega = 40.0 * rng.normal(size=3)
    lowest = np.array([0.0, 0.0, CUBE.solid.circumradius + 0.001])
    upwards = State(0.03, lowest, random_quaternion(rng), np.array([0.2, 0.1, 0.0]), omega)
    start = Flight(replace(upwards, velocity_m_s=np.array([0.2, 0.1, -0.1])), np.inf).at(0.01)
    return Throw((Flight(replace(start, time_s=0.0), 80 / FPS),), ()), rng


@pytest.mark.parametrize("seed", range(20))
def test_free_flight_near_the_table_is_no_impact(seed: int) -> None:
    throw, rng = free_flight(seed)
    assert measure_throw(seen(throw, rng), CUBE).impacts == ()


@pytest.mark.parametrize("seed", range(5))
def test_a_slowly_drifting_pose_is_no_impact(seed: int) -> None:
    # Marks that move over the edges shift a pose by a few sigmas and back.
    throw, rng = free_flight(seed)
    track = seen(throw, rng)
    wave = 3.0 * np.sin(2.0 * np.pi * track.time_s * FPS / 40.0)[:, None]
    aside = track.position_m + wave * np.array([2e-5, -1e-5, 2e-5])
    rotated = quat_multiply(quat_from_rotvec(wave * np.radians([0.1, 0.05, -0.1])), track.quaternion)
    assert measure_throw(replace(track, position_m=aside, quaternion=rotated), CUBE).impacts == ()


@pytest.mark.parametrize("kept", [0, 1, 2])
def test_fewer_than_three_frames_are_no_flight(kept: int) -> None:
    throw, rng = free_flight(0)
    track = seen(throw, rng)
    status = np.where(np.arange(len(track)) < kept, TRACKED, LOST)
    with pytest.raises(NoFlightError, match=rf"{kept} frames? (is|are) tracked: wanted at least three"):
        measure_throw(replace(track, status=status), CUBE)


def kicked(throw: Throw, gap_frames: float) -> Throw:
    """The first impact followed by another upward impulse some frames later."""
    before, bounce = throw.flights[0], throw.impacts[0]
    middle = throw.flights[1]
    again_s = bounce.time_s + gap_frames / FPS
    touch = middle.at(again_s)
    kick = np.zeros(12)
    kick[8:] = [0.3, 15.0, -10.0, 5.0]
    last = Flight(perturbed(touch, kick), again_s + 40 / FPS)
    return Throw((before, replace(middle, end_s=again_s), last), (bounce, replace(bounce, time_s=again_s)))


@pytest.mark.parametrize("seed", range(4))
def test_two_contacts_within_a_frame_are_never_two_impacts_at_wrong_instants(seed: int) -> None:
    throw, rng = separate_impacts(CUBE, 40 + seed, 1)
    twice = kicked(throw, 0.5)
    impacts = measure_throw(seen(twice, rng), CUBE).impacts
    assert len(impacts) in (1, 2)
    for impact in impacts:
        # One instant for both, or one that nearly joins the flights, lies within a frame of them.
        assert min(abs(impact.time_s - i.time_s) for i in twice.impacts) < 1.0 / FPS


@cache
def bounced() -> tuple[Throw, Track, Throw]:
    """A cube's true throw, its track with gaps, and the throw measured from it."""
    throw, rng = separate_impacts(CUBE, 70, 1)
    track = seen(throw, rng)
    status = track.status.copy()
    middle = len(track) // 4
    status[:3], status[middle : middle + 4], status[-2:] = ABSENT, LOST, LOST
    values = [track.position_m.copy(), track.quaternion.copy(), track.covariance.copy()]
    for value in values:
        value[status != TRACKED] = np.nan
    track = replace(track, position_m=values[0], quaternion=values[1], covariance=values[2], status=status)
    return throw, track, measure_throw(track, CUBE)


def test_smoothing_puts_every_pose_on_its_own_flight() -> None:
    _, track, found = bounced()
    smoothed = smooth(track, found)
    p, q = found.poses(smoothed.time_s)
    use = smoothed.tracked
    np.testing.assert_array_equal(smoothed.position_m[use], p[use])
    np.testing.assert_allclose(np.abs((smoothed.quaternion[use] * q[use]).sum(1)), 1.0, atol=1e-12)


def test_smoothing_keeps_the_jump_of_the_velocity() -> None:
    true, track, found = bounced()
    smoothed = smooth(track, found)
    t = true.impacts[0].time_s
    after = int(np.searchsorted(track.time_s, t))
    up, down = slice(after, after + 4), slice(after - 4, after)
    slopes = [np.diff(smoothed.position_m[side, 2]).mean() * FPS for side in (down, up)]
    wanted = [true.at(float(track.time_s[side].mean())).velocity_m_s[2] for side in (down, up)]
    # Over the frames on one side the slope is the flight's own; a filter across the impact would halve the jump.
    np.testing.assert_allclose(slopes, wanted, atol=0.02)


def test_frames_lost_within_a_flight_are_filled_and_no_others() -> None:
    true, track, found = bounced()
    smoothed = smooth(track, found)
    middle = len(track) // 4
    assert (smoothed.status[middle : middle + 4] == TRACKED).all()
    assert (smoothed.status[:3] == ABSENT).all()
    assert (smoothed.status[-2:] == LOST).all()
    assert np.isnan(smoothed.position_m[[0, 1, 2, -2, -1]]).all()
    p, q = true.poses(track.time_s)
    gap = slice(middle, middle + 4)
    # A flight of some forty frames at 0.1 degrees and 0.02 mm across, 0.15 mm along the sight, determines its middle well.
    np.testing.assert_allclose(smoothed.position_m[gap], p[gap], atol=2e-4)
    assert np.degrees(angle_between(smoothed.quaternion[gap], q[gap])).max() < 0.2


def test_no_frame_is_filled_towards_one_that_its_flight_does_not_explain() -> None:
    _, track, found = bounced()
    middle = len(track) // 4
    status, excluded = track.status.copy(), np.zeros(len(track), bool)
    status[6:middle], excluded[3:6] = LOST, True
    smoothed = smooth(replace(track, status=status), found, excluded=excluded)
    assert (smoothed.status[6 : middle + 4] == LOST).all()
    assert (smooth(replace(track, status=status), found).status[6 : middle + 4] == TRACKED).all()


def test_smoothing_reduces_errors_and_standard_errors_of_every_frame() -> None:
    true, track, found = bounced()
    smoothed = smooth(track, found)
    p, q = true.poses(track.time_s)
    use = track.tracked
    for axis in range(6):
        before, after = (np.sqrt(t.covariance[use, axis, axis]) for t in (track, smoothed))
        assert np.median(after) < 0.6 * np.median(before)
    off = [np.linalg.norm(t.position_m[use] - p[use], axis=1) for t in (track, smoothed)]
    rotated = [angle_between(t.quaternion[use], q[use]) for t in (track, smoothed)]
    for before, after in (off, rotated):
        assert np.median(after) < 0.6 * np.median(before)


def test_the_covariance_of_a_smoothed_pose_is_true_at_every_distance_from_the_middle() -> None:
    nees = []
    for seed in range(12):
        throw, rng = separate_impacts(CUBE, 200 + seed, 1)
        track = seen(throw, rng)
        smoothed = smooth(track, measure_throw(track, CUBE))
        p, q = throw.poses(smoothed.time_s)
        errors = np.concatenate([p - smoothed.position_m, rotation_between(smoothed.quaternion, q)], axis=1)
        rows = [0, len(p) // 4, -1]
        nees.append([e @ np.linalg.solve(C, e) for e, C in zip(errors[rows], smoothed.covariance[rows], strict=True)])
    # Twelve throws: the mean of chi-square with six numbers is 6 ± 1, and two thirds of it because the fit allows each
    # frame more than its own sigma. The first frame's covariance given to all would make it 1.4 in the middle and 9.6 at
    # the end.
    assert (np.mean(nees, axis=0) > 2.0).all()
    assert (np.mean(nees, axis=0) < 7.5).all()


def test_smoothing_leaves_the_single_frames_as_they_were() -> None:
    _, track, found = bounced()
    kept = track.position_m.copy()
    smooth(track, found)
    np.testing.assert_array_equal(track.position_m, kept)


def test_a_track_without_a_pose_is_smoothed_to_itself() -> None:
    _, track, found = bounced()
    empty = replace(track, status=np.full(len(track), ABSENT, dtype="<U7"))
    assert smooth(empty, found) is empty


@pytest.mark.parametrize("seed", range(4))
def test_a_flight_through_frames_of_two_labellings_is_not_believed(seed: int) -> None:
    """High above the table no impact explains the change, and one flight has to pass through all frames. Their errors then seem
    as large as the change; nevertheless the frames keep their own poses."""
    throw, rng = free_flight(seed)
    track = seen(throw, rng)
    quaternion, half = track.quaternion.copy(), len(track) // 2
    quaternion[half:] = quat_multiply(quaternion[half:], quat_from_rotvec([0.0, 0.0, np.pi / 2]))
    high = track.position_m + np.array([0.0, 0.0, 0.2])
    found = measure(replace(track, quaternion=quaternion, position_m=high), CUBE)
    assert found.unexplained[track.tracked].all()
    np.testing.assert_array_equal(found.smoothed_frames.position_m[track.tracked], high[track.tracked])
