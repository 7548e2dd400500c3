"""A clip whose frames have other times than its file says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ..footage import Clip, DerivedClip, FillingDerivedClip, FillsFrames, Frame


def clip_at_times(clip: Clip, times_s: NDArray[np.float64]) -> Clip:
    """The clip with its frames at other times (n,) [s]; the clip itself if they are its own. Raises ValueError for times
    that do not increase, or are not as many as its frames."""
    times = np.asarray(times_s, np.float64)
    if times.shape != (len(clip),) or not (np.diff(times) > 0.0).all():
        raise InputError(f"times of shape {times.shape}: wanted {len(clip)} that increase, one for each frame")
    if np.array_equal(times, clip.times_s):
        return clip
    return _FillingRetimedClip(clip, times) if isinstance(clip, FillsFrames) else _RetimedClip(clip, times)


class _RetimedClip(DerivedClip):
    """A `Clip` whose frames are another's, at other times."""

    def __init__(self, clip: Clip, times_s: NDArray[np.float64]) -> None:
        super().__init__(clip)
        self.times_s = times_s


class _FillingRetimedClip(_RetimedClip, FillingDerivedClip):
    """The same of a clip that writes into given memory."""

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Write the frames from `start` on into `out` (n, height, width), at least the pixels of `boxes` (n, 4) of each."""
        self._filling.fill(start, out, boxes)
