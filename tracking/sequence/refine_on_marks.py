"""Refinement of all frames on surface marks and edges together.

The marks are learned from some frames of the flights that the edges show (`surface_marks`), and are used if marks and edges
together determine the flights as well as edges alone. Of a film far faster than the die only some frames have been refined on
edges. The others are refined now, along the flights that the marks show, or from the tracked poses if the marks are not used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat, rotation_between
from ...model.throw import Flight, Throw
from ..flights import transition_matrix
from ..footage import Frames, FrameSource, Rows
from ..picture import View
from ..pose import ClipPoses, as_track, bias_jacobians, wholly_in_view
from ..surface_marks import (
    CHI2_MEDIAN,
    FramePoses,
    FrameRefinement,
    SurfaceMarks,
    common_length_m,
    contour_covariance,
    frames_to_learn_from,
    learn_marks,
    median_square,
)
from ..throw import (
    MeasuredThrow,
    NoFlightError,
    decimation_factor,
    determines_table_height,
    flights_only,
    frames_in_flight,
    measure,
    placement_covariances,
    shared_bias_jacobian,
    without_shared_bias,
)
from ..track import LOST, Track
from .refine_on_edges import EdgeRefinement, among, refine_blocks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_CONTRADICTION = 12.6
"""Squared sigmas of six numbers above which marks and edges do not show the same motion: chance gives more in one case of twenty.
On one random clip, of a glossy die exposed for half the time, marks that contradicted the edges by 15 moved it by 1.2 mm."""
POSE_NUMBERS = 6
"""Numbers of a pose."""
LEAST_PLACEMENT_SHARE = 1e-5
"""Least common error of the placement of marks that is considered, over the die's edge: a thousandth of a pixel."""
MOST_PLACEMENT_SHARE = 0.3
"""Largest common error of the placement of marks that is considered, over the die's edge."""
LEAST_GAIN = 0.0
"""Least gain of the marks (`_gain`): marks and edges together must determine the flights as well as edges alone. When standard
errors half as large were required, dice of 20 px an edge were refined without their marks, and were off by 0.46° instead of
0.10°."""


@dataclass(frozen=True, eq=False)
class MarkRefinement:
    """The result of a refinement on surface marks."""

    poses: ClipPoses
    marks: SurfaceMarks | None
    """What the faces show; None if that determines no position."""
    shared_covariance: Array | None
    """(n, 6, 6) covariance that poses on marks share, NaN for a frame without one; None if marks were not used."""


