"""The background, a picture of the scene without the die: read from a file, or estimated from the clip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .clip import Clip
from .images import read_picture

MAX_SAMPLES = 60
"""Most frames in the median: its noise is then a sixth of one frame's."""
MIN_SAMPLES = 9
"""Fewest frames in the median, however large they are."""
SAMPLED_BYTES = 2**28
"""Memory for the sampled frames, at native depth; of large frames fewer are sampled."""
BAND_BYTES = 2**25
"""Memory for the floating-point work of the median at one time."""


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
    """(height, width) grey levels of the scene, as the median of up to MAX_SAMPLES frames spread over the clip.

    A pixel is right if the die covers it in fewer than half of the sampled frames, as a die that falls and bounces does. A die
    that lies still for half the clip becomes part of the background: give a picture of the empty scene, or restrict the frames
    to those before it comes to rest.
    """
    frame_bytes = clip.width_px * clip.height_px * (1 if clip.bit_depth <= 8 else 2)
    count = min(len(clip), max(MIN_SAMPLES, min(MAX_SAMPLES, SAMPLED_BYTES // frame_bytes)))
    chosen = np.unique(np.linspace(0, len(clip) - 1, count).round().astype(int))
    stack: NDArray[np.uint8 | np.uint16] = np.stack([clip.frame(int(k)) for k in chosen])
    rows = max(1, BAND_BYTES // (4 * len(stack) * clip.width_px))
    bands = [np.median(stack[:, r : r + rows], axis=0) for r in range(0, clip.height_px, rows)]
    return np.concatenate(bands).astype(np.float32)


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
        raise ValueError(
            f"{path.name}: the background has {width} × {height} px; wanted the clip's {clip.width_px} × {clip.height_px}; "
            "use a frame of the same camera setting"
        )
    if (picture.dtype == np.uint8) != (clip.bit_depth <= 8) or int(picture.max()) >= 2**clip.bit_depth:
        raise ValueError(
            f"{path.name}: the background has {8 * picture.dtype.itemsize}-bit levels up to {int(picture.max())} and the clip "
            f"{clip.bit_depth} bits; save it at the clip's own depth"
        )
    return picture.astype(np.float32)
