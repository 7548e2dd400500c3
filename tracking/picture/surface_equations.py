"""The normal equations of a well-rounded die: every pixel of its picture against the one that its pose predicts.

On a die with wide bevels little of the surface is flat, corners are balls, and a contour lies beside a surface whose
brightness changes over a few pixels. The edges of such a die taken one by one (`edge_stretch`) leave the brightness beside
each of them free, which hides where it is. Here one light is on all of the picture (`placed_die.surface_picture`), with a
deviation δ of each part of the surface and a shade γ of the background beside each piece of the contour. Both are solved for
at each step, by pixels that show them alone, and δ is eliminated from the equations. The coefficients of the light are
unknowns of the picture, eliminated as those of edges are.

**Robust weights.** Tukey's biweight, with a scale from the residuals of all bevels and contours of the picture, leaves out
marks, highlights and what stands in the way. Flat faces say nothing about the pose but through their brightness, which all
of their pixels share: their pixels are added up before they enter the equations.

**Saturation.** A pixel at full scale says "at least this bright": where as much or more is predicted it counts as explained and
says nothing else, and where less is, it counts as any other. How bright a saturated face is then follows from its contour and
the light.

**Correlation.** What the model does not know of a surface (highlights, texture, codecs) is smooth, so that residuals beside
each other are alike. A picture with the correlations ρ_x and ρ_y of neighbours says as much as one of independent residuals
that has (1 - ρ_x)(1 - ρ_y)/((1 + ρ_x)(1 + ρ_y)) times the pixels, and the equations are scaled by that.
"""

from __future__ import annotations

from math import erf, floor, isnan, log, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner, inner_no_memory, inner_nogil
from ..placed_die import (
    BLUR,
    CLEAR_PX,
    CONTOUR,
    CONTOUR_PX,
    EXPECTED_CLEAR_PX,
    LIGHT_TERMS,
    LOG_NOISE,
    NO_LIGHT,
    NOTHING,
    PARAMETERS,
    PIXELS,
    RESPONSE,
    ROBUST_COST,
    SMALLEST_WINDOW_PX,
    STRETCHES,
    WEIGHT_SUM,
    EdgeSampling,
    FrameWindows,
    NormalEquations,
    PictureModel,
    PoseState,
    RefinementSettings,
    SurfaceGrid,
    Workspace,
    ball_px,
    blur_of_pixels,
    cholesky_factor,
    clear_light,
    contour_segments,
    draw_surface,
    eliminate_light,
    fill_blurred_row,
    fill_changes,
    fill_nearest_contour,
    lamps_anywhere,
    new_surface_grid,
    pixels_about,
    place_die,
    solve_factored,
    used_columns,
)
from .edge_equations import add_edge_equations
from .edge_stretch import (
    BIWEIGHT_CUT,
    CLEAR_SIGMAS,
    LEAST_FILE_NOISE,
    MIXED_SHARE,
    NORMAL_MAD,
    file_residual,
    response_slope,
)
from .region_cost import DIFFERENT_SIGMAS, FACE_SHADING, FACE_SIGMAS, SHADOW_SQUARED_SIGMAS_CUT, SQUARED_SIGMAS_CUT
from .shade import (
    LEAST_NOISE_GREY,
    MARK_SIGMAS,
    OUTSIDE_SHARE,
    REWEIGHTINGS,
    distance_seen_px,
    eliminate_shades,
    shade_at,
    shade_slope,
    solve_shades,
)
from .stretch_sums import SATURATED_PART, median_size, robust_scale

