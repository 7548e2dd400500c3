"""The die's geometry before a camera: projection, visible faces, outline, and the windows of a frame that show it.

x_cam = R_cw x_world + t_cw. Lens distortion is that of Brown and Conrady, as in `tracking.camera`.

A rolling shutter exposes one row after another. The pose of a frame is then that of the instant at which the row of the
die's centre is exposed, so that it needs no knowledge of the motion (`exposure_delay` counts it from the time of the
frame). A point in another row is seen dt later, moved by v dt + (exp(ω dt) - 1) r. Within the height of a die dt is
some tenths of a millisecond: exp is expanded to the second order, and gravity moves the die by less than a micrometre.
"""

from __future__ import annotations

from math import hypot, inf, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner, inner_no_memory
from .kernel_types import CameraRig, FrameWindows, PoseState, Shape, Workspace

LEAST_DEPTH_M = 1e-6
"""Depth below which a point counts as behind the camera."""
LEAST_RISE_PX = 1e-9
"""An edge that crosses fewer pixel lines is parallel to them."""
SLACK = 0.02
"""Share of a neighbouring edge by which it is extended at either end, so that no line slips through at a vertex."""
NO_EDGE_PX = 1e9
"""Distance to the next edge if there is none."""
SMALLEST_WINDOW_PX = 4
"""A window that is no wider shows no die."""
WINDOW_PX = 20.0
"""Margin of the window about the outline: the widest band, and the error of a prediction."""
NARROW_WINDOW_PX = 11.0
"""The same for a refinement at the lens blur alone, whose band is a few pixels wide."""
ROW_ITERATIONS = 3
"""Iterations for the row in which a moving point is seen; each divides the error by 15 or more for a die of 3 m/s."""


@inner_no_memory
def pixel_of_ray(K: Any, dist: Any, a: float, b: float) -> tuple[float, float]:
    """Pixel of a camera ray (a, b) = (x/z, y/z), lens distortion included: the model of `tracking.camera`."""
    k1, k2, p1, p2, k3 = dist[0], dist[1], dist[2], dist[3], dist[4]
    r2 = a * a + b * b
    g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    ad = a * g + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    bd = b * g + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    return K[0, 0] * ad + K[0, 1] * bd + K[0, 2], K[1, 1] * bd + K[1, 2]


@inner_no_memory
def defocus_variance(aperture_m: float, focus_m: float, focal_px: float, depth_m: float) -> float:
    """Variance [px²] of the blur of a point out of focus, along either axis.

    A lens of diameter D that is focused at z₀ draws a point at z as a disc of the radius D f |1/z - 1/z₀|/2 [px], f being the
    focal length [px]; a uniform disc has a quarter of its squared radius as variance."""
    radius = 0.5 * aperture_m * focal_px * (1.0 / depth_m - 1.0 / focus_m)
    return 0.25 * radius * radius


@inner_no_memory
def depth_of(rig: CameraRig, view: int, position: Any) -> float:
    """Depth [m] of a point (3,) before a view."""
    depth = rig.translation[view, 2]
    for b in range(3):
        depth += rig.rotation[view, 2, b] * position[b]
    return float(depth)


@inner_no_memory
def lens_blur_at(rig: CameraRig, view: int, position: Any, blur_px: float) -> float:
    """Standard deviation [px] of the lens blur of a point (3,) in a view, with that of the lens in focus given."""
    depth = depth_of(rig, view, position)
    if rig.aperture[view] == 0.0 or depth <= LEAST_DEPTH_M:
        return blur_px
    return sqrt(blur_px**2 + defocus_variance(rig.aperture[view], rig.focus[view], rig.matrix[view, 0, 0], depth))


