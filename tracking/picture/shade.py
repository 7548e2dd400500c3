"""The shade of the background beside the contour: a level and a slope, as a soft shadow has, beside each piece of it.

The slopes have a stated deviation, which falls with the height above the table. The shade beside an edge is one of the
intensities of a stretch of it (`edge_stretch`).

**Beside a rounded die** level and slope are solved for by the pixels that show the background alone, and again, together with the
pose, by those of the contour: they are eliminated from the equations of a picture, each with what the pixels outside say of it.

At a distance d from the contour, beyond it, a pixel shows the background under the shade γ + s a, where a is the mean distance of
what it sees of the background: d far away, and 0.8 blurs on the contour. What a step of the pose changes of a is left out of the
derivatives, a hundredth of them.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_no_memory, inner_nogil
from ..placed_die import NOTHING, PictureModel, SurfaceGrid, depth_of, reach_of_die

OUTSIDE_SHARE = 0.02
"""Share of the die in a pixel below which it shows the background alone."""
SHADE_DEVIATION = 0.15
"""Standard deviation of the shade of the background beside the die: soft shadows."""
MARK_SIGMAS = 3.0
"""Distance of a pixel from what is expected, in standard deviations, at which it has half a weight: a mark, a hard shadow."""
SHADOW_SHARE = 0.05
"""Share of the background that is added to this distance."""
LEAST_NOISE_GREY = 0.5
"""Least noise that these weights assume."""
REWEIGHTINGS = 5
"""Iterations of these weights."""
LEAST_PIVOT = 1e-12
"""Part of its diagonal that a pivot of the two keeps at the least."""
_MIDDLE_BLURS = 1.6
"""Twice the mean distance, in blurs, of what a pixel on the contour sees of the background: √(2/π) = 0.8."""


@inner_no_memory
def shade_slope(model: PictureModel, view: int, pos: Any, height: float) -> float:
    """Standard deviation of the slope [1/px] of the shade on the background beside a contour at some height above the table: the
    farther the table lies behind, the softer is what the die throws on it."""
    rig, reach = model.rig, reach_of_die(model.shape)
    metre_px = rig.matrix[view, 0, 0] / depth_of(rig, view, pos)
    return model.settings.shade_change * reach / ((reach + max(height, 0.0)) ** 2 * metre_px)


# --- Beside an edge ---


@inner_no_memory
def error_of_step_by_slope(A: Any, base: float, coupled: Any, square: float) -> float:
    """The standard error of the step from the near side of a sharp edge to the far one, over what it is with a known slope.

    `A` is the normal matrix of the two intensities with the slope eliminated (lower half), `coupled` its coupling to them, and
    `square` the normal equation of the slope."""
    near, both, far = A[0, 0], A[1, 0], A[1, 1]
    det, q0, q1 = near * far - both * both, coupled[0], coupled[1]
    variance = (far + 2.0 * base * both + base * base * near) / det
    by_slope = (base * (near * q1 - both * q0) - (far * q0 - both * q1)) / det
    of_slope = square + (far * q0 * q0 - 2.0 * both * q0 * q1 + near * q1 * q1) / det
    return sqrt(variance / max(variance - by_slope * by_slope / of_slope, LEAST_PIVOT * variance))


# --- Beside a rounded die ---


@inner_no_memory
def distance_seen_px(distance_px: float, blur_px: float) -> float:
    """Mean distance from the contour of what a pixel at some distance sees of the background."""
    return 0.5 * (distance_px + sqrt(distance_px * distance_px + (_MIDDLE_BLURS * blur_px) ** 2))


@inner_no_memory
def shade_at(grid: SurfaceGrid, shades: Any, i: int, j: int, blur_px: float) -> float:
    """Shade of the background at a pixel, with the level and the slope beside each piece of the contour (pieces, 2)."""
    k = grid.side[i, j]
    return float(shades[k, 0] + shades[k, 1] * distance_seen_px(grid.beyond[i, j, 0], blur_px))


@inner_nogil
def solve_shades(image: Any, background: Any, corner: Any, grid: SurfaceGrid, of_clip: Any, shades: Any) -> Any:
    """Solve for the shades (pieces, 2), with Cauchy's weights; return the information about them (pieces, 3): that of the level,
    of both, and of the slope [px²]. `of_clip` is the noise of the clip [grey], the blur [px], and the standard deviation of the
    slope [1/px]."""
    (wx, wy), (noise_grey, blur_px, deviation) = corner, of_clip
    noise2 = max(noise_grey, LEAST_NOISE_GREY) ** 2
    square, seen, v = np.zeros((len(shades), 3)), np.zeros((len(shades), 2)), noise2
    for _ in range(REWEIGHTINGS):
        square[:] = 0.0
        seen[:] = 0.0
        squares, weights = 0.0, 0.0
        for i in range(grid.part.shape[0]):
            for j in range(grid.part.shape[1]):
                k = grid.side[i, j]
                if k == NOTHING or not grid.share[i, j] < OUTSIDE_SHARE:
                    continue
                value, under = image[grid.y0 + i - wy, grid.x0 + j - wx], background[grid.y0 + i, grid.x0 + j]
                away = under * distance_seen_px(grid.beyond[i, j, 0], blur_px)
                e = value - shades[k, 0] * under - shades[k, 1] * away
                weight = 1.0 / (1.0 + e * e / (MARK_SIGMAS * MARK_SIGMAS * noise2 + (SHADOW_SHARE * under) ** 2))
                seen[k, 0] += weight * under * value
                seen[k, 1] += weight * away * value
                square[k, 0] += weight * under * under
                square[k, 1] += weight * under * away
                square[k, 2] += weight * away * away
                squares += weight * e * e
                weights += weight
        for k in range(len(shades)):
            square[k, 0] += v / SHADE_DEVIATION**2
            square[k, 2] += v / deviation**2
            a, b, c = square[k, 0], square[k, 1], square[k, 2]
            level = seen[k, 0] + v / SHADE_DEVIATION**2
            shades[k, 0] = (c * level - b * seen[k, 1]) / (a * c - b * b)
            shades[k, 1] = (seen[k, 1] - b * shades[k, 0]) / c
        v = max(noise2, squares / max(weights, 1.0))
    return square / v


@inner_no_memory
def eliminate_shades(of_shades: Any, of_parts: Any, shared: Any, right: Any) -> None:
    """Eliminate the shades from the equations of the parts of the surface (`of_parts`: normal matrix, coupling to the unknowns
    that all pixels share, and right side) and of the latter, `shared` (lower half) and `right`. `of_shades` is the information
    about them (pieces, 3), their coupling to the shared unknowns (pieces, 2, unknowns) and to the parts (pieces, 2, parts), and
    their right side (pieces, 2)."""
    information, by_shared, by_parts, left = of_shades
    tie, by, part_left = of_parts
    for k in range(len(left)):
        a, b, c = information[k]
        det = a * c - b * b
        if not det > LEAST_PIVOT * a * c:
            continue
        r0, r1 = (c * left[k, 0] - b * left[k, 1]) / det, (a * left[k, 1] - b * left[k, 0]) / det
        for p in range(len(part_left)):
            p0, p1 = by_parts[k, 0, p], by_parts[k, 1, p]
            if p0 == 0.0:
                continue
            part_left[p] -= p0 * r0 + p1 * r1
            s0, s1 = (c * p0 - b * p1) / det, (a * p1 - b * p0) / det
            for q in range(len(part_left)):
                tie[p, q] -= s0 * by_parts[k, 0, q] + s1 * by_parts[k, 1, q]
            for q in range(len(right)):
                by[p, q] -= s0 * by_shared[k, 0, q] + s1 * by_shared[k, 1, q]
        for p in range(len(right)):
            p0, p1 = by_shared[k, 0, p], by_shared[k, 1, p]
            right[p] -= p0 * r0 + p1 * r1
            s0, s1 = (c * p0 - b * p1) / det, (a * p1 - b * p0) / det
            for q in range(p + 1):
                shared[p, q] -= s0 * by_shared[k, 0, q] + s1 * by_shared[k, 1, q]
