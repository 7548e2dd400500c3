"""What a camera does with the light and with its grey levels, beside recording them: each a small step with one number.

On the light: automatic exposure (a gain that drifts), and the colour filters of a raw mosaic. On grey levels: temporal noise
reduction, sharpening, and the crop of a stabiliser, in the order in which phones apply them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift

from ...model.errors import InputError

Array = NDArray[np.float64]

SHARPENING_RADIUS_PX = 1.2
"""Standard deviation of the blur that sharpening subtracts: halos of 2 to 3 px, as in films of phones."""
DENOISED_SHARE = 0.35
"""Share of the new frame in a still pixel after noise reduction: noise falls to a half."""
MOTION_SIGMAS = 3.0
"""Change of a pixel, in standard deviations of its noise, at which noise reduction takes all of the new frame."""
SHAKE_FRAMES = 12.0
"""Correlation time of the shifts of a stabiliser's crop."""
COLOUR_FILTERS = np.array([[0.55, 1.0], [1.0, 0.65]])
"""Sensitivities of the pixels of a Bayer cell (red, green; green, blue) to white light, relative to green."""


@dataclass(frozen=True)
class Processing:
    """Strengths of all steps; 0 leaves a step out."""

    gain_drift: float = 0.0
    """The gain of the exposure rises by this share from the first frame to the middle one, and again to the last."""
    bayer: bool = False
    """Whether the pixels keep their colour filters: the raw mosaic in grey."""
    denoising: float = 0.0
    """Noise reduction over frames, from 0 to 1; moving edges of low contrast leave trails."""
    sharpening: float = 0.0
    """Share of the fine detail that is added; edges get halos."""
    shake_px: float = 0.0
    """Standard deviation of the shifts of the picture from frame to frame by a stabiliser."""

    def __post_init__(self) -> None:
        for name in ("gain_drift", "sharpening", "shake_px"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name} = {getattr(self, name)}: wanted 0 or more")
        if not 0 <= self.denoising <= 1:
            raise InputError(f"denoising = {self.denoising}: wanted 0 (none) to 1")


def gains(processing: Processing, frames: int) -> Array:
    """(n,) factors on the light of the frames, 1 for the middle one."""
    share = np.arange(frames) / max(frames - 1, 1)
    return np.asarray((1.0 + processing.gain_drift) ** -np.cos(np.pi * share))


def shifts_px(processing: Processing, frames: int, seed: int) -> Array:
    """(n, 2) shifts of the pictures to the right and down: a smooth random walk about 0."""
    keep = np.exp(-1.0 / SHAKE_FRAMES)
    steps = np.random.default_rng([seed, 3]).standard_normal((frames, 2))
    walk = np.empty((frames, 2))
    at = steps[0] if frames else np.zeros(2)
    for k, step in enumerate(steps):
        at = keep * at + np.sqrt(1.0 - keep**2) * step
        walk[k] = at
    return processing.shake_px * walk


def filtered(light: Array, processing: Processing) -> Array:
    """The light behind the colour filters."""
    if not processing.bayer:
        return light
    height, width = light.shape
    mosaic = np.tile(COLOUR_FILTERS, (-(-height // 2), -(-width // 2)))[:height, :width]
    return light * mosaic


class Processor:
    """The steps on grey levels. It has state: noise reduction remembers the frame before."""

    def __init__(self, processing: Processing, noise_levels: float) -> None:
        """`noise_levels` is the standard deviation of the noise of a pixel that the camera assumes."""
        self.processing = processing
        self._noise = max(noise_levels, 1e-9)
        self._before: Array | None = None

    def levels(self, recorded: Array, shift_px: Array) -> Array:
        """Grey levels (height, width) of the next frame after all steps, unrounded and unclipped."""
        return shifted(sharpened(self._denoised(recorded), self.processing.sharpening), shift_px)

    def _denoised(self, new: Array) -> Array:
        if self.processing.denoising == 0:
            return new
        if self._before is not None:
            change = np.abs(cv2.GaussianBlur(new - self._before, (0, 0), 1.0))
            # The blur reduces the noise of the difference of two frames to 0.4 of that of one.
            moves = np.clip(change / (0.4 * MOTION_SIGMAS * self._noise) - 1.0, 0.0, 1.0)
            least = 1.0 - self.processing.denoising * (1.0 - DENOISED_SHARE)
            new = self._before + np.maximum(moves, least) * (new - self._before)
        self._before = new
        return new


def sharpened(levels: Array, share: float) -> Array:
    """Grey levels with their fine detail enhanced."""
    if share == 0:
        return levels
    soft = cv2.GaussianBlur(levels, (0, 0), SHARPENING_RADIUS_PX, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(levels + share * (levels - soft))


def shifted(levels: Array, shift_px: Array) -> Array:
    """The picture moved to the right and down, by cubic splines."""
    if not np.any(shift_px):
        return levels
    return np.asarray(shift(levels, (shift_px[1], shift_px[0]), order=3, mode="nearest"))
