"""Boxes of an image: the parts that are rendered again, and blending them into the image without a seam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...tracking.camera import Camera

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]
"""Left, top, right, bottom [px]; the last two are exclusive."""

BOX_STEP_PX = 32
"""Sizes of boxes are multiples of this, because Mitsuba's compiled variants take 0.3 s for every new size."""
FEATHER_PX = 8
"""Width over which a box is blended into the empty table: at its border, the die changes less than a grey level."""
BOX_MARGIN_PX = FEATHER_PX + 4
"""Margin of a box around its points."""


def box_about(points_px: Array, camera: Camera) -> Box | None:
    """The box around points with BOX_MARGIN_PX, within the image; None if it is empty."""
    points_px = points_px[np.isfinite(points_px).all(1)]
    if not len(points_px):
        return None
    left, top = np.maximum(np.floor(points_px.min(0)).astype(int) - BOX_MARGIN_PX, 0)
    right, bottom = np.minimum(
        np.ceil(points_px.max(0)).astype(int) + BOX_MARGIN_PX + 1, [camera.width_px, camera.height_px]
    )
    return (int(left), int(top), int(right), int(bottom)) if right > left and bottom > top else None


def merged(boxes: list[Box]) -> list[Box]:
    """The boxes, with overlapping ones replaced by the box around both, because blending twice would be wrong."""
    done: list[Box] = []
    for box in boxes:
        for other in list(done):
            if box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]:
                done.remove(other)
                box = (min(box[0], other[0]), min(box[1], other[1]), max(box[2], other[2]), max(box[3], other[3]))
        done.append(box)
    return done if len(done) < 2 or not _overlap(done) else merged(done)


def _overlap(boxes: list[Box]) -> bool:
    return any(
        a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for k, a in enumerate(boxes) for b in boxes[:k]
    )


def rounded_up(box: Box, camera: Camera, step_px: int) -> Box:
    """The box enlarged to a multiple of `step_px` each way, within the image."""
    sides = []
    for low, high, most in ((box[0], box[2], camera.width_px), (box[1], box[3], camera.height_px)):
        size = min(-(-(high - low) // step_px) * step_px, most)
        begin = min(max(low - (size - (high - low)) // 2, 0), most - size)
        sides.append((begin, begin + size))
    return sides[0][0], sides[1][0], sides[0][1], sides[1][1]


def part_of(box: Box) -> tuple[slice, slice]:
    """Rows and columns of a box."""
    return slice(box[1], box[3]), slice(box[0], box[2])


def blend(image: Array, inside: Array, box: Box) -> None:
    """Blend a box into the image; its weight rises from its borders, except for borders of the image itself."""
    height, width = image.shape
    left, top, right, bottom = box
    x, y = np.arange(left, right), np.arange(top, bottom)
    ramps = []
    for at, low, high, end in ((x, left, right, width), (y, top, bottom, height)):
        near_low = (at - low + 1) / FEATHER_PX if low > 0 else np.ones(len(at))
        near_high = (high - at) / FEATHER_PX if high < end else np.ones(len(at))
        ramps.append(np.clip(np.minimum(near_low, near_high), 0.0, 1.0))
    weight = ramps[1][:, None] * ramps[0][None, :]
    part = image[part_of(box)]
    part += weight * (inside - part)
