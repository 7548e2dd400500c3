"""Windows of a picture: where to render anew, and how to lay the new over the old without a seam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...tracking.camera import Camera

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]
"""Of the picture: left, top, right, bottom, the last two exclusive."""

FEATHER_PX = 8
"""Over which a window goes over into the empty table: where it ends, the die's influence is below a grey level."""


def box_about(points_px: Array, camera: Camera) -> Box | None:
    """The box (left, top, right, bottom) about points, with the feather, within the picture."""
    points_px = points_px[np.isfinite(points_px).all(1)]
    if not len(points_px):
        return None
    margin = FEATHER_PX + 4
    left, top = np.maximum(np.floor(points_px.min(0)).astype(int) - margin, 0)
    right, bottom = np.minimum(np.ceil(points_px.max(0)).astype(int) + margin + 1, [camera.width_px, camera.height_px])
    return (int(left), int(top), int(right), int(bottom)) if right > left and bottom > top else None


def merged(boxes: list[Box]) -> list[Box]:
    """The boxes, those that overlap replaced by the one about both: a blended window must not be blended over."""
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
    """The box widened to a multiple of `step_px` each way, as far as the picture goes."""
    sides = []
    for low, high, most in ((box[0], box[2], camera.width_px), (box[1], box[3], camera.height_px)):
        size = min(-(-(high - low) // step_px) * step_px, most)
        begin = min(max(low - (size - (high - low)) // 2, 0), most - size)
        sides.append((begin, begin + size))
    return sides[0][0], sides[1][0], sides[0][1], sides[1][1]


def part_of(box: Box) -> tuple[slice, slice]:
    return slice(box[1], box[3]), slice(box[0], box[2])


def blend(picture: Array, window: Array, box: Box) -> None:
    """Lay a window over the picture; its weight rises from its borders, but for those that are the picture's own."""
    height, width = picture.shape
    left, top, right, bottom = box
    x, y = np.arange(left, right), np.arange(top, bottom)
    ramps = []
    for at, low, high, end in ((x, left, right, width), (y, top, bottom, height)):
        near_low = (at - low + 1) / FEATHER_PX if low > 0 else np.ones(len(at))
        near_high = (high - at) / FEATHER_PX if high < end else np.ones(len(at))
        ramps.append(np.clip(np.minimum(near_low, near_high), 0.0, 1.0))
    weight = ramps[1][:, None] * ramps[0][None, :]
    part = picture[part_of(box)]
    part += weight * (window - part)
