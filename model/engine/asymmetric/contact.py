"""Contact of an asymmetric body: what is held where bounces have ended, and when its face is decided.

The equations are those of `asymmetric`. Forces and impulses are vertical.
"""

from __future__ import annotations

from math import asin, ceil, inf, pi, sqrt

from ...compiled import inner
from ..flight import table_height, table_velocity
from ..inertia import body_angular_velocity, to_table_axes, vertical_in_body
from ..rest import MARGIN_OF_PROOF, lowest_face_row, plumb_face_row
from ..types import APPROACHING, ROUNDING_BOUND, STANDING_HEIGHT, Array, AsymmetricBody, Contact, Indices, Plane
from .motion import clearance, free_acceleration, response, rotational_energy, unit_torque, vertex_velocity

REST_PART = 0.1
"""Part of the speed of the slowest bounce below which a vertex is at rest."""

REST_ROUNDING = 4.0
"""Multiple of the rounding of a velocity below which a vertex is at rest, where no bounce is slow."""

FORCE_TOLERANCE = 1e-12
"""Acceleration, as a part of the largest in the motion, below which it is rounding."""

RELEASE_MARGIN = 1e-7
"""By how much the table's acceleration exceeds what presses a face, in units of the largest one, when the face is released: then
the vertices accelerate away measurably."""


@inner
def apply_vertical_impulse(body: AsymmetricBody, y: Array, i: int, impulse: float) -> None:
    """A vertical impulse [N s] on a vertex, in place."""
    a, b, c = unit_torque(body, y, i)
    x, z, _ = to_table_axes(y, a, b, c)
    y[9] += impulse / body.mass
    y[10] += impulse * x
    y[11] += impulse * z


@inner
def _rotate_by(y: Array, a: float, b: float, c: float) -> None:
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
def project_on_contact(contact: Contact, y: Array, time: float) -> None:
    """Put vertices i and j (-1: i alone) at rest on the table, in place, by the least change in the metric of mass."""
    body, plane, i, j = contact
    for _ in range(2):
        h = clearance(body, plane, y, time, i)
        if j < 0:
            y[2] -= h
        else:
            k = clearance(body, plane, y, time, j)
            aii, aij, ajj = response(body, y, i, i), response(body, y, i, j), response(body, y, j, j)
            det = aii * ajj - aij * aij
            n, o = (aij * k - ajj * h) / det, (aij * h - aii * k) / det
            a, b, c = unit_torque(body, y, i)
            d, e, f = unit_torque(body, y, j)
            y[2] += (n + o) / body.mass
            _rotate_by(
                y,
                (n * a + o * d) / body.moments[0],
                (n * b + o * e) / body.moments[1],
                (n * c + o * f) / body.moments[2],
            )
    u = vertex_velocity(body, plane, y, time, i)
    if j < 0:
        apply_vertical_impulse(body, y, i, -u / response(body, y, i, i))
        return
    v = vertex_velocity(body, plane, y, time, j)
    aii, aij, ajj = response(body, y, i, i), response(body, y, i, j), response(body, y, j, j)
    det = aii * ajj - aij * aij
    apply_vertical_impulse(body, y, i, (aij * v - ajj * u) / det)
    apply_vertical_impulse(body, y, j, (aij * u - aii * v) / det)


@inner
def lay_on_face(body: AsymmetricBody, plane: Plane, y: Array, time: float, face: int) -> None:
    """Lay the die flat on a face, turning about the vertical with the same L_z, in place."""
    for _ in range(2):
        x, z, v = vertical_in_body(y)
        a, b, c = -body.normals[face, 0], -body.normals[face, 1], -body.normals[face, 2]
        # The body turns by δ, its vertical by u × δ: δ = a × u takes u to the direction a against the normal.
        _rotate_by(y, b * v - c * z, c * x - a * v, a * z - b * x)
    y[2] = body.offsets[face] + table_height(plane, time)
    _stop_all_but_vertical_spin(body, plane, y, time)


@inner
def _stop_all_but_vertical_spin(body: AsymmetricBody, plane: Plane, y: Array, time: float) -> None:
    """Leave only the turn about the vertical, with the same L_z, and the table's own velocity, in place."""
    x, z, v = vertical_in_body(y)
    i1, i2, i3 = body.moments[0], body.moments[1], body.moments[2]
    rate = y[12] / (i1 * x * x + i2 * z * z + i3 * v * v)
    y[10], y[11], _ = to_table_axes(y, i1 * rate * x, i2 * rate * z, i3 * rate * v)
    y[9] = table_velocity(plane, time)


