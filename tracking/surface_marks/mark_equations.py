"""Normal equations of a pose from the pixels inside a die's faces, and the Gauss-Newton refinement on them.

With D the ray of a pixel in world axes, n the normal of a face, e an axis of the face, and r the point of the die
that the pixel shows, counted from the die's centre: a pose increment (δp, δθ) moves that point by q = δp + δθ × r,
and the face coordinate under the pixel by δa = s·q with s = (e·D)/(n·D) n - e. The derivative of the texture under
the pixel is therefore t = T_a s_a + T_b s_b by position, and r × t by rotation.

The light of each face is eliminated by a Schur complement (variable projection). Pixels are compared where they are,
never resampled, so their noise stays independent.
"""

from __future__ import annotations

from math import ceil, floor, hypot
from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled, inner_fast_sums
from ..picture import PoseState, solve_factored, solve_positive
from .face_geometry import (
    drift_of_rows,
    drifted_face,
    exposure_shrink,
    face_in_camera,
    face_outline,
    largest_move_px,
    motion_reach_px,
    row_on_face,
    turn_to_world,
    turned_by,
)
from .face_light import fit_light, light_sums, relative_slopes
from .kernel_types import (
    ALL_LIGHT,
    CONVERGED_GAIN,
    CONVERGED_PX,
    FEWEST_PIXELS,
    FIRST_GRADIENT,
    FLAT_DECIMATION,
    LEAST_VIEW_COSINE,
    LIGHT_COEFFICIENTS,
    LIGHT_GRADIENT_SIGMA,
    MOST_OCCLUDED,
    NEGLIGIBLE_BLUR_TEXEL2,
    OVERRELAXATION,
    POSE_PARAMETERS,
    REFINING_ITERATIONS,
    TEXTURE_KNOWN,
    WARPS,
    WITHOUT_WARPS,
    WORKSPACE_PIXELS,
    ZERO,
    Faces,
    Frame,
    Optics,
    Workspace,
    new_workspace,
)
from .texture_blur import blur_on_face, blur_texture, relative_blur, spline_laplacian, spline_with_slopes

GAUSS_NEWTON_STEPS = 4
"""Most steps of a refinement; from a flight the first one comes within a hundredth of a pixel of the solution."""
SCALE_CEILING = 2.0
"""Ceiling of a frame's noise scale over the face's usual one."""
RELATIVE_DAMPING = 1e-12
"""Added to the diagonal of a pose's normal equations as a share of it: their columns are in metres and in radians."""


class MarkEquations(NamedTuple):
    """Normal equations of one frame."""

    H: Any
    """(6, 6) information of the pose increment."""
    g: Any
    """(6,) right side."""
    warps: Any
    """(faces, WARPS, 6 + WARPS + 1) for the warps of each face's texture, the rows of their normal matrix: by pose (6),
    by themselves, and the right side."""
    stats: Any
    """(faces, 3) pixels in view, pixels used, and noise [grey]."""


class RefinedRows(NamedTuple):
    """Frames that are refined on marks and edges together, one row each."""

    position: Any
    """(m, 3) [m], start and result."""
    rotation: Any
    """(m, 3, 3) body to world, start and result."""
    velocity: Any
    """(m, 3) [m/s]"""
    omega: Any
    """(m, 3) [rad/s], world axes."""
    edge_information: Any
    """(m, 6, 6) of the edges."""
    edge_gradient: Any
    """(m, 6) that information times the edges' pose minus the start."""
    mark_information: Any
    """(m, 6, 6) result: of the marks alone; zero where no marked face is in view, whose pose stays."""


