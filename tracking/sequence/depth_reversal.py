"""Correction of poses that are depth reversals of the true ones.

A wire cube can be seen in two ways (Necker, London and Edinburgh Phil. Mag. 1, 329, 1832), and so can the outline of a die: with
near and far exchanged it draws the same, except for perspective and for interior edges. A tetrahedron that turns one face to the
camera becomes one that points at it with a corner, whose three edges are invisible, as if its faces were of one grey. In flight
the reversal rotates nearly as evenly as the die does, and single frames hardly distinguish the two. Many frames do: poses of the
reversal do not lie on a motion with the fall of g, as those of the die do."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.die import nearest_equivalent_rotation
from ...model.rotations import angle_between, matrix_from_quat, quat_from_rotvec
from ..flights import fit_flights
from ..footage import FrameSource
from ..frame_to_frame import FrameTracker
from ..picture import View
from ..pose import ClipPoses, Pose, as_track, half_turn_about_sight, reversed_pose, wholly_in_view
from ..throw import UNMODELLED_SHARE, weighted_poses
from ..track import Track
from .labelling import with_rows_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SAMPLED_FRAMES = 36
"""Frames that are tested, spread over the clip."""
SAMPLED_OF_PIECE = 12
"""Frames that are tested of each piece between jumps of the poses."""
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
"""Misfit by which the reversal must be better to be accepted whatever its motion is, of SHORT_RUN frames or fewer, or of more
between impacts that leave no flight. Where a die passes a view in which near and far draw the same, it may be followed as its
reversal from there on. Of a tetrahedron above its shadow the reversal was better by 0.3."""
SHORT_RUN = 12
"""Frames whose motion hardly shows the fall: over more of them it decides."""
MAX_CHI2_RATIO = 0.5
"""Chi-square of the reversal over that of the poses above which it is rejected. A die at rest, or one that an impact deflects,
has a large chi-square in either pose."""
FLIGHT_CHI2 = 8.0
"""Reduced chi-square above which poses are those of no die in flight."""
GOOD_CHI2 = 4.0
"""Reduced chi-square below which motions are equally good, and the pictures decide."""
DECISIVE_CHI2_RATIO = 0.1
"""Chi-square of the reversal of more than SHORT_RUN frames over that of the poses, below which pictures no longer count: those of
a dark die whose edges hardly show may prefer the wrong one. Its chi-square was 25 times that of the true poses there. With an
impact among the frames, right poses may have a hundred times that of a reversal; but this jumps where they do not."""
JUMP_RAD = 0.35
"""Rotation [rad] between neighbouring frames, beyond that by their spins, at which one of them is taken for a reversal. An impact
that changes the spin by 350 rad/s turns a die by as much within half a frame at 500 frames/s; a false jump costs time alone."""
END_FRAMES = 2
"""Frames at either end of a run that may lie beyond an impact."""
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


@dataclass(frozen=True, eq=False)
class _ReversedRun:
    """The reversal of a run of frames, better than the poses there."""

    poses: ClipPoses
    """Tracked from one of its frames; of the run and some frames beside it."""
    run: slice
    chi2: float
    """Reduced chi-square of the clip's motion about the run with the reversal; -inf if the pictures decide."""
    gain: float
    """Misfit of the pictures by which it is better; negative if it is worse."""


def _corrected_once(view: View, source: FrameSource, poses: ClipPoses, unused: Mask) -> ClipPoses:
    """One round; the same poses if no run was replaced.

    Of two neighbouring pieces only one is reversed in a round, the one with which the motion is better: with the other a flight
    would be reversed as a whole, and still turn evenly."""
    ends = _piece_ends(view, poses, source.times_s)
    pieces = list(itertools.pairwise(ends))
    found: list[_ReversedRun] = []
    for piece, rows in zip(pieces, _sampled_rows(poses, pieces), strict=True):
        found += _better_runs(view, source, poses, unused, piece, rows, has_jumps=len(pieces) > 1)
    found.sort(key=lambda one: (max(one.chi2, GOOD_CHI2), -one.gain))
    reversed_pieces: set[int] = set()
    for one in found:
        number = bisect_right(ends, one.run.start)
        if not reversed_pieces & {number - 1, number + 1}:
            reversed_pieces.add(number)
            poses = _merged(view, poses, one.poses, one.run, source.times_s)
    return poses


def _piece_ends(view: View, poses: ClipPoses, times_s: Array) -> list[int]:
    """The rows, 0 and the number of all among them, at which poses begin that do not go on from those before: a tracker that has
    followed a reversal, or has come to one, jumps in the middle of a flight."""
    known = np.flatnonzero(poses.known)
    half_s = 0.5 * np.diff(times_s[known])[:, None]
    spin = poses.motion[known, 3:]
    there = matrix_from_quat(quat_from_rotvec(half_s * spin[:-1])) @ poses.rotation[known[:-1]]
    here = matrix_from_quat(quat_from_rotvec(-half_s * spin[1:])) @ poses.rotation[known[1:]]
    jump_rad = angle_between(there, nearest_equivalent_rotation(here, there, view.symmetries))
    return [0, *known[1:][jump_rad > JUMP_RAD].tolist(), len(poses.known)]


