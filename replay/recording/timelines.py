"""The two timelines of a recording: `frame` counts frames, `t` is the clip's clock.

Times are whole nanoseconds: seconds as floats would be cut off, and miss their frame by one. What happens between two
frames stands on `t` at its own instant, and on `frame` at the first frame that shows it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

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
        """The first frame at or after each instant (k,); the last frame for what comes later."""
        after = np.searchsorted(self.time_s, np.asarray(times_s, float))
        return np.asarray(self.frame[np.minimum(after, len(self.frame) - 1)])


def nanoseconds(times_s: ArrayLike) -> NDArray[np.timedelta64]:
    """Seconds as the viewer wants them."""
    return np.rint(np.asarray(times_s, float) * 1e9).astype(np.int64).astype("timedelta64[ns]")


def on_frames(frame: Integers, time_s: Array) -> list[rr.TimeColumn]:
    """Both timelines for rows that stand on frames."""
    return [rr.TimeColumn("frame", sequence=frame), rr.TimeColumn("t", duration=nanoseconds(time_s))]


def send_instants(
    recording: rr.RecordingStream, entity: str, times_s: ArrayLike, clock: Clock, columns: rr.ComponentColumnList
) -> None:
    """Rows at instants between frames: exact on `t`, at the first frame that shows them on `frame`."""
    times = np.asarray(times_s, float)
    if len(times):
        recording.send_columns(entity, [rr.TimeColumn("t", duration=nanoseconds(times))], columns)
        recording.send_columns(entity, [rr.TimeColumn("frame", sequence=clock.frame_of(times))], columns)
