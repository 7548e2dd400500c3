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

from math import ceil, cos, floor, hypot, sin, sqrt
from typing import Any

import numpy as np

from ..model.compiled import compiled, inner, int64, truth

GAINS = 6
"""Light on one face of one frame: T, 1, a, b, aT, bT. What the paint scatters follows the texture T, what it mirrors lies over
it; either changes linearly over the face."""
PLAIN = 4
"""Those of them that a face of unknown texture has, T being 1."""
GRADIENT = 0.3
"""Standard deviation of the prior on how much the scattered light changes from the middle of a face to its border, as a share: a
small mark seen through much noise does not show it."""
WARPS = 9
"""Ways in which a texture may lie wrongly on its face: shift (2), linear map (4), and the two terms by which a plane seen from
another side differs from that. Poses that are wrong alike on all frames warp what is learned from them in just these. The last
one is blur."""
SHARED = 1
"""Numbers shared by all faces and frames: the lens blur."""
STEEP = 0.3
"""Share of the steepest slope on a face from which a pixel counts as steep."""
FLAT = 0.01
"""The same share below which a pixel tells the light alone: its part in the normal equations is below 1e-4."""
THINNED = 3
"""Of the pixels on flat ground beside marks every third is enough for the six numbers of light."""
NO_BLUR = 0.02
"""Variance [texel²] below which more or less blur is left out: a texture's own is about one."""
BLUR_STEP = 1.15
"""Factor on the lens blur for its difference quotient."""
BUFFER = 60_000
"""Pixels of one face at the most; larger faces are walked on every second, third, ... row."""
TUKEY = 4.685
"""Cut of the biweight in sigmas: 95 % efficient on clean Gaussian residuals."""
GRAZING = 0.2
"""Cosine of the view below which a face is left out: it is squeezed five times, and its blur is that of other faces."""
MARGIN_BLURS = 2.5
"""Blurs, and half a pixel, by which pixels of a face stay away from where its flat part ends: 0.6 % of the step beyond
the edge are left there."""
SETTLED_PX = 0.1
"""A step of the refinement that moves no point by more is the last one: marks are blurred over five times as much at least, and
what the next step would move is of second order in that share."""
MOST_HIDDEN = 0.5
"""Share of a face's pixels that may be unlike its texture before the face is left out of a frame."""


_FIRST, _ALL, _POSE, _LOOKING, _FITTING, _NO_PLACES = int64(0), int64(GAINS), int64(6), int64(4), int64(3), truth(False)
"""Numbers that are handed on: as literals each would be compiled apart, with all that it is handed to."""


