"""The picture that a pose of a rounded die predicts, pixel by pixel, and how it changes with the pose.

A pixel shows the blurred light of the die, and what the die leaves of the background:

    I = [w B] + (1 - [w]) γ G

with w = 1 within the contour and 0 outside, B the brightness of the part of the surface behind the pixel, by its normal and
with what that part deviates from the light, G the background and γ its shade. The brackets are the blur by lens, motion and
pixel: of the product, since near the contour the surface turns away and its brightness changes within a pixel. w and w B
are drawn on a grid of half pixels (`draw_surface`). Pieces that the contour crosses count by the part of them within it, at
its middle. A die that moves by more than NODE_PX within the exposure is drawn at several instants.

**Derivatives.** A point of the surface moves in the picture by u (`fill_changes`), and takes its brightness along, which
changes as its normal turns. On the contour the points that are seen change, but at right angles to it they move as the body
does. So

    dI = -(∇[w B] - γ G ∇[w]) · u + [w dB/dn · (δθ × n)],

with the gradients of the drawn pictures. Those by the coefficients of the light are [w m(n)], m the monomials of the
normal.
"""

from __future__ import annotations

from math import ceil, exp, isnan, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner, inner_no_memory, inner_nogil
from .kernel_types import LIGHT_DEGREE, LIGHT_TERMS, CameraRig, EdgeSampling, PictureModel, PoseState, Shape, Workspace
from .projection import place_die, project_point, reach_of_die
from .rounded_surface import (
    NOTHING,
    ball_px,
    contour_segments,
    face_at,
    fill_nearest_contour,
    fill_ray,
    flat_faces,
    is_far_outside,
    motion_px,
    part_on_ray,
    rays_about_centre,
)
from .small_matrices import turn
from .surface_grid import SurfaceGrid, blur_surface
from .surface_light import fill_monomials

NODE_PX = 1.2
"""Motion within the exposure [px] that one drawn instant stands for."""
MOST_NODES = 8
"""Most instants: motion beyond that is blurred by a Gaussian between them."""
FAR_BLURS = 3.0
"""Distance from the contour, in blurs, up to which pixels show both die and background."""
CLOSE_PX = 1.5
"""Distance from the contour up to which it may cross a pixel."""
TURNING_PX = 3.0
"""Depth within the contour up to which a bevel turns away so fast that its brightness changes within a pixel."""
WITHIN_FACE_PX = 0.4
"""A pixel this far within a flat face shows nothing else."""
INWARD_PX = 0.5
"""A pixel on or outside the contour gets the derivatives of the point that lies this far inside it."""
PIECE_PX = 5.0
"""Length of the pieces of a side of the contour that have a shade of the background of their own: the shadow that the die casts
on the table lies beside a part of a side only. With one shade a side a plain tetrahedron was seen 0.28 px too wide, with these
0.13."""
MOST_PIECES = 16
"""Most pieces of a side."""


# --- light of the surface


@inner_no_memory
def _brightness(mean: Any, R: Any, n: Any) -> float:
    """The polynomial of the light at a normal (3,) in axes of the die."""
    x = R[0, 0] * n[0] + R[0, 1] * n[1] + R[0, 2] * n[2]
    y = R[1, 0] * n[0] + R[1, 1] * n[1] + R[1, 2] * n[2]
    z = R[2, 0] * n[0] + R[2, 1] * n[1] + R[2, 2] * n[2]
    total, k, a = 0.0, np.int64(0), 1.0
    for i in range(LIGHT_DEGREE + 1):
        b = a
        for j in range(LIGHT_DEGREE + 1 - i):
            total += mean[k] * b
            k += 1
            if i + j < LIGHT_DEGREE:
                total += mean[k] * b * z
                k += 1
            b *= y
        a *= x
    return total


