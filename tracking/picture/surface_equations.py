"""The normal equations of a well-rounded die: every pixel of its picture against the one that its pose predicts.

On a die with wide bevels little of the surface is flat, corners are balls, and a contour lies beside a surface whose brightness
changes over a few pixels. The edges of such a die taken one by one (`edge_stretch`) leave the brightness beside each of them free,
which hides where it is: cubes of 65 and 129 pixels with corners of 12 and 15 % of the edge, refined from their true poses, came
out 0.9 and 1.7 degrees off. The whole picture, with one light on all of it, leaves a quarter of that.

A pixel with the share w of the die behind it is

    I = w (B(n) + δ) + (1 - w) γ G,        w = ½ erfc(d / (σ √2)),

with d the distance from the contour (that of the inner body, pushed out by the ball), σ the blur across it by lens and motion, B the
brightness of the surface by its normal n (`surface_light`), blurred as the picture is, δ what the part of the surface deviates from
that, the background G, and its shade γ beside each side of the contour. δ and γ are solved for and eliminated at each pose, part by
part; the coefficients of the light are unknowns of the picture, eliminated as those of edges are.

**Derivatives.** A contour moves with the point of the inner edge that it belongs to. A pixel within the contour sees another normal
when the die moves. With u the displacement of the point F of the inner body whose ball the ray d meets, and X = F + r n the point
seen, X stays on the ray, n · (X - u) is constant, and on a corner n changes by (d (n · u)/(n · d) - u)/r. On an edge with the axis e
only the part at right angles to e counts, and n turns with the axis as well: by -(n · (δθ × e)) e. On a flat face n turns with it.

**Robust weights.** Tukey's biweight, with a scale from the residuals of all bevels and contours of the picture, leaves out marks,
highlights and what stands in the way. Flat faces say nothing about the pose but through their brightness, which all of their pixels
share: their pixels are added up before they enter the equations.
"""

from __future__ import annotations

from math import erfc, exp, isnan, log, sqrt
from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import inner_no_memory, inner_nogil
from .edge_equations import add_edge_equations
from .edge_stretch import BIWEIGHT_CUT, CLEAR_SIGMAS, NORMAL_MAD
from .kernel_types import (
    BLUR,
    CLEAR_PX,
    CONTOUR,
    CONTOUR_PX,
    LIGHT_DEGREE,
    LIGHT_TERMS,
    LOG_NOISE,
    PARAMETERS,
    PIXELS,
    ROBUST_COST,
    STRETCHES,
    STRIP_CELLS,
    WEIGHT_SUM,
    EdgeSampling,
    FrameWindows,
    NormalEquations,
    PictureModel,
    PoseState,
    Workspace,
)
from .projection import SMALLEST_WINDOW_PX, exposure_delay, place_die, project_point
from .rounded_surface import (
    NOTHING,
    ball_px,
    contour_segments,
    face_at,
    fill_nearest_contour,
    fill_ray,
    flat_faces,
    motion_px,
    part_on_ray,
    pixels_about,
    rays_about_centre,
)
from .surface_light import DEVIATION_SHARE, LAMP_PRIOR, NO_LIGHT, clear_light, eliminate_light, fill_monomials

FAR_BLURS = 3.0
"""Distance from the contour, in blurs, up to which pixels show both die and background."""
PURE_SHARE = 0.98
"""Share of the die behind a pixel from which it shows a part of the surface alone."""
OUTSIDE_SHARE = 0.02
"""Share of it below which a pixel shows the background alone."""
INWARD_PX = 0.5
"""A pixel on or outside the contour gets the brightness of the point that lies this far inside it."""
GRAIN_SHARE = 0.02
"""Standard deviation of grain, as a share of the mean brightness, which the scale of the residuals multiplies."""
SHADE_DEVIATION = 0.15
"""Standard deviation of the shade of the background beside the die: soft shadows."""
DEVIATION_FACTOR = 1.6
"""Deviation of a part of the surface from the light, over that which the light states: highlights on bevels."""
MARK_SIGMAS = 6.0
"""Distance from the mean of a part, in standard deviations of its pixels, beyond which a pixel is a mark."""
SHADOW_SHARE = 0.1
"""Difference of a pixel from the shaded background, as a share of it, up to which it counts for the shade."""
GRAZING = 0.1
"""Least cosine between ray and normal in derivatives: the contour takes over where a ray grazes the surface."""
SMOOTHED_BLURS = 2.0
"""Half-width of the window over which the brightness of bevels is blurred, in blurs."""
WIDEST_SMOOTHING_PX = 5
"""Largest half-width of that window: motion beyond it is blurred less."""
SCALE_CELLS = 128
"""Cells of the histogram from which the median of residuals is found."""
CELL_SIGMAS = 0.0625
"""Width of one of them, in standard deviations; larger residuals go into the last."""
SPLIT_PX = 3.0
"""Depth within the contour up to which pixels are taken in four pieces: a surface that turns away changes its brightness within a
pixel."""
LEAST_VARIANCE_PX2 = 0.05
"""Least variance of the blur of bevels."""
STEP_PX = 1.5
"""Distance from the contour, beyond a blur, at which a clear step is looked for on both sides."""
CLEAR_PART = 0.3
"""Share of the predicted step that must be seen for it to be clear."""
LEAST_PX = 30.0
"""Pixels of bevels and contour below which nothing is said."""
LEAST_ROUNDED_PX = 1.0
"""Radius of the ball in the picture from which all pixels are compared. Bevels narrower than the blur look like sharp edges."""

