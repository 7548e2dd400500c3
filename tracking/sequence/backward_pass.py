"""The backward pass: poses that tracking finds from the end of the clip back through the impacts, in place of forward ones that
explain pictures and motion worse.

Behind an impact a wrong pose may explain a few pictures best, and is followed from there. Backwards the die comes to the same
impact along another flight, from a pose that is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..frame_to_frame import BACKWARDS_MISSES, FrameTracker, TrackingTask
from ..picture import View
from ..pose import ClipPoses, pose_state, refine_pose
from .compare_poses import CONTESTED_SHARE, FLIGHT_FRAMES, differ, explain_better
from .initialisation import FULL_STAGE
from .labelling import with_rows_of

Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

REJOINED_FRAMES = FULL_STAGE
"""Frames in a row on which tracking found the same poses backwards, from which on it would find the same."""
CHANGE_COST = 0.5
"""Cost of a change from forward to backward poses or back where they differ, which is a jump of the die: ten frames that are
better by SMALLER_COST make up for two."""
LOST_EXCESS_COST = 0.5
"""Cost of a row without a pose over that of the median one: a pose that costs more is not taken for one that is missing."""


def with_backward_poses(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses, and on runs of frames those tracked backwards through the impacts, where these explain pictures and motion
    better. Returns `poses` itself where they do nowhere, or on a film so fast that frames were skipped."""
    if poses.frame_stride > 1:
        return poses
    source, backward, out = task.source, _backward_poses(view, task, poses), poses
    for rows, is_preferred in _differing_runs(view, poses, backward):
        is_contested = poses.known[rows].mean() > CONTESTED_SHARE
        if explain_better(view, source, backward, poses, rows) if is_contested else is_preferred:
            out = with_rows_of(view, out, backward, rows, source.times_s)
    return out


def _backward_poses(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses that tracking finds backwards, from the last one of the clip, and again from an earlier one wherever the die is
    lost. Of a flight on which it finds the same poses only the first frames are tracked as well."""
    backward, starts = ClipPoses.empty(len(poses.known)), np.flatnonzero(poses.known)
    begins = np.flatnonzero(poses.known & poses.begins)
    while len(starts):
        row, has_rejoined = _track_backwards(view, task, poses, int(starts[-1]), backward)
        if has_rejoined:
            before = begins[begins <= row]
            row = min(row, int(before[-1]) + FLIGHT_FRAMES) if len(before) else -1
        starts = starts[starts <= row]
    # Backwards a flight begins on its last row, behind which the next one does.
    backward.begins[1:], backward.begins[0] = backward.begins[:-1].copy(), False
    return backward


def _track_backwards(
    view: View, task: TrackingTask, poses: ClipPoses, row: int, backward: ClipPoses
) -> tuple[int, bool]:
    """Write what tracking finds backwards from the pose on a row, until the die is lost, or the same poses as before were found
    on REJOINED_FRAMES in a row. Returns the row to go on from, and whether these were found."""
    source, motion = task.source, poses.motion[row]
    initial = pose_state(poses.position_m[row], poses.rotation[row], *np.split(motion, 2))
    pose = refine_pose(view, np.asarray(source.frame(row), np.float32), initial, coarse=0, roughly=True)
    if pose.covariance is None:
        return row - 1, False
    rates = motion if motion.any() else None
    tracker = FrameTracker.from_pose(view, pose, source.times_s, row, task.unused, rates).backwards_tracker()
    backward.put(row, pose, motion)
    same = 0
    for block in source.blocks_backwards(row):
        with block:
            for stop in range(len(block.frames), 0, -REJOINED_FRAMES):
                some = slice(max(stop - REJOINED_FRAMES, 0), stop)
                row = block.first + some.start
                tracker.track(block.frames[some], source.times_s, row, backward)
                rows = np.arange(row, block.first + stop)
                is_same = bool(backward.known[rows].all() and not differ(view, poses, backward, rows).any())
                same = same + len(rows) if is_same else 0
                if same >= REJOINED_FRAMES or tracker.misses > BACKWARDS_MISSES:
                    return row - 1, is_same
    return -1, False


def _differing_runs(view: View, poses: ClipPoses, backward: ClipPoses) -> list[tuple[Rows, bool]]:
    """Runs of rows on which the backward poses differ or are alone, each with whether the sequence of least cost takes them."""
    differs = backward.known & differ(view, poses, backward, np.arange(len(poses.known)))
    rows, is_preferred = np.flatnonzero(differs), _prefers_backward(poses, backward, differs)
    begins = (np.diff(rows) > 1) | (np.diff(is_preferred[rows].astype(int)) != 0)
    runs = np.split(rows, np.flatnonzero(begins) + 1)
    return [(run, bool(is_preferred[run[0]])) for run in runs if len(run)]


def _prefers_backward(poses: ClipPoses, backward: ClipPoses, differs: Mask) -> Mask:
    """(n,) rows on which the sequence of least cost through both takes the backward pose. Every change from one to the other
    between two rows on which they differ costs CHANGE_COST, and a row without a pose LOST_EXCESS_COST more than usual."""
    lost = float(np.median(poses.cost_with_edge_noise[poses.known])) + LOST_EXCESS_COST
    costs = np.stack([np.where(one.known, one.cost_with_edge_noise, lost) for one in (poses, backward)], axis=1)
    total, came_from = costs[0].copy(), np.zeros((len(costs), 2), int)
    for k in range(1, len(costs)):
        other = total[::-1] + (CHANGE_COST if differs[k - 1] and differs[k] else 0.0)
        came_from[k] = np.where(other < total, [1, 0], [0, 1])
        total = np.minimum(total, other) + costs[k]
    chosen = np.zeros(len(costs), int)
    chosen[-1] = int(np.argmin(total))
    for k in range(len(costs) - 1, 0, -1):
        chosen[k - 1] = came_from[k, chosen[k]]
    return chosen == 1