@inner(nogil=True)
def _pixel_of(K: Any, dist: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Pixel of a camera point, lens distortion included."""
    a, b = x / z, y / z
    r2 = a * a + b * b
    g = 1.0 + r2 * (dist[0] + r2 * (dist[1] + r2 * dist[4]))
    ad = a * g + 2.0 * dist[2] * a * b + dist[3] * (r2 + 2.0 * a * a)
    bd = b * g + dist[2] * (r2 + 2.0 * b * b) + 2.0 * dist[3] * a * b
    return K[0, 0] * ad + K[0, 1] * bd + K[0, 2], K[1, 1] * bd + K[1, 2]


@inner(nogil=True)
def _solve(A: Any, n: int, y: Any, out: Any) -> bool:
    """Solve the leading n × n of a symmetric positive definite system in place of its lower triangle; False where it is not."""
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i == j:
                if s <= 1e-12 * abs(A[i, i]) or s <= 0.0:
                    return False
                A[i, i] = sqrt(s)
            else:
                A[i, j] = s / A[j, j]
    _back(A, n, y, out)
    return True


@inner(nogil=True)
def _back(L: Any, n: int, y: Any, out: Any) -> None:
    """Solve L Lᵀ out = y."""
    for i in range(n):
        s = y[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        out[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, n):
            s -= L[k, i] * out[k]
        out[i] = s / L[i, i]


@inner(nogil=True)
def _face_in_camera(Rcw: Any, tcw: Any, pos: Any, R: Any, axes: Any, offset: float, E: Any, origin: Any) -> float:
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


@inner(nogil=True)
def _shrink(Rcw: Any, omega: Any, exposure: float, S: Any) -> None:
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


@inner(nogil=True)
def _smear(S: Any, centre: Any, offset: float, E: Any, origin: Any) -> None:
    """The axes and the origin of a face as they seem on a picture with S."""
    still = E.copy()
    for k in range(3):
        for i in range(3):
            E[k, i] = S[i, 0] * still[k, 0] + S[i, 1] * still[k, 1] + S[i, 2] * still[k, 2]
    for i in range(3):
        origin[i] = centre[i] + offset * E[2, i]


@inner(nogil=True)
def _outline(
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
        px[i, 0], px[i, 1] = _pixel_of(K, dist, x, y, z)
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


@inner(nogil=True)
def _spline(coef: Any, x: float, y: float, out: Any) -> None:
    """Value and derivatives by x and y (in texels) of a cubic B-spline surface, in out (3,); x runs along columns."""
    j, i = floor(x), floor(y)
    s, t = x - j, y - i
    bx0 = (1.0 - s) ** 3 / 6.0
    bx1 = 2.0 / 3.0 - s * s * (1.0 - 0.5 * s)
    bx3 = s * s * s / 6.0
    bx2 = 1.0 - bx0 - bx1 - bx3
    dx0 = -0.5 * (1.0 - s) ** 2
    dx1 = s * (1.5 * s - 2.0)
    dx3 = 0.5 * s * s
    dx2 = -dx0 - dx1 - dx3
    by = (
        (1.0 - t) ** 3 / 6.0,
        2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
        2.0 / 3.0 - (1.0 - t) ** 2 * (0.5 + 0.5 * t),
        t * t * t / 6.0,
    )
    dy0, dy1, dy3 = -0.5 * (1.0 - t) ** 2, t * (1.5 * t - 2.0), 0.5 * t * t
    dy = (dy0, dy1, -dy0 - dy1 - dy3, dy3)
    v, gx, gy = 0.0, 0.0, 0.0
    for k in range(4):
        c0, c1, c2, c3 = (
            coef[i - 1 + k, j - 1],
            coef[i - 1 + k, j],
            coef[i - 1 + k, j + 1],
            coef[i - 1 + k, j + 2],
        )
        row = c0 * bx0 + c1 * bx1 + c2 * bx2 + c3 * bx3
        v += by[k] * row
        gy += dy[k] * row
        gx += by[k] * (c0 * dx0 + c1 * dx1 + c2 * dx2 + c3 * dx3)
    out[0], out[1], out[2] = v, gx, gy


@inner(nogil=True)
def _blur_on_face(
    K: Any, Rcw: Any, E: Any, origin: Any, offset: float, vel: Any, omega: Any, exposure: float, lens: Any, motion: Any
) -> None:
    """Blur of a face in face coordinates, as variances aa, ab, bb: `lens` (3,) [m²] for a lens blur of one pixel, and
    `motion` (3,) [m²].

    The lens blurs alike in all directions of the picture, so on the face it blurs most where the view squeezes it; motion
    during the exposure is a box with the variance of its length squared over twelve.
    """
    iz = 1.0 / origin[2]
    x, y = origin[0] * iz, origin[1] * iz
    jaa, jab = K[0, 0] * (E[0, 0] - x * E[0, 2]) * iz, K[0, 0] * (E[1, 0] - x * E[1, 2]) * iz
    jba, jbb = K[1, 1] * (E[0, 1] - y * E[0, 2]) * iz, K[1, 1] * (E[1, 1] - y * E[1, 2]) * iz
    s = 1.0 / (jaa * jbb - jab * jba) ** 2
    lens[0], lens[1], lens[2] = s * (jab * jab + jbb * jbb), -s * (jaa * jab + jba * jbb), s * (jaa * jaa + jba * jba)
    motion[:] = 0.0
    if exposure > 0.0:
        q, w = np.zeros(3), np.zeros(3)
        for i in range(3):
            for j in range(3):
                q[i] += Rcw[i, j] * vel[j]
                w[i] += Rcw[i, j] * omega[j]
        q[0] += offset * (w[1] * E[2, 2] - w[2] * E[2, 1])
        q[1] += offset * (w[2] * E[2, 0] - w[0] * E[2, 2])
        q[2] += offset * (w[0] * E[2, 1] - w[1] * E[2, 0])
        slip = (E[2, 0] * q[0] + E[2, 1] * q[1] + E[2, 2] * q[2]) / (E[2, 0] * x + E[2, 1] * y + E[2, 2])
        ma = exposure * (E[0, 0] * (slip * x - q[0]) + E[0, 1] * (slip * y - q[1]) + E[0, 2] * (slip - q[2]))
        mb = exposure * (E[1, 0] * (slip * x - q[0]) + E[1, 1] * (slip * y - q[1]) + E[1, 2] * (slip - q[2]))
        motion[0], motion[1], motion[2] = ma * ma / 12.0, ma * mb / 12.0, mb * mb / 12.0


@inner(nogil=True)
def _reach_px(K: Any, depth: float, motion: Any) -> float:
    """Pixels by which motion during the exposure carries a face's border to either side."""
    return 0.5 * sqrt(12.0 * (motion[0] + motion[2])) * sqrt(K[0, 0] * K[1, 1]) / depth


@inner(nogil=True)
def _extra_blur(lens: Any, motion: Any, blur_px: float, base: Any, texel: float, spread: Any) -> int:
    """By how much more a face is blurred on a frame than its texture, in `spread` (2, 3): principal directions [texels],
    √3 standard deviations long, and the sign, -1 where it is less; returns how many of them matter. `base` (2, 3) is the blur of
    the texture, of the lens for one pixel and of motion."""
    iv = 1.0 / (texel * texel)
    s = blur_px * blur_px
    caa = (s * (lens[0] - base[0, 0]) + motion[0] - base[1, 0]) * iv
    cab = (s * (lens[1] - base[0, 1]) + motion[1] - base[1, 1]) * iv
    cbb = (s * (lens[2] - base[0, 2]) + motion[2] - base[1, 2]) * iv
    mean, half = 0.5 * (caa + cbb), sqrt(0.25 * (caa - cbb) ** 2 + cab * cab)
    number = 0
    for k in range(2):
        value = mean + half if k == 0 else mean - half
        if abs(value) < NO_BLUR:
            continue
        ux, uy = value - cbb, cab
        if abs(ux) + abs(uy) < 1e-9 * (abs(mean) + half):
            ux, uy = (1.0, 0.0) if (k == 0) == (caa >= cbb) else (0.0, 1.0)
        length = hypot(ux, uy)
        reach = sqrt(3.0 * abs(value))
        spread[number, 0], spread[number, 1] = reach * ux / length, reach * uy / length
        spread[number, 2] = 1.0 if value > 0.0 else -1.0
        number += 1
    return number


@inner(nogil=True)
def _blurred(coef: Any, x: float, y: float, spread: Any, number: int, side: Any, out: Any) -> None:
    """The spline blurred along `number` directions, by three-point Gauss-Hermite quadrature along each: exact for
    quintics; less blur than the texture has is the same difference taken away, exact for cubics."""
    _spline(coef, x, y, out)
    if number == 0:
        return
    top = coef.shape[0] - 2.0 - 1e-9
    v, gx, gy = out[0], out[1], out[2]
    for k in range(number):
        share = spread[k, 2] / 6.0
        for sign in (-1.0, 1.0):
            _spline(
                coef,
                min(max(x + sign * spread[k, 0], 1.0), top),
                min(max(y + sign * spread[k, 1], 1.0), top),
                side,
            )
            out[0] += share * (side[0] - v)
            out[1] += share * (side[1] - gx)
            out[2] += share * (side[2] - gy)


@inner(nogil=True)
def _curvature(coef: Any, x: float, y: float, side: Any) -> float:
    """Half the Laplacian of the spline [1/texel²], over steps of one texel: what more variance of blur does to it."""
    top = coef.shape[0] - 2.0 - 1e-9
    _spline(coef, x, y, side)
    total = -4.0 * side[0]
    for dx, dy in ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)):
        _spline(coef, min(max(x + dx, 1.0), top), min(max(y + dy, 1.0), top), side)
        total += side[0]
    return 0.5 * total


