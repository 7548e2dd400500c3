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


def test_a_run_of_frames_off_the_only_flight_keeps_its_poses_and_is_named_however_high_it_is() -> None:
    throw, rng = thrown(4)
    track = seen(throw, rng)
    behind = np.arange(len(track)) >= np.searchsorted(track.time_s, throw.impacts[0].time_s) - 1
    aside = track.position_m + np.where(np.arange(len(track)) < 8, 0.03, 0.0)[:, None] * [0.0, 1.0, 1.0]
    track = replace(track, position_m=aside, status=np.where(behind, LOST, track.status).astype(track.status.dtype))
    found = measure(track, CUBE)
    np.testing.assert_array_equal(np.flatnonzero(found.unexplained), np.arange(8))
    np.testing.assert_array_equal(found.smoothed_frames.position_m[:8], aside[:8])
    assert any("No flight explains frames 0 to 7:" in notice for notice in notices(track))


def test_frames_behind_an_unresolved_contact_are_named_where_a_frame_is_at_its_very_instant() -> None:
    throw, rng = thrown(5, impacts=1)
    found = measure(seen(throw, rng), CUBE)
    first, *others = found.throw.impacts
    row = int(np.flatnonzero(found.frames.time_s < first.time_s)[-1])
    impacts = (replace(first, contact="unresolved", time_s=float(found.frames.time_s[row])), *others)
    weights = np.where(np.isin(found.rows, row + np.arange(1, 4)), 0.0, found.chain.weights)
    resolved = replace(found.resolved, chain=replace(found.chain, weights=weights))
    altered = replace(found, throw=replace(found.throw, impacts=impacts), resolved=resolved)
    assert altered.unexplained[row + 1 : row + 4].all()
    assert not altered.unexplained[: row + 1].any()


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


def test_frames_that_scatter_beside_an_unresolved_contact_are_named_where_others_are_not() -> None:
    throw, rng = thrown(7)
    found = measure(seen(throw, rng, stated=0.3), CUBE)
    smoothed = found.smoothed_frames
    assert 2.0 < np.nanmin(found.residual_sigmas) <= np.nanmax(found.residual_sigmas) < 6.0
    assert doubtful_frame_notices(found, smoothed) == ()
    first, *others = found.throw.impacts
    unresolved = replace(found, throw=replace(found.throw, impacts=(replace(first, contact="unresolved"), *others)))
    (notice,) = [each for each in doubtful_frame_notices(unresolved, smoothed) if "beside a contact" in each]
    behind = int(np.flatnonzero(smoothed.time_s < others[0].time_s)[-1])
    assert f"The poses of frames 0 to {behind}, beside a contact that is not resolved, differ" in notice
