"""A fast cube that is found behind both of its bounces only: tracking has to go back through them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from footage_of_throws import DICE, FPS, fast_cube, film, studio
from numpy.typing import NDArray

from diethrow.model.throw.motion import Throw
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.frame_to_frame import FrameTracker, TrackingTask
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.initialisation import find_initial_pose
from diethrow.tracking.sequence.lost_ranges import with_lost_ranges_found

Array = NDArray[np.float64]

FRAMES, SEEN_FROM = 64, 36
ROOM = replace(studio(), noise_grey=2.0, shadow=0.4)


def cube_seen_late() -> tuple[View, FrameSource, FrameTracker, ClipPoses, Throw]:
    """A fast cube, and a tracker that knows its poses on some frames from SEEN_FROM on, behind both bounces."""
    throw = fast_cube(FRAMES)
    assert [bounce.time_s * FPS < SEEN_FROM - 1 for bounce in throw.bounces] == [True, True]
    source, view = FrameSource([film(ROOM, DICE["cube"], throw, FRAMES)]), ROOM.view(DICE["cube"])
    begun = find_initial_pose(view, source, np.arange(FRAMES) < SEEN_FROM)
    assert begun is not None
    tracker, poses = begun
    assert np.flatnonzero(poses.known)[0] == SEEN_FROM
    tracker.unused = np.zeros(FRAMES, bool)
    return view, source, tracker, poses, throw


def off_m(poses: ClipPoses, throw: Throw) -> Array:
    """(n,) distance of tracked positions from the true ones."""
    return np.asarray(np.linalg.norm(poses.position_m - throw.poses(np.arange(FRAMES) / FPS)[0], axis=1))


def whole_track() -> tuple[View, TrackingTask, ClipPoses, Throw]:
    """A fast cube tracked through all its frames."""
    view, source, tracker, poses, throw = cube_seen_late()
    tracker.track_to_end(source, poses, lambda frame: None, all_frames=True)
    task = TrackingTask(source, np.zeros(FRAMES, bool), None, lambda frame: None)
    return view, task, with_lost_ranges_found(view, task, poses), throw
