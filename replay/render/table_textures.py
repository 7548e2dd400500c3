"""Textures of the table: reflectances of wood, cork, granite, matte and mirror surfaces, made from noise.

They are as difficult for tracking as real surfaces (grain along one direction, patches, specks, seams), but not
photorealistic. A texture depends on its name and a seed only.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import fftfreq, irfft2, rfft2, rfftfreq

Picture = NDArray[np.float32]

TEXTURE_PX = 2048
WIDTH_M = 0.4
"""Side of the textured square around the origin; beyond it the texture repeats. It has 5 px/mm, as in a close view."""


def table_paint(surface: str, seed: int) -> Picture:
    """Reflectance (n, n), 0 to 1, of the square of side WIDTH_M around the world's origin.

    `surface` is free text: the first name of SURFACES in it decides; without one the table is matte grey.
    """
    rng = np.random.default_rng(seed)
    known = next((name for name in SURFACES if name in surface.lower()), "matte")
    return np.asarray(np.clip(SURFACES[known](rng), 0.01, 0.95), np.float32)


def is_mirror(surface: str) -> bool:
    """Whether the table reflects."""
    return "mirror" in surface.lower()


def _noise(rng: np.random.Generator, sigma_x_px: float, sigma_y_px: float | None = None) -> Picture:
    """Periodic Gaussian noise of unit variance, smoothed with these standard deviations."""
    white = rng.standard_normal((TEXTURE_PX, TEXTURE_PX)).astype(np.float32)
    turns_y, turns_x = 2.0 * np.pi * fftfreq(TEXTURE_PX), 2.0 * np.pi * rfftfreq(TEXTURE_PX)
    keep_y = np.exp(-0.5 * ((sigma_y_px or sigma_x_px) * turns_y) ** 2).astype(np.float32)
    keep_x = np.exp(-0.5 * (sigma_x_px * turns_x) ** 2).astype(np.float32)
    soft = irfft2(rfft2(white) * keep_y[:, None] * keep_x, s=white.shape)
    return np.asarray(soft / soft.std(), np.float32)


def _wood(rng: np.random.Generator) -> Picture:
    """Boards along y with irregular growth rings, fine pores, and dark seams between them."""
    board_px = TEXTURE_PX // 5
    x = np.arange(TEXTURE_PX, dtype=np.float32)[None, :]
    board = (x // board_px).astype(int)
    tone = rng.normal(0.0, 0.05, board.max() + 1)[board]
    phase = (
        rng.uniform(0.0, 40.0, board.max() + 1)[board] + 1.6 * _noise(rng, 60.0, 400.0) + 0.25 * _noise(rng, 8.0, 120.0)
    )
    rings = np.sin(2.0 * np.pi * (x / 34.0 + phase))
    pores = np.maximum(_noise(rng, 1.0, 14.0) - 1.6, 0.0)
    seam = np.exp(-0.5 * (((x % board_px) - 2.0) / 1.5) ** 2)
    return np.asarray(
        (0.34 + 0.045 * rings + 0.02 * _noise(rng, 1.0, 25.0) + tone) * (1 - 0.3 * pores) * (1 - 0.7 * seam)
    )


def _cork(rng: np.random.Generator) -> Picture:
    """Granules of many tones with dark gaps between them."""
    tone = cv2.medianBlur(np.asarray(0.42 + 0.12 * _noise(rng, 2.2, 1.8), np.float32), 5)
    patches = np.round(_noise(rng, 5.0, 4.0) * 1.5) / 1.5
    gaps = np.maximum(-_noise(rng, 2.0, 1.4) - 1.5, 0.0)
    return np.asarray((tone + 0.05 * patches + 0.015 * _noise(rng, 0.7)) * (1.0 - 0.5 * np.minimum(gaps, 1.0)))


def _granite(rng: np.random.Generator) -> Picture:
    """Dark ground with grey patches and bright specks."""
    specks = np.maximum(_noise(rng, 1.6) - 1.7, 0.0)
    return np.asarray(0.13 + 0.045 * _noise(rng, 4.0) + 0.035 * _noise(rng, 1.8) + 0.3 * np.minimum(specks, 1.0))


def _matte(rng: np.random.Generator) -> Picture:
    """Grey lacquer, slightly uneven."""
    return np.asarray(0.35 * (1.0 + 0.025 * _noise(rng, 1.2) + 0.02 * _noise(rng, 60.0)))


def _dust(rng: np.random.Generator) -> Picture:
    """Dust on a mirror: share of the light that it scatters."""
    return np.asarray(0.02 + 0.25 * np.minimum(np.maximum(_noise(rng, 1.6) - 3.6, 0.0), 1.0))


SURFACES: dict[str, Callable[[np.random.Generator], Picture]] = {
    "wood": _wood,
    "cork": _cork,
    "granite": _granite,
    "mirror": _dust,
    "matte": _matte,
}
"""The surfaces by the name in a table's description."""