def _sampled_rows(poses: ClipPoses, pieces: list[tuple[int, int]]) -> list[NDArray[np.int64]]:
    """For each piece the rows that are tested: some spread over the clip, some of those that are costly, and where there are
    several pieces some of each."""
    known = np.flatnonzero(poses.known)
    rows = np.union1d(_spread(known, SAMPLED_FRAMES), _spread(np.flatnonzero(_costly(poses)), SAMPLED_FRAMES))
    if len(pieces) > 1:
        each = [_spread(known[(known >= begin) & (known < end)], SAMPLED_OF_PIECE) for begin, end in pieces]
        rows = np.union1d(rows, np.concatenate(each))
    return [rows[(rows >= begin) & (rows < end)] for begin, end in pieces]


def _better_runs(
    view: View,
    source: FrameSource,
    poses: ClipPoses,
    unused: Mask,
    piece: tuple[int, int],
    rows: NDArray[np.int64],
    *,
    has_jumps: bool,
) -> list[_ReversedRun]:
    """The runs of one piece, given by its first row and the row behind it, whose reversal is better, tested on some `rows` of
    it."""
    begin, end = piece
    chi2 = _reduced_chi2(as_track(view, source, poses), rows, piece)
    # Poses that jump are those of no flight: then their reversals are tested whatever the pictures say.
    most = np.where(has_jumps & (chi2 > FLIGHT_CHI2), np.inf, REVERSAL_MISFIT)
    suspicious = _costly(poses)[rows] | (chi2 > SUSPICIOUS_CHI2) | has_jumps
    reversals = [
        _reversal(view, source, poses, int(k), float(misfit)) if is_suspicious else None
        for k, is_suspicious, misfit in zip(rows, suspicious, most, strict=True)
    ]
    found = []
    for first, stop in _runs(np.array([pose is not None for pose in reversals])):
        # The true poses resume somewhere before the next sampled frame.
        limits = int(rows[first - 1]) + 1 if first > 0 else begin, int(rows[stop]) if stop < len(rows) else end
        own = zip(rows[first:stop].tolist(), reversals[first:stop], strict=True)
        starts = [(k, pose) for k, pose in own if pose is not None]
        best = _best_reversed_run(view, source, poses, unused, limits, starts)
        found += [] if best is None else [best]
    return found


def _best_reversed_run(
    view: View,
    source: FrameSource,
    poses: ClipPoses,
    unused: Mask,
    limits: tuple[int, int],
    starts: list[tuple[int, Pose]],
) -> _ReversedRun | None:
    """The best reversal within a range of rows, tracked from some of the reversals on single rows; None if none is better than
    the poses."""
    rows = slice(starts[0][0], starts[-1][0] + 1)
    least, best = MAX_CHI2_RATIO, None
    for i in np.unique(np.linspace(0, len(starts) - 1, min(MAX_TRIALS, len(starts))).astype(int)):
        k, pose = starts[i]
        other = _tracked_from(view, source, pose, _reversed_rates(view, poses, k), k, limits, unused)
        run = _followed(poses, other, rows, k)
        gain, is_long = _gain(poses, other, run), run.stop - run.start > SHORT_RUN
        if _is_clearly_better(poses, other, run) and not (is_long and _motion_decides(view, source, poses, other, run)):
            ratio, chi2 = -np.inf, -np.inf
        else:
            ratio, chi2 = _chi2_ratio(view, source, poses, other, run)
            is_decisive = ratio < DECISIVE_CHI2_RATIO and is_long
            if gain < -REVERSAL_MISFIT and not (is_decisive and not _adds_jumps(view, source, poses, other, run)):
                continue
        if ratio < least:
            least, best = ratio, _ReversedRun(other, run, chi2, gain)
    return best


def _adds_jumps(view: View, source: FrameSource, poses: ClipPoses, other: ClipPoses, run: slice) -> bool:
    """Whether the clip jumps at more places with others in a run than with the poses."""
    merged = _merged(view, poses, other, run, source.times_s)
    return len(_piece_ends(view, merged, source.times_s)) > len(_piece_ends(view, poses, source.times_s))


def _followed(poses: ClipPoses, other: ClipPoses, run: slice, k: int) -> slice:
    """The part of a run about row k over which another was tracked without a gap, if it shows a motion: tracking may end at an
    impact. Otherwise the run."""
    missing = np.flatnonzero(poses.known & ~other.known)
    begin = int(max([run.start, *(missing[missing < k] + 1)]))
    end = int(min([run.stop, *missing[missing > k]]))
    return slice(begin, end) if end - begin > SHORT_RUN else run


def _costly(poses: ClipPoses) -> Mask:
    """(n,) frames whose poses explain them clearly worse than half of the clip."""
    usual = float(np.median(poses.cost_with_edge_noise[poses.known])) if poses.known.any() else np.inf
    return np.asarray(poses.known & (poses.cost_with_edge_noise > usual + COSTLY_MISFIT))


