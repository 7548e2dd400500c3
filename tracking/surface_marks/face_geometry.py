"""Where a die's faces lie in a picture, and where the pixels of a picture lie on a face.

A pixel meets the plane of a face by one division, because its camera ray is known in advance with the lens distortion
undone; no picture is resampled when a pose is evaluated. Quantities are in camera axes unless stated otherwise.
"""

from __future__ import annotations

from math import cos, hypot, sin, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory, inner_nogil
from ..picture import ROW_ITERATIONS, PoseState, pixel_of_ray, turned_within
from .kernel_types import Optics, RowDrift

LEAST_DEPTH_M = 1e-6
"""A corner nearer to the camera's plane than this has no pixel."""
SHORTEST_SIDE_PX = 1e-9
"""A side of a face shorter than this in the picture has no direction."""
SMALL_ANGLE_RAD = 1e-8
"""Below it the first-order rotation is exact to rounding."""


@inner_no_memory
def face_in_camera(Rcw: Any, tcw: Any, pos: Any, R: Any, axes: Any, offset: float, E: Any, origin: Any) -> float:
    """Fill axes E (3, 3; rows a, b, normal) and origin (3,) of a face in camera axes; return the cosine between its
    normal and the direction to the camera."""
    for k in range(3):
        for i in range(3):
            s = 0.0
            for j in range(3):
                w = R[j, 0] * axes[k, 0] + R[j, 1] * axes[k, 1] + R[j, 2] * axes[k, 2]
                s += Rcw[i, j] * w
            E[k, i] = s
    for i in range(3):
        origin[i] = tcw[i] + Rcw[i, 0] * pos[0] + Rcw[i, 1] * pos[1] + Rcw[i, 2] * pos[2] + offset * E[2, i]
    away = sqrt(origin[0] ** 2 + origin[1] ** 2 + origin[2] ** 2)
    return -(E[2, 0] * origin[0] + E[2, 1] * origin[1] + E[2, 2] * origin[2]) / away


@inner_nogil
def exposure_shrink(Rcw: Any, omega: Any, exposure: float, S: Any) -> None:
    """Fill S (3, 3), camera axes: c + S r is the mean position over the exposure T of a point r of a die about its
    centre c.

    A point of a rotating die moves on an arc, whose mean lies nearer to the axis: S = 1 - (ω² 1 - ω ωᵀ) T²/24. At 150
    rad/s and half a millisecond the die looks smaller by 2e-4, and farther away by the same share.
    """
    w = np.zeros(3)
    for i in range(3):
        for j in range(3):
            w[i] += Rcw[i, j] * omega[j]
    k = exposure * exposure / 24.0
    for i in range(3):
        for j in range(3):
            S[i, j] = k * w[i] * w[j]
        S[i, i] += 1.0 - k * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2])


@inner_nogil
def shrink_face(S: Any, centre: Any, offset: float, E: Any, origin: Any) -> None:
    """Apply S of `exposure_shrink` to the axes and the origin of a face of a die about `centre`."""
    exact = E.copy()
    for k in range(3):
        for i in range(3):
            E[k, i] = S[i, 0] * exact[k, 0] + S[i, 1] * exact[k, 1] + S[i, 2] * exact[k, 2]
    for i in range(3):
        origin[i] = centre[i] + offset * E[2, i]


@inner_nogil
def drift_of_rows(optics: Optics, pose: PoseState) -> RowDrift:
    """How a die moves in camera axes from the row of its centre, in which its pose holds, to other rows."""
    Rcw, tcw = optics.rotation, optics.translation
    centre, velocity, omega = np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        centre[i] = tcw[i]
        for j in range(3):
            centre[i] += Rcw[i, j] * pose.position[j]
            velocity[i] += Rcw[i, j] * pose.velocity[j]
            omega[i] += Rcw[i, j] * pose.omega[j]
    _, row = pixel_of_ray(optics.matrix, optics.distortion, centre[0] / centre[2], centre[1] / centre[2])
    return RowDrift(optics.row_s, row, centre, velocity, omega)


