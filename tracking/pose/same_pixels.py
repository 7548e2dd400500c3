"""Poses of one picture, compared on the same pixels.

The region cost of a pose is the mean over the pixels about its own outline. A pose that leaves out a part of the die has another
region, and its cost another mean: that of a cube whose bright face is drawn as one seen straight on, without the dark one beside
it, holds less of the shadow. On the region of all poses together it lacks the dark face."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..picture import PIXELS, ROBUST_COST, Image, View, edges_cost
from .candidate_poses import JUDGED_PIXELS, region_costs_on
from .clip_poses import ClipPoses
from .refine_kernels import REGION_MARGIN_PX

Array = NDArray[np.float64]


def excess_on_same_pixels(view: View, image: Image, poses: Sequence[ClipPoses], row: int) -> Array:
    """(n,) what the cost of each of some poses of one picture (height, width) is higher by if its region is that of all.

    0 where the cost is no mean over a region: of a die whose whole surface is compared. So it is for several cameras, which leave
    no such poses."""
    excess = np.zeros(len(poses))
    positions = np.array([one.position_m[row] for one in poses])
    rotations = np.array([one.rotation[row] for one in poses])
    if len(poses) < 2 or len(view.cameras) > 1 or any(view.shows_surface(position) for position in positions):
        return excess
    corners = np.einsum("nij,vj->nvi", rotations, view.die.solid.vertices) + positions[:, None]
    px = view.camera.project(corners).reshape(-1, 2)
    low = np.maximum(np.floor(np.nanmin(px, axis=0) - REGION_MARGIN_PX), 0.0).astype(int)
    size = np.array([view.camera.width_px, view.camera.height_px])
    high = np.minimum(np.ceil(np.nanmax(px, axis=0) + REGION_MARGIN_PX) + 1, size).astype(int)
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    common, _ = region_costs_on(view, image, box, positions, rotations, JUDGED_PIXELS)
    return np.asarray(common - np.array([_own_region_cost(one, row) for one in poses]))


def _own_region_cost(poses: ClipPoses, row: int) -> float:
    """The region cost in the cost of a pose, as in `pose_cost`."""
    statistics = poses.statistics[row]
    unexplained = statistics[ROBUST_COST] / max(statistics[PIXELS], 1.0)
    return float(poses.cost[row] - edges_cost(poses.clear_share[row], unexplained))
