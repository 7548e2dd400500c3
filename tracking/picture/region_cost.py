"""tracking.picture.region_score."""

from __future__ import annotations

from math import ceil, floor, isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_nogil
from .kernel_types import (
    SHADOW_SQUARED_SIGMAS_CUT,
    SQUARED_SIGMAS_CUT,
    CameraRig,
    FrameWindows,
    Shape,
    Workspace,
    new_workspace,
)
from .projection import draw_outer, face_lines, place_die, rounded_contour, within_hull


@inner_nogil
def region_cost(
    windows: FrameWindows, backgrounds: Any, rig: CameraRig, shape: Shape, pos: Any, R: Any, noise: float, samples: int,
    margin: float, work: Workspace,
) -> tuple[float, float]:  # fmt: skip
    """How badly the drawn die explains its surroundings, as the mean over `samples` pixels of truncated squared sigmas,
    and the share of the die's own pixels that differ from the background.

    Inside a face the image should be that face's mean grey; outside it should be the background, or a darker shade of it. Of a
    rounded die faces end at its contour, short of where those of a sharp one would.
    The surroundings are the outline's box and `margin` [px] about it, so rivals near each other see the same pixels.
    """
    score, number, inside, differs = 0.0, 0.0, 0.0, 0.0
    for view in range(rig.camera.shape[0]):
        camera = rig.camera[view]
        mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
        if mirrored or windows.size[camera, 0] == 0 or not place_die(shape, rig, view, pos, R, work):
            continue
        contour, ball_px = rounded_contour(shape, rig, view, pos, work)
        if not draw_outer(shape, rig, view, pos, R, work):
            return 1e9, 0.0
        x0, y0 = windows.corner[camera, 0], windows.corner[camera, 1]
        x1, y1 = x0 + windows.size[camera, 0], y0 + windows.size[camera, 1]
        low_x = max(floor(work.px[:, 0].min() - margin), x0)
        low_y = max(floor(work.px[:, 1].min() - margin), y0)
        high_x = min(ceil(work.px[:, 0].max() + margin) + 1, x1)
        high_y = min(ceil(work.px[:, 1].max() + margin) + 1, y1)
        if high_x - low_x < 4 or high_y - low_y < 4:
            continue
        a, b, c = _box_score(
            windows.pixels[camera], backgrounds[camera], x0, y0, low_x, low_y, high_x, high_y, shape, work, contour, ball_px,
            noise, samples,
        )  # fmt: skip
        score += a
        number += 1.0
        inside += b
        differs += c
    if number == 0.0:
        return 1e9, 0.0
    return score / number, differs / max(inside, 1.0)


@compiled(nogil=True)
def region_costs_in_box(
    image: Any, background: Any, rig: CameraRig, shape: Shape, low_x: int, low_y: int, high_x: int, high_y: int,
    positions: Any, rotations: Any, noise: float, samples: int, score: Any, differs: Any,
) -> None:  # fmt: skip
    """Judge many poses by one box of the first camera's picture: mean truncated squared sigmas a pixel, and the share of
    the die's pixels that differ from the background."""
    work = new_workspace(shape, rig)
    corner_x, corner_y = np.int64(0), np.int64(0)
    for k in range(positions.shape[0]):
        score[k], differs[k] = 1e9, 0.0
        if not place_die(shape, rig, corner_x, positions[k], rotations[k], work):
            continue
        contour, ball_px = rounded_contour(shape, rig, corner_x, positions[k], work)
        if draw_outer(shape, rig, corner_x, positions[k], rotations[k], work):
            total, inside, other = _box_score(
                image, background, corner_x, corner_y, low_x, low_y, high_x, high_y, shape, work, contour, ball_px,
                noise, samples,
            )  # fmt: skip
            score[k], differs[k] = total, other / max(inside, 1.0)


@inner_nogil
def _box_score(
    image: Any, background: Any, x0: int, y0: int, low_x: int, low_y: int, high_x: int, high_y: int, shape: Shape,
    work: Workspace, contour: int, ball_px: float, noise: float, samples: int,
) -> tuple[float, float, float]:  # fmt: skip
    """Mean of the truncated squared sigmas over about `samples` pixels of a box, pixels on the die, and those of them that
    differ from the background; pixels whose background is NaN do not count. No face reaches beyond the outline of the inner
    body, of so many lines as `contour`, widened by `ball_px`; corners of the outline stay sharp."""
    stride = max(1, int(sqrt((high_x - low_x) * (high_y - low_y) / samples)))
    nf, most = shape.face_edges.shape
    lines, count = np.zeros((nf, most, 3)), np.zeros(nf, np.int64)
    for f in range(nf):
        if work.facing[f] > 0.0:
            count[f] = face_lines(shape, work, f, lines[f])
    columns = (high_x - low_x + stride - 1) // stride
    label = np.full(((high_y - low_y + stride - 1) // stride, columns), -1)
    total, number, mean = np.zeros(nf), np.zeros(nf), np.zeros(nf)
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
                    if isnan(background[y, x]) or (contour > 0 and not within_hull(work.hull, contour, x, y, ball_px)):
                        break
                    label[i, j] = f
                    total[f] += image[y - y0, x - x0]
                    number[f] += 1.0
                    break
    for f in range(nf):
        mean[f] = total[f] / max(number[f], 1.0)
    # Marks pull the mean down: once more without what lies far below or above it.
    total[:] = 0.0
    number[:] = 0.0
    for i in range(label.shape[0]):
        for j in range(columns):
            f = label[i, j]
            if f >= 0:
                value = image[low_y + i * stride - y0, low_x + j * stride - x0]
                if abs(value - mean[f]) < 12.0 * noise:
                    total[f] += value
                    number[f] += 1.0
    for f in range(nf):
        if number[f] > 0.0:
            mean[f] = total[f] / number[f]
    score, judged, inside, differs = 0.0, 0.0, 0.0, 0.0
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
                if abs(difference) > 3.0 * noise:
                    differs += 1.0
                e = value - mean[f]
                score += min(e * e / (4.0 * noise * noise + (0.04 * mean[f]) ** 2), SQUARED_SIGMAS_CUT)
            else:
                score += min(
                    difference * difference * iv, SHADOW_SQUARED_SIGMAS_CUT if difference < 0.0 else SQUARED_SIGMAS_CUT
                )
    return score / max(judged, 1.0), inside, differs
