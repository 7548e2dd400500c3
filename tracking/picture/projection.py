"""tracking.picture.projection."""

from __future__ import annotations

from math import hypot, sqrt
from typing import Any

from ...model.compiled import inner_no_memory
from .kernel_types import CameraRig, Shape, Workspace


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
def place_die(shape: Shape, rig: CameraRig, view: int, pos: Any, R: Any, work: Workspace) -> bool:
    """Put the die before one view: vertices in camera axes and in pixels, which faces look at it. False where a vertex
    lies behind the camera."""
    Rcw, tcw = rig.rotation[view], rig.translation[view]
    K, dist = rig.matrix[view], rig.distortion[view]
    for i in range(shape.vertices.shape[0]):
        x, y, z = shape.vertices[i, 0], shape.vertices[i, 1], shape.vertices[i, 2]
        for a in range(3):
            work.arm[i, a] = R[a, 0] * x + R[a, 1] * y + R[a, 2] * z
        for a in range(3):
            work.cam[i, a] = tcw[a]
            for b in range(3):
                work.cam[i, a] += Rcw[a, b] * (pos[b] + work.arm[i, b])
        if work.cam[i, 2] <= 1e-6:
            return False
        work.px[i, 0], work.px[i, 1] = project_point(K, dist, work.cam[i, 0], work.cam[i, 1], work.cam[i, 2], work.J)
    # From the die's centre to the camera's.
    e0, e1, e2 = -pos[0], -pos[1], -pos[2]
    for b in range(3):
        e0 -= Rcw[b, 0] * tcw[b]
        e1 -= Rcw[b, 1] * tcw[b]
        e2 -= Rcw[b, 2] * tcw[b]
    gap = sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    for f in range(shape.normals.shape[0]):
        for a in range(3):
            work.normal[f, a] = (
                R[a, 0] * shape.normals[f, 0] + R[a, 1] * shape.normals[f, 1] + R[a, 2] * shape.normals[f, 2]
            )
        toward = work.normal[f, 0] * e0 + work.normal[f, 1] * e1 + work.normal[f, 2] * e2
        work.facing[f] = (toward - shape.offsets[f] - shape.radius) / gap
    return True


@inner_no_memory
def outline_hull(shape: Shape, work: Workspace) -> int:
    """Lines (a, b, c) of the outline of the die as placed, a x + b y + c > 0 inside; their number. The ball's radius is
    left to APART_PX and to the caller's margin."""
    mx, my = 0.0, 0.0
    for i in range(work.px.shape[0]):
        mx += work.px[i, 0] / work.px.shape[0]
        my += work.px[i, 1] / work.px.shape[0]
    count = 0
    for e in range(shape.edges.shape[0]):
        if (work.facing[shape.edge_faces[e, 0]] > 0.0) == (work.facing[shape.edge_faces[e, 1]] > 0.0):
            continue
        i, j = shape.edges[e, 0], shape.edges[e, 1]
        dx, dy = work.px[j, 0] - work.px[i, 0], work.px[j, 1] - work.px[i, 1]
        length = max(hypot(dx, dy), 1e-9)
        a, b = -dy / length, dx / length
        c = -(a * work.px[i, 0] + b * work.px[i, 1])
        if a * mx + b * my + c < 0.0:
            a, b, c = -a, -b, -c
        work.hull[count, 0], work.hull[count, 1], work.hull[count, 2] = a, b, c
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
def neighbours(face: Any, edges: Any, px: Any, e: int, steep: bool, out: Any) -> int:
    """The other edges of a face (its edges padded with -1) as functions of the pixel line that crosses them: first and
    last line, where the first vertex's line is, position there, and step a line. How many there are."""
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
        if abs(rise) < 1e-9:
            continue
        slack = 0.02 * abs(rise)
        out[count, 0], out[count, 1] = min(start, start + rise) - slack, max(start, start + rise) + slack
        out[count, 2], out[count, 3], out[count, 4] = start, at, run / rise
        count += 1
    return count


