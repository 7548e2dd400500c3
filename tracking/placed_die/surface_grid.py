"""The pixels of a drawn die, and their blur by lens, motion and pixel.

The die is drawn on a grid of half pixels (`surface_picture`). What it shows there is blurred onto the pixels, and so are the
derivatives by rotation and light."""

from __future__ import annotations

from math import ceil, exp, sqrt
from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory, inner_nogil
from .kernel_types import LIGHT_TERMS, PictureModel, PoseState
from .rounded_surface import NOTHING, motion_px, rays_about_centre

BLUR_REACH = 2.6
"""Half-width of the window of the blur, in blurs."""
WIDEST_BLUR = 12
"""Largest half-width of that window [half pixels]: blur beyond it is cut off."""
WIDEST_SLOPE_PX = 3
"""The same of the window in which derivatives by rotation and light are blurred [px]."""
SEPARABLE_PX2 = 1.0
"""Variance of the blur of a coarse step from which it is drawn along rows and then along columns. What moves within
one drawn instant (`surface_picture.NODE_PX`) has a covariance of at most a twenty-fourth of its square."""
LEAST_VARIANCE_PX2 = 0.04
"""Least variance of the blur: a grid of half pixels shows no less."""
PIXEL_VARIANCE_PX2 = 1.0 / 12.0
"""Variance of a pixel."""
LEAST_SHARE = 1e-4
"""Least share of a pixel that is counted."""


class SurfaceGrid(NamedTuple):
    """What the pixels of a box show, and how that changes with the pose."""

    x0: int
    y0: int
    """Of the first pixel."""
    part: Any
    """(rows, columns) of the surface, of pixels beside the contour that of the nearest point inside; NOTHING farther
    outside."""
    side: Any
    """(rows, columns) piece of a side of the contour that is nearest; NOTHING where a pixel is not used."""
    share: Any
    """(rows, columns) [w], of the die behind the pixel."""
    glow: Any
    """(rows, columns) [w B] in grey."""
    bright: Any
    """(rows, columns) B at the pixel or the nearest point inside [grey]."""
    beyond: Any
    """(rows, columns, 5) distance from the contour [px], direction away from the die, -dw/dd [1/px], and dw/dσ [1/px]."""
    flow: Any
    """(rows, columns, 2, 6) how the point of the surface moves in the picture with the pose [px/m, px/rad]."""
    slope: Any
    """(rows, columns, 3 + LIGHT_TERMS) derivatives of its B by the rotation vector [grey/rad], and by the light."""
    gradient: Any
    """(rows, columns, 4) of [w B] and [w], by column and by row."""
    covered: Any
    """(2 rows, 2 columns) w on the grid of half pixels."""
    shining: Any
    """(2 rows, 2 columns) w B on it."""
    moved: Any
    """(2 rows, 2 columns, 2) w times the distance from the middle of a piece to that of the part within the contour [px]."""


@inner_nogil
def new_surface_grid(box: Any) -> SurfaceGrid:
    """The grid of a box x0, y0, x1, y1 (end exclusive)."""
    rows, columns = box[3] - box[1], box[2] - box[0]
    return SurfaceGrid(
        box[0], box[1], np.full((rows, columns), NOTHING), np.full((rows, columns), NOTHING), np.zeros((rows, columns)),
        np.zeros((rows, columns)), np.zeros((rows, columns)), np.zeros((rows, columns, 5)),
        np.zeros((rows, columns, 2, 6)), np.zeros((rows, columns, 3 + LIGHT_TERMS)), np.zeros((rows, columns, 4)),
        np.zeros((2 * rows, 2 * columns)), np.zeros((2 * rows, 2 * columns)), np.zeros((2 * rows, 2 * columns, 2)),
    )  # fmt: skip


# --- windows


@inner_no_memory
def _variances(lens: float, exposed: Any) -> tuple[float, float, float]:
    """Of the blur by lens and motion [px²]: along rows, along columns, and the covariance of both. `exposed` is the motion within
    the exposure (x, y) [px]."""
    x, y = exposed[0], exposed[1]
    return lens + x**2 / 12.0, lens + y**2 / 12.0, x * y / 12.0


@inner_nogil
def _window(size: int, spacing_px: float, variances: Any) -> Any:
    """(size, size) a Gaussian about the middle, of sum 1."""
    xx, yy, xy = variances
    det, weight, total = xx * yy - xy * xy, np.zeros((size, size)), 0.0
    for a in range(size):
        v = spacing_px * (a - 0.5 * (size - 1))
        for b in range(size):
            u = spacing_px * (b - 0.5 * (size - 1))
            weight[a, b] = exp(-0.5 * (yy * u * u - 2.0 * xy * u * v + xx * v * v) / det)
            total += weight[a, b]
    for a in range(size):
        for b in range(size):
            weight[a, b] /= total
    return weight


