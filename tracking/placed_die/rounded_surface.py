"""Which part of a die's surface a pixel shows: a flat face, a strip along an edge, or a rounded corner.

A rounded die is a sharp polyhedron with a ball rolled round it. A ray from the camera meets it first on one of its flat
faces, moved out by the radius; on a cylinder about an edge; or on a sphere about a vertex. Flat faces are polygons in the
picture. Elsewhere the nearest intersection of the ray decides, and gives the normal that the pixel shows.

The parts of the surface are numbered: the faces, then the strips along edges, then the corners.
"""

from __future__ import annotations

from math import ceil, floor, hypot, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_no_memory, inner_nogil
from .kernel_types import CameraRig, PoseState, Shape, Workspace
from .projection import (
    LEAST_DEPTH_M,
    ROW_ITERATIONS,
    camera_point,
    exposure_delay,
    pixel_of_ray,
    project_point,
    turn_inwards,
    turned_within,
)

NOTHING = -1
"""Number of no part."""
MISSED = 1e300
"""Distance along a ray that meets nothing."""


@inner_no_memory
def ball_px(shape: Shape, rig: CameraRig, view: int, pos: Any) -> float:
    """Radius [px] of the ball in a view: how far the contour lies beyond that of the inner body."""
    depth = rig.translation[view, 2]
    for b in range(3):
        depth += rig.rotation[view, 2, b] * pos[b]
    return shape.radius * rig.matrix[view, 0, 0] / max(depth, LEAST_DEPTH_M)


# --- the picture of a placed die


@inner_nogil
def contour_segments(shape: Shape, work: Workspace) -> Any:
    """(edges, 10) the contour of the placed inner body: first end, direction, length [px], its line a x + b y + c, positive
    inside, and the vertices at its ends."""
    segments, count = np.empty((shape.edges.shape[0], 10)), 0
    mx, my, nv = 0.0, 0.0, work.vertex_px.shape[0]
    for i in range(nv):
        mx += work.vertex_px[i, 0] / nv
        my += work.vertex_px[i, 1] / nv
    for e in range(shape.edges.shape[0]):
        if (work.face_cosine[shape.edge_faces[e, 0]] > 0.0) == (work.face_cosine[shape.edge_faces[e, 1]] > 0.0):
            continue
        i, k = shape.edges[e, 0], shape.edges[e, 1]
        x, y = work.vertex_px[i, 0], work.vertex_px[i, 1]
        dx, dy = work.vertex_px[k, 0] - x, work.vertex_px[k, 1] - y
        length = max(hypot(dx, dy), 1e-9)
        dx, dy = dx / length, dy / length
        sign = 1.0 if -dy * (mx - x) + dx * (my - y) > 0.0 else -1.0
        row = segments[count]
        row[0], row[1], row[2], row[3], row[4] = x, y, dx, dy, length
        row[5], row[6], row[7] = -sign * dy, sign * dx, sign * (dy * x - dx * y)
        row[8], row[9] = i, k
        count += 1
    return segments[:count]


@inner_no_memory
def fill_nearest_contour(segments: Any, x: float, y: float, out: Any) -> None:
    """Fill (5,) the distance [px] of a pixel from the contour of the inner body, positive outside; the direction away from
    the die there; which segment is nearest; and the place on it, as a share of its length."""
    least, nx, ny, which = 1e300, 0.0, 0.0, 0
    for k in range(segments.shape[0]):
        within = segments[k, 5] * x + segments[k, 6] * y + segments[k, 7]
        if within < least:
            least, nx, ny, which = within, -segments[k, 5], -segments[k, 6], k
    distance = -least
    if least < 0.0:
        nearest = 1e300
        for k in range(segments.shape[0]):
            s = segments[k]
            rx, ry = x - s[0], y - s[1]
            t = min(max(rx * s[2] + ry * s[3], 0.0), s[4])
            rx, ry = rx - t * s[2], ry - t * s[3]
            d2 = rx * rx + ry * ry
            if d2 < nearest:
                nearest, nx, ny, which = d2, rx, ry, k
        distance = sqrt(nearest)
        nx, ny = nx / max(distance, 1e-9), ny / max(distance, 1e-9)
    s = segments[which]
    along = ((x - s[0]) * s[2] + (y - s[1]) * s[3]) / s[4]
    out[0], out[1], out[2], out[3], out[4] = distance, nx, ny, which, min(max(along, 0.0), 1.0)


@inner_no_memory
def is_far_outside(segments: Any, x: float, y: float, far: float) -> bool:
    """Whether a pixel lies beyond the line of a side by more than `far` [px], and so beyond the contour: it costs less than the
    distance."""
    least = 0.0
    for k in range(segments.shape[0]):
        least = min(least, segments[k, 5] * x + segments[k, 6] * y + segments[k, 7])
    return bool(least < -far)