@inner_no_memory
def _brightness_and_gradient(mean: Any, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The same at a normal in world axes, and its gradient."""
    total, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    k, a, da = np.int64(0), 1.0, 0.0
    for i in range(LIGHT_DEGREE + 1):
        b, db = 1.0, 0.0
        for j in range(LIGHT_DEGREE + 1 - i):
            c = mean[k]
            k += 1
            if i + j < LIGHT_DEGREE:
                gz += mean[k] * a * b
                c += mean[k] * z
                k += 1
            total += c * a * b
            gx += c * da * b
            gy += c * a * db
            db = db * y + b
            b *= y
        da = da * x + a
        a *= x
    return total, gx, gy, gz


# --- what a pose predicts


@inner(nogil=True, shared=True)
def draw_surface(
    view: int, model: PictureModel, pose: PoseState, sampling: EdgeSampling, work: Workspace, grid: SurfaceGrid
) -> None:
    """Fill share and glow of the pixels that `fill_changes` has found to be used."""
    rig, shape = model.rig, model.shape
    exposed = motion_px(rig, view, pose, rays_about_centre(rig, view, pose.position), model.settings.exposure_s)
    radius_px = reach_of_die(shape) * ball_px(shape, rig, view, pose.position) / shape.radius
    widest = sqrt(exposed[0] ** 2 + exposed[1] ** 2) + _turned_rad(pose, model.settings.exposure_s) * radius_px
    nodes = min(max(ceil(widest / NODE_PX), 1), MOST_NODES)
    step, before = np.zeros(3), np.zeros(3)
    for k in range(nodes):
        dt = ((k + 0.5) / nodes - 0.5) * model.settings.exposure_s
        for b in range(3):
            step[b] = pose.omega[b] * dt
            before[b] = pose.position[b] + pose.velocity[b] * dt
        then = PoseState(before, turn(pose.rotation, step), pose.velocity, pose.omega)
        if place_die(shape, rig, view, then, work):
            _draw_instant(view, model, then, 1.0 / nodes, work, grid)
    blur_surface(model, sampling.blur_px, (exposed[0] / nodes, exposed[1] / nodes), grid)


@inner_no_memory
def _turned_rad(pose: PoseState, exposure_s: float) -> float:
    """How far the die turns within the exposure."""
    return sqrt(pose.omega[0] ** 2 + pose.omega[1] ** 2 + pose.omega[2] ** 2) * exposure_s


@inner_nogil
def _draw_instant(
    view: int, model: PictureModel, pose: PoseState, weight: float, work: Workspace, grid: SurfaceGrid
) -> None:
    """Add w and w B of one instant of the exposure on the grid of half pixels."""
    rig, shape, light, R = model.rig, model.shape, work.light, pose.rotation
    segments, about = contour_segments(shape, work), rays_about_centre(rig, view, pose.position)
    lines, count = flat_faces(shape, rig, view, pose, work)
    ball, near, hit, ray = ball_px(shape, rig, view, pose.position), np.zeros(5), np.zeros(6), np.zeros((2, 3))
    mean, deviation, nf = light.mean[view], light.part_deviation[view], shape.normals.shape[0]
    of_face = np.zeros(nf)
    for f in range(nf):
        of_face[f] = _brightness(mean, R, shape.normals[f]) + deviation[f]
    part = np.int64(NOTHING)
    for i in range(grid.part.shape[0]):
        y = float(grid.y0 + i)
        for j in range(grid.part.shape[1]):
            x = float(grid.x0 + j)
            if is_far_outside(segments, x, y, ball + CLOSE_PX):
                continue
            fill_nearest_contour(segments, x, y, near)
            d = near[0] - ball
            if d > CLOSE_PX:
                continue
            f, room = _face_with_room(lines, count, x, y)
            if f != NOTHING and room > WITHIN_FACE_PX:
                _add_quarters(grid, i, j, weight, of_face[f])
                continue
            if d > -CLOSE_PX:
                d = near[0] - _ball_beyond_px(model, view, segments, near, work)
            elif d < -TURNING_PX and f == NOTHING:
                fill_ray(rig, view, pose, about, x, y, ray)
                part = part_on_ray(shape, work.face_cosine, ray, part, hit)
                if part != NOTHING:
                    _add_quarters(grid, i, j, weight, _brightness(mean, R, hit) + deviation[part])
                continue
            for quarter in range(4):
                a, b = quarter // 2, quarter % 2
                du, dv = 0.5 * b - 0.25, 0.5 * a - 0.25
                beyond = d + du * near[1] + dv * near[2]
                inside, back = _part_within(beyond, near[1], near[2])
                if inside == 0.0:
                    continue
                u, v = x + du - back * near[1], y + dv - back * near[2]
                f = face_at(lines, count, u, v)
                value = 0.0
                if f != NOTHING:
                    value = of_face[f]
                else:
                    fill_ray(rig, view, pose, about, u, v, ray)
                    part = part_on_ray(shape, work.face_cosine, ray, part, hit)
                    if part == NOTHING:
                        # By rounding the ray just misses the limb that it should graze.
                        fill_ray(rig, view, pose, about, u - 0.1 * near[1], v - 0.1 * near[2], ray)
                        part = part_on_ray(shape, work.face_cosine, ray, part, hit)
                        if part == NOTHING:
                            continue
                    value = _brightness(mean, R, hit) + deviation[part]
                grid.covered[2 * i + a, 2 * j + b] += weight * inside
                grid.shining[2 * i + a, 2 * j + b] += weight * inside * value
                grid.moved[2 * i + a, 2 * j + b, 0] -= weight * inside * back * near[1]
                grid.moved[2 * i + a, 2 * j + b, 1] -= weight * inside * back * near[2]


@inner_no_memory
def _part_within(beyond: float, nx: float, ny: float) -> tuple[float, float]:
    """The share of a square of half a pixel within a line at right angles to (nx, ny), whose middle lies `beyond` pixels outside
    it, and how far within the middle that of this part lies [px].

    Along the normal the square is a trapezoid: the sum of two boxes."""
    a, b = 0.5 * max(abs(nx), abs(ny)), max(0.5 * min(abs(nx), abs(ny)), 1e-9)
    reach = 0.5 * (a + b)
    outside = abs(beyond)
    if outside >= reach:
        return (0.0, 0.0) if beyond > 0.0 else (1.0, 0.0)
    q = min(reach - outside, b)
    share, moment = q * q / (2.0 * a * b), (reach * q * q / 2.0 - q * q * q / 3.0) / (a * b)
    if outside < reach - b:
        half = reach - b
        share += (half - outside) / a
        moment += (half * half - outside * outside) / (2.0 * a)
    # By symmetry the moments of both parts are opposite.
    share = share if beyond > 0.0 else 1.0 - share
    return share, moment / share


@inner_no_memory
def _add_quarters(grid: SurfaceGrid, i: int, j: int, weight: float, value: float) -> None:
    """Add a pixel that shows the die alone, of one brightness."""
    for a in range(2):
        for b in range(2):
            grid.covered[2 * i + a, 2 * j + b] += weight
            grid.shining[2 * i + a, 2 * j + b] += weight * value


@inner_no_memory
def _face_with_room(lines: Any, count: Any, x: float, y: float) -> tuple[int, float]:
    """The flat face at a pixel, NOTHING where there is none, and how far within it the pixel lies [px]."""
    for f in range(count.shape[0]):
        least = 1e300 if count[f] > 0 else -1.0
        for k in range(count[f]):
            least = min(least, lines[f, k, 0] * x + lines[f, k, 1] * y + lines[f, k, 2])
            if least < 0.0:
                break
        if least >= 0.0:
            return f, least
    return NOTHING, 0.0


# --- how that changes


@inner(nogil=True, shared=True)
def fill_changes(
    view: int, model: PictureModel, pose: PoseState, sampling: EdgeSampling, background: Any, work: Workspace, grid: SurfaceGrid
) -> int:  # fmt: skip
    """Fill which pixels are used, which part of the placed die they show, and the derivatives of that; return the number of
    pieces of the contour, of which short sides have fewer than MOST_PIECES."""
    rig, shape, light = model.rig, model.shape, work.light
    segments, about = contour_segments(shape, work), rays_about_centre(rig, view, pose.position)
    lines, count = flat_faces(shape, rig, view, pose, work)
    exposed = motion_px(rig, view, pose, about, model.settings.exposure_s)
    ball, blur_px = ball_px(shape, rig, view, pose.position), sampling.blur_px
    near, hit, ray, point = np.zeros(5), np.zeros(6), np.zeros((2, 3)), np.zeros(3)
    nf, part, mean = shape.normals.shape[0], np.int64(NOTHING), light.mean[view]
    face_bright, face_slope = np.zeros(nf), np.zeros((nf, 3 + LIGHT_TERMS))
    for f in range(nf):
        face_bright[f] = _fill_brightness(pose.rotation, shape.normals[f], mean, face_slope[f])
    turned = abs(exposed[2]) * 0.5 * max(grid.part.shape[0], grid.part.shape[1])
    widest = sqrt(exposed[0] ** 2 + exposed[1] ** 2) + turned
    far = FAR_BLURS * sqrt(blur_px * blur_px + widest * widest / 12.0)
    for i in range(grid.part.shape[0]):
        y = float(grid.y0 + i)
        for j in range(grid.part.shape[1]):
            x = float(grid.x0 + j)
            if isnan(background[grid.y0 + i, grid.x0 + j]):
                continue
            if is_far_outside(segments, x, y, ball + sampling.band_px + far):
                continue
            fill_nearest_contour(segments, x, y, near)
            d, nx, ny = near[0] - ball, near[1], near[2]
            if d > sampling.band_px + far:
                continue
            out = grid.beyond[i, j]
            if d > -far - 1.0:
                moved = (exposed[0] - exposed[2] * (y - about[1])) * nx + (
                    exposed[1] + exposed[2] * (x - about[0])
                ) * ny
                sigma = sqrt(blur_px * blur_px + moved * moved / 12.0)
                d = near[0] - _ball_beyond_px(model, view, segments, near, work)
                density = exp(-0.5 * (d / sigma) ** 2) / (sigma * 2.5066282746310002)
                out[3], out[4] = density, d / sigma * density * blur_px / sigma
            out[0], out[1], out[2] = d, nx, ny
            grid.side[i, j] = _piece(segments, near)
            if d > far:
                continue
            inward = max(d + INWARD_PX, 0.0)
            u, v = x - inward * nx, y - inward * ny
            f, room = _face_with_room(lines, count, u, v)
            if f != NOTHING:
                grid.part[i, j], grid.bright[i, j] = f, light.part_deviation[view, f] + face_bright[f]
                slope = grid.slope[i, j]
                for q in range(3 + LIGHT_TERMS):
                    slope[q] = face_slope[f, q]
                if d < -far and room > far:
                    continue
                fill_ray(rig, view, pose, about, u, v, ray)
                _fill_point_of_face(shape, f, ray, point)
            else:
                fill_ray(rig, view, pose, about, u, v, ray)
                part = part_on_ray(shape, work.face_cosine, ray, part, hit)
                if part == NOTHING:
                    continue
                for q in range(3):
                    point[q] = hit[3 + q] + shape.radius * hit[q]
                grid.part[i, j], grid.bright[i, j] = part, light.part_deviation[view, part]
                grid.bright[i, j] += _fill_brightness(pose.rotation, hit, mean, grid.slope[i, j])
            _fill_flow(rig, view, pose, point, work.J, grid.flow[i, j])
    return int(segments.shape[0]) * MOST_PIECES


@inner_no_memory
def _piece(segments: Any, near: Any) -> int:
    """The piece of the contour at the place on it that `fill_nearest_contour` found."""
    side = int(near[3])
    pieces = int(min(max(segments[side, 4] / PIECE_PX, 1.0), MOST_PIECES))
    return side * MOST_PIECES + min(int(near[4] * pieces), pieces - 1)


@inner_no_memory
def _ball_beyond_px(model: PictureModel, view: int, segments: Any, near: Any, work: Workspace) -> float:
    """How far the contour at a pixel lies beyond that of the inner body [px]: the ball as seen there, in that direction."""
    k, along = int(near[3]), near[4]
    iA, iB = int(segments[k, 8]), int(segments[k, 9])
    zA, zB = work.vertex_camera[iA, 2], work.vertex_camera[iB, 2]
    s, J = along * zA / ((1.0 - along) * zB + along * zA), work.J
    cx = work.vertex_camera[iA, 0] + s * (work.vertex_camera[iB, 0] - work.vertex_camera[iA, 0])
    cy = work.vertex_camera[iA, 1] + s * (work.vertex_camera[iB, 1] - work.vertex_camera[iA, 1])
    project_point(model.rig.matrix[view], model.rig.distortion[view], cx, cy, zA + s * (zB - zA), J)
    squared = 0.0
    for b in range(3):
        squared += (near[1] * J[0, b] + near[2] * J[1, b]) ** 2
    return model.shape.radius * sqrt(squared)


@inner_no_memory
def _fill_point_of_face(shape: Shape, f: int, ray: Any, point: Any) -> None:
    """Fill where a ray meets a flat face (3,) [m], in axes of the die."""
    toward, away = 0.0, shape.offsets[f] + shape.radius
    for q in range(3):
        toward += shape.normals[f, q] * ray[1, q]
        away -= shape.normals[f, q] * ray[0, q]
    for q in range(3):
        point[q] = ray[0, q] + away / toward * ray[1, q]


@inner_no_memory
def _fill_flow(rig: CameraRig, view: int, pose: PoseState, point: Any, J: Any, flow: Any) -> None:
    """Fill (2, 6) how a point (3,) of the die, in its axes, moves in the picture with the pose."""
    R, Rcw = pose.rotation, rig.rotation[view]
    r0 = R[0, 0] * point[0] + R[0, 1] * point[1] + R[0, 2] * point[2]
    r1 = R[1, 0] * point[0] + R[1, 1] * point[1] + R[1, 2] * point[2]
    r2 = R[2, 0] * point[0] + R[2, 1] * point[1] + R[2, 2] * point[2]
    p0, p1, p2 = pose.position[0] + r0, pose.position[1] + r1, pose.position[2] + r2
    x = rig.translation[view, 0] + Rcw[0, 0] * p0 + Rcw[0, 1] * p1 + Rcw[0, 2] * p2
    y = rig.translation[view, 1] + Rcw[1, 0] * p0 + Rcw[1, 1] * p1 + Rcw[1, 2] * p2
    z = rig.translation[view, 2] + Rcw[2, 0] * p0 + Rcw[2, 1] * p1 + Rcw[2, 2] * p2
    project_point(rig.matrix[view], rig.distortion[view], x, y, z, J)
    for q in range(2):
        out = flow[q]
        for b in range(3):
            out[b] = J[q, 0] * Rcw[0, b] + J[q, 1] * Rcw[1, b] + J[q, 2] * Rcw[2, b]
        out[3], out[4], out[5] = r1 * out[2] - r2 * out[1], r2 * out[0] - r0 * out[2], r0 * out[1] - r1 * out[0]


@inner_no_memory
def _fill_brightness(R: Any, n: Any, mean: Any, slope: Any) -> float:
    """Fill (3 + LIGHT_TERMS,) the derivatives of the brightness at a normal (3,) in axes of the die, by the rotation vector
    and the light; return the brightness."""
    x = R[0, 0] * n[0] + R[0, 1] * n[1] + R[0, 2] * n[2]
    y = R[1, 0] * n[0] + R[1, 1] * n[1] + R[1, 2] * n[2]
    z = R[2, 0] * n[0] + R[2, 1] * n[1] + R[2, 2] * n[2]
    total, gx, gy, gz = _brightness_and_gradient(mean, x, y, z)
    slope[0], slope[1], slope[2] = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
    fill_monomials(x, y, z, slope[3:])
    return total
