"""model.engine.asymmetric.contact."""

from __future__ import annotations

from math import asin, ceil, inf, pi, sqrt

from ...compiled import inner
from ..types import Plane
from .motion import (
    NEAR,
    ROUNDING,
    Array,
    Indices,
    Top,
    approach_velocity,
    body_spin,
    clearance,
    free_acceleration,
    height_of_table,
    lever_arm,
    response,
    to_world,
    turning_energy,
    velocity_of_table,
    vertical_in_body,
)


@inner
def push_vertex(top: Top, y: Array, i: int, impulse: float) -> None:
    """A vertical impulse [N s] on a vertex, in place."""
    a, b, c = lever_arm(top, y, i)
    x, z, _ = to_world(y, a, b, c)
    y[9] += impulse / top.mass
    y[10] += impulse * x
    y[11] += impulse * z


@inner
def _turn(y: Array, a: float, b: float, c: float) -> None:
    """Turn the body by a small rotation vector [rad] in its own axes, in place; L stays as it is."""
    w, x, z, v = y[3], y[4], y[5], y[6]
    a, b, c = 0.5 * a, 0.5 * b, 0.5 * c
    y[3], y[4], y[5], y[6] = (
        w - x * a - z * b - v * c,
        x + w * a + z * c - v * b,
        z + w * b + v * a - x * c,
        v + w * c + x * b - z * a,
    )
    norm = sqrt(y[3] * y[3] + y[4] * y[4] + y[5] * y[5] + y[6] * y[6])
    y[3:7] /= norm


@inner
def stand_on(top: Top, plane: Plane, y: Array, time: float, i: int, j: int) -> None:
    """Put vertices i and j (-1: i alone) at rest on the table, by the least change in the metric of mass, in place."""
    for _ in range(2):
        h = clearance(top, plane, y, time, i)
        if j < 0:
            y[2] -= h
        else:
            k = clearance(top, plane, y, time, j)
            aii, aij, ajj = response(top, y, i, i), response(top, y, i, j), response(top, y, j, j)
            det = aii * ajj - aij * aij
            n, o = (aij * k - ajj * h) / det, (aij * h - aii * k) / det
            a, b, c = lever_arm(top, y, i)
            d, e, f = lever_arm(top, y, j)
            y[2] += (n + o) / top.mass
            _turn(
                y,
                (n * a + o * d) / top.moments[0],
                (n * b + o * e) / top.moments[1],
                (n * c + o * f) / top.moments[2],
            )
    u = approach_velocity(top, plane, y, time, i)
    if j < 0:
        push_vertex(top, y, i, -u / response(top, y, i, i))
        return
    v = approach_velocity(top, plane, y, time, j)
    aii, aij, ajj = response(top, y, i, i), response(top, y, i, j), response(top, y, j, j)
    det = aii * ajj - aij * aij
    push_vertex(top, y, i, (aij * v - ajj * u) / det)
    push_vertex(top, y, j, (aij * u - aii * v) / det)


@inner
def lie_on(top: Top, plane: Plane, y: Array, time: float, face: int) -> None:
    """Lay the die flat on a face, turning about the vertical with the same L_z, in place."""
    for _ in range(2):
        x, z, v = vertical_in_body(y)
        a, b, c = -top.normals[face, 0], -top.normals[face, 1], -top.normals[face, 2]
        # The body turns by δ, its vertical by u × δ: δ = a × u takes u to the direction a against the normal.
        _turn(y, b * v - c * z, c * x - a * v, a * z - b * x)
    y[2] = top.offsets[face] + height_of_table(plane, time)
    _still(top, plane, y, time)


@inner
def _still(top: Top, plane: Plane, y: Array, time: float) -> None:
    """Leave only the turn about the vertical, with the same L_z, and the table's own velocity, in place."""
    x, z, v = vertical_in_body(y)
    i1, i2, i3 = top.moments[0], top.moments[1], top.moments[2]
    rate = y[12] / (i1 * x * x + i2 * z * z + i3 * v * v)
    y[10], y[11], _ = to_world(y, i1 * rate * x, i2 * rate * z, i3 * rate * v)
    y[9] = velocity_of_table(plane, time)


