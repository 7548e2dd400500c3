"""Correction of poses that are depth reversals of the true ones.

A wire cube can be seen in two ways (Necker, London and Edinburgh Phil. Mag. 1, 329, 1832), and so can the outline of a die: with
near and far exchanged it draws the same, except for perspective and for interior edges. A tetrahedron that turns one face to the
camera becomes one that points at it with a corner, whose three edges are invisible, as if its faces were of one grey. In flight
the reversal rotates nearly as evenly as the die does, and single frames hardly distinguish the two. Many frames do: poses of the
reversal do not lie on a motion with the fall of g, as those of the die do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..flights import fit_flights
from ..footage import FrameSource
from ..picture import View
from ..pose import ClipPoses, Pose, as_track, half_turn_about_sight, reversed_pose
from ..throw import UNMODELLED_SHARE, weighted_poses
from ..track import Track
from .frame_to_frame import FrameTracker
from .labelling import with_labels_continued

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SAMPLED_FRAMES = 36
"""Frames that are tested, spread over the clip."""
MIN_IN_A_ROW = 3
"""Sampled frames in a row that begin or end a run of the reversal. The refinement of a single frame may converge to another
minimum for a difference in the last digit of its initial pose. When a single frame ended a run, five of 16 films that differ in
their noise alone kept its shorter part; with three in a row none does."""
SUSPICIOUS_CHI2 = 1.5
"""Reduced chi-square of frames about one motion from which they may be those of no die in flight: or an impact is among them."""
WINDOW = 24
"""Frames of one motion."""
REVERSAL_MISFIT = 0.15
"""Misfit by which the pose of a reversal may be worse: where a die shows one face, single frames hardly distinguish the two."""
COSTLY_MISFIT = 0.3
"""Misfit above the usual of the clip from which a frame is compared with its reversal."""
CLEAR_MISFIT = 0.5
"""Misfit by which the reversal of SHORT_RUN frames or fewer must be better to be accepted whatever its motion is. Where a die
passes a view in which near and far draw the same, it may be followed as its reversal from there on. Of a tetrahedron above its
shadow the reversal was better by 0.3."""
SHORT_RUN = 12
"""Frames whose motion hardly shows the fall: over more of them it decides."""
MAX_CHI2_RATIO = 0.5
"""Chi-square of the reversal over that of the poses above which it is rejected. A die at rest, or one that an impact deflects,
has a large chi-square in either pose."""
FLIGHT_CHI2 = 8.0
"""Reduced chi-square above which poses are those of no die in flight."""
MIN_COVERAGE = 0.9
"""Share of the frames of a run over which the reversal must be tracked."""
MAX_TRIALS = 3
"""Frames of a run from which its reversal is tracked: some of them show it well enough."""
MAX_ROUNDS = 3
"""Rounds of the search: runs that were corrected may reveal others."""
MOTION_FRAMES = 8
"""Frames over which the motion of the reversal is learned, before it is tracked to both ends of the run."""


def correct_depth_reversals(view: View, source: FrameSource, poses: ClipPoses, unused: Mask) -> ClipPoses:
    """The poses, with runs of frames replaced by their depth reversal where the poses lie on no motion of a die in flight and
    those of the reversal do, or where the reversal explains the pictures clearly better. Returns `poses` itself if nothing was
    replaced.

    Films so fast that frames were skipped are not tested, nor clips of several cameras: a reversal for one is none for the
    others."""
    if poses.frame_stride > 1 or len(source.clips) > 1:
        return poses
    for _ in range(MAX_ROUNDS):
        before, poses = poses, _corrected_once(view, source, poses, unused)
        if poses is before:
            break
    return poses


def _corrected_once(view: View, source: FrameSource, poses: ClipPoses, unused: Mask) -> ClipPoses:
    """One round; the same poses if no run was replaced."""
    costly = _costly(poses)
    rows = np.union1d(_spread(np.flatnonzero(poses.known)), _spread(np.flatnonzero(costly)))
    suspicious = costly[rows] | (_reduced_chi2(as_track(view, source, poses), rows) > SUSPICIOUS_CHI2)
    reversals = [
        _reversal(view, source, poses, int(k)) if is_suspicious else None
        for k, is_suspicious in zip(rows, suspicious, strict=True)
    ]
    for begin, end in _runs(np.array([pose is not None for pose in reversals])):
        # The true poses resume somewhere before the next sampled frame.
        limits = int(rows[begin - 1]) + 1 if begin > 0 else 0, int(rows[end]) if end < len(rows) else len(source)
        run, ratio, best = slice(int(rows[begin]), int(rows[end - 1]) + 1), MAX_CHI2_RATIO, poses
        found = [
            (int(k), pose) for k, pose in zip(rows[begin:end], reversals[begin:end], strict=True) if pose is not None
        ]
        for i in np.unique(np.linspace(0, len(found) - 1, min(MAX_TRIALS, len(found))).astype(int)):
            k, pose = found[i]
            other = _tracked_from(view, source, pose, _reversed_rates(view, poses, k), k, limits, unused)
            other_ratio = (
                -np.inf if _is_clearly_better(poses, other, run) else _chi2_ratio(view, source, poses, other, run)
            )
            if other_ratio < ratio:
                ratio, best = other_ratio, other
        if best is not poses:
            poses = _merged(view, poses, best, run, source.times_s)
    return poses


def _costly(poses: ClipPoses) -> Mask:
    """(n,) frames whose poses explain them clearly worse than half of the clip."""
    usual = float(np.median(poses.cost_with_edge_noise[poses.known])) if poses.known.any() else np.inf
    return np.asarray(poses.known & (poses.cost_with_edge_noise > usual + COSTLY_MISFIT))


def _spread(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most SAMPLED_FRAMES of some rows, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(SAMPLED_FRAMES, len(rows))).astype(int))]


def _is_clearly_better(poses: ClipPoses, other: ClipPoses, run: slice) -> bool:
    """Whether other poses are those of nearly all frames of a short run and explain their pictures clearly better: its motion
    then need not tell, which a few frames behind an impact hardly show."""
    both = np.flatnonzero((poses.known & other.known)[run]) + run.start
    covered = len(both) >= max(MIN_COVERAGE * poses.known[run].sum(), MIN_IN_A_ROW)
    gain = poses.cost_with_edge_noise[both] - other.cost_with_edge_noise[both]
    return bool(covered and run.stop - run.start <= SHORT_RUN and float(np.median(gain)) > CLEAR_MISFIT)


def _runs(has_reversal: Mask) -> list[tuple[int, int]]:
    """Ranges (begin, end) of sampled frames (n,) over which a reversal exists: MIN_IN_A_ROW in a row begin a run, and as many
    without one in a row end it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], has_reversal, [False]])))
    runs: list[tuple[int, int]] = []
    longest: list[int] = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if runs and begin - runs[-1][1] < MIN_IN_A_ROW:
            runs[-1], longest[-1] = (runs[-1][0], end), max(longest[-1], end - begin)
        else:
            runs.append((begin, end))
            longest.append(end - begin)
    return [run for run, frames in zip(runs, longest, strict=True) if frames >= MIN_IN_A_ROW]