@dataclass(frozen=True, eq=False)
class _Edges:
    """What the refinement on edges has given: poses on one frame in `every`."""

    refinement: EdgeRefinement
    poses: ClipPoses
    every: int

    @property
    def missing(self) -> Mask:
        """(n,) frames that have not been refined."""
        return np.arange(len(self.refinement.source)) % self.every != 0

    def completed(self, refinement: EdgeRefinement, report: Callable[[int], None]) -> ClipPoses:
        """The poses, with those of the missing frames from a refinement."""
        missing = self.missing
        if not missing.any():
            return self.poses
        out = refinement.refine(missing, lambda done: report(done // 2))
        out.take(np.flatnonzero(~missing), self.poses)
        return out


def refine_on_marks(
    refinement: EdgeRefinement, poses: ClipPoses, every: int, report: Callable[[int], None]
) -> MarkRefinement:
    """All frames refined on marks and edges, where that helps. `poses` are those on edges, of one frame in `every`; `report` is
    called with the frames done.

    The marks are those that the first camera sees. With several cameras they are learned only to be read: their edges intersect
    each other's lines of sight, which the marks of one camera do not."""
    view, source = refinement.view, refinement.source
    edges = _Edges(refinement, poses, every)
    track = as_track(view, source, poses, wholly_in_view(view, poses))
    decimation = decimation_factor(track, view.die)
    try:
        found = measure(track, view.die, view.camera, every=decimation)
    except NoFlightError:
        return MarkRefinement(edges.completed(refinement, report), None, None)
    variance = _variance_factor(found.frames, flights_only(found.throw))
    marks = _learned(source, view, found, variance)
    if marks is None or len(source.clips) > 1 or not _are_useful(marks, found, every * decimation, variance):
        return MarkRefinement(edges.completed(refinement, report), marks, None)
    marks = with_placement_error(view, marks, found.throw)
    flights = Throw(marks.flights, flights_only(found.throw).impacts)
    to_the_end = replace(found.throw, flights=(*marks.flights, *found.throw.flights[len(marks.flights) :]))
    poses = edges.completed(refinement.along(to_the_end), report)
    on_edges = _poses_on_edges(refinement, poses, found, variance)
    # Frames without edges cannot be refined. On frames of a die that the table supports edges suffice: the marks are known as far
    # as they were learned, on the flights.
    flying = _in_flight(on_edges, found.throw).tracked
    rows, supported = np.flatnonzero(flying), np.flatnonzero(on_edges.tracked & ~flying)
    frames = FrameRefinement(view, marks, _frame_poses(view, on_edges, poses, rows), flights, on_edges.time_s[rows])
    # Frames refined on edges only now count half, and half when refined on marks.
    _refine_rows(source, rows, frames, report if every == 1 else lambda done: report((len(source) + done) // 2))
    out, shared = ClipPoses.empty(len(source)), np.full((len(source), 6, 6), np.nan)
    out.take(np.arange(len(source)), poses)
    placement = placement_covariances(on_edges, view.camera, view.die, rows)
    shared[rows] = frames.shared_covariance + placement[rows]
    for put, refined in ((rows, frames.poses()), (supported, _frame_poses(view, on_edges, poses, supported))):
        out.position_m[put], out.rotation[put] = refined.position_m, refined.rotation
        out.bias_jacobian[put, :, : refined.bias_jacobian.shape[2]] = refined.bias_jacobian
        out.H[put, :6, :6] = refined.information
    return MarkRefinement(out, marks, shared)


def _learned(source: FrameSource, view: View, found: MeasuredThrow, variance: float) -> SurfaceMarks | None:
    """The marks, from frames in flight whose covariances are multiplied by `variance`: those that lie on no flight, as behind an
    impact that was missed, show each face somewhere else."""
    edges, throw = _in_flight(found.frames, found.throw), flights_only(found.throw)
    status = np.where(found.unexplained, LOST, edges.status)
    edges = replace(edges, status=status, covariance=variance * edges.covariance)
    rows = frames_to_learn_from(edges, throw)
    images = ((int(k), source.frame(int(k))[0]) for k in rows)
    # A table that is not where the scene has it determines no distance.
    has_table = determines_table_height(found.chain)
    impacts = [link.impact if has_table else None for link in found.chain.links[: len(throw.impacts)]]
    return learn_marks(view, images, edges, throw, impacts, saturation_grey=float(2 ** source.clips[0].bit_depth - 1))


def _in_flight(track: Track, throw: Throw) -> Track:
    """The track without frames of supported motion. If the die flies to the end, all frames are in flight: the last frame of a
    decimated fit comes before the last of the track."""
    return track if flights_only(throw) is throw else frames_in_flight(track, throw)


def _poses_on_edges(refinement: EdgeRefinement, poses: ClipPoses, found: MeasuredThrow, variance: float) -> Track:
    """Poses on edges of the frames that show the die whole: shared errors subtracted, covariances multiplied by `variance`."""
    view, shared = refinement.view, found.chain.shared
    track = as_track(view, refinement.source, poses, wholly_in_view(view, poses))
    jacobian = shared_bias_jacobian(track, view.camera, view.die)[:, :, : len(shared)]
    straight = without_shared_bias(track, jacobian, shared)
    return replace(straight, covariance=variance * straight.covariance)


def _frame_poses(view: View, edges: Track, poses: ClipPoses, rows: Rows) -> FramePoses:
    """The poses on edges of some tracked frames, with their information."""
    return FramePoses(
        edges.position_m[rows], matrix_from_quat(edges.quaternion[rows]),
        np.linalg.inv(edges.covariance[rows]).astype(np.float64),
        bias_jacobians(view, poses.H[rows], poses.position_m[rows]),
    )  # fmt: skip


def _refine_rows(source: FrameSource, rows: Rows, frames: FrameRefinement, report: Callable[[int], None]) -> None:
    """Refine the frames `rows` of a clip, which are those of `frames`."""
    boxes = np.zeros((len(source), 1, 4), np.int64)
    boxes[rows, 0] = frames.boxes

    def jobs(images: Frames, shown: Rows, pool: Executor) -> list[Future[None]]:
        own, which = among(rows, shown)
        return frames.refine(images, which, own, pool)

    refine_blocks(source, boxes, jobs, report)


# --- how far marks and edges agree ---------------------------------------------------------------------------------------


def _are_useful(marks: SurfaceMarks, found: MeasuredThrow, every: int, variance: float) -> bool:
    """Whether marks show the same motion as edges, and determine it as well. One frame in `every` was refined on edges.

    Edges whose poses scatter about the flights with `variance` times the variance that they state may err as much in common,
    which the covariance of the flights does not hold. Marks that contradict them by no more are used if they determine the
    motion as well even where they alone are to blame, and err by so much more than they state."""
    both = _learned_flights(marks, found.throw)
    unshared = [by_edges for by_edges, _ in _learned_flights(marks, found.throw_without_shared_errors)]
    beyond = max(1.0, _contradiction(both) / MAX_CONTRADICTION)
    return bool(beyond <= variance and _gain(both, unshared, every) - POSE_NUMBERS * np.log(beyond) >= LEAST_GAIN)


def _contradiction(both: Sequence[tuple[Flight, Flight]]) -> float:
    """Median squared distance of flights by edges and by marks half-way through each, in the sigmas of both.

    Two measurements of one motion must agree. If they do not, the marks were learned in the wrong places: many small faces, each
    seen for a short time, can shift against each other without a change of the pictures."""
    _, differences, covariances = _differences(both)
    return median_square(differences, covariances) if len(differences) else 0.0


def with_placement_error(view: View, marks: SurfaceMarks, by_edges: Throw) -> SurfaceMarks:
    """Marks that state as a common error of their placement what contradicts the edges, beyond all errors stated before."""
    positions, differences, covariances = _differences(_learned_flights(marks, by_edges))
    if not len(differences):
        return marks
    edge, unit = view.die.solid.edge_m, contour_covariance(view, positions, 1.0)
    least_m, most_m = LEAST_PLACEMENT_SHARE * edge, MOST_PLACEMENT_SHARE * edge
    return replace(marks, placement_m=common_length_m(differences, covariances, unit, least_m, most_m))


def _learned_flights(marks: SurfaceMarks, by_edges: Throw) -> list[tuple[Flight, Flight]]:
    """Flights by edges and by marks of those that marks were learned from."""
    learned = np.flatnonzero([np.isfinite(shared).all() for shared in marks.shared_covariance])
    return [(by_edges.flights[k], marks.flights[k]) for k in learned]


def _differences(both: Sequence[tuple[Flight, Flight]]) -> tuple[Array, Array, Array]:
    """Half-way through each flight whose end is known: the position by marks (n, 3), the pose by marks minus that by edges (n, 6)
    and the covariance of that difference (n, 6, 6)."""
    positions, differences, covariances = [], [], []
    for by_edges, by_marks in both:
        if by_edges.covariance is None or by_marks.covariance is None or not np.isfinite(by_edges.end_s):
            continue
        t = 0.5 * (by_edges.start.time_s + by_edges.end_s)
        a, b = by_edges.at(t), by_marks.at(t)
        M, N = transition_matrix(by_edges, t)[:6], transition_matrix(by_marks, t)[:6]
        positions.append(b.position_m)
        differences.append(np.concatenate([b.position_m - a.position_m, rotation_between(a.quaternion, b.quaternion)]))
        covariances.append(M @ by_edges.covariance @ M.T + N @ by_marks.covariance @ N.T)
    return (
        np.array(positions).reshape(-1, 3),
        np.array(differences).reshape(-1, 6),
        np.array(covariances).reshape(-1, 6, 6),
    )


def _gain(both: Sequence[tuple[Flight, Flight]], unshared: Sequence[Flight], every: int) -> float:
    """Gain of marks, weakly helped by edges, over edges alone, for the pose half-way through a flight: median difference of the
    logarithms of the determinants of the covariances.

    Those of the edges count as if from all frames, of which one in `every` was used, except for the errors that all frames share,
    which the covariances of the `unshared` flights leave out."""
    gains = []
    for (by_edges, by_marks), without_shared in zip(both, unshared, strict=True):
        if by_edges.covariance is None or without_shared.covariance is None or by_marks.covariance is None:
            continue
        if np.isfinite(by_edges.end_s):
            t = 0.5 * (by_edges.start.time_s + by_edges.end_s)
            M, N = transition_matrix(by_edges, t)[:6], transition_matrix(by_marks, t)[:6]
            shared = by_edges.covariance - without_shared.covariance
            edges = M @ (without_shared.covariance / every + shared) @ M.T
            marks = N @ by_marks.covariance @ N.T
            gains.append(float(np.linalg.slogdet(edges)[1] - np.linalg.slogdet(marks)[1]))
    return float(np.median(gains)) if gains else -np.inf


def _variance_factor(track: Track, throw: Throw) -> float:
    """Variance of single poses about their flights over the stated one, from the median; 1 at least. Correlated errors of
    neighbouring frames are not included: the marks estimate these for themselves."""
    use = np.flatnonzero(track.tracked & (track.time_s <= throw.flights[-1].end_s))
    p, q = throw.poses(track.time_s[use])
    residual = np.concatenate([track.position_m[use] - p, rotation_between(q, track.quaternion[use])], axis=1)
    squared = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(track.covariance[use]), residual)
    return max(1.0, float(np.median(squared)) / CHI2_MEDIAN)