@inner
def complementary(top: Top, y: Array, chosen: Indices, n: int, w: Array, tolerance: float, pushes: Array) -> bool:
    """Pushes >= 0 on the vertices `chosen` (n of them) that leave each of `w` (n,) >= 0 and 0 where pushed.

    At most two vertices are pushed; returns False where three are needed, so that all of `w` become 0. Fills `pushes`
    (n,) and changes `w` to what remains.
    """
    pushes[:n] = 0.0
    least = 0.0
    for k in range(n):
        least = min(least, w[k])
    if least >= -tolerance:
        return True
    for a in range(n):
        for b in range(a, n):
            i, j = chosen[a], chosen[b]
            aii = response(top, y, i, i)
            if a == b:
                p, q = -w[a] / aii, 0.0
            else:
                aij, ajj = response(top, y, i, j), response(top, y, j, j)
                det = aii * ajj - aij * aij
                p, q = (aij * w[b] - ajj * w[a]) / det, (aij * w[a] - aii * w[b]) / det
            if p < 0.0 or q < 0.0:
                continue
            serves = True
            for k in range(n):
                left = w[k] + response(top, y, chosen[k], i) * p + response(top, y, chosen[k], j) * q
                serves = serves and left >= -tolerance
            if serves:
                for k in range(n):
                    w[k] += response(top, y, chosen[k], i) * p + response(top, y, chosen[k], j) * q
                pushes[a] += p
                pushes[b] += q
                return True
    return False


@inner
def spin_growth_bound(top: Top) -> float:
    """c: the largest |Iⱼ - Iₖ|/Iᵢ."""
    a, b, c = top.moments[0], top.moments[1], top.moments[2]
    return max(abs(b - c) / a, abs(c - a) / b, abs(a - b) / c)


@inner
def settle(top: Top, plane: Plane, y: Array, time: float, slow: float, chosen: Indices, room: Array) -> tuple[int, int]:
    """End the bounces of the vertices that stand on the table, in place, and find which the die presses on.

    Returns (-1, -1) for none, (i, -1), (i, j), or (face, -2).
    """
    w, pushes = room[0], room[1]
    spin = sqrt(2.0 * turning_energy(top, y) / top.moments[0])
    speed = abs(y[9]) + spin * top.radius + plane.amplitude * plane.rate
    # A tenth of the switch speed is rest; where nothing is switched, what rounding leaves.
    rounding = max(0.1 * slow, 4.0 * ROUNDING * (speed + sqrt(plane.g * top.radius)))
    n = 0
    for k in range(top.vertices.shape[0]):
        if clearance(top, plane, y, time, k) <= NEAR * top.radius:
            u = approach_velocity(top, plane, y, time, k)
            if abs(u) <= max(slow, rounding):
                chosen[n], w[n] = k, u
                n += 1
    if n == 0:
        return -1, -1
    if complementary(top, y, chosen, n, w, rounding, pushes):
        for k in range(n):
            push_vertex(top, y, chosen[k], pushes[k])
    else:
        _still(top, plane, y, time)
    standing = 0
    for k in range(n):
        if approach_velocity(top, plane, y, time, chosen[k]) <= rounding:
            chosen[standing] = chosen[k]
            standing += 1
    scale = plane.g + plane.amplitude * plane.rate * plane.rate + spin * spin * top.radius
    for k in range(standing):
        w[k] = free_acceleration(top, plane, y, time, chosen[k])
    if complementary(top, y, chosen, standing, w, 1e-12 * scale, pushes):
        held = 0
        for k in range(standing):
            if w[k] <= 1e-12 * scale:
                chosen[held] = chosen[k]
                held += 1
    else:
        held = standing
    if held >= 3:
        return lowest_face_row(top, y), -2
    return (chosen[0] if held > 0 else -1), (chosen[1] if held > 1 else -1)