def _chi2_ratio(view: View, source: FrameSource, poses: ClipPoses, other: ClipPoses, run: slice) -> float:
    """Chi-square of other poses over that of the poses, on the frames that both have.

    Infinite if the others are not those of a die in flight either, miss frames of the run, or the pictures contradict them. The
    median over windows counts: those with an impact fit neither."""
    both = poses.known & other.known
    covered = both[run].sum() >= MIN_COVERAGE * poses.known[run].sum()
    if not covered or both.sum() < MOTION_FRAMES:
        return np.inf
    if other.cost_with_edge_noise[both].mean() > poses.cost_with_edge_noise[both].mean() + REVERSAL_MISFIT:
        return np.inf
    rows = np.flatnonzero(both)[:: WINDOW // 2]
    ours, theirs = (float(np.median(_reduced_chi2(as_track(view, source, one, both), rows))) for one in (poses, other))
    return theirs / ours if 0.0 < theirs < FLIGHT_CHI2 and ours > 0.0 else np.inf


def _reversed_rates(view: View, poses: ClipPoses, k: int) -> Array:
    """(6,) velocity [m/s] and spin [rad/s] of the reversal on one frame."""
    return np.concatenate([poses.motion[k, :3], half_turn_about_sight(view, poses.position_m[k]) @ poses.motion[k, 3:]])


def _reversal(view: View, source: FrameSource, poses: ClipPoses, k: int) -> Pose | None:
    """The reversal of the pose on one frame, if it is a different pose and explains the picture nearly as well."""
    picture = np.asarray(source.frame(k), np.float32)
    pose = reversed_pose(view, picture, poses.position_m[k], poses.rotation[k])
    if pose is None or pose.cost_with_edge_noise > poses.cost_with_edge_noise[k] + REVERSAL_MISFIT:
        return None
    return pose


def _tracked_from(
    view: View, source: FrameSource, pose: Pose, rates: Array, k: int, limits: tuple[int, int], unused: Mask
) -> ClipPoses:
    """Poses tracked from one on frame k, with these approximate `rates` (6,) (velocity [m/s], spin [rad/s]), to both ends of a
    range of frames, or until the die is lost."""
    first, stop = limits
    poses = ClipPoses.empty(len(source))
    poses.put(k, pose, rates)
    onward = FrameTracker.from_pose(view, pose, source.times_s, k, unused, rates)
    motion_known = min(k + 1 + MOTION_FRAMES, stop)
    for row in range(k + 1, motion_known):
        onward.track(source.frame(row)[None], source.times_s, row, poses)
        if onward.misses > 0:
            return poses
    last = int(np.flatnonzero(poses.known)[-1])
    back = onward.backwards_tracker()
    for block in source.blocks(motion_known, stop):
        with block:
            onward.track(block.frames, source.times_s, block.first, poses)
        if onward.misses > 0:
            break
    for block in source.blocks_backwards(last):
        with block:
            skipped = max(first - block.first, 0)
            back.track(block.frames[skipped:], source.times_s, block.first + skipped, poses)
        if block.first <= first or back.misses > 0:
            break
    return poses


def _reduced_chi2(track: Track, rows: NDArray[np.int64]) -> Array:
    """(rows,) reduced chi-square of the tracked frames about each of some rows from one motion: of WINDOW frames, or of all if
    there are fewer; 0 if these are too few to decide."""
    use = np.flatnonzero(track.tracked)
    if len(use) < MIN_IN_A_ROW:
        return np.zeros(len(rows))
    at = np.clip(np.searchsorted(use, rows) - WINDOW // 2, 0, max(len(use) - WINDOW, 0))
    windows = [np.arange(k, min(k + WINDOW, len(use))) for k in at]
    _, chi2 = fit_flights(weighted_poses(track, use, UNMODELLED_SHARE), windows)
    return np.asarray(chi2 / (6.0 * np.array([len(window) for window in windows]) - 12.0))


def _merged(view: View, poses: ClipPoses, other: ClipPoses, run: slice, times_s: Array) -> ClipPoses:
    """The poses with those of the other, and none on frames of the run that the other lost. The labelling of each part continues
    that of the frames before."""
    inside = np.zeros(len(poses.known), bool)
    inside[run] = True
    # Beyond the run either may be right: the one of lower cost is taken.
    rows = np.flatnonzero(other.known & (inside | ~poses.known | (other.cost < poses.cost)))
    out = poses.copy()
    out.known[inside] = False
    out.take(rows, other)
    for k in (int(rows[0]), int(rows[-1]) + 1):
        out = with_labels_continued(view, out, times_s, k)
    return out
