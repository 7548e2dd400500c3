"""Rows on the two timelines of a recording: `frame` counts frames, `t` is the clip's clock.

Times are whole nanoseconds, because the viewer truncates float seconds and a row could then miss its frame by one. An
event between two frames has its own instant on `t`, and the first frame after it on `frame`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from ..elements import Colour, Motion

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Clock:
    """The frames of the recording and their times."""

    frame: Integers
    """(n,) increasing."""
    time_s: Array
    """(n,)."""

    def frame_of(self, times_s: ArrayLike) -> Integers:
        """The first frame at or after each instant (k,) [s]; the last frame for later instants."""
        after = np.searchsorted(self.time_s, np.asarray(times_s, float))
        return np.asarray(self.frame[np.minimum(after, len(self.frame) - 1)])


def nanoseconds(times_s: ArrayLike) -> NDArray[np.timedelta64]:
    """Seconds as the viewer expects them."""
    return np.rint(np.asarray(times_s, float) * 1e9).astype(np.int64).astype("timedelta64[ns]")


def on_frames(frame: Integers, time_s: Array) -> list[rr.TimeColumn]:
    """Both timelines of rows on frames."""
    return [rr.TimeColumn("frame", sequence=frame), rr.TimeColumn("t", duration=nanoseconds(time_s))]


def send_instants(
    recording: rr.RecordingStream, entity: str, times_s: ArrayLike, clock: Clock, columns: rr.ComponentColumnList
) -> None:
    """Rows at instants (k,) [s] between frames: exact on `t`, and at the first frame after them on `frame`."""
    times = np.asarray(times_s, float)
    if len(times):
        recording.send_columns(entity, [rr.TimeColumn("t", duration=nanoseconds(times))], columns)
        recording.send_columns(entity, [rr.TimeColumn("frame", sequence=clock.frame_of(times))], columns)


def send_clears(recording: rr.RecordingStream, entity: str, motion: Motion) -> None:
    """Clear the entity and all below it on every frame without a pose."""
    if len(motion.missing_frame):
        clears = rr.Clear.columns(is_recursive=[True] * len(motion.missing_frame))
        recording.send_columns(entity, on_frames(motion.missing_frame, motion.missing_time_s), clears)


def send_log_lines(
    recording: rr.RecordingStream, entity: str, times_s: ArrayLike, lines: Sequence[str], clock: Clock, colour: Colour
) -> None:
    """Lines of the event log."""
    log = rr.TextLog.columns(text=lines, level=["INFO"] * len(lines), color=[colour] * len(lines))
    send_instants(recording, entity, times_s, clock, log)


def send_vertical_lines(
    recording: rr.RecordingStream,
    entity: str,
    times_s: ArrayLike,
    ends: tuple[ArrayLike, ArrayLike],
    clock: Clock,
    style: rr.SeriesLines,
) -> None:
    """A vertical line in a plot at each instant, between the two `ends`; NaN separates it from the next line."""
    times = np.asarray(times_s, float)
    points = np.stack(np.broadcast_arrays(*ends, np.full(len(times), np.nan)), axis=1)
    recording.log(entity, style, static=True)
    send_instants(recording, entity, np.repeat(times, 3), clock, rr.Scalars.columns(scalars=points.ravel()))
