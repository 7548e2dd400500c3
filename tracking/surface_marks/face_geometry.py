"""tracking.surface_marks.face_geometry."""

from __future__ import annotations

from math import cos, hypot, sin, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory, inner_nogil
from ..picture import pixel_of_ray


@inner_no_memory
def face_in_camera(Rcw: Any, tcw: Any, pos: Any, R: Any, axes: Any, offset: float, E: Any, origin: Any) -> float:
    """Axes E (3, 3, rows a, b, normal) and origin (3,) of a face in the camera; returns the cosine of the view."""
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
    """S (3, 3), camera axes, with c + S r the mean place over the exposure of a point r of a die about its centre c.

    A turning point runs along an arc, whose middle lies nearer to the axis than the arc does: S = 1 - (ω² 1 - ω ωᵀ) T²/24. At
    150 rad/s and half a millisecond the die seems smaller by 2e-4, and as much further off.
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
def smear(S: Any, centre: Any, offset: float, E: Any, origin: Any) -> None:
    """The axes and the origin of a face as they seem on a picture with S."""
    still = E.copy()
    for k in range(3):
        for i in range(3):
            E[k, i] = S[i, 0] * still[k, 0] + S[i, 1] * still[k, 1] + S[i, 2] * still[k, 2]
    for i in range(3):
        origin[i] = centre[i] + offset * E[2, i]


@inner_no_memory
def outline(
    K: Any, dist: Any, E: Any, origin: Any, corners: Any, count: int, margin: float, px: Any, planes: Any
) -> bool:
    """Corners px (count, 2) of the flat part of a face and half-planes (count, 3), positive inside by `margin` [px] and
    more; False where a corner lies behind the camera."""
    mx, my = 0.0, 0.0
    for i in range(count):
        x = origin[0] + corners[i, 0] * E[0, 0] + corners[i, 1] * E[1, 0]
        y = origin[1] + corners[i, 0] * E[0, 1] + corners[i, 1] * E[1, 1]
        z = origin[2] + corners[i, 0] * E[0, 2] + corners[i, 1] * E[1, 2]
        if z <= 1e-6:
            return False
        px[i, 0], px[i, 1] = pixel_of_ray(K, dist, x / z, y / z)
        mx += px[i, 0] / count
        my += px[i, 1] / count
    for i in range(count):
        j = (i + 1) % count
        nx, ny = -(px[j, 1] - px[i, 1]), px[j, 0] - px[i, 0]
        size = hypot(nx, ny)
        if size < 1e-9:
            return False
        nx, ny = nx / size, ny / size
        if nx * (mx - px[i, 0]) + ny * (my - px[i, 1]) < 0.0:
            nx, ny = -nx, -ny
        planes[i, 0], planes[i, 1] = nx, ny
        planes[i, 2] = -(nx * px[i, 0] + ny * px[i, 1]) - margin
    return True


@inner_no_memory
def reach_px(K: Any, depth: float, motion: Any) -> float:
    """Pixels by which motion during the exposure carries a face's border to either side."""
    return 0.5 * sqrt(12.0 * (motion[0] + motion[2])) * sqrt(K[0, 0] * K[1, 1]) / depth


@inner_fast_sums_no_memory
def line_on_face(
    rays: Any, first: int, count: int, wide: Any, E: Any, origin: Any, gap: float, texel: float, half: float, xs: Any,
    ys: Any,
) -> None:  # fmt: skip
    """Where the pixels of one line, from the `first` on, lie on a face [texel]. With λ D = c + S r on the ray D through a pixel
    (see `exposure_shrink`), r = λ D/S - c/S; `wide` is 1/S, `origin` that of the face after it, and `gap` its distance."""
    w00, w01, w02 = wide[0, 0], wide[0, 1], wide[0, 2]
    w10, w11, w12 = wide[1, 0], wide[1, 1], wide[1, 2]
    w20, w21, w22 = wide[2, 0], wide[2, 1], wide[2, 2]
    ax, ay, az = E[0, 0] / texel, E[0, 1] / texel, E[0, 2] / texel
    bx, by, bz = E[1, 0] / texel, E[1, 1] / texel, E[1, 2] / texel
    nx, ny, nz = E[2, 0], E[2, 1], E[2, 2]
    x0 = half - ax * origin[0] - ay * origin[1] - az * origin[2]
    y0 = half - bx * origin[0] - by * origin[1] - bz * origin[2]
    for i in range(count):
        dx, dy = float(rays[first + i, 0]), float(rays[first + i, 1])
        X, Y, Z = w00 * dx + w01 * dy + w02, w10 * dx + w11 * dy + w12, w20 * dx + w21 * dy + w22
        depth = gap / (nx * X + ny * Y + nz * Z)
        xs[i] = depth * (ax * X + ay * Y + az * Z) + x0
        ys[i] = depth * (bx * X + by * Y + bz * Z) + y0


@inner_nogil
def turn_to_world(Rcw: Any, H: Any, g: Any) -> None:
    """Turn the first six rows and columns (two vectors) from camera to world axes."""
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
    """exp(w) R, by Rodrigues' formula; below 1e-8 rad the first-order form is exact to rounding."""
    angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a = sin(angle) / angle if angle > 1e-8 else 1.0
    b = (1.0 - cos(angle)) / (angle * angle) if angle > 1e-8 else 0.5
    out = np.empty((3, 3))
    for k in range(3):
        x, y, z = R[0, k], R[1, k], R[2, k]
        cx, cy, cz = w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x
        out[0, k] = x + a * cx + b * (w[1] * cz - w[2] * cy)
        out[1, k] = y + a * cy + b * (w[2] * cx - w[0] * cz)
        out[2, k] = z + a * cz + b * (w[0] * cy - w[1] * cx)
    return out


@inner_no_memory
def moved_px(K: Any, Rcw: Any, tcw: Any, pos: Any, step: Any, reach: float) -> float:
    """How far in the picture a step (6,) of a die that reaches so far [m] moves its farthest points at the most."""
    x, y, z, depth = 0.0, 0.0, 0.0, tcw[2]
    for j in range(3):
        x += Rcw[0, j] * step[j]
        y += Rcw[1, j] * step[j]
        z += Rcw[2, j] * step[j]
        depth += Rcw[2, j] * pos[j]
    turned = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    return float(K[0, 0] / depth * (hypot(x, y) + reach * (turned + abs(z) / depth)))
