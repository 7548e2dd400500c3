"""Frames whose poses contradict each other, the table or the energy are named, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from throws import FPS, random_release, seen, true_throw

from diethrow.model.die.die import make_die
from diethrow.model.throw.motion import Throw
from diethrow.tracking.check.doubtful_frames import doubtful_frame_notices
from diethrow.tracking.throw.measurement import measure
from diethrow.tracking.track import LOST, Track

CUBE = make_die("cube", 0.016, 0.0048)


def thrown(seed: int, impacts: int = 2) -> tuple[Throw, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return true_throw(CUBE, random_release(CUBE, rng), 0.6, impacts=impacts), rng


def notices(track: Track) -> tuple[str, ...]:
    found = measure(track, CUBE)
    return doubtful_frame_notices(found, found.smoothed_frames)


def test_no_frame_of_a_throw_is_named_whose_flights_all_show() -> None:
    shown = 0
    for seed in range(60):
        throw, rng = thrown(seed)
        instants = [0.0, *(impact.time_s for impact in throw.impacts), throw.flights[-1].end_s]
        if np.diff(instants).min() > 6 / FPS:
            shown += 1
            assert notices(seen(throw, rng)) == (), seed
    assert shown > 12


def test_a_frame_beyond_an_impact_that_no_other_frame_shows_keeps_its_pose_and_is_named() -> None:
    throw, rng = thrown(4)
    track = seen(throw, rng)
    struck = int(np.searchsorted(track.time_s, throw.impacts[0].time_s))
    early = np.arange(len(track)) < struck - 1
    late = track.time_s > throw.impacts[1].time_s
    track = replace(track, status=np.where(early | late, LOST, track.status).astype(track.status.dtype))
    found = measure(track, CUBE)
    assert found.throw.impacts == ()
    smoothed = found.smoothed_frames
    (notice,) = doubtful_frame_notices(found, smoothed)
    assert f"No flight explains frame {struck - 1}:" in notice
    np.testing.assert_array_equal(smoothed.position_m[struck - 1], track.position_m[struck - 1])


def test_a_die_below_the_table_is_named_with_its_depth() -> None:
    throw, rng = thrown(5, impacts=1)
    track = seen(throw, rng)
    lowered = replace(track, position_m=track.position_m - [0.0, 0.0, 0.005])
    (notice,) = [notice for notice in notices(lowered) if "below the table" in notice]
    assert "up to 5.0 mm below" in notice
    struck = int(np.searchsorted(track.time_s, throw.impacts[0].time_s))
    first, last = map(int, notice.split("frames ")[1].split(":")[0].split(" to "))
    assert first <= struck <= last


def test_a_throw_backwards_in_time_gains_energy() -> None:
    throw, rng = thrown(6, impacts=1)
    track = seen(throw, rng)
    backwards = replace(
        track, position_m=track.position_m[::-1], quaternion=track.quaternion[::-1], covariance=track.covariance[::-1]
    )
    (notice,) = notices(backwards)
    assert notice.startswith(f"The die gains energy at a bounce in frames 0 to {len(track) - 1}:")


def test_frames_that_differ_from_their_flight_far_more_than_they_state_are_named() -> None:
    throw, rng = thrown(7)
    track = seen(throw, rng, stated=0.05)
    (notice,) = notices(track)
    assert f"The poses of frames 0 to {len(track) - 1} differ from their flight by " in notice
    assert 12 <= int(notice.split(" by ")[1].split()[0]) <= 20
