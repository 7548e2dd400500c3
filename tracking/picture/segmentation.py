"""Where on a frame is something that is not background, and which of it is only shadow."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

NEAR_BORDER_PX = 3
"""A region that ends so near to the border may go on beyond it: neighbourhoods are cut off there, and specks smoothed
away."""

DITHERED = 0.5
"""Noise, in steps between grey levels, with which rounding errs for each pixel by itself: in the mean it is off by no
more than exp(-2π²/4)/π of a step then, a four hundredth."""

RIM_PX, THIN_PX = 6, 11
"""How far beyond a sure shadow its rim reaches: half the window in which its share of light is looked at, and the
penumbra; and the width below which what is left of a rim, and light thrown on the table by the die, is taken out with
it."""


@dataclass(frozen=True, eq=False)
class Blob:
    """One connected region that differs from the background."""

    centre_px: NDArray[np.float64]
    """(2,) x, y."""
    area_px: float
    box: tuple[int, int, int, int]
    """x0, y0, x1, y1; end exclusive."""
    touches_border: bool


def level_step(images: list[NDArray[np.float32]]) -> float:
    """Step [grey] between levels as some frames (height, width) show them: the smallest gap between two that occur, and
    1 where but one does. It is 1 where a file uses all its levels; 12 bits in the upper part of 16 show 16."""
    step_grey = np.inf
    for image in images:
        gaps = np.diff(np.unique(image[::2, ::2]))
        step_grey = min(step_grey, float(gaps.min(initial=np.inf)))
        if step_grey <= 1.0:
            break
    return step_grey if np.isfinite(step_grey) else 1.0


def errs_alike(step_grey: float, noise_grey: float) -> bool:
    """Whether rounding to steps so wide errs alike on pixels of one grey. Steps of 1 are left to the least noise that
    edges are given."""
    return step_grey > 1.0 and noise_grey < DITHERED * step_grey


def noise_and_rounding(images: list[NDArray[np.float32]], background: NDArray[np.float32]) -> tuple[float, float]:
    """`background_noise` [grey] for the levels that occur, and the step between these [grey] where rounding errs alike,
    or 0."""
    step_grey = level_step(images)
    noise_grey = background_noise(images, background, step_grey)
    return noise_grey, step_grey if errs_alike(step_grey, noise_grey) else 0.0


def background_noise(
    images: list[NDArray[np.float32]], background: NDArray[np.float32], step_grey: float = 1.0
) -> float:
    """Standard deviation [grey] of a still pixel about the background: the smallest over the frames of the median
    absolute difference, because a die or its shadow only ever adds to it. Not below what rounding to steps of
    `step_grey` leaves. One pixel in four is looked at: of 100 × 100 they tell the noise to two parts in a hundred."""
    some = slice(None, None, 2)
    spreads = [1.4826 * float(np.median(np.abs(image[some, some] - background[some, some]))) for image in images]
    return max(min(spreads), 0.3 * step_grey)


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


def without_rims(image: NDArray[np.float32], background: NDArray[np.float32], mask: Mask, lit: Mask) -> Mask:
    """The part of `mask` that is bulky and no shadow, where `lit` is what `without_shadow` leaves of it.

    Near the die and near its own border a shadow is no constant share of the background within a window. A thin ring of
    it is left, and joined to the die makes a region half as large again with its middle elsewhere.
    """
    shadow = cv2.morphologyEx((mask & ~lit).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RIM_PX + 1, 2 * RIM_PX + 1))
    rest = mask & ~(cv2.dilate(shadow, reach).astype(bool) & (image < background))
    filled = cv2.morphologyEx(rest.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    thin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (THIN_PX, THIN_PX))
    return np.asarray(cv2.morphologyEx(filled, cv2.MORPH_OPEN, thin).astype(bool))


def largest_blob(mask: Mask, holes_px: int = 7) -> Blob | None:
    """The largest connected region of at least 60 pixels, small holes and specks smoothed away; None if there is
    none."""
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, np.ones((holes_px, holes_px), np.uint8))
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
