"""tracking.surface_marks.texture_gains."""

from __future__ import annotations

from math import floor, hypot
from typing import Any

import numpy as np

from ...model.compiled import compiled, inner_fast_sums, inner_no_memory, inner_nogil
from ..picture import pixel_of_ray, solve_positive
from .face_geometry import exposure_shrink, face_in_camera, outline, reach_px, smear
from .kernel_types import (
    EVERY_THIRD,
    FIRST,
    GAINS,
    GRADIENT,
    GRAZING,
    LOOKING,
    MANY,
    MOST_HIDDEN,
    NO_BLUR,
    PLAIN,
    STEEP,
    Bench,
    Faces,
    Optics,
)
from .texture_blur import blur_on_face, extra_blur, soften


@inner_no_memory
def relative_slopes(steep: Any, n: int) -> None:
    """Slopes as shares of the largest; where there is none, all pixels count alike."""
    most = 0.0
    for i in range(n):
        most = max(most, steep[i])
    for i in range(n):
        steep[i] = steep[i] / most if most > 0.0 else 1.0


@inner_fast_sums
def light_sums(n: int, grey: Any, texture: Any, xs: Any, ys: Any, weight: Any, A: Any, y: Any) -> None:
    """Normal matrix A (lower half) and right side y of the six numbers of light, T, 1, a, b, aT, bT: of their products only
    eighteen differ."""
    s0, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    t0, tx, ty, txx, txy, tyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    q0, qx, qy, qxx, qxy, qyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    y0, y1, y2, y3, y4, y5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        w, t, a, b = weight[i], texture[i], xs[i], ys[i]
        wa, wb, wt, wg = w * a, w * b, w * t, w * grey[i]
        waa, wab, wbb, wtt, wgt = wa * a, wa * b, wb * b, wt * t, wg * t
        s0 += w
        sx += wa
        sy += wb
        sxx += waa
        sxy += wab
        syy += wbb
        t0 += wt
        tx += wa * t
        ty += wb * t
        txx += waa * t
        txy += wab * t
        tyy += wbb * t
        q0 += wtt
        qx += wtt * a
        qy += wtt * b
        qxx += wtt * a * a
        qxy += wtt * a * b
        qyy += wtt * b * b
        y0 += wgt
        y1 += wg
        y2 += wg * a
        y3 += wg * b
        y4 += wgt * a
        y5 += wgt * b
    A[0, 0] = q0
    A[1, 0], A[1, 1] = t0, s0
    A[2, 0], A[2, 1], A[2, 2] = tx, sx, sxx
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = ty, sy, sxy, syy
    A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4] = qx, tx, txx, txy, qxx
    A[5, 0], A[5, 1], A[5, 2], A[5, 3], A[5, 4], A[5, 5] = qy, ty, txy, tyy, qxy, qyy
    y[0], y[1], y[2], y[3], y[4], y[5] = y0, y1, y2, y3, y4, y5


@inner_fast_sums
def _light_left(n: int, c: Any, grey: Any, texture: Any, xs: Any, ys: Any, left: Any) -> None:
    """What the light leaves of the grey levels."""
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    for i in range(n):
        a, b = xs[i], ys[i]
        left[i] = grey[i] - (c0 + c4 * a + c5 * b) * texture[i] - (c1 + c2 * a + c3 * b)


@inner_fast_sums
def _weights(n: int, icut: float, left: Any, weight: Any) -> float:
    """The biweight of residuals, given the inverse of its cut; their sum."""
    total = 0.0
    for i in range(n):
        q = left[i] * icut
        q = max(1.0 - q * q, 0.0)
        weight[i] = q * q
        total += q * q
    return total


