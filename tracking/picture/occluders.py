"""What stands before the die: a rod or a frame, found while the die passes behind it.

An occluder is part of the background, and its borders look like contours of the die. If a confirmed pose puts the die
before pixels that show the background and never change, the background becomes NaN there. Every pixel line that touches
it is left out: the pose is then as unsure as the rest of the picture makes it, and the motion carries it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import inner_no_memory
from ..placed_die import FrameWindows, PictureModel, PoseState, Workspace, outline_hull, place_die, within_hull

OCCLUDED_SHARE = 0.04
"""Share of the die's pixels that show nothing but the background from which occluders are looked for."""
HALF_WIDTH_PX = 2
"""Half the width of the square of pixels that must show no die at all."""
UNCHANGED_RMS_SIGMAS = 1.2
"""Root mean square difference of such a square from the background, in its noise, at the most."""
CHANGED_SIGMAS = 4.0
"""Difference from the background, in its noise, that no pixel of a still occluder ever reaches."""


class OccluderMask(NamedTuple):
    """What is known of occluders, filled in place."""

    still: Any
    """(cameras, height, width) float32, the background without gaps."""
    changed: Any
    """(cameras, height, width) uint8, 1 if some picture differed from the background."""
    occluded: Any
    """(cameras, height, width) uint8, 1 if the die was there and was not seen, and nothing ever changed."""
    count: Any
    """(1,) number of occluded pixels."""


def new_occluder_mask(backgrounds: NDArray[np.float32]) -> OccluderMask:
    """A mask without occluders, for backgrounds (cameras, height, width)."""
    shape = backgrounds.shape
    return OccluderMask(backgrounds, np.zeros(shape, np.uint8), np.zeros(shape, np.uint8), np.zeros(1, np.int64))


@inner_no_memory
def update_occluder_mask(
    windows: FrameWindows, model: PictureModel, mask: OccluderMask, pose: PoseState, work: Workspace
) -> None:
    """Update the mask, and the backgrounds of the model, from one frame with a known pose.

    A pixel well inside the outline is occluded if its neighbourhood shows the background alone, in this frame and in
    all later ones: something that changes later was no occluder, but a face as grey as the table. The backgrounds
    become NaN there and HALF_WIDTH_PX beyond the whole neighbourhood, because a blurred border belongs to neither side.
    """
    rig, shape, backgrounds, noise = model.rig, model.shape, model.backgrounds, model.settings.noise_grey
    far = 2 * HALF_WIDTH_PX
    for view in range(rig.camera.shape[0]):
        c = rig.camera[view]
        mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
        if mirrored or windows.size[c, 0] == 0 or not place_die(shape, rig, view, pose, work):
            continue
        count = outline_hull(shape, work)
        x0, y0 = windows.corner[c, 0], windows.corner[c, 1]
        width, height = windows.size[c, 0], windows.size[c, 1]
        still, image = mask.still[c], windows.pixels[c]
        fresh = np.int64(0)
        for i in range(height):
            for j in range(width):
                if abs(image[i, j] - still[y0 + i, x0 + j]) > CHANGED_SIGMAS * noise:
                    mask.changed[c, y0 + i, x0 + j] = 1
                    if mask.occluded[c, y0 + i, x0 + j] == 1:
                        mask.occluded[c, y0 + i, x0 + j] = 0
                        mask.count[0] -= 1
                        fresh += 1
        for i in range(HALF_WIDTH_PX, height - HALF_WIDTH_PX):
            for j in range(HALF_WIDTH_PX, width - HALF_WIDTH_PX):
                x, y = x0 + j, y0 + i
                if mask.occluded[c, y, x] == 1 or not within_hull(
                    work.hull, count, float(x), float(y), -float(HALF_WIDTH_PX)
                ):
                    continue
                total, steady = 0.0, True
                for a in range(-HALF_WIDTH_PX, HALF_WIDTH_PX + 1):
                    for b in range(-HALF_WIDTH_PX, HALF_WIDTH_PX + 1):
                        steady = steady and mask.changed[c, y + a, x + b] == 0
                        total += (image[i + a, j + b] - still[y + a, x + b]) ** 2
                    if not steady:
                        break
                if steady and total < (UNCHANGED_RMS_SIGMAS * noise * (2 * HALF_WIDTH_PX + 1)) ** 2:
                    mask.occluded[c, y, x] = 1
                    mask.count[0] += 1
                    fresh += 1
        if fresh == 0:
            continue
        low_y, high_y = max(y0 - far, 0), min(y0 + height + far, still.shape[0])
        low_x, high_x = max(x0 - far, 0), min(x0 + width + far, still.shape[1])
        for y in range(low_y, high_y):
            for x in range(low_x, high_x):
                backgrounds[c, y, x] = still[y, x]
        for y in range(max(low_y - far, 0), min(high_y + far, still.shape[0])):
            for x in range(max(low_x - far, 0), min(high_x + far, still.shape[1])):
                if mask.occluded[c, y, x] == 1:
                    for a in range(max(y - far, 0), min(y + far + 1, still.shape[0])):
                        for b in range(max(x - far, 0), min(x + far + 1, still.shape[1])):
                            backgrounds[c, a, b] = np.nan
