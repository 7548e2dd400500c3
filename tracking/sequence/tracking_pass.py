"""The tracking pass: from the initial pose to both ends of the clip, back from its end through the impacts, from another initial
pose wherever the die was lost, and all of it again for a die whose corners turn out to be rounded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ...model.errors import InputError
from ...model.rotations import matrix_from_quat, quat_from_matrix
from ...model.throw import State
from ..clip_parameters import (
    BLUR_FRAMES,
    RADIUS_FRAMES,
    CornerRadius,
    CornerRounding,
    contour_sigma_px,
    depth_of_field,
    estimate_lens,
    gain_over_sharp,
    is_rounded,
    largest_radius_m,
    radius_by_free_poses,
    radius_on_flights,
    sample_in_flight,
)
from ..footage import FrameSource
from ..picture import View, flight_from, share_in_view, with_corner_radius, with_lens
from ..pose import ClipPoses, ManualInitialisation, as_track, pose_state, refine_pose, same_picture, wholly_in_view
from ..throw import NoFlightError, measure
from ..track import Track
from .depth_reversal import correct_depth_reversals
from .frame_to_frame import BACKWARDS_MISSES, FrameTracker
from .initialisation import (
    AGREEMENT_EDGES,
    FULL_STAGE,
    find_initial_pose,
    find_lost_die,
    initial_pose_by_hand,
    log_scatter,
)
from .labelling import with_rows_of
from .places import PlacesBeside

Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

LEAST_RESUMED_FRAMES = FULL_STAGE
"""Frames without a pose that explains them from which on an initial pose is looked for among them: as many as show whether one
is right."""
UNEXPLAINED_RATIO = 1.25
"""Cost over the median of the clip from which poses do not explain their pictures, if it lies UNEXPLAINED_EXCESS_COST above as
well: a median over LEAST_RESUMED_FRAMES frames, of which those beside an impact may be a few. Right poses of 39 random clips came
to 1.5 at the most, and are found again in vain; wrong ones that follow two impacts within frames to 1.3, others to 3."""
UNEXPLAINED_EXCESS_COST = 0.5
"""Excess over that median; tracking itself measures costs from those of the frames before, and follows a wrong pose as these
grow."""
SETTLING_FRAMES = 2
"""Frames behind an impact whose poses may not have converged."""
FLIGHT_FRAMES = 16
"""Frames over which a motion shows that it is none of a die in flight. Eight hardly do: on one flight of a sharp
tetrahedron wrong poses had a reduced chi-square of 1.3 to 6 there, and of 2.5 to 140 over 16."""
NO_FLIGHT_LOG_SCATTER = 1.0
"""Logarithm of the residual standard deviation, in standard errors of the poses, beyond which these lie on no flight. On the 21
random clips that it was chosen on, right poses of flights without an impact came to 1.0 at the most; wrong ones of a well-rounded
die, which hardly shows how it lies, may come to less."""
SMALLER_COST = 0.1
"""Mean cost with the noise of edges, and the logarithm of the scatter about flights, by which other poses must be better to
replace those that do not explain their pictures or lie on no flight."""
CONTESTED_SHARE = 0.5
"""Share of the frames of other poses that had poses before, above which the others must explain the pictures better: on fewer,
beside an impact, neither tells."""
JOINED_COST = 0.15
"""The same by which poses that continue these may be worse than the poses beside, which do not: single frames hardly distinguish
a die from its depth reversal, and the motion does."""
CHANGE_COST = 0.5
"""Cost of a change from forward to backward poses or back where they differ, which is a jump of the die: ten frames that are
better by SMALLER_COST make up for two."""
LOST_EXCESS_COST = 0.5
"""Cost of a row without a pose over that of the median one: a pose that costs more is not taken for one that is missing."""
MAX_RADIUS_TRIALS = 3
"""Most tracking passes with an estimated radius of the corners."""
SAME_RADIUS = 0.1
"""Relative change of the radius that needs no further pass."""
SMALLER_RADIUS = 0.9
"""Factor on a radius that the flights of its pass do not support: little decides whether an impact is lost, and it is rather lost
with a radius that is too large."""
SUFFICIENT_FRAMES = 0.95
"""Share of the frames tracked with another radius, or none, below which a radius is rejected."""
EXCLUDED_SIGMAS = 4.0
"""Standard errors of the contour, by the flights of a sharp die, by which it must lie nearer to that than to a rounded one's."""
SHARP_CONTOUR_PX = 0.25
"""Error of that contour [px] up to which its die may be sharp. It was chosen on one seed of random clips: flights of six sharp
dice showed up to 0.14, those of 15 of 18 rounded ones 0.16 to 0.8. Of the others two are rounded by too little to differ so, and
one leaves 0.2 open."""
ROUND_SHARE = 0.25
"""Radius of the corners, as a share of the inscribed radius, of a die that may be rounded and is not found as a sharp one."""