@compiled(nogil=True)
def mark_equations(
    frame: Frame, optics: Optics, faces: Faces, with_warps: bool, workspace: Workspace, equations: MarkEquations
) -> None:
    """Fill the normal equations of the pose increment from the marks of every face in view.

    Without `with_warps`, `equations.warps` is left alone and its time saved.
    """
    image, x0, y0 = frame.image, frame.x0, frame.y0
    H, g, warps, stats = equations.H, equations.g, equations.warps, equations.stats
    H[:] = 0.0
    g[:] = 0.0
    if with_warps:
        warps[:] = 0.0
    N = 6 + WARPS if with_warps else 6
    stats[:] = 0.0
    K, Rcw, tcw, texel = optics.matrix, optics.rotation, optics.translation, faces.texel
    position, R, velocity, omega = frame.pose
    offsets, corners, counts = faces.offsets, faces.corners, faces.counts
    height, width = image.shape
    n = faces.coefficients.shape[1]
    half = 0.5 * (n - 1)
    E, origin = np.zeros((3, 3)), np.zeros(3)
    most = corners.shape[1]
    px, planes = np.zeros((most, 2)), np.zeros((most, 3))
    relative, lens_blur, motion = np.zeros(3), np.zeros(3), np.zeros(3)
    grey, texture, steep = workspace.grey, workspace.texture, workspace.steep
    slope, ray, by_blur, line = workspace.slope, workspace.ray, workspace.by_blur, workspace.line
    c, A = np.zeros(LIGHT_COEFFICIENTS), np.zeros((LIGHT_COEFFICIENTS, LIGHT_COEFFICIENTS))
    face_H, face_g, light_cross = np.zeros((N, N)), np.zeros(N), np.zeros((N, LIGHT_COEFFICIENTS))
    eliminated = np.zeros(LIGHT_COEFFICIENTS)
    shrink, inverse_shrink, centre, scaled_centre = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    exposure_shrink(Rcw, omega, optics.exposure, shrink)
    drift, rolling = drift_of_rows(optics, frame.pose), optics.row_s != 0.0
    E_then, origin_then = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        centre[i] = tcw[i] + Rcw[i, 0] * position[0] + Rcw[i, 1] * position[1] + Rcw[i, 2] * position[2]
        for j in range(3):
            # S⁻¹ to first order: the second is 1e-7.
            inverse_shrink[i, j] = (2.0 if i == j else 0.0) - shrink[i, j]
    for i in range(3):
        scaled_centre[i] = (
            inverse_shrink[i, 0] * centre[0] + inverse_shrink[i, 1] * centre[1] + inverse_shrink[i, 2] * centre[2]
        )
    for f in range(faces.axes.shape[0]):
        if faces.usual_grey[f] <= 0.0:
            continue
        coefficients, use, texture_blur = faces.coefficients[f], faces.use[f], faces.texture_blur[f]
        if face_in_camera(Rcw, tcw, position, R, faces.axes[f], offsets[f], E, origin) < LEAST_VIEW_COSINE:
            continue
        blur_on_face(optics, E, origin, offsets[f], velocity, omega, lens_blur, motion)
        border = faces.margin + motion_reach_px(K, origin[2], motion)
        if not face_outline(optics, drift, E, origin, corners[f, : counts[f]], border, px, planes):
            continue
        top, bottom = px[0, 1], px[0, 1]
        for i in range(counts[f]):
            top, bottom = min(top, px[i, 1]), max(bottom, px[i, 1])
        first, last = max(ceil(top + border), y0), min(floor(bottom - border), y0 + height - 1)
        left, right = px[0, 0], px[0, 0]
        for i in range(counts[f]):
            left, right = min(left, px[i, 0]), max(right, px[i, 0])
        if relative_blur(lens_blur, motion, optics.blur, texture_blur, texel, relative) >= NEGLIGIBLE_BLUR_TEXEL2:
            coefficients = workspace.blurred[blur_texture(coefficients, relative, workspace.blurred)]
        stride = 1 + max(int((last - first + 1) * (right - left)), 0) // len(grey)
        # S⁻¹ is applied to rays and centre rather than S to the die, see `row_on_face`.
        for i in range(3):
            origin[i] = scaled_centre[i] + offsets[f] * E[2, i]
        gap = E[2, 0] * origin[0] + E[2, 1] * origin[1] + E[2, 2] * origin[2]
        m = ZERO
        for v in range(first, last + 1, stride):
            low, high = float(x0), float(x0 + width - 1)
            for k in range(counts[f]):
                rest = planes[k, 1] * v + planes[k, 2]
                if planes[k, 0] > 1e-12:
                    low = max(low, -rest / planes[k, 0])
                elif planes[k, 0] < -1e-12:
                    high = min(high, -rest / planes[k, 0])
                elif rest < 0.0:
                    high = low - 1.0
            begin = ceil(low)
            end = max(floor(high) + 1, begin)
            if rolling:
                gap = drifted_face(drift, float(v), E, scaled_centre, offsets[f], E_then, origin_then)
                row_on_face(optics.rays[v, begin:end], inverse_shrink, E_then, origin_then, gap, texel, half, line)
            else:
                row_on_face(optics.rays[v, begin:end], inverse_shrink, E, origin, gap, texel, half, line)
            for u in range(begin, end):
                value, x, y = image[v - y0, u - x0], line[0, u - begin], line[1, u - begin]
                if value >= faces.saturation:
                    continue
                if not (1.0 <= x < n - 2.0 and 1.0 <= y < n - 2.0):
                    continue
                kind = use[int(y + 0.5), int(x + 0.5)]
                if kind == 0 or (kind == 1 and (u + v) % FLAT_DECIMATION != 0):
                    continue
                level, gx, gy = spline_with_slopes(coefficients, x, y)
                grey[m], texture[m] = value, level
                workspace.a[m], workspace.b[m] = (x - half) / half, (y - half) / half
                slope[0, m], slope[1, m] = gx / texel, gy / texel
                steep[m] = hypot(gx, gy)
                if with_warps:
                    by_blur[m] = 0.5 * spline_laplacian(coefficients, x, y)
                ray[0, m], ray[1, m] = optics.rays[v, u, 0], optics.rays[v, u, 1]
                m += 1
        stats[f, 0] = m
        if m < FEWEST_PIXELS:
            continue
        relative_slopes(steep, m)
        c[:] = 0.0
        ceiling_grey = SCALE_CEILING * faces.usual_grey[f]
        scale = fit_light(m, TEXTURE_KNOWN, faces, ceiling_grey, REFINING_ITERATIONS, workspace, A, c)
        if scale < 0.0 or c[0] <= 0.0:
            continue
        used = 0.0
        for i in range(m):
            used += workspace.weight[i]
        stats[f, 1], stats[f, 2] = used, scale
        if used < (1.0 - MOST_OCCLUDED) * m:
            continue
        # All in camera axes; rotated to world axes once, after the sum.
        _fill_by_pose(m, c, E, offsets[f], half * texel, workspace)
        if with_warps:
            _fill_by_warps(m, c, half * texel, workspace)
        for k in range(N):
            _fill_products(m, k, workspace, face_H, face_g, light_cross)
        light_sums(m, grey, texture, workspace.a, workspace.b, workspace.weight, A, eliminated)
        inverse_variance = 1.0 / (scale * scale)
        for k in range(FIRST_GRADIENT, LIGHT_COEFFICIENTS):
            A[k, k] += 1.0 / (LIGHT_GRADIENT_SIGMA * c[0]) ** 2 / inverse_variance
        if not solve_positive(A, ALL_LIGHT, light_cross[0], eliminated):
            continue
        for k in range(N):
            solve_factored(A, ALL_LIGHT, light_cross[k], eliminated)
            for h in range(k, N):
                s = 0.0
                for q in range(LIGHT_COEFFICIENTS):
                    s += light_cross[h, q] * eliminated[q]
                face_H[h, k] -= s
        for k in range(N):
            face_g[k] *= inverse_variance
            face_H[k, k] *= inverse_variance
            for h in range(k):
                face_H[k, h] *= inverse_variance
                face_H[h, k] = face_H[k, h]
        turn_to_world(Rcw, face_H, face_g)
        for k in range(6):
            g[k] += face_g[k]
            for h in range(6):
                H[k, h] += face_H[k, h]
        if with_warps:
            for k in range(WARPS):
                for h in range(N):
                    warps[f, k, h] = face_H[6 + k, h]
                warps[f, k, N] = face_g[6 + k]


