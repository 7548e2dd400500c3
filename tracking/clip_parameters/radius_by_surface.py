"""The corner radius that the whole surface of a die shows: every pixel is compared with the drawn one.

The picture of a rounded body (`placed_die`) is drawn with one radius after another, the pose of each frame being free, and
the costs of the poses are compared frame by frame. What a smaller radius draws beyond the corners, and a larger one leaves
out, no distance imitates: a tetrahedron of 100 pixels an edge whose corners are rounded by 5 pixels ends 10 pixels before
its corners. Edges alone, which `corner_radius` compares, tell radii of about a pixel; what a codec or the motion during the
exposure smears there looks like a bevel of several.

The first radius is FIRST_PX, or that which the blur gives to any corner: a drawn one is blurred across its edges alone. If
the next costs more, the die is hardly rounded. A coarse codec rounds corners as well: JPEG of quality 30 those of a sharp cube
by two pixels, of quality 15 by three.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..picture import THREADS, View, with_corner_radius
from ..pose import SampledFrames, pose_state, refine_pose, weak_prior
from .corner_radius import (
    FEWEST_FRAMES,
    FREE_SIGMA_PX,
    FREE_SIGMA_SHARE,
    SIGNIFICANT_SIGMAS,
    Array,
    CornerRadius,
    largest_radius_m,
    scale_px_per_m,
    winsorised_mean,
)

SURFACE_FRAMES = 10
"""Frames that are compared: of a rounded die each shows the corners."""
FIRST_PX = 1.02
"""First radius where the die is farthest."""
FIRST_BLURS = 1.8
"""The same in lens blurs: sharp cubes and tetrahedra of 1.2, 2.4 and 3.5 px of blur cost least with 1 to 2 blurs."""
SURFACE_RATIO = 1.4
"""Ratio of successive radii."""
QUICK_RATIO = 2.4
"""Ratio of the radius that is compared with the first where edges show no bevel: corners that are clearly rounded by more than
the first radius cost less with it, whatever theirs."""
LEAST_FALL_SHARE = 0.045
"""Least fall of the cost, as a share of it, from the first radius to the best of a die that is clearly rounded: where much is not
explained, by a codec or the light, a little less says nothing. JPEG of quality 60 comes to 0.04, and beyond 0.045 of a
dodecahedron with other noise."""
QUICK_FALL_SHARE = 0.02
"""The same from the first radius to QUICK_RATIO times it, from which that of more frames is worth its time."""
MOST_RISE_SIGMAS = 4.0
"""Standard errors above the least cost from which larger radii are not tried."""


@dataclass(frozen=True)
class SurfaceRadius:
    """The radius of the corners by the whole surface."""

    first_m: float
    """The least radius that was drawn."""
    best: CornerRadius
    """The radius of the least cost; `first_m` if the die is not rounded more."""
    most_m: float
    """The largest radius that costs no more, within SIGNIFICANT_SIGMAS."""
    is_rounded: bool
    """Whether the die is clearly rounded by more than the first radius."""

    @property
    def is_sharp(self) -> bool:
        """Whether the die is clearly not rounded by more than the first radius."""
        return not self.is_rounded and self.most_m <= self.first_m


def radius_by_surface(view: View, frames: SampledFrames) -> SurfaceRadius | None:
    """The radius of the least cost, the pose of each frame being free; None for fewer than FEWEST_FRAMES, before a mirror, and
    for a die so small that the first radius leaves a ball."""
    first_m, largest_m = _first_radius_m(view, frames), largest_radius_m(view.die)
    if len(frames) < FEWEST_FRAMES or view.mirror or first_m * SURFACE_RATIO > largest_m:
        return None
    radii: list[float] = []
    costs: list[Array] = []
    best, radius_m = 0, first_m
    while radius_m < largest_m:
        cost, frames = _costs(with_corner_radius(view, radius_m), frames)
        radii.append(radius_m)
        costs.append(cost)
        fall, sigma = winsorised_mean(costs[best] - cost)
        if fall > 0.0:
            best = len(radii) - 1
        elif fall < -(SIGNIFICANT_SIGMAS if best == 0 else MOST_RISE_SIGMAS) * sigma:
            break
        radius_m *= SURFACE_RATIO
    falls = np.array([winsorised_mean(costs[best] - cost) for cost in costs])
    allowed = np.flatnonzero(falls[:, 0] >= -SIGNIFICANT_SIGMAS * falls[:, 1])
    fall, sigma = winsorised_mean(costs[0] - costs[best])
    found_m = _vertex_m(np.array(radii), falls[:, 0], best)
    sigma_m = float(np.hypot(FREE_SIGMA_SHARE * found_m, FREE_SIGMA_PX / scale_px_per_m(view, frames)))
    return SurfaceRadius(
        first_m,
        CornerRadius(found_m, sigma_m),
        radii[int(allowed[-1])],
        best > 0
        and fall > max(LEAST_FALL_SHARE * float(np.nanmean(costs[0])), SIGNIFICANT_SIGMAS * sigma)
        and _falls_where_explained(costs[0], costs[best]),
    )


def _falls_where_explained(first: Array, best: Array) -> bool:
    """Whether the cost (n,) falls by LEAST_FALL_SHARE on the half of the frames that cost least, too. On the others something
    is seen that is not drawn, such as the shadow of a die near the table, and corners of several pixels leave some of it out."""
    known = np.isfinite(first) & np.isfinite(best)
    first, best = first[known], best[known]
    half = np.argsort(best, kind="stable")[: (len(best) + 1) // 2]
    return bool((first[half] - best[half]).sum() > LEAST_FALL_SHARE * first[half].sum())


def may_be_rounder(view: View, frames: SampledFrames) -> bool:
    """Whether a radius of QUICK_RATIO times the first costs less than that, by QUICK_FALL_SHARE, on FEWEST_FRAMES of the frames.

    Twelve pictures are drawn; `radius_by_surface`, which decides, draws twenty at the least. False where that gives none."""
    few, first_m = frames.sample(FEWEST_FRAMES), _first_radius_m(view, frames)
    if len(few) < FEWEST_FRAMES or view.mirror or QUICK_RATIO * first_m > largest_radius_m(view.die):
        return False
    before, few = _costs(with_corner_radius(view, first_m), few)
    fall, _ = winsorised_mean(before - _costs(with_corner_radius(view, QUICK_RATIO * first_m), few)[0])
    return fall > QUICK_FALL_SHARE * float(np.nanmean(before))


def surface_gain_over_sharp(
    view: View, radius_m: float, sharp: SampledFrames, rounded: SampledFrames
) -> tuple[float, float] | None:
    """Mean fall of the cost from the first radius to another, and its standard error, each from the poses of a track of its own,
    on the same pictures; None where `radius_by_surface` is, and for a radius not larger than the next to the first."""
    first_m = _first_radius_m(view, sharp)
    if len(sharp) < FEWEST_FRAMES or view.mirror or radius_m < SURFACE_RATIO * first_m:
        return None
    before, _ = _costs(with_corner_radius(view, first_m), sharp)
    return winsorised_mean(before - _costs(with_corner_radius(view, radius_m), rounded)[0])


def _first_radius_m(view: View, frames: SampledFrames) -> float:
    """The first radius [m]: every camera draws its bevels on all frames."""
    first_px = max(FIRST_PX, FIRST_BLURS * view.blur_px)
    m_per_px = (
        ((frames.position_m - camera.centre_m) @ camera.rotation[2]).max(initial=0.0) / camera.matrix[0, 0]
        for camera in view.cameras
    )
    return float(first_px * max(m_per_px))


def _costs(view: View, frames: SampledFrames) -> tuple[Array, SampledFrames]:
    """(n,) costs of the frames at refined poses with the radius of the view's die, and the frames at these poses."""

    def one(k: int) -> tuple[float, Array, Array]:
        motion = frames.motion[k]
        start = pose_state(frames.position_m[k], frames.rotation[k], motion[:3], motion[3:])
        pose = refine_pose(
            view, frames.pictures[k], start, coarse=0, prior=weak_prior(view, start.position), roughly=True
        )
        return pose.cost, pose.position_m, pose.rotation

    with ThreadPoolExecutor(THREADS) as pool:
        cost, position, rotation = zip(*pool.map(one, range(len(frames))), strict=True)
    return np.array(cost), replace(frames, position_m=np.array(position), rotation=np.array(rotation))


def _vertex_m(radii: Array, falls: Array, best: int) -> float:
    """The vertex of the parabola through the greatest of the falls and its neighbours, over the logarithm of the radius."""
    if not 0 < best < len(radii) - 1:
        return float(radii[best])
    before, at, after = falls[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    step = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(radii[best] * SURFACE_RATIO ** np.clip(step, -0.5, 0.5))