@inner_nogil
def robust_gains(
    n: int, known: bool, floor_grey: float, ceiling_grey: float, cut: float, turns: int, bench: Bench, A: Any, c: Any
) -> float:
    """Fit the light of n pixels by biweight least squares: all GAINS numbers where the texture is `known`, else a plane.
    Fills the bench's weights and residuals and c, and returns the scale [grey], between `floor_grey` and `ceiling_grey`; -1
    where there is no fit. The scale is that of the pixels that are `steep`: where the texture changes, small errors of place
    and blur add to the noise, and those are the pixels that the pose rests on."""
    grey, texture, xs, ys = bench.grey, bench.texture, bench.a, bench.b
    weight, left, size, steep = bench.weight, bench.left, bench.size, bench.steep
    y, x = np.zeros(GAINS), np.zeros(GAINS)
    for i in range(n):
        weight[i] = 1.0
    scale = floor_grey
    K = GAINS if known else PLAIN - 1
    for turn_number in range(turns):
        light_sums(n, grey, texture, xs, ys, weight, A, y)
        if known:
            level = max(abs(c[0]), scale) if turn_number > 0 else 255.0
            for a in range(PLAIN, GAINS):
                A[a, a] += (scale / (GRADIENT * level)) ** 2
        else:
            for a in range(K):
                y[a] = y[a + 1]
                for b in range(a + 1):
                    A[a, b] = A[a + 1, b + 1]
        if not solve_positive(A, K, y, x):
            return -1.0
        for a in range(K):
            c[a if known else a + 1] = x[a]
        _light_left(n, c, grey, texture, xs, ys, left)
        step = EVERY_THIRD if turn_number < turns - 1 and n > MANY else 1
        m = 0
        for i in range(0, n, step):
            if steep[i] >= STEEP:
                size[m] = abs(left[i])
                m += 1
        if m == 0:
            return -1.0
        scale = min(max(floor_grey, 1.4826 * np.median(size[:m])), ceiling_grey)
        _weights(n, 1.0 / (cut * scale), left, weight)
    return scale