@inner(nogil=True)
def _relative(steep: Any, n: int) -> None:
    """Slopes as shares of the largest; where there is none, all pixels count alike."""
    most = 0.0
    for i in range(n):
        most = max(most, steep[i])
    for i in range(n):
        steep[i] = steep[i] / most if most > 0.0 else 1.0


@inner(nogil=True)
def _robust_gains(
    n: int,
    grey: Any,
    basis: Any,
    first: int,
    last: int,
    floor_grey: float,
    ceiling_grey: float,
    cut: float,
    turns: int,
    steep: Any,
    w: Any,
    res: Any,
    c: Any,
) -> float:
    """Fit grey = basis · c by biweight least squares, columns `first` to `last` of basis (n, GAINS) alone; fills weights w,
    residuals res and c, and returns the scale [grey], between `floor_grey` and `ceiling_grey`; -1 where there is no
    fit. The scale is that of the pixels that are `steep`: where the texture changes, small errors of place and blur add to
    the noise, and those are the pixels that the pose rests on."""
    A, y, x = np.zeros((GAINS, GAINS)), np.zeros(GAINS), np.zeros(GAINS)
    K = last - first
    size = np.empty(n)
    for i in range(n):
        w[i] = 1.0
    scale = floor_grey
    for turn_number in range(turns):
        A[:] = 0.0
        y[:] = 0.0
        for i in range(n):
            wi = w[i]
            if wi <= 0.0:
                continue
            for a in range(K):
                wa = wi * basis[i, a + first]
                y[a] += wa * grey[i]
                for b in range(a + 1):
                    A[a, b] += wa * basis[i, b + first]
        if last > PLAIN:
            level = max(abs(x[0]), scale) if turn_number > 0 else 255.0
            for a in range(PLAIN, last):
                A[a - first, a - first] += (scale / (GRADIENT * level)) ** 2
        if not _solve(A, K, y, x):
            return -1.0
        m = 0
        for i in range(n):
            left = grey[i]
            for a in range(K):
                left -= x[a] * basis[i, a + first]
            res[i] = left
            if steep[i] >= STEEP:
                size[m] = abs(left)
                m += 1
        scale = min(max(floor_grey, 1.4826 * np.median(size[:m])), ceiling_grey)
        iv = 1.0 / (cut * scale)
        for i in range(n):
            q = res[i] * iv
            w[i] = (1.0 - q * q) ** 2 if abs(q) < 1.0 else 0.0
    c[:] = 0.0
    for a in range(K):
        c[a + first] = x[a]
    return scale


