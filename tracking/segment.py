"""Where on a frame is something that is not background, and which of it is only shadow."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

NEAR_BORDER_PX = 3
"""A region that ends so near to the border may go on beyond it: neighbourhoods are cut off there, and specks smoothed away."""


@dataclass(frozen=True, eq=False)
class Blob:
    """One connected region that differs from the background."""

    centre_px: NDArray[np.float64]
    """(2,) x, y."""
    area_px: float
    box: tuple[int, int, int, int]
    """x0, y0, x1, y1; end exclusive."""
    touches_border: bool


def background_noise(images: list[NDArray[np.float32]], background: NDArray[np.float32]) -> float:
    """Standard deviation [grey] of a still pixel about the background: the smallest over the frames of the median
    absolute difference, because a die or its shadow only ever adds to it. Not below what rounding to integers leaves. One
    pixel in four is looked at: of 100 × 100 they tell the noise to two parts in a hundred."""
    some = slice(None, None, 2)
    spreads = [1.4826 * float(np.median(np.abs(image[some, some] - background[some, some]))) for image in images]
    return max(min(spreads), 0.3)


def differing(image: NDArray[np.float32], background: NDArray[np.float32], noise_grey: float) -> Mask:
    """Pixels whose 3 × 3 mean differs from the background by more than five standard errors and two grey levels."""
    mean = cv2.blur(image - background, (3, 3))
    return np.asarray(np.abs(mean) > max(5.0 * noise_grey / 3.0, 2.0))


def without_shadow(image: NDArray[np.float32], background: NDArray[np.float32], noise_grey: float, mask: Mask) -> Mask:
    """`mask` less the pixels that look like the background in a darker light: in a 9 × 9 neighbourhood the image is a
    constant share of the background, texture included."""
    window = (9, 9)
    bb = cv2.blur(background * background, window)
    share = cv2.blur(image * background, window) / np.maximum(bb, 1.0)
    left = cv2.blur(image * image, window) - share * share * bb
    texture = cv2.blur(background * background, window) - cv2.blur(background, window) ** 2
    same = left < 4.0 * noise_grey**2 + 0.1 * share * share * texture
    shadow = (share < 0.97) & same & (image < background + noise_grey)
    return mask & ~shadow


def largest_blob(mask: Mask) -> Blob | None:
    """The largest connected region of at least 60 pixels, small holes and specks smoothed away; None if there is none."""
    kernel = np.ones((3, 3), np.uint8)
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    count, _, stats, centres = cv2.connectedComponentsWithStats(clean)
    if count < 2:
        return None
    k = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    x, y, w, h, area = (int(v) for v in stats[k])
    if area < 60:
        return None
    border = min(x, y) <= NEAR_BORDER_PX
    border = border or x + w >= mask.shape[1] - NEAR_BORDER_PX or y + h >= mask.shape[0] - NEAR_BORDER_PX
    return Blob(np.asarray(centres[k], float), float(area), (x, y, x + w, y + h), border)