@inner_no_memory
def drifted_point(drift: RowDrift, dt: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point of the die in camera axes, dt [s] after its pose."""
    c, v = drift.centre, drift.velocity
    x, y, z = turned_within(drift.omega, dt, x - c[0], y - c[1], z - c[2])
    return x + c[0] + v[0] * dt, y + c[1] + v[1] * dt, z + c[2] + v[2] * dt


@inner_no_memory
def drifted_face(drift: RowDrift, v: float, E: Any, centre: Any, offset: float, E_then: Any, origin_then: Any) -> float:
    """Fill axes and origin of a face when row v is exposed, from those at the pose, of a die about `centre`; return the
    distance of its plane."""
    dt = (v - drift.row) * drift.row_s
    for k in range(3):
        E_then[k, 0], E_then[k, 1], E_then[k, 2] = turned_within(drift.omega, dt, E[k, 0], E[k, 1], E[k, 2])
    gap = 0.0
    for i in range(3):
        origin_then[i] = centre[i] + dt * drift.velocity[i] + offset * E_then[2, i]
        gap += E_then[2, i] * origin_then[i]
    return gap


@inner_no_memory
def pixel_of_drifting(optics: Optics, drift: RowDrift, x: float, y: float, z: float) -> tuple[float, float]:
    """Pixel of a point (x, y, z) of the die at its pose, when the row that shows it is exposed."""
    u, v = pixel_of_ray(optics.matrix, optics.distortion, x / z, y / z)
    for _ in range(ROW_ITERATIONS):
        a, b, c = drifted_point(drift, (v - drift.row) * drift.row_s, x, y, z)
        u, v = pixel_of_ray(optics.matrix, optics.distortion, a / c, b / c)
    return u, v


@inner_no_memory
def face_outline(
    optics: Optics, drift: RowDrift, E: Any, origin: Any, corners: Any, margin: float, px: Any, planes: Any
) -> bool:
    """Fill the corners px (count, 2) of the flat part of a face, of `corners` (count, 2) [m], and its half-planes (count,
    3), positive inside by `margin` [px] and more; False if a corner lies behind the camera, or the face is folded: seen edge-on
    and bent by a rolling shutter or distortion, it does not lie on one side of its edges."""
    mx, my, count, inside = 0.0, 0.0, corners.shape[0], 0
    for i in range(count):
        x = origin[0] + corners[i, 0] * E[0, 0] + corners[i, 1] * E[1, 0]
        y = origin[1] + corners[i, 0] * E[0, 1] + corners[i, 1] * E[1, 1]
        z = origin[2] + corners[i, 0] * E[0, 2] + corners[i, 1] * E[1, 2]
        if z <= LEAST_DEPTH_M:
            return False
        px[i, 0], px[i, 1] = pixel_of_ray(optics.matrix, optics.distortion, x / z, y / z)
        if drift.row_s != 0.0:
            px[i, 0], px[i, 1] = pixel_of_drifting(optics, drift, x, y, z)
        mx += px[i, 0] / count
        my += px[i, 1] / count
    for i in range(count):
        j = (i + 1) % count
        nx, ny = -(px[j, 1] - px[i, 1]), px[j, 0] - px[i, 0]
        size = hypot(nx, ny)
        if size < SHORTEST_SIDE_PX:
            return False
        nx, ny = nx / size, ny / size
        if nx * (mx - px[i, 0]) + ny * (my - px[i, 1]) >= 0.0:
            inside += 1
        else:
            nx, ny = -nx, -ny
        planes[i, 0], planes[i, 1] = nx, ny
        planes[i, 2] = -(nx * px[i, 0] + ny * px[i, 1]) - margin
    return inside == 0 or inside == count


@inner_no_memory
def motion_reach_px(K: Any, depth: float, motion: Any) -> float:
    """Largest displacement [px] of a face's border to either side by its motion during the exposure, of variances
    `motion`."""
    return 0.5 * sqrt(12.0 * (motion[0] + motion[2])) * sqrt(K[0, 0] * K[1, 1]) / depth


@inner_fast_sums_no_memory
def row_on_face(
    rays: Any, inverse_shrink: Any, E: Any, origin: Any, gap: float, texel: float, half: float, line: Any
) -> None:
    """Fill `line` with the face coordinates [texel] of the pixels of one image row, of given `rays` (count, 2).

    A pixel with the ray D shows the point r of the die for which λ D = c + S r (see `exposure_shrink`): r = λ S⁻¹ D -
    S⁻¹ c. `inverse_shrink` is S⁻¹, `origin` the face's after it, and `gap` the distance of its plane.
    """
    w00, w01, w02 = inverse_shrink[0, 0], inverse_shrink[0, 1], inverse_shrink[0, 2]
    w10, w11, w12 = inverse_shrink[1, 0], inverse_shrink[1, 1], inverse_shrink[1, 2]
    w20, w21, w22 = inverse_shrink[2, 0], inverse_shrink[2, 1], inverse_shrink[2, 2]
    ax, ay, az = E[0, 0] / texel, E[0, 1] / texel, E[0, 2] / texel
    bx, by, bz = E[1, 0] / texel, E[1, 1] / texel, E[1, 2] / texel
    nx, ny, nz = E[2, 0], E[2, 1], E[2, 2]
    x0 = half - ax * origin[0] - ay * origin[1] - az * origin[2]
    y0 = half - bx * origin[0] - by * origin[1] - bz * origin[2]
    for i in range(rays.shape[0]):
        dx, dy = float(rays[i, 0]), float(rays[i, 1])
        X, Y, Z = w00 * dx + w01 * dy + w02, w10 * dx + w11 * dy + w12, w20 * dx + w21 * dy + w22
        depth = gap / (nx * X + ny * Y + nz * Z)
        line[0, i] = depth * (ax * X + ay * Y + az * Z) + x0
        line[1, i] = depth * (bx * X + by * Y + bz * Z) + y0


@inner_nogil
def turn_to_world(Rcw: Any, H: Any, g: Any) -> None:
    """Rotate the first six parameters (two vectors) of normal equations H, g from camera to world axes."""
    N = len(g)
    T = np.zeros((N, N))
    for k in range(3):
        for h in range(3):
            T[k, h] = Rcw[h, k]
            T[3 + k, 3 + h] = Rcw[h, k]
    for k in range(6, N):
        T[k, k] = 1.0
    M = np.zeros((N, N))
    y = np.zeros(N)
    for i in range(N):
        for j in range(N):
            s = 0.0
            for k in range(N):
                s += T[i, k] * H[k, j]
            M[i, j] = s
        for k in range(N):
            y[i] += T[i, k] * g[k]
    for i in range(N):
        for j in range(N):
            s = 0.0
            for k in range(N):
                s += M[i, k] * T[j, k]
            H[i, j] = s
    for k in range(N):
        g[k] = y[k]


@inner_nogil
def turned_by(R: Any, w: Any) -> Any:
    """exp(w) R, by Rodrigues' formula."""
    angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a = sin(angle) / angle if angle > SMALL_ANGLE_RAD else 1.0
    b = (1.0 - cos(angle)) / (angle * angle) if angle > SMALL_ANGLE_RAD else 0.5
    out = np.empty((3, 3))
    for k in range(3):
        x, y, z = R[0, k], R[1, k], R[2, k]
        cx, cy, cz = w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x
        out[0, k] = x + a * cx + b * (w[1] * cz - w[2] * cy)
        out[1, k] = y + a * cy + b * (w[2] * cx - w[0] * cz)
        out[2, k] = z + a * cz + b * (w[0] * cy - w[1] * cx)
    return out


@inner_no_memory
def largest_move_px(optics: Optics, position: Any, step: Any, reach: float) -> float:
    """Upper bound [px] of the displacement of any point, at most `reach` [m] from the centre, by a pose step (6,)."""
    Rcw = optics.rotation
    x, y, z, depth = 0.0, 0.0, 0.0, optics.translation[2]
    for j in range(3):
        x += Rcw[0, j] * step[j]
        y += Rcw[1, j] * step[j]
        z += Rcw[2, j] * step[j]
        depth += Rcw[2, j] * position[j]
    turned = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    return float(optics.matrix[0, 0] / depth * (hypot(x, y) + reach * (turned + abs(z) / depth)))
