"""A die in flight is a clock: steps of the frames' times are found and counted, and impacts are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from random_throws import DICE
from throws import FPS, blurred_in_time, random_release, seen, true_throw

from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.throw import weighted_poses
from diethrow.tracking.timing.motion_clock import StepKind, TimeStep, find_time_steps
from diethrow.tracking.track import Track

Rows = NDArray[np.int64]
CUBE = DICE["cube"]
OUT_OF_WINDOWS = 5
"""Frames beside an impact or an end where a step may stay undecided: the shortest window has four."""


def throw_and_track(seed: int, shape: str = "cube", *, correlated_frames: float = 0.0) -> tuple[Throw, Track]:
    """A throw with three impacts, and its poses on every frame."""
    rng = np.random.default_rng(seed)
    die = DICE[shape]
    throw = true_throw(die, random_release(die, rng), 0.6, impacts=3)
    track = seen(throw, rng)
    return throw, blurred_in_time(track, throw, rng, correlated_frames) if correlated_frames else track


def filmed(track: Track, kept: Rows) -> Track:
    """The track of a file that holds these frames of the film, numbered and timed one after the other."""
    n = len(kept)
    return Track(
        np.arange(n), np.arange(n) / FPS, track.position_m[kept], track.quaternion[kept], track.covariance[kept],
        track.status[kept],
    )  # fmt: skip


def steps_of(track: Track, copies: Rows | None = None) -> tuple[TimeStep, ...]:
    """The steps found, with the frames that are known copies left out."""
    use = np.arange(len(track)) if copies is None else np.setdiff1d(np.arange(len(track)), copies)
    return find_time_steps(weighted_poses(track, use), track.frame[use], 1.0 / FPS, copies)


def far_from_impacts(throw: Throw, frame: int, margin: int = OUT_OF_WINDOWS) -> bool:
    return all(abs(frame - impact.time_s * FPS) > margin for impact in throw.impacts)


@pytest.mark.parametrize("shape", sorted(DICE))
def test_even_times_show_no_step_and_an_impact_is_none(shape: str) -> None:
    for seed in range(2):
        for frames in (0.0, 6.0):
            throw, track = throw_and_track(seed, shape, correlated_frames=frames)
            assert len(throw.impacts) == 3
            assert steps_of(track) == ()


@pytest.mark.parametrize("count", [1, 2, 7, 12])
def test_missing_frames_are_found_and_counted(count: int) -> None:
    throw, track = throw_and_track(1)
    place = int(throw.impacts[0].time_s * FPS) // 2
    assert throw.impacts[0].time_s * FPS > place + count + OUT_OF_WINDOWS
    kept = np.delete(np.arange(len(track)), np.arange(place, place + count))
    (step,) = steps_of(filmed(track, kept))
    assert (step.kind, step.before, step.after, step.intervals) == (StepKind.WHOLE, place - 1, place, count)
    # Four standard errors of the free estimate: one case in 16 000.
    assert abs(step.measured_intervals - count) < 4.0 * step.sigma_intervals + 0.02


def test_every_41st_frame_missing_is_found() -> None:
    for seed in range(2):
        throw, track = throw_and_track(seed)
        kept = np.array([k for k in range(len(track)) if k % 41 != 40])
        found = {step.before: step for step in steps_of(filmed(track, kept))}
        for place in range(39, len(kept) - OUT_OF_WINDOWS, 40):
            if far_from_impacts(throw, int(kept[place])):
                assert found.pop(place).intervals == 1
        # What else is reported lies at an impact, and is not corrected.
        assert not any(step.is_certain for step in found.values() if far_from_impacts(throw, int(kept[step.before])))


def test_a_frame_that_is_there_twice_is_told_from_a_frozen_one() -> None:
    _, track = throw_and_track(2)
    place, n = 20, len(track)
    twice = np.sort(np.append(np.arange(n), place))
    (step,) = steps_of(filmed(track, twice), np.array([place + 1]))
    assert (step.kind, step.before, step.after, step.intervals) == (StepKind.WHOLE, place, place + 2, -1)
    old = np.where(np.arange(n) == place + 1, place, np.arange(n))
    (step,) = steps_of(filmed(track, old), np.array([place + 1]))
    assert (step.kind, step.before, step.after, step.intervals) == (StepKind.RUNS_ON, place, place + 2, 0)


def test_a_part_of_an_interval_is_reported_and_not_corrected() -> None:
    throw, track = throw_and_track(3)
    place = int(throw.impacts[0].time_s * FPS) // 2
    late = replace(track, time_s=track.time_s + np.where(track.frame >= place, -0.4 / FPS, 0.0))
    (step,) = steps_of(late)
    assert step.kind is StepKind.FRACTION
    assert not step.is_certain
    assert (step.before, step.after) == (place - 1, place)
    assert step.measured_intervals == pytest.approx(0.4, abs=0.1)


def test_a_die_that_hardly_moves_is_no_clock() -> None:
    rng = np.random.default_rng(5)
    still = State(0.0, np.array([0.0, 0.0, 0.05]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    track = seen(Throw((Flight(still, 30 / FPS),), ()), rng, noise=20.0)
    assert steps_of(filmed(track, np.delete(np.arange(len(track)), 15))) == ()
