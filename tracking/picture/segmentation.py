"""Segmentation of a frame against the background: what differs, what of it is only shadow, and the noise of what does
not.

A shadow is the background in a darker light: in a small window the image is a constant share of the background, texture
included. Near the die and near its own border that does not hold, and a rim of the shadow remains.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from .edge_stretch import NORMAL_MAD

Mask = NDArray[np.bool_]

Image = NDArray[np.float32]

NEAR_BORDER_PX = 3
"""A region that ends so near to the border may go on beyond it: neighbourhoods are cut off there, and specks are
smoothed away."""
DITHERED = 0.5
"""Noise, in steps between grey levels, above which rounding errors of pixels are independent: their mean is off by no
more than exp(-2π²/4)/π of a step then, a four hundredth."""
ROUNDING_SHARE = 0.3
"""Standard deviation of rounding, in steps: 1/√12."""

MEAN_PX = 3
"""Side of the square whose mean is compared with the background."""
DIFFERENT_SIGMAS = 5.0
"""Difference of that mean from the background, in standard errors, from which a pixel differs."""
DIFFERENT_GREY = 2.0
"""Least such difference in grey levels: the light of a still scene drifts by less."""
RING_PX = 6, 30
"""Distances from a region between which pixels show the noise about the die."""
ROUGH_PX = 7
"""Width below which differences from the background are rough, and no shadow."""
LEAST_RING_PX = 200
"""Fewest pixels that show it."""
NOISIER = 1.25
"""Ratio of this noise to that of the still background from which it counts: it is larger on 3 of 40 random clips, most of which
have noise of one size everywhere."""
LEAST_DIFFERENCE_GREY = 0.1
"""Least difference whose logarithm is taken."""
SHADOW_WINDOW_PX = 9
"""Side of the window in which a shadow is a constant share of the background."""
SHADOW_SHARE = 0.97
"""Share of the background's light that a shadow leaves, at the most."""
SHADOW_NOISE = 2.0
"""Residual noise of a shadow, in the noise of the background, at the most."""
SHADOW_TEXTURE = 0.1
"""Part of the variance of the background's texture that a shadow may leave unexplained."""
LEAST_SQUARED_GREY = 1.0
"""Mean square of a background below which a share of it is undefined."""

RIM_PX = 6
"""Reach of a shadow's rim beyond a sure shadow: half the window of its share of light, and the penumbra."""
THIN_PX = 11
"""Width below which the rest of a rim, and light that the die throws on the table, is removed."""
SMOOTHED_PX = 3
"""Width below which specks and gaps of a mask are removed."""
LEAST_BLOB_PX = 60
"""Area below which a region is no die."""


@dataclass(frozen=True, eq=False)
class Blob:
    """One connected region that differs from the background."""

    centre_px: NDArray[np.float64]
    """(2,) x, y."""
    area_px: float
    box: tuple[int, int, int, int]
    """x0, y0, x1, y1; end exclusive."""
    touches_border: bool


def level_step(images: list[Image]) -> float:
    """Step [grey] between the levels that some frames (height, width) use: the smallest gap between two levels, 1 if
    there is only one level. It is 1 for a file that uses all its levels; 12 bits in the upper part of 16 give 16."""
    step_grey = np.inf
    for image in images:
        gaps = np.diff(np.unique(image[::2, ::2]))
        step_grey = min(step_grey, float(gaps.min(initial=np.inf)))
        if step_grey <= 1.0:
            break
    return step_grey if np.isfinite(step_grey) else 1.0


def rounding_is_correlated(step_grey: float, noise_grey: float) -> bool:
    """Whether rounding to such steps has the same error on pixels of one grey. Steps of 1 are covered by the least
    noise that edges are given."""
    return step_grey > 1.0 and noise_grey < DITHERED * step_grey


@dataclass(frozen=True)
class PixelNoise:
    """The errors of pixels of the still background."""

    noise_grey: float
    """Standard deviation between frames."""
    rounding_grey: float = 0.0
    """Step between the grey levels of the clip if rounding errors of pixels of one grey are the same; 0 otherwise."""
    level_grey: float = 1.0
    """Unit of thresholds in grey levels, for pictures mapped to light: the step of the file's levels, on average."""


