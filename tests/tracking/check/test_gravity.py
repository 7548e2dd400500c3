"""A die falls with g; another acceleration indicates a wrong scale, clock or camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from throws import random_release, seen, true_throw

from diethrow.model.die.die import make_die
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec
from diethrow.model.throw.motion import Throw
from diethrow.tracking.check.gravity import fall_notices, measure_fall
from diethrow.tracking.track import LOST, Track

CUBE = make_die("cube", 0.016, 0.0048)


def seen_throw(seed: int) -> tuple[Track, Throw]:
    rng = np.random.default_rng(seed)
    throw = true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=2)
    return seen(throw, rng), throw


def scaled(track: Track, share: float) -> Track:
    """The track with the size of the die wrong by a factor."""
    lengths = np.array([share] * 3 + [1.0] * 3)
    return replace(track, position_m=share * track.position_m, covariance=track.covariance * np.outer(lengths, lengths))


def test_the_fall_of_a_well_measured_throw_is_gravity_within_its_covariance() -> None:
    nees = []
    for seed in range(30):
        fall = measure_fall(*seen_throw(seed))
        assert fall is not None
        assert fall_notices(fall) == ()
        miss = fall.acceleration_m_s2 - [0.0, 0.0, -9.81]
        nees.append(miss @ np.linalg.solve(fall.covariance, miss))
    # Three degrees of freedom; the mean of 30 scatters by 0.45, and the scatter scale is never below 1.
    assert 1.6 < np.mean(nees) < 4.5


@pytest.mark.parametrize("share", [0.5, 1.25])
def test_the_fall_gives_the_right_size_of_a_die_of_the_wrong_size(share: float) -> None:
    track, throw = seen_throw(1)
    (notice,) = fall_notices(measure_fall(scaled(track, share), throw))
    factor = float(notice.split("the lengths of [die] by ")[1].split()[0])
    assert factor == pytest.approx(1.0 / share, rel=0.03)  # a sigma of the fall is near one per cent


def test_the_fall_gives_the_right_frame_rate_by_its_square() -> None:
    track, throw = seen_throw(2)
    slow = replace(track, time_s=1.5 * track.time_s)
    late = tuple(replace(impact, time_s=1.5 * impact.time_s) for impact in throw.impacts)
    (notice,) = fall_notices(measure_fall(slow, Throw(throw.flights, late)))
    factor = float(notice.split("clip.fps by ")[1].split()[0])
    assert factor == pytest.approx(1.5, rel=0.03)


def test_a_tilted_camera_shows_in_a_sideways_fall() -> None:
    track, throw = seen_throw(3)
    tilt = matrix_from_quat(quat_from_rotvec(np.array([0.3, 0.0, 0.0])))
    turned = np.kron(np.eye(2), tilt)
    tilted = replace(track, position_m=track.position_m @ tilt.T, covariance=turned @ track.covariance @ turned.T)
    (notice,) = fall_notices(measure_fall(tilted, throw))
    assert "rotation of [camera]" in notice


def test_a_few_frames_with_a_wrong_pose_do_not_bend_the_fall() -> None:
    track, throw = seen_throw(4)
    position = track.position_m.copy()
    position[10:13] += 5e-3
    fall = measure_fall(replace(track, position_m=position), throw)
    assert fall is not None
    # Three of some fifty frames of the first flight, each with a weight of at most 2.5 sigma.
    assert np.linalg.norm(fall.acceleration_m_s2 + np.array([0.0, 0.0, 9.81])) < 1.0
    assert fall_notices(fall) == ()


def test_too_short_flights_give_no_fall() -> None:
    track, throw = seen_throw(5)
    status = np.array([LOST] * len(track), dtype="<U7")
    status[:6] = track.status[:6]
    few = replace(track, status=status)
    assert measure_fall(few, throw) is None
    assert fall_notices(None) == ()
