"""Laws of a die that was lost in view, or followed wrongly: it is found again, and right poses stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cube_seen_late import FRAMES, ROOM, SEEN_FROM, cube_seen_late, off_m, whole_track
from footage_of_throws import DICE, film

from diethrow.model.rotations import angle_between, matrix_from_quat
from diethrow.model.throw.motion import Flight, Impact, State, Throw
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.frame_to_frame import TrackingTask
from diethrow.tracking.sequence.lost_ranges import with_lost_ranges_found
from diethrow.tracking.sequence.tracking_pass import track_throughout


def test_tracking_resumes_where_the_die_was_lost_in_view() -> None:
    view, source, tracker, poses, throw = cube_seen_late()
    tracker.track_to_end(source, poses, lambda frame: None, all_frames=True)
    task = TrackingTask(source, np.zeros(FRAMES, bool), None, lambda frame: None)
    resumed = with_lost_ranges_found(view, task, poses)
    assert resumed.known.all()
    assert off_m(resumed, throw)[resumed.known].max() < 1e-3
    turned = angle_between(resumed.rotation[:-1], resumed.rotation[1:])[resumed.known[:-1] & resumed.known[1:]]
    # 60 rad/s at 1500 frames a second are 2.3 degrees a frame: no face takes the place of another.
    assert turned.max() < np.radians(10.0)


def test_poses_that_do_not_explain_their_pictures_are_replaced_with_those_beside_them_that_explain_them_worse() -> None:
    view, task, poses, throw = whole_track()
    usual = float(np.median(poses.cost))
    for rows, excess in ((slice(40, 56), usual + 2.0), (slice(32, 40), 0.5)):
        poses.position_m[rows] += np.array([3e-3, 0.0, 0.0])
        poses.cost[rows] += excess
    again = with_lost_ranges_found(view, task, poses.copy())
    assert again.known.all()
    assert off_m(again, throw).max() < 1e-3


def test_poses_that_explain_their_pictures_stay_as_they_are() -> None:
    view, task, poses, _ = whole_track()
    poses.cost[40:56] *= 1.15
    assert np.array_equal(with_lost_ranges_found(view, task, poses.copy()).position_m, poses.position_m)


def test_right_poses_that_seem_to_explain_their_pictures_badly_are_found_again() -> None:
    view, task, poses, throw = whole_track()
    poses.cost[40:56] *= 1.3
    again = with_lost_ranges_found(view, task, poses.copy())
    assert again.known.all()
    assert np.abs(again.position_m - poses.position_m).max() < 2e-4
    assert off_m(again, throw).max() < 1e-3


def test_a_die_that_is_thrown_out_of_its_motion_is_found_on_the_next_frame() -> None:
    """Two impacts within a frame interval leave a dodecahedron that turns by 66 degrees a frame, and looks as if it turned by 37
    at the most."""
    die, fps, frames = DICE["dodecahedron"], 240.0, 24
    time_s, spins = 11.4 / fps, (np.array([4.0, 9.0, -6.0]), np.radians(66.0) * fps * np.array([0.6, -0.64, 0.48]))
    start = State(0.0, np.array([-0.006, 0.0, 0.03]), np.array([0.8, 0.6, 0.0, 0.0]), np.zeros(3), spins[0])
    before, nothing = Flight(start, time_s), np.full(3, np.nan)
    after = Flight(replace(before.at(time_s), velocity_m_s=np.array([0.2, 0.1, 0.3]), omega_rad_s=spins[1]), np.inf)
    jump = Impact(time_s, "unresolved", (), nothing[:2], nothing, *[np.nan] * 4, 0, 0)
    throw, room = Throw((before, after), (jump,)), replace(ROOM, shadow=0.0)
    clip = film(room, die, throw, frames, fps=fps)
    task = TrackingTask(FrameSource([clip]), np.zeros(frames, bool), None, lambda frame: None)
    view, poses = track_throughout(room.view(die), task)
    assert poses.known.all()
    labels = np.swapaxes(matrix_from_quat(throw.poses(clip.times_s)[1]), 1, 2) @ poses.rotation
    for flight in (labels[:12], labels[12:]):
        assert angle_between(flight, flight[-1:]).max() < 0.02
        assert angle_between(flight[:, None], view.symmetries).min(1).max() < 0.02


def test_tracking_does_not_resume_where_the_die_had_left_the_picture() -> None:
    view, source, _, poses, _ = cube_seen_late()
    poses.motion[SEEN_FROM, :3] = -100.0 * view.camera.rotation[0]
    task = TrackingTask(source, np.zeros(FRAMES, bool), None, lambda frame: None)
    last = int(np.flatnonzero(poses.known)[-1])
    poses.motion[last, :3] = 100.0 * view.camera.rotation[0]
    before = poses.known.copy()
    assert np.array_equal(with_lost_ranges_found(view, task, poses).known, before)
