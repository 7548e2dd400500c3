"""What a mirror makes sure of: whatever differs from the empty scene is the die or its reflection.

A diffuse table may hold a shadow, so that a region that is darker than the background is no evidence against a pose that
leaves it uncovered: `region_costs` lets such pixels count little. A mirror sends light from the lamp away from the camera and
shows no shadow. There the dark faces of a die before a dark reflected room belong to the die; a pose that leaves them out, as
that of a smaller square further away which covers the one bright face, does not explain the picture.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .kernel_types import SHADOW_SQUARED_SIGMAS_CUT, SQUARED_SIGMAS_CUT
from .view import MIRRORED, View

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]

SUBPIXEL_BITS = 4
"""Binary digits behind the point of the outlines that are filled."""
FAR_PX = 1e4
"""Further away than this a corner is out of every picture."""


def reflects(view: View) -> bool:
    """Whether the table is a mirror."""
    return len(view.rig.weight) > len(view.cameras)


def mirror_region_costs(
    view: View, image: NDArray[np.float32], box: Box, positions_m: Array, rotations: Array, samples: int
) -> Array:
    """(n,) what the scores of `region_costs` on a window `box` of the first camera's picture lack on a mirror, in the same
    units: pixels darker than the background that neither the die nor its reflection covers are no shadow."""
    x0, y0, x1, y1 = box
    stride = max(1, int(np.sqrt((x1 - x0) * (y1 - y0) / samples)))
    rows, columns = slice(y0, y1, stride), slice(x0, x1, stride)
    difference = np.nan_to_num(image[rows, columns] - view.background[rows, columns])
    squared = np.where(difference < 0.0, (difference / view.noise_grey) ** 2, 0.0)
    lacking = np.asarray(
        np.minimum(squared, SQUARED_SIGMAS_CUT) - np.minimum(squared, SHADOW_SQUARED_SIGMAS_CUT), np.float32
    )
    both = (
        _outlines(view, positions_m, rotations, box, stride),
        _reflections(view, positions_m, rotations, box, stride),
    )
    covered, scores = np.empty(lacking.shape, np.float32), np.empty(len(positions_m))
    for k, outlines in enumerate(zip(*both, strict=True)):
        covered[:] = 0.0
        for outline in outlines:
            cv2.fillConvexPoly(covered, cv2.convexHull(outline), 1.0, cv2.LINE_8, SUBPIXEL_BITS)
        scores[k] = lacking.ravel() @ covered.ravel()
    return np.asarray((lacking.sum() - scores) / lacking.size, np.float64)


def _outlines(view: View, positions_m: Array, rotations: Array, box: Box, stride: int) -> NDArray[np.int32]:
    """(n, vertices, 2) the die's corners in units of `stride` pixels of the box, with SUBPIXEL_BITS behind the point."""
    corners = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    px = (view.camera.project(corners) - np.array(box[:2])) / stride
    return np.rint(np.clip(np.nan_to_num(px, nan=-FAR_PX), -FAR_PX, FAR_PX) * 2**SUBPIXEL_BITS).astype(np.int32)


def _reflections(view: View, positions_m: Array, rotations: Array, box: Box, stride: int) -> NDArray[np.int32]:
    """The same of the die in the mirror."""
    return _outlines(view, positions_m @ MIRRORED, MIRRORED @ rotations, box, stride)
