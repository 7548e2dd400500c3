"""The third pass: frames refined once more on what is printed on the die's faces, where they have anything.

The marks are learned from some frames of the flights that the second pass shows (`marks`), and used where marks and edges
together are as sure of the flights as edges alone. Of a film far faster than the die only some frames had a second pass; the
others have it now, along the flights that the marks show, or as the first did where they are not used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import Flight, Throw
from ..footage import Frames, FrameSource, Rows
from ..picture import View
from ..pose import ClipPoses, as_track, contour_bias_jacobians, wholly_in_view
from ..surface_marks import CHI2_MEDIAN, FramePoses, FrameRefinement, SurfaceMarks, frames_to_learn_from, learn_marks
from ..throw import (
    MeasuredThrow,
    NoFlightError,
    decimation_factor,
    determines_table_height,
    flights_only,
    frames_in_flight,
    measure,
    shared_bias_jacobian,
    transition_matrix,
    without_shared_bias,
)
from ..track import Track
from .refine_on_edges import EdgeRefinement, among, see_all

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CONTRADICTED = 30.0
"""Squared sigmas of six numbers from which marks and edges do not tell of one motion."""
WORTHWHILE = 0.0
"""Least gain of the marks, see `_gain`: marks and edges together must be as sure of the flights as edges alone. Asked for sigmas
half as large, dice of 20 px an edge did without their marks, and were turned by 0.46° and not by 0.10°."""


@dataclass(frozen=True, eq=False)
class MarkRefinement:
    """What a third pass gives."""

    seen: ClipPoses
    marks: SurfaceMarks | None
    """What the faces show; None where that places nothing."""
    shared: Array | None
    """(n, 6, 6) covariance that poses on marks share, NaN where a frame has none; None where marks were not used."""


def third_pass(second: EdgeRefinement, seen: ClipPoses, every: int, reached: Callable[[int], None]) -> MarkRefinement:
    """All frames refined on marks and edges, where that helps. `seen` is what the second pass shows on one frame in `every`.
    `reached` is called with how far it is, in frames.

    Marks are those that the first camera sees. With several, they are learned to be read: the edges of all cameras cross each
    other's lines of sight, which marks of one do not.
    """
    view, source = second.view, second.source
    left = np.arange(len(source)) % every != 0
    track = as_track(view, source, seen, wholly_in_view(view, seen))
    thinned = decimation_factor(track, view.die)
    try:
        found = measure(track, view.die, view.camera, every=thinned)
    except NoFlightError:
        return MarkRefinement(_completed(second, seen, left, reached), None, None)
    scatter = _scatter(found.frames, flights_only(found.throw))
    marks = _learned(source, view, found, scatter)
    if marks is None or len(source.clips) > 1 or not _are_worth_it(marks, found, every * thinned):
        return MarkRefinement(_completed(second, seen, left, reached), marks, None)
    flights = Throw(marks.flights, flights_only(found.throw).impacts)
    to_the_end = replace(found.throw, flights=(*marks.flights, *found.throw.flights[len(marks.flights) :]))
    seen = _completed(second.along(to_the_end), seen, left, reached)
    edges = _edges_of(second, seen, found, scatter)
    # Frames without edges have nothing to be refined. On those of a die that the table carries edges do as well: marks are known
    # to where they were learned, on the flights.
    flying = _in_flight(edges, found.throw).tracked
    rows, carried = np.flatnonzero(flying), np.flatnonzero(edges.tracked & ~flying)
    refinement = FrameRefinement(view, marks, _poses_of(view, edges, seen, rows), flights, source.times_s[rows])
    # Frames whose edges are seen now count half, and half when their marks are.
    _see_some(source, rows, refinement, reached if every == 1 else lambda done: reached((len(source) + done) // 2))
    out, shared = ClipPoses.empty(len(source)), np.full((len(source), 6, 6), np.nan)
    out.take(np.arange(len(source)), seen)
    shared[rows] = refinement.shared_covariance
    for put, poses in ((rows, refinement.poses()), (carried, _poses_of(view, edges, seen, carried))):
        out.position_m[put], out.rotation[put] = poses.position_m, poses.rotation
        out.contour_bias_jacobian[put], out.H[put, :6, :6] = poses.contour_bias_jacobian, poses.information
    return MarkRefinement(out, marks, shared)


def _completed(second: EdgeRefinement, seen: ClipPoses, left: Mask, reached: Callable[[int], None]) -> ClipPoses:
    """With the frames that are left."""
    if not left.any():
        return seen
    out = second.see(left, lambda done: reached(done // 2))
    out.take(np.flatnonzero(~left), seen)
    return out


def _learned(source: FrameSource, view: View, found: MeasuredThrow, scatter: float) -> SurfaceMarks | None:
    """The marks, from frames in flight."""
    edges, throw = _in_flight(found.frames, found.throw), flights_only(found.throw)
    edges = replace(edges, covariance=scatter * edges.covariance)
    rows = frames_to_learn_from(edges, throw)
    images = ((int(k), source.frame(int(k))[0]) for k in rows)
    # A table that is not where the scene has it tells no distance.
    told = determines_table_height(found.chain)
    strikes = [link.impact if told else None for link in found.chain.links[: len(throw.impacts)]]
    return learn_marks(view, images, edges, throw, strikes, saturation_grey=float(2 ** source.clips[0].bit_depth - 1))


def _in_flight(track: Track, throw: Throw) -> Track:
    """Without frames that the table carries at the end. Where the die flies to the end, all are in flight: a thinned fit ends
    before the last one does."""
    return track if flights_only(throw) is throw else frames_in_flight(track, throw)


def _edges_of(second: EdgeRefinement, seen: ClipPoses, found: MeasuredThrow, scatter: float) -> Track:
    """What edges say of the frames that show the die whole: without the errors that all share, and as sure as they scatter."""
    view, shared = second.view, found.chain.shared
    track = as_track(view, second.source, seen, wholly_in_view(view, seen))
    straight = without_shared_bias(
        track, shared_bias_jacobian(track, view.camera, view.die)[:, :, : len(shared)], shared
    )
    return replace(straight, covariance=scatter * straight.covariance)


def _poses_of(view: View, edges: Track, seen: ClipPoses, rows: Rows) -> FramePoses:
    """What the edges of some tracked frames say."""
    return FramePoses(
        edges.position_m[rows], matrix_from_quat(edges.quaternion[rows]),
        np.linalg.inv(edges.covariance[rows]).astype(np.float64), contour_bias_jacobians(seen.H[rows], view.settings),
    )  # fmt: skip


def _see_some(source: FrameSource, rows: Rows, refinement: FrameRefinement, reached: Callable[[int], None]) -> None:
    """Refine the frames `rows` of a clip, which are those of `refinement`."""
    boxes = np.zeros((len(source), 1, 4), np.int64)
    boxes[rows, 0] = refinement.boxes

    def begun(frames: Frames, shown: Rows, pool: Executor) -> list[Future[None]]:
        mine, which = among(rows, shown)
        return refinement.refine(frames, which, mine, pool)

    see_all(source, boxes, begun, reached)


def _are_worth_it(marks: SurfaceMarks, found: MeasuredThrow, every: int) -> bool:
    """Whether marks tell of the same motion as edges, and tell more. One frame in `every` had edges."""
    learned = np.flatnonzero([np.isfinite(shared).all() for shared in marks.shared_covariance])
    both = [(found.throw.flights[k], marks.flights[k]) for k in learned]
    own = [found.throw_without_shared_errors.flights[k] for k in learned]
    return _contradiction(both) <= CONTRADICTED and _gain(both, own, every) >= WORTHWHILE


def _contradiction(both: Sequence[tuple[Flight, Flight]]) -> float:
    """Median squared distance of flights by edges and by marks half-way through each, in the sigmas of both.

    Two ways to see one motion must agree. Where they do not, the marks were learned in the wrong places: many small faces,
    each seen for a short time, can shift against each other without the pictures telling.
    """
    squared = []
    for ours, theirs in both:
        if ours.covariance is None or theirs.covariance is None or not np.isfinite(ours.end_s):
            continue
        t = 0.5 * (ours.start.time_s + ours.end_s)
        a, b = ours.at(t), theirs.at(t)
        miss = np.concatenate([b.position_m - a.position_m, rotation_between(a.quaternion, b.quaternion)])
        M, N = transition_matrix(ours, t)[:6], transition_matrix(theirs, t)[:6]
        C = M @ ours.covariance @ M.T + N @ theirs.covariance @ N.T
        squared.append(float(miss @ np.linalg.solve(C, miss)))
    return float(np.median(squared)) if squared else 0.0


def _gain(both: Sequence[tuple[Flight, Flight]], own: Sequence[Flight], every: int) -> float:
    """By how much marks, weakly helped by edges, are surer than edges alone of the pose half-way through a flight: median
    difference of the logarithms of the determinants of the covariances. Those of the edges count as if from all frames, of which
    one in `every` was used, but for what all frames err alike and their `own` covariances leave out."""
    gains = []
    for (ours, theirs), alone in zip(both, own, strict=True):
        if ours.covariance is None or alone.covariance is None or theirs.covariance is None:
            continue
        if np.isfinite(ours.end_s):
            t = 0.5 * (ours.start.time_s + ours.end_s)
            M, N = transition_matrix(ours, t)[:6], transition_matrix(theirs, t)[:6]
            shared = ours.covariance - alone.covariance
            edges, marks = M @ (alone.covariance / every + shared) @ M.T, N @ theirs.covariance @ N.T
            gains.append(float(np.linalg.slogdet(edges)[1] - np.linalg.slogdet(marks)[1]))
    return float(np.median(gains)) if gains else -np.inf


def _scatter(track: Track, throw: Throw) -> float:
    """By how much, as a variance, single poses usually lie further from their flights than their sigmas say; 1 at the least. What
    neighbouring frames err alike is left out: the marks estimate for themselves what the edges err in common."""
    use = np.flatnonzero(track.tracked & (track.time_s <= throw.flights[-1].end_s))
    p, q = throw.poses(track.time_s[use])
    miss = np.concatenate([track.position_m[use] - p, rotation_between(q, track.quaternion[use])], axis=1)
    squared = np.einsum("ni,nij,nj->n", miss, np.linalg.inv(track.covariance[use]), miss)
    return max(1.0, float(np.median(squared)) / CHI2_MEDIAN)