def pixel_noise(images: list[Image], background: Image, level_grey: float = 1.0) -> PixelNoise:
    """`background_noise` for the levels that the frames use, or `noise_beside_die` where that is larger, and the step
    between these levels if rounding errors are correlated. In pictures mapped to light the steps differ, and the average one,
    `level_grey`, counts."""
    if level_grey != 1.0:
        return PixelNoise(background_noise(images, background, level_grey), 0.0, level_grey)
    step_grey = level_step(images)
    noise_grey = background_noise(images, background, step_grey)
    beside = [noise_beside_die(image, background, noise_grey) for image in images]
    beside_grey = float(np.median([noise for noise in beside if noise > 0.0] or [0.0]))
    if beside_grey > NOISIER * noise_grey:
        noise_grey = beside_grey
    return PixelNoise(noise_grey, step_grey if rounding_is_correlated(step_grey, noise_grey) else 0.0)


def background_noise(images: list[Image], background: Image, step_grey: float = 1.0) -> float:
    """Standard deviation [grey] of a still pixel about the background, rounding to `step_grey` included.

    It is the smallest over the frames of the median absolute difference, because a die or its shadow only adds to it.
    Differences between rounded values are whole steps, and so is their median: it is interpolated, as for a normal law,
    between the shares of differences that lie within half a step less and half a step more. One pixel in four is used:
    100 × 100 of them determine the noise to 2 %.
    """
    some = slice(None, None, 2)
    medians = [_interpolated_median(np.abs(image[some, some] - background[some, some]), step_grey) for image in images]
    return float(np.hypot(NORMAL_MAD * min(medians), ROUNDING_SHARE * step_grey))


def _interpolated_median(sizes: Image, step: float) -> float:
    """Median of sizes rounded to a step, as if they were not and followed a normal law (`background_noise`)."""
    size = sizes[~np.isnan(sizes)]  # the background of some pixels may be unknown
    median = float(np.quantile(size, 0.5, method="lower"))
    above = (np.ceil(median / step - 0.5) + 0.5) * step
    below = max(above - step, 0.0)
    share_below = np.mean(size <= below) if below > 0.0 else 0.0
    score_below, score_above = ndtri(0.5 + 0.5 * np.array([share_below, np.mean(size <= above)]))
    return below + (above - below) * float((1.0 / NORMAL_MAD - score_below) / (score_above - score_below))


def noise_beside_die(image: Image, background: Image, noise_grey: float) -> float:
    """Standard deviation [grey] of pixels in a ring about the largest region that differs from the background, without what is
    smooth, such as a shadow; 0 if there is none. A codec repeats a still background without any noise, and leaves its errors
    about what moves."""
    mask = differs_from_background(image, background, noise_grey)
    box = _about(mask, SMOOTHED_PX)
    opened = cv2.morphologyEx(mask[box].astype(np.uint8), cv2.MORPH_OPEN, np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8))
    count, parts, stats, _ = cv2.connectedComponentsWithStats(opened)
    if count < 2:
        return 0.0
    whole = np.zeros(mask.shape, bool)
    whole[box] = parts == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    box = _about(whole, max(RING_PX) + ROUGH_PX)
    region = whole[box].astype(np.uint8)
    near, far = (
        cv2.dilate(region, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)))
        for reach in RING_PX
    )
    difference = image[box] - background[box]
    rough = np.abs(difference - cv2.blur(difference, (ROUGH_PX, ROUGH_PX)))[(far > 0) & (near == 0)]
    return NORMAL_MAD * float(np.median(rough)) if len(rough) >= LEAST_RING_PX else 0.0


def _about(mask: Mask, margin_px: int) -> tuple[slice, slice]:
    """The rows and columns of a picture that show all of a mask with a margin: most of a picture is background, and need not be
    looked through for regions."""
    x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
    x0, y0 = max(x - margin_px, 0), max(y - margin_px, 0)
    return np.s_[y0 : y + h + margin_px, x0 : x + w + margin_px]