@inner
def solve_complementarity(
    body: AsymmetricBody, y: Array, chosen: Indices, n: int, w: Array, tolerance: float, pushes: Array
) -> bool:
    """Pushes ≥ 0 on the vertices `chosen` (n of them) that leave each of `w` (n,) ≥ 0, and 0 where it is pushed.

    At most two vertices are pushed. Returns False where three are needed, which make all of `w` zero. Fills `pushes` (n,) and
    changes `w` to what remains.
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
            aii = response(body, y, i, i)
            if a == b:
                p, q = -w[a] / aii, 0.0
            else:
                aij, ajj = response(body, y, i, j), response(body, y, j, j)
                det = aii * ajj - aij * aij
                p, q = (aij * w[b] - ajj * w[a]) / det, (aij * w[a] - aii * w[b]) / det
            if p < 0.0 or q < 0.0:
                continue
            serves = True
            for k in range(n):
                left = w[k] + response(body, y, chosen[k], i) * p + response(body, y, chosen[k], j) * q
                serves = serves and left >= -tolerance
            if serves:
                for k in range(n):
                    w[k] += response(body, y, chosen[k], i) * p + response(body, y, chosen[k], j) * q
                pushes[a] += p
                pushes[b] += q
                return True
    return False


@inner
def struck_together(contact: Contact, y: Array, time: float, velocity: float, chosen: Indices) -> tuple[int, float]:
    """The vertex that `contact` holds and all that touch and approach at the same instant, into `chosen`: their number and bits.

    `velocity` [m/s] is that of the vertex."""
    body, plane, hit, _ = contact
    n, bits = 0, 0.0
    for k in range(body.vertices.shape[0]):
        is_low = clearance(body, plane, y, time, k) <= STANDING_HEIGHT * body.radius
        if k == hit or (is_low and vertex_velocity(body, plane, y, time, k) <= APPROACHING * velocity):
            chosen[n] = k
            bits += 2.0**k
            n += 1
    return n, bits


@inner
def simultaneous_impact(
    contact: Contact, y: Array, time: float, velocity: float, chi: float, chosen: Indices, n: int, room: Array
) -> None:
    """The smooth impact, in place, of the vertex that `contact` holds, with `velocity` [m/s], and of all n that touch with it."""
    body, plane, hit, _ = contact
    w, pushes = room[0], room[1]
    if n == 1:
        apply_vertical_impulse(body, y, hit, -(1.0 + chi) * velocity / response(body, y, hit, hit))
        return
    for k in range(n):
        w[k] = vertex_velocity(body, plane, y, time, chosen[k])
    if solve_complementarity(body, y, chosen, n, w, APPROACHING * abs(velocity), pushes):
        for k in range(n):
            apply_vertical_impulse(body, y, chosen[k], (1.0 + chi) * pushes[k])
    else:
        a, b, c = y[9], y[10], y[11]
        _stop_all_but_vertical_spin(body, plane, y, time)
        y[9] += chi * (y[9] - a)
        y[10] += chi * (y[10] - b)
        y[11] += chi * (y[11] - c)


@inner
def spin_growth_bound(body: AsymmetricBody) -> float:
    """c: the largest |Iⱼ - Iₖ|/Iᵢ."""
    a, b, c = body.moments[0], body.moments[1], body.moments[2]
    return max(abs(b - c) / a, abs(c - a) / b, abs(a - b) / c)


@inner
def resolve_contacts(
    body: AsymmetricBody, plane: Plane, y: Array, time: float, slow: float, chosen: Indices, room: Array
) -> tuple[int, int]:
    """End the bounces of the vertices that stand on the table, in place; returns the contact that the die presses on.

    It is (-1, -1) for none, (i, -1), (i, j), or (row of the face, -2). `slow` [m/s] is the speed of the slowest bounce.
    """
    w, pushes = room[0], room[1]
    spin = sqrt(2.0 * rotational_energy(body, y) / body.moments[0])
    speed = abs(y[9]) + spin * body.radius + plane.amplitude * plane.rate
    rounding = max(REST_PART * slow, REST_ROUNDING * ROUNDING_BOUND * (speed + sqrt(plane.g * body.radius)))
    n = 0
    for k in range(body.vertices.shape[0]):
        if clearance(body, plane, y, time, k) <= STANDING_HEIGHT * body.radius:
            u = vertex_velocity(body, plane, y, time, k)
            if abs(u) <= max(slow, rounding):
                chosen[n], w[n] = k, u
                n += 1
    if n == 0:
        return -1, -1
    if solve_complementarity(body, y, chosen, n, w, rounding, pushes):
        for k in range(n):
            apply_vertical_impulse(body, y, chosen[k], pushes[k])
    else:
        _stop_all_but_vertical_spin(body, plane, y, time)
    standing = 0
    for k in range(n):
        if vertex_velocity(body, plane, y, time, chosen[k]) <= rounding:
            chosen[standing] = chosen[k]
            standing += 1
    scale = plane.g + plane.amplitude * plane.rate * plane.rate + spin * spin * body.radius
    for k in range(standing):
        w[k] = free_acceleration(body, plane, y, time, chosen[k])
    if solve_complementarity(body, y, chosen, standing, w, FORCE_TOLERANCE * scale, pushes):
        held = 0
        for k in range(standing):
            if w[k] <= FORCE_TOLERANCE * scale:
                chosen[held] = chosen[k]
                held += 1
    else:
        held = standing
    if held >= 3:
        return lowest_face_row(body.normals, y), -2
    return (chosen[0] if held > 0 else -1), (chosen[1] if held > 1 else -1)


@inner
def decided_face(body: AsymmetricBody, plane: Plane, y: Array) -> int:
    """Row of the face that the die can no longer leave, or -1, on a table at rest."""
    face = plumb_face_row(body, y)
    energy = body.mass * (plane.g * y[2] + 0.5 * y[9] * y[9]) + rotational_energy(body, y)
    for e in range(body.edge_faces.shape[0]):
        if body.edge_faces[e, 0] == face or body.edge_faces[e, 1] == face:
            kept = 0.5 * y[12] * y[12] / body.edge_inertias[e]
            if energy >= body.mass * plane.g * body.edge_heights[e] + kept:
                return -1
    return face


@inner
def spins_forever(body: AsymmetricBody, plane: Plane, y: Array, i: int) -> bool:
    """Whether the die spins on vertex i, on a table at rest, and can never touch it with another one."""
    limit = body.safe_tilt_cosines[i]
    if limit > 1.0:
        return False
    a, b, c = body.vertices[i, 0], body.vertices[i, 1], body.vertices[i, 2]
    size = sqrt(a * a + b * b + c * c)
    a, b, c = -a / size, -b / size, -c / size
    x, z, v = vertical_in_body(y)
    p, q, r = body_angular_velocity(body, y)
    i1, i2, i3 = body.moments[0], body.moments[1], body.moments[2]
    along = a * i1 * p + b * i2 * q + c * i3 * r
    inertia_along = a * a * i1 + b * b * i2 + c * c * i3
    inertia_across = 0.5 * (i1 + i2 + i3 - inertia_along)
    across = y[12] - along * limit
    needed = body.mass * plane.g * size * limit + 0.5 * along * along / inertia_along
    needed += 0.5 * across * across / (inertia_across * (1.0 - limit * limit))
    energy = body.mass * (plane.g * y[2] + 0.5 * y[9] * y[9]) + rotational_energy(body, y)
    upright = a * x + b * z + c * v
    return bool(upright > limit + MARGIN_OF_PROOF and needed > energy * (1.0 + MARGIN_OF_PROOF))


@inner
def face_contact_duration(body: AsymmetricBody, plane: Plane, y: Array, time: float, face: int) -> float:
    """Time [s] until a die that lies on a face is no longer pressed on all of it; infinite for never.

    The table's force N = m (g + s'') acts where its moment about the centre is that of the spin: at the foot of the
    centre plus e/N. This point must stay inside the face, which bounds N from below and above.
    """
    i1, i2, i3 = body.moments[0], body.moments[1], body.moments[2]
    p, q, r = body_angular_velocity(body, y)
    nx, ny, nz = body.normals[face, 0], body.normals[face, 1], body.normals[face, 2]
    # ω × Iω, and u × of it with u = -n.
    tx, ty, tz = q * r * (i3 - i2), r * p * (i1 - i3), p * q * (i2 - i1)
    ex, ey, ez = -(ny * tz - nz * ty), -(nz * tx - nx * tz), -(nx * ty - ny * tx)
    least, most = 0.0, inf
    count = 0
    while count < body.corners.shape[1] and body.corners[face, count] >= 0:
        count += 1
    for k in range(count):
        a, b = body.vertices[body.corners[face, k]], body.vertices[body.corners[face, (k + 1) % count]]
        dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        # Inward across the edge: n × (b - a).
        ix, iy, iz = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
        inside = -(ix * a[0] + iy * a[1] + iz * a[2])
        drift = ix * ex + iy * ey + iz * ez
        if inside > 0.0 and drift < 0.0:
            least = max(least, -drift / inside)
        elif inside < 0.0 and drift > 0.0:
            most = min(most, -drift / inside)
    peak_table_acceleration = plane.amplitude * plane.rate * plane.rate
    if peak_table_acceleration == 0.0:
        return inf
    # With the peak acceleration a, g - a sin θ leaves [least, most]/m where sin θ exceeds `high` or falls below `low`.
    high = (plane.g - least / body.mass) / peak_table_acceleration + RELEASE_MARGIN
    low = (plane.g - most / body.mass) / peak_table_acceleration - RELEASE_MARGIN
    theta, after = plane.rate * time + plane.phase, inf
    if high < 1.0:
        crossing = asin(max(high, -1.0))
        after = crossing + 2.0 * pi * ceil((theta - crossing) / (2.0 * pi)) - theta
    if low > -1.0:
        crossing = pi - asin(min(low, 1.0))
        after = min(after, crossing + 2.0 * pi * ceil((theta - crossing) / (2.0 * pi)) - theta)
    return after / plane.rate
