"""The region cost of a pose: how badly the drawn die explains the pixels around it, in a kernel.

Inside a face the image should be the median grey of that face; outside the die it should be the background, or a darker
shade of it. The cost is the mean over sampled pixels of truncated squared sigmas. `pose_costs` says how it relates to
the other costs of a pose.
"""

from __future__ import annotations

from math import ceil, floor, isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner, inner_no_memory, inner_nogil
from ..placed_die import (
    CLEAR_PX,
    CONTOUR_PX,
    PIXELS,
    ROBUST_COST,
    SMALLEST_WINDOW_PX,
    FrameWindows,
    PictureModel,
    PoseState,
    RefinementSettings,
    Shape,
    Workspace,
    face_lines,
    new_workspace,
    place_die,
    place_outer,
    rounded_contour,
    within_rounded_outline,
)

SQUARED_SIGMAS_CUT = 16.0
"""Squared sigmas at which the misfit of a pixel is truncated."""
SHADOW_SQUARED_SIGMAS_CUT = 4.0
"""The same where the image is darker than the background, which a shadow explains."""
FACE_SIGMAS = 2.0
"""Noise of a pixel on a face, over that of the background: grain and marks."""
FACE_SHADING = 0.04
"""Standard deviation of shading over a face, as a share of its grey; added in quadrature."""
DIFFERENT_SIGMAS = 3.0
"""Difference from the background, in its noise, from which a pixel shows something else."""
NO_COST = 1e9
"""Cost of a pose that lies behind the camera or out of view."""

SUPPORT_COST = 2.0
"""Cost of a contour without any clear step, in units of the region cost."""
UNEXPLAINED_COST = 10.0
"""Cost of edges of which the edge model explains no pixel, in units of the region cost."""


@inner(nogil=True, shared=True)
def region_cost(
    windows: FrameWindows, model: PictureModel, pose: PoseState, margin: float, work: Workspace
) -> tuple[float, float]:
    """Mean over the cameras of the region cost of one pose, and the share of the die's own pixels that differ from the
    background.

    The region is the box of the outline and `margin` [px] about it, so hypotheses near each other are compared on the
    same pixels. Mirrored views are left out.
    """
    rig, shape = model.rig, model.shape
    score, number, inside, differs = 0.0, 0.0, 0.0, 0.0
    for view in range(rig.camera.shape[0]):
        camera = rig.camera[view]
        mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
        if mirrored or windows.size[camera, 0] == 0 or not place_die(shape, rig, view, pose, work):
            continue
        outline = rounded_contour(shape, rig, view, pose.position, work)
        if not place_outer(shape, rig, view, pose, work):
            return NO_COST, 0.0
        x0, y0 = windows.corner[camera, 0], windows.corner[camera, 1]
        x1, y1 = x0 + windows.size[camera, 0], y0 + windows.size[camera, 1]
        low_x = max(floor(work.vertex_px[:, 0].min() - margin), x0)
        low_y = max(floor(work.vertex_px[:, 1].min() - margin), y0)
        high_x = min(ceil(work.vertex_px[:, 0].max() + margin) + 1, x1)
        high_y = min(ceil(work.vertex_px[:, 1].max() + margin) + 1, y1)
        if high_x - low_x < SMALLEST_WINDOW_PX or high_y - low_y < SMALLEST_WINDOW_PX:
            continue
        a, b, c = _box_cost(
            windows.pixels[camera], model.backgrounds[camera], (x0, y0), (low_x, low_y, high_x, high_y), shape,
            outline, model.settings, work,
        )  # fmt: skip
        score += a
        number += 1.0
        inside += b
        differs += c
    if number == 0.0:
        return NO_COST, 0.0
    return score / number, differs / max(inside, 1.0)


@inner_nogil
def pose_cost(region: float, statistics: Any) -> float:
    """The pose cost: the region cost, and what the edges of the refined pose lack."""
    unexplained = statistics[ROBUST_COST] / max(statistics[PIXELS], 1.0)
    return region + clear_steps_cost(statistics) + UNEXPLAINED_COST * unexplained


@inner_no_memory
def clear_steps_cost(statistics: Any) -> float:
    """Cost of a contour of which a part shows no clear step."""
    return SUPPORT_COST * (1.0 - statistics[CLEAR_PX] / max(statistics[CONTOUR_PX], 1e-9))


