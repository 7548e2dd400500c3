"""The second pass: frames refined on their edges, from where the flights lead.

That brings back frames that the first pass lost or got wrong. Where the first pass lies elsewhere, a frame is refined from
there as well, and the better is kept. The poses are those of single frames: nothing is smoothed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..clip_parameters import ClockOffsets, rig_at
from ..footage import FrameBlock, Frames, FrameSource, Rows
from ..picture import (
    CLEAR_PX,
    CONTOUR_PX,
    PARAMETERS,
    STATISTICS,
    THREADS,
    CameraRig,
    PoseRows,
    RefinementSettings,
    View,
    refinement_boxes,
    shares_in_view,
)
from ..pose import ClipPoses, covariances, refine_frames, weak_prior
from .labelling import angles, with_labels_of_flights

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOST_SUPPORT, CUT_SUPPORT = 0.45, 0.6
"""Least share of the contour that bears a pose out, of a die wholly in view and of one that is cut by the border."""
LEAST_IN_VIEW = 0.3
"""Share of the corners that must lie in view for a frame to be refined from its flight."""
APART_RAD, APART_REACH = np.radians(1.5), 0.1
"""From how far off, in units of the die's reach the latter, a refinement may lead elsewhere."""
HELD = (0.01, 0.1, 1.0)
"""By how much the prior counts in the pose of a frame whose pixels leave a direction open: the first that inverts, its sigmas ten
times as wide. It is the same flight's on all frames, and where it is none, beside a contact, it must not be found again for
that."""
OPEN_RAD = np.radians(6.0)
"""A pose whose turn is less sure than this is no pose."""


@dataclass(frozen=True, eq=False)
class EdgeRefinement:
    """What there is to start from. Any frames may then be refined, and others later."""

    view: View
    source: FrameSource
    first: ClipPoses
    """Of the first pass, with starts on rows that it left out."""
    throw: Throw | None
    """The flights that it shows."""
    usable: Mask
    """(n,) frames that may be looked at."""
    offsets: ClockOffsets
    min_step_px: float = 0.0
    """A step that moves no point of the die by more than this is the last one: see `along`."""

    def along(self, throw: Throw) -> EdgeRefinement:
        """The same from flights so sure that a step which hardly leaves them is the last: what is left of the way to what the
        pixels of a frame say, about a tenth, is error rather than motion."""
        return replace(self, throw=throw, min_step_px=self.view.quality.min_step_px)

    def see(self, rows: Mask, reached: Callable[[int], None]) -> ClipPoses:
        """Some frames (n,) of the clip, refined; the others are not known. `reached` is called with how far it is."""
        view, first, count = self.view, self.first, len(self.source)
        rows, settings = rows & self.usable, view.settings._replace(min_step_px=self.min_step_px)
        wanted, tries = (
            first,
            [_Settling(view, settings, first, first.known & rows, self.offsets, np.zeros(count, bool))],
        )
        if self.throw is not None:
            wanted = _motions(self.throw, self.source.times_s)
            apart = rows & self._apart_from(wanted)
            tries = [
                _Settling(view, settings, some, use, self.offsets, apart)
                for some, use in ((wanted, rows), (first, apart))
            ]

        def begun(frames: Frames, shown: Rows, pool: Executor) -> list[Future[None]]:
            return [job for one in tries for job in one.see(frames, shown, pool)]

        see_all(self.source, _looked_at(view, tries, count), begun, reached)
        seen = tries[0].seen(count)
        for one in tries[1:]:
            other = one.seen(count)
            seen.take(np.flatnonzero(other.known & (~seen.known | (other.cost < seen.cost))), other)
        return with_labels_of_flights(view, seen, wanted, first)

    def _apart_from(self, flown: ClipPoses) -> Mask:
        """(n,) where the first pass lies further from flights than a refinement is sure to cover."""
        moved = np.linalg.norm(flown.position_m - self.first.position_m, axis=1)
        turned = angles(flown.rotation, self.first.rotation)
        return np.asarray(self.first.known & ((turned > APART_RAD) | (moved > APART_REACH * self.view.reach_m)))


def see_all(
    source: FrameSource,
    boxes: NDArray[np.int64],
    begun: Callable[[Frames, Rows, Executor], list[Future[None]]],
    reached: Callable[[int], None],
) -> None:
    """Hand all frames of which `boxes` hold pixels, block by block, to what begins the jobs of a block in a pool; `reached` is
    called with how many are done. The jobs of a block are waited for when those of the next are begun: no thread then has
    nothing to do because another is late."""
    with ThreadPoolExecutor(THREADS) as pool:
        under_way: list[tuple[FrameBlock, list[Future[None]]]] = []
        for block in source.blocks_within(boxes):
            under_way.append((block, begun(block.frames, block.rows, pool)))
            if len(under_way) > 1:
                _finish(*under_way.pop(0))
            reached(block.first)
        for block, jobs in under_way:
            _finish(block, jobs)
    reached(len(source))


def _finish(block: FrameBlock, jobs: list[Future[None]]) -> None:
    """Wait for the jobs of a block, then release its memory."""
    with block:
        for job in jobs:
            job.result()


def among(rows: Rows, shown: Rows) -> tuple[slice, Rows]:
    """Which of some `rows` lie between the first and the last that are `shown`, and the place of each among those."""
    a, b = (int(k) for k in np.searchsorted(rows, (shown[0], shown[-1] + 1)))
    # One that is not shown has no pixels to be looked at: any frame will do for it.
    return slice(a, b), np.minimum(np.searchsorted(shown, rows[a:b]), len(shown) - 1)


