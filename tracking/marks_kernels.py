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
from typing import Any, NamedTuple

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
THINNED = 3
"""Of the pixels on flat ground beside marks every third is enough for the six numbers of light."""
NO_BLUR = 0.02
"""Variance [texel²] below which more or less blur is left out: a texture's own is about one."""
BLUR_STEP = 1.15
"""Factor on the lens blur for its difference quotient. Its derivative proper would rest on the texture's curvature at one place,
and so on its noise, which every look that it was learned from shares: blurs came out a quarter too large."""
STENCIL_BLUR = 2.0
"""Variance [texel²] up to which a texture is blurred by three values in a row, a texel apart, some times over. More is blurred by
values twice as far apart, from four times as much on four times, and so on, each after one turn of those nearer to each other:
values far apart leave what lies between them as it is. Three values √3 standard deviations apart, weighted 1/6, 2/3 and 1/6,
blur a quintic as a normal distribution does; the turns here are about as wide, and right for cubics."""
EVERY_THIRD, MANY = 3, 600
"""On the way one pixel in three tells the scale of the residuals well enough, where a face has so many."""
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
OVERSTEP = 1.2
"""Factor on the steps of the refinement. With the weights of the last residuals kept, as here, the normal equations are steeper
than the robust cost: by the ratio of the means of the biweight and of its influence function's slope, 0.915 to 0.758 for
Gaussian residuals. One plain step left a sixth of the way."""
MOST_HIDDEN = 0.5
"""Share of a face's pixels, or texels, that may be unlike its texture before the face is left out of a frame."""


_FIRST, _ALL, _POSE, _LOOKING, _FITTING = int64(0), int64(GAINS), int64(6), int64(4), int64(3)
_NO_PLACES, _KNOWN, _MOST = truth(False), truth(True), int64(BUFFER)
"""Numbers that are handed on: as literals each would be compiled apart, with all that it is handed to."""
_inner = inner(nogil=True)
_inner_sums = inner(nogil=True, fastmath={"reassoc", "contract", "nsz"})
_free = inner(nogil=True, _nrt=False)
_free_sums = inner(nogil=True, _nrt=False, fastmath={"reassoc", "contract", "nsz"})
"""For kernels that only others call; free ones take no memory and count no references to arrays; of plain sums over pixels the
order is left to the compiler."""


class Optics(NamedTuple):
    """The camera, and what blurs its pictures."""

    rays: Any
    """(height, width, 2) camera rays x/z, y/z of the pixels of the whole picture, lens distortion undone."""
    matrix: Any
    """(3, 3) [px]"""
    distortion: Any
    """(5,)"""
    rotation: Any
    """(3, 3) world to camera."""
    translation: Any
    """(3,) [m]"""
    exposure: float
    """[s]"""
    blur: float
    """[px] of the lens."""


class Faces(NamedTuple):
    """The die's faces with what they show, and how pixels are compared with it."""

    axes: Any
    """(faces, 3, 3) rows a, b and the outward normal, body axes."""
    offsets: Any
    """(faces,) [m]"""
    corners: Any
    """(faces, most, 2) [m] of the flat part in (a, b), padded."""
    counts: Any
    """(faces,) corners of each."""
    base: Any
    """(faces, 2, 3) [m²] blur of the textures, see `_blur_on_face`."""
    coefficients: Any
    """(faces, n, n) of the splines."""
    use: Any
    """(faces, n, n) 0 where no pixel looks, 1 where few do because the texture is flat, 2 where all do."""
    usual_grey: Any
    """(faces,) usual residual of a pixel; 0 for a face that shows nothing."""
    margin: float
    """[px] by which pixels stay away from where the flat part ends."""
    texel: float
    """[m]"""
    saturation: float
    """[grey] from which pixels tell nothing."""
    floor_grey: float
    """Least noise."""
    cut: float
    """Of the robust weights [sigmas]."""


