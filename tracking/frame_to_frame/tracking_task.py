"""The clip that is tracked, and tracking to both of its ends from an initial pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..footage import FrameSource
from ..pose import ClipPoses, ManualInitialisation
from .frame_tracker import BACKWARDS_MISSES, FrameTracker

Mask = NDArray[np.bool_]


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


def track_both_ways(tracker: FrameTracker, task: TrackingTask, poses: ClipPoses) -> FrameTracker:
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
