"""Less of a clip, for speed: every n-th frame, or pictures of half the size and less.

A smaller picture is the mean over squares of pixels, at the clip's own depth: its noise falls as 1/f, the die's edges
grow sharper in pixels, and the share of pixels that both sides of an edge mix in stays. With pixel centres at integers,
pixel u of the clip is pixel (u - (f - 1)/2)/f of the smaller picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from .clip import Clip, Frame

SMALLEST_PX = 16
"""Pictures narrower than this show no die."""


@dataclass(frozen=True)
class Coarseness:
    """How much of a clip is used."""

    every: int = 1
    """Every so many frames one is used, from the first on."""
    shrink: int = 1
    """So many pixels of the clip, each way, make one."""

    def __post_init__(self) -> None:
        for name in ("every", "shrink"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name} = {value}: wanted 1 or more, a whole number")

    @property
    def is_whole(self) -> bool:
        """Whether all of the clip is used."""
        return self.every == 1 and self.shrink == 1

    def clip(self, clip: Clip) -> Clip:
        """The clip with less in it; itself where all is used. Raises ValueError where too little would be left."""
        if self.is_whole:
            return clip
        if min(clip.width_px, clip.height_px) < SMALLEST_PX * self.shrink:
            raise ValueError(
                f"shrink = {self.shrink} leaves {clip.width_px // self.shrink} × {clip.height_px // self.shrink} px of "
                f"{clip.width_px} × {clip.height_px}; wanted at least {SMALLEST_PX} each way: shrink less"
            )
        if len(clip) <= self.every:
            raise ValueError(f"every = {self.every} leaves 1 frame of {len(clip)}; wanted 2 at least: leave out fewer")
        return CoarserClip(clip, self)

    def camera(self, camera: Camera) -> Camera:
        """The camera whose pictures the smaller ones are."""
        f = self.shrink
        smaller = np.array([[1.0 / f, 0.0, -0.5 * (f - 1) / f], [0.0, 1.0 / f, -0.5 * (f - 1) / f], [0.0, 0.0, 1.0]])
        return replace(
            camera, width_px=camera.width_px // f, height_px=camera.height_px // f, matrix=smaller @ camera.matrix
        )

    def picture(self, picture: NDArray[Any]) -> NDArray[np.float32]:
        """One picture (height, width) made smaller."""
        f = self.shrink
        height, width = picture.shape[0] // f, picture.shape[1] // f
        squares = picture[: height * f, : width * f].reshape(height, f, width, f)
        return np.asarray(squares.mean((1, 3), dtype=np.float32))

    def numbers(self, frames: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers in the file (n,) of frames that were counted one by one from the first."""
        return np.asarray(frames[:1] + self.every * (frames - frames[:1])) if len(frames) else frames

    def rows(self, first: int, ranges: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        """Ranges (first, stop) of frame numbers in the file as ranges of frames counted one by one from `first`."""
        return tuple((first - (first - a) // self.every, first - (first - b) // self.every) for a, b in ranges)


WHOLE = Coarseness()
"""All of a clip."""


class CoarserClip:
    """A clip of which a part is used."""

    def __init__(self, clip: Clip, coarseness: Coarseness) -> None:
        self._clip, self._coarseness = clip, coarseness
        self.width_px = clip.width_px // coarseness.shrink
        self.height_px = clip.height_px // coarseness.shrink
        self.bit_depth = clip.bit_depth
        self.times_s = clip.times_s[:: coarseness.every]
        self.first_frame = clip.first_frame

    @property
    def notices(self) -> tuple[str, ...]:
        """Those of the clip."""
        return self._clip.notices

    def __len__(self) -> int:
        return len(self.times_s)

    def frame(self, index: int) -> Frame:
        """One frame; raises as the clip does."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} was asked for, and there are 0 to {len(self) - 1}")
        whole = self._clip.frame(self._coarseness.every * index)
        if self._coarseness.shrink == 1:
            return whole
        smaller = np.rint(self._coarseness.picture(whole))
        return smaller.astype(np.uint8) if whole.dtype == np.uint8 else smaller.astype(np.uint16)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order; raises as the clip does."""
        for index in range(start, len(self) if stop is None else stop):
            yield self.frame(index)

    def metadata(self) -> dict[str, Any]:
        """What the file says of itself."""
        return self._clip.metadata()
