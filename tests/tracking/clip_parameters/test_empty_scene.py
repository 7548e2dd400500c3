"""Laws of the background that is measured around a tracked die: it holds nothing of the die, however long the die stays."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from footage_of_throws import DICE, FPS, film, studio
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.model.die import symmetry_rotations
from diethrow.model.rotations import angle_between, matrix_from_quat
from diethrow.model.throw import Flight, State, Throw
from diethrow.tracking.clip_parameters.empty_scene import LEAST_UNCOVERED, empty_scene
from diethrow.tracking.footage.background import estimate_background
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.picture import PixelNoise
from diethrow.tracking.picture.view import View, make_view
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.tracker import track_clip

ROOM = replace(studio(), noise_grey=2.0)
CUBE = DICE["cube"]
FRAMES = 60
REACH_M = CUBE.solid.circumradius
NONE_UNUSED = np.zeros(FRAMES, bool)


@cache
def slow_cube() -> Throw:
    """A cube near its highest point that moves sideways by little more than its own width, and turns by 30 degrees."""
    speed_m_s = 2.4 * REACH_M * FPS / FRAMES
    middle = State(
        0.5 * FRAMES / FPS, np.array([0.0, 0.0, 0.018]), np.array([0.5, 0.5, -0.1, 0.7]),
        speed_m_s * ROOM.camera.rotation[0], np.array([5.0, 10.0, 3.0]),
    )  # fmt: skip
    middle = replace(middle, quaternion=middle.quaternion / np.linalg.norm(middle.quaternion))
    return Throw((Flight(Flight(middle, np.inf).at(0.0), FRAMES / FPS),), ())


@cache
def slow_clip() -> ArrayClip:
    return film(ROOM, CUBE, slow_cube(), FRAMES)


def true_poses(frames: range) -> ClipPoses:
    poses = ClipPoses.empty(FRAMES)
    position, quaternion = slow_cube().poses(slow_clip().times_s)
    poses.position_m[:], poses.rotation[:] = position, matrix_from_quat(quaternion)
    states = [slow_cube().at(float(time_s)) for time_s in slow_clip().times_s]
    poses.motion[:] = [np.concatenate([state.velocity_m_s, state.omega_rad_s]) for state in states]
    poses.known[list(frames)] = True
    return poses


def view_before(background: NDArray[np.float32]) -> View:
    return make_view(ROOM.camera, CUBE, background, PixelNoise(ROOM.noise_grey), None, 0.7)


def test_the_scene_behind_a_die_that_hardly_moves_is_that_of_the_frames_beside_it() -> None:
    estimated = estimate_background(slow_clip())
    found = empty_scene(view_before(estimated), FrameSource([slow_clip()]), true_poses(range(FRAMES)), NONE_UNUSED)
    error = found.backgrounds[0] - ROOM.table
    # The cube covers the pixels in its middle for three quarters of the clip, one face as long as the table is seen. With 15
    # frames left a median has a third of their noise.
    assert np.abs(estimated - ROOM.table).max() > 30.0
    assert np.abs(error).max() < 5.0
    assert found.changed_share > 0.02


def test_what_no_frame_shows_beside_the_die_keeps_its_grey_level() -> None:
    few = true_poses(range(LEAST_UNCOVERED - 1))
    before = np.full_like(ROOM.table, 77.0)
    found = empty_scene(view_before(before), FrameSource([slow_clip()]), few, ~few.known)
    np.testing.assert_array_equal(found.backgrounds[0], before)
    assert found.changed_share == 0.0


def test_frames_over_which_the_flight_leads_on_show_what_lies_behind_the_die() -> None:
    late = true_poses(range(FRAMES - 12, FRAMES))
    before = np.full_like(ROOM.table, 77.0)
    found = empty_scene(view_before(before), FrameSource([slow_clip()]), late, NONE_UNUSED)
    measured = found.backgrounds[0] != 77.0
    # Over 12 frames the cube moves by half its reach, and covers what lies behind its middle on all of them.
    alone = empty_scene(view_before(before), FrameSource([slow_clip()]), late, ~late.known)
    assert measured.sum() > 1.5 * (alone.backgrounds[0] != 77.0).sum()
    assert np.abs(found.backgrounds[0] - ROOM.table)[measured].max() < 5.0


def test_a_die_is_tracked_as_well_without_a_picture_of_the_empty_scene() -> None:
    given = track_clip(slow_clip(), ROOM.camera, CUBE, background=np.rint(ROOM.table))
    alone = track_clip(slow_clip(), ROOM.camera, CUBE)
    assert np.abs(alone.background - ROOM.table).max() < 8.0
    assert (alone.track.tracked == given.track.tracked).all()
    both = np.flatnonzero(given.track.tracked)
    apart_m = np.linalg.norm((alone.track.position_m - given.track.position_m)[both], axis=1)
    # The distance along the line of sight has a standard error of 0.1 mm.
    assert np.median(apart_m) < 1e-4
    here, there = (matrix_from_quat(one.track.quaternion[both]) for one in (alone, given))
    turned = np.degrees([angle_between(here @ symmetry, there) for symmetry in symmetry_rotations(CUBE.solid)])
    assert np.median(turned, axis=1).min() < 0.1
