"""The background, a picture of the scene without the die: read from a file, or estimated from the clip.

On a pixel the background stays what it is, and the die that passes shows now this face and now that one: of the grey levels over
time, those of the background lie closest together, even where the die covers the pixel most of the time. The estimate is their
mean: the samples about the shortest interval that holds a share of them all (the estimator of location of Andrews et al. 1972
called shorth, there with half of the samples).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from .clip import Clip
from .images import read_picture

MAX_SAMPLES = 60
"""Most frames that are sampled: the noise of the background is then a seventh of one frame's."""
MIN_SAMPLES = 9
"""Fewest frames that are sampled, however large they are."""
SAMPLED_BYTES = 2**28
"""Memory for the sampled frames, at native depth; of large frames fewer are sampled."""
BAND_BYTES = 2**25
"""Memory for the floating-point work on them at one time."""
CLOSEST_SHARE = 1.0 / 3.0
"""Share of the samples in the shortest interval. With a half, as with the median, a die that turns back at its highest point
leaves a picture of itself; with a quarter, the soft shadow beside it is left more often."""
MEAN_REACH = 2.5
"""Reach about the middle of that interval, in its lengths, within which samples enter the mean: 2.15 standard deviations if all
show the background with normal noise, and more if the die covers most of them."""

STILL_SAMPLES = 8
"""Frames that are compared before all are: of a throw, hardly any two of them are alike."""
STILL_RMS = 0.6
"""Largest root mean square difference [levels of 8 bits] of copies of one picture: codecs leave up to 0.5, and noise of one level
makes 1.4."""
STILL_LEVELS = 12.0
"""Largest difference of a single pixel [levels of 8 bits] of such copies: a die that moves makes more."""


def shows_one_picture(clip: Clip) -> bool:
    """Whether all of several frames are copies of one picture, up to what a codec changes: nothing can be measured on them."""
    first = np.asarray(clip.frame(0), np.float32)
    unit = 2.0 ** (clip.bit_depth - 8)

    def is_first(index: int) -> bool:
        difference = np.abs(np.asarray(clip.frame(index), np.float32) - first)
        return (
            float(difference.max()) <= STILL_LEVELS * unit
            and float(np.sqrt((difference**2).mean())) <= STILL_RMS * unit
        )

    samples = np.unique(np.linspace(1, len(clip) - 1, STILL_SAMPLES).astype(int)) if len(clip) > 1 else ()
    return len(clip) > 1 and all(map(is_first, map(int, samples))) and all(map(is_first, range(1, len(clip))))


def estimate_background(clip: Clip) -> NDArray[np.float32]:
    """(height, width) grey levels of the scene, from up to MAX_SAMPLES frames spread over the clip.

    A pixel is right if at least CLOSEST_SHARE of the sampled frames show the background there, and the die shows no single grey
    level as often. A die that lies still for long becomes part of the background: give a picture of the empty scene, or restrict
    the frames to those before it comes to rest.
    """
    frame_bytes = clip.width_px * clip.height_px * (1 if clip.bit_depth <= 8 else 2)
    count = min(len(clip), max(MIN_SAMPLES, min(MAX_SAMPLES, SAMPLED_BYTES // frame_bytes)))
    chosen = np.unique(np.linspace(0, len(clip) - 1, count).round().astype(int))
    stack: NDArray[np.uint8 | np.uint16] = np.stack([clip.frame(int(k)) for k in chosen])
    rows = max(1, BAND_BYTES // (4 * len(stack) * clip.width_px))
    bands = [_mean_of_closest(stack[:, r : r + rows]) for r in range(0, clip.height_px, rows)]
    return np.concatenate(bands)


def _mean_of_closest(samples: NDArray[np.uint8 | np.uint16]) -> NDArray[np.float32]:
    """(...) mean of those of samples (n, ...) that lie about their shortest interval with CLOSEST_SHARE of them."""
    levels = np.sort(samples, axis=0).astype(np.float32)
    count = max(1, round(CLOSEST_SHARE * len(levels)))
    lengths = levels[count - 1 :] - levels[: len(levels) - count + 1]
    length = lengths.min(axis=0)
    # Whole grey levels have many intervals of one length: that in the middle of them.
    rank = np.cumsum(lengths == length, axis=0, dtype=np.int16)
    first = np.argmax(rank >= (rank[-1] + 1) // 2, axis=0)
    middle = np.take_along_axis(levels, first[None], axis=0)[0] + 0.5 * length
    near = np.abs(levels - middle) <= MEAN_REACH * length
    return np.asarray(levels.sum(axis=0, where=near) / near.sum(axis=0), np.float32)


def load_background(path: Path, clip: Clip) -> NDArray[np.float32]:
    """(height, width) grey levels of a picture of the empty scene.

    Raises FileNotFoundError, and ValueError for a file that is no picture, or of another size or depth than the clip.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: there is no such background picture; give its path relative to the scene file"
        )
    picture = read_picture(path)
    height, width = picture.shape
    if (width, height) != (clip.width_px, clip.height_px):
        raise InputError(
            f"{path.name}: the background has {width} × {height} px; wanted the clip's {clip.width_px} × {clip.height_px}; "
            "use a frame of the same camera setting"
        )
    if (picture.dtype == np.uint8) != (clip.bit_depth <= 8) or int(picture.max()) >= 2**clip.bit_depth:
        raise InputError(
            f"{path.name}: the background has {8 * picture.dtype.itemsize}-bit levels up to {int(picture.max())} and the clip "
            f"{clip.bit_depth} bits; save it at the clip's own depth"
        )
    return picture.astype(np.float32)