# --- the picture


@inner_nogil
def blur_surface(model: PictureModel, blur_px: float, exposed: Any, grid: SurfaceGrid) -> None:
    """Blur w and w B onto the pixels in use."""
    variances = _variances(max(blur_px**2, LEAST_VARIANCE_PX2), exposed)
    if blur_px > model.settings.blur_px and min(variances[0], variances[1]) > SEPARABLE_PX2:
        _blur_rows_then_columns(variances, grid)
    else:
        _blur_at_once(variances, model.shape.normals.shape[0], grid)


@inner_nogil
def _blur_at_once(variances: Any, faces: int, grid: SurfaceGrid) -> None:
    """Blur with a window of two dimensions, and with the places of parts of pieces within their pieces."""
    xx, yy, xy = variances
    half = min(ceil(2.0 * BLUR_REACH * sqrt(max(xx, yy))), WIDEST_BLUR)
    det, weight = xx * yy - xy * xy, _window(2 * half, 0.5, (xx, yy, xy))
    rows, columns = grid.part.shape
    flat = half // 2 + 1
    for i in range(rows):
        for j in range(columns):
            if grid.side[i, j] == NOTHING:
                continue
            if _same_about(grid.part, i, j, flat, faces):
                grid.share[i, j] = grid.covered[2 * i, 2 * j]
                grid.glow[i, j] = grid.shining[2 * i, 2 * j]
                continue
            share, glow, share_x, glow_x, share_y, glow_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            first, last = max(0, half - 2 * j - 1), min(2 * half, 2 * columns + half - 2 * j - 1)
            for a in range(max(0, half - 2 * i - 1), min(2 * half, 2 * rows + half - 2 * i - 1)):
                by, covered, shining = weight[a], grid.covered[2 * i + 1 + a - half], grid.shining[2 * i + 1 + a - half]
                at, moved = 2 * j + 1 - half, grid.moved[2 * i + 1 + a - half]
                across = 0.5 * (a - half) + 0.25
                for b in range(first, last):
                    along = 0.5 * (b - half) + 0.25
                    w = covered[at + b]
                    if w == 0.0:
                        continue
                    x, y, t = (yy * along - xy * across) / det, (xx * across - xy * along) / det, by[b]
                    dx, dy = moved[at + b, 0], moved[at + b, 1]
                    if dx != 0.0 or dy != 0.0:
                        dx, dy = dx / w, dy / w
                        t *= 1.0 - x * dx - y * dy
                        x, y = x + (yy * dx - xy * dy) / det, y + (xx * dy - xy * dx) / det
                    s, g = t * w, t * shining[at + b]
                    share += s
                    glow += g
                    share_x += x * s
                    glow_x += x * g
                    share_y += y * s
                    glow_y += y * g
            grid.share[i, j], grid.glow[i, j] = share, glow
            out = grid.gradient[i, j]
            out[0], out[1], out[2], out[3] = glow_x, glow_y, share_x, share_y


@inner_nogil
def _blur_rows_then_columns(variances: Any, grid: SurfaceGrid) -> None:
    """Blur of a coarse step, along rows first and then along columns. It leaves out motion at an angle to both, and where parts
    lie within their pieces: some hundredths of a pixel."""
    rows, columns = grid.part.shape
    half = min(ceil(2.0 * BLUR_REACH * sqrt(max(variances[0], variances[1]))), WIDEST_BLUR)
    along_x, along_y = _line_weights(half, variances[0]), _line_weights(half, variances[1])
    across = np.empty((4, columns, 2 * rows))
    for i in range(2 * rows):
        for j in range(columns):
            x = 2 * j + 1 - half
            _sum_row(grid, i, j, x, (max(0, -x), min(2 * half, 2 * columns - x)), along_x, across)
    for i in range(rows):
        y = 2 * i + 1 - half
        for j in range(columns):
            if grid.side[i, j] != NOTHING:
                _sum_column(grid, i, j, y, (max(0, -y), min(2 * half, 2 * rows - y)), along_y, across)


@inner_nogil
def _line_weights(half: int, variance: float) -> Any:
    """(2, 2 half) a Gaussian on half pixels, of sum 1, and its derivative by the place of its middle."""
    weights, total = np.empty((2, 2 * half)), 0.0
    for a in range(2 * half):
        u = 0.5 * (a - half) + 0.25
        weights[0, a] = exp(-0.5 * u * u / variance)
        total += weights[0, a]
    for a in range(2 * half):
        weights[0, a] /= total
        weights[1, a] = weights[0, a] * (0.5 * (a - half) + 0.25) / variance
    return weights