class Bench(NamedTuple):
    """Room for the pixels of one face, taken once for many frames."""

    grey: Any
    texture: Any
    a: Any
    b: Any
    """Light changes with these: face coordinates, one at the grid's border."""
    steep: Any
    weight: Any
    left: Any
    size: Any
    where: Any
    slope: Any
    """(2, most) of the texture by a and b [1/m]."""
    ray: Any
    """(2, most)"""
    softer: Any
    """(2, most) derivatives of the texture by its own variance [1/texel²] and by the lens blur [1/px]."""
    by: Any
    """(6 + WARPS + SHARED, most) derivatives of the grey levels by all that they may depend on."""
    heavy: Any
    """(most,) one of them, times its weight."""
    soft: Any
    """(4, n, n) textures that are being blurred."""
    line: Any
    """(2, most) where the pixels of one line lie on the face [texel]."""


@compiled(nogil=True)
def new_bench(most: int, side: int) -> Bench:
    """A bench for `most` pixels of a face, and textures of `side` texels a side."""
    return Bench(
        np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most),
        np.empty(most), np.empty(most, np.int64), np.empty((2, most)), np.empty((2, most)), np.empty((2, most)),
        np.empty((6 + WARPS + SHARED, most)), np.empty(most), np.empty((4, side, side)), np.empty((2, most)),
    )  # fmt: skip