@inner_no_memory
def pixels_about(vertex_px: Any, margin: float, window: Any) -> tuple[int, int, int, int]:
    """The part (x0, y0, x1, y1; end exclusive) of a window with all vertices and a margin [px]."""
    low_x, low_y, high_x, high_y = 1e9, 1e9, -1e9, -1e9
    for i in range(vertex_px.shape[0]):
        x, y = vertex_px[i, 0], vertex_px[i, 1]
        low_x, low_y, high_x, high_y = min(low_x, x), min(low_y, y), max(high_x, x), max(high_y, y)
    return (
        max(floor(max(low_x - margin, -1e9)), window[0]),
        max(floor(max(low_y - margin, -1e9)), window[1]),
        min(ceil(min(high_x + margin, 1e9)) + 1, window[2]),
        min(ceil(min(high_y + margin, 1e9)) + 1, window[3]),
    )


@inner_nogil
def flat_faces(shape: Shape, rig: CameraRig, view: int, pose: PoseState, work: Workspace) -> tuple[Any, Any]:
    """The half-planes (faces, most, 3) a x + b y + c >= 0 [px] of the flat faces as placed, and (faces,) how many of them
    bound each; 0 for faces that are turned away, or folded (`turn_inwards`)."""
    nf, most = shape.face_edges.shape
    lines, count = np.zeros((nf, most, 3)), np.zeros(nf, np.int64)
    late = exposure_delay(rig, pose.position)
    arm = np.empty(3)
    for f in range(nf):
        if not work.face_cosine[f] > 0.0:
            continue
        mx, my, n = 0.0, 0.0, 0
        for j in range(most):
            e = shape.face_edges[f, j]
            if e < 0:
                break
            for b in range(3):
                arm[b] = work.vertex_arm[shape.edges[e, 0], b] + shape.radius * work.face_normal[f, b]
            x0, y0 = _pixel_of_arm(rig, view, pose, arm, late)
            for b in range(3):
                arm[b] = work.vertex_arm[shape.edges[e, 1], b] + shape.radius * work.face_normal[f, b]
            x1, y1 = _pixel_of_arm(rig, view, pose, arm, late)
            length = max(hypot(x1 - x0, y1 - y0), 1e-9)
            nx, ny = (y0 - y1) / length, (x1 - x0) / length
            lines[f, j, 0], lines[f, j, 1], lines[f, j, 2] = nx, ny, -(nx * x0 + ny * y0)
            mx, my, n = mx + 0.5 * (x0 + x1), my + 0.5 * (y0 + y1), n + 1
        count[f] = n if turn_inwards(shape, f, n, mx / n, my / n, lines[f]) else 0
    return lines, count


@inner_no_memory
def face_at(lines: Any, count: Any, x: float, y: float) -> int:
    """The flat face at a pixel; NOTHING where there is none."""
    for f in range(count.shape[0]):
        hit = count[f] > 0
        for k in range(count[f]):
            if lines[f, k, 0] * x + lines[f, k, 1] * y + lines[f, k, 2] < 0.0:
                hit = False
                break
        if hit:
            return f
    return NOTHING


@inner_no_memory
def _pixel_of_arm(rig: CameraRig, view: int, pose: PoseState, arm: Any, late: float) -> tuple[float, float]:
    """Pixel of a point of the die, at the instant at which its row is exposed. `arm` is the point from the die's centre, in
    world axes at the pose; `late` the time of the pose from that of the frame."""
    u, v = 0.0, rig.middle_row[view]
    rows = ROW_ITERATIONS + 1 if rig.row_s[view] != 0.0 else 1
    for k in range(rows):
        dt = 0.0 if k == 0 else (v - rig.middle_row[view]) * rig.row_s[view] - late
        x, y, z = camera_point(rig, view, pose, arm, dt)
        z = max(z, LEAST_DEPTH_M)
        u, v = pixel_of_ray(rig.matrix[view], rig.distortion[view], x / z, y / z)
    return u, v


# --- rays


@inner_nogil
def rays_about_centre(rig: CameraRig, view: int, pos: Any) -> Any:
    """(9,) what `fill_ray` needs: pixel of the die's centre, its ray (x/z, y/z), the derivative (2, 2) of a ray by its
    pixel there, and the time of the pose from that of the frame."""
    out, J = np.zeros(9), np.zeros((2, 3))
    x, y, z = rig.translation[view, 0], rig.translation[view, 1], rig.translation[view, 2]
    for b in range(3):
        x += rig.rotation[view, 0, b] * pos[b]
        y += rig.rotation[view, 1, b] * pos[b]
        z += rig.rotation[view, 2, b] * pos[b]
    out[0], out[1] = project_point(rig.matrix[view], rig.distortion[view], x, y, z, J)
    out[2], out[3] = x / z, y / z
    det = (J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]) * z
    out[4], out[5], out[6], out[7] = J[1, 1] / det, -J[0, 1] / det, -J[1, 0] / det, J[0, 0] / det
    out[8] = exposure_delay(rig, pos)
    return out