def _spread(rows: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """At most so many of some rows, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))]


def _gain(poses: ClipPoses, other: ClipPoses, run: slice) -> float:
    """Mean misfit by which other poses explain the pictures of a run better, on the frames that both have; -inf without any."""
    both = np.flatnonzero((poses.known & other.known)[run]) + run.start
    return float((poses.cost_with_edge_noise[both] - other.cost_with_edge_noise[both]).mean()) if len(both) else -np.inf


def _is_clearly_better(poses: ClipPoses, other: ClipPoses, run: slice) -> bool:
    """Whether other poses are those of nearly all frames of a run and explain their pictures clearly better."""
    both = np.flatnonzero((poses.known & other.known)[run]) + run.start
    covered = len(both) >= max(MIN_COVERAGE * poses.known[run].sum(), MIN_IN_A_ROW)
    gain = poses.cost_with_edge_noise[both] - other.cost_with_edge_noise[both]
    return bool(covered and float(np.median(gain)) > CLEAR_MISFIT)


def _motion_decides(view: View, source: FrameSource, poses: ClipPoses, other: ClipPoses, run: slice) -> bool:
    """Whether the motion decides which of two poses are those of a die: not where impacts follow each other so fast that no
    motion through the frames about a run is that of one in flight, with either, and the others scatter less in the run."""
    if min(_chi2_about(view, source, poses, other, run)) < FLIGHT_CHI2:
        return True
    both = poses.known & other.known
    before, after = (_median_chi2(view, source, one, both, (run.start, run.stop)) for one in (poses, other))
    return after > before


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


def _chi2_ratio(view: View, source: FrameSource, poses: ClipPoses, other: ClipPoses, run: slice) -> tuple[float, float]:
    """Chi-square of other poses over that of the poses, and the former, on the frames of a run that both have, or on the clip
    about the run with one or the other in it; whichever is less.

    Infinite if the others are not those of a die in flight either, or miss frames of the run. The median over windows counts:
    those with an impact fit neither."""
    both = poses.known & other.known
    covered = both[run].sum() >= MIN_COVERAGE * poses.known[run].sum()
    if not covered or both.sum() < MOTION_FRAMES:
        return np.inf, np.inf
    everywhere, inner = (0, len(both)), (run.start + END_FRAMES, run.stop - END_FRAMES)
    before, after = (_median_chi2(view, source, one, both, everywhere) for one in (poses, other))
    if both[slice(*inner)].sum() >= MOTION_FRAMES:
        # A frame from beyond an impact at an end of the run is on no motion with the others.
        before = min(before, _median_chi2(view, source, poses, both, inner))
    pairs = ((before, after), _chi2_about(view, source, poses, other, run))
    flying = [(after / before, after) for before, after in pairs if 0.0 < after < FLIGHT_CHI2 and before > 0.0]
    return min(flying, default=(np.inf, np.inf))


def _chi2_about(view: View, source: FrameSource, poses: ClipPoses, other: ClipPoses, run: slice) -> tuple[float, float]:
    """Chi-square of the clip about a run with the poses, and with the others in the run."""
    merged = _merged(view, poses, other, run, source.times_s)
    shown = poses.known & merged.known & wholly_in_view(view, merged)
    about = max(run.start - WINDOW // 2, 0), min(run.stop + WINDOW // 2, len(shown))
    before, after = (_median_chi2(view, source, one, shown, about) for one in (poses, merged))
    return before, after


def _median_chi2(view: View, source: FrameSource, poses: ClipPoses, shown: Mask, within: tuple[int, int]) -> float:
    """Median reduced chi-square of windows of the shown frames within a range; infinite without any."""
    rows = np.flatnonzero(shown[slice(*within)])[:: WINDOW // 2] + within[0]
    if not len(rows):
        return np.inf
    return float(np.median(_reduced_chi2(as_track(view, source, poses, shown), rows, within)))


def _reversed_rates(view: View, poses: ClipPoses, k: int) -> Array:
    """(6,) velocity [m/s] and spin [rad/s] of the reversal on one frame."""
    return np.concatenate([poses.motion[k, :3], half_turn_about_sight(view, poses.position_m[k]) @ poses.motion[k, 3:]])


def _reversal(view: View, source: FrameSource, poses: ClipPoses, k: int, limit: float) -> Pose | None:
    """The reversal of the pose on one frame, if it is a different pose and its misfit is larger by less than a limit."""
    picture = np.asarray(source.frame(k), np.float32)
    pose = reversed_pose(view, picture, poses.position_m[k], poses.rotation[k])
    if pose is None or pose.cost_with_edge_noise > poses.cost_with_edge_noise[k] + limit:
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


def _reduced_chi2(track: Track, rows: NDArray[np.int64], within: tuple[int, int]) -> Array:
    """(rows,) reduced chi-square of the tracked frames about each of some rows from one motion: of WINDOW frames within a range,
    or of all if there are fewer; 0 if these are too few to decide."""
    use = within[0] + np.flatnonzero(track.tracked[slice(*within)])
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
    return with_rows_of(view, out, other, rows, times_s)