@inner_no_memory
def room_beside(others: Any, count: int, line: int, at: float) -> float:
    """Distance along a pixel line from an edge's point to the nearest other edge of its face that the line crosses."""
    nearest = 1e9
    for j in range(count):
        if line >= others[j, 0] and line <= others[j, 1]:
            nearest = min(nearest, abs(others[j, 3] + (line - others[j, 2]) * others[j, 4] - at))
    return nearest


@inner_no_memory
def reach_of_die(shape: Shape) -> float:
    """Farthest point of the die from its centre [m]."""
    reach = 0.0
    for i in range(shape.outer.shape[0]):
        reach = max(reach, sqrt(shape.outer[i, 0] ** 2 + shape.outer[i, 1] ** 2 + shape.outer[i, 2] ** 2))
    return reach


@inner_no_memory
def draw_outer(shape: Shape, rig: CameraRig, view: int, pos: Any, R: Any, work: Workspace) -> bool:
    """Put the vertices of the flat faces' sharp polyhedron, not those of the inner body, in pixels on the desk."""
    for i in range(shape.outer.shape[0]):
        for a in range(3):
            work.cam[i, a] = rig.translation[view, a]
            for b in range(3):
                arm = R[b, 0] * shape.outer[i, 0] + R[b, 1] * shape.outer[i, 1] + R[b, 2] * shape.outer[i, 2]
                work.cam[i, a] += rig.rotation[view, a, b] * (pos[b] + arm)
        if work.cam[i, 2] <= 1e-6:
            return False
        work.px[i, 0], work.px[i, 1] = project_point(
            rig.matrix[view], rig.distortion[view], work.cam[i, 0], work.cam[i, 1], work.cam[i, 2], work.J
        )
    return True


@inner_no_memory
def rounded_contour(shape: Shape, rig: CameraRig, view: int, pos: Any, work: Workspace) -> tuple[int, float]:
    """Lines on the desk's hull of the outline of a rounded die's inner body as placed, their number, and how far beyond them its
    contour lies in the picture; none of a sharp die, whose faces end there."""
    if shape.radius == 0.0:
        return 0, 0.0
    depth = rig.translation[view, 2]
    for b in range(3):
        depth += rig.rotation[view, 2, b] * pos[b]
    return outline_hull(shape, work), shape.radius * rig.matrix[view, 0, 0] / depth


@inner_no_memory
def face_lines(shape: Shape, work: Workspace, f: int, lines: Any) -> int:
    """Half-planes a x + b y + c >= 0 of a face as placed."""
    mx, my, count = 0.0, 0.0, 0
    for j in range(shape.face_edges.shape[1]):
        e = shape.face_edges[f, j]
        if e < 0:
            break
        i, k = shape.edges[e, 0], shape.edges[e, 1]
        a, b = work.px[i, 1] - work.px[k, 1], work.px[k, 0] - work.px[i, 0]
        lines[j, 0], lines[j, 1], lines[j, 2] = a, b, -(a * work.px[i, 0] + b * work.px[i, 1])
        mx += 0.5 * (work.px[i, 0] + work.px[k, 0])
        my += 0.5 * (work.px[i, 1] + work.px[k, 1])
        count += 1
    for j in range(count):
        if lines[j, 0] * mx / count + lines[j, 1] * my / count + lines[j, 2] < 0.0:
            for q in range(3):
                lines[j, q] = -lines[j, q]
    return count


@inner_no_memory
def scale_px(rig: CameraRig, pos: Any) -> float:
    """Pixels a metre at a point, in the nearest view."""
    best = 0.0
    for view in range(rig.camera.shape[0]):
        z = rig.translation[view, 2]
        for b in range(3):
            z += rig.rotation[view, 2, b] * pos[b]
        if z > 1e-6:
            best = max(best, rig.matrix[view, 0, 0] / z)
    return best
