"""What the pixels inside a die's faces say about its pose: compiled loops over texels and pixels (see `marks`).

Face coordinates (a, b) [m] are counted from the foot of the perpendicular from the die's centre, along two axes of the
body frame; the third axis is the outward normal. A texture is a cubic B-spline surface on a square grid of such
coordinates, one for each face, equal to about one on the bare paint. The ray of every pixel is known beforehand, lens
distortion undone, so that a pixel meets a face by one division and no picture is ever resampled when a pose is asked.

With D the ray in world axes, n the normal, e an axis of the face and r the point of the die that the pixel shows, counted
from the die's centre, a pose increment (δp, δθ) moves that point by q = δp + δθ × r, and the face coordinate under the pixel
by δa = s·q with s = (e·D)/(n·D) n - e. The derivative of the texture under the pixel is therefore t = T_a s_a + T_b s_b by
position, and r × t by rotation.
"""

from __future__ import annotations

from math import ceil, floor, hypot
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_fast_sums
from ..picture import solve_factored, solve_positive
from .face_geometry import exposure_shrink, face_in_camera, line_on_face, outline, reach_px, turn_to_world
from .kernel_types import (
    ALL,
    BLUR_STEP,
    FIRST,
    FITTING,
    GAINS,
    GRADIENT,
    GRAZING,
    KNOWN,
    MOST_HIDDEN,
    NO_BLUR,
    PLAIN,
    SHARED,
    THINNED,
    WARPS,
    Bench,
    Faces,
    Optics,
)
from .texture_blur import blur_on_face, extra_blur, soften, spline_bend, spline_value, spline_with_slopes
from .texture_gains import light_sums, relative_slopes, robust_gains