@inner_no_memory
def project_point(K: Any, dist: Any, x: float, y: float, z: float, J: Any) -> tuple[float, float]:
    """Pixel of a camera point and, in J (2, 3), its derivative [px/m]."""
    iz = 1.0 / z
    a, b = x * iz, y * iz
    k1, k2, p1, p2, k3 = dist[0], dist[1], dist[2], dist[3], dist[4]
    r2 = a * a + b * b
    g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dg = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    aa = g + 2.0 * a * a * dg + 2.0 * p1 * b + 6.0 * p2 * a
    ab = 2.0 * a * b * dg + 2.0 * p1 * a + 2.0 * p2 * b
    bb = g + 2.0 * b * b * dg + 6.0 * p1 * b + 2.0 * p2 * a
    ua, ub = K[0, 0] * aa + K[0, 1] * ab, K[0, 0] * ab + K[0, 1] * bb
    va, vb = K[1, 1] * ab, K[1, 1] * bb
    J[0, 0], J[0, 1], J[0, 2] = ua * iz, ub * iz, -(ua * a + ub * b) * iz
    J[1, 0], J[1, 1], J[1, 2] = va * iz, vb * iz, -(va * a + vb * b) * iz
    return pixel_of_ray(K, dist, a, b)


@inner_no_memory
def exposure_delay(rig: CameraRig, pos: Any) -> float:
    """Time [s] from that of the frame to the exposure of the row in which the first camera sees a point; 0 for a global
    shutter."""
    if rig.row_s[0] == 0.0:
        return 0.0
    x, y, z = rig.translation[0, 0], rig.translation[0, 1], rig.translation[0, 2]
    for b in range(3):
        x += rig.rotation[0, 0, b] * pos[b]
        y += rig.rotation[0, 1, b] * pos[b]
        z += rig.rotation[0, 2, b] * pos[b]
    if z <= LEAST_DEPTH_M:
        return 0.0
    _, row = pixel_of_ray(rig.matrix[0], rig.distortion[0], x / z, y / z)
    return (row - rig.middle_row[0]) * rig.row_s[0]


