"""Where tracking begins: the first frame that shows the die whole, with the initial pose that the next frames support best.

One picture often leaves several poses open. A plain tetrahedron that turns one face to the camera is a triangle, and up to four
poses draw the same triangle (the three-point problem: Haralick et al., Int. J. Comput. Vis. 13, 331, 1994). The motion
distinguishes them: only the true pose falls with g and rotates evenly, and the others sooner or later do not fit the picture
either. So all initial poses are hypotheses that are tracked over more and more frames, and those that explain the pictures
clearly worse are rejected. If one picture suffices, that ends at the second stage.

Pictures of printed faces may prefer a wrong pose by much. From HALF_STAGE frames on the scatter of the poses about one flight
counts as their misfit does, and what lies behind the first impact of the leading hypothesis does not count.

A wrong hypothesis often becomes right as soon as the die shows another face. What counts is therefore its recent motion; a
hypothesis that changed on the way is tracked back to its first frame, over which it must move as evenly. A hypothesis is certain
if no other pose is left and it moves as a die does. If none is certain, hypotheses from several frames are tracked to a common
frame, and those that agree there are accepted: wrong ones diverge."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ..footage import FrameSource
from ..frame_to_frame import (
    AMBIGUOUS_COST,
    FASTEST_M_S,
    HEIGHT_SIGMAS,
    MIN_POSES_OF_FLIGHT,
    MOST_CANDIDATES,
    FrameTracker,
    is_high,
    lowest_m,
    motion_of_poses,
)
from ..picture import View
from ..pose import (
    SAME_POSE_EDGES,
    UNEVEN,
    ClipPoses,
    ManualInitialisation,
    Pose,
    die_blobs,
    excess_on_same_pixels,
    log_scatter,
    manual_initial_pose,
    pose_candidates,
    reversed_pose,
    same_picture,
    unevenness,
    velocity_across_m_s,
)
from ..throw import contact_reach_m
from .places import PlacesBeside

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

MAX_FIRST_FRAMES = 14
"""Frames on which an initial pose is searched, a few frames apart, before the clip is given up."""
FIRST_SPACING = 4
"""Frames from the first of these to the second, less one; each further distance is a frame longer."""
SMALL_SHARE = 0.6
"""Share of the usual area below which a region does not show the whole die: the die grows by less than that as it comes
nearer."""
SAMPLED_FRAMES = 12
"""Frames from which the usual area is determined."""
CERTAIN_SHARE = 0.85
"""Share of the contour with a clear step, over all frames and with none missed, above which a hypothesis is accepted at once."""
MIN_SUPPORT = 0.6
"""Least mean of `Pose.support` of any hypothesis. A clear share as large suffices where more frames than those of the second
stage show an even motion: a face as bright as the table has no step on any of them."""
EVEN = 0.5
"""Unevenness below which a hypothesis is accepted at once."""
MIN_HYPOTHESES = 3
"""Frames whose hypotheses are compared at least if none is certain, as of small dice."""
SHARPER = 0.6
"""Factor on the lens blur for a second search if no hypothesis is accepted, or that of the first frame is uncertain. With twice
the true blur none was accepted of a tetrahedron of 27 pixels an edge, and with this factor that on the first frame is certain. A
blur several times too small does no harm."""
STAGES = (4, 8, 16, 32, 64)
"""Frames over which hypotheses are tracked, stage by stage. A hypothesis must be tracked over the second stage to be accepted;
from the third on only the second half of the frames counts."""
FULL_STAGE = STAGES[1]
"""Frames over which a hypothesis must be tracked."""
HALF_STAGE = STAGES[2]
"""Frames from which on evenness decides: right hypotheses take some frames to converge."""
LATE_ROWS = 2
"""Rows behind an impact before it is noticed: poses there lie on no flight with those before."""
REJECTION_MISFIT = 0.3
"""Misfit above the least by which a hypothesis is rejected, that of the motion included from HALF_STAGE on."""
CONTRADICTING_MISFIT = 0.1
"""Misfit below that of the winner by which an uneven hypothesis contradicts it: among wrong hypotheses one may move evenly. A
right one is hardly worse than those that its own frames draw away from it."""
AGREEMENT_EDGES = 0.2
"""Distance of corners, in edges, within which hypotheses from different frames agree: the distance of a small die is
uncertain."""
SAME_AREA_LOG = 0.4
"""Logarithm of the ratio of areas beyond which the regions of two frames do not show the same."""


@dataclass(frozen=True)
class Score:
    """How well pictures and motion support a hypothesis."""

    misfit: float
    """Mean misfit of the second half of the pictures."""
    unevenness: float = 0.0
    """Departure from the motion of a die in flight, in units of UNEVEN_EDGES and UNEVEN_RAD."""
    since: int = 0
    """First row of the hypothesis that this covers."""
    until: int = 1
    """Row behind the last."""
    log_scatter: float = 0.0
    """Logarithm of the residual standard deviation of all poses about one flight, in units of their standard errors: the misfit
    of the motion, as that of the pictures holds the logarithm of the noise that they leave. 0 at the least, and before
    HALF_STAGE."""

    @property
    def evidence(self) -> float:
        """Misfit of pictures and motion."""
        return self.misfit + self.log_scatter

    @property
    def total(self) -> float:
        """What hypotheses are ordered by, the best first: the evidence once it holds the motion, whose errors it knows."""
        return self.evidence if self.until >= HALF_STAGE else self.misfit + self.unevenness


@dataclass(eq=False)
class Hypothesis:
    """An initial pose, tracked over some frames."""

    tracker: FrameTracker
    poses: ClipPoses
    """Of the frames since the initial pose."""
    score: Score
    """At the last stage at which any hypothesis moved as a die does."""
    competitors: int = 0
    """Other poses that are as good at the end, or uneven with a smaller misfit."""
    flies_until: int = STAGES[-1]
    """Row of the first impact on the way, where another flight began near the table; more than all rows if there was none."""
    before_impact: FrameTracker | None = None
    """A tracker with the motion before that row."""
    excess: Array = field(default_factory=lambda: np.zeros(STAGES[-1]))
    """(rows,) what the costs are higher by on the pixels of all hypotheses that were compared on a row."""

    def score_of(self, view: View, times_s: Array, since: int, until: int) -> Score:
        """The score of the rows from `since` to before `until`."""
        poses = self.poses
        # An initial pose that was a little off takes some frames to converge.
        settled = (since + until) // 2 + np.flatnonzero(poses.known[(since + until) // 2 : until])
        misfit = self.misfit_on(settled)
        scatter = log_scatter(view, poses, times_s, np.flatnonzero(poses.known[:until])) if until >= HALF_STAGE else 0.0
        return Score(misfit, unevenness(view, poses, times_s, since, until), since, until, scatter)

    def misfit_on(self, rows: Rows) -> float:
        """Mean misfit of the pictures of some rows."""
        return float((self.poses.cost_with_edge_noise[rows] + self.excess[rows]).mean())

    @property
    def clear_share(self) -> float:
        """Share of the contour with a clear step, over all frames."""
        return float(self.poses.clear_share[self.poses.known].mean())

    @property
    def is_certain(self) -> bool:
        """Whether nothing speaks against it, so that no other frame is needed."""
        known = np.flatnonzero(self.poses.known)
        has_no_gap = len(known) == known[-1] - known[0] + 1
        least = CERTAIN_SHARE if self.score.until <= FULL_STAGE else MIN_SUPPORT
        return self.competitors == 0 and self.clear_share > least and has_no_gap and self.score.unevenness < EVEN


Candidate = tuple[int, Hypothesis]
"""A frame and the hypothesis that begins on it."""


def find_initial_pose(
    view: View,
    source: FrameSource,
    unused: Mask,
    report: Callable[[int], None] = lambda frame: None,
    most_frames: int = MAX_FIRST_FRAMES,
) -> tuple[FrameTracker, ClipPoses] | None:
    """A tracker from the first frame that shows the die whole, and its poses so far; None if no die is found.

    Frames that are `unused` (n,) are skipped, and the tracker skips them as well; `report` is called with each frame examined. At
    most `most_frames` are searched. If no hypothesis is accepted with the lens blur of the view, the search is repeated with a
    smaller one; and on the first frame if that is not certain, whatever later ones are. If none is accepted then, the likeliest
    is returned."""
    sharper = replace(view, blur_px=SHARPER * view.blur_px)
    found, uncertain = _search(view, source, unused, report, most_frames=most_frames)
    if found is not None and uncertain:
        # With a blur too large wrong hypotheses may be certain sooner than right ones, by the last bit of a sum.
        k, blurred = uncertain[0]
        sharp = best_hypothesis(sharper, source, k, unused)
        if sharp is not None and sharp.is_certain and _explains_better(view, source, k, sharp, blurred):
            found = k, sharp
    if found is None:
        found, others = _search(sharper, source, unused, report, most_frames=most_frames)
        uncertain += others
    if found is not None:
        return _on_clip(found[1], source, found[0], unused)
    if not uncertain:
        return None
    k, chosen = min(uncertain, key=lambda pair: (pair[1].competitors, -pair[1].clear_share))
    return _on_clip(chosen, source, k, unused)


def find_lost_die(
    view: View, source: FrameSource, unused: Mask, report: Callable[[int], None], beside: PlacesBeside
) -> tuple[FrameTracker, ClipPoses] | None:
    """As `find_initial_pose`, where the lens blur is known and a die need not be in view: None unless a pose is accepted, which
    the places on the frames `beside` can lead to."""
    found, _ = _search(view, source, unused, report, beside)
    return _on_clip(found[1], source, found[0], unused) if found is not None else None


def _search(
    view: View,
    source: FrameSource,
    unused: Mask,
    report: Callable[[int], None],
    beside: PlacesBeside | None = None,
    most_frames: int = MAX_FIRST_FRAMES,
) -> tuple[Candidate | None, list[Candidate]]:
    """The first hypothesis that is certain or with which others agree; and those that are neither."""
    uncertain: list[Candidate] = []
    for k in islice(_candidate_frames(view, source, unused, report), most_frames):
        best = best_hypothesis(view, source, k, unused, beside)
        if best is None or best.poses.support[best.poses.known].mean() < MIN_SUPPORT:
            continue
        if best.is_certain:
            return (k, best), uncertain
        uncertain.append((k, best))
        agreed = _most_agreed(view, source, uncertain)
        if agreed is not None and len(uncertain) >= MIN_HYPOTHESES:
            return agreed, uncertain
    return _most_agreed(view, source, uncertain), uncertain


def _most_agreed(view: View, source: FrameSource, candidates: list[Candidate]) -> Candidate | None:
    """Of hypotheses from different frames the one with which most others agree; None if no two agree.

    Of equals the more even one is chosen, or the first if impacts leave none even. Wrong hypotheses diverge, except those with
    competitors: what is ambiguous in one picture is so in the next."""
    candidates = [(k, hypothesis) for k, hypothesis in candidates if hypothesis.competitors == 0]
    votes = [sum(_agree(view, source, one, other) for other in candidates if other is not one) for one in candidates]
    if not any(votes):
        return None
    best = max(
        range(len(candidates)),
        key=lambda i: (votes[i], -min(candidates[i][1].score.unevenness, UNEVEN), -candidates[i][0]),
    )
    return candidates[best]


def _agree(view: View, source: FrameSource, one: Candidate, other: Candidate) -> bool:
    """Whether two hypotheses draw the same die on the last frame to which the later one was tracked."""
    (k, early), (j, late) = sorted((one, other), key=lambda pair: pair[0])
    row = int(np.flatnonzero(late.poses.known)[-1])
    common = j - k + row
    if common >= len(early.poses.known):
        return False
    for i in range(early.tracker.next_frame, common + 1):
        if early.tracker.misses > 1:
            break
        early.tracker.track(source.frame(k + i)[None], source.times_s[k:], i, early.poses)
    return bool(early.poses.known[common]) and _same(view, early, common, late, row, AGREEMENT_EDGES)


def _candidate_frames(view: View, source: FrameSource, unused: Mask, report: Callable[[int], None]) -> Iterator[int]:
    """Frames that may show the die whole, in order and ever wider apart.

    A shadow comes into view before the die that casts it, and a die bit by bit, on many frames. Once the first candidate failed,
    frames that show much less than the usual area come last.
    """
    # Three frames fit wrong hypotheses as well: 200 frames a second of a die that turns ten degrees a frame gave poses 45 degrees
    # off, with standard errors of a tenth of a degree, on the last three. A clip of fewer frames than are wanted is all there is.
    enough = min(FULL_STAGE, len(source))
    tried, k, least_px, small = 0, 0, 0.0, []
    while k <= len(source) - enough:
        report(k)
        seen = _frames_ahead(unused, k) >= enough
        blobs = die_blobs(view, np.asarray(source.frame(k)[0], np.float32)) if seen else []
        if blobs and blobs[0].area_px >= least_px:
            tried += 1
            yield k
            if tried == 1:
                least_px = SMALL_SHARE * _usual_area_px(view, source)
            k += FIRST_SPACING + tried
        else:
            small += [k] if blobs else []
            k += 1
    yield from small[:: 1 + len(small) // MAX_FIRST_FRAMES]


def _frames_ahead(unused: Mask, k: int) -> int:
    """Frames from k on over which a hypothesis can be tracked: up to the second that is unused; none if k is."""
    if unused[k]:
        return 0
    missing = np.flatnonzero(unused[k:])
    return int(missing[1]) if len(missing) > 1 else len(unused) - k


def _usual_area_px(view: View, source: FrameSource) -> float:
    """Median area [px] of what differs from the background and is no shadow, over some frames of the clip."""
    rows = np.unique(np.linspace(0, len(source) - 1, SAMPLED_FRAMES).astype(int))
    areas = [
        blobs[0].area_px for k in rows if (blobs := die_blobs(view, np.asarray(source.frame(int(k))[0], np.float32)))
    ]
    return float(np.median(areas)) if areas else 0.0


def initial_pose_by_hand(
    view: View, source: FrameSource, by_hand: ManualInitialisation, unused: Mask
) -> tuple[FrameTracker, ClipPoses]:
    """A tracker from the pose that a person gave. Raises ValueError for a frame that does not exist or is excluded."""
    k = by_hand.frame - source.first_frame
    if not 0 <= k < len(source) or unused[k]:
        last = source.first_frame + len(source) - 1
        raise InputError(
            f"start.frame = {by_hand.frame}: wanted a frame of the clip ({source.first_frame} to {last}), none that is "
            "excluded"
        )
    pose = manual_initial_pose(view, np.asarray(source.frame(k)[0], np.float32), by_hand)
    hypothesis = _new_hypothesis(view, source, k, pose, unused, _rate_px_s(view, source, k, unused))
    return _on_clip(hypothesis, source, k, unused)


def _on_clip(hypothesis: Hypothesis, source: FrameSource, k: int, unused: Mask) -> tuple[FrameTracker, ClipPoses]:
    """The tracker and poses of a hypothesis that began on frame k, with rows of the clip.

    Of a hypothesis that is not certain the last frames are kept, over which its motion is even. It may have begun as another and
    changed on the way: the frames before are tracked again from there."""
    poses, tracker = ClipPoses.empty(len(source)), hypothesis.tracker
    rows = np.flatnonzero(hypothesis.poses.known)
    if not hypothesis.is_certain:
        rows = rows[-FULL_STAGE:]
    poses.take(k + rows, hypothesis.poses, rows)
    tracker.next_frame, tracker.unused, tracker.searches = k + tracker.next_frame, unused, True
    return tracker, poses


# --- the hypotheses of one frame ---------------------------------------------------------------------------------------


def best_hypothesis(
    view: View, source: FrameSource, k: int, unused: Mask, beside: PlacesBeside | None = None
) -> Hypothesis | None:
    """The hypothesis on frame k that the frames after it support best, of those that places `beside` lead to; None if there is
    none."""
    left = min(STAGES[-1], _frames_ahead(unused, k))
    rate_px_s = _rate_px_s(view, source, k, unused)
    poses = _candidates(view, source, k, rate_px_s, beside)
    found = _best_tracked(
        view, source, k, [_new_hypothesis(view, source, k, pose, unused, rate_px_s) for pose in poses], left
    )
    if found is None and poses and left > MIN_POSES_OF_FLIGHT:
        moving = _moving_hypothesis(view, source, k, poses, unused, beside)
        found = None if moving is None else _best_tracked(view, source, k, [moving], left)
    return found


def _candidates(view: View, source: FrameSource, k: int, rate_px_s: Array, beside: PlacesBeside | None) -> list[Pose]:
    """Candidate poses of frame k, and their depth reversals that explain it as well."""
    picture = np.asarray(source.frame(k), np.float32)
    kept = [pose for _, pose in pose_candidates(view, picture, rate_px_s)]
    least = min((pose.cost for pose in kept), default=np.inf)
    for pose in tuple(kept):
        other = reversed_pose(view, picture, pose.position_m, pose.rotation)
        if other is not None and other.cost < least + AMBIGUOUS_COST:
            places = [(one.position_m, one.rotation) for one in kept]
            if not any(same_picture(view, place, (other.position_m, other.rotation)) for place in places):
                kept.append(other)
    time_s = float(source.times_s[k])
    return [pose for pose in kept if beside is None or beside.can_lead_to(pose, time_s)]


def _best_tracked(
    view: View, source: FrameSource, k: int, hypotheses: list[Hypothesis], left: int
) -> Hypothesis | None:
    """The best of some hypotheses that begin on frame k, tracked stage by stage over the frames left; None if all are lost."""
    for stage in sorted({min(stage, left) for stage in STAGES}):
        leader = hypotheses[0] if stage > FULL_STAGE and hypotheses else None
        followed = [h for h in hypotheses if _follows_to(h, view, source, k, stage)]
        _compare_on_same_pixels(view, source, k, hypotheses)
        scored = [(h, _recent_score(h, view, source.times_s[k:], stage)) for h in followed]
        # What they do behind an impact of the leader, or one that lost them, tells nothing: compared is the flight before.
        decided = [h for h, _ in scored if h is not leader]
        ends = [h.flies_until for h in hypotheses if h not in decided and FULL_STAGE <= h.flies_until < stage]
        if leader is not None and ends:
            return _winner(view, source, k, _best_until(view, source, k, hypotheses, min(ends)))
        # Past an impact no hypothesis moves evenly: of those still on the die, the one that led before it has won.
        even = [(h, score) for h, score in scored if score.unevenness < UNEVEN or stage < min(HALF_STAGE, left)]
        if not even:
            tracked = [h for h, _ in scored]
            remaining = [h for h in hypotheses if h in tracked] or hypotheses
            return _winner(view, source, k, remaining) if stage > FULL_STAGE else None
        least = min(score.evidence for _, score in even)
        rejected = REJECTION_MISFIT if stage >= HALF_STAGE else AMBIGUOUS_COST
        for hypothesis, score in even:
            hypothesis.score = score
        near = [h for h, score in even if score.evidence < least + rejected]
        hypotheses = _distinct(view, sorted(near, key=lambda h: h.score.total))
        uneven = [score.misfit for _, score in scored if score.unevenness >= UNEVEN]
        contradicting = sum(misfit < hypotheses[0].score.misfit - CONTRADICTING_MISFIT for misfit in uneven)
        if len(hypotheses) == 1 and stage >= FULL_STAGE and hypotheses[0].is_certain:
            break
    return _winner(view, source, k, hypotheses, contradicting)


def _best_until(view: View, source: FrameSource, k: int, hypotheses: list[Hypothesis], until: int) -> list[Hypothesis]:
    """The hypotheses that explain the frames before a row best, the best first, with these scores; of those that pass an impact
    only the frames before it."""
    tracked = [hypothesis for hypothesis in hypotheses if hypothesis.poses.known[:until].sum() >= until - 1]
    for hypothesis in tracked:
        hypothesis.score = hypothesis.score_of(view, source.times_s[k:], 0, until - LATE_ROWS)
    least = min((hypothesis.score.evidence for hypothesis in tracked), default=np.inf)
    near = [hypothesis for hypothesis in tracked if hypothesis.score.evidence < least + REJECTION_MISFIT]
    for hypothesis in near:
        if hypothesis.before_impact is not None:
            hypothesis.tracker = hypothesis.before_impact
            hypothesis.poses.known[hypothesis.flies_until :] = False
    return sorted(near, key=lambda hypothesis: hypothesis.score.total)


def _winner(
    view: View, source: FrameSource, k: int, hypotheses: list[Hypothesis], contradicting: int = 0
) -> Hypothesis | None:
    """The first of the hypotheses, with the number of its competitors; `contradicting` are uneven and have a smaller misfit. One
    that changed on the way is tracked back to its first frame, over which it must move as evenly."""
    if not hypotheses:
        return None
    best = hypotheses[0]
    best.competitors = len(hypotheses) - 1 + contradicting
    last = int(np.flatnonzero(best.poses.known)[-1])
    if best.score.since and last < best.score.until:
        back = best.tracker.backwards_tracker()
        best.poses.known[:last], best.excess[:last] = False, 0.0
        back.track(np.stack([source.frame(k + row) for row in range(last)]), source.times_s[k:], 0, best.poses)
        best.score = best.score_of(view, source.times_s[k:], 0, last + 1)
    return best


def _rate_px_s(view: View, source: FrameSource, k: int, unused: Mask) -> Array:
    """(2,) velocity [px/s] in the first camera's picture of the region that differs from the background, from frame k and those
    beside it; 0 if none of these shows it."""
    here = die_blobs(view, np.asarray(source.frame(k)[0], np.float32))
    beside: list[tuple[float, Array]] = []
    for j in (k - 1, k + 1):
        if here and 0 <= j < len(source) and not unused[j]:
            there = die_blobs(view, np.asarray(source.frame(j)[0], np.float32))
            if there and abs(np.log(there[0].area_px / here[0].area_px)) < SAME_AREA_LOG:
                beside.append((float(source.times_s[j]), there[0].centre_px))
    if not beside:
        return np.zeros(2)
    first, last = (
        (beside[0], beside[-1]) if len(beside) > 1 else ((float(source.times_s[k]), here[0].centre_px), beside[0])
    )
    return np.asarray((last[1] - first[1]) / (last[0] - first[0]), float)


def _new_hypothesis(view: View, source: FrameSource, k: int, pose: Pose, unused: Mask, rate_px_s: Array) -> Hypothesis:
    """A hypothesis that has not been tracked yet."""
    poses = ClipPoses.empty(min(STAGES[-1], len(source) - k))
    poses.put(0, pose, np.zeros(6))
    tracker = FrameTracker.from_pose(
        view,
        pose,
        source.times_s[k:],
        0,
        unused[k:],
        velocity_m_s=velocity_across_m_s(view, pose.position_m, rate_px_s),
    )
    return Hypothesis(tracker, poses, Score(pose.cost_with_edge_noise))


def _moving_hypothesis(
    view: View, source: FrameSource, k: int, poses: list[Pose], unused: Mask, beside: PlacesBeside | None
) -> Hypothesis | None:
    """The hypothesis through some pose of frame k and poses that the next pictures show by themselves. A die may turn so far from
    frame to frame that no pose leads to the next without its spin."""
    rows = k + np.arange(MIN_POSES_OF_FLIGHT)
    if unused[rows].any():
        return None
    candidates = [
        poses,
        *(_candidates(view, source, int(row), _rate_px_s(view, source, int(row), unused), beside) for row in rows[1:]),
    ]
    cheapest = [sorted(some, key=lambda pose: pose.cost)[:MOST_CANDIDATES] for some in candidates]
    motion = motion_of_poses(view, source.times_s[rows], cheapest, FASTEST_M_S)
    if motion is None:
        return None
    found, last, times_s = ClipPoses.empty(min(STAGES[-1], len(source) - k)), len(rows) - 1, source.times_s[k:]
    for row, pose in enumerate(motion.poses):
        found.put(row, pose, motion.motion[3:])
    tracker = FrameTracker.from_pose(view, motion.poses[-1], times_s, last, unused[k:])
    tracker.follow(motion)
    return Hypothesis(tracker, found, Score(motion.poses[0].cost_with_edge_noise))


def _follows_to(hypothesis: Hypothesis, view: View, source: FrameSource, k: int, stage: int) -> bool:
    """Track a hypothesis up to so many frames; false if the die was lost on the way, or went into the table."""
    tracker, poses, times_s = hypothesis.tracker, hypothesis.poses, source.times_s[k:]
    for j in range(tracker.next_frame, stage):
        motion, rotation, P, clock = (
            some.copy() for some in (tracker.motion, tracker.rotation, tracker.P, tracker.clock)
        )
        tracker.track(source.frame(k + j)[None], times_s, j, poses)
        if tracker.misses > 1:
            return False
        is_low = not is_high(view, tracker.motion[:3], tracker.rotation, tracker.P)
        if j < hypothesis.flies_until and tracker.clock[2] < MIN_POSES_OF_FLIGHT < j and is_low:
            hypothesis.flies_until = j
            hypothesis.before_impact = FrameTracker(tracker.view, motion, rotation, P, clock, tracker.unused)
            hypothesis.before_impact.next_frame = j
    return bool(poses.known[:stage].sum() >= stage - 1 and not _is_below_table(tracker))


def _compare_on_same_pixels(view: View, source: FrameSource, k: int, hypotheses: list[Hypothesis]) -> None:
    """Write by how much the costs of hypotheses that begin on frame k are higher on the pixels of all of them."""
    for row in np.flatnonzero(np.sum([h.poses.known for h in hypotheses], axis=0) > 1).tolist():
        compared = [h for h in hypotheses if h.poses.known[row]]
        picture = np.asarray(source.frame(k + row)[0], np.float32)
        excess = excess_on_same_pixels(view, picture, [h.poses for h in compared], row)
        for hypothesis, more in zip(compared, excess, strict=True):
            hypothesis.excess[row] = more


def _explains_better(view: View, source: FrameSource, k: int, one: Hypothesis, other: Hypothesis) -> bool:
    """Whether one hypothesis on frame k explains the later pictures that both were tracked over better than another."""
    _compare_on_same_pixels(view, source, k, [one, other])
    both = np.flatnonzero(one.poses.known & other.poses.known)
    late = both[len(both) // 2 :]
    return len(late) > 0 and one.misfit_on(late) < other.misfit_on(late)


def _recent_score(hypothesis: Hypothesis, view: View, times_s: Array, stage: int) -> Score:
    """The score of a hypothesis that was tracked up to so many frames: an initial pose that was a little off takes some frames to
    converge, and a wrong one may become right when the die shows another face, so that the recent motion counts."""
    since = stage // 2 if stage > FULL_STAGE else 0
    whole = hypothesis.score_of(view, times_s, 0, stage)
    return whole if whole.unevenness < EVEN else hypothesis.score_of(view, times_s, since, stage)


def _is_below_table(tracker: FrameTracker) -> bool:
    """Whether the die lies clearly below the table where it was tracked to. A picture that shows several ways to draw the same
    outline, as of a tetrahedron that turns a face or a corner to the camera, may put it there."""
    lowest = float(lowest_m(tracker.view.shape, tracker.motion[:3], tracker.rotation))
    sigma_m = float(np.sqrt(max(tracker.P[2, 2], 0.0)))
    return lowest < -max(contact_reach_m(tracker.view.die), HEIGHT_SIGMAS * sigma_m)


def _distinct(view: View, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The hypotheses without those that converged to the pose of a better one."""
    kept: list[Hypothesis] = []
    for hypothesis in hypotheses:
        last = int(np.flatnonzero(hypothesis.poses.known)[-1])
        if not any(other.poses.known[last] and _same(view, hypothesis, last, other, last) for other in kept):
            kept.append(hypothesis)
    return kept


def _same(
    view: View, one: Hypothesis, row: int, other: Hypothesis, other_row: int, within: float = SAME_POSE_EDGES
) -> bool:
    """Whether two hypotheses draw the same die, each on its own row, within a distance of corners in edges."""
    here, there = ((h.poses.position_m[k], h.poses.rotation[k]) for h, k in ((one, row), (other, other_row)))
    return same_picture(view, here, there, within)
