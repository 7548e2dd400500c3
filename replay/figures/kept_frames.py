"""A clip for several figures: what one of them passes over and another wants is decoded once."""

from __future__ import annotations

from collections.abc import Iterable

from ...tracking.footage import Clip, DerivedClip, Frame


class KeptFrames(DerivedClip):
    """A clip that keeps some frames, and reads those that lie on the way to a later one before that.

    To show one frame, a film is decoded from the key frame before it: to go back costs more than to stop on the way.
    """

    def __init__(self, clip: Clip, kept: Iterable[int]) -> None:
        """`kept` are the indices of these frames, counted from `first_frame`."""
        super().__init__(clip)
        self._wanted = sorted(set(kept))
        self._frames: dict[int, Frame] = {}
        self._next = 0

    def frame(self, index: int) -> Frame:
        """One frame; raises as the clip does."""
        if index in self._frames:
            return self._frames[index].copy()
        for earlier in [k for k in self._wanted if self._next <= k < index and k not in self._frames]:
            self._frames[earlier] = self._clip.frame(earlier)
        frame = self._clip.frame(index)
        self._next = index + 1
        if index in self._wanted:
            self._frames[index] = frame.copy()
        return frame