@compiled(nogil=True)
def mark_equations(
    image: Any, x0: int, y0: int, optics: Optics, faces: Faces, pos: Any, R: Any, vel: Any, omega: Any, places: bool,
    bench: Bench, H: Any, g: Any, place: Any, stats: Any,
) -> None:  # fmt: skip
    """Fill H (6, 6) and g (6,) of the pose increment from the marks of every face in view.

    `image` is a float32 window whose pixel [0, 0] lies at (x0, y0). `place` (faces, WARPS + SHARED, 6 + WARPS + SHARED + 1)
    becomes, for the warps of each face's texture and the lens blur [px], the rows of their normal matrix: by pose (6), by
    themselves, and the right side; with `places` False it is left alone, and the time for it saved. `stats` (faces, 3) become
    pixels seen, pixels used and noise [grey].
    """
    H[:] = 0.0
    g[:] = 0.0
    if places:
        place[:] = 0.0
    N = 6 + WARPS + SHARED if places else 6
    stats[:] = 0.0
    K, dist, Rcw, tcw, texel = optics.matrix, optics.distortion, optics.rotation, optics.translation, faces.texel
    offsets, corners, counts = faces.offsets, faces.corners, faces.counts
    height, width = image.shape
    n = faces.coefficients.shape[1]
    half = 0.5 * (n - 1)
    E, origin = np.zeros((3, 3)), np.zeros(3)
    most = corners.shape[1]
    px, planes = np.zeros((most, 2)), np.zeros((most, 3))
    more, further, own = np.zeros(3), np.zeros(3), np.zeros((2, 3))
    grey, texture, steep = bench.grey, bench.texture, bench.steep
    slope, ray, softer, line = bench.slope, bench.ray, bench.softer, bench.line
    c, A = np.zeros(GAINS), np.zeros((GAINS, GAINS))
    HH, gg, C = np.zeros((N, N)), np.zeros(N), np.zeros((N, GAINS))
    elim = np.zeros(GAINS)
    shrink, wide, centre, middle = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    exposure_shrink(Rcw, omega, optics.exposure, shrink)
    for i in range(3):
        centre[i] = tcw[i] + Rcw[i, 0] * pos[0] + Rcw[i, 1] * pos[1] + Rcw[i, 2] * pos[2]
        for j in range(3):
            # 1/S to first order: its square is 1e-7.
            wide[i, j] = (2.0 if i == j else 0.0) - shrink[i, j]
    for i in range(3):
        middle[i] = wide[i, 0] * centre[0] + wide[i, 1] * centre[1] + wide[i, 2] * centre[2]
    for f in range(faces.axes.shape[0]):
        if faces.usual_grey[f] <= 0.0:
            continue
        coef, use, base = faces.coefficients[f], faces.use[f], faces.base[f]
        if face_in_camera(Rcw, tcw, pos, R, faces.axes[f], offsets[f], E, origin) < GRAZING:
            continue
        blur_on_face(K, Rcw, E, origin, offsets[f], vel, omega, optics.exposure, own[0], own[1])
        border = faces.margin + reach_px(K, origin[2], own[1])
        if not outline(K, dist, E, origin, corners[f], counts[f], border, px, planes):
            continue
        top, bottom = px[0, 1], px[0, 1]
        for i in range(counts[f]):
            top, bottom = min(top, px[i, 1]), max(bottom, px[i, 1])
        first, last = max(ceil(top + border), y0), min(floor(bottom - border), y0 + height - 1)
        left, right = px[0, 0], px[0, 0]
        for i in range(counts[f]):
            left, right = min(left, px[i, 0]), max(right, px[i, 0])
        if extra_blur(own[0], own[1], optics.blur, base, texel, more) >= NO_BLUR:
            coef = bench.soft[soften(coef, more, bench.soft)]
        if places:
            extra_blur(own[0], own[1], BLUR_STEP * optics.blur, base, texel, further)
            for k in range(3):
                further[k] -= more[k]
            blurrier = bench.soft[2 + soften(coef, further, bench.soft[2:])]
        stride = 1 + max(int((last - first + 1) * (right - left)), 0) // len(grey)
        # Rays and centre are bent rather than the die, see `line_on_face`.
        for i in range(3):
            origin[i] = middle[i] + offsets[f] * E[2, i]
        gap = E[2, 0] * origin[0] + E[2, 1] * origin[1] + E[2, 2] * origin[2]
        m = FIRST
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
            begin, end = ceil(low), floor(high) + 1
            line_on_face(optics.rays[v], begin, end - begin, wide, E, origin, gap, texel, half, line[0], line[1])
            for u in range(begin, end):
                value, x, y = image[v - y0, u - x0], line[0, u - begin], line[1, u - begin]
                if value >= faces.saturation:
                    continue
                if not (1.0 <= x < n - 2.0 and 1.0 <= y < n - 2.0):
                    continue
                kind = use[int(y + 0.5), int(x + 0.5)]
                if kind == 0 or (kind == 1 and (u + v) % THINNED != 0):
                    continue
                level, gx, gy = spline_with_slopes(coef, x, y)
                grey[m], texture[m] = value, level
                bench.a[m], bench.b[m] = (x - half) / half, (y - half) / half
                slope[0, m], slope[1, m] = gx / texel, gy / texel
                steep[m] = hypot(gx, gy)
                if places:
                    softer[0, m] = 0.5 * spline_bend(coef, x, y)
                    softer[1, m] = (spline_value(blurrier, x, y) - level) / ((BLUR_STEP - 1.0) * optics.blur)
                ray[0, m], ray[1, m] = optics.rays[v, u, 0], optics.rays[v, u, 1]
                m += 1
        stats[f, 0] = m
        if m < 40:
            continue
        relative_slopes(steep, m)
        c[:] = 0.0
        scale = robust_gains(m, KNOWN, faces.floor_grey, 2.0 * faces.usual_grey[f], faces.cut, FITTING, bench, A, c)
        if scale < 0.0 or c[0] <= 0.0:
            continue
        used = 0.0
        for i in range(m):
            used += bench.weight[i]
        stats[f, 1], stats[f, 2] = used, scale
        if used < (1.0 - MOST_HIDDEN) * m:
            continue
        # Everything in camera axes; turned to world axes once, after the sum.
        _fill_by_pose(m, c, E, offsets[f], half * texel, bench)
        if places:
            _fill_by_places(m, c, half * texel, bench)
        for k in range(N):
            _add_products(m, k, bench, HH, gg, C)
        light_sums(m, grey, texture, bench.a, bench.b, bench.weight, A, elim)
        iv = 1.0 / (scale * scale)
        for k in range(PLAIN, GAINS):
            A[k, k] += 1.0 / (GRADIENT * c[0]) ** 2 / iv
        if not solve_positive(A, ALL, C[0], elim):
            continue
        for k in range(N):
            solve_factored(A, ALL, C[k], elim)
            for h in range(k, N):
                s = 0.0
                for q in range(GAINS):
                    s += C[h, q] * elim[q]
                HH[h, k] -= s
        for k in range(N):
            gg[k] *= iv
            HH[k, k] *= iv
            for h in range(k):
                HH[k, h] *= iv
                HH[h, k] = HH[k, h]
        turn_to_world(Rcw, HH, gg)
        for k in range(6):
            g[k] += gg[k]
            for h in range(6):
                H[k, h] += HH[k, h]
        if places:
            for k in range(WARPS + SHARED):
                for h in range(N):
                    place[f, k, h] = HH[6 + k, h]
                place[f, k, N] = gg[6 + k]


