"""Where following begins: on the first frame that shows the die whole, with the start that the next frames bear out.

One picture often leaves several poses open. A plain tetrahedron that turns one face to the camera is a triangle, and up to
four poses draw the same triangle (the three-point problem: Haralick et al., Int. J. Comput. Vis. 13, 331, 1994). What
tells them apart is the motion: only the true pose falls with g and turns evenly, and the others sooner or later do not fit
the picture either. So all starts race each other over ever more frames, and whoever explains the pictures clearly worse is out.
Where one picture is enough the race ends at its second stage.

A wrong start that is followed often turns right as soon as the die shows another face. What counts is therefore how a runner
moves now, and one that settled on the way runs back to the frame of its start, over which it must move as evenly. A start is
sure where no other pose is left, and it moves as a die does. Where none is sure, starts on several frames are followed to one:
those that meet there are believed, for wrong ones go astray each in its own way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import quat_from_matrix, rotation_between
from ...model.world import GRAVITY_M_S2
from ..footage import FrameSource
from ..picture import View
from ..pose import (
    SAME_POSE_EDGES,
    ClipPoses,
    ManualInitialisation,
    Pose,
    die_blobs,
    initial_poses,
    manual_initial_pose,
    same_picture,
)
from .frame_to_frame import FrameTracker

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

START_FRAMES = 14
"""Frames on which a start is looked for, a few frames apart, before the clip is given up."""
SMALL, SAMPLED = 0.6, 12
"""Share of the usual size below which a region is no die in view, a clip's die growing by less than that as it comes near, and
frames from which the usual size is known."""
SURE_SUPPORT, FAIR_SUPPORT = 0.85, 0.6
"""Share of the contour that must show a clear step over a race, with no frame missed, for a start to be taken at once; one with
less than the second is none."""
EVEN, OPINIONS = 0.5, 3
"""Unevenness below which a start is taken at once; above it, as of small dice, and where it has rivals, starts on so many
frames are asked at least."""
SHARPER = 0.6
"""Factor on the lens blur with which starts are looked for again where none is borne out, or none is sure by itself: with twice
the true one none was, of a tetrahedron of 27 pixels an edge, and with this the first frame is sure. A blur several times too
small does no harm."""
STAGES = (4, 8, 16, 32, 64)
"""Frames over which the starts race each other; a start must be followed over the second to be believed. From the third on only
the second half of the frames counts."""
BEHIND = 0.3
"""By how much worse than the best a start may explain the pictures and stay in the race. How evenly it moves does not count
before the third stage: right starts take some frames to settle."""
CHEAPER = 0.1
"""By how much better one that moves unevenly explains the pictures where it shows that the winner is not the die: among starts
that are all wrong one may move evenly. A right one is hardly worse than those that its own frames draw astray."""
MET = 0.2
"""Distance of corners, in edges, within which starts from different frames have met: the distance of a small die scatters."""
UNEVEN_EDGE, UNEVEN_RAD = 0.1, np.radians(1.5)
"""Departure (rms) from a parabola, in edges, and from an even turn that no die in flight shows. A wrong start jumps about,
and so does the pose drawn into a shadow."""


@dataclass(frozen=True)
class Rating:
    """How well pictures and motion bear a runner out."""

    misfit: float
    """How badly the pictures are explained, on the mean."""
    unevenness: float = 0.0
    """How unevenly the die would move, in units of what none does."""
    since: int = 0
    """Row of the race from which on these are, and up to which."""
    until: int = 1

    @property
    def badness(self) -> float:
        """What the runners are ordered by."""
        return self.misfit + self.unevenness


@dataclass(eq=False)
class Runner:
    """A start and how far it has been followed."""

    chase: FrameTracker
    seen: ClipPoses
    """The frames of the race alone, the first of them the frame of the start."""
    rating: Rating
    """At the last stage of the race at which somebody moved as a die does."""
    rivals: int = 0
    """Other poses that are as good when the race ends, or uneven and explain the pictures better."""

    @property
    def support(self) -> float:
        """Share of the contour with a clear step, over the race."""
        return float(self.seen.support[self.seen.known].mean())

    @property
    def sure(self) -> bool:
        """Whether nothing speaks against it, and no other frame need be asked."""
        known = np.flatnonzero(self.seen.known)
        whole = len(known) == known[-1] - known[0] + 1
        return self.rivals == 0 and self.support > SURE_SUPPORT and whole and self.rating.unevenness < EVEN


def find_initial_pose(
    view: View, source: FrameSource, unused: Mask, reached: Callable[[int], None] = lambda frame: None
) -> tuple[FrameTracker, ClipPoses] | None:
    """The chase from the first frame that shows the die whole, and what it has seen so far; None where no die is found.

    Frames that are `unused` (n,) are passed over; `reached` is told the frame that is looked at. Where no start is borne out with
    the lens blur of the view, they are looked for in a sharper picture; and on the first frame asked where others are believed
    only because they meet.
    """
    sharper = replace(view, blur_px=SHARPER * view.blur_px)
    found, unsure = _borne_out(view, source, unused, reached)
    if found is not None and not found[1].sure:
        first = best_hypothesis(sharper, source, unsure[0][0], unused)
        found = (unsure[0][0], first) if first is not None and first.sure else found
    if found is None:
        found, others = _borne_out(sharper, source, unused, reached)
        unsure += others
    if found is not None:
        return _begun(found[1], source, found[0], unused)
    if not unsure:
        return None
    k, chosen = min(unsure, key=lambda pair: (pair[1].rivals, -pair[1].support))
    return _begun(chosen, source, k, unused)


def _borne_out(
    view: View, source: FrameSource, unused: Mask, reached: Callable[[int], None]
) -> tuple[tuple[int, Runner] | None, list[tuple[int, Runner]]]:
    """The first start (row, runner) that is sure, or that others meet; and those that are neither."""
    unsure: list[tuple[int, Runner]] = []
    for k, _ in islice(_candidates(view, source, unused, reached), START_FRAMES):
        best = best_hypothesis(view, source, k, unused)
        if best is None or best.support < FAIR_SUPPORT:
            continue
        if best.sure:
            return (k, best), unsure
        unsure.append((k, best))
        agreed = _most_agreed(view, source, unsure)
        if agreed is not None and len(unsure) >= OPINIONS:
            return agreed, unsure
    return _most_agreed(view, source, unsure), unsure


def _most_agreed(view: View, source: FrameSource, starts: list[tuple[int, Runner]]) -> tuple[int, Runner] | None:
    """Of starts on different frames (row, runner) the one that most others meet when they are followed to one frame; of equals
    the more even one, or the first where impacts leave none even; None where no two meet. Wrong starts go astray each in its
    own way, but for those with rivals: what is open in one picture is so in the next."""
    starts = [(k, runner) for k, runner in starts if runner.rivals == 0]
    votes = [sum(_meet(view, source, one, other) for other in starts if other is not one) for one in starts]
    if not any(votes):
        return None
    best = max(range(len(starts)), key=lambda i: (votes[i], -min(starts[i][1].rating.unevenness, 1.0), -starts[i][0]))
    return starts[best]


def _meet(view: View, source: FrameSource, one: tuple[int, Runner], other: tuple[int, Runner]) -> bool:
    """Whether two starts draw the same die on the last frame that the later one was followed to."""
    (k, early), (j, late) = sorted((one, other), key=lambda pair: pair[0])
    row = int(np.flatnonzero(late.seen.known)[-1])
    there = j - k + row
    if there >= len(early.seen.known):
        return False
    for i in range(early.chase.next_frame, there + 1):
        if early.chase.misses > 1:
            break
        early.chase.over(source.frame(k + i)[None], source.times_s[k:], i, early.seen)
    return bool(early.seen.known[there]) and _same(view, early, there, late, row, MET)


def _candidates(
    view: View, source: FrameSource, unused: Mask, reached: Callable[[int], None]
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Frames (row, pictures) that may show the die whole, in order and ever wider apart.

    A shadow comes into view before the die that casts it, and a die bit by bit, on many frames: once the first of them was
    no beginning, those that show much less than frames of this clip usually do come last.
    """
    # Three frames fit wrong starts as well: 200 frames a second of a die that turns ten degrees a frame gave poses 45 degrees
    # off, with sigmas of a tenth of one, on the last three. A clip of fewer frames than are wanted is all there is.
    last = len(source) - min(STAGES[1], len(source))
    tried, k, least_px, small = 0, 0, 0.0, []
    while k <= last:
        reached(k)
        image = np.asarray(source.frame(k), np.float32)
        blobs = [] if unused[k] else die_blobs(view, image[0])
        if blobs and blobs[0].area_px >= least_px:
            tried += 1
            yield k, image
            if tried == 1:
                least_px = SMALL * _usual_area_px(view, source)
            k += 4 + tried
        else:
            small += [k] if blobs else []
            k += 1
    for k in small[:: 1 + len(small) // START_FRAMES]:
        yield k, np.asarray(source.frame(k), np.float32)


def _usual_area_px(view: View, source: FrameSource) -> float:
    """Median size of what differs from the background and is no shadow, over some frames of the clip."""
    rows = np.unique(np.linspace(0, len(source) - 1, SAMPLED).astype(int))
    areas = [
        blobs[0].area_px for k in rows if (blobs := die_blobs(view, np.asarray(source.frame(int(k))[0], np.float32)))
    ]
    return float(np.median(areas)) if areas else 0.0


def initial_pose_by_hand(
    view: View, source: FrameSource, by_hand: ManualInitialisation, unused: Mask
) -> tuple[FrameTracker, ClipPoses]:
    """The chase from the pose that a person gave. Raises ValueError for a frame that is not there or not used."""
    k = by_hand.frame - source.first_frame
    if not 0 <= k < len(source) or unused[k]:
        last = source.first_frame + len(source) - 1
        raise ValueError(
            f"start.frame = {by_hand.frame}: wanted a frame of the clip ({source.first_frame} to {last}), none that is "
            "excluded"
        )
    pose = manual_initial_pose(view, np.asarray(source.frame(k)[0], np.float32), by_hand)
    return _begun(_at_the_line(view, source, k, pose, unused), source, k, unused)


def _begun(runner: Runner, source: FrameSource, k: int, unused: Mask) -> tuple[FrameTracker, ClipPoses]:
    """The chase and what it saw, with the rows of the clip in place of those of the race that began on frame k. Of a start
    that is not sure the end is kept, where it met others or the die had shown most of itself, and what came before as far as the
    pictures bear it out as well; the rest is looked at again from there."""
    seen, chase = ClipPoses.empty(len(source)), runner.chase
    rows = np.flatnonzero(runner.seen.known)
    if not runner.sure:
        cost, end = runner.seen.cost[rows], max(len(rows) - STAGES[1], 0)
        dear = np.flatnonzero(cost[:end] > np.median(cost[end:]) + BEHIND)
        settled = runner.rivals == 0 and runner.rating.since == 0
        rows = rows[(dear[-1] + 1 if len(dear) else 0) if settled else end :]
    seen.take(k + rows, runner.seen, rows)
    chase.next_frame, chase.unused = k + chase.next_frame, unused
    return chase, seen


def best_hypothesis(view: View, source: FrameSource, k: int, unused: Mask) -> Runner | None:
    """The start on frame k that the frames after it bear out best; None where they bear out none."""
    left = min(STAGES[-1], len(source) - k)
    starts = initial_poses(view, np.asarray(source.frame(k), np.float32))
    runners = [_at_the_line(view, source, k, pose, unused) for _, pose in starts]
    for stage in sorted({min(stage, left) for stage in STAGES}):
        rated = [(r, rating) for r in runners if (rating := _followed(r, view, source, k, stage)) is not None]
        # Past an impact nobody moves evenly any more: of those still on the die, who led before it has won.
        even = [(r, rating) for r, rating in rated if rating.unevenness < 1.0 or stage < min(STAGES[2], left)]
        if not even:
            followed = [r for r, _ in rated]
            return (
                _winner(view, source, k, [r for r in runners if r in followed] or runners)
                if stage > STAGES[1]
                else None
            )
        least = min(rating.misfit for _, rating in even)
        for runner, rating in even:
            runner.rating = rating
        near = [r for r, rating in even if rating.misfit < least + BEHIND]
        runners = _apart(view, sorted(near, key=lambda r: r.rating.badness))
        uneven = [rating.misfit for _, rating in rated if rating.unevenness >= 1.0]
        cheaper = sum(misfit < runners[0].rating.misfit - CHEAPER for misfit in uneven)
        if len(runners) == 1 and stage >= STAGES[1] and runners[0].rating.unevenness < EVEN:
            break
    return _winner(view, source, k, runners, cheaper)


def _winner(view: View, source: FrameSource, k: int, runners: list[Runner], cheaper: int = 0) -> Runner | None:
    """The first of the runners, with the number of its rivals, of which some are `cheaper` than it and uneven. One that settled
    on the way runs back to the start, which must look as even."""
    if not runners:
        return None
    best = runners[0]
    best.rivals = len(runners) - 1 + cheaper
    last = int(np.flatnonzero(best.seen.known)[-1])
    if best.rating.since and last < best.rating.until:
        back = best.chase.turned_back()
        best.seen.known[:last] = False
        back.over(np.stack([source.frame(k + row) for row in range(last)]), source.times_s[k:], 0, best.seen)
        best.rating = _rating(view, best.seen, source.times_s[k:], 0, last + 1)
    return best


def _at_the_line(view: View, source: FrameSource, k: int, pose: Pose, unused: Mask) -> Runner:
    """A start that has not been followed yet."""
    seen = ClipPoses.empty(min(STAGES[-1], len(source) - k))
    seen.put(0, pose, np.zeros(6))
    chase = FrameTracker.from_start(view, pose, source.times_s[k:], 0, unused[k:])
    return Runner(chase, seen, Rating(pose.cost_with_edge_noise))


def _followed(runner: Runner, view: View, source: FrameSource, k: int, stage: int) -> Rating | None:
    """Follow a start up to so many frames; None where the die was lost on the way."""
    chase, seen, times_s = runner.chase, runner.seen, source.times_s[k:]
    for j in range(chase.next_frame, stage):
        chase.over(source.frame(k + j)[None], times_s, j, seen)
        if chase.misses > 1:
            return None
    if seen.known[:stage].sum() < stage - 1:
        return None
    # A start that was a little off takes some frames to settle, and one that was wrong may turn right when the die shows
    # another face: what counts is how it runs now.
    since = stage // 2 if stage > STAGES[1] else 0
    whole = _rating(view, seen, times_s, 0, stage)
    return whole if whole.unevenness < EVEN else _rating(view, seen, times_s, since, stage)


def _rating(view: View, seen: ClipPoses, times_s: Array, since: int, until: int) -> Rating:
    """The rating of a run from row `since` to before `until`."""
    misfit = float(seen.cost_with_edge_noise[since:until][seen.known[since:until]].mean())
    return Rating(misfit, _unevenness(view, seen, times_s, since, until), since, until)


def _unevenness(view: View, seen: ClipPoses, times_s: Array, since: int, until: int) -> float:
    """How far the poses from row `since` to before `until` depart from a parabola and an even turn; 1 where no die in flight
    does."""
    known = since + np.flatnonzero(seen.known[since:until])
    if len(known) < 3:
        return 0.0
    middle = int(known[len(known) // 2])
    t = times_s[known] - times_s[middle]
    fall = seen.position_m[known] + np.outer(0.5 * GRAVITY_M_S2 * t * t, [0.0, 0.0, 1.0])
    turns = rotation_between(quat_from_matrix(seen.rotation[middle]), quat_from_matrix(seen.rotation[known]))
    return max(_departure(t, fall) / (UNEVEN_EDGE * view.die.solid.edge_m), _departure(t, turns) / UNEVEN_RAD)


def _departure(t: Array, values: Array) -> float:
    """Root mean square distance of values (n, 3) from a straight line over t (n,)."""
    line = np.stack([np.ones_like(t), t], 1) @ np.polynomial.polynomial.polyfit(t, values, 1)
    return float(np.sqrt(((values - line) ** 2).sum(1).mean()))


def _apart(view: View, runners: list[Runner]) -> list[Runner]:
    """The best of those that ended up on the same pose."""
    kept: list[Runner] = []
    for runner in runners:
        last = int(np.flatnonzero(runner.seen.known)[-1])
        if not any(other.seen.known[last] and _same(view, runner, last, other, last) for other in kept):
            kept.append(runner)
    return kept


def _same(view: View, one: Runner, row: int, other: Runner, other_row: int, within: float = SAME_POSE_EDGES) -> bool:
    """Whether two runners draw the same die, each on its own row."""
    here, there = ((r.seen.position_m[k], r.seen.rotation[k]) for r, k in ((one, row), (other, other_row)))
    return same_picture(view, here, there, within)