@_free
def _pixel_of(K: Any, dist: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Pixel of a camera point, lens distortion included."""
    a, b = x / z, y / z
    r2 = a * a + b * b
    g = 1.0 + r2 * (dist[0] + r2 * (dist[1] + r2 * dist[4]))
    ad = a * g + 2.0 * dist[2] * a * b + dist[3] * (r2 + 2.0 * a * a)
    bd = b * g + dist[2] * (r2 + 2.0 * b * b) + 2.0 * dist[3] * a * b
    return K[0, 0] * ad + K[0, 1] * bd + K[0, 2], K[1, 1] * bd + K[1, 2]


@_free
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


@_free
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


@_free
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


@_inner
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


@_inner
def _smear(S: Any, centre: Any, offset: float, E: Any, origin: Any) -> None:
    """The axes and the origin of a face as they seem on a picture with S."""
    still = E.copy()
    for k in range(3):
        for i in range(3):
            E[k, i] = S[i, 0] * still[k, 0] + S[i, 1] * still[k, 1] + S[i, 2] * still[k, 2]
    for i in range(3):
        origin[i] = centre[i] + offset * E[2, i]


@_free
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


@_free
def _weights_along(s: float) -> tuple[float, float, float, float]:
    """Of the four coefficients about a place, which lies `s` behind the second of them."""
    b0, b1, b3 = (1.0 - s) ** 3 / 6.0, 2.0 / 3.0 - s * s * (1.0 - 0.5 * s), s * s * s / 6.0
    return b0, b1, 1.0 - b0 - b1 - b3, b3


@_free
def _spline(coef: Any, x: float, y: float) -> tuple[float, float, float]:
    """Value and derivatives by x and y (in texels) of a cubic B-spline surface; x runs along columns."""
    j, i = floor(x), floor(y)
    s, t = x - j, y - i
    (bx0, bx1, bx2, bx3), by = _weights_along(s), _weights_along(t)
    dx0 = -0.5 * (1.0 - s) ** 2
    dx1 = s * (1.5 * s - 2.0)
    dx3 = 0.5 * s * s
    dx2 = -dx0 - dx1 - dx3
    dy0, dy1, dy3 = -0.5 * (1.0 - t) ** 2, t * (1.5 * t - 2.0), 0.5 * t * t
    dy = (dy0, dy1, -dy0 - dy1 - dy3, dy3)
    v, gx, gy = 0.0, 0.0, 0.0
    for k in range(4):
        row = coef[i - 1 + k]
        c0, c1, c2, c3 = row[j - 1], row[j], row[j + 1], row[j + 2]
        level = c0 * bx0 + c1 * bx1 + c2 * bx2 + c3 * bx3
        v += by[k] * level
        gy += dy[k] * level
        gx += by[k] * (c0 * dx0 + c1 * dx1 + c2 * dx2 + c3 * dx3)
    return v, gx, gy


@_free
def _spline_value(coef: Any, x: float, y: float) -> float:
    """Its value alone."""
    j, i = floor(x), floor(y)
    bx, by = _weights_along(x - j), _weights_along(y - i)
    v = 0.0
    for k in range(4):
        row = coef[i - 1 + k]
        v += by[k] * (row[j - 1] * bx[0] + row[j] * bx[1] + row[j + 1] * bx[2] + row[j + 2] * bx[3])
    return v


@_free
def _spline_bend(coef: Any, x: float, y: float) -> float:
    """Sum of its second derivatives by x and by y [1/texel²]."""
    j, i = floor(x), floor(y)
    s, t = x - j, y - i
    bx, by = _weights_along(s), _weights_along(t)
    bends = (1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t)
    v = 0.0
    for k in range(4):
        row = coef[i - 1 + k]
        c0, c1, c2, c3 = row[j - 1], row[j], row[j + 1], row[j + 2]
        v += by[k] * ((1.0 - s) * (c0 - 2.0 * c1 + c2) + s * (c1 - 2.0 * c2 + c3))
        v += bends[k] * (c0 * bx[0] + c1 * bx[1] + c2 * bx[2] + c3 * bx[3])
    return v


@_inner
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


@_free
def _reach_px(K: Any, depth: float, motion: Any) -> float:
    """Pixels by which motion during the exposure carries a face's border to either side."""
    return 0.5 * sqrt(12.0 * (motion[0] + motion[2])) * sqrt(K[0, 0] * K[1, 1]) / depth


@_free
def _largest(more: Any) -> float:
    """Size of the largest of variances xx, xy, yy."""
    return abs(0.5 * (more[0] + more[2])) + sqrt(0.25 * (more[0] - more[2]) ** 2 + more[1] * more[1])


@_free
def _extra_blur(lens: Any, motion: Any, blur_px: float, base: Any, texel: float, more: Any) -> float:
    """By how much more a face is blurred on a frame than its texture, as variances xx, xy, yy in `more` (3,) [texel²]; returns
    the size of the largest. `base` (2, 3) is the blur of the texture, of the lens for one pixel and of motion."""
    iv = 1.0 / (texel * texel)
    s = blur_px * blur_px
    for k in range(3):
        more[k] = (s * (lens[k] - base[0, k]) + motion[k] - base[1, k]) * iv
    return _largest(more)


@_free
def soften(texture: Any, more: Any, room: Any) -> int:
    """Blur a surface (n, n), its values on a grid or the coefficients of its spline, by variances `more` (3,) xx, xy, yy
    [texel²]; which of the two in `room` (2, n, n) it then is. Less blur than a texture has is the same difference taken away,
    once: more turns would sharpen its noise."""
    apart, left, k = 1, _largest(more), _FIRST
    whole, blurrier = left, more[0] + more[2] > 0.0
    while blurrier and left > STENCIL_BLUR * apart * apart:
        _blur_again(texture, k, more, 1.0 / (3.0 * whole), apart, room)
        left -= apart * apart / 3.0
        apart *= 2
        k += 1
    turns = max(int(3.0 * left / (apart * apart) + 0.5), 1) if blurrier else 1
    for _ in range(turns):
        _blur_again(texture, k, more, left / (whole * turns * apart * apart), apart, room)
        k += 1
    return (k - 1) % 2


@_free
def _blur_again(texture: Any, turn_number: int, more: Any, unit: float, apart: int, room: Any) -> None:
    """The surface after so many turns, blurred once more: from one place in `room` (2, n, n) to the other."""
    if turn_number == 0:
        _blur_once(texture, more, unit, apart, room[0])
    else:
        _blur_once(room[(turn_number - 1) % 2], more, unit, apart, room[turn_number % 2])


@_free_sums
def _blur_once(texture: Any, more: Any, unit: float, apart: int, out: Any) -> None:
    """Add half of `unit` times the variances [1] times the second differences between values so far apart; the border stays."""
    n = texture.shape[0]
    xx, xy, yy = 0.5 * unit * more[0], 0.25 * unit * more[1], 0.5 * unit * more[2]
    middle, inside, far = 1.0 - 2.0 * (xx + yy), n - 2 * apart, 2 * apart
    for i in range(n):
        here, blurred = texture[i], out[i]
        for j in range(n):
            blurred[j] = here[j]
        if i < apart or i >= n - apart:
            continue
        # Views that begin where they are read: an index that might be negative keeps the loop from being done in steps of eight.
        left, centre, right = here[:inside], here[apart : n - apart], here[far:]
        a, b, c = texture[i - apart, :inside], texture[i - apart, apart : n - apart], texture[i - apart, far:]
        d, e, f = texture[i + apart, :inside], texture[i + apart, apart : n - apart], texture[i + apart, far:]
        new = blurred[apart : n - apart]
        for j in range(inside):
            across, along = left[j] + right[j], b[j] + e[j]
            new[j] = middle * centre[j] + xx * across + yy * along + xy * (a[j] - c[j] - d[j] + f[j])


@_free_sums
def _line_on_face(
    rays: Any, first: int, count: int, wide: Any, E: Any, origin: Any, gap: float, texel: float, half: float, xs: Any,
    ys: Any,
) -> None:  # fmt: skip
    """Where the pixels of one line, from the `first` on, lie on a face [texel]. With λ D = c + S r on the ray D through a pixel
    (see `_shrink`), r = λ D/S - c/S; `wide` is 1/S, `origin` that of the face after it, and `gap` its distance."""
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


@_free
def _relative(steep: Any, n: int) -> None:
    """Slopes as shares of the largest; where there is none, all pixels count alike."""
    most = 0.0
    for i in range(n):
        most = max(most, steep[i])
    for i in range(n):
        steep[i] = steep[i] / most if most > 0.0 else 1.0


@_inner_sums
def _light_sums(n: int, grey: Any, texture: Any, xs: Any, ys: Any, weight: Any, A: Any, y: Any) -> None:
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


@_inner_sums
def _light_left(n: int, c: Any, grey: Any, texture: Any, xs: Any, ys: Any, left: Any) -> None:
    """What the light leaves of the grey levels."""
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    for i in range(n):
        a, b = xs[i], ys[i]
        left[i] = grey[i] - (c0 + c4 * a + c5 * b) * texture[i] - (c1 + c2 * a + c3 * b)


@_inner_sums
def _weights(n: int, icut: float, left: Any, weight: Any) -> float:
    """The biweight of residuals, given the inverse of its cut; their sum."""
    total = 0.0
    for i in range(n):
        q = left[i] * icut
        q = max(1.0 - q * q, 0.0)
        weight[i] = q * q
        total += q * q
    return total


@_inner
def _robust_gains(
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
        _light_sums(n, grey, texture, xs, ys, weight, A, y)
        if known:
            level = max(abs(c[0]), scale) if turn_number > 0 else 255.0
            for a in range(PLAIN, GAINS):
                A[a, a] += (scale / (GRADIENT * level)) ** 2
        else:
            for a in range(K):
                y[a] = y[a + 1]
                for b in range(a + 1):
                    A[a, b] = A[a + 1, b + 1]
        if not _solve(A, K, y, x):
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
    blur of this frame (`_blur_on_face`). The picture is read by cubic convolution (Keys, 1981), whose kernel adds no variance
    of its own. Where the texture is `known`, only what `faces.use` names is looked at, the light is fitted with the texture,
    of which `knots` (3, n, n) are value and slopes x, y on the grid, and what does not look like it is left out; else a plane
    of light alone is fitted, and the values are grey over plane. Returns the share of the texels in view that were used,
    below a half of which nothing is added, and the sum of weights; zeros for a face that is not seen.
    """
    n = total.shape[0]
    E, origin = np.zeros((3, 3)), np.zeros(3)
    K, dist, Rcw, use, texel = optics.matrix, optics.distortion, optics.rotation, faces.use[f], faces.texel
    offset, sides = faces.offsets[f], faces.counts[f]
    if _face_in_camera(Rcw, optics.translation, pos, R, faces.axes[f], offset, E, origin) < GRAZING:
        return 0.0, 0.0
    S, centre = np.zeros((3, 3)), origin - offset * E[2]
    _shrink(Rcw, omega, optics.exposure, S)
    _blur_on_face(K, Rcw, E, origin, offset, vel, omega, optics.exposure, own[0], own[1])
    _smear(S, centre, offset, E, origin)
    px, planes = np.zeros((sides, 2)), np.zeros((sides, 3))
    margin = faces.margin + _reach_px(K, origin[2], own[1])
    if not _outline(K, dist, E, origin, faces.corners[f], sides, margin, px, planes):
        return 0.0, 0.0
    height, width = image.shape
    half = 0.5 * (n - 1)
    more, values = np.zeros(3), knots[0]
    if _extra_blur(own[0], own[1], optics.blur, faces.base[f], texel, more) >= NO_BLUR and known:
        values = bench.soft[soften(values, more, bench.soft)]
    grey, where, steep, texture = bench.grey, bench.where, bench.steep, bench.texture
    m = _FIRST
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
    _relative(steep, m)
    scale = _robust_gains(m, known, faces.floor_grey, 1e9, faces.cut, _LOOKING, bench, A, c)
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
    _shrink(Rcw, omega, optics.exposure, shrink)
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
        if _face_in_camera(Rcw, tcw, pos, R, faces.axes[f], offsets[f], E, origin) < GRAZING:
            continue
        _blur_on_face(K, Rcw, E, origin, offsets[f], vel, omega, optics.exposure, own[0], own[1])
        border = faces.margin + _reach_px(K, origin[2], own[1])
        if not _outline(K, dist, E, origin, corners[f], counts[f], border, px, planes):
            continue
        top, bottom = px[0, 1], px[0, 1]
        for i in range(counts[f]):
            top, bottom = min(top, px[i, 1]), max(bottom, px[i, 1])
        first, last = max(ceil(top + border), y0), min(floor(bottom - border), y0 + height - 1)
        left, right = px[0, 0], px[0, 0]
        for i in range(counts[f]):
            left, right = min(left, px[i, 0]), max(right, px[i, 0])
        if _extra_blur(own[0], own[1], optics.blur, base, texel, more) >= NO_BLUR:
            coef = bench.soft[soften(coef, more, bench.soft)]
        if places:
            _extra_blur(own[0], own[1], BLUR_STEP * optics.blur, base, texel, further)
            for k in range(3):
                further[k] -= more[k]
            blurrier = bench.soft[2 + soften(coef, further, bench.soft[2:])]
        stride = 1 + max(int((last - first + 1) * (right - left)), 0) // len(grey)
        # Rays and centre are bent rather than the die, see `_line_on_face`.
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
            begin, end = ceil(low), floor(high) + 1
            _line_on_face(optics.rays[v], begin, end - begin, wide, E, origin, gap, texel, half, line[0], line[1])
            for u in range(begin, end):
                value, x, y = image[v - y0, u - x0], line[0, u - begin], line[1, u - begin]
                if value >= faces.saturation:
                    continue
                if not (1.0 <= x < n - 2.0 and 1.0 <= y < n - 2.0):
                    continue
                kind = use[int(y + 0.5), int(x + 0.5)]
                if kind == 0 or (kind == 1 and (u + v) % THINNED != 0):
                    continue
                level, gx, gy = _spline(coef, x, y)
                grey[m], texture[m] = value, level
                bench.a[m], bench.b[m] = (x - half) / half, (y - half) / half
                slope[0, m], slope[1, m] = gx / texel, gy / texel
                steep[m] = hypot(gx, gy)
                if places:
                    softer[0, m] = 0.5 * _spline_bend(coef, x, y)
                    softer[1, m] = (_spline_value(blurrier, x, y) - level) / ((BLUR_STEP - 1.0) * optics.blur)
                ray[0, m], ray[1, m] = optics.rays[v, u, 0], optics.rays[v, u, 1]
                m += 1
        stats[f, 0] = m
        if m < 40:
            continue
        _relative(steep, m)
        c[:] = 0.0
        scale = _robust_gains(m, _KNOWN, faces.floor_grey, 2.0 * faces.usual_grey[f], faces.cut, _FITTING, bench, A, c)
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
        _light_sums(m, grey, texture, bench.a, bench.b, bench.weight, A, elim)
        iv = 1.0 / (scale * scale)
        for k in range(PLAIN, GAINS):
            A[k, k] += 1.0 / (GRADIENT * c[0]) ** 2 / iv
        if not _solve(A, _ALL, C[0], elim):
            continue
        for k in range(N):
            _back(A, _ALL, C[k], elim)
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


@_inner_sums
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


@_inner_sums
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


@_inner_sums
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


@_inner_sums
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


@_inner
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


@_inner
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
    frames: Any, which: Any, boxes: Any, optics: Optics, faces: Faces, positions: Any, rotations: Any, velocities: Any,
    omegas: Any, factor: float, others: Any, other_gs: Any, steps: int, H: Any,
) -> None:  # fmt: skip
    """Gauss-Newton on the marks together with another source of the pose, on frames number `which` (m,) of many
    (n, cameras, height, width), whose first camera's windows are `boxes` (m, 4; x0, y0, x1, y1), empty where a frame shall be
    left alone.

    `others` (m, 6, 6) is that source's information and `other_gs` (m, 6) its information times its pose minus the start;
    `factor` divides the information of the marks. `positions` (m, 3) and `rotations` (m, 3, 3) are replaced; H (m, 6, 6)
    becomes the information of the marks alone, divided by `factor`; zero where no face with marks is seen, whose pose stays.
    """
    K, Rcw, tcw = optics.matrix, optics.rotation, optics.translation
    reach = hypot(faces.offsets[0], hypot(faces.corners[0, 0, 0], faces.corners[0, 0, 1]))
    place, stats = np.zeros((1, 1, 1)), np.zeros((faces.axes.shape[0], 3))
    Hk, g = np.zeros((6, 6)), np.zeros(6)
    A, y, step, away = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6)
    bench = new_bench(_MOST, faces.coefficients.shape[1])
    for k in range(which.shape[0]):
        x0, y0 = boxes[k, 0], boxes[k, 1]
        if boxes[k, 2] <= x0 or boxes[k, 3] <= y0:
            continue
        image = np.empty((boxes[k, 3] - y0, boxes[k, 2] - x0), np.float32)
        for i in range(image.shape[0]):
            here, there = image[i], frames[which[k], 0, y0 + i, x0:]
            for j in range(image.shape[1]):
                here[j] = there[j]
        p, Q, vel, omega = positions[k].copy(), rotations[k].copy(), velocities[k], omegas[k]
        other, other_g = others[k], other_gs[k]
        seen = False
        away[:] = 0.0
        for _ in range(steps):
            mark_equations(image, x0, y0, optics, faces, p, Q, vel, omega, _NO_PLACES, bench, Hk, g, place, stats)
            seen = Hk[0, 0] > 0.0
            if not seen:
                break
            for i in range(6):
                y[i] = g[i] / factor + other_g[i]
                for j in range(6):
                    Hk[i, j] /= factor
                    A[i, j] = Hk[i, j] + other[i, j]
                    y[i] -= other[i, j] * away[j]
            for i in range(6):
                # Columns of metres and of radians: the pivots are judged relative to their own diagonal.
                A[i, i] *= 1.0 + 1e-12
            seen = _solve(A, _POSE, y, step)
            if not seen:
                break
            gained = 0.0
            for i in range(6):
                gained += step[i] * y[i]
                step[i] *= OVERSTEP
                away[i] += step[i]
            for i in range(3):
                p[i] += step[i]
            Q = _turned(Q, step[3:])
            # A third of a sigma moved: the next step would be a tenth of that.
            if gained < 0.1 or _moved_px(K, Rcw, tcw, p, step, reach) < SETTLED_PX:
                break
        for i in range(6):
            for j in range(6):
                H[k, i, j] = Hk[i, j] if seen else 0.0
        if seen:
            for i in range(3):
                positions[k, i] = p[i]
                for j in range(3):
                    rotations[k, i, j] = Q[i, j]


@_free
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