class NoDieError(InputError):
    """No die was found in the clip."""


@dataclass(frozen=True, eq=False)
class TrackingTask:
    """What every tracking pass over a clip needs."""

    source: FrameSource
    unused: Mask
    """(n,) frames whose pictures are not used."""
    by_hand: ManualInitialisation | None
    """An initial pose by hand, if there is one."""
    report: Callable[[int], None]
    """Called with the frames done."""


def track_rounded(
    view: View, task: TrackingTask, rounding: CornerRounding
) -> tuple[View, ClipPoses, CornerRadius | None]:
    """Poses from tracking, the view that they were tracked with, and the radius of the corners if it was estimated.

    Unless the radius is given, the pass is repeated with a rounded die if the pictures show one, until its flights show the
    radius that it was done with. Raises NoDieError if no die was found."""
    if rounding is CornerRounding.GIVEN:
        return *track_once(view, task), None
    first, poses = _track_sharp_or_round(view, task, rounding)
    corners = _radius_from_pictures(first, task.source, poses, rounding)
    if corners is None or corners.radius_m == 0.0:
        return first, poses, corners if rounding is CornerRounding.ESTIMATED else None
    was_sharp = first.die.corner_radius_m == 0.0
    if rounding is CornerRounding.TESTED and was_sharp and _flies_as_sharp(first, poses, task.source, corners.radius_m):
        return first, poses, None
    trials = _radius_trials(view, task, corners)
    if rounding is CornerRounding.TESTED and was_sharp:
        trials = [trial for trial in trials if _is_better_than_sharp(trial, poses, task.source)]
        if not trials:
            return first, poses, None
    if trials:
        most = max(trial.poses.frames for trial in trials)
        sufficient = [trial for trial in trials if trial.poses.frames >= SUFFICIENT_FRAMES * most]
        corners = sufficient[-1].corners
        # Poses with a smaller radius than the final one lie farther away than the latter implies.
        chosen = min(sufficient, key=lambda trial: abs(trial.radius_m - sufficient[-1].corners.radius_m))
        first, poses = chosen.view, chosen.poses
    return with_corner_radius(first, corners.radius_m), poses, corners


