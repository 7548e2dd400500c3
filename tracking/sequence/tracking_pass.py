"""The tracking pass: from the initial pose to both ends of the clip, and back from its end through the impacts; then from another
initial pose wherever the die was lost."""

from __future__ import annotations

from ...model.errors import InputError
from ..clip_parameters import BLUR_FRAMES, depth_of_field, estimate_lens
from ..frame_to_frame import TrackingTask, track_both_ways
from ..picture import View, with_lens
from ..pose import ClipPoses, wholly_in_view
from .backward_pass import with_backward_poses
from .depth_reversal import correct_depth_reversals
from .initialisation import MAX_FIRST_FRAMES, find_initial_pose, initial_pose_by_hand
from .lost_ranges import with_lost_ranges_found


class NoDieError(InputError):
    """No die was found in the clip."""


def track_throughout(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
    """As `track_once`, with poses found wherever the die was lost."""
    view, poses = track_once(view, task)
    return view, find_where_lost(view, task, poses)


def track_once(view: View, task: TrackingTask, most_frames: int = MAX_FIRST_FRAMES) -> tuple[View, ClipPoses]:
    """The poses of one pass, and the view with the lens blur estimated at its beginning; of a second pass if the first shows a
    depth of field. Where the die was lost, it stays so: `find_where_lost`. Raises NoDieError where no die was found on
    `most_frames` at the most."""
    tracked_view, poses = _track_once(view, task, most_frames)
    lens = depth_of_field(
        tracked_view, poses.sample(task.source.frame, wholly_in_view(tracked_view, poses), BLUR_FRAMES)
    )
    return (tracked_view, poses) if lens is None else _track_once(with_lens(view, lens), task, most_frames)


def find_where_lost(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses of a pass, with those found wherever the die was lost or followed wrongly; `poses` itself if none were."""
    found = with_lost_ranges_found(view, task, poses)
    return poses if found is poses else correct_depth_reversals(view, task.source, found, task.unused)


def _track_once(view: View, task: TrackingTask, most_frames: int) -> tuple[View, ClipPoses]:
    """One pass."""
    source = task.source
    found = (
        find_initial_pose(view, source, task.unused, task.report, most_frames)
        if task.by_hand is None
        else initial_pose_by_hand(view, source, task.by_hand, task.unused)
    )
    if found is None:
        raise NoDieError(
            f"no die was found in {len(source)} frames: look at the clip, the background and the [die] shape and edge"
        )
    tracker, poses = found
    lens = estimate_lens(view, poses.sample(source.frame, poses.known, BLUR_FRAMES))
    tracker.view = with_lens(tracker.view, lens)
    track_both_ways(tracker, task, poses)
    # The tracker's view contains the occluders that it found.
    poses = with_backward_poses(tracker.view, task, poses)
    return tracker.view, correct_depth_reversals(tracker.view, source, poses, task.unused)