@inner_fast_sums
def _by_pose(
    ga: float, gb: float, dx: float, dy: float, a: float, b: float, E: Any, offset: float
) -> tuple[float, float, float, float, float, float]:
    """Derivatives of a pixel's grey level by the pose, in camera axes, from its slopes by face coordinates, its ray,
    and the point (a, b) that it shows."""
    nd = E[2, 0] * dx + E[2, 1] * dy + E[2, 2]
    slip = (ga * (E[0, 0] * dx + E[0, 1] * dy + E[0, 2]) + gb * (E[1, 0] * dx + E[1, 1] * dy + E[1, 2])) / nd
    tx = slip * E[2, 0] - ga * E[0, 0] - gb * E[1, 0]
    ty = slip * E[2, 1] - ga * E[0, 1] - gb * E[1, 1]
    tz = slip * E[2, 2] - ga * E[0, 2] - gb * E[1, 2]
    rx = offset * E[2, 0] + a * E[0, 0] + b * E[1, 0]
    ry = offset * E[2, 1] + a * E[0, 1] + b * E[1, 1]
    rz = offset * E[2, 2] + a * E[0, 2] + b * E[1, 2]
    return tx, ty, tz, ry * tz - rz * ty, rz * tx - rx * tz, rx * ty - ry * tx


