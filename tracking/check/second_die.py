"""Looks for a second die beside the tracked one.

One die is tracked. Another one that moves in view joins its region where the pictures of both touch, hides it, and may be tracked
in its place. On some tracked frames the outlines of the die and of its reflection in the table are taken out of what differs from
the background and is no shadow. What remains, whole inside the picture and about as large as the die, is another one.

A hand reaches in from the border and light that the die throws on the table falls apart into specks: neither counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat
from ..camera import Camera
from ..footage import Clip
from ..picture import (
    Image,
    PixelNoise,
    differs_from_background,
    largest_blob,
    outline_mask,
    pixel_noise,
    without_rims,
    without_shadow,
)
from ..track import Track

Array = NDArray[np.float64]

SEARCHED_FRAMES = 16
"""Most tracked frames that are searched."""
LEAST_FRAMES = 3
"""Fewest frames that show it: one wrong pose leaves the die itself beside its outline."""
LEAST_SHARE = 0.25
"""Share of the searched frames that show it: where the dice overlap, it is not seen."""
AREA_SHARES = (0.4, 2.5)
"""Least and largest area of another die, in areas of the tracked one: it may be half hidden, or nearer."""
BRIGHT_SHARE = 0.2
"""Share of the region that is brighter than the table, less than one face of a die. In films with little noise whole shadows
remain, which are darker throughout: on rendered films the share is 0.07 at most, and 0.4 or more for a die. A die darker than
the table is missed."""
MARGIN_PX = 8
"""Margin about the outlines: half the window that distinguishes shadows, and the blur of an edge."""


@dataclass(frozen=True)
class SecondDie:
    """Regions beside the tracked die that are as large as a die."""

    frames: int
    """Number of searched frames that show one."""
    searched: int

    @property
    def notice(self) -> str:
        """What was seen and what it does."""
        return (
            f"{self.frames} of {self.searched} searched frames show something of the size of a die beside the tracked one; a "
            "second die hides the tracked one or is taken for it: keep others out of view, or give the first pose by hand "
            "([start])."
        )


def find_second_die(
    clip: Clip, track: Track, camera: Camera, die: Die, background: Image, level_grey: float = 1.0
) -> SecondDie | None:
    """The second die that tracked frames of a clip show; None if too few show one.

    `background` (height, width) is a frame without dice, or an estimate; `level_grey` is as in `PixelNoise`."""
    rows = np.flatnonzero(track.tracked)
    if len(rows) < LEAST_FRAMES:
        return None
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(SEARCHED_FRAMES, len(rows))).astype(int))]
    pictures = [np.ascontiguousarray(clip.frame(int(k)), np.float32) for k in rows]
    noise = pixel_noise(pictures, background, level_grey)
    shown = 0
    for k, picture in zip(rows, pictures, strict=True):
        rotation = matrix_from_quat(track.quaternion[k])
        corners_m = die.solid.vertices @ rotation.T + track.position_m[k]
        shown += _shows_another(picture, background, noise, camera, corners_m)
    if shown < max(LEAST_FRAMES, LEAST_SHARE * len(rows)):
        return None
    return SecondDie(shown, len(rows))


def _shows_another(picture: Image, background: Image, noise: PixelNoise, camera: Camera, corners_m: Array) -> bool:
    """Whether a picture shows another die than that with these corners (n, 3)."""
    mask = differs_from_background(picture, background, noise.noise_grey, noise.level_grey)
    lit = without_shadow(picture, background, noise.noise_grey, mask)
    die = outline_mask(camera, corners_m)
    reflection = outline_mask(camera, corners_m * [1.0, 1.0, -1.0])
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1))
    covered = cv2.dilate((die | reflection).astype(np.uint8), reach).astype(bool)
    beside = without_rims(picture, background, mask, lit) & ~covered
    other = largest_blob(beside, holes_px=1)
    if other is None or other.touches_border:
        return False
    low, high = AREA_SHARES
    x0, y0, x1, y1 = other.box
    bright = np.count_nonzero((beside & (picture > background))[y0:y1, x0:x1])
    return bool(low * die.sum() <= other.area_px <= high * die.sum() and bright >= BRIGHT_SHARE * other.area_px)