def differs_from_background(image: Image, background: Image, noise_grey: float, level_grey: float = 1.0) -> Mask:
    """Mask of the pixels whose 3 × 3 mean differs from the background by more than DIFFERENT_SIGMAS and
    DIFFERENT_GREY levels of `level_grey`."""
    mean = cv2.blur(image - background, (MEAN_PX, MEAN_PX))
    return np.asarray(np.abs(mean) > max(DIFFERENT_SIGMAS * noise_grey / MEAN_PX, DIFFERENT_GREY * level_grey))


def differs_clearly(image: Image, background: Image, mask: Mask) -> Mask:
    """The part of `mask` that differs clearly: above the threshold that divides the logarithms of its differences into two
    classes (Otsu, IEEE Trans. Syst. Man Cybern. 9, 62, 1979). A codec leaves traces about a die that moves, and a lamp of some
    width a shadow without a border; both differ far less than the die."""
    if not mask.any():
        return mask
    difference = np.nan_to_num(np.abs(cv2.blur(image - background, (MEAN_PX, MEAN_PX))))
    size = np.log(np.maximum(difference, LEAST_DIFFERENCE_GREY))
    low, high = float(size[mask].min()), float(size[mask].max())
    levels = np.asarray(255.0 * (size - low) / max(high - low, 1e-9)).clip(0.0, 255.0).astype(np.uint8)
    threshold, _ = cv2.threshold(levels[mask], 0, 255, cv2.THRESH_OTSU)
    return np.asarray(mask & (levels > threshold))


def without_shadow(image: Image, background: Image, noise_grey: float, mask: Mask) -> Mask:
    """`mask` without the pixels that look like the background in a darker light."""
    window = (SHADOW_WINDOW_PX, SHADOW_WINDOW_PX)
    bb = cv2.blur(background * background, window)
    share = cv2.blur(image * background, window) / np.maximum(bb, LEAST_SQUARED_GREY)
    left = cv2.blur(image * image, window) - share * share * bb
    texture = cv2.blur(background * background, window) - cv2.blur(background, window) ** 2
    same = left < SHADOW_NOISE**2 * noise_grey**2 + SHADOW_TEXTURE * share * share * texture
    shadow = (share < SHADOW_SHARE) & same & (image < background + noise_grey)
    return mask & ~shadow


def without_rims(image: Image, background: Image, mask: Mask, lit: Mask) -> Mask:
    """The part of `mask` that is bulky and no shadow; `lit` is what `without_shadow` leaves of it.

    The rim of a shadow, joined to the die, would make a region half as large again with another centre.
    """
    shadow = cv2.morphologyEx(
        (mask & ~lit).astype(np.uint8), cv2.MORPH_OPEN, np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8)
    )
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RIM_PX + 1, 2 * RIM_PX + 1))
    rest = mask & ~(cv2.dilate(shadow, reach).astype(bool) & (image < background))
    filled = cv2.morphologyEx(rest.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8))
    thin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (THIN_PX, THIN_PX))
    return np.asarray(cv2.morphologyEx(filled, cv2.MORPH_OPEN, thin).astype(bool))


def largest_blob(mask: Mask, holes_px: int = 7) -> Blob | None:
    """The largest connected region of at least LEAST_BLOB_PX, holes and specks smoothed away; None if there is none."""
    part = _about(mask, SMOOTHED_PX + holes_px)
    y0, x0 = part[0].start, part[1].start
    clean = cv2.morphologyEx(mask[part].astype(np.uint8), cv2.MORPH_OPEN, np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8))
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, np.ones((holes_px, holes_px), np.uint8))
    count, _, stats, centres = cv2.connectedComponentsWithStats(clean)
    if count < 2:
        return None
    k = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    x, y, w, h, area = (int(v) for v in stats[k] + [x0, y0, 0, 0, 0])
    if area < LEAST_BLOB_PX:
        return None
    border = min(x, y) <= NEAR_BORDER_PX
    border = border or x + w >= mask.shape[1] - NEAR_BORDER_PX or y + h >= mask.shape[0] - NEAR_BORDER_PX
    return Blob(np.asarray(centres[k] + [x0, y0], float), float(area), (x, y, x + w, y + h), border)