PURE_SHARE = 0.98
"""Share of the die behind a pixel from which it shows a part of the surface alone."""
GRAIN_SHARE = 0.02
"""Standard deviation of grain, as a share of the mean brightness, which the scale of the residuals multiplies."""
DEVIATION_FACTOR = 1.6
"""Deviation of a part of the surface from the light, over that which the light states: highlights on bevels."""
SCALE_CELLS = 128
"""Cells of the histogram from which the median of residuals is found."""
CELL_SIGMAS = 0.0625
"""Width of one of them, in standard deviations; larger residuals go into the last."""
STEP_PX = 1.5
"""Distance from the contour, beyond a blur, at which a clear step is looked for on both sides."""
STEP_DEPTHS = 3
"""Depths, evenly spaced up to that distance, at which it is looked for within the contour."""
CLEAR_PART = 0.3
"""Share of the predicted step that must be seen for it to be clear."""
LEAST_CHANCE = 0.5
"""Least count of a pixel of the contour that may be clear. Others count with their chance to be: on a table as bright as a face a
true pose shows a third of its contour. With less, the few clear pixels of a pose on the bare table weigh too much."""
WITHIN_DIE_PX = 2.0
"""Depth within the contour from which pixels give the mean grey of the die."""
LEAST_PX = 30.0
"""Pixels of bevels and contour below which nothing is said."""
LARGEST_RESIDUAL_GREY = 1e9
"""A larger residual is none of a picture: the light has diverged."""
SHOWN_PARTS = 8
"""Most parts of the surface whose deviations one pixel is taken to show."""
LEAST_PART_PIVOT = 1e-13
"""Part of its diagonal that a pivot of their equations keeps at the least."""
MOST_CORRELATION = 0.9
"""Largest correlation of neighbours that is believed."""

_ALL = PARAMETERS + LIGHT_TERMS
"""Unknowns that all pixels share: those of the equations, then the light."""