@inner_fast_sums_no_memory
def _sum_row(grid: SurfaceGrid, i: int, j: int, x: int, window: Any, weights: Any, across: Any) -> None:
    """Fill the blurred w and w B at a column of pixels on a row of half pixels, and their derivatives by the column."""
    share, glow, share_x, glow_x = 0.0, 0.0, 0.0, 0.0
    covered, shining, here, by_x = grid.covered[i], grid.shining[i], weights[0], weights[1]
    for b in range(window[0], window[1]):
        w, g = covered[x + b], shining[x + b]
        share += here[b] * w
        glow += here[b] * g
        share_x += by_x[b] * w
        glow_x += by_x[b] * g
    across[0, j, i], across[1, j, i], across[2, j, i], across[3, j, i] = share, glow, share_x, glow_x


@inner_fast_sums_no_memory
def _sum_column(grid: SurfaceGrid, i: int, j: int, y: int, window: Any, weights: Any, across: Any) -> None:
    """Fill share, glow and gradients of a pixel from the blurred rows."""
    share, glow, share_x, glow_x, share_y, glow_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    w, g, w_x, g_x, here, by_y = across[0, j], across[1, j], across[2, j], across[3, j], weights[0], weights[1]
    for a in range(window[0], window[1]):
        share += here[a] * w[y + a]
        glow += here[a] * g[y + a]
        share_x += here[a] * w_x[y + a]
        glow_x += here[a] * g_x[y + a]
        share_y += by_y[a] * w[y + a]
        glow_y += by_y[a] * g[y + a]
    grid.share[i, j], grid.glow[i, j] = share, glow
    out = grid.gradient[i, j]
    out[0], out[1], out[2], out[3] = glow_x, glow_y, share_x, share_y


@inner_no_memory
def _same_about(part: Any, i: int, j: int, flat: int, faces: int) -> bool:
    """Whether a pixel and those about it show one flat face, or nothing of the die."""
    k = part[i, j]
    if k >= faces:
        return False
    for a in range(-1, 2):
        for b in range(-1, 2):
            y, x = i + a * flat, j + b * flat
            if not (0 <= y < part.shape[0] and 0 <= x < part.shape[1]) or part[y, x] != k:
                return False
    return True


# --- its derivatives


@inner_nogil
def blur_of_pixels(view: int, model: PictureModel, pose: PoseState, blur_px: float) -> Any:
    """(2 n + 1, 2 n + 1) the blur on the grid of whole pixels, of sum 1."""
    about = rays_about_centre(model.rig, view, pose.position)
    exposed = motion_px(model.rig, view, pose, about, model.settings.exposure_s)
    variances = _variances(max(blur_px**2 - PIXEL_VARIANCE_PX2, PIXEL_VARIANCE_PX2), exposed)
    half = min(ceil(BLUR_REACH * sqrt(max(variances[0], variances[1]))), WIDEST_SLOPE_PX)
    return _window(2 * half + 1, 1.0, variances)


@inner_no_memory
def fill_blurred_row(grid: SurfaceGrid, i: int, j: int, weight: Any, row: Any, parts: Any, shares: Any) -> int:
    """Fill (3 + LIGHT_TERMS,) the blurred derivatives of w B at a pixel by rotation and light, the parts (n,) that it shows
    and their shares (n,) of it; return how many these are."""
    half, count = weight.shape[0] // 2, 0
    for q in range(row.shape[0]):
        row[q] = 0.0
    for a in range(max(-half, -i), min(half, grid.part.shape[0] - 1 - i) + 1):
        for b in range(max(-half, -j), min(half, grid.part.shape[1] - 1 - j) + 1):
            y, x = i + a, j + b
            f = grid.part[y, x]
            if f == NOTHING:
                continue
            w = grid.covered[2 * y, 2 * x] + grid.covered[2 * y, 2 * x + 1]
            w = (
                0.25
                * weight[a + half, b + half]
                * (w + grid.covered[2 * y + 1, 2 * x] + grid.covered[2 * y + 1, 2 * x + 1])
            )
            if w < LEAST_SHARE:
                continue
            for q in range(row.shape[0]):
                row[q] += w * grid.slope[y, x, q]
            k = 0
            while k < count and parts[k] != f:
                k += 1
            if k == count:
                if count == parts.shape[0]:
                    continue
                parts[k], shares[k] = f, 0.0
                count += 1
            shares[k] += w
    return count