@compiled(nogil=True)
def look_at_face(
    image: Any,
    x0: int,
    y0: int,
    K: Any,
    dist: Any,
    Rcw: Any,
    tcw: Any,
    pos: Any,
    R: Any,
    vel: Any,
    omega: Any,
    exposure: float,
    blur_px: float,
    base: Any,
    axes: Any,
    offset: float,
    corners: Any,
    count: int,
    margin: float,
    texel: float,
    saturation: float,
    floor_grey: float,
    cut: float,
    coef: Any,
    use: Any,
    known: bool,
    values: Any,
    weights: Any,
    own: Any,
) -> float:
    """What one frame shows of a face's texture, on its grid.

    `values` (n, n) become the texture as this frame shows it, `weights` (n, n) their inverse variance, 0 where the frame
    does not show it, and `own` (2, 3) their blur (`_blur_on_face`). The picture is read by cubic convolution (Keys, 1981),
    whose kernel adds no variance of its own. Where the texture is `known`, only what `use` names is looked at, the light is
    fitted with the texture, and what does not look like it is left out; else a plane of light alone is fitted, and the
    values are grey over plane. Returns the share of the texels in view that were used; 0 for a face that is not seen.
    """
    n = values.shape[0]
    weights[:] = 0.0
    E, origin = np.zeros((3, 3)), np.zeros(3)
    if _face_in_camera(Rcw, tcw, pos, R, axes, offset, E, origin) < GRAZING:
        return 0.0
    S, centre = np.zeros((3, 3)), origin - offset * E[2]
    _shrink(Rcw, omega, exposure, S)
    _blur_on_face(K, Rcw, E, origin, offset, vel, omega, exposure, own[0], own[1])
    _smear(S, centre, offset, E, origin)
    px, planes = np.zeros((count, 2)), np.zeros((count, 3))
    margin += _reach_px(K, origin[2], own[1])
    if not _outline(K, dist, E, origin, corners, count, margin, px, planes):
        return 0.0
    height, width = image.shape
    half = 0.5 * (n - 1)
    total = n * n
    spread, side, out = np.zeros((2, 3)), np.zeros(3), np.zeros(3)
    number = _extra_blur(own[0], own[1], blur_px, base, texel, spread)
    grey, res, w, steep = np.empty(total), np.empty(total), np.empty(total), np.empty(total)
    basis = np.empty((total, GAINS))
    where = np.empty(total, np.int64)
    m = 0
    for i in range(n):
        b = (i - half) * texel
        for j in range(n):
            if known and use[i, j] == 0:
                continue
            a = (j - half) * texel
            X = origin[0] + a * E[0, 0] + b * E[1, 0]
            Y = origin[1] + a * E[0, 1] + b * E[1, 1]
            Z = origin[2] + a * E[0, 2] + b * E[1, 2]
            u, v = _pixel_of(K, dist, X, Y, Z)
            inside = True
            for k in range(count):
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
                row = iv - 1 + r
                p0, p1, p2, p3 = image[row, ju - 1], image[row, ju], image[row, ju + 1], image[row, ju + 2]
                value += cy * (kx[0] * p0 + kx[1] * p1 + kx2 * p2 + kx[3] * p3)
                top = max(top, p0, p1, p2, p3)
            if top >= saturation:
                continue
            grey[m] = value
            if known:
                _blurred(coef, float(j), float(i), spread, number, side, out)
            basis[m, 0] = out[0] if known else 1.0
            steep[m] = hypot(out[1], out[2]) if known else 1.0
            basis[m, 1], basis[m, 2], basis[m, 3] = 1.0, a / (half * texel), b / (half * texel)
            basis[m, 4], basis[m, 5] = basis[m, 0] * basis[m, 2], basis[m, 0] * basis[m, 3]
            where[m] = i * n + j
            m += 1
    if m < 60:
        return 0.0
    c = np.zeros(GAINS)
    _relative(steep, m)
    scale = _robust_gains(
        np.int64(m),
        grey,
        basis,
        0 if known else 1,
        GAINS if known else PLAIN,
        floor_grey,
        1e9,
        cut,
        _LOOKING,
        steep,
        w,
        res,
        c,
    )
    if scale < 0.0 or (known and c[0] <= 0.0):
        return 0.0
    used = 0.0
    for k in range(m):
        i, j = where[k] // n, where[k] % n
        if known:
            contrast = c[0] + c[4] * basis[k, 2] + c[5] * basis[k, 3]
            if contrast <= 0.1 * c[0]:
                continue
            values[i, j] = basis[k, 0] + res[k] / contrast
            weights[i, j] = w[k] * (contrast / scale) ** 2
            used += w[k]
        else:
            plane = grey[k] - res[k]
            if plane > 2.0 * scale:
                values[i, j] = grey[k] / plane
                weights[i, j] = (plane / scale) ** 2
                used += 1.0
    return used / m