@inner_no_memory
def fill_ray(rig: CameraRig, view: int, pose: PoseState, about: Any, x: float, y: float, ray: Any) -> None:
    """Fill origin [m] and direction (2, 3) of the ray of a pixel, in axes of the die as it stands when that row is exposed."""
    R, Rcw, tcw = pose.rotation, rig.rotation[view], rig.translation[view]
    dx, dy = x - about[0], y - about[1]
    a, b = about[2] + about[4] * dx + about[5] * dy, about[3] + about[6] * dx + about[7] * dy
    # Lens distortion over the picture of a die: one Newton step leaves less than a thousandth of a pixel.
    u, v = pixel_of_ray(rig.matrix[view], rig.distortion[view], a, b)
    dx, dy = x - u, y - v
    a, b = a + about[4] * dx + about[5] * dy, b + about[6] * dx + about[7] * dy
    dt = 0.0
    if rig.row_s[view] != 0.0:
        dt = (y - rig.middle_row[view]) * rig.row_s[view] - about[8]
    o0, o1, o2 = -pose.position[0], -pose.position[1], -pose.position[2]
    o0, o1, o2 = o0 - pose.velocity[0] * dt, o1 - pose.velocity[1] * dt, o2 - pose.velocity[2] * dt
    for k in range(3):
        o0 -= Rcw[k, 0] * tcw[k]
        o1 -= Rcw[k, 1] * tcw[k]
        o2 -= Rcw[k, 2] * tcw[k]
    d0 = Rcw[0, 0] * a + Rcw[1, 0] * b + Rcw[2, 0]
    d1 = Rcw[0, 1] * a + Rcw[1, 1] * b + Rcw[2, 1]
    d2 = Rcw[0, 2] * a + Rcw[1, 2] * b + Rcw[2, 2]
    if dt != 0.0:
        o0, o1, o2 = turned_within(pose.omega, -dt, o0, o1, o2)
        d0, d1, d2 = turned_within(pose.omega, -dt, d0, d1, d2)
    for k in range(3):
        ray[0, k] = R[0, k] * o0 + R[1, k] * o1 + R[2, k] * o2
        ray[1, k] = R[0, k] * d0 + R[1, k] * d1 + R[2, k] * d2


@inner_no_memory
def part_on_ray(shape: Shape, face_cosine: Any, ray: Any, beside: int, hit: Any) -> int:
    """The strip or corner of a rounded die that a ray meets first, and in `hit` (6,) the normal there and the middle of the
    ball that it meets, all in axes of the die; NOTHING if it meets none. Flat faces are not asked, nor what lies between
    two that are turned away.

    `beside` is the part that a pixel nearby shows, or NOTHING. It is asked first, and mostly is the one: where a normal is one
    of the part's own, the ray meets it on the surface, which it enters once."""
    nf, ne = shape.normals.shape[0], shape.edges.shape[0]
    o0, o1, o2 = ray[0, 0], ray[0, 1], ray[0, 2]
    d0, d1, d2 = ray[1, 0], ray[1, 1], ray[1, 2]
    size = sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    d0, d1, d2 = d0 / size, d1 / size, d2 / size
    if nf <= beside < nf + ne:
        t, e = _to_strip(shape, beside - nf, (o0, o1, o2), (d0, d1, d2), MISSED, hit), beside - nf
        if t < MISSED and _is_normal_of_strip(shape, e, hit):
            return beside
    elif beside >= nf + ne:
        t, i = _to_corner(shape, beside - nf - ne, (o0, o1, o2), (d0, d1, d2), MISSED, hit), beside - nf - ne
        if t < MISSED and _is_normal_of_corner(shape, i, hit):
            return beside
    nearest, part = MISSED, NOTHING
    for e in range(ne):
        if face_cosine[shape.edge_faces[e, 0]] <= 0.0 and face_cosine[shape.edge_faces[e, 1]] <= 0.0:
            continue
        t = _to_strip(shape, e, (o0, o1, o2), (d0, d1, d2), nearest, hit)
        if t < nearest:
            nearest, part = t, nf + e
            if _is_normal_of_strip(shape, e, hit):
                return part
    for i in range(shape.vertices.shape[0]):
        t = _to_corner(shape, i, (o0, o1, o2), (d0, d1, d2), nearest, hit)
        if t < nearest:
            nearest, part = t, nf + ne + i
    return part