@inner(nogil=True, shared=True)
def add_picture_equations(
    view: int, windows: FrameWindows, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add what the picture of one view says about a pose to the normal equations, H (lower half) and g, and to the
    statistics: its edges one by one, or its whole surface (`compares_surface`)."""
    if compares_surface(view, model, pose):
        add_surface_equations(view, windows, model, pose, sampling, work, equations)
    else:
        add_edge_equations(view, windows, model, pose, sampling, work, equations)


@inner_no_memory
def compares_surface(view: int, model: PictureModel, pose: PoseState) -> bool:
    """Whether the whole surface is compared in a view, and not edges: of a die rounded by `surface_from_px` or more, unless it is
    seen in a mirror, or bevels may have any shade."""
    shape, rig = model.shape, model.rig
    if not (shape.radius > 0.0 and rig.partner[view] < 0 and model.settings.light.level[view] != NO_LIGHT):
        return False
    return bool(ball_px(shape, rig, view, pose.position) > model.settings.surface_from_px)


@inner(nogil=True, shared=True)
def add_surface_equations(
    view: int, windows: FrameWindows, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add all pixels of one view of a rounded die to the normal equations, H (lower half) and g, and to the statistics."""
    rig, shape, light = model.rig, model.shape, work.light
    light.solved[view] = 0
    light.surface_cost[view] = 0.0
    if not place_die(shape, rig, view, pose, work):
        return
    camera = rig.camera[view]
    image, background = windows.pixels[camera], model.backgrounds[camera]
    wx, wy = windows.corner[camera, 0], windows.corner[camera, 1]
    window = (wx, wy, wx + windows.size[camera, 0], wy + windows.size[camera, 1])
    box = pixels_about(work.vertex_px, ball_px(shape, rig, view, pose.position) + sampling.band_px, window)
    if min(box[2] - box[0], box[3] - box[1]) < SMALLEST_WINDOW_PX:
        return
    if not light.level[view] > 0.0:
        _begin_light(view, model, pose, image, window, box, work)
        if not light.level[view] > 0.0:
            return
    grid = new_surface_grid(box)
    pieces = fill_changes(view, model, pose, sampling, background, work, grid)
    draw_surface(view, model, pose, sampling, work, grid)
    shades, residual = np.zeros((pieces, 2)), np.zeros(grid.part.shape)
    shades[:, 0] = 1.0
    corner = (wx, wy)
    settings = model.settings
    of_clip = (view, settings.noise_grey, settings.saturation_grey)
    _solve_deviations(image, corner, grid, of_clip, work)
    slope = shade_slope(model, view, pose.position, pose.position[2])
    known = solve_shades(image, background, corner, grid, (settings.noise_grey, sampling.blur_px, slope), shades)
    limits = (settings.saturation_grey, sampling.blur_px)
    if _fill_residuals(image, background, corner, grid, shades, limits, residual):
        _add_pixels(
            image, background, corner, grid, (shades, known, residual), (view, model, pose, sampling), work, equations
        )


@inner_nogil
def _begin_light(
    view: int, model: PictureModel, pose: PoseState, image: Any, window: Any, box: Any, work: Workspace
) -> None:
    """Begin with the mean grey of the die, and lamps anywhere."""
    ball, background = ball_px(model.shape, model.rig, view, pose.position), model.backgrounds[model.rig.camera[view]]
    segments, total, number, near = contour_segments(model.shape, work), 0.0, 0.0, np.zeros(5)
    for y in range(box[1], box[3], 2):
        for x in range(box[0], box[2], 2):
            fill_nearest_contour(segments, float(x), float(y), near)
            if near[0] < ball - WITHIN_DIE_PX and not isnan(background[y, x]):
                total += image[y - window[1], x - window[0]]
                number += 1.0
    if number == 0.0 or not total > 0.0:
        return
    lamps_anywhere(view, work.light, total / number)


@inner_nogil
def _solve_deviations(image: Any, corner: Any, grid: SurfaceGrid, of_clip: Any, work: Workspace) -> None:
    """Solve for the deviation of each part of the surface from the light, by pixels that show it alone, with Cauchy's weights:
    marks may cover half of a flat face. What the deviations change is added to the glow of pixels."""
    (wx, wy), (view, noise_grey, saturation), light = corner, of_clip, work.light
    level, deviation, before = light.level[view], DEVIATION_FACTOR * light.deviation[view], light.part_deviation[view]
    v = max(noise_grey, LEAST_NOISE_GREY) ** 2 + (GRAIN_SHARE * level) ** 2
    # After the first step of a picture the equations have solved for the deviations, together with the pose.
    change, first = np.zeros(before.shape[0]), light.part_matrix[view, 0, 0] == 0.0
    if first:
        _fill_median_changes(image, corner, grid, level, change)
    for _ in range(REWEIGHTINGS if first else 0):
        sums, number = np.zeros(len(change)), np.zeros(len(change))
        for i in range(grid.part.shape[0]):
            for j in range(grid.part.shape[1]):
                part = grid.part[i, j]
                if grid.side[i, j] != NOTHING and grid.share[i, j] > PURE_SHARE and part != NOTHING:
                    value = image[grid.y0 + i - wy, grid.x0 + j - wx]
                    e = value - grid.glow[i, j]
                    if value >= saturation and e < change[part]:
                        continue
                    weight = 1.0 / (1.0 + (e - change[part]) ** 2 / (MARK_SIGMAS * MARK_SIGMAS * v))
                    sums[part] += weight * e
                    number[part] += weight
        for k in range(len(change)):
            tied = v / (deviation * deviation)
            change[k] = (sums[k] - tied * before[k]) / (number[k] + tied)
    for k in range(len(change)):
        before[k] += change[k]
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            if grid.part[i, j] != NOTHING:
                grid.glow[i, j] += grid.share[i, j] * change[grid.part[i, j]]
                grid.bright[i, j] += change[grid.part[i, j]]


@inner_nogil
def _fill_median_changes(image: Any, corner: Any, grid: SurfaceGrid, level: float, change: Any) -> None:
    """Fill by how much the pixels that show a part of the surface alone lie above the light (parts,) [grey], by their median.

    Where the light is hardly known, weights about it would take the marks of a dark face for the face: they are nearer to the
    mean grey of the die."""
    parts, e = grid.part.shape, 0.0
    counts, begins, values = np.zeros(len(change), np.int64), np.zeros(len(change), np.int64), np.empty(grid.part.size)
    for filling in range(2):
        for i in range(parts[0]):
            for j in range(parts[1]):
                part = grid.part[i, j]
                if grid.side[i, j] != NOTHING and grid.share[i, j] > PURE_SHARE and part != NOTHING:
                    if filling == 1:
                        e = image[grid.y0 + i - corner[1], grid.x0 + j - corner[0]] - grid.glow[i, j]
                        values[begins[part] + counts[part]] = max(e + level, 0.0)
                    counts[part] += 1
        if filling == 0:
            for k in range(1, len(change)):
                begins[k] = begins[k - 1] + counts[k - 1]
            counts[:] = 0
    for k in range(len(change)):
        if counts[k] > 0:
            change[k] = median_size(values[begins[k] : begins[k] + counts[k]], counts[k]) - level


@inner_nogil
def _fill_residuals(
    image: Any, background: Any, corner: Any, grid: SurfaceGrid, shades: Any, limits: Any, residual: Any
) -> bool:
    """Fill what the picture differs from the predicted one (rows, columns) [grey], 0 for a saturated pixel that is predicted to
    be as bright or brighter; false if the prediction is none."""
    saturation, blur_px = limits
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            k = grid.side[i, j]
            if k != NOTHING:
                under = shade_at(grid, shades, i, j, blur_px) * background[grid.y0 + i, grid.x0 + j]
                value = image[grid.y0 + i - corner[1], grid.x0 + j - corner[0]]
                residual[i, j] = value - grid.glow[i, j] - (1.0 - grid.share[i, j]) * under
                if not abs(residual[i, j]) < LARGEST_RESIDUAL_GREY:
                    return False
                if value >= saturation and residual[i, j] < SATURATED_PART * saturation:
                    residual[i, j] = 0.0
    return True


@inner_nogil
def _add_pixels(
    image: Any, background: Any, corner: Any, grid: SurfaceGrid, solved: Any, scene: Any, work: Workspace,
    equations: NormalEquations,
) -> None:  # fmt: skip
    """Add the pixels, with the shades and what parts of the surface deviate eliminated, and then the light."""
    (shades, known, residual), (view, model, pose, sampling), light = solved, scene, work.light
    level, cost = light.level[view], light.surface_cost[view]
    settings, nf, deviations = model.settings, model.shape.normals.shape[0], light.part_deviation[view]
    parts = deviations.shape[0]
    H, g, stats = equations.H, equations.g, equations.statistics
    deviation, grain2 = DEVIATION_FACTOR * light.deviation[view], (GRAIN_SHARE * level) ** 2
    noise2 = max(settings.noise_grey, settings.noise_floor_grey) ** 2
    scale = _scale_of_residuals(grid, residual, (noise2, grain2), nf)
    if scale == 0.0:
        return
    scale = max(scale, settings.noise_floor_grey / sqrt(noise2))
    independent = _independent_share(grid, residual, (noise2 * scale * scale, grain2 * scale * scale), nf)
    shared, right = np.zeros((_ALL, _ALL)), np.zeros(_ALL)
    tie, by, left, of_face = np.zeros((parts, parts)), np.zeros((parts, _ALL)), np.zeros(parts), np.zeros((nf, 2))
    shade_by, shade_parts = np.zeros((len(shades), 2, _ALL)), np.zeros((len(shades), 2, parts))
    shade_left, effect = np.zeros((len(shades), 2)), np.zeros(2)
    known *= independent
    row, top = np.zeros(_ALL), used_columns(sampling)
    blur = blur_of_pixels(view, model, pose, sampling.blur_px)
    slope, shown, shares = np.zeros(3 + LIGHT_TERMS), np.zeros(SHOWN_PARTS, np.int64), np.zeros(SHOWN_PARTS)
    limits = (sampling.blur_px, scale * sqrt(noise2))
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            k = grid.side[i, j]
            if k == NOTHING:
                continue
            w, e, part = grid.share[i, j], residual[i, j], grid.part[i, j]
            under = shade_at(grid, shades, i, j, sampling.blur_px) * background[grid.y0 + i, grid.x0 + j]
            seen = image[grid.y0 + i - corner[1], grid.x0 + j - corner[0]]
            _add_cost(e, w, seen - under, (settings.noise_grey, level), cost)
            if seen >= settings.saturation_grey and e == 0.0:
                continue
            v = scale * scale * (noise2 + w * w * grain2)
            q = max(1.0 - e * e / (BIWEIGHT_CUT * BIWEIGHT_CUT * v), 0.0)
            iv = independent * q * q / v
            telling = _is_telling(grid, i, j, nf)
            if telling:
                stats[PIXELS] += 1.0
                stats[WEIGHT_SUM] += q * q
                stats[ROBUST_COST] += 1.0 - q * q * q
                stats[LOG_NOISE] += 0.5 * log(v) if settings.response == 0.0 else 0.0
            if abs(grid.beyond[i, j, 0]) < 0.5:
                is_clear, chance = _is_clear(image, background, corner, grid, (i, j), shades[k, 0], limits)
                stats[CONTOUR_PX] += 1.0
                stats[EXPECTED_CLEAR_PX] += max(chance, LEAST_CHANCE)
                if is_clear:
                    stats[CLEAR_PX] += 1.0
            if part == NOTHING or not w > 0.0:
                continue
            if not telling:
                of_face[part, 0] += iv
                of_face[part, 1] += iv * e
                continue
            if q == 0.0:
                continue
            step = grid.bright[i, j] - under
            count = fill_blurred_row(grid, i, j, blur, slope, shown, shares)
            gx = grid.gradient[i, j, 0] - under * grid.gradient[i, j, 2]
            gy = grid.gradient[i, j, 1] - under * grid.gradient[i, j, 3]
            for a in range(6):
                row[a] = -gx * grid.flow[i, j, 0, a] - gy * grid.flow[i, j, 1, a]
            for a in range(3):
                row[3 + a] += slope[a]
            row[CONTOUR] = step * grid.beyond[i, j, 3]
            row[BLUR] = step * grid.beyond[i, j, 4] if sampling.with_blur else 0.0
            die_grey = grid.glow[i, j] / max(w, MIXED_SHARE)
            row[RESPONSE] = response_slope(w, die_grey, under) if sampling.with_response else 0.0
            for a in range(LIGHT_TERMS):
                row[PARAMETERS + a] = slope[3 + a]
            _add_row(row, iv, e, shared, right)
            for k in range(count):
                f, t = shown[k], iv * shares[k]
                left[f] += t * e
                for q in range(count):
                    tie[f, shown[q]] += t * shares[q]
                for a in range(_ALL):
                    by[f, a] += t * row[a]
            effect[0] = (1.0 - w) * background[grid.y0 + i, grid.x0 + j]
            effect[1] = effect[0] * distance_seen_px(grid.beyond[i, j, 0], sampling.blur_px)
            known[k, 0] += iv * effect[0] * effect[0]
            known[k, 1] += iv * effect[0] * effect[1]
            known[k, 2] += iv * effect[1] * effect[1]
            for b in range(2):
                t = iv * effect[b]
                shade_left[k, b] += t * e
                for a in range(_ALL):
                    shade_by[k, b, a] += t * row[a]
                for q in range(count):
                    shade_parts[k, b, shown[q]] += t * shares[q]
    stats[STRETCHES] += 1.0
    if settings.response > 0.0:
        stats[LOG_NOISE] += _file_log_noise(image, corner, grid, residual, settings, nf)
    for f in range(nf):
        if of_face[f, 0] > 0.0 and _fill_face_row(grid, f, row):
            _add_row(row, of_face[f, 0], of_face[f, 1] / of_face[f, 0], shared, right)
            tie[f, f] += of_face[f, 0]
            left[f] += of_face[f, 1]
            for a in range(_ALL):
                by[f, a] += of_face[f, 0] * row[a]
    eliminate_shades((known, shade_by, shade_parts, shade_left), (tie, by, left), shared, right)
    if not _eliminate_deviations(view, light, 1.0 / (deviation * deviation), (tie, by, left), shared, right):
        return
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


@inner_nogil
def _eliminate_deviations(view: int, light: Any, prior: float, of_parts: Any, shared: Any, right: Any) -> bool:
    """Eliminate what the parts of the surface deviate from the light, of information `prior` each, from the equations of the
    others: their normal matrix, coupling and right side are `of_parts`. These are kept, for the step that follows."""
    tie, by, left = of_parts
    parts, column = left.shape[0], np.zeros(left.shape[0])
    for k in range(parts):
        tie[k, k] += prior
        left[k] -= prior * light.part_deviation[view, k]
        light.part_right[view, k] = left[k]
        for a in range(_ALL):
            light.part_coupling[view, k, a] = by[k, a]
    L = light.part_matrix[view]
    if not cholesky_factor(tie, parts, L, LEAST_PART_PIVOT):
        L[0, 0] = 0.0
        return False
    solved = np.zeros((_ALL, parts))
    for a in range(_ALL):
        for k in range(parts):
            column[k] = by[k, a]
        solve_factored(L, parts, column, solved[a])
    for a in range(_ALL):
        for k in range(parts):
            t = solved[a, k]
            if t != 0.0:
                right[a] -= t * left[k]
                for b in range(a + 1):
                    shared[a, b] -= t * by[k, b]
    return True


@inner_no_memory
def _add_cost(e: float, w: float, difference: float, scene: Any, cost: Any) -> None:
    """Add a pixel to the region cost (4,) of the pose: its residual, the share of the die behind it, and its difference
    from the background [grey]."""
    noise, level = scene
    variance = noise * noise * (1.0 + w * (FACE_SIGMAS * FACE_SIGMAS - 1.0)) + (w * FACE_SHADING * level) ** 2
    cut = SHADOW_SQUARED_SIGMAS_CUT if w < OUTSIDE_SHARE and e < 0.0 else SQUARED_SIGMAS_CUT
    cost[0] += min(e * e / variance, cut)
    cost[1] += 1.0
    if w > PURE_SHARE:
        cost[2] += 1.0
        if abs(difference) > DIFFERENT_SIGMAS * noise:
            cost[3] += 1.0


@inner_no_memory
def _is_telling(grid: SurfaceGrid, i: int, j: int, faces: int) -> bool:
    """Whether a pixel shows a bevel or the contour."""
    w = grid.share[i, j]
    return w > 0.0 and (w < PURE_SHARE or grid.part[i, j] >= faces)


@inner_nogil
def _scale_of_residuals(grid: SurfaceGrid, residual: Any, noise: Any, faces: int) -> float:
    """Standard deviation of residuals of bevels and contours by their median, over that of noise and grain; 0 if there are
    too few of them."""
    cells, counted = np.zeros(SCALE_CELLS), 0.0
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            if grid.side[i, j] != NOTHING and _is_telling(grid, i, j, faces) and residual[i, j] != 0.0:
                size = abs(residual[i, j]) / sqrt(noise[0] + grid.share[i, j] ** 2 * noise[1])
                cells[int(min(size / CELL_SIGMAS, SCALE_CELLS - 1.0))] += 1.0
                counted += 1.0
    if counted < LEAST_PX:
        return 0.0
    below = 0.0
    for k in range(SCALE_CELLS):
        if below + cells[k] >= 0.5 * counted:
            return NORMAL_MAD * (k + (0.5 * counted - below) / cells[k]) * CELL_SIGMAS
        below += cells[k]
    return NORMAL_MAD * SCALE_CELLS * CELL_SIGMAS


@inner_nogil
def _file_log_noise(
    image: Any, corner: Any, grid: SurfaceGrid, residual: Any, settings: RefinementSettings, faces: int
) -> float:
    """Sum over bevels and contours of the logarithm of their noise in the file's grey levels."""
    sizes, n = np.zeros(residual.size), 0
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            if grid.side[i, j] != NOTHING and _is_telling(grid, i, j, faces) and residual[i, j] != 0.0:
                value = image[grid.y0 + i - corner[1], grid.x0 + j - corner[0]]
                sizes[n] = abs(file_residual(value, residual[i, j], settings))
                n += 1
    scale = max(NORMAL_MAD * median_size(sizes, n), LEAST_FILE_NOISE) if n > 0 else 1.0
    return n * log(max(robust_scale(n, 1.0 / (BIWEIGHT_CUT * scale), sizes), LEAST_FILE_NOISE)) if n > 0 else 0.0


@inner_nogil
def _independent_share(grid: SurfaceGrid, residual: Any, noise: Any, faces: int) -> float:
    """The share of pixels of bevels and contours that would say as much if their residuals were independent."""
    squares, along_x, along_y, count, count_x, count_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    r = residual.copy()
    for i in range(r.shape[0]):
        for j in range(r.shape[1]):
            r[i, j] = 0.0
            if grid.side[i, j] != NOTHING and _is_telling(grid, i, j, faces):
                t = residual[i, j] / sqrt(noise[0] + grid.share[i, j] ** 2 * noise[1])
                if abs(t) < BIWEIGHT_CUT and t != 0.0:
                    r[i, j] = t
                    squares += t * t
                    count += 1.0
                    if i > 0 and r[i - 1, j] != 0.0:
                        along_y += t * r[i - 1, j]
                        count_y += 1.0
                    if j > 0 and r[i, j - 1] != 0.0:
                        along_x += t * r[i, j - 1]
                        count_x += 1.0
    if min(count_x, count_y) < LEAST_PX:
        return 1.0
    x = min(max(along_x / count_x * count / squares, 0.0), MOST_CORRELATION)
    y = min(max(along_y / count_y * count / squares, 0.0), MOST_CORRELATION)
    return (1.0 - x) * (1.0 - y) / ((1.0 + x) * (1.0 + y))


@inner_no_memory
def _is_clear(
    image: Any, background: Any, corner: Any, grid: SurfaceGrid, pixel: Any, shade: float, limits: Any
) -> tuple[bool, float]:
    """Whether the picture has the predicted step across the contour at a pixel on it, and the chance of that among the noise if
    the prediction is right. It is looked for where it is largest: a bevel may turn dark only within a pixel of its limb."""
    (i, j), (blur_px, noise) = pixel, limits
    away = STEP_PX + blur_px
    nx, ny, d = grid.beyond[i, j, 1], grid.beyond[i, j, 2], grid.beyond[i, j, 0]
    rows, columns = grid.part.shape
    i2, j2 = floor(i - (d - away) * ny + 0.5), floor(j - (d - away) * nx + 0.5)
    if min(i2, j2) < 0 or i2 >= rows or j2 >= columns:
        return False, 1.0
    seen, step = 0.0, 0.0
    seen2, expected2 = _unlike_background(image, background, corner, grid, (i2, j2), shade)
    for k in range(STEP_DEPTHS):
        depth = away * (k + 1.0) / STEP_DEPTHS
        i1, j1 = floor(i - (d + depth) * ny + 0.5), floor(j - (d + depth) * nx + 0.5)
        if min(i1, j1) < 0 or i1 >= rows or j1 >= columns:
            continue
        seen1, expected1 = _unlike_background(image, background, corner, grid, (i1, j1), shade)
        if abs(expected1 - expected2) > abs(step):
            seen, step = seen1 - seen2, expected1 - expected2
    least = max(CLEAR_SIGMAS * noise, CLEAR_PART * abs(step))
    # The step is the difference of two pixels, with √2 times the noise of one.
    chance = 0.5 + 0.5 * erf((abs(step) - least) / (2.0 * noise))
    return seen * step > 0.0 and abs(seen) > least, chance


@inner_no_memory
def _unlike_background(
    image: Any, background: Any, corner: Any, grid: SurfaceGrid, pixel: Any, shade: float
) -> tuple[float, float]:
    """How much a pixel differs from the shaded background [grey], seen and predicted."""
    i, j = pixel
    under = shade * background[grid.y0 + i, grid.x0 + j]
    return (
        image[grid.y0 + i - corner[1], grid.x0 + j - corner[0]] - under,
        grid.glow[i, j] - grid.share[i, j] * under,
    )


@inner_no_memory
def _fill_face_row(grid: SurfaceGrid, f: int, row: Any) -> bool:
    """Fill the derivatives (_ALL,) of the pixels that show a flat face alone: of the first that does."""
    for a in range(PARAMETERS):
        row[a] = 0.0
    for i in range(grid.part.shape[0]):
        for j in range(grid.part.shape[1]):
            if grid.part[i, j] == f and grid.share[i, j] >= PURE_SHARE:
                for a in range(3):
                    row[3 + a] = grid.slope[i, j, a]
                for a in range(LIGHT_TERMS):
                    row[PARAMETERS + a] = grid.slope[i, j, 3 + a]
                return True
    return False


@inner_no_memory
def _add_row(row: Any, iv: float, e: float, shared: Any, right: Any) -> None:
    """Add one residual `e` of information `iv` to the equations (lower half)."""
    for a in range(row.shape[0]):
        t = iv * row[a]
        right[a] += t * e
        into = shared[a]
        for b in range(a + 1):
            into[b] += t * row[b]
