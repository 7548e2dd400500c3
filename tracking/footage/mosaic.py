"""Raw mosaics of colour sensors, saved as grey: recognised in the pictures and smoothed away.

The pixels of such a sensor lie behind colour filters that repeat with a cell of 2 × 2 pixels. On any scene they differ from their
neighbours in three patterns with a period of two pixels: a chequer, columns and rows. Their contrasts C are, from the levels
p_ij of a cell with mean p,

    chequer (p_00 + p_11 - p_01 - p_10) / 4p,  columns (p_00 + p_10 - p_01 - p_11) / 4p,  rows (p_00 + p_01 - p_10 - p_11) / 4p.

A pattern of the scene, such as a cloth, has no fixed phase to the pixels: C changes its sign over the picture, and that of
noise and compression differs from tile to tile. A mosaic has a contrast of LEAST_CONTRAST or more in one of them, with one sign
on nearly all tiles.

The binomial filter [1 2 1]ᵀ[1 2 1] / 16 has a zero at this period in both directions and removes all three patterns exactly,
whatever the colours of the scene. It blurs by 0.7 px (standard deviation). Scaling the four kinds of pixels to one mean keeps the
sharpness, but leaves the pattern on everything that has another colour than the background: on a rendered clip with a
coloured die 15 poses of 66 were wrong with it, and 3 of 63 with the filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .clip import Clip, DerivedClip, FillingDerivedClip, FillsFrames, Frame
from .reader import MOSAIC

Array = NDArray[np.float64]

LEAST_CONTRAST = 0.05
"""Least contrast of a mosaic. Amplifiers of alternate columns differ by 1 %; red and blue pixels in white light have about 0.6
times the level of green ones, which makes a chequer of 0.25."""
TILE_PX = 16
"""Side of a tile: 64 cells, whose mean has a small noise."""
LEAST_TILES = 24
"""Fewest tiles to decide by: equal signs on nine tenths of them are no chance."""
ONE_SIGN_SHARE = 0.9
"""Share of the tiles with the same sign: the rest may show something of another colour."""
DARK_SHARE = 0.25
"""Share of the picture's mean below which a tile is too dark to say anything."""
REACH_PX = 1
"""Of the filter beyond a pixel."""


@dataclass(frozen=True, eq=False)
class Mosaic:
    """The pattern of colour filters that a picture shows."""

    level_shares: Array
    """(2, 2) mean level of each kind of pixel, as a share of the mean of all."""

    def notice(self, name: str) -> str:
        """What was found in the file of this name, and what is done."""
        shares = " : ".join(f"{share:.2f}" for share in self.level_shares.ravel())
        return (
            f"{name}: the frames are the {MOSAIC} (the pixels of a 2 × 2 cell have levels as {shares}); each frame is smoothed "
            "by 3 × 3 pixels, which removes the pattern and blurs by 0.7 px."
        )


def find_mosaic(picture: NDArray[Any]) -> Mosaic | None:
    """The mosaic in a picture (height, width); None where it shows none, or is too small to decide."""
    rows, columns = (side // TILE_PX for side in picture.shape)
    if rows * columns < LEAST_TILES:
        return None
    cells = picture[: rows * TILE_PX, : columns * TILE_PX].reshape(rows, TILE_PX // 2, 2, columns, TILE_PX // 2, 2)
    kinds = cells.mean((1, 4), dtype=np.float64).transpose(1, 3, 0, 2)  # (2, 2, rows, columns)
    mean = kinds.mean((0, 1))
    lit = mean > DARK_SHARE * mean.mean()
    if np.count_nonzero(lit) < LEAST_TILES:
        return None
    (p00, p01), (p10, p11) = kinds[..., lit]
    patterns = np.array([p00 + p11 - p01 - p10, p00 + p10 - p01 - p11, p00 + p01 - p10 - p11]) / 4.0
    contrast = patterns.sum(1) / mean[lit].sum()
    same_sign = (np.sign(patterns) == np.sign(contrast)[:, None]).mean(1)
    if not ((np.abs(contrast) >= LEAST_CONTRAST) & (same_sign >= ONE_SIGN_SHARE)).any():
        return None
    shares = kinds[..., lit].sum(-1)
    return Mosaic(shares / shares.mean())


def mosaic_of(clip: Clip) -> Mosaic | None:
    """The mosaic that a clip shows on its first frame and on its middle one; None where either shows none."""
    first, middle = find_mosaic(clip.frame(0)), find_mosaic(clip.frame(len(clip) // 2))
    return None if middle is None else first


def smoothed(picture: NDArray[Any]) -> NDArray[Any]:
    """The picture (height, width) under the binomial filter; its border is reflected about the outermost pixels, which keeps
    the phase of the cells."""
    weights = np.array([0.25, 0.5, 0.25])
    return np.asarray(cv2.sepFilter2D(picture, -1, weights, weights, borderType=cv2.BORDER_REFLECT_101))


def clip_without_mosaic(clip: Clip, notice: str) -> Clip:
    """The clip with its frames smoothed and one notice more (`Mosaic.notice`); `mosaic` in its metadata is true."""
    return _FillingSmoothedClip(clip, notice) if isinstance(clip, FillsFrames) else _SmoothedClip(clip, notice)


def has_mosaic(clip: Clip) -> bool:
    """Whether the clip has been smoothed because of a mosaic."""
    return bool(clip.metadata().get("mosaic"))


class _SmoothedClip(DerivedClip):
    """A `Clip` whose frames are another's, smoothed."""

    def __init__(self, clip: Clip, notice: str) -> None:
        super().__init__(clip)
        self._notice = notice

    def _changed(self, frame: Frame) -> Frame:
        return smoothed(frame)

    @property
    def notices(self) -> tuple[str, ...]:
        """Those of the file, and that on the mosaic."""
        return (*self._clip.notices, self._notice)

    def metadata(self) -> dict[str, Any]:
        """What the file declares."""
        return {**self._clip.metadata(), "mosaic": True}


class _FillingSmoothedClip(_SmoothedClip, FillingDerivedClip):
    """The same of a clip that writes into given memory; a pixel outside the boxes is not smoothed."""

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Write the frames from `start` on into `out` (n, height, width), at least the pixels of `boxes` (n, 4) of each."""
        raw = np.empty_like(out)
        if boxes is None:
            self._filling.fill(start, raw)
            for k, picture in enumerate(raw):
                out[k] = smoothed(picture)
            return
        size = np.array([self.width_px, self.height_px])
        wider = np.hstack([np.maximum(boxes[:, :2] - REACH_PX, 0), np.minimum(boxes[:, 2:] + REACH_PX, size)])
        is_empty = (boxes[:, 2:] <= boxes[:, :2]).any(1)
        wider[is_empty] = 0
        self._filling.fill(start, raw, wider)
        for k in np.flatnonzero(~is_empty).tolist():
            (x0, y0, x1, y1), (left, top, right, bottom) = boxes[k].tolist(), wider[k].tolist()
            part = smoothed(raw[k, top:bottom, left:right])
            out[k, y0:y1, x0:x1] = part[y0 - top : y1 - top, x0 - left : x1 - left]
