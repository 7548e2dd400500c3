"""Tracking of a clip whose file may have lost or doubled frames.

The clip is tracked at the times of its file. If the motion shows that frames are missing or repeat others, the times are
corrected, and the clip is tracked again without the copies: fits along the flights, and all that frames share, depend on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from ...model.die import Die
from ..camera import Camera
from ..footage import Clip
from ..quality import STANDARD, Quality
from ..sequence import NO_FACTS, Background, ClipFacts, Progress, TrackedClip, track_clip
from .frame_times import FrameTimes, find_frame_times, joined
from .retimed_clip import clip_at_times

MAX_PASSES = 3
"""Most times that a clip is tracked: a step that hides beside another shows once that is corrected."""
SEVERAL_CAMERAS = "with several cameras, a step of one clock is one of all"
"""Why the times of several cameras are not corrected."""


AS_FILMED = "--timing as-filmed"
"""Why the times are not corrected if that is wanted."""
Timing = Literal["corrected", "as-filmed"]
"""Whether times are corrected for missing and repeated frames."""
TIMINGS: tuple[Timing, ...] = get_args(Timing)


@dataclass(frozen=True)
class ClipClock:
    """What is known and wanted of the clock of a clip."""

    timing: Timing = "corrected"
    interval_s: float | None = None
    """Interval of the camera's clock; None if it is that of the clip."""


ITS_OWN = ClipClock()


@dataclass(frozen=True, eq=False)
class TimedTracking:
    """A tracked clip, with the times of its frames."""

    tracked: TrackedClip
    times: FrameTimes


def track_clip_in_time(
    clips: Sequence[Clip],
    cameras: Sequence[Camera],
    die: Die,
    *,
    background: Sequence[Background | None] | Background | None = None,
    facts: ClipFacts = NO_FACTS,
    quality: Quality = STANDARD,
    progress: Progress | None = None,
    clock: ClipClock = ITS_OWN,
) -> TimedTracking:
    """As `track_clip`, with missing, doubled and frozen frames found, and corrected if `clock` says so. Raises as `track_clip`
    does."""
    times = FrameTimes.as_filmed(clips[0])
    for number in range(MAX_PASSES):
        timed = [clip_at_times(clip, times.times_s) for clip in clips]
        known = replace(facts, excluded=(*facts.excluded, *times.unused))
        tracked = track_clip(
            timed, list(cameras), die, background=background, facts=known, quality=quality, progress=progress
        )
        found = find_frame_times(tracked.track, tracked.die, cameras[0], timed[0], clock.interval_s, known.excluded)
        if clock.timing == "as-filmed":
            found = found.uncorrected(AS_FILMED, clips[0])
        elif len(clips) > 1 and found.changes:
            found = found.uncorrected(SEVERAL_CAMERAS, clips[0])
        times = joined(times, found)
        if not (found.corrected and found.changes) or number == MAX_PASSES - 1:
            break
    return TimedTracking(tracked, times)