@compiled(nogil=True)
def mark_equations(
    image: Any,
    x0: int,
    y0: int,
    rays: Any,
    K: Any,
    dist: Any,
    Rcw: Any,
    tcw: Any,
    pos: Any,
    R: Any,
    vel: Any,
    omega: Any,
    exposure: float,
    blur_px: float,
    base: Any,
    axes: Any,
    offsets: Any,
    corners: Any,
    counts: Any,
    margin: float,
    texel: float,
    saturation: float,
    floor_grey: float,
    cut: float,
    usual_grey: Any,
    coef: Any,
    use: Any,
    places: bool,
    H: Any,
    g: Any,
    place: Any,
    stats: Any,
) -> None:
    """Fill H (6, 6) and g (6,) of the pose increment from the marks of every face in view.

    `image` is a float32 window whose pixel [0, 0] lies at (x0, y0); `rays` (height, width, 2) are those of the whole
    picture. `coef`, `use` (faces, n, n) are the textures: `use` is 0 where no pixel looks, 1 where few do because the texture
    is flat, 2 where all do. `place` (faces, WARPS + SHARED, 6 + WARPS + SHARED + 1) becomes, for the warps of each face's
    texture and the lens blur [px], the rows of their normal matrix: by pose (6), by themselves, and the right side; with
    `places` False it is left alone, and the time for it saved. `stats` (faces, 3) become pixels seen, pixels used and noise
    [grey].
    """
    H[:] = 0.0
    g[:] = 0.0
    if places:
        place[:] = 0.0
    N = 6 + WARPS + SHARED if places else 6
    stats[:] = 0.0
    height, width = image.shape
    n = coef.shape[1]
    half = 0.5 * (n - 1)
    E, origin = np.zeros((3, 3)), np.zeros(3)
    most = corners.shape[1]
    px, planes = np.zeros((most, 2)), np.zeros((most, 3))
    grey = np.empty(BUFFER)
    basis = np.empty((BUFFER, GAINS))
    slope = np.empty((BUFFER, 2))
    ray = np.empty((BUFFER, 2))
    spread, wider, own, side = np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros(3)
    softer = np.empty((BUFFER if places else 1, 2))
    more = 0
    w, res, steep = np.empty(BUFFER), np.empty(BUFFER), np.empty(BUFFER)
    out = np.zeros(3)
    c = np.zeros(GAINS)
    J = np.zeros(N)
    HH, gg, C = np.zeros((N, N)), np.zeros(N), np.zeros((N, GAINS))
    S, elim = np.zeros((GAINS, GAINS)), np.zeros(GAINS)
    shrink, wide, centre, middle = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    _shrink(Rcw, omega, exposure, shrink)
    for i in range(3):
        centre[i] = tcw[i] + Rcw[i, 0] * pos[0] + Rcw[i, 1] * pos[1] + Rcw[i, 2] * pos[2]
        for j in range(3):
            # 1/S to first order: its square is 1e-7.
            wide[i, j] = (2.0 if i == j else 0.0) - shrink[i, j]
    for i in range(3):
        middle[i] = wide[i, 0] * centre[0] + wide[i, 1] * centre[1] + wide[i, 2] * centre[2]
    for f in range(axes.shape[0]):
        if usual_grey[f] <= 0.0:
            continue
        if _face_in_camera(Rcw, tcw, pos, R, axes[f], offsets[f], E, origin) < GRAZING:
            continue
        _blur_on_face(K, Rcw, E, origin, offsets[f], vel, omega, exposure, own[0], own[1])
        border = margin + _reach_px(K, origin[2], own[1])
        if not _outline(K, dist, E, origin, corners[f], counts[f], border, px, planes):
            continue
        top, bottom = px[0, 1], px[0, 1]
        for i in range(counts[f]):
            top, bottom = min(top, px[i, 1]), max(bottom, px[i, 1])
        first, last = max(ceil(top + border), y0), min(floor(bottom - border), y0 + height - 1)
        left, right = px[0, 0], px[0, 0]
        for i in range(counts[f]):
            left, right = min(left, px[i, 0]), max(right, px[i, 0])
        number = _extra_blur(own[0], own[1], blur_px, base[f], texel, spread)
        if places:
            more = _extra_blur(own[0], own[1], BLUR_STEP * blur_px, base[f], texel, wider)
        stride = 1 + max(int((last - first + 1) * (right - left)), 0) // BUFFER
        # With λ D = c + S r on the ray D through a pixel, r = λ D/S - c/S: rays and centre are bent rather than the die.
        for i in range(3):
            origin[i] = middle[i] + offsets[f] * E[2, i]
        gap = E[2, 0] * origin[0] + E[2, 1] * origin[1] + E[2, 2] * origin[2]
        m = _FIRST
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
            for u in range(ceil(low), floor(high) + 1):
                value = image[v - y0, u - x0]
                if value >= saturation:
                    continue
                dx, dy = rays[v, u, 0], rays[v, u, 1]
                bx = wide[0, 0] * dx + wide[0, 1] * dy + wide[0, 2]
                by = wide[1, 0] * dx + wide[1, 1] * dy + wide[1, 2]
                bz = wide[2, 0] * dx + wide[2, 1] * dy + wide[2, 2]
                depth = gap / (E[2, 0] * bx + E[2, 1] * by + E[2, 2] * bz)
                X, Y, Z = depth * bx - origin[0], depth * by - origin[1], depth * bz - origin[2]
                a = E[0, 0] * X + E[0, 1] * Y + E[0, 2] * Z
                b = E[1, 0] * X + E[1, 1] * Y + E[1, 2] * Z
                x, y = a / texel + half, b / texel + half
                if not (1.0 <= x < n - 2.0 and 1.0 <= y < n - 2.0):
                    continue
                kind = use[f, int(y + 0.5), int(x + 0.5)]
                if kind == 0 or (kind == 1 and (u + v) % THINNED != 0):
                    continue
                _blurred(coef[f], x, y, spread, number, side, out)
                grey[m] = value
                basis[m, 0], basis[m, 1] = out[0], 1.0
                basis[m, 2], basis[m, 3] = (x - half) / half, (y - half) / half
                basis[m, 4], basis[m, 5] = out[0] * basis[m, 2], out[0] * basis[m, 3]
                slope[m, 0], slope[m, 1] = out[1] / texel, out[2] / texel
                steep[m] = hypot(out[1], out[2])
                if places:
                    value = out[0]
                    _blurred(coef[f], x, y, wider, more, side, out)
                    softer[m, 1] = (out[0] - value) / ((BLUR_STEP - 1.0) * blur_px)
                    softer[m, 0] = _curvature(coef[f], x, y, side)
                ray[m, 0], ray[m, 1] = dx, dy
                m += 1
        stats[f, 0] = m
        if m < 40:
            continue
        _relative(steep, m)
        scale = _robust_gains(
            m, grey, basis, _FIRST, _ALL, floor_grey, 2.0 * usual_grey[f], cut, _FITTING, steep, w, res, c
        )
        if scale < 0.0 or c[0] <= 0.0:
            continue
        used = 0.0
        for i in range(m):
            used += w[i]
        stats[f, 1], stats[f, 2] = used, scale
        if used < (1.0 - MOST_HIDDEN) * m:
            continue
        HH[:] = 0.0
        gg[:] = 0.0
        C[:] = 0.0
        S[:] = 0.0
        iv = 1.0 / (scale * scale)
        for i in range(m):
            wi = w[i] * iv
            if wi <= 0.0:
                continue
            for k in range(GAINS):
                for h in range(k + 1):
                    S[k, h] += wi * basis[i, k] * basis[i, h]
            if steep[i] < FLAT:
                continue
            contrast = c[0] + c[4] * basis[i, 2] + c[5] * basis[i, 3]
            ga, gb = contrast * slope[i, 0], contrast * slope[i, 1]
            dx, dy = ray[i, 0], ray[i, 1]
            nd = E[2, 0] * dx + E[2, 1] * dy + E[2, 2]
            # Everything in camera axes here; turned to world axes once, after the sum.
            slip = (ga * (E[0, 0] * dx + E[0, 1] * dy + E[0, 2]) + gb * (E[1, 0] * dx + E[1, 1] * dy + E[1, 2])) / nd
            tx = slip * E[2, 0] - ga * E[0, 0] - gb * E[1, 0]
            ty = slip * E[2, 1] - ga * E[0, 1] - gb * E[1, 1]
            tz = slip * E[2, 2] - ga * E[0, 2] - gb * E[1, 2]
            a, b = basis[i, 2] * half * texel, basis[i, 3] * half * texel
            rx = offsets[f] * E[2, 0] + a * E[0, 0] + b * E[1, 0]
            ry = offsets[f] * E[2, 1] + a * E[0, 1] + b * E[1, 1]
            rz = offsets[f] * E[2, 2] + a * E[0, 2] + b * E[1, 2]
            J[0], J[1], J[2] = tx, ty, tz
            J[3], J[4], J[5] = ry * tz - rz * ty, rz * tx - rx * tz, rx * ty - ry * tx
            if places:
                radial = ga * a + gb * b
                J[6], J[7] = -ga, -gb
                J[8], J[9], J[10], J[11] = -ga * a, -ga * b, -gb * a, -gb * b
                J[12], J[13] = -radial * a, -radial * b
                J[14], J[15] = contrast * softer[i, 0], contrast * softer[i, 1]
            for k in range(N):
                jk = wi * J[k]
                gg[k] += jk * res[i]
                for h in range(k + 1):
                    HH[k, h] += jk * J[h]
                for h in range(GAINS):
                    C[k, h] += jk * basis[i, h]
        for k in range(PLAIN, GAINS):
            S[k, k] += 1.0 / (GRADIENT * c[0]) ** 2
        if not _solve(S, _ALL, C[0], elim):
            continue
        for k in range(N):
            _back(S, _ALL, C[k], elim)
            for h in range(k, N):
                s = 0.0
                for q in range(GAINS):
                    s += C[h, q] * elim[q]
                HH[h, k] -= s
        for k in range(N):
            for h in range(k):
                HH[h, k] = HH[k, h]
        _turn_to_world(Rcw, HH, gg)
        for k in range(6):
            g[k] += gg[k]
            for h in range(6):
                H[k, h] += HH[k, h]
        if places:
            for k in range(WARPS + SHARED):
                for h in range(N):
                    place[f, k, h] = HH[6 + k, h]
                place[f, k, N] = gg[6 + k]