@inner
def lowest_face_row(top: Top, y: Array) -> int:
    """Row of the face normal that points down most."""
    x, z, v = vertical_in_body(y)
    best, lowest = 0, inf
    for k in range(top.normals.shape[0]):
        down = top.normals[k, 0] * x + top.normals[k, 1] * z + top.normals[k, 2] * v
        if down < lowest:
            best, lowest = k, down
    return best


@inner
def decided_face(top: Top, plane: Plane, y: Array) -> int:
    """Row of the face that the die can no longer leave, or -1, on a table at rest."""
    x, z, v = vertical_in_body(y)
    face, best = 0, -inf
    for k in range(top.normals.shape[0]):
        down = -(top.normals[k, 0] * x + top.normals[k, 1] * z + top.normals[k, 2] * v) / top.offsets[k]
        if down > best:
            face, best = k, down
    energy = top.mass * (plane.g * y[2] + 0.5 * y[9] * y[9]) + turning_energy(top, y)
    for e in range(top.edge_faces.shape[0]):
        if top.edge_faces[e, 0] == face or top.edge_faces[e, 1] == face:
            kept = 0.5 * y[12] * y[12] / top.edge_inertias[e]
            if energy >= top.mass * plane.g * top.edge_heights[e] + kept:
                return -1
    return face


@inner
def leaves_face_after(top: Top, plane: Plane, y: Array, time: float, face: int) -> float:
    """Time [s] until a die that lies on a face is no longer pressed on all of it; inf for never.

    The table's force N = m (g + s'') acts where its moment about the centre is that of the spin: at the foot of the
    centre plus e/N. It must stay inside the face, which bounds N from below and above.
    """
    i1, i2, i3 = top.moments[0], top.moments[1], top.moments[2]
    p, q, r = body_spin(top, y)
    nx, ny, nz = top.normals[face, 0], top.normals[face, 1], top.normals[face, 2]
    # ω × Iω, and u × of it with u = -n.
    tx, ty, tz = q * r * (i3 - i2), r * p * (i1 - i3), p * q * (i2 - i1)
    ex, ey, ez = -(ny * tz - nz * ty), -(nz * tx - nx * tz), -(nx * ty - ny * tx)
    least, most = 0.0, inf
    count = 0
    while count < top.corners.shape[1] and top.corners[face, count] >= 0:
        count += 1
    for k in range(count):
        a, b = top.vertices[top.corners[face, k]], top.vertices[top.corners[face, (k + 1) % count]]
        dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        # Inward across the edge: n × (b - a).
        ix, iy, iz = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
        inside = -(ix * a[0] + iy * a[1] + iz * a[2])
        drift = ix * ex + iy * ey + iz * ez
        if inside > 0.0 and drift < 0.0:
            least = max(least, -drift / inside)
        elif inside < 0.0 and drift > 0.0:
            most = min(most, -drift / inside)
    swing = plane.amplitude * plane.rate * plane.rate
    if swing == 0.0:
        return inf
    # g - swing sin θ leaves [least, most]/m where sin θ passes above `high` or below `low`; by a little more than that,
    # so that the vertices then accelerate away measurably.
    high = (plane.g - least / top.mass) / swing + 1e-7
    low = (plane.g - most / top.mass) / swing - 1e-7
    theta, after = plane.rate * time + plane.phase, inf
    if high < 1.0:
        crossing = asin(max(high, -1.0))
        after = crossing + 2.0 * pi * ceil((theta - crossing) / (2.0 * pi)) - theta
    if low > -1.0:
        crossing = pi - asin(min(low, 1.0))
        after = min(after, crossing + 2.0 * pi * ceil((theta - crossing) / (2.0 * pi)) - theta)
    return after / plane.rate