@compiled(nogil=True)
def region_costs_in_box(
    image: Any, model: PictureModel, box: Any, positions: Any, rotations: Any, costs: Any, differs: Any
) -> None:
    """Fill the region costs of many poses on one box (x0, y0, x1, y1; end exclusive) of the first camera's picture, and
    the shares of their pixels that differ from the background."""
    rig, shape = model.rig, model.shape
    work = new_workspace(shape, rig)
    first, still = np.int64(0), np.zeros(3)
    for k in range(positions.shape[0]):
        costs[k], differs[k] = NO_COST, 0.0
        pose = PoseState(positions[k], rotations[k], still, still)
        if not place_die(shape, rig, first, pose, work):
            continue
        outline = rounded_contour(shape, rig, first, positions[k], work)
        if place_outer(shape, rig, first, pose, work):
            total, inside, other = _box_cost(
                image, model.backgrounds[0], (first, first), box, shape, outline, model.settings, work
            )
            costs[k], differs[k] = total, other / max(inside, 1.0)


@inner_nogil
def _box_cost(
    image: Any, background: Any, corner: Any, box: Any, shape: Shape, outline: Any, settings: RefinementSettings,
    work: Workspace,
) -> tuple[float, float, float]:  # fmt: skip
    """Region cost over about as many pixels of a box as the settings say, number of these on the die, and number of
    those that differ from the background.

    Pixel [0, 0] of the image is `corner` of the background; pixels whose background is NaN do not count. No face
    reaches farther beyond the `outline` of the inner body, so many lines of the hull, than so many pixels.
    """
    (x0, y0), (low_x, low_y, high_x, high_y), (contour, ball_px) = corner, box, outline
    noise, samples = settings.noise_grey, settings.region_pixels
    stride = max(1, int(sqrt((high_x - low_x) * (high_y - low_y) / samples)))
    nf, most = shape.face_edges.shape
    lines, count = np.zeros((nf, most, 3)), np.zeros(nf, np.int64)
    for f in range(nf):
        if work.face_cosine[f] > 0.0:
            count[f] = face_lines(shape, work, f, lines[f])
    columns = (high_x - low_x + stride - 1) // stride
    label = np.full(((high_y - low_y + stride - 1) // stride, columns), -1)
    number, grey = np.zeros(nf), np.zeros(nf)
    for i in range(label.shape[0]):
        y = low_y + i * stride
        for j in range(columns):
            x = low_x + j * stride
            for f in range(nf):
                if count[f] == 0:
                    continue
                hit = True
                for k in range(count[f]):
                    if lines[f, k, 0] * x + lines[f, k, 1] * y + lines[f, k, 2] < 0.0:
                        hit = False
                        break
                if hit:
                    if isnan(background[y, x]):
                        break
                    if contour > 0 and not within_rounded_outline(work.hull, contour, x, y, ball_px):
                        break
                    label[i, j] = f
                    number[f] += 1.0
                    break
    # Marks may be far brighter than a face, and would bias its mean.
    own = np.empty(label.size)
    for f in range(nf):
        n = 0
        if number[f] > 0.0:
            for i in range(label.shape[0]):
                for j in range(columns):
                    if label[i, j] == f:
                        own[n] = image[low_y + i * stride - y0, low_x + j * stride - x0]
                        n += 1
            grey[f] = np.median(own[:n])
    cost, judged, inside, differs = 0.0, 0.0, 0.0, 0.0
    iv = 1.0 / (noise * noise)
    for i in range(label.shape[0]):
        y = low_y + i * stride
        for j in range(columns):
            x = low_x + j * stride
            f = label[i, j]
            value = image[y - y0, x - x0]
            difference = value - background[y, x]
            if isnan(difference):
                continue
            judged += 1.0
            if f >= 0:
                inside += 1.0
                if abs(difference) > DIFFERENT_SIGMAS * noise:
                    differs += 1.0
                e = value - grey[f]
                variance = FACE_SIGMAS**2 * noise * noise + (FACE_SHADING * grey[f]) ** 2
                cost += min(e * e / variance, SQUARED_SIGMAS_CUT)
            else:
                cut = SHADOW_SQUARED_SIGMAS_CUT if difference < 0.0 else SQUARED_SIGMAS_CUT
                cost += min(difference * difference * iv, cut)
    return cost / max(judged, 1.0), inside, differs