@inner(nogil=True)
def _turn_to_world(Rcw: Any, H: Any, g: Any) -> None:
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


@inner(nogil=True)
def _turned(R: Any, w: Any) -> Any:
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


@compiled(nogil=True)
def refine_on_marks(
    image: Any,
    x0: int,
    y0: int,
    rays: Any,
    K: Any,
    dist: Any,
    Rcw: Any,
    tcw: Any,
    pos: Any,
    R: Any,
    vel: Any,
    omega: Any,
    exposure: float,
    blur_px: float,
    base: Any,
    axes: Any,
    offsets: Any,
    corners: Any,
    counts: Any,
    margin: float,
    texel: float,
    saturation: float,
    floor_grey: float,
    cut: float,
    usual_grey: Any,
    coef: Any,
    use: Any,
    factor: float,
    other: Any,
    other_g: Any,
    steps: int,
    stats: Any,
) -> tuple[Any, Any, Any]:
    """Gauss-Newton on the marks together with another source of the pose.

    `other` (6, 6) is that source's information and `other_g` (6,) its information times its pose minus the start;
    `factor` divides the information of the marks. Returns position (3,), rotation (3, 3) and information (6, 6) of the
    marks alone, divided by `factor`; zero where no face with marks is seen.
    """
    p, Q = pos.copy(), R.copy()
    H, g = np.zeros((6, 6)), np.zeros(6)
    place = np.zeros((1, 1, 1))
    A, y, step, away = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6)
    for _ in range(steps):
        mark_equations(
            image, x0, y0, rays, K, dist, Rcw, tcw, p, Q, vel, omega, exposure, blur_px, base, axes, offsets, corners,
            counts, margin, texel, saturation, floor_grey, cut, usual_grey, coef, use, _NO_PLACES, H, g, place, stats,
        )  # fmt: skip
        for i in range(6):
            y[i] = g[i] / factor + other_g[i]
            for j in range(6):
                H[i, j] /= factor
                A[i, j] = H[i, j] + other[i, j]
                y[i] -= other[i, j] * away[j]
        for i in range(6):
            # Columns of metres and of radians: the pivots are judged relative to their own diagonal.
            A[i, i] *= 1.0 + 1e-12
        if not _solve(A, _POSE, y, step):
            H[:] = 0.0
            break
        for i in range(6):
            away[i] += step[i]
        for i in range(3):
            p[i] += step[i]
        Q = _turned(Q, step[3:])
        # A third of a sigma moved: the next step would be a fifth of that.
        gained = 0.0
        for i in range(6):
            gained += step[i] * y[i]
        if (
            gained < 0.1
            or _moved_px(K, Rcw, tcw, p, step, hypot(offsets[0], hypot(corners[0, 0, 0], corners[0, 0, 1])))
            < SETTLED_PX
        ):
            break
    return p, Q, H


@inner(nogil=True)
def _moved_px(K: Any, Rcw: Any, tcw: Any, pos: Any, step: Any, reach: float) -> float:
    """How far in the picture a step (6,) of a die that reaches so far [m] moves its farthest points at the most."""
    x, y, z, depth = 0.0, 0.0, 0.0, tcw[2]
    for j in range(3):
        x += Rcw[0, j] * step[j]
        y += Rcw[1, j] * step[j]
        z += Rcw[2, j] * step[j]
        depth += Rcw[2, j] * pos[j]
    turned = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    return float(K[0, 0] / depth * (hypot(x, y) + reach * (turned + abs(z) / depth)))