@inner_fast_sums
def _fill_by_pose(m: int, c: Any, E: Any, offset: float, unit: float, workspace: Workspace) -> None:
    """Derivatives of m grey levels by the pose; `unit` is half the grid's width [m]."""
    by, slope, ray = workspace.derivatives, workspace.slope, workspace.ray
    for i in range(m):
        x, y = workspace.a[i], workspace.b[i]
        contrast = c[0] + c[4] * x + c[5] * y
        by[0, i], by[1, i], by[2, i], by[3, i], by[4, i], by[5, i] = _by_pose(
            contrast * slope[0, i], contrast * slope[1, i], ray[0, i], ray[1, i], unit * x, unit * y, E, offset,
        )  # fmt: skip


@inner_fast_sums
def _fill_by_warps(m: int, c: Any, unit: float, workspace: Workspace) -> None:
    """Derivatives of m grey levels by the warps of the texture."""
    by = workspace.derivatives
    for i in range(m):
        x, y = workspace.a[i], workspace.b[i]
        contrast = c[0] + c[4] * x + c[5] * y
        a, b, ga, gb = unit * x, unit * y, contrast * workspace.slope[0, i], contrast * workspace.slope[1, i]
        radial = ga * a + gb * b
        by[6, i], by[7, i] = -ga, -gb
        by[8, i], by[9, i], by[10, i], by[11, i] = -ga * a, -ga * b, -gb * a, -gb * b
        by[12, i], by[13, i] = -radial * a, -radial * b
        by[14, i] = contrast * workspace.by_blur[i]