@compiled(nogil=True)
def look_at_face(
    image: Any, x0: int, y0: int, optics: Optics, faces: Faces, f: int, knots: Any, pos: Any, R: Any, vel: Any, omega: Any,
    known: bool, importance: float, bench: Bench, total: Any, weights: Any, count: Any, own: Any,
) -> tuple[float, float]:  # fmt: skip
    """What one frame shows of the texture of face f, on its grid.

    `total` (n, n) becomes more by the texture as this frame shows it times its weight, `weights` (n, n) by that weight, the
    inverse variance times `importance`, and `count` (n, n) by one where the frame shows a texel; `own` (2, 3) becomes the
    blur of this frame (`blur_on_face`). The picture is read by cubic convolution (Keys, 1981), whose kernel adds no variance
    of its own. Where the texture is `known`, only what `faces.use` names is looked at, the light is fitted with the texture,
    of which `knots` (3, n, n) are value and slopes x, y on the grid, and what does not look like it is left out; else a plane
    of light alone is fitted, and the values are grey over plane. Returns the share of the texels in view that were used,
    below a half of which nothing is added, and the sum of weights; zeros for a face that is not seen.
    """
    n = total.shape[0]
    E, origin = np.zeros((3, 3)), np.zeros(3)
    K, dist, Rcw, use, texel = optics.matrix, optics.distortion, optics.rotation, faces.use[f], faces.texel
    offset, sides = faces.offsets[f], faces.counts[f]
    if face_in_camera(Rcw, optics.translation, pos, R, faces.axes[f], offset, E, origin) < GRAZING:
        return 0.0, 0.0
    S, centre = np.zeros((3, 3)), origin - offset * E[2]
    exposure_shrink(Rcw, omega, optics.exposure, S)
    blur_on_face(K, Rcw, E, origin, offset, vel, omega, optics.exposure, own[0], own[1])
    smear(S, centre, offset, E, origin)
    px, planes = np.zeros((sides, 2)), np.zeros((sides, 3))
    margin = faces.margin + reach_px(K, origin[2], own[1])
    if not outline(K, dist, E, origin, faces.corners[f], sides, margin, px, planes):
        return 0.0, 0.0
    height, width = image.shape
    half = 0.5 * (n - 1)
    more, values = np.zeros(3), knots[0]
    if extra_blur(own[0], own[1], optics.blur, faces.base[f], texel, more) >= NO_BLUR and known:
        values = bench.soft[soften(values, more, bench.soft)]
    grey, where, steep, texture = bench.grey, bench.where, bench.steep, bench.texture
    m = FIRST
    for i in range(n):
        b = (i - half) * texel
        for j in range(n):
            if known and use[i, j] == 0:
                continue
            a = (j - half) * texel
            X = origin[0] + a * E[0, 0] + b * E[1, 0]
            Y = origin[1] + a * E[0, 1] + b * E[1, 1]
            Z = origin[2] + a * E[0, 2] + b * E[1, 2]
            u, v = pixel_of_ray(K, dist, X / Z, Y / Z)
            inside = True
            for k in range(sides):
                if planes[k, 0] * u + planes[k, 1] * v + planes[k, 2] < 0.0:
                    inside = False
                    break
            if not inside:
                continue
            ju, iv = floor(u) - x0, floor(v) - y0
            if ju < 1 or iv < 1 or ju + 2 >= width or iv + 2 >= height:
                continue
            s, t = u - x0 - ju, v - y0 - iv
            kx = (-0.5 * s * (1.0 - s) ** 2, 1.0 + s * s * (1.5 * s - 2.5), 0.0, -0.5 * s * s * (1.0 - s))
            ky = (-0.5 * t * (1.0 - t) ** 2, 1.0 + t * t * (1.5 * t - 2.5), 0.0, -0.5 * t * t * (1.0 - t))
            kx2, ky2 = 1.0 - kx[0] - kx[1] - kx[3], 1.0 - ky[0] - ky[1] - ky[3]
            value, top = 0.0, 0.0
            for r in range(4):
                cy = ky2 if r == 2 else ky[r]
                row = image[iv - 1 + r]
                p0, p1, p2, p3 = row[ju - 1], row[ju], row[ju + 1], row[ju + 2]
                value += cy * (kx[0] * p0 + kx[1] * p1 + kx2 * p2 + kx[3] * p3)
                top = max(top, p0, p1, p2, p3)
            if top >= faces.saturation:
                continue
            grey[m] = value
            texture[m], steep[m] = 1.0, 1.0
            if known:
                texture[m], steep[m] = values[i, j], hypot(knots[1, i, j], knots[2, i, j])
            bench.a[m], bench.b[m] = a / (half * texel), b / (half * texel)
            where[m] = i * n + j
            m += 1
    if m < 60:
        return 0.0, 0.0
    c, A = np.zeros(GAINS), np.zeros((GAINS, GAINS))
    relative_slopes(steep, m)
    scale = robust_gains(m, known, faces.floor_grey, 1e9, faces.cut, LOOKING, bench, A, c)
    if scale < 0.0 or (known and c[0] <= 0.0):
        return 0.0, 0.0
    # What this frame says of each texel: its value in place of the residual, its weight in place of the robust one.
    shown, each = bench.left, bench.weight
    used, together = 0.0, 0.0
    for k in range(m):
        if known:
            contrast = c[0] + c[4] * bench.a[k] + c[5] * bench.b[k]
            if contrast <= 0.1 * c[0]:
                each[k] = 0.0
                continue
            used += each[k]
            shown[k] = texture[k] + shown[k] / contrast
            each[k] *= (contrast / scale) ** 2
        else:
            plane = grey[k] - shown[k]
            each[k] = 0.0
            if plane > 2.0 * scale:
                shown[k] = grey[k] / plane
                each[k] = (plane / scale) ** 2
                used += 1.0
        together += each[k]
    if used < MOST_HIDDEN * m:
        return used / m, 0.0
    for k in range(m):
        if each[k] > 0.0:
            i, j = where[k] // n, where[k] % n
            total[i, j] += importance * each[k] * shown[k]
            weights[i, j] += importance * each[k]
            count[i, j] += 1
    return used / m, importance * together
