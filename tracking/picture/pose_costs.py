"""Costs of a pose: how badly the drawn die explains a picture. Lower is better.

| cost | of | measures |
| --- | --- | --- |
| `region_costs` | many poses, one box of the first camera | faces of one grey, outside the background or a shade of it |
| `mirror_region_costs` | these before a mirror, to be added | dark pixels that neither die nor reflection covers |
| `region_cost` (kernel) | one pose, all cameras | as `region_costs`, on the pose's own box |
| `pose_cost` (kernel), `Pose.cost` | one refined pose | `region_cost`, and what the edges lack: clear steps, explained pixels |
| `Pose.cost` of a whole surface (`surface_equations`) | one refined pose | every pixel against the drawn one; clear steps |
| `costs_with_edge_noise` | refined poses | `pose_cost`, and the mean logarithm of the noise [grey] that edges leave |

The unit is one truncated squared sigma per pixel. A clip's corner radius has a cost of its own, the robust likelihood
of the edges alone (`tracking.clip_parameters.corner_radius`).

The costs compare poses on one frame. They are no likelihoods of one model: the region cost treats neighbouring pixels
as independent and leaves the shading of faces to a share of their grey. Faces of nearly one grey cost a picture little
wherever their edge lies; the residual noise at that edge distinguishes such poses.

**Mirrors.** A diffuse table may hold a shadow, so that a region darker than the background is no evidence against a
pose that leaves it uncovered: `region_costs` truncates such pixels early. A mirror sends the light of the lamp away
from the camera and shows no shadow. There the dark faces of a die before a dark reflected room belong to the die. A
pose that leaves them out, as that of a smaller square farther away that covers the one bright face, does not explain
the picture.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..placed_die import CLEAR_PX, CONTOUR_PX, EXPECTED_CLEAR_PX, LOG_NOISE, PIXELS
from .region_cost import (
    SHADOW_SQUARED_SIGMAS_CUT,
    SQUARED_SIGMAS_CUT,
    SUPPORT_COST,
    UNEXPLAINED_COST,
    region_costs_in_box,
)
from .view import MIRRORED, Array, Image, View

Box = tuple[int, int, int, int]

SUBPIXEL_BITS = 4
"""Fractional binary digits of the outlines that are filled."""
LEAST_PX = 1e-9
"""Length of contour that counts as none."""
FAR_PX = 1e4
"""A corner farther away than this is out of every picture."""


def region_costs(
    view: View, image: Image, box: Box, positions_m: Array, rotations: Array, samples: int
) -> tuple[Array, Array]:
    """(n,) region costs of many poses (n, 3), (n, 3, 3) on a window `box` (x0, y0, x1, y1; end exclusive) of the first
    camera's picture (height, width), over about `samples` pixels; and (n,) the shares of their pixels that differ from
    the background."""
    costs, differs = np.empty(len(positions_m)), np.empty(len(positions_m))
    region_costs_in_box(
        np.ascontiguousarray(image, np.float32), view.model(view.settings._replace(region_pixels=samples)), box,
        np.ascontiguousarray(positions_m, float), np.ascontiguousarray(rotations, float), costs, differs,
    )  # fmt: skip
    return costs, differs


def edges_cost(clear_share: float, unexplained: float) -> float:
    """What `pose_cost` adds to a region cost: for a contour of which only a share shows a clear step, and for the mean robust
    cost of the edges' pixels."""
    return SUPPORT_COST * (1.0 - clear_share) + UNEXPLAINED_COST * unexplained


def costs_with_edge_noise(cost: Array, statistics: Array) -> Array:
    """(n,) pose costs (n,) and the mean logarithm of the noise [grey] that the edges leave, from the statistics (n,
    STATISTICS)."""
    return np.asarray(cost + statistics[:, LOG_NOISE] / np.maximum(statistics[:, PIXELS], 1.0))


def clear_shares(statistics: Array) -> Array:
    """(...) share of the visible contour that shows a clear step, from statistics (..., STATISTICS); 0 without a contour."""
    return np.asarray(statistics[..., CLEAR_PX] / np.maximum(statistics[..., CONTOUR_PX], LEAST_PX))


def supports(statistics: Array) -> Array:
    """(...) length of the contour that shows a clear step, over that which does in the mean if the pose is right."""
    return np.asarray(statistics[..., CLEAR_PX] / np.maximum(statistics[..., EXPECTED_CLEAR_PX], LEAST_PX))


def mirror_region_costs(
    view: View, image: Image, box: Box, positions_m: Array, rotations: Array, samples: int
) -> Array:
    """(n,) what `region_costs` on the same box lack before a mirror: pixels darker than the background that neither the
    die nor its reflection covers are no shadow, and are truncated as late as others."""
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
        _outlines(view, positions_m @ MIRRORED, MIRRORED @ rotations, box, stride),
    )
    covered, explained = np.empty(lacking.shape, np.float32), np.empty(len(positions_m))
    for k, outlines in enumerate(zip(*both, strict=True)):
        covered[:] = 0.0
        for outline in outlines:
            cv2.fillConvexPoly(covered, cv2.convexHull(outline), 1.0, cv2.LINE_8, SUBPIXEL_BITS)
        explained[k] = lacking.ravel() @ covered.ravel()
    return np.asarray((lacking.sum() - explained) / lacking.size, np.float64)


def _outlines(view: View, positions_m: Array, rotations: Array, box: Box, stride: int) -> NDArray[np.int32]:
    """(n, vertices, 2) the die's corners in units of `stride` pixels of the box, with SUBPIXEL_BITS fractional bits."""
    corners = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions_m[:, None]
    px = (view.camera.project(corners) - np.array(box[:2])) / stride
    return np.rint(np.clip(np.nan_to_num(px, nan=-FAR_PX), -FAR_PX, FAR_PX) * 2**SUBPIXEL_BITS).astype(np.int32)