@inner_no_memory
def turned_within(omega: Any, dt: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector after a rotation by ω dt, to the second order."""
    wx, wy, wz = omega[0] * dt, omega[1] * dt, omega[2] * dt
    ax, ay, az = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    return (
        x + ax + 0.5 * (wy * az - wz * ay),
        y + ay + 0.5 * (wz * ax - wx * az),
        z + az + 0.5 * (wx * ay - wy * ax),
    )


@inner_no_memory
def camera_point(rig: CameraRig, view: int, pose: PoseState, arm: Any, dt: float) -> tuple[float, float, float]:
    """The point (x, y, z) of a die in camera axes dt [s] after its pose; `arm` is the point from the die's centre, in
    world axes at the pose."""
    pos, vel, Rcw, tcw = pose.position, pose.velocity, rig.rotation[view], rig.translation[view]
    x, y, z = turned_within(pose.omega, dt, arm[0], arm[1], arm[2])
    x, y, z = x + pos[0] + vel[0] * dt, y + pos[1] + vel[1] * dt, z + pos[2] + vel[2] * dt
    return (
        tcw[0] + Rcw[0, 0] * x + Rcw[0, 1] * y + Rcw[0, 2] * z,
        tcw[1] + Rcw[1, 0] * x + Rcw[1, 1] * y + Rcw[1, 2] * z,
        tcw[2] + Rcw[2, 0] * x + Rcw[2, 1] * y + Rcw[2, 2] * z,
    )


@inner_no_memory
def _move_vertex(rig: CameraRig, view: int, pose: PoseState, late: float, i: int, work: Workspace) -> None:
    """Move a placed vertex, in camera axes and in pixels, to where it is when its own row is exposed. `late` is the time
    of the pose from that of the frame."""
    for _ in range(ROW_ITERATIONS):
        dt = (work.vertex_px[i, 1] - rig.middle_row[view]) * rig.row_s[view] - late
        x, y, z = camera_point(rig, view, pose, work.vertex_arm[i], dt)
        if z <= LEAST_DEPTH_M:
            return
        work.vertex_camera[i, 0], work.vertex_camera[i, 1], work.vertex_camera[i, 2] = x, y, z
        work.vertex_px[i, 0], work.vertex_px[i, 1] = pixel_of_ray(rig.matrix[view], rig.distortion[view], x / z, y / z)


@inner_no_memory
def place_die(shape: Shape, rig: CameraRig, view: int, pose: PoseState, work: Workspace) -> bool:
    """Fill in the workspace the vertices of the die in one view, in camera axes and in pixels, and the cosines of its
    faces. False if a vertex lies behind the camera."""
    pos, R = pose.position, pose.rotation
    Rcw, tcw = rig.rotation[view], rig.translation[view]
    K, dist = rig.matrix[view], rig.distortion[view]
    for i in range(shape.vertices.shape[0]):
        x, y, z = shape.vertices[i, 0], shape.vertices[i, 1], shape.vertices[i, 2]
        for a in range(3):
            work.vertex_arm[i, a] = R[a, 0] * x + R[a, 1] * y + R[a, 2] * z
        for a in range(3):
            work.vertex_camera[i, a] = tcw[a]
            for b in range(3):
                work.vertex_camera[i, a] += Rcw[a, b] * (pos[b] + work.vertex_arm[i, b])
        if work.vertex_camera[i, 2] <= LEAST_DEPTH_M:
            return False
        work.vertex_px[i, 0], work.vertex_px[i, 1] = project_point(
            K, dist, work.vertex_camera[i, 0], work.vertex_camera[i, 1], work.vertex_camera[i, 2], work.J
        )
    late = 0.0
    if rig.row_s[view] != 0.0:
        late = exposure_delay(rig, pos)
        for i in range(shape.vertices.shape[0]):
            _move_vertex(rig, view, pose, late, i, work)
    # From the die's centre to the camera's.
    e0, e1, e2 = -pos[0], -pos[1], -pos[2]
    for b in range(3):
        e0 -= Rcw[b, 0] * tcw[b]
        e1 -= Rcw[b, 1] * tcw[b]
        e2 -= Rcw[b, 2] * tcw[b]
    gap = sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    for f in range(shape.normals.shape[0]):
        for a in range(3):
            work.face_normal[f, a] = (
                R[a, 0] * shape.normals[f, 0] + R[a, 1] * shape.normals[f, 1] + R[a, 2] * shape.normals[f, 2]
            )
        n0, n1, n2, c0, c1, c2 = work.face_normal[f, 0], work.face_normal[f, 1], work.face_normal[f, 2], e0, e1, e2
        if rig.row_s[view] != 0.0:
            # A face is turned away or not when its own rows are exposed.
            dt = (_middle_row(shape, work, f) - rig.middle_row[view]) * rig.row_s[view] - late
            n0, n1, n2 = turned_within(pose.omega, dt, n0, n1, n2)
            c0, c1, c2 = c0 - pose.velocity[0] * dt, c1 - pose.velocity[1] * dt, c2 - pose.velocity[2] * dt
        toward = n0 * c0 + n1 * c1 + n2 * c2
        work.face_cosine[f] = (toward - shape.offsets[f] - shape.radius) / gap
    return True


@inner_no_memory
def _middle_row(shape: Shape, work: Workspace, f: int) -> float:
    """Row in the picture of the middle of a face, of the corners as placed."""
    total, count = 0.0, 0
    for j in range(shape.face_edges.shape[1]):
        e = shape.face_edges[f, j]
        if e >= 0:
            total += work.vertex_px[shape.edges[e, 0], 1] + work.vertex_px[shape.edges[e, 1], 1]
            count += 2
    return total / count


@inner_no_memory
def outline_hull(shape: Shape, work: Workspace) -> int:
    """Fill in the workspace's hull the lines (a, b, c) of the outline of the placed die, a x + b y + c > 0 inside, with the
    ends of their edges; return their number.

    The outline is that of the inner body: margins of the caller cover the radius of a rounded die.
    """
    mx, my = 0.0, 0.0
    for i in range(work.vertex_px.shape[0]):
        mx += work.vertex_px[i, 0] / work.vertex_px.shape[0]
        my += work.vertex_px[i, 1] / work.vertex_px.shape[0]
    count = 0
    for e in range(shape.edges.shape[0]):
        if (work.face_cosine[shape.edge_faces[e, 0]] > 0.0) == (work.face_cosine[shape.edge_faces[e, 1]] > 0.0):
            continue
        i, j = shape.edges[e, 0], shape.edges[e, 1]
        dx, dy = work.vertex_px[j, 0] - work.vertex_px[i, 0], work.vertex_px[j, 1] - work.vertex_px[i, 1]
        length = max(hypot(dx, dy), 1e-9)
        a, b = -dy / length, dx / length
        c = -(a * work.vertex_px[i, 0] + b * work.vertex_px[i, 1])
        if a * mx + b * my + c < 0.0:
            a, b, c = -a, -b, -c
        work.hull[count, 0], work.hull[count, 1], work.hull[count, 2] = a, b, c
        first = b * work.vertex_px[i, 0] - a * work.vertex_px[i, 1]
        last = b * work.vertex_px[j, 0] - a * work.vertex_px[j, 1]
        work.hull[count, 3], work.hull[count, 4] = min(first, last), max(first, last)
        count += 1
    return count


@inner_no_memory
def within_hull(hull: Any, count: int, x: float, y: float, margin: float) -> bool:
    """Whether a pixel lies inside the outline widened by a margin [px]."""
    for k in range(count):
        if hull[k, 0] * x + hull[k, 1] * y + hull[k, 2] < -margin:
            return False
    return count > 0


@inner_no_memory
def within_rounded_outline(hull: Any, count: int, x: float, y: float, radius: float) -> bool:
    """Whether a pixel lies inside the outline of an inner body or no farther than a radius [px] from it."""
    nearest_squared = inf
    for k in range(count):
        d = hull[k, 0] * x + hull[k, 1] * y + hull[k, 2]
        if d < -radius:
            return False
        if d < 0.0:
            along = hull[k, 1] * x - hull[k, 0] * y
            beyond = max(hull[k, 3] - along, along - hull[k, 4], 0.0)
            nearest_squared = min(nearest_squared, d * d + beyond * beyond)
    return count > 0 and (nearest_squared == inf or nearest_squared <= radius * radius)


@inner_no_memory
def neighbour_edges(face: Any, edges: Any, px: Any, e: int, steep: bool, out: Any) -> int:
    """Fill the other edges of a face (its edges padded with -1) as functions of the pixel line that crosses them;
    return their number.

    A row of `out` is: first and last line, line of the first vertex, position there, and step per line. Lines are rows
    of the picture if `steep`, columns otherwise.
    """
    count = 0
    for j in range(face.shape[0]):
        o = face[j]
        if o < 0:
            break
        if o == e:
            continue
        i, k = edges[o, 0], edges[o, 1]
        dx, dy = px[k, 0] - px[i, 0], px[k, 1] - px[i, 1]
        run, rise, start, at = (dx, dy, px[i, 1], px[i, 0]) if steep else (dy, dx, px[i, 0], px[i, 1])
        if abs(rise) < LEAST_RISE_PX:
            continue
        slack = SLACK * abs(rise)
        out[count, 0], out[count, 1] = min(start, start + rise) - slack, max(start, start + rise) + slack
        out[count, 2], out[count, 3], out[count, 4] = start, at, run / rise
        count += 1
    return count


@inner_no_memory
def room_beside(others: Any, count: int, line: int, at: float) -> float:
    """Distance [px] along a pixel line from a point of an edge to the nearest other edge of its face that the line
    crosses."""
    nearest = NO_EDGE_PX
    for j in range(count):
        if line >= others[j, 0] and line <= others[j, 1]:
            nearest = min(nearest, abs(others[j, 3] + (line - others[j, 2]) * others[j, 4] - at))
    return nearest


@inner_no_memory
def reach_of_die(shape: Shape) -> float:
    """Distance [m] of the farthest point of the die from its centre."""
    reach = 0.0
    for i in range(shape.outer.shape[0]):
        reach = max(reach, sqrt(shape.outer[i, 0] ** 2 + shape.outer[i, 1] ** 2 + shape.outer[i, 2] ** 2))
    return reach


@inner_no_memory
def place_outer(shape: Shape, rig: CameraRig, view: int, pose: PoseState, work: Workspace) -> bool:
    """Fill in the workspace the pixels of the sharp polyhedron of the flat faces, in place of those of the inner body.
    False if a vertex lies behind the camera."""
    pos, R = pose.position, pose.rotation
    for i in range(shape.outer.shape[0]):
        for a in range(3):
            work.vertex_camera[i, a] = rig.translation[view, a]
            for b in range(3):
                arm = R[b, 0] * shape.outer[i, 0] + R[b, 1] * shape.outer[i, 1] + R[b, 2] * shape.outer[i, 2]
                work.vertex_camera[i, a] += rig.rotation[view, a, b] * (pos[b] + arm)
        if work.vertex_camera[i, 2] <= LEAST_DEPTH_M:
            return False
        work.vertex_px[i, 0], work.vertex_px[i, 1] = project_point(
            rig.matrix[view],
            rig.distortion[view],
            work.vertex_camera[i, 0],
            work.vertex_camera[i, 1],
            work.vertex_camera[i, 2],
            work.J,
        )
    if rig.row_s[view] != 0.0:
        late = exposure_delay(rig, pos)
        for i in range(shape.outer.shape[0]):
            for b in range(3):
                work.vertex_arm[i, b] = (
                    R[b, 0] * shape.outer[i, 0] + R[b, 1] * shape.outer[i, 1] + R[b, 2] * shape.outer[i, 2]
                )
            _move_vertex(rig, view, pose, late, i, work)
    return True


@inner_no_memory
def rounded_contour(shape: Shape, rig: CameraRig, view: int, pos: Any, work: Workspace) -> tuple[int, float]:
    """Fill in the workspace's hull the outline of a rounded die's inner body as placed. Return the number of its lines,
    and how far beyond them the contour lies in the picture [px]; 0 for a sharp die, whose faces end there."""
    if shape.radius == 0.0:
        return 0, 0.0
    depth = rig.translation[view, 2]
    for b in range(3):
        depth += rig.rotation[view, 2, b] * pos[b]
    return outline_hull(shape, work), shape.radius * rig.matrix[view, 0, 0] / depth


@inner_no_memory
def face_lines(shape: Shape, work: Workspace, f: int, lines: Any) -> int:
    """Fill the half-planes a x + b y + c >= 0 of a placed face; return their number, 0 for a folded face (`turn_inwards`)."""
    mx, my, count = 0.0, 0.0, 0
    for j in range(shape.face_edges.shape[1]):
        e = shape.face_edges[f, j]
        if e < 0:
            break
        i, k = shape.edges[e, 0], shape.edges[e, 1]
        a, b = work.vertex_px[i, 1] - work.vertex_px[k, 1], work.vertex_px[k, 0] - work.vertex_px[i, 0]
        lines[j, 0], lines[j, 1], lines[j, 2] = a, b, -(a * work.vertex_px[i, 0] + b * work.vertex_px[i, 1])
        mx += 0.5 * (work.vertex_px[i, 0] + work.vertex_px[k, 0])
        my += 0.5 * (work.vertex_px[i, 1] + work.vertex_px[k, 1])
        count += 1
    return count if turn_inwards(shape, f, count, mx / count, my / count, lines) else 0


@inner_no_memory
def turn_inwards(shape: Shape, f: int, count: int, mx: float, my: float, lines: Any) -> bool:
    """Give the lines of a face's `count` edges, each drawn from the edge's first end to its second, the sign that makes them
    positive at the middle of the face (mx, my). False if the face is folded: it does not lie on one side of its edges.

    A rolling shutter, or distortion, bends what is seen edge-on, so that two of its sides cross. The half-planes of such a face
    may contain half of the picture. Whether the face lies on the left of an edge or on its right is known from the die, and must
    agree with the picture for all edges, or in a mirror for none.
    """
    agree = 0
    for j in range(count):
        inside = lines[j, 0] * mx + lines[j, 1] * my + lines[j, 2] >= 0.0
        if inside == _is_left_of(shape, f, shape.face_edges[f, j]):
            agree += 1
        if not inside:
            for q in range(3):
                lines[j, q] = -lines[j, q]
    return agree == 0 or agree == count


@inner_no_memory
def _is_left_of(shape: Shape, f: int, e: int) -> bool:
    """Whether one of its two faces lies on the left of an edge, seen from outside, along it from its first end to its second."""
    n, p, q = shape.normals[f], shape.vertices[shape.edges[e, 0]], shape.vertices[shape.edges[e, 1]]
    g = shape.normals[shape.edge_faces[e, 0] + shape.edge_faces[e, 1] - f]
    d0, d1, d2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    # The other face slopes away beyond the edge.
    left = g[0] * (n[1] * d2 - n[2] * d1) + g[1] * (n[2] * d0 - n[0] * d2) + g[2] * (n[0] * d1 - n[1] * d0)
    return bool(left < 0.0)


@inner_no_memory
def scale_px(rig: CameraRig, pos: Any) -> float:
    """Pixels per metre at a point, in the nearest view."""
    best = 0.0
    for view in range(rig.camera.shape[0]):
        z = rig.translation[view, 2]
        for b in range(3):
            z += rig.rotation[view, 2, b] * pos[b]
        if z > LEAST_DEPTH_M:
            best = max(best, rig.matrix[view, 0, 0] / z)
    return best


@inner(nogil=True, shared=True)
def crop_windows(
    pictures: Any, rig: CameraRig, shape: Shape, pose: PoseState, margin: float, work: Workspace
) -> FrameWindows:
    """Copy the windows of one frame's pictures (cameras, height, width) that hold the die and its reflection with a
    margin [px].

    A camera that does not show the die gets a window of size 0.
    """
    cameras, height, width = pictures.shape
    corner, size = np.zeros((cameras, 2), np.int64), np.zeros((cameras, 2), np.int64)
    low, high = np.full((cameras, 2), 1e9), np.full((cameras, 2), -1e9)
    for view in range(rig.camera.shape[0]):
        if not place_die(shape, rig, view, pose, work):
            continue
        c = rig.camera[view]
        for a in range(2):
            low[c, a] = min(low[c, a], work.vertex_px[:, a].min() - margin)
            high[c, a] = max(high[c, a], work.vertex_px[:, a].max() + margin)
    rows, columns = 0, 0
    for c in range(cameras):
        x0, y0 = int(max(low[c, 0], 0.0)), int(max(low[c, 1], 0.0))
        x1, y1 = int(min(high[c, 0] + 1.0, float(width))), int(min(high[c, 1] + 1.0, float(height)))
        if x1 - x0 > SMALLEST_WINDOW_PX and y1 - y0 > SMALLEST_WINDOW_PX:
            corner[c, 0], corner[c, 1], size[c, 0], size[c, 1] = x0, y0, x1 - x0, y1 - y0
            rows, columns = max(rows, y1 - y0), max(columns, x1 - x0)
    pixels = np.empty((cameras, rows, columns), np.float32)
    for c in range(cameras):
        for i in range(size[c, 1]):
            there, here = pictures[c, corner[c, 1] + i, corner[c, 0] :], pixels[c, i]
            for j in range(size[c, 0]):
                here[j] = there[j]
    return FrameWindows(pixels, corner, size)