def _looked_at(view: View, tries: Sequence[_Settling], count: int) -> NDArray[np.int64]:
    """(count, cameras, 4) pixels that hold all that a pass looks at."""
    boxes = np.zeros((count, len(view.cameras), 4), np.int64)
    for one in tries:
        mine = refinement_boxes(view, one.position_m, one.rotation)
        there = boxes[one.rows]
        both = np.concatenate([np.minimum(there, mine)[..., :2], np.maximum(there, mine)[..., 2:]], axis=-1)
        lone, blank = (np.asarray(~some.any(-1))[..., None] for some in (there, mine))
        boxes[one.rows] = np.where(lone, mine, np.where(blank, there, both))
    return boxes


class _Settling:
    """Some frames on their way from a start each to the pose that their pixels bear out: what there is to know without the
    pictures is worked out for all of them at once."""

    def __init__(
        self, view: View, settings: RefinementSettings, start: ClipPoses, use: Mask, offsets: ClockOffsets, judged: Mask
    ) -> None:
        """Rows in `use` are refined from `start`. Pictures as a whole are judged where a frame is `judged`, or one near it:
        where there is another start to compare with."""
        in_view = shares_in_view(view, start.position_m, start.rotation) >= LEAST_IN_VIEW
        self.rows: NDArray[np.int64] = np.flatnonzero(use & in_view)
        n = len(self.rows)
        self._view, self._settings, self._start, self._offsets, self._judged = view, settings, start, offsets, judged
        self._found = PoseRows(
            start.position_m[self.rows], start.rotation[self.rows], start.motion[self.rows],
            np.zeros((n, PARAMETERS, PARAMETERS)), np.zeros((n, STATISTICS)), np.full(n, np.inf),
        )  # fmt: skip
        self.position_m, self.rotation = self._found.position, self._found.rotation

    def see(self, frames: Frames, shown: Rows, pool: Executor) -> list[Future[None]]:
        """Refine those that are among some pictures (n, cameras, height, width), which are those of rows `shown` (n,), in the
        threads of a pool: the jobs that were begun."""
        mine, which = among(self.rows, shown)
        settings = self._settings if self._judged[shown].any() else self._settings._replace(region_pixels=0)
        cuts = np.linspace(0, len(which), THREADS + 1).astype(int).tolist()
        return [
            pool.submit(self._settle, frames, which[a:b], slice(mine.start + a, mine.start + b), settings)
            for a, b in pairwise(cuts)
            if b > a
        ]

    def _settle(self, frames: Frames, which: Rows, mine: slice, settings: RefinementSettings) -> None:
        if not self._offsets.any:
            self._settle_with(frames, which, mine, settings, self._view.rig)
            return
        for k, row in enumerate(range(mine.start, mine.stop)):
            # Late cameras stand elsewhere for every frame.
            rig = rig_at(self._view.rig, self._offsets.seconds, self.position_m[row], self._found.motion[row])
            self._settle_with(frames, which[k : k + 1], slice(row, row + 1), settings, rig)

    def _settle_with(
        self, frames: Frames, which: Rows, mine: slice, settings: RefinementSettings, rig: CameraRig
    ) -> None:
        refine_frames(
            frames, which, self._view.model(settings, rig), PoseRows(*(values[mine] for values in self._found))
        )

    def seen(self, count: int) -> ClipPoses:
        """What the pixels bear out of it, as rows of a clip of so many frames."""
        # Of a tetrahedron with two faces in sight, one of them edge-on, two lines of the contour are all that is seen: what they
        # leave open the refinement's own loose prior held.
        pixels, prior = self._found.H[:, :6, :6], weak_prior(self._view)
        known = covariances(pixels)
        held = np.flatnonzero(self._found.H.any((1, 2)) & _are_open(known))
        known[held] = covariances(pixels[held] + prior)
        seen, good = ClipPoses.empty(count), self._borne_out(known)
        for share in HELD:
            told = pixels[held] + share * prior
            inverts = ~_are_open(covariances(told))
            self._found.H[held[inverts], :6, :6] = told[inverts]
            held = held[~inverts]
        rows = self.rows[good]
        seen.put_rows(rows, PoseRows(*(values[good] for values in self._found)))
        return seen

    def _borne_out(self, known: Array) -> Mask:
        """(n,) where the pixels bear a refined pose out, of which so much is `known`: (n, 6, 6) covariances, the prior's share
        included where pixels leave a direction open."""
        gone = np.linalg.norm(self.position_m - self._start.position_m[self.rows], axis=1)
        turned = angles(self.rotation, self._start.rotation[self.rows])
        contour_px = self._found.statistics[:, CONTOUR_PX]
        support = self._found.statistics[:, CLEAR_PX] / np.maximum(contour_px, 1e-9)
        whole = shares_in_view(self._view, self.position_m, self.rotation) == 1.0
        open_rad = np.sqrt(np.trace(known[:, 3:, 3:], axis1=1, axis2=2))
        near = (gone < 0.5 * self._view.reach_m) & (turned < OPEN_RAD)
        plain = (contour_px >= 20.0) & (support >= np.where(whole, LOST_SUPPORT, CUT_SUPPORT))
        return np.asarray(near & plain & (open_rad < OPEN_RAD))


def _are_open(covariance: Array) -> Mask:
    """(n,) where a direction was left open."""
    return np.asarray(np.isnan(covariance[:, 0, 0]))


def _motions(throw: Throw, times_s: Array) -> ClipPoses:
    """Where the flights lead on every frame, as starts for a refinement."""
    out = ClipPoses.empty(len(times_s))
    position, quaternion = throw.poses(times_s)
    out.position_m[:], out.rotation[:] = position, matrix_from_quat(quaternion)
    out.motion[:] = throw.rates(times_s)
    out.known[:] = True
    return out