@inner_fast_sums
def _by_pose(
    ga: float, gb: float, dx: float, dy: float, a: float, b: float, E: Any, offset: float
) -> tuple[float, float, float, float, float, float]:
    """Derivative of a pixel's grey level by the pose, in camera axes, from its slopes by face coordinates, its ray and the
    place (a, b) that it shows."""
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
def _fill_by_pose(m: int, c: Any, E: Any, offset: float, unit: float, bench: Bench) -> None:
    """Derivatives of m grey levels by the pose."""
    by = bench.by
    for i in range(m):
        x, y = bench.a[i], bench.b[i]
        contrast = c[0] + c[4] * x + c[5] * y
        by[0, i], by[1, i], by[2, i], by[3, i], by[4, i], by[5, i] = _by_pose(
            contrast * bench.slope[0, i], contrast * bench.slope[1, i], bench.ray[0, i], bench.ray[1, i], unit * x, unit * y,
            E, offset,
        )  # fmt: skip


@inner_fast_sums
def _fill_by_places(m: int, c: Any, unit: float, bench: Bench) -> None:
    """The same by the warps of the texture and the lens blur."""
    by = bench.by
    for i in range(m):
        x, y = bench.a[i], bench.b[i]
        contrast = c[0] + c[4] * x + c[5] * y
        a, b, ga, gb = unit * x, unit * y, contrast * bench.slope[0, i], contrast * bench.slope[1, i]
        radial = ga * a + gb * b
        by[6, i], by[7, i] = -ga, -gb
        by[8, i], by[9, i], by[10, i], by[11, i] = -ga * a, -ga * b, -gb * a, -gb * b
        by[12, i], by[13, i] = -radial * a, -radial * b
        by[14, i], by[15, i] = contrast * bench.softer[0, i], contrast * bench.softer[1, i]


@inner_fast_sums
def _add_products(m: int, k: int, bench: Bench, HH: Any, gg: Any, C: Any) -> None:
    """Row k of HH (lower half), gg and C, the products with the light, all at unit noise, of m pixels: one sum after the other
    over all pixels, which the processor does several at a time."""
    mine, weight, left, heavy = bench.by[k], bench.weight, bench.left, bench.heavy
    texture, xs, ys = bench.texture, bench.a, bench.b
    pull, ct, c1, cx, cy, cxt, cyt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(m):
        w, t, x, y = weight[i] * mine[i], texture[i], xs[i], ys[i]
        heavy[i] = w
        pull += w * left[i]
        ct += w * t
        c1 += w
        cx += w * x
        cy += w * y
        cxt += w * x * t
        cyt += w * y * t
    gg[k] = pull
    C[k, 0], C[k, 1], C[k, 2], C[k, 3], C[k, 4], C[k, 5] = ct, c1, cx, cy, cxt, cyt
    for h in range(k + 1):
        other, total = bench.by[h], 0.0
        for i in range(m):
            total += heavy[i] * other[i]
        HH[k, h] = total
