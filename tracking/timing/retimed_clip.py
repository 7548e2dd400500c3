"""A clip whose frames have other times than its file says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..footage import Clip, FillsFrames, Frame


def clip_at_times(clip: Clip, times_s: NDArray[np.float64]) -> Clip:
    """The clip with its frames at other times (n,) [s]; the clip itself if they are its own. Raises ValueError for times
    that do not increase, or are not as many as its frames."""
    times = np.asarray(times_s, np.float64)
    if times.shape != (len(clip),) or not (np.diff(times) > 0.0).all():
        raise ValueError(f"times of shape {times.shape}: wanted {len(clip)} that increase, one for each frame")
    if np.array_equal(times, clip.times_s):
        return clip
    return _FillingRetimedClip(clip, times) if isinstance(clip, FillsFrames) else _RetimedClip(clip, times)


class _RetimedClip:
    """A `Clip` whose frames are another's, at other times."""

    def __init__(self, clip: Clip, times_s: NDArray[np.float64]) -> None:
        self._clip = clip
        self.width_px, self.height_px, self.bit_depth = clip.width_px, clip.height_px, clip.bit_depth
        self.times_s, self.first_frame = times_s, clip.first_frame

    @property
    def notices(self) -> tuple[str, ...]:
        """Those of the file."""
        return self._clip.notices

    def __len__(self) -> int:
        return len(self._clip)

    def frame(self, index: int) -> Frame:
        """One frame; raises as the clip does."""
        return self._clip.frame(index)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order; raises as the clip does."""
        return self._clip.frames(start, stop)

    def metadata(self) -> dict[str, Any]:
        """What the file declares."""
        return self._clip.metadata()


class _FillingRetimedClip(_RetimedClip):
    """The same of a clip that writes into given memory."""

    def __init__(self, clip: Clip, times_s: NDArray[np.float64]) -> None:
        super().__init__(clip, times_s)
        assert isinstance(clip, FillsFrames)
        self._filling: FillsFrames = clip

    @property
    def in_any_order(self) -> bool:
        """As of the clip."""
        return self._filling.in_any_order

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Write the frames from `start` on into `out` (n, height, width), at least the pixels of `boxes` (n, 4) of each."""
        self._filling.fill(start, out, boxes)
