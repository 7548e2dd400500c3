"""Refinement of all frames on their edges, or on the whole surface of a well-rounded die, from the poses that the flights give.

That recovers frames that tracking lost or got wrong. Where the tracked pose lies elsewhere, a frame is refined from there as
well, and the better result is kept. The poses are those of single frames: nothing is smoothed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import angle_between, matrix_from_quat, quat_from_matrix
from ...model.throw import Throw
from ..clip_parameters import ClockOffsets, rig_at
from ..footage import FrameBlock, Frames, FrameSource, Rows
from ..frame_to_frame import (
    DELAY_ITERATIONS,
    ENOUGH_EXCESS_COST,
    KNOWN_RAD,
    MIN_SUPPORT,
    MIN_SUPPORT_CUT,
    ON_PATH_SUPPORT,
)
from ..picture import (
    CONTOUR_PX,
    LINES,
    PARAMETERS,
    SHADED_STRETCH_PX,
    STATISTICS,
    THREADS,
    CameraRig,
    PoseRows,
    RefinementSettings,
    View,
    independent_share,
    refinement_boxes,
    shares_in_view,
    supports,
)
from ..pose import LEAST_CONTOUR_PX, ClipPoses, covariances, refine_frames, seen_distance_m, weak_priors
from ..throw import contact_reach_m, lowest_heights_m
from .labelling import with_labels_of_flights

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Jobs = Callable[[Frames, Rows, Executor], list[Future[None]]]

RUNS = 2
"""Runs into which the frames of a block are divided, each for one thread. The light on a die whose whole surface is compared is
learned along a run: there a block is one run, whose later part would begin without light in another, and poses do not hang on the
number of cores. With two runs a rounded cube was off by 1.6 mm in distance, with one by 0.07."""
MIN_IN_VIEW = 0.3
"""Least share of the corners in view for a frame to be refined."""
SECOND_START_RAD = np.radians(1.5)
"""Angle [rad] between flight and tracked pose from which a frame is refined from both: a refinement may not cover more."""
SECOND_START_REACH = 0.1
"""The same for the distance, in circumradii."""
MAX_SHIFT_REACH = 0.5
"""Largest displacement by a refinement, in circumradii, as the camera sees it."""
MAX_TURN_RAD = np.radians(6.0)
"""Largest rotation [rad] by a refinement."""
PRIOR_SHARES = (0.01, 0.1, 1.0)
"""Shares of the prior in the information of a pose whose pixels leave a direction undetermined: the first that is invertible; its
standard deviations are ten times as wide at 0.01. The prior is the same flight's on all frames, and beside a contact, where the
flight may be none, it must not be recovered for that reason."""


@dataclass(frozen=True, eq=False)
class EdgeRefinement:
    """The refinement of a clip. Some frames may be refined first, and others later."""

    view: View
    source: FrameSource
    tracked: ClipPoses
    """Tracked poses, and interpolated ones on rows that tracking skipped."""
    throw: Throw | None
    """The flights that they show."""
    usable: Mask
    """(n,) frames whose pictures may be used."""
    offsets: ClockOffsets
    min_step_px: float = 0.0
    """A step that moves no point of the die by more than this is the last."""

    def along(self, throw: Throw) -> EdgeRefinement:
        """The same from flights so well known that a step which hardly leaves them is the last: the remaining distance to what
        the pixels of a frame say, about a tenth, is error rather than motion."""
        return replace(self, throw=throw, min_step_px=self.view.quality.min_step_px)

    def refine(self, rows: Mask, report: Callable[[int], None]) -> ClipPoses:
        """Some frames (n,) of the clip, refined; the others are not known. `report` is called with the frames done."""
        view, tracked, count = self.view, self.tracked, len(self.source)
        rows = rows & self.usable
        settings = view.settings._replace(min_step_px=self.min_step_px, contour_stretch_px=SHADED_STRETCH_PX)
        reference, never = tracked, np.zeros(count, bool)
        attempts = [_Attempt(view, settings, tracked, tracked.known & rows, self.offsets, never, tracked)]
        if self.throw is not None:
            reference = _poses_on_flights(view, self.throw, self.source.times_s)
            # Beyond its frames a flight goes on into the table, where some background looks like a die.
            heights_m = lowest_heights_m(view.die, reference.position_m, quat_from_matrix(reference.rotation))
            rows = rows & ((heights_m > -contact_reach_m(view.die)) | tracked.known)
            from_both = rows & self._differ_from(reference)
            attempts = [
                _Attempt(view, settings, some, use, self.offsets, from_both, tracked)
                for some, use in ((reference, rows), (tracked, from_both))
            ]

        def jobs(frames: Frames, shown: Rows, pool: Executor) -> list[Future[None]]:
            return [job for one in attempts for job in one.refine(frames, shown, pool)]

        refine_blocks(self.source, _boxes(view, attempts, count), jobs, report)
        poses = attempts[0].poses(count)
        for attempt in attempts[1:]:
            other = attempt.poses(count)
            poses.take(np.flatnonzero(other.known & (~poses.known | (other.cost < poses.cost))), other)
        # Whole surfaces have a share of independent pixels of their own, in each picture.
        by_edges = np.flatnonzero(poses.known & (poses.statistics[:, LINES] > 0.0))
        poses.H[by_edges] *= independent_share(poses.statistics[by_edges])
        return with_labels_of_flights(view, poses, reference, tracked)

    def _differ_from(self, flights: ClipPoses) -> Mask:
        """(n,) where the tracked pose lies further from the flights than a refinement is certain to cover."""
        distance = np.linalg.norm(flights.position_m - self.tracked.position_m, axis=1)
        angle = angle_between(flights.rotation, self.tracked.rotation)
        is_far = (angle > SECOND_START_RAD) | (distance > SECOND_START_REACH * self.view.reach_m)
        return np.asarray(self.tracked.known & is_far)


def _enough_cost(tracked: ClipPoses) -> float:
    """The cost up to which a pose explains its picture as others of the clip do."""
    costs = tracked.cost[tracked.known & np.isfinite(tracked.cost)]
    return float(np.median(costs)) + ENOUGH_EXCESS_COST if len(costs) else np.inf


def refine_blocks(source: FrameSource, boxes: NDArray[np.int64], jobs: Jobs, report: Callable[[int], None]) -> None:
    """Submit the jobs of all frames of which `boxes` hold pixels, block by block, to a pool; `report` is called with the frames
    done.

    The jobs of a block are waited for after those of the next are submitted: no thread is idle because another is late."""
    with ThreadPoolExecutor(THREADS) as pool:
        under_way: list[tuple[FrameBlock, list[Future[None]]]] = []
        for block in source.blocks_within(boxes):
            under_way.append((block, jobs(block.frames, block.rows, pool)))
            if len(under_way) > 1:
                _finish(*under_way.pop(0))
            report(block.first)
        for block, submitted in under_way:
            _finish(block, submitted)
    report(len(source))


def _finish(block: FrameBlock, jobs: list[Future[None]]) -> None:
    """Wait for the jobs of a block, then release its memory."""
    with block:
        for job in jobs:
            job.result()


def among(rows: Rows, shown: Rows) -> tuple[slice, Rows]:
    """Which of some `rows` lie between the first and the last that are `shown`, and the index of each among those."""
    a, b = (int(k) for k in np.searchsorted(rows, (shown[0], shown[-1] + 1)))
    # A row that is not shown has no pixels in its boxes: any frame will do for it.
    return slice(a, b), np.minimum(np.searchsorted(shown, rows[a:b]), len(shown) - 1)


def _boxes(view: View, attempts: Sequence[_Attempt], count: int) -> NDArray[np.int64]:
    """(count, cameras, 4) boxes of pixels that contain all that the attempts read."""
    boxes = np.zeros((count, len(view.cameras), 4), np.int64)
    for attempt in attempts:
        own = refinement_boxes(view, attempt.position_m, attempt.rotation)
        present = boxes[attempt.rows]
        both = np.concatenate([np.minimum(present, own)[..., :2], np.maximum(present, own)[..., 2:]], axis=-1)
        is_new, is_empty = (np.asarray(~some.any(-1))[..., None] for some in (present, own))
        boxes[attempt.rows] = np.where(is_new, own, np.where(is_empty, present, both))
    return boxes


class _Attempt:
    """The refinement of some frames, each from an initial pose. What does not depend on the pictures is computed for all at
    once."""

    def __init__(
        self,
        view: View,
        settings: RefinementSettings,
        start: ClipPoses,
        use: Mask,
        offsets: ClockOffsets,
        compared: Mask,
        tracked: ClipPoses,
    ) -> None:
        """Rows in `use` are refined from `start`: the `tracked` poses, or those of the flights that these show. The cost of the
        whole picture is computed in blocks with a `compared` frame: one that has another initial pose as well."""
        in_view = shares_in_view(view, start.position_m, start.rotation) >= MIN_IN_VIEW
        self.rows: NDArray[np.int64] = np.flatnonzero(use & in_view)
        n = len(self.rows)
        self._view, self._settings, self._start, self._offsets = view, settings, start, offsets
        self._compared, self._enough = compared, _enough_cost(tracked)
        # Beyond the frames that were tracked a flight may have ended.
        known = np.flatnonzero(tracked.known)
        is_between = (self.rows > known[0]) & (self.rows < known[-1]) if len(known) else np.zeros(n, bool)
        self._on_flights = is_between & (start is not tracked)
        self._found = PoseRows(
            start.position_m[self.rows], start.rotation[self.rows], start.motion[self.rows],
            np.zeros((n, PARAMETERS, PARAMETERS)), np.zeros((n, STATISTICS)), np.full(n, np.inf),
        )  # fmt: skip
        self.position_m, self.rotation = self._found.position, self._found.rotation
        self._runs = 1 if n and view.shows_surface(np.median(self.position_m, axis=0)) else RUNS

    def refine(self, frames: Frames, shown: Rows, pool: Executor) -> list[Future[None]]:
        """Refine those rows that are among some pictures (n, cameras, height, width) of rows `shown` (n,), in the threads of a
        pool. Returns the jobs submitted."""
        own, which = among(self.rows, shown)
        settings = self._settings if self._compared[shown].any() else self._settings._replace(region_pixels=0)
        cuts = np.linspace(0, len(which), self._runs + 1).astype(int).tolist()
        return [
            pool.submit(self._refine_rows, frames, which[a:b], slice(own.start + a, own.start + b), settings)
            for a, b in pairwise(cuts)
            if b > a
        ]

    def _refine_rows(self, frames: Frames, which: Rows, own: slice, settings: RefinementSettings) -> None:
        """Refine the rows `own` of the attempt, whose pictures are frames[which]."""
        if not self._offsets.any:
            self._refine_with_rig(frames, which, own, settings, self._view.rig)
            return
        for k, row in enumerate(range(own.start, own.stop)):
            # The pose of a camera with a clock offset depends on the motion in the frame.
            rig = rig_at(self._view.rig, self._offsets.seconds, self.position_m[row], self._found.motion[row])
            self._refine_with_rig(frames, which[k : k + 1], slice(row, row + 1), settings, rig)

    def _refine_with_rig(
        self, frames: Frames, which: Rows, own: slice, settings: RefinementSettings, rig: CameraRig
    ) -> None:
        rows = PoseRows(*(values[own] for values in self._found))
        refine_frames(frames, which, self._view.model(settings, rig), self._enough, rows)

    def poses(self, count: int) -> ClipPoses:
        """The accepted poses, as rows of a clip of so many frames."""
        # Of a tetrahedron with two faces in view, one of them edge-on, only two lines of the contour are visible: the
        # refinement's own loose prior holds what they leave undetermined.
        information, prior = self._found.H[:, :6, :6], weak_priors(self._view, self.position_m)
        covariance = covariances(information)
        singular = np.flatnonzero(self._found.H.any((1, 2)) & _are_singular(covariance))
        covariance[singular] = covariances(information[singular] + prior[singular])
        out, accepted = ClipPoses.empty(count), self._are_accepted(covariance)
        for share in PRIOR_SHARES:
            with_prior = information[singular] + share * prior[singular]
            is_invertible = ~_are_singular(covariances(with_prior))
            self._found.H[singular[is_invertible], :6, :6] = with_prior[is_invertible]
            singular = singular[~is_invertible]
        rows = self.rows[accepted]
        out.put_rows(rows, PoseRows(*(values[accepted] for values in self._found)))
        return out

    def _are_accepted(self, covariance: Array) -> Mask:
        """(n,) whether the pixels support a refined pose, whose covariances are (n, 6, 6): it stayed near its initial pose, shows
        enough of the contour, and is determined."""
        distance = _seen_distances_m(self._view, self.position_m, self._start.position_m[self.rows])
        angle = angle_between(self.rotation, self._start.rotation[self.rows])
        contour_px = self._found.statistics[:, CONTOUR_PX]
        whole = shares_in_view(self._view, self.position_m, self.rotation) == 1.0
        sigma_rad = np.sqrt(np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2))
        is_near = (distance < MAX_SHIFT_REACH * self._view.reach_m) & (angle < MAX_TURN_RAD)
        on_path = (distance < SECOND_START_REACH * self._view.reach_m) & (angle < SECOND_START_RAD)
        least = np.where(self._on_flights & on_path, ON_PATH_SUPPORT, MIN_SUPPORT)
        has_support = supports(self._found.statistics) >= np.where(whole, least, MIN_SUPPORT_CUT)
        is_visible = (contour_px >= LEAST_CONTOUR_PX) & has_support
        return np.asarray(is_near & is_visible & (sigma_rad < KNOWN_RAD))


def _seen_distances_m(view: View, there_m: Array, here_m: Array) -> Array:
    """(n,) how far the die's farthest points move across the line of sight between places (n, 3): how far away a small die is,
    its picture says only within centimetres."""
    steps = zip(here_m, there_m - here_m, strict=True)
    return np.array([seen_distance_m(view.rig, place, step, view.reach_m) for place, step in steps])


def _are_singular(covariance: Array) -> Mask:
    """(n,) whether a direction is undetermined."""
    return np.asarray(np.isnan(covariance[:, 0, 0]))


def _poses_on_flights(view: View, throw: Throw, frames_s: Array) -> ClipPoses:
    """The poses that the flights give on every frame, as initial poses of a refinement: with a rolling shutter when the row of
    the die's centre is exposed."""
    out, times_s = ClipPoses.empty(len(frames_s)), frames_s
    if view.readout_s != 0.0:
        for _ in range(DELAY_ITERATIONS):
            times_s = frames_s + view.exposure_delay_s(throw.poses(times_s)[0])
    position, quaternion = throw.poses(times_s)
    out.position_m[:], out.rotation[:] = position, matrix_from_quat(quaternion)
    out.motion[:] = throw.rates(times_s)
    out.known[:] = True
    return out