@inner_fast_sums
def _fill_products(m: int, k: int, workspace: Workspace, H: Any, g: Any, light_cross: Any) -> None:
    """Row k of H (lower half), of g, and of `light_cross`, the products with the light, at unit noise.

    Each sum runs over all m pixels before the next one, so that the processor adds several pixels at a time.
    """
    mine, weight, residual = workspace.derivatives[k], workspace.weight, workspace.residual
    weighted, texture, xs, ys = workspace.weighted, workspace.texture, workspace.a, workspace.b
    gradient, ct, c1, cx, cy, cxt, cyt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(m):
        w, t, x, y = weight[i] * mine[i], texture[i], xs[i], ys[i]
        weighted[i] = w
        gradient += w * residual[i]
        ct += w * t
        c1 += w
        cx += w * x
        cy += w * y
        cxt += w * x * t
        cyt += w * y * t
    g[k] = gradient
    row = light_cross[k]
    row[0], row[1], row[2], row[3], row[4], row[5] = ct, c1, cx, cy, cxt, cyt
    for h in range(k + 1):
        other, total = workspace.derivatives[h], 0.0
        for i in range(m):
            total += weighted[i] * other[i]
        H[k, h] = total


@compiled(nogil=True)
def refine_rows(
    frames: Any, which: Any, boxes: Any, optics: Optics, faces: Faces, variance_factor: float, rows: RefinedRows
) -> None:
    """Gauss-Newton on the marks together with the edges' poses, in place in `rows`.

    Row k uses the first camera of frame `which[k]` of `frames` (n, cameras, height, width), in the window `boxes[k]`
    (x0, y0, x1, y1); rows with an empty window are left alone. `variance_factor` divides the information of the
    marks.
    """
    reach = hypot(faces.offsets[0], hypot(faces.corners[0, 0, 0], faces.corners[0, 0, 1]))
    H, g = np.zeros((6, 6)), np.zeros(6)
    equations = MarkEquations(H, g, np.zeros((1, 1, 1)), np.zeros((faces.axes.shape[0], 3)))
    A, y, step, moved = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6)
    workspace = new_workspace(WORKSPACE_PIXELS, faces.coefficients.shape[1])
    for k in range(which.shape[0]):
        x0, y0 = boxes[k, 0], boxes[k, 1]
        if boxes[k, 2] <= x0 or boxes[k, 3] <= y0:
            continue
        image = np.empty((boxes[k, 3] - y0, boxes[k, 2] - x0), np.float32)
        for i in range(image.shape[0]):
            here, there = image[i], frames[which[k], 0, y0 + i, x0:]
            for j in range(image.shape[1]):
                here[j] = there[j]
        p, R, velocity, omega = rows.position[k].copy(), rows.rotation[k].copy(), rows.velocity[k], rows.omega[k]
        edge_information, edge_gradient = rows.edge_information[k], rows.edge_gradient[k]
        solved = False
        moved[:] = 0.0
        for _ in range(GAUSS_NEWTON_STEPS):
            frame = Frame(image, x0, y0, PoseState(p, R, velocity, omega))
            mark_equations(frame, optics, faces, WITHOUT_WARPS, workspace, equations)
            solved = H[0, 0] > 0.0
            if not solved:
                break
            for i in range(6):
                y[i] = g[i] / variance_factor + edge_gradient[i]
                for j in range(6):
                    H[i, j] /= variance_factor
                    A[i, j] = H[i, j] + edge_information[i, j]
                    y[i] -= edge_information[i, j] * moved[j]
            for i in range(6):
                A[i, i] *= 1.0 + RELATIVE_DAMPING
            solved = solve_positive(A, POSE_PARAMETERS, y, step)
            if not solved:
                break
            gained = 0.0
            for i in range(6):
                gained += step[i] * y[i]
                step[i] *= OVERRELAXATION
                moved[i] += step[i]
            for i in range(3):
                p[i] += step[i]
            R = turned_by(R, step[3:])
            if gained < CONVERGED_GAIN or largest_move_px(optics, p, step, reach) < CONVERGED_PX:
                break
        for i in range(6):
            for j in range(6):
                rows.mark_information[k, i, j] = H[i, j] if solved else 0.0
        if solved:
            for i in range(3):
                rows.position[k, i] = p[i]
                for j in range(3):
                    rows.rotation[k, i, j] = R[i, j]