@inner_no_memory
def _to_strip(shape: Shape, e: int, origin: Any, direction: Any, nearest: float, hit: Any) -> float:
    """How far along a ray, of unit `direction`, the cylinder about an edge is. Where that is nearer than `nearest`, `hit` (6,) is
    filled; else MISSED."""
    p, q = shape.vertices[shape.edges[e, 0]], shape.vertices[shape.edges[e, 1]]
    d0, d1, d2 = direction
    a0, a1, a2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    w0, w1, w2 = origin[0] - p[0], origin[1] - p[1], origin[2] - p[2]
    aa = a0 * a0 + a1 * a1 + a2 * a2
    da, wa, radius = d0 * a0 + d1 * a1 + d2 * a2, w0 * a0 + w1 * a1 + w2 * a2, shape.radius
    A = 1.0 - da * da / aa
    B = w0 * d0 + w1 * d1 + w2 * d2 - da * wa / aa
    C = w0 * w0 + w1 * w1 + w2 * w2 - wa * wa / aa - radius * radius
    disc = B * B - A * C
    if disc < 0.0 or A <= 0.0:
        return MISSED
    t = (-B - sqrt(disc)) / A
    s = (wa + t * da) / aa
    if s < 0.0 or s > 1.0 or t >= nearest:
        return MISSED
    hit[0], hit[1] = (w0 + t * d0 - s * a0) / radius, (w1 + t * d1 - s * a1) / radius
    hit[2] = (w2 + t * d2 - s * a2) / radius
    hit[3], hit[4], hit[5] = p[0] + s * a0, p[1] + s * a1, p[2] + s * a2
    return t


@inner_no_memory
def _is_normal_of_strip(shape: Shape, e: int, normal: Any) -> bool:
    """Whether a normal at right angles to an edge lies between those of its faces."""
    f, g = shape.normals[shape.edge_faces[e, 0]], shape.normals[shape.edge_faces[e, 1]]
    outward = normal[0] * (f[0] + g[0]) + normal[1] * (f[1] + g[1]) + normal[2] * (f[2] + g[2])
    turned = normal[0] * (g[0] - f[0]) + normal[1] * (g[1] - f[1]) + normal[2] * (g[2] - f[2])
    return outward > 0.0 and abs(turned) < 1.0 - (f[0] * g[0] + f[1] * g[1] + f[2] * g[2])


@inner_no_memory
def _to_corner(shape: Shape, i: int, origin: Any, direction: Any, nearest: float, hit: Any) -> float:
    """As `_to_strip`, of the ball about a vertex."""
    p, radius = shape.vertices[i], shape.radius
    d0, d1, d2 = direction
    w0, w1, w2 = origin[0] - p[0], origin[1] - p[1], origin[2] - p[2]
    B = w0 * d0 + w1 * d1 + w2 * d2
    disc = B * B - (w0 * w0 + w1 * w1 + w2 * w2 - radius * radius)
    if disc < 0.0:
        return MISSED
    t = -B - sqrt(disc)
    if t >= nearest:
        return MISSED
    hit[0], hit[1], hit[2] = (w0 + t * d0) / radius, (w1 + t * d1) / radius, (w2 + t * d2) / radius
    hit[3], hit[4], hit[5] = p[0], p[1], p[2]
    return t


@inner_no_memory
def _is_normal_of_corner(shape: Shape, i: int, normal: Any) -> bool:
    """Whether no vertex lies farther out along a normal than vertex i."""
    p = shape.vertices[i]
    for k in range(shape.vertices.shape[0]):
        q = shape.vertices[k]
        if k != i and normal[0] * (q[0] - p[0]) + normal[1] * (q[1] - p[1]) + normal[2] * (q[2] - p[2]) >= 0.0:
            return False
    return True


@inner_no_memory
def motion_px(rig: CameraRig, view: int, pose: PoseState, about: Any, exposure_s: float) -> tuple[float, float, float]:
    """How far the centre moves in the picture within the exposure (x, y) [px], and how far the die turns in it [rad]."""
    det = about[4] * about[7] - about[5] * about[6]
    x, y, z, vx, vy, vz, turn = (
        rig.translation[view, 0],
        rig.translation[view, 1],
        rig.translation[view, 2],
        0.0,
        0.0,
        0.0,
        0.0,
    )
    for b in range(3):
        x += rig.rotation[view, 0, b] * pose.position[b]
        y += rig.rotation[view, 1, b] * pose.position[b]
        z += rig.rotation[view, 2, b] * pose.position[b]
        vx += rig.rotation[view, 0, b] * pose.velocity[b]
        vy += rig.rotation[view, 1, b] * pose.velocity[b]
        vz += rig.rotation[view, 2, b] * pose.velocity[b]
        turn += rig.rotation[view, 2, b] * pose.omega[b]
    da, db = (vx - x / z * vz) / z * exposure_s, (vy - y / z * vz) / z * exposure_s
    return (about[7] * da - about[5] * db) / det, (about[4] * db - about[6] * da) / det, turn * exposure_s
