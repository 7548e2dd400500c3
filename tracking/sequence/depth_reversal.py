"""Dice that were taken for their reversal in depth.

A wire cube can be seen in two ways (Necker, London and Edinburgh Phil. Mag. 1, 329, 1832), and so can the outline of a die:
what is near exchanged with what is far, it draws the same but for perspective and for the edges inside. A tetrahedron that turns
one face to the camera is then one that points at it with a corner, whose three edges nobody sees: as if its faces were of one
grey. In flight the reversal turns nearly as evenly as the die does, and on one frame little tells the two apart. Over many it is
plain: its poses do not lie on a motion with the fall of g as those of the die do.

The vertices of a die, reflected through its centre, are those of the die turned by some rotation T (the identity, but for the
tetrahedron). The reversal in depth of an orientation R, seen along u, is a half turn about u of R T.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.die import inversion_rotation, nearest_equivalent_rotation
from ..footage import FrameSource
from ..picture import View
from ..pose import ClipPoses, Pose, as_track, refine_pose, same_picture
from ..throw import UNMODELLED_SHARE, fit_flights, observations_of
from ..track import Track
from .frame_to_frame import FrameTracker

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOOKED_AT, FEWEST = 36, 3
"""Frames that are asked, spread over the clip, and how many of them in a row begin or end a run of the reversal. A refinement
of one frame may stop in another minimum for the last digit of its start: where one frame ended a run, five of 16 films that
differ in their noise alone kept its shorter part, and three in a row have ended none of them."""
STRAINED, WINDOW = 1.5, 24
"""Mean square, in sigmas, of how far so many poses lie off one motion, from which on they may be those of no die in flight: or an
impact is among them."""
NEARLY = 0.15
"""By how much worse a reversal may explain the pictures: where a die shows one face, single ones hardly tell the two apart."""
RELIEVED, FLYING = 0.5, 8.0
"""Share of the strain that the reversal may leave at the most, and how much: dice in flight are followed with less. Of a die that
rests, or that an impact turns, all is strained whatever its pose."""
COVERED = 0.9
"""Share of the frames of a run on which the reversal must have been followed."""
TRIED, ROUNDS = 3, 3
"""Frames of a run from which its reversal is followed, of which some show it well enough; and how often runs are looked for:
those that were put right may show others."""
SETTLE = 8
"""Frames over which the motion is learned from a reversed pose, before it is followed to both ends of the run."""


def reversed_in_depth(view: View, position_m: Array, rotation: Array) -> Array | None:
    """The orientation (3, 3) that draws nearly the same outline with near and far exchanged, along the line of sight of the
    first camera; None of a solid that has none."""
    inversion = inversion_rotation(view.die.solid)
    if inversion is None:
        return None
    return np.asarray(_half_turn(view, position_m) @ rotation @ inversion)


def _half_turn(view: View, position_m: Array) -> Array:
    """(3, 3) about the line of sight of the first camera."""
    along = (position_m - view.camera.centre_m) / np.linalg.norm(position_m - view.camera.centre_m)
    return np.asarray(2.0 * np.outer(along, along) - np.eye(3))


def correct_depth_reversals(view: View, source: FrameSource, seen: ClipPoses, unused: Mask) -> ClipPoses:
    """The sightings with runs of frames followed anew from their reversal, where they lie on no motion of a die in flight and
    those of the reversal do so better.

    Nothing is asked of films so fast that frames were left out, nor of several cameras: what is reversed for one is none for
    the others.
    """
    if seen.frame_stride > 1 or len(source.clips) > 1:
        return seen
    for _ in range(ROUNDS):
        before, seen = seen, _once(view, source, seen, unused)
        if seen is before:
            break
    return seen


def _once(view: View, source: FrameSource, seen: ClipPoses, unused: Mask) -> ClipPoses:
    """The same sightings where no run was put right."""
    known = np.flatnonzero(seen.known)
    rows = known[np.unique(np.linspace(0, len(known) - 1, min(LOOKED_AT, len(known))).astype(int))]
    asked = _strains(as_track(view, source, seen), rows) > STRAINED
    reversals = [
        _reversal(view, source, seen, int(k)) if is_asked else None for k, is_asked in zip(rows, asked, strict=True)
    ]
    for begin, end in _runs(np.array([pose is not None for pose in reversals])):
        # The die is itself again somewhere before the next frame that was asked.
        first = int(rows[begin - 1]) + 1 if begin > 0 else 0
        stop = int(rows[end]) if end < len(rows) else len(source)
        run, left, best = slice(int(rows[begin]), int(rows[end - 1]) + 1), RELIEVED, seen
        shown = [i for i in range(begin, end) if reversals[i] is not None]
        for i in (shown[j] for j in np.unique(np.linspace(0, len(shown) - 1, min(TRIED, len(shown))).astype(int))):
            pose, k = reversals[i], int(rows[i])
            assert pose is not None
            other = _followed(view, source, pose, _reversed_motion(view, seen, k), k, (first, stop), unused)
            share = _left(view, source, seen, other, run)
            if share < left:
                left, best = share, other
        if best is not seen:
            seen = _taken_over(view, seen, best, run)
    return seen


def _runs(shown: Mask) -> list[tuple[int, int]]:
    """Ranges (begin, end) of the frames asked (n,) over which the reversal is `shown`. FEWEST in a row make a run, and as many
    without it in a row end it: a single frame, on which a refinement may stop in another minimum, ends none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], shown, [False]])))
    runs: list[tuple[int, int]] = []
    longest: list[int] = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if runs and begin - runs[-1][1] < FEWEST:
            runs[-1], longest[-1] = (runs[-1][0], end), max(longest[-1], end - begin)
        else:
            runs.append((begin, end))
            longest.append(end - begin)
    return [run for run, frames in zip(runs, longest, strict=True) if frames >= FEWEST]


