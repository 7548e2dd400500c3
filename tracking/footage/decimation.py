"""Decimation of a clip, for speed: every n-th frame only, and smaller pictures.

A smaller picture is the mean over squares of f × f pixels (`cv2.INTER_AREA`), at the clip's own depth. Its noise falls as 1/f,
and so does the blur of the die's edges, in pixels. With pixel centres at integers, pixel u of the clip is pixel
(u - (f - 1)/2)/f of the smaller picture.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ..camera import Camera
from .clip import Clip, Frame

MIN_SIDE_PX = 16
"""Smallest width and height of a picture: in a smaller one no die can be measured."""


@dataclass(frozen=True)
class Decimation:
    """Which part of a clip is used."""

    every: int = 1
    """One frame in so many is used, from the first on."""
    shrink: int = 1
    """Side of the square of the clip's pixels that makes one pixel [px]."""

    def __post_init__(self) -> None:
        for name in ("every", "shrink"):
            value = getattr(self, name)
            if value < 1:
                raise InputError(f"{name} = {value}: wanted a whole number, 1 or more")

    @property
    def is_whole(self) -> bool:
        """Whether all of the clip is used."""
        return self.every == 1 and self.shrink == 1

    def clip(self, clip: Clip) -> Clip:
        """The decimated clip; the clip itself where all is used. Raises ValueError where too little would be left."""
        if self.is_whole:
            return clip
        if min(clip.width_px, clip.height_px) < MIN_SIDE_PX * self.shrink:
            raise InputError(
                f"shrink = {self.shrink} leaves {clip.width_px // self.shrink} × {clip.height_px // self.shrink} px of "
                f"{clip.width_px} × {clip.height_px}; wanted at least {MIN_SIDE_PX} each way; give a smaller shrink"
            )
        if len(clip) <= self.every:
            raise InputError(
                f"every = {self.every} leaves 1 frame of {len(clip)}; wanted 2 at least; give a smaller every"
            )
        return DecimatedClip(clip, self)

    def camera(self, camera: Camera) -> Camera:
        """The camera that takes the smaller pictures: the intrinsics in their pixels."""
        f = self.shrink
        smaller = np.array([[1.0 / f, 0.0, -0.5 * (f - 1) / f], [0.0, 1.0 / f, -0.5 * (f - 1) / f], [0.0, 0.0, 1.0]])
        return replace(
            camera, width_px=camera.width_px // f, height_px=camera.height_px // f, matrix=smaller @ camera.matrix
        )

    def picture(self, picture: NDArray[Any]) -> NDArray[np.float32]:
        """One picture (height, width) made smaller, not rounded; rows and columns that fill no square are left out."""
        f = self.shrink
        height, width = picture.shape[0] // f, picture.shape[1] // f
        # In floating point: on integers OpenCV rounds the mean of four up where it ends in a half, on average by 1/8 of a level.
        squares = picture[: height * f, : width * f].astype(np.float32)
        return np.asarray(cv2.resize(squares, (width, height), interpolation=cv2.INTER_AREA))

    def frame_numbers(self, frames: NDArray[np.int64]) -> NDArray[np.int64]:
        """Frame numbers in the file (n,) of used frames that are numbered one by one from the first."""
        return np.asarray(frames[:1] + self.every * (frames - frames[:1])) if len(frames) else frames

    def frame_ranges(self, first: int, ranges: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        """Ranges (first, stop) of frame numbers in the file as ranges of used frames, numbered one by one from `first`."""
        return tuple((first - (first - a) // self.every, first - (first - b) // self.every) for a, b in ranges)


WHOLE_CLIP = Decimation()
"""All of a clip."""


class DecimatedClip:
    """A `Clip` of the part of another that a `Decimation` uses."""

    def __init__(self, clip: Clip, decimation: Decimation) -> None:
        self._clip, self._decimation = clip, decimation
        self.width_px = clip.width_px // decimation.shrink
        self.height_px = clip.height_px // decimation.shrink
        self.bit_depth = clip.bit_depth
        self.times_s = clip.times_s[:: decimation.every]
        self.first_frame = clip.first_frame

    @property
    def notices(self) -> tuple[str, ...]:
        """Those of the whole clip."""
        return self._clip.notices

    def __len__(self) -> int:
        return len(self.times_s)

    def frame(self, index: int) -> Frame:
        """One frame; raises as the clip does."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} was asked for; the decimated clip has 0 to {len(self) - 1}")
        whole = self._clip.frame(self._decimation.every * index)
        if self._decimation.shrink == 1:
            return whole
        picture = np.rint(self._decimation.picture(whole))
        return picture.astype(np.uint8) if whole.dtype == np.uint8 else picture.astype(np.uint16)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order; raises as the clip does."""
        for index in range(start, len(self) if stop is None else stop):
            yield self.frame(index)

    def metadata(self) -> dict[str, Any]:
        """What the file declares; rate and exposure are those of the whole clip."""
        return self._clip.metadata()
