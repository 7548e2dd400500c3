"""The region cost of a pose: how badly the drawn die explains the pixels around it, in a kernel.

The picture that a pose predicts has, per pixel, the share w of the die behind it, blurred by lens and motion across the
contour; the brightness B of the part of the surface that it shows; and the background G elsewhere: w B + (1 - w) G. The cost
of a pixel is its truncated squared difference from that, over the variance, and the logarithm of the variance: pixels of the
die are allowed grain, marks and shading, for which a pose must pay where it draws the die over a background that it could
have left to see.

The brightness of a part is the mean of its pixels. A sharp die has faces, each with a brightness of its own. A rounded one has
strips and corners besides (`rounded_surface`), and they would give a wrong pose so much freedom that it explains anything. But
brightness varies with the normal as lamps in unknown directions make it (`surface_light`), up to a deviation of each part:
parts are B = m ℓ + δ, with the coefficients ℓ of the picture solved for, and what ℓ and δ take from their priors is added to
the cost.

All poses on a picture are judged on the same pixels: those of the box in which the die was expected. Beyond it, a pose counts
what its pixels cost more than the background alone. Otherwise a larger die, which sees more quiet background about it, would
cost less. `pose_costs` says how this relates to the other costs of a pose.
"""

from __future__ import annotations

from math import erfc, isnan, log, log1p, sqrt
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_no_memory, inner_nogil
from .kernel_types import (
    BACKGROUND_SHARE,
    CLEAR_PX,
    CONTOUR_PX,
    DIE_PX,
    EVIDENCE,
    LIGHT_TERMS,
    PIXELS,
    ROBUST_COST,
    CameraRig,
    FrameWindows,
    PictureModel,
    PoseState,
    RefinementSettings,
    Shape,
    Workspace,
    new_workspace,
)
from .projection import SMALLEST_WINDOW_PX, exposure_delay, place_die
from .rounded_surface import (
    NOTHING,
    ball_px,
    beyond_contour,
    contour_segments,
    face_at,
    fill_ray,
    flat_faces,
    motion_px,
    number_of_parts,
    part_on_ray,
    pixels_about,
    rays_about_centre,
)
from .small_matrices import cholesky_factor, solve_factored
from .surface_light import LAMP_PRIOR, LEAST_LIGHT_PIVOT, fill_monomials

SQUARED_SIGMAS_CUT = 16.0
"""Squared sigmas at which the misfit of a pixel is truncated."""
SHADOW_SQUARED_SIGMAS_CUT = 4.0
"""The same where the image is darker than the background, which a shadow explains."""
FACE_SIGMAS = 2.0
"""Noise of a pixel on a face, over that of the background: grain and marks."""
FACE_SHADING = 0.04
"""Standard deviation of shading over a face, as a share of its grey; added in quadrature."""
CONTOUR_SHARE = 0.1
"""Standard deviation of a pixel on the contour, over 2 √(w (1 - w)), as a share of the step from the die to the background:
what the blur is off."""
MARK_SIGMAS = 12.0
"""Distance from the mean of a part, in noise of the background, beyond which a pixel is a mark and is left out of the
mean."""
PART_DEVIATION = 0.08
"""Standard deviation of the brightness of a part from what the light makes of its normal, in units of the mean brightness.
Twice and half as much order poses alike."""
PART_TAILS = 4.0
"""Degrees of freedom of Student's t for these deviations: a highlight is far from any polynomial."""
LIGHT_ITERATIONS = 3
"""Solutions for the light, each with the weights of the one before."""
PURE_SHARE = 0.98
"""Share of the die behind a pixel from which its grey counts for the brightness of its part."""
OUTSIDE_SHARE = 0.02
"""Share of it up to which a pixel shows the background."""
FAR_BLURS = 3.0
"""Distance beyond the contour, in blurs, from which a pixel shows the background alone."""
INWARD_PX = 0.5
"""A pixel outside the contour gets the brightness of the point that lies this far inside it."""
DIFFERENT_SIGMAS = 3.0
"""Difference from the background, in its noise, from which a pixel shows something else."""
NO_COST = 1e9
"""Cost of a pose that lies behind the camera or out of view."""