def _left(view: View, source: FrameSource, seen: ClipPoses, other: ClipPoses, run: slice) -> float:
    """The share of the strain that another leaves on the frames that both saw; infinite where it is not that of a die in flight
    either, or misses frames of the run, or the pictures deny it. The middling window counts: those with an impact fit neither."""
    both = seen.known & other.known
    covered = both[run].sum() >= COVERED * seen.known[run].sum()
    if (
        not covered
        or both.sum() < SETTLE
        or other.cost_with_edge_noise[both].mean() > seen.cost_with_edge_noise[both].mean() + NEARLY
    ):
        return np.inf
    rows = np.flatnonzero(both)[:: WINDOW // 2]
    ours, theirs = (float(np.median(_strains(as_track(view, source, one, both), rows))) for one in (seen, other))
    return theirs / ours if 0.0 < theirs < FLYING and ours > 0.0 else np.inf


def _reversed_motion(view: View, seen: ClipPoses, k: int) -> Array:
    """(6,) velocity [m/s] and spin [rad/s] of the reversal on one frame."""
    return np.concatenate([seen.motion[k, :3], _half_turn(view, seen.position_m[k]) @ seen.motion[k, 3:]])


def _reversal(view: View, source: FrameSource, seen: ClipPoses, k: int) -> Pose | None:
    """The reversal of the pose on one frame, where it is another one and explains the picture nearly as well."""
    rotation = reversed_in_depth(view, seen.position_m[k], seen.rotation[k])
    if rotation is None:
        return None
    picture, here = np.asarray(source.frame(k), np.float32), (seen.position_m[k], seen.rotation[k])
    pose = refine_pose(view, picture, here[0], rotation, coarse=2, roughly=True)
    if pose.covariance is None or pose.cost_with_edge_noise > seen.cost_with_edge_noise[k] + NEARLY:
        return None
    return None if same_picture(view, here, (pose.position_m, pose.rotation)) else pose


def _followed(
    view: View, source: FrameSource, pose: Pose, moving: Array, k: int, within: tuple[int, int], unused: Mask
) -> ClipPoses:
    """What is seen of the die followed from a pose on frame k, `moving` (6,) with about this velocity [m/s] and spin [rad/s],
    to both ends of a range of frames, as far as it goes."""
    first, stop = within
    seen = ClipPoses.empty(len(source))
    seen.put(k, pose, moving)
    onward = FrameTracker.from_start(view, pose, source.times_s, k, unused, moving)
    settled = min(k + 1 + SETTLE, stop)
    for row in range(k + 1, settled):
        onward.over(source.frame(row)[None], source.times_s, row, seen)
        if onward.misses > 0:
            return seen
    last = int(np.flatnonzero(seen.known)[-1])
    back = onward.turned_back()
    for block in source.blocks(settled, stop):
        with block:
            onward.over(block.frames, source.times_s, block.first, seen)
        if onward.misses > 0:
            break
    for block in source.blocks_backwards(last):
        skipped = max(first - block.first, 0)
        with block:
            back.over(block.frames[skipped:], source.times_s, block.first + skipped, seen)
        if block.first <= first or back.misses > 0:
            break
    return seen


def _strains(track: Track, rows: NDArray[np.int64]) -> Array:
    """(rows,) mean square, in sigmas, of how far the tracked frames about some rows lie off one motion: WINDOW of them, or as
    many as there are; 0 where these are too few to tell."""
    use = np.flatnonzero(track.tracked)
    if len(use) < FEWEST:
        return np.zeros(len(rows))
    at = np.clip(np.searchsorted(use, rows) - WINDOW // 2, 0, max(len(use) - WINDOW, 0))
    windows = [np.arange(k, min(k + WINDOW, len(use))) for k in at]
    _, left = fit_flights(observations_of(track, use, UNMODELLED_SHARE), windows)
    return np.asarray(left / (6.0 * np.array([len(window) for window in windows]) - 12.0))


def _taken_over(view: View, seen: ClipPoses, other: ClipPoses, run: slice) -> ClipPoses:
    """The sightings with those of the other, and nothing on the frames of the run that the other lost. Every
    labelling goes on from that of the frames before."""
    inside = np.zeros(len(seen.known), bool)
    inside[run] = True
    # Beyond the run either may be right: the cheaper one.
    rows = np.flatnonzero(other.known & (inside | ~seen.known | (other.cost < seen.cost)))
    out = seen.copy()
    out.known[inside] = False
    out.take(rows, other)
    for k in (int(rows[0]), int(rows[-1]) + 1):
        before, after = np.flatnonzero(out.known[:k]), k + np.flatnonzero(out.known[k:])
        if len(before) and len(after):
            there, here = out.rotation[before[-1]], out.rotation[after[0]]
            out.rotation[k:] = out.rotation[k:] @ (here.T @ nearest_equivalent_rotation(here, there, view.symmetries))
    return out