_ALL = PARAMETERS + LIGHT_TERMS
"""Unknowns that all pixels share: those of the equations, then the light."""


class Grid(NamedTuple):
    """What the pixels of a box show, and how that changes with the pose."""

    x0: int
    y0: int
    """Of the first pixel."""
    part: Any
    """(rows, columns) of the surface: the faces, then the strips along edges, then the corners; NOTHING outside."""
    side: Any
    """(rows, columns) segment of the contour that is nearest; NOTHING where a pixel is not used."""
    share: Any
    """(rows, columns) w, of the die behind the pixel."""
    covered: Any
    """(rows, columns) share of the pixel's area within the contour, without blur."""
    beyond: Any
    """(rows, columns, 5) distance from the contour [px], direction away from the die, -dw/dd [1/px], and dw/dσ [1/px]."""
    contour: Any
    """(rows, columns, 6) how the contour moves outward with the pose [px/m, px/rad]."""
    bright: Any
    """(rows, columns, 7) brightness of the surface [grey], and its derivatives by the pose."""
    normal: Any
    """(rows, columns, 3) in world axes."""


@inner_nogil
def add_picture_equations(
    view: int, windows: FrameWindows, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add what the picture of one view says about a pose to the normal equations, H (lower half) and g, and to the statistics: its
    edges one by one, or the whole surface of a die with bevels wider than the blur. Before a mirror, and where bevels may have any
    shade, edges are compared."""
    rig, shape = model.rig, model.shape
    whole = shape.radius > 0.0 and rig.partner[view] < 0 and work.light.level[view] != NO_LIGHT
    if whole and ball_px(shape, rig, view, pose.position) > LEAST_ROUNDED_PX:
        add_surface_equations(view, windows, model, pose, sampling, work, equations)
    else:
        add_edge_equations(view, windows, model, pose, sampling, work, equations)


@inner_nogil
def add_surface_equations(
    view: int, windows: FrameWindows, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add all pixels of one view of a rounded die to the normal equations, H (lower half) and g, and to the statistics."""
    rig, shape, settings, light = model.rig, model.shape, model.settings, work.light
    light.solved[view] = 0
    if not place_die(shape, rig, view, pose, work):
        return
    camera = rig.camera[view]
    image, background = windows.pixels[camera], model.backgrounds[camera]
    wx, wy = windows.corner[camera, 0], windows.corner[camera, 1]
    window = (wx, wy, wx + windows.size[camera, 0], wy + windows.size[camera, 1])
    ball = ball_px(shape, rig, view, pose.position)
    box = pixels_about(work.vertex_px, ball + sampling.band_px, window)
    rows, columns = box[3] - box[1], box[2] - box[0]
    if min(columns, rows) < SMALLEST_WINDOW_PX:
        return
    segments = contour_segments(shape, work)
    if not light.level[view] > 0.0:
        _begin_light(view, image, background, window, box, (segments, ball), work)
        if not light.level[view] > 0.0:
            return
    grid = Grid(
        box[0], box[1], np.full((rows, columns), NOTHING), np.full((rows, columns), NOTHING), np.zeros((rows, columns)),
        np.zeros((rows, columns)), np.zeros((rows, columns, 5)), np.zeros((rows, columns, 6)), np.zeros((rows, columns, 7)),
        np.zeros((rows, columns, 3)),
    )  # fmt: skip
    exposed_px = motion_px(rig, view, pose, rays_about_centre(rig, view, pose.position), settings.exposure_s)
    _fill_grid(view, model, pose, sampling, segments, exposed_px, work, grid, background)
    deviations, shades = np.zeros(_number_of_whole_parts(shape)), np.ones(len(segments))
    _solve_deviations(image, background, (wx, wy), grid, view, settings.noise_grey, work, deviations, shades)
    _blur_bevels(grid, deviations, shape.normals.shape[0], settings.blur_px, exposed_px)
    _add_pixels(image, background, (wx, wy), grid, (deviations, shades), (view, model, sampling), work, equations)


@inner_nogil
def _begin_light(view: int, image: Any, background: Any, window: Any, box: Any, outline: Any, work: Workspace) -> None:
    """Begin with the mean grey of the die, and lamps anywhere."""
    (segments, ball), light, total, number, near = outline, work.light, 0.0, 0.0, np.zeros(5)
    for y in range(box[1], box[3], 2):
        for x in range(box[0], box[2], 2):
            fill_nearest_contour(segments, float(x), float(y), near)
            if near[0] < ball - 2.0 and not isnan(background[y, x]):
                total += image[y - window[1], x - window[0]]
                number += 1.0
    if number == 0.0 or not total > 0.0:
        return
    level = total / number
    light.level[view], light.deviation[view] = level, DEVIATION_SHARE * level
    for i in range(LIGHT_TERMS):
        light.mean[view, i] = level if i == 0 else 0.0
        light.prior_mean[view, i] = light.mean[view, i]
        for k in range(LIGHT_TERMS):
            light.information[view, i, k] = LAMP_PRIOR[i, k] / (level * level)


@inner_no_memory
def _fill_contour_row(model: PictureModel, view: int, segments: Any, near: Any, work: Workspace, row: Any) -> float:
    """Fill (6,) how the contour at a pixel moves outward with the pose [px/m, px/rad]; return how far it lies beyond that of the
    inner body [px]."""
    rig, shape, J, a = model.rig, model.shape, work.J, work.edge_gradient
    k, along = int(near[3]), near[4]
    iA, iB = int(segments[k, 8]), int(segments[k, 9])
    zA, zB = work.vertex_camera[iA, 2], work.vertex_camera[iB, 2]
    s = along * zA / ((1.0 - along) * zB + along * zA)
    cx = work.vertex_camera[iA, 0] + s * (work.vertex_camera[iB, 0] - work.vertex_camera[iA, 0])
    cy = work.vertex_camera[iA, 1] + s * (work.vertex_camera[iB, 1] - work.vertex_camera[iA, 1])
    cz = zA + s * (zB - zA)
    nx, ny = near[1], near[2]
    reach, R = 0.0, rig.rotation[view]
    for again in range(2):
        project_point(rig.matrix[view], rig.distortion[view], cx, cy, cz, J)
        ax, ay, az = nx * J[0, 0] + ny * J[1, 0], nx * J[0, 1] + ny * J[1, 1], nx * J[0, 2] + ny * J[1, 2]
        size = sqrt(ax * ax + ay * ay + az * az)
        if again == 0:
            reach = shape.radius * size
            # The point of the contour itself, on the ball.
            cx, cy, cz = cx + shape.radius * ax / size, cy + shape.radius * ay / size, cz + shape.radius * az / size
    for b in range(3):
        a[b] = R[0, b] * ax + R[1, b] * ay + R[2, b] * az
        row[b] = a[b]
    r0 = work.vertex_arm[iA, 0] + s * (work.vertex_arm[iB, 0] - work.vertex_arm[iA, 0])
    r1 = work.vertex_arm[iA, 1] + s * (work.vertex_arm[iB, 1] - work.vertex_arm[iA, 1])
    r2 = work.vertex_arm[iA, 2] + s * (work.vertex_arm[iB, 2] - work.vertex_arm[iA, 2])
    row[3], row[4], row[5] = r1 * a[2] - r2 * a[1], r2 * a[0] - r0 * a[2], r0 * a[1] - r1 * a[0]
    return reach


@inner_no_memory
def _fill_brightness(R: Any, shape: Any, f: int, hit: Any, direction: Any, mean: Any, n: Any, out: Any) -> None:
    """Fill the normal (3,) in world axes, the brightness of the surface there [grey], and its derivatives by the pose (7,).

    `hit` (6,) is the normal and, off the flat faces, the point of the inner body whose ball the ray meets, in axes of the die;
    `direction` (3,) that of the ray."""
    nf, ne = shape.normals.shape[0], shape.edges.shape[0]
    n0 = R[0, 0] * hit[0] + R[0, 1] * hit[1] + R[0, 2] * hit[2]
    n1 = R[1, 0] * hit[0] + R[1, 1] * hit[1] + R[1, 2] * hit[2]
    n2 = R[2, 0] * hit[0] + R[2, 1] * hit[1] + R[2, 2] * hit[2]
    n[0], n[1], n[2] = n0, n1, n2
    total, g0, g1, g2 = _brightness_and_gradient(mean, n0, n1, n2)
    out[0] = total
    if f < nf:
        out[1], out[2], out[3] = 0.0, 0.0, 0.0
        out[4], out[5], out[6] = n1 * g2 - n2 * g1, n2 * g0 - n0 * g2, n0 * g1 - n1 * g0
        return
    d0 = R[0, 0] * direction[0] + R[0, 1] * direction[1] + R[0, 2] * direction[2]
    d1 = R[1, 0] * direction[0] + R[1, 1] * direction[1] + R[1, 2] * direction[2]
    d2 = R[2, 0] * direction[0] + R[2, 1] * direction[1] + R[2, 2] * direction[2]
    nd = n0 * d0 + n1 * d1 + n2 * d2
    # Where the ray grazes the surface its brightness changes without bound; the contour takes over there.
    nd = min(nd, -GRAZING * sqrt(d0 * d0 + d1 * d1 + d2 * d2))
    f0 = R[0, 0] * hit[3] + R[0, 1] * hit[4] + R[0, 2] * hit[5]
    f1 = R[1, 0] * hit[3] + R[1, 1] * hit[4] + R[1, 2] * hit[5]
    f2 = R[2, 0] * hit[3] + R[2, 1] * hit[4] + R[2, 2] * hit[5]
    e0, e1, e2, ge = 0.0, 0.0, 0.0, 0.0
    if f < nf + STRIP_CELLS * ne:
        p, q = (
            shape.vertices[shape.edges[(f - nf) // STRIP_CELLS, 0]],
            shape.vertices[shape.edges[(f - nf) // STRIP_CELLS, 1]],
        )
        b0, b1, b2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        size = sqrt(b0 * b0 + b1 * b1 + b2 * b2)
        b0, b1, b2 = b0 / size, b1 / size, b2 / size
        e0 = R[0, 0] * b0 + R[0, 1] * b1 + R[0, 2] * b2
        e1 = R[1, 0] * b0 + R[1, 1] * b1 + R[1, 2] * b2
        e2 = R[2, 0] * b0 + R[2, 1] * b1 + R[2, 2] * b2
        ge = g0 * e0 + g1 * e1 + g2 * e2
        g0, g1, g2 = g0 - ge * e0, g1 - ge * e1, g2 - ge * e2
    along = (g0 * d0 + g1 * d1 + g2 * d2) / nd
    q0, q1, q2 = (along * n0 - g0) / shape.radius, (along * n1 - g1) / shape.radius, (along * n2 - g2) / shape.radius
    out[1], out[2], out[3] = q0, q1, q2
    out[4] = f1 * q2 - f2 * q1 - ge * (e1 * n2 - e2 * n1)
    out[5] = f2 * q0 - f0 * q2 - ge * (e2 * n0 - e0 * n2)
    out[6] = f0 * q1 - f1 * q0 - ge * (e0 * n1 - e1 * n0)


@inner_no_memory
def _brightness_and_gradient(mean: Any, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The polynomial of the light at a normal, and its gradient, in the order of `fill_monomials`."""
    total, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    k, a, da = np.int64(0), 1.0, 0.0
    for i in range(LIGHT_DEGREE + 1):
        b, db = 1.0, 0.0
        for j in range(LIGHT_DEGREE + 1 - i):
            c = mean[k]
            k += 1
            total += c * a * b
            gx += c * da * b
            gy += c * a * db
            if i + j < LIGHT_DEGREE:
                c = mean[k]
                k += 1
                total += c * a * b * z
                gx += c * da * b * z
                gy += c * a * db * z
                gz += c * a * b
            db = db * y + b
            b *= y
        da = da * x + a
        a *= x
    return total, gx, gy, gz


@inner_nogil
def _fill_grid(
    view: int, model: PictureModel, pose: PoseState, sampling: EdgeSampling, segments: Any, exposed_px: Any,
    work: Workspace, grid: Grid, background: Any,
) -> None:  # fmt: skip
    """Fill what every pixel shows, and how that changes with the pose."""
    rig, shape = model.rig, model.shape
    lines, count = flat_faces(shape, rig, view, pose, work)
    about, late = rays_about_centre(rig, view, pose.position), exposure_delay(rig, pose.position)
    ball, blur_px = ball_px(shape, rig, view, pose.position), sampling.blur_px
    near = np.zeros(5)
    turned = abs(exposed_px[2]) * 0.5 * max(grid.part.shape[0], grid.part.shape[1])
    widest = sqrt(exposed_px[0] ** 2 + exposed_px[1] ** 2) + turned
    far = FAR_BLURS * sqrt(blur_px * blur_px + widest * widest / 12.0)
    for i in range(grid.part.shape[0]):
        y = float(grid.y0 + i)
        for j in range(grid.part.shape[1]):
            x = float(grid.x0 + j)
            if isnan(background[grid.y0 + i, grid.x0 + j]):
                continue
            fill_nearest_contour(segments, x, y, near)
            d, nx, ny = near[0] - ball, near[1], near[2]
            if d > sampling.band_px + far:
                continue
            w, out = 1.0, grid.beyond[i, j]
            if d > -far - 1.0:
                moved = (exposed_px[0] - exposed_px[2] * (y - about[1])) * nx
                moved += (exposed_px[1] + exposed_px[2] * (x - about[0])) * ny
                sigma = sqrt(blur_px * blur_px + moved * moved / 12.0)
                d = near[0] - _fill_contour_row(model, view, segments, near, work, grid.contour[i, j])
                w = 0.5 * erfc(d / (sigma * 1.4142135623730951))
                density = exp(-0.5 * (d / sigma) ** 2) / (sigma * 2.5066282746310002)
                out[3], out[4] = density, d / sigma * density * blur_px / sigma
            out[0], out[1], out[2] = d, nx, ny
            if w > 0.5 * OUTSIDE_SHARE:
                split = 2 if -SPLIT_PX < d < 1.0 else 1
                for quarter in range(split * split):
                    du, dv = (0.0, 0.0) if split == 1 else (0.5 * (quarter % 2) - 0.25, 0.5 * (quarter // 2) - 0.25)
                    beyond = d + du * nx + dv * ny
                    inside = min(max(0.5 - split * beyond, 0.0), 1.0) if d > -SPLIT_PX else 1.0
                    # Of a piece on the contour the part within it.
                    back = max(0.5 * (beyond + 0.5 / split), 0.0)
                    if inside > 0.0:
                        at = (x + du - back * nx, y + dv - back * ny)
                        _add_point(view, model, pose, (about, late, count), lines, at, inside / (split * split), work, grid, i, j)
                total = grid.covered[i, j]
                if total == 0.0:
                    # The nearest point inside.
                    at = (x - (d + INWARD_PX) * nx, y - (d + INWARD_PX) * ny)
                    _add_point(view, model, pose, (about, late, count), lines, at, 1.0, work, grid, i, j)
                    if grid.covered[i, j] == 0.0:
                        continue
                    grid.covered[i, j], total = 0.0, 1.0
                for q in range(7):
                    grid.bright[i, j, q] /= total
                grid.share[i, j] = w
            grid.side[i, j] = int(near[3])


@inner_no_memory
def _add_point(
    view: int, model: PictureModel, pose: PoseState, about: Any, lines: Any, at: Any, weight: float, work: Workspace,
    grid: Grid, i: int, j: int,
) -> None:  # fmt: skip
    """Add the brightness of the surface at one point of a pixel, with its derivatives."""
    (centre, late, count), (x, y) = about, at
    shape, R, point = model.shape, pose.rotation, work.surface_point
    hit, direction, here = point[0:6], point[6:9], point[9:16]
    f = face_at(lines, count, x, y)
    if f == NOTHING:
        fill_ray(model.rig, view, pose, centre, late, x, y, point[16:19], direction)
        f = part_on_ray(shape, work.face_cosine, point[16:19], direction, hit)
        if f == NOTHING:
            return
    else:
        for q in range(3):
            hit[q] = shape.normals[f, q]
    _fill_brightness(R, shape, f, hit, direction, work.light.mean[view], grid.normal[i, j], here)
    for q in range(7):
        grid.bright[i, j, q] += weight * here[q]
    grid.part[i, j] = _whole_part(shape, f)
    grid.covered[i, j] += weight


@inner_no_memory
def _number_of_whole_parts(shape: Any) -> int:
    return shape.normals.shape[0] + shape.edges.shape[0] + shape.vertices.shape[0]


@inner_no_memory
def _whole_part(shape: Any, f: int) -> int:
    """The number of a part of the surface if the pieces of a strip are one part."""
    nf, ne = shape.normals.shape[0], shape.edges.shape[0]
    if f < nf:
        return f
    return nf + (f - nf) // STRIP_CELLS if f < nf + STRIP_CELLS * ne else f - (STRIP_CELLS - 1) * ne


@inner_nogil
def _solve_deviations(
    image: Any, background: Any, corner: Any, grid: Grid, view: int, noise_grey: float, work: Workspace, deviations: Any,
    shades: Any,
) -> None:  # fmt: skip
    """Solve for the deviation (parts,) [grey] of each part of the surface from the light, by pixels that show it alone, and for
    the shade (segments,) of the background beside each side of the contour; twice, the second time without marks."""
    (wx, wy), level = corner, work.light.level[view]
    deviation = DEVIATION_FACTOR * work.light.deviation[view]
    noise2 = max(noise_grey, 0.5) ** 2
    v = noise2 + (GRAIN_SHARE * level) ** 2
    for again in range(2):
        sums, number = np.zeros(len(deviations)), np.zeros(len(deviations))
        top, bottom = np.zeros(len(shades)), np.zeros(len(shades))
        for i in range(grid.part.shape[0]):
            for j in range(grid.part.shape[1]):
                k = grid.side[i, j]
                if k == NOTHING:
                    continue
                value, under = image[grid.y0 + i - wy, grid.x0 + j - wx], background[grid.y0 + i, grid.x0 + j]
                if grid.share[i, j] > PURE_SHARE:
                    part = grid.part[i, j]
                    e = value - grid.bright[i, j, 0]
                    if again == 0 or (e - deviations[part]) ** 2 < MARK_SIGMAS**2 * v:
                        sums[part] += e
                        number[part] += 1.0
                elif grid.share[i, j] < OUTSIDE_SHARE:
                    e = value - shades[k] * under
                    if again == 0 or e * e < MARK_SIGMAS**2 * noise2 + (SHADOW_SHARE * under) ** 2:
                        top[k] += under * value
                        bottom[k] += under * under
        for k in range(len(deviations)):
            deviations[k] = sums[k] / (number[k] + v / (deviation * deviation))
        tie = noise2 / SHADE_DEVIATION**2
        for k in range(len(shades)):
            shades[k] = (top[k] + tie) / (bottom[k] + tie)


@inner_nogil
def _blur_bevels(grid: Grid, deviations: Any, faces: int, blur_px: float, exposed_px: Any) -> None:
    """Add the deviations to the brightness, and blur it and its derivatives where the surface is not flat for the width of the
    blur."""
    rows, columns = grid.part.shape
    for i in range(rows):
        for j in range(columns):
            if grid.part[i, j] != NOTHING:
                grid.bright[i, j, 0] += deviations[grid.part[i, j]]
    # The pieces of a pixel have averaged over it already.
    lens = max(blur_px**2 - 1.0 / 12.0, LEAST_VARIANCE_PX2)
    xx, yy = lens + exposed_px[0] ** 2 / 12.0, lens + exposed_px[1] ** 2 / 12.0
    xy = exposed_px[0] * exposed_px[1] / 12.0
    half = min(int(SMOOTHED_BLURS * sqrt(max(xx, yy)) + 0.5), WIDEST_SMOOTHING_PX)
    det, weight = xx * yy - xy * xy, np.zeros((2 * half + 1, 2 * half + 1))
    for a in range(-half, half + 1):
        for b in range(-half, half + 1):
            weight[a + half, b + half] = exp(-0.5 * (yy * b * b - 2.0 * xy * a * b + xx * a * a) / det)
    sharp = grid.bright.copy()
    for i in range(rows):
        for j in range(columns):
            k = grid.part[i, j]
            if k == NOTHING:
                continue
            if k < faces:
                flat = True
                for a in range(-half, half + 1, max(half, 1)):
                    for b in range(-half, half + 1, max(half, 1)):
                        if 0 <= i + a < rows and 0 <= j + b < columns and grid.part[i + a, j + b] != k:
                            flat = False
                if flat:
                    continue
            total, out = 0.0, grid.bright[i, j]
            for q in range(7):
                out[q] = 0.0
            for a in range(max(-half, -i), min(half, rows - 1 - i) + 1):
                for b in range(max(-half, -j), min(half, columns - 1 - j) + 1):
                    if grid.covered[i + a, j + b] > 0.0:
                        t = weight[a + half, b + half] * grid.covered[i + a, j + b]
                        total += t
                        for q in range(7):
                            out[q] += t * sharp[i + a, j + b, q]
            for q in range(7):
                out[q] = out[q] / total if total > 0.0 else sharp[i, j, q]


@inner_nogil
def _add_pixels(
    image: Any, background: Any, corner: Any, grid: Grid, unknowns: Any, scene: Any, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add the pixels, with what parts of the surface and sides of the background deviate eliminated, and then the light."""
    (wx, wy), (deviations, shades), (view, model, sampling), light = corner, unknowns, scene, work.light
    settings, nf, parts = model.settings, model.shape.normals.shape[0], _number_of_whole_parts(model.shape)
    H, g, stats = equations.H, equations.g, equations.statistics
    level, deviation = light.level[view], DEVIATION_FACTOR * light.deviation[view]
    noise2 = max(settings.noise_grey, settings.noise_floor_grey) ** 2
    grain2 = (GRAIN_SHARE * level) ** 2
    rows, columns = grid.part.shape
    residual, cells, counted = np.zeros((rows, columns)), np.zeros(SCALE_CELLS), 0.0
    for i in range(rows):
        for j in range(columns):
            k = grid.side[i, j]
            if k == NOTHING:
                continue
            w, under = grid.share[i, j], shades[k] * background[grid.y0 + i, grid.x0 + j]
            e = image[grid.y0 + i - wy, grid.x0 + j - wx] - w * grid.bright[i, j, 0] - (1.0 - w) * under
            residual[i, j] = e
            if _is_telling(grid, i, j, nf):
                size = abs(e) / sqrt(noise2 + w * w * grain2)
                cells[min(int(size / CELL_SIGMAS), SCALE_CELLS - 1)] += 1.0
                counted += 1.0
    if counted < LEAST_PX:
        return
    scale = max(_median(cells, counted) * NORMAL_MAD, settings.noise_floor_grey / sqrt(noise2))
    icut = 1.0 / (BIWEIGHT_CUT * scale)
    shared, right = np.zeros((_ALL, _ALL)), np.zeros(_ALL)
    tie, by, left = np.zeros(parts), np.zeros((parts, _ALL)), np.zeros(parts)
    of_face = np.zeros((nf, 2))
    row, top = np.zeros(_ALL), PARAMETERS if sampling.with_blur else BLUR
    for i in range(rows):
        for j in range(columns):
            k = grid.side[i, j]
            if k == NOTHING:
                continue
            w, e, part = grid.share[i, j], residual[i, j], grid.part[i, j]
            v = noise2 + w * w * grain2
            q = e * icut / sqrt(v)
            q = max(1.0 - q * q, 0.0)
            iv = q * q / (scale * scale * v)
            telling = _is_telling(grid, i, j, nf)
            if telling:
                stats[PIXELS] += 1.0
                stats[WEIGHT_SUM] += q * q
                stats[ROBUST_COST] += 1.0 - q * q * q
                stats[LOG_NOISE] += 0.5 * log(scale * scale * v)
            under = background[grid.y0 + i, grid.x0 + j]
            if abs(grid.beyond[i, j, 0]) < 0.5:
                stats[CONTOUR_PX] += 1.0
                if _is_clear(image, (wx, wy), grid, i, j, shades[k] * under, sampling.blur_px, scale * sqrt(noise2)):
                    stats[CLEAR_PX] += 1.0
            if w == 0.0:
                continue
            if not telling:
                of_face[part, 0] += iv
                of_face[part, 1] += iv * e
                continue
            step = grid.bright[i, j, 0] - shades[k] * under
            for a in range(6):
                row[a] = step * grid.beyond[i, j, 3] * grid.contour[i, j, a] + w * grid.bright[i, j, 1 + a]
            row[CONTOUR], row[BLUR] = step * grid.beyond[i, j, 3], step * grid.beyond[i, j, 4]
            fill_monomials(grid.normal[i, j, 0], grid.normal[i, j, 1], grid.normal[i, j, 2], row[PARAMETERS:])
            for a in range(PARAMETERS, _ALL):
                row[a] *= w
            if not sampling.with_blur:
                row[BLUR] = 0.0
            _add_row(row, iv, e, shared, right)
            by_part = by[part]
            tie[part] += iv * w * w
            left[part] += iv * w * e
            for a in range(_ALL):
                by_part[a] += iv * w * row[a]
    stats[STRETCHES] += 1.0
    for f in range(nf):
        if of_face[f, 0] > 0.0:
            _fill_face_row(grid, f, row)
            _add_row(row, of_face[f, 0], of_face[f, 1] / of_face[f, 0], shared, right)
            tie[f] += of_face[f, 0]
            left[f] += of_face[f, 1]
            for a in range(_ALL):
                by[f, a] += of_face[f, 0] * row[a]
    for k in range(parts):
        prior = 1.0 / (deviation * deviation)
        if tie[k] > 0.0:
            inverse = 1.0 / (tie[k] + prior)
            for a in range(_ALL):
                t = by[k, a] * inverse
                if t != 0.0:
                    right[a] -= t * (left[k] - prior * deviations[k])
                    for b in range(a + 1):
                        shared[a, b] -= t * by[k, b]
    clear_light(view, light)
    for a in range(top):
        g[a] += right[a]
        for b in range(a + 1):
            H[a, b] += shared[a, b]
    for a in range(LIGHT_TERMS):
        light.right[view, a] = right[PARAMETERS + a]
        for b in range(a + 1):
            light.matrix[view, a, b] = shared[PARAMETERS + a, PARAMETERS + b]
        for b in range(top):
            light.coupling[view, a, b] = shared[PARAMETERS + a, b]
    eliminate_light(light, view, top, H, g)


@inner_no_memory
def _is_telling(grid: Grid, i: int, j: int, faces: int) -> bool:
    """Whether a pixel shows a bevel or the contour."""
    w = grid.share[i, j]
    return w > 0.0 and (w < PURE_SHARE or grid.part[i, j] >= faces)


@inner_no_memory
def _median(cells: Any, counted: float) -> float:
    """The median of a histogram of sizes, in standard deviations."""
    below = 0.0
    for k in range(cells.shape[0]):
        if below + cells[k] >= 0.5 * counted:
            return float((k + (0.5 * counted - below) / cells[k]) * CELL_SIGMAS)
        below += cells[k]
    return float(cells.shape[0] * CELL_SIGMAS)


@inner_no_memory
def _is_clear(
    image: Any, corner: Any, grid: Grid, i: int, j: int, under: float, blur_px: float, noise: float
) -> bool:  # fmt: skip
    """Whether the picture has the predicted step across the contour at a pixel on it."""
    away = STEP_PX + blur_px
    x, y = grid.x0 + j - corner[0], grid.y0 + i - corner[1]
    nx, ny, d = grid.beyond[i, j, 1], grid.beyond[i, j, 2], grid.beyond[i, j, 0]
    x1, y1 = int(x - (d + away) * nx + 0.5), int(y - (d + away) * ny + 0.5)
    x2, y2 = int(x - (d - away) * nx + 0.5), int(y - (d - away) * ny + 0.5)
    height, width = image.shape
    if min(x1, y1, x2, y2) < 0 or max(x1, x2) >= width or max(y1, y2) >= height:
        return False
    seen, step = image[y1, x1] - image[y2, x2], grid.bright[i, j, 0] - under
    return seen * step > 0.0 and abs(seen) > max(CLEAR_SIGMAS * noise, CLEAR_PART * abs(step))


@inner_no_memory
def _fill_face_row(grid: Grid, f: int, row: Any) -> None:
    """Fill the derivatives (_ALL,) of the pixels that show a flat face alone: of the first that does."""
    for a in range(PARAMETERS):
        row[a] = 0.0
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            if grid.part[i, j] == f and grid.share[i, j] >= PURE_SHARE:
                for a in range(6):
                    row[a] = grid.bright[i, j, 1 + a]
                fill_monomials(grid.normal[i, j, 0], grid.normal[i, j, 1], grid.normal[i, j, 2], row[PARAMETERS:])
                return


@inner_no_memory
def _add_row(row: Any, iv: float, e: float, shared: Any, right: Any) -> None:
    """Add one residual `e` of information `iv` to the equations (lower half)."""
    for a in range(row.shape[0]):
        t = iv * row[a]
        right[a] += t * e
        into = shared[a]
        for b in range(a + 1):
            into[b] += t * row[b]