SUPPORT_COST = 2.0
"""Cost of a contour without any clear step, in units of the region cost."""
UNEXPLAINED_COST = 10.0
"""Cost of edges of which the edge model explains no pixel, in units of the region cost."""


@inner_nogil
def region_cost(
    windows: FrameWindows, model: PictureModel, start: PoseState, pose: PoseState, margin: float, work: Workspace,
    statistics: Any,
) -> float:  # fmt: skip
    """Mean over the cameras of the region cost of one pose. What is counted goes to the statistics: BACKGROUND_SHARE,
    EVIDENCE and DIE_PX.

    The die was expected at `start`, in the box of its outline and `margin` [px] about it. Mirrored views are left out.
    """
    rig, shape = model.rig, model.shape
    score, number, inside, differs, gained = 0.0, 0.0, 0.0, 0.0, 0.0
    statistics[BACKGROUND_SHARE], statistics[EVIDENCE], statistics[DIE_PX] = 1.0, 0.0, 0.0
    for view in range(rig.camera.shape[0]):
        camera = rig.camera[view]
        mirrored = rig.partner[view] >= 0 and rig.partner[view] < view
        if mirrored or windows.size[camera, 0] == 0 or not place_die(shape, rig, view, start, work):
            continue
        window = (
            windows.corner[camera, 0],
            windows.corner[camera, 1],
            windows.corner[camera, 0] + windows.size[camera, 0],
            windows.corner[camera, 1] + windows.size[camera, 1],
        )
        expected = pixels_about(work.vertex_px, margin + ball_px(shape, rig, view, start.position), window)
        if not place_die(shape, rig, view, pose, work):
            return NO_COST
        own = pixels_about(work.vertex_px, margin + ball_px(shape, rig, view, pose.position), window)
        if min(own[2] - own[0], own[3] - own[1]) < SMALLEST_WINDOW_PX:
            continue
        if min(expected[2] - expected[0], expected[3] - expected[1]) < SMALLEST_WINDOW_PX:
            continue
        a, b, c, d = _box_cost(
            windows.pixels[camera], model.backgrounds[camera], (window[0], window[1]), expected, own, shape, rig, view,
            pose, model.settings, work,
        )  # fmt: skip
        score += a
        number += 1.0
        inside += b
        differs += c
        gained += d
    if number == 0.0:
        return NO_COST
    statistics[BACKGROUND_SHARE] = 1.0 - differs / max(inside, 1.0)
    statistics[EVIDENCE], statistics[DIE_PX] = gained, inside
    return score / number


@inner_nogil
def pose_cost(region: float, statistics: Any) -> float:
    """The pose cost: the region cost, and what the edges of the refined pose lack."""
    cost = region
    lacking = 1.0 - statistics[CLEAR_PX] / max(statistics[CONTOUR_PX], 1e-9)
    cost += SUPPORT_COST * lacking + UNEXPLAINED_COST * statistics[ROBUST_COST] / max(statistics[PIXELS], 1.0)
    return cost


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
        if place_die(shape, rig, first, pose, work):
            total, inside, other, _ = _box_cost(
                image, model.backgrounds[0], (first, first), box, box, shape, rig, first, pose, model.settings, work
            )
            costs[k], differs[k] = total, other / max(inside, 1.0)


