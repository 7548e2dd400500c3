"""The camera's response: a clip of grey levels as a clip of light.

The lens, the motion and the area of a pixel average light. A camera or a codec for display then stores a curve of it, such as
grey = light ** 0.45, and a blurred edge in grey levels lies off its place, towards its darker side. `clip_in_light` undoes the
curve by a table: every reader of the mapped clip sees light.

Mapped levels are integers with EXTRA_BITS more than the file's, so that rounding them adds nothing: the lowest step of the
file is 5 of them under sRGB. A clip with a linear response is not mapped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from .clip import Clip, DerivedClip, FillingDerivedClip, FillsFrames, Frame

Response = str | float | None
"""`linear`, `srgb` or an exponent (grey = light ** exponent); None if it is not known, which counts as linear."""

LINEAR, SRGB = "linear", "srgb"
NAMED_RESPONSES = (LINEAR, SRGB)
EXPONENTS = (0.2, 1.5)
"""Least and largest exponent. Displays have 0.4 to 0.5; a value such as 2.2 is the inverse of what is wanted."""
EXTRA_BITS = 6
"""Bits of a mapped clip beyond the file's, up to 16 in all."""
MAX_BITS = 16
BYTE_BITS = 8


def is_linear(response: Response) -> bool:
    """Whether grey levels are proportional to light, as far as is known."""
    return response is None or response in (LINEAR, 1.0)


def light_of(grey: NDArray[np.float64], response: Response) -> NDArray[np.float64]:
    """Light for grey levels, both as shares of full scale. Raises ValueError for an unknown response."""
    if is_linear(response):
        return np.asarray(grey, float)
    if response == SRGB:
        return np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return np.asarray(grey ** (1.0 / _exponent(response)))


def grey_of(light: NDArray[np.float64], response: Response) -> NDArray[np.float64]:
    """Grey levels for light, both as shares of full scale: the inverse of `light_of`. Raises ValueError as that does."""
    if is_linear(response):
        return np.asarray(light, float)
    if response == SRGB:
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.asarray(light ** _exponent(response))


def _exponent(response: Response) -> float:
    if isinstance(response, str) or response is None or not EXPONENTS[0] <= response <= EXPONENTS[1]:
        raise InputError(
            f"response = {response!r}: wanted one of {', '.join(NAMED_RESPONSES)}, or an exponent from {EXPONENTS[0]} to "
            f"{EXPONENTS[1]} (grey = light ** exponent)"
        )
    return float(response)


def light_table(bit_depth: int, response: Response) -> NDArray[np.uint16]:
    """Mapped level of every value that a pixel of `bit_depth` bits can have in memory; above full scale that of full scale."""
    grey = np.arange(2**BYTE_BITS if bit_depth <= BYTE_BITS else 2**MAX_BITS) / (2**bit_depth - 1)
    return np.asarray(np.rint(_full_scale(bit_depth) * light_of(np.minimum(grey, 1.0), response)), np.uint16)


def level_grey(clip: Clip, response: Response) -> float:
    """Levels of the mapped clip per level of the file, on average; 1 for a linear response."""
    return 1.0 if is_linear(response) else _full_scale(clip.bit_depth) / (2**clip.bit_depth - 1)


def clip_in_light(clip: Clip, response: Response) -> Clip:
    """The clip with its grey levels mapped to light; the clip itself if the response is linear."""
    if is_linear(response):
        return clip
    return _FillingLightClip(clip, response) if isinstance(clip, FillsFrames) else _LightClip(clip, response)


def picture_in_light(picture: NDArray[np.float32], clip: Clip, response: Response) -> NDArray[np.float32]:
    """A picture (height, width) in the clip's grey levels mapped as the clip is."""
    if is_linear(response):
        return picture
    full = 2**clip.bit_depth - 1
    share = np.clip(picture / full, 0.0, 1.0)
    return np.asarray(_full_scale(clip.bit_depth) * light_of(share, response), np.float32)


def _full_scale(bit_depth: int) -> int:
    return int(2 ** min(bit_depth + EXTRA_BITS, MAX_BITS) - 1)


class _LightClip(DerivedClip):
    """A `Clip` whose frames are another's, mapped by a table."""

    def __init__(self, clip: Clip, response: Response) -> None:
        super().__init__(clip)
        self._table = light_table(clip.bit_depth, response)
        self.bit_depth = min(clip.bit_depth + EXTRA_BITS, MAX_BITS)

    def _changed(self, frame: Frame) -> Frame:
        return np.asarray(self._table[frame])


class _FillingLightClip(_LightClip, FillingDerivedClip):
    """The same of a clip that writes into given memory; a pixel outside the boxes is not mapped."""

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Write the frames from `start` on into `out` (n, height, width), at least the pixels of `boxes` (n, 4) of each."""
        raw = np.empty(out.shape, np.uint8 if self._clip.bit_depth <= BYTE_BITS else np.uint16)
        self._filling.fill(start, raw, boxes)
        for k, picture in enumerate(out):
            x0, y0, x1, y1 = (0, 0, self.width_px, self.height_px) if boxes is None else boxes[k].tolist()
            picture[y0:y1, x0:x1] = self._table[raw[k, y0:y1, x0:x1]]