def track_once(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
    """The poses of one pass, and the view with the lens blur estimated at its beginning; of a second pass if the first shows a
    depth of field. Raises NoDieError where no die was found."""
    tracked_view, poses = _track_once(view, task)
    lens = depth_of_field(
        tracked_view, poses.sample(task.source.frame, wholly_in_view(tracked_view, poses), BLUR_FRAMES)
    )
    return (tracked_view, poses) if lens is None else _track_once(with_lens(view, lens), task)


def _track_once(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
    """One pass."""
    source = task.source
    found = (
        find_initial_pose(view, source, task.unused, task.report)
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
    _track_both_ways(tracker, task, poses)
    # The tracker's view contains the occluders that it found.
    poses = _with_backward_poses(tracker.view, task, poses)
    poses = _resumed(tracker.view, task, poses)
    return tracker.view, correct_depth_reversals(tracker.view, source, poses, task.unused)


def _track_both_ways(tracker: FrameTracker, task: TrackingTask, poses: ClipPoses) -> FrameTracker:
    """Track the die from its first poses to the end of the clip, and back to where it came in. Returns the tracker that went
    back."""
    source, first_known = task.source, int(np.flatnonzero(poses.known)[0])
    back = tracker.backwards_tracker()
    tracker.track_to_end(source, poses, task.report, all_frames=not tracker.view.quality.second_pass)
    for block in source.blocks_backwards(first_known):
        with block:
            back.track(block.frames, source.times_s, block.first, poses)
        if back.misses > BACKWARDS_MISSES:
            break
    return back


def _with_backward_poses(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses, and on runs of frames those tracked backwards through the impacts, where these explain pictures and motion
    better. Returns `poses` itself where they do nowhere, or on a film so fast that frames were skipped.

    Behind an impact a wrong pose may explain a few pictures best, and is followed from there. Backwards the die comes to the same
    impact along another flight, from a pose that is known."""
    if poses.frame_stride > 1:
        return poses
    source, backward, out = task.source, _backward_poses(view, task, poses), poses
    for rows, is_preferred in _differing_runs(view, poses, backward):
        is_contested = poses.known[rows].mean() > CONTESTED_SHARE
        if _explain_better(view, source, backward, poses, rows) if is_contested else is_preferred:
            out = with_rows_of(view, out, backward, rows, source.times_s)
    return out


def _backward_poses(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses that tracking finds backwards, from the last one of the clip, and again from an earlier one wherever the die is
    lost. A flight on which it finds the same poses is left out up to its first frames."""
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
    on LEAST_RESUMED_FRAMES in a row. Returns the row to go on from, and whether these were found."""
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
            for stop in range(len(block.frames), 0, -LEAST_RESUMED_FRAMES):
                some = slice(max(stop - LEAST_RESUMED_FRAMES, 0), stop)
                row = block.first + some.start
                tracker.track(block.frames[some], source.times_s, row, backward)
                rows = np.arange(row, block.first + stop)
                is_same = bool(backward.known[rows].all() and not _differ(view, poses, backward, rows).any())
                same = same + len(rows) if is_same else 0
                if same >= LEAST_RESUMED_FRAMES or tracker.misses > BACKWARDS_MISSES:
                    return row - 1, is_same
    return -1, False


def _differ(view: View, poses: ClipPoses, others: ClipPoses, rows: Rows) -> Mask:
    """(rows,) whether others show another die than the poses on some rows, or only one of the two has a pose."""
    out = poses.known[rows] != others.known[rows]
    for i in np.flatnonzero(poses.known[rows] & others.known[rows]).tolist():
        here, there = ((one.position_m[rows[i]], one.rotation[rows[i]]) for one in (poses, others))
        out[i] = not same_picture(view, here, there, AGREEMENT_EDGES)
    return out


def _differing_runs(view: View, poses: ClipPoses, backward: ClipPoses) -> list[tuple[Rows, bool]]:
    """Runs of rows on which the backward poses differ or are alone, each with whether the sequence of least cost takes them."""
    differs = backward.known & _differ(view, poses, backward, np.arange(len(poses.known)))
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


def _resumed(view: View, task: TrackingTask, poses: ClipPoses) -> ClipPoses:
    """The poses with those of ranges in which the die was lost while it was wholly in view, or in which the poses do not explain
    the pictures. In each an initial pose is looked for as in a clip by itself: past several impacts in a row nothing is left of
    the motion before them."""
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
        back = _track_both_ways(tracker, task, others)
        new = np.flatnonzero(others.known[lost]) + lost.start
        if poses.known[new].mean() > CONTESTED_SHARE and not _explain_better(view, source, others, poses, new):
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
        rows = row + step * np.arange(LEAST_RESUMED_FRAMES)
        rows = rows[(rows >= 0) & (rows < len(poses.known))]
        for k in rows.tolist():
            tracker.track(task.source.frame(k)[None], task.source.times_s, k, others)
        if _agree(tracker.view, others, poses, rows) or not _explain_better(
            tracker.view, task.source, others, poses, rows, -JOINED_COST
        ):
            others.known[rows] = False
            break
        row += step * LEAST_RESUMED_FRAMES


def _agree(view: View, others: ClipPoses, poses: ClipPoses, rows: Rows) -> bool:
    """Whether others draw the same die as the poses on the last of some rows that both have."""
    last = rows[others.known[rows] & poses.known[rows]][-1:]
    return len(last) > 0 and not _differ(view, poses, others, last).any()


def _explain_better(
    view: View, source: FrameSource, others: ClipPoses, poses: ClipPoses, rows: Rows,
    by: float = SMALLER_COST,
) -> bool:  # fmt: skip
    """Whether others explain the pictures and the motion on some rows better than the poses by a mean cost, on the rows that both
    have."""
    # In order of time, whichever way the rows were tracked: a flight is fitted to them.
    both = np.sort(rows[others.known[rows] & poses.known[rows]])
    if not len(both):
        return False
    theirs, ours = (
        float(one.cost_with_edge_noise[both].mean()) + _usual_log_scatter(view, source, one, both)
        for one in (others, poses)
    )
    return theirs < ours - by


def _usual_log_scatter(view: View, source: FrameSource, poses: ClipPoses, rows: Rows) -> float:
    """`log_scatter` of poses on some rows: the median over windows, of which those with an impact tell nothing; 0 if there are
    too few rows."""
    found = [log_scatter(view, poses, source.times_s, window) for window in _windows(rows)]
    return float(np.median(found)) if found else 0.0


def _first_lost_range(view: View, source: FrameSource, poses: ClipPoses, unused: Mask) -> slice | None:
    """The first range of frames without a pose, or with poses that do not explain them, that is long enough for an initial pose,
    beside a frame from which the die moves on wholly in view."""
    wrong = _unexplained(poses) | _of_no_flight(view, source, poses)
    without = (~poses.interpolated().known | wrong) & ~unused
    edges = np.flatnonzero(np.diff(np.concatenate([[False], without, [False]])))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        beside = [(k, step) for k, step in ((begin - 1, 1), (end, -1)) if 0 <= k < len(unused) and poses.known[k]]
        if end - begin >= LEAST_RESUMED_FRAMES and any(_stays_in_view(view, source, poses, *one) for one in beside):
            return slice(begin, end)
    return None


def _unexplained(poses: ClipPoses) -> Mask:
    """(n,) frames whose poses, with those beside them, explain the pictures far worse than the poses of this clip usually do."""
    known = np.flatnonzero(poses.known)
    out = np.zeros(len(poses.known), bool)
    cost = poses.cost[known]
    usual = float(np.median(cost)) if len(known) else 0.0
    near = median_filter(cost, LEAST_RESUMED_FRAMES, mode="nearest") if len(known) else cost
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
        windows = _windows(rows)
        for window in windows:
            out[window] = True
        for window in windows:
            if log_scatter(view, poses, source.times_s, window) < NO_FLIGHT_LOG_SCATTER:
                out[window] = False
    return out


def _windows(rows: Rows) -> list[Rows]:
    """Overlapping windows of FLIGHT_FRAMES of some rows, or all of them if there are fewer; none if these are fewer than
    LEAST_RESUMED_FRAMES."""
    if len(rows) < LEAST_RESUMED_FRAMES:
        return []
    begins = {*range(0, max(len(rows) - FLIGHT_FRAMES, 0), FLIGHT_FRAMES // 4), max(len(rows) - FLIGHT_FRAMES, 0)}
    return [rows[k : k + FLIGHT_FRAMES] for k in sorted(begins)]


def _stays_in_view(view: View, source: FrameSource, poses: ClipPoses, k: int, step: int) -> bool:
    """Whether the die on row k is still wholly in view `step` rows later, by its motion on row k."""
    here, then = source.times_s[[k, k + step]].tolist()
    rotation, (velocity_m_s, omega_rad_s) = quat_from_matrix(poses.rotation[k]), np.split(poses.motion[k], 2)
    state = State(here, poses.position_m[k], rotation, velocity_m_s, omega_rad_s)
    ahead = flight_from(view, state).at(then)
    return share_in_view(view, ahead.position_m, ahead.rotation) == 1.0


# --- rounded corners ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Trial:
    """A tracking pass with a radius of the corners."""

    radius_m: float
    view: View
    poses: ClipPoses
    is_supported: bool
    """Whether its flights show a radius."""
    corners: CornerRadius
    """The radius known after it."""


def _track_sharp_or_round(view: View, task: TrackingTask, rounding: CornerRounding) -> tuple[View, ClipPoses]:
    """A first pass with the view's radius; with a well-rounded die if none is found and the pictures then show one."""
    try:
        return track_once(view, task)
    except NoDieError:
        # A die that is round all over is not found as one with sharp corners.
        ball = with_corner_radius(view, min(ROUND_SHARE * view.die.solid.inradius, largest_radius_m(view.die)))
        first, poses = track_once(ball, task)
        if _radius_from_pictures(first, task.source, poses, rounding) is None:
            raise
        return first, poses


def _radius_trials(view: View, task: TrackingTask, corners: CornerRadius) -> list[_Trial]:
    """Passes with an estimated radius, each with that of the one before, until it no longer changes."""
    radius_m, trials = corners.radius_m, []
    for _ in range(MAX_RADIUS_TRIALS):
        # From the original view: tracking a sharp die takes what its corners would cover for an occluder.
        try:
            tracked_view, poses = track_once(with_corner_radius(view, radius_m), task)
        except NoDieError:
            break  # so round that no initial pose is found; the poses tracked before remain
        use = wholly_in_view(tracked_view, poses) & poses.evenly_spaced
        track = as_track(tracked_view, task.source, poses, use)
        found, _ = radius_in_flight(tracked_view, task.source, track, corners)
        is_supported, corners = found is not corners, found
        trials.append(_Trial(radius_m, tracked_view, poses, is_supported, corners))
        before, radius_m = radius_m, corners.radius_m if is_supported else SMALLER_RADIUS * radius_m
        if is_supported and abs(radius_m - before) < SAME_RADIUS * before:
            break
    return trials


def _is_better_than_sharp(trial: _Trial, sharp: ClipPoses, source: FrameSource) -> bool:
    """Whether a rounded die was tracked over as many frames as the sharp one, or over hardly fewer with a radius that its flights
    support, and explains their pictures better. A sharp die out of focus looks a little rounded; with a radius that is not its
    own it is lost, or tracked with poses that draw it worse."""
    if trial.poses.frames < (SUFFICIENT_FRAMES if trial.is_supported else 1.0) * sharp.frames:
        return False
    both = sharp.known & trial.poses.known
    frames = (poses.sample(source.frame, both, RADIUS_FRAMES) for poses in (sharp, trial.poses))
    gain, sigma = gain_over_sharp(trial.view, trial.radius_m, *frames)
    return gain > 0.0 or sigma == np.inf


def _flies_as_sharp(view: View, sharp: ClipPoses, source: FrameSource, radius_m: float) -> bool:
    """Whether the flights of a die that was tracked with sharp corners exclude a radius.

    The contour of a rounded die lies within that of a sharp one, for which it seems too far away. The fall and the table
    then show that the contour of the sharp die is drawn so far out as the radius says; of a die that is sharp they show
    hardly an error, whatever a codec or a sharpening filter does to its edges. Only a throw with a contact on one corner says
    so: the corners of a rounded die touch elsewhere."""
    use = wholly_in_view(view, sharp) & sharp.evenly_spaced
    inset_px = contour_sigma_px(view, radius_m, sharp.position_m[use], sharp.rotation[use])
    track = replace(as_track(view, source, sharp, use), contour_sigma_px=inset_px)
    try:
        throw = measure(track, view.die, view.camera)
    except NoFlightError:
        return False
    if not len(throw.chain.shared) or all(impact.contact != "vertex" for impact in throw.throw.impacts):
        return False
    found, sigma = float(throw.chain.shared[0]), throw.chain.contour_sigma_px
    return abs(found) < SHARP_CONTOUR_PX and abs(found) + EXCLUDED_SIGMAS * sigma < abs(found + inset_px)


def _radius_from_pictures(
    view: View, source: FrameSource, poses: ClipPoses, rounding: CornerRounding
) -> CornerRadius | None:
    """The radius of the corners from single pictures; None if the die looks sharp, or too few frames show it."""
    looks = partial(poses.sample, source.frame, wholly_in_view(view, poses))
    if rounding is CornerRounding.TESTED and not is_rounded(view, looks):
        return None
    return radius_by_free_poses(view, looks(RADIUS_FRAMES))


def radius_in_flight(
    view: View, source: FrameSource, track: Track, corners: CornerRadius
) -> tuple[CornerRadius, float]:
    """The radius of the corners from the flights of a track, and the contour error [px] that remains; `corners` itself and 0 if
    the flights do not determine it better.

    The flights are free to correct their distance. That leaves more ways to join them. Where these fail, the pictures contradict
    the flights, or the flights the radius: the poses then do better without that freedom."""
    p, R = track.position_m[track.tracked], matrix_from_quat(track.quaternion[track.tracked])
    if not len(p):
        return corners, 0.0
    try:
        found = measure(
            replace(track, contour_sigma_px=contour_sigma_px(view, corners.sigma_m, p, R)), view.die, view.camera
        )
    except NoFlightError:
        return corners, 0.0
    looks = sample_in_flight(view, source.frame, track, found.throw)
    again = radius_on_flights(view, looks, corners.radius_m, found.chain.contour_sigma_px)
    if again is None or again.sigma_m > corners.sigma_m or again.radius_m == 0.0:
        return corners, 0.0
    return again, contour_sigma_px(view, again.sigma_m, p, R)