@inner_nogil
def _box_cost(
    image: Any, background: Any, corner: Any, expected: Any, own: Any, shape: Shape, rig: CameraRig, view: int,
    pose: PoseState, settings: RefinementSettings, work: Workspace,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Region cost over about as many pixels of the expected box as the settings say, number of pixels on the die, of those
    that differ from the background, and the sum over pixels of what the die costs more than the background alone.

    The die is placed in the workspace, and lies in the box `own`. Pixel [0, 0] of the image is `corner` of the
    background; pixels whose background is NaN do not count.
    """
    (x0, y0), noise = corner, settings.noise_grey
    ex0, ey0, ex1, ey1 = expected
    low_x, low_y = min(ex0, own[0]), min(ey0, own[1])
    high_x, high_y = max(ex1, own[2]), max(ey1, own[3])
    stride = max(1, int(sqrt((ex1 - ex0) * (ey1 - ey0) / settings.region_pixels)))
    # Of all pixels, every so many: other poses are asked on the same ones.
    low_x, low_y = low_x + (-low_x) % stride, low_y + (-low_y) % stride
    rows, columns = (high_y - low_y + stride - 1) // stride, (high_x - low_x + stride - 1) // stride
    part, share = np.empty((rows, columns), np.int64), np.empty((rows, columns))
    number_of = number_of_parts(shape)
    sums, grey, light = np.zeros((number_of, 2 + LIGHT_TERMS)), np.zeros(number_of), np.zeros(LIGHT_TERMS)
    normals, monomials = np.empty((rows, columns, 3) if shape.radius > 0.0 else (0, 0, 3)), np.zeros(LIGHT_TERMS)
    _fill_parts(
        image,
        background,
        (x0, y0, low_x, low_y, stride),
        part,
        share,
        normals,
        sums,
        shape,
        rig,
        view,
        pose,
        settings,
        work,
    )
    prior_cost = _fill_greys(image, (x0, y0, low_x, low_y, stride), part, share, sums, grey, light, shape, noise)
    judged, inside, differs, gained, quiet = 0.0, 0.0, 0.0, prior_cost, 0.0
    iv = 1.0 / (noise * noise)
    for i in range(rows):
        y = low_y + i * stride
        for j in range(columns):
            x = low_x + j * stride
            value, behind = image[y - y0, x - x0], background[y, x]
            difference = value - behind
            if isnan(difference):
                continue
            cut = SHADOW_SQUARED_SIGMAS_CUT if difference < 0.0 else SQUARED_SIGMAS_CUT
            alone = min(difference * difference * iv, cut)
            expects = x >= ex0 and x < ex1 and y >= ey0 and y < ey1
            if expects:
                judged += 1.0
                quiet += alone
            w = share[i, j]
            if w < OUTSIDE_SHARE:
                continue
            if w > 0.5:
                inside += 1.0
                differs += 1.0 if abs(difference) > DIFFERENT_SIGMAS * noise else 0.0
            bright = grey[part[i, j]]
            if shape.radius > 0.0:
                fill_monomials(normals[i, j, 0], normals[i, j, 1], normals[i, j, 2], monomials)
                bright = max(bright + _brightness(light, monomials), 0.0)
            on_die = FACE_SIGMAS**2 * noise * noise + (FACE_SHADING * bright) ** 2
            step = CONTOUR_SHARE * (bright - behind)
            v = w * w * on_die + (1.0 - w) ** 2 * noise * noise + 4.0 * w * (1.0 - w) * step * step
            e = value - w * bright - (1.0 - w) * behind
            gained += min(e * e / v, SQUARED_SIGMAS_CUT) + log(max(v * iv, 1.0)) - alone
    pixels = float(stride * stride)
    return (quiet + gained) / max(judged, 1.0), pixels * inside, pixels * differs, pixels * gained


@inner_nogil
def _fill_parts(
    image: Any, background: Any, grid: Any, part: Any, share: Any, normals: Any, sums: Any, shape: Shape, rig: CameraRig,
    view: int,     pose: PoseState, settings: RefinementSettings, work: Workspace,
) -> None:  # fmt: skip
    """Fill the part of the surface that each pixel of a grid shows, the share of the die behind it, and its normal in axes of
    the die, none of a sharp die; and for each part the number of its pixels, the sum of their greys, and the means of the
    monomials of their normals (parts, 2 + LIGHT_TERMS)."""
    x0, y0, low_x, low_y, stride = grid
    lines, count = flat_faces(shape, rig, view, pose, work)
    segments, ball = contour_segments(shape, work), ball_px(shape, rig, view, pose.position)
    about, late = rays_about_centre(rig, view, pose.position), exposure_delay(rig, pose.position)
    origin, direction, normal, monomials = np.zeros(3), np.zeros(3), np.zeros(6), np.zeros(LIGHT_TERMS)
    exposed_px = motion_px(rig, view, pose, about, settings.exposure_s)
    widest = (
        sqrt(exposed_px[0] ** 2 + exposed_px[1] ** 2) + abs(exposed_px[2]) * max(part.shape[0], part.shape[1]) * stride
    )
    band = FAR_BLURS * sqrt(settings.blur_px**2 + widest * widest / 12.0)
    nf = shape.normals.shape[0]
    for i in range(part.shape[0]):
        y = low_y + i * stride
        for j in range(part.shape[1]):
            x = low_x + j * stride
            part[i, j], share[i, j] = NOTHING, 0.0
            beyond, nx, ny = beyond_contour(segments, x, y, ball, band)
            if beyond > band or isnan(background[y, x]):
                continue
            moved = (exposed_px[0] - exposed_px[2] * (y - about[1])) * nx
            moved += (exposed_px[1] + exposed_px[2] * (x - about[0])) * ny
            blur = sqrt(settings.blur_px**2 + moved * moved / 12.0)
            if beyond > FAR_BLURS * blur:
                continue
            w = 0.5 * erfc(beyond / (blur * 1.4142135623730951))
            # Whatever lies outside is moved inside for its brightness.
            back = max(beyond + INWARD_PX, 0.0)
            u, v = x - back * nx, y - back * ny
            k = face_at(lines, count, u, v)
            if k == NOTHING and shape.radius > 0.0:
                fill_ray(rig, view, pose, about, late, u, v, origin, direction)
                k = part_on_ray(shape, work.face_cosine, origin, direction, normal)
            elif k != NOTHING:
                for q in range(3):
                    normal[q] = shape.normals[k, q]
            if k == NOTHING:
                continue
            part[i, j], share[i, j] = k, w
            if shape.radius > 0.0:
                for q in range(3):
                    normals[i, j, q] = normal[q]
            if w > PURE_SHARE:
                sums[k, 0] += 1.0
                sums[k, 1] += image[y - y0, x - x0]
                if shape.radius > 0.0 and k >= nf:
                    fill_monomials(normal[0], normal[1], normal[2], monomials)
                    for q in range(LIGHT_TERMS):
                        sums[k, 2 + q] += monomials[q]
    for k in range(sums.shape[0]):
        if k < nf:
            fill_monomials(shape.normals[k, 0], shape.normals[k, 1], shape.normals[k, 2], sums[k, 2:])
        else:
            for q in range(LIGHT_TERMS):
                sums[k, 2 + q] /= max(sums[k, 0], 1.0)


@inner_nogil
def _fill_greys(
    image: Any, grid: Any, part: Any, share: Any, sums: Any, grey: Any, light: Any, shape: Shape, noise: float
) -> float:
    """Fill the brightness (parts,) [grey] of each part, beyond that of the light (LIGHT_TERMS,) on its normals, and the light;
    return what they cost. A sharp die has no light.

    `sums` are those of `_fill_parts`; the first two columns become those without marks."""
    x0, y0, low_x, low_y, stride = grid
    number, total, nf = 0.0, 0.0, shape.normals.shape[0]
    for k in range(grey.shape[0]):
        number, total = number + sums[k, 0], total + sums[k, 1]
        grey[k] = sums[k, 1] / max(sums[k, 0], 1.0)
        if k < nf:
            sums[k, 0], sums[k, 1] = 0.0, 0.0
    # Marks bias the mean of a face: it is taken again without pixels far from it.
    for i in range(part.shape[0]):
        for j in range(part.shape[1]):
            k = part[i, j]
            if k != NOTHING and k < nf and share[i, j] > PURE_SHARE:
                value = image[low_y + i * stride - y0, low_x + j * stride - x0]
                if abs(value - grey[k]) < MARK_SIGMAS * noise:
                    sums[k, 0] += 1.0
                    sums[k, 1] += value
    level = total / max(number, 1.0)
    for k in range(grey.shape[0]):
        if sums[k, 0] > 0.0:
            grey[k] = sums[k, 1] / sums[k, 0]
        elif grey[k] == 0.0:
            grey[k] = level
    if shape.radius == 0.0 or not level > 0.0:
        return 0.0
    return _follow_light(sums, grey, light, level, noise)


@inner_nogil
def _follow_light(sums: Any, grey: Any, light: Any, level: float, noise: float) -> float:
    """Solve for the light (LIGHT_TERMS,) on the parts, and leave of their brightness (parts,) what the light does not make of
    their normals, drawn towards zero by how little of them is seen. Returns what light and deviations cost."""
    parts, n = grey.shape[0], np.int64(LIGHT_TERMS)
    weight, variance = np.zeros(parts), np.empty(parts)
    H, L, y = np.empty((LIGHT_TERMS, LIGHT_TERMS)), np.zeros((LIGHT_TERMS, LIGHT_TERMS)), np.empty(LIGHT_TERMS)
    deviation = (PART_DEVIATION * level) ** 2
    pixel = FACE_SIGMAS**2 * noise * noise + (FACE_SHADING * level) ** 2
    for k in range(parts):
        weight[k] = 1.0 if sums[k, 0] > 0.0 else 0.0
        variance[k] = deviation + pixel / max(sums[k, 0], 1.0)
    for i in range(LIGHT_TERMS):
        light[i] = level if i == 0 else 0.0
    cost = 0.0
    for _ in range(LIGHT_ITERATIONS):
        for i in range(LIGHT_TERMS):
            y[i] = LAMP_PRIOR[i, 0] / level
            for q in range(i + 1):
                H[i, q] = LAMP_PRIOR[i, q] / (level * level)
        for k in range(parts):
            if weight[k] > 0.0:
                iv = weight[k] / variance[k]
                for i in range(LIGHT_TERMS):
                    s = iv * sums[k, 2 + i]
                    y[i] += s * grey[k]
                    for q in range(i + 1):
                        H[i, q] += s * sums[k, 2 + q]
        if not cholesky_factor(H, n, L, LEAST_LIGHT_PIVOT):
            light[:] = 0.0
            return 0.0
        solve_factored(L, n, y, light)
        cost = 0.0
        for k in range(parts):
            if weight[k] > 0.0:
                e = grey[k] - _brightness(light, sums[k, 2:])
                z2 = e * e / variance[k]
                weight[k] = (PART_TAILS + 1.0) / (PART_TAILS + z2)
                cost += (PART_TAILS + 1.0) * log1p(z2 / PART_TAILS)
    for i in range(LIGHT_TERMS):
        for q in range(LIGHT_TERMS):
            e = (light[i] - (level if i == 0 else 0.0)) * (light[q] - (level if q == 0 else 0.0))
            cost += e * LAMP_PRIOR[i, q] / (level * level)
    for k in range(parts):
        seen = sums[k, 0] / pixel
        grey[k] = seen * (grey[k] - _brightness(light, sums[k, 2:])) / (1.0 / deviation + seen)
    return cost


@inner_no_memory
def _brightness(light: Any, monomials: Any) -> float:
    total = 0.0
    for i in range(LIGHT_TERMS):
        total += light[i] * monomials[i]
    return total
