"""Ranges of frames in which the die was lost, or followed wrongly.

In each an initial pose is looked for as in a clip by itself: past several impacts in a row nothing is left of the motion before
them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ...model.rotations import quat_from_matrix
from ...model.throw import State
from ..footage import FrameSource
from ..frame_to_frame import FrameTracker, TrackingTask, track_both_ways
from ..picture import View, flight_from, share_in_view
from ..pose import ClipPoses, log_scatter
from .compare_poses import CONTESTED_SHARE, differ, explain_better, windows_of
from .initialisation import FULL_STAGE, find_lost_die
from .labelling import with_rows_of
from .places import PlacesBeside

Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

LEAST_LOST_FRAMES = FULL_STAGE
"""Frames without a pose that explains them from which on an initial pose is looked for among them: as many as show whether one
is right."""
UNEXPLAINED_RATIO = 1.25
"""Cost over the median of the clip from which poses do not explain their pictures, if it lies UNEXPLAINED_EXCESS_COST above as
well: a median over LEAST_LOST_FRAMES frames, of which those beside an impact may be a few. Right poses of 39 random clips came
to 1.5 at the most, and are found again in vain; wrong ones that follow two impacts within frames to 1.3, others to 3."""
UNEXPLAINED_EXCESS_COST = 0.5
"""Excess over that median; tracking itself measures costs from those of the frames before, and follows a wrong pose as these
grow."""
SETTLING_FRAMES = 2
"""Frames behind an impact whose poses may not have converged."""
NO_FLIGHT_LOG_SCATTER = 1.0
"""Logarithm of the residual standard deviation, in standard errors of the poses, beyond which these lie on no flight. On the 21
random clips that it was chosen on, right poses of flights without an impact came to 1.0 at the most; wrong ones of a well-rounded
die, which hardly shows how it lies, may come to less."""
JOINED_COST = 0.15
"""Cost, of pictures and motion as SMALLER_COST, by which poses that continue these may be worse than the poses beside, which do
not: single frames hardly distinguish a die from its depth reversal, and the motion does."""


def with_lost_ranges_found(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses with those of ranges in which the die was lost while it was wholly in view, or in which the poses do not explain
    the pictures or lie on no flight, found anew. Returns `poses` itself where nothing was found."""
    source, given_up = task.source, np.zeros(len(poses.known), bool)
    while (lost := _first_lost_range(view, source, poses, task.unused | given_up)) is not None:
        elsewhere = np.ones(len(given_up), bool)
        elsewhere[lost] = False
        beside = [k for k in (lost.start - 1, lost.stop) if 0 <= k < len(poses.known) and poses.known[k]]
        places = PlacesBeside.of(poses, source.times_s, beside, view.die.solid.edge_m)
        found = find_lost_die(view, source, task.unused | elsewhere, task.report, places)
        if found is None:
            given_up[lost] = True
            continue
        tracker, others = found
        back = track_both_ways(tracker, task, others)
        new = np.flatnonzero(others.known[lost]) + lost.start
        if poses.known[new].mean() > CONTESTED_SHARE and not explain_better(view, source, others, poses, new):
            given_up[lost] = True
            continue
        # What is left of the range is looked at again: another impact may lie there.
        given_up |= others.known
        poses.known[lost] = False
        if others.known[lost.stop - 1]:
            _track_on(tracker, task, others, poses, lost.stop, 1)
        if others.known[lost.start]:
            _track_on(back, task, others, poses, lost.start - 1, -1)
        poses = with_rows_of(view, poses, others, np.flatnonzero(others.known), source.times_s)
    return poses


def _track_on(
    tracker: FrameTracker, task: TrackingTask, others: ClipPoses, poses: ClipPoses, row: int, step: int
) -> None:
    """Track on from a row, forwards or backwards by `step`, until the poses found are those that are there, or explain the
    pictures worse: before a die was lost it may have been followed wrongly."""
    tracker.unused, tracker.next_frame = task.unused, row
    while tracker.misses == 0:
        rows = row + step * np.arange(LEAST_LOST_FRAMES)
        rows = rows[(rows >= 0) & (rows < len(poses.known))]
        for k in rows.tolist():
            tracker.track(task.source.frame(k)[None], task.source.times_s, k, others)
        if _agree(tracker.view, others, poses, rows) or not explain_better(
            tracker.view, task.source, others, poses, rows, -JOINED_COST
        ):
            others.known[rows] = False
            break
        row += step * LEAST_LOST_FRAMES


def _agree(view: View, others: ClipPoses, poses: ClipPoses, rows: Rows) -> bool:
    """Whether others draw the same die as the poses on the last of some rows that both have."""
    last = rows[others.known[rows] & poses.known[rows]][-1:]
    return len(last) > 0 and not differ(view, poses, others, last).any()


def _first_lost_range(view: View, source: FrameSource, poses: ClipPoses, unused: Mask) -> slice | None:
    """The first range of frames without a pose, or with poses that do not explain them, that is long enough for an initial pose,
    beside a frame from which the die moves on wholly in view."""
    wrong = _unexplained(poses) | _of_no_flight(view, source, poses)
    without = (~poses.interpolated().known | wrong) & ~unused
    edges = np.flatnonzero(np.diff(np.concatenate([[False], without, [False]])))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        beside = [(k, step) for k, step in ((begin - 1, 1), (end, -1)) if 0 <= k < len(unused) and poses.known[k]]
        if end - begin >= LEAST_LOST_FRAMES and any(stays_in_view(view, source, poses, *one) for one in beside):
            return slice(begin, end)
    return None


def _unexplained(poses: ClipPoses) -> Mask:
    """(n,) frames whose poses, with those beside them, explain the pictures far worse than the poses of this clip usually do."""
    known = np.flatnonzero(poses.known)
    out = np.zeros(len(poses.known), bool)
    cost = poses.cost[known]
    usual = float(np.median(cost)) if len(known) else 0.0
    near = median_filter(cost, LEAST_LOST_FRAMES, mode="nearest") if len(known) else cost
    out[known] = near > max(UNEXPLAINED_RATIO * usual, usual + UNEXPLAINED_EXCESS_COST)
    return out


def _of_no_flight(view: View, source: FrameSource, poses: ClipPoses) -> Mask:
    """(n,) frames whose poses lie on no flight with any of those beside them: tracking may have followed another pose that draws
    the same, behind an impact, as of a tetrahedron that shows one face. No film so fast that frames were skipped is tested."""
    out = np.zeros(len(poses.known), bool)
    if poses.frame_stride > 1:
        return out
    known = np.flatnonzero(poses.known)
    for flight in np.split(known, np.flatnonzero(poses.begins[known])):
        # The first poses have not converged, and the last may lie behind the impact.
        rows = flight[SETTLING_FRAMES:-1]
        windows = windows_of(rows)
        for window in windows:
            out[window] = True
        for window in windows:
            if log_scatter(view, poses, source.times_s, window) < NO_FLIGHT_LOG_SCATTER:
                out[window] = False
    return out


def stays_in_view(view: View, source: FrameSource, poses: ClipPoses, k: int, step: int) -> bool:
    """Whether the die on row k is still wholly in view `step` rows later, by its motion on row k."""
    here, then = source.times_s[[k, k + step]].tolist()
    rotation, (velocity_m_s, omega_rad_s) = quat_from_matrix(poses.rotation[k]), np.split(poses.motion[k], 2)
    state = State(here, poses.position_m[k], rotation, velocity_m_s, omega_rad_s)
    ahead = flight_from(view, state).at(then)
    return share_in_view(view, ahead.position_m, ahead.rotation) == 1.0
