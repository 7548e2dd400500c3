"""tracking.surface_marks.texture_blur."""

from __future__ import annotations

from math import floor, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory, inner_nogil
from .kernel_types import FIRST, STENCIL_BLUR


@inner_no_memory
def _weights_along(s: float) -> tuple[float, float, float, float]:
    """Of the four coefficients about a place, which lies `s` behind the second of them."""
    b0, b1, b3 = (1.0 - s) ** 3 / 6.0, 2.0 / 3.0 - s * s * (1.0 - 0.5 * s), s * s * s / 6.0
    return b0, b1, 1.0 - b0 - b1 - b3, b3


@inner_no_memory
def spline_with_slopes(coef: Any, x: float, y: float) -> tuple[float, float, float]:
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


@inner_no_memory
def spline_value(coef: Any, x: float, y: float) -> float:
    """Its value alone."""
    j, i = floor(x), floor(y)
    bx, by = _weights_along(x - j), _weights_along(y - i)
    v = 0.0
    for k in range(4):
        row = coef[i - 1 + k]
        v += by[k] * (row[j - 1] * bx[0] + row[j] * bx[1] + row[j + 1] * bx[2] + row[j + 2] * bx[3])
    return v


@inner_no_memory
def spline_bend(coef: Any, x: float, y: float) -> float:
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


@inner_nogil
def blur_on_face(
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


@inner_no_memory
def _largest(more: Any) -> float:
    """Size of the largest of variances xx, xy, yy."""
    return abs(0.5 * (more[0] + more[2])) + sqrt(0.25 * (more[0] - more[2]) ** 2 + more[1] * more[1])


@inner_no_memory
def extra_blur(lens: Any, motion: Any, blur_px: float, base: Any, texel: float, more: Any) -> float:
    """By how much more a face is blurred on a frame than its texture, as variances xx, xy, yy in `more` (3,) [texel²]; returns
    the size of the largest. `base` (2, 3) is the blur of the texture, of the lens for one pixel and of motion."""
    iv = 1.0 / (texel * texel)
    s = blur_px * blur_px
    for k in range(3):
        more[k] = (s * (lens[k] - base[0, k]) + motion[k] - base[1, k]) * iv
    return _largest(more)


@inner_no_memory
def soften(texture: Any, more: Any, room: Any) -> int:
    """Blur a surface (n, n), its values on a grid or the coefficients of its spline, by variances `more` (3,) xx, xy, yy
    [texel²]; which of the two in `room` (2, n, n) it then is. Less blur than a texture has is the same difference taken away,
    once: more turns would sharpen its noise."""
    apart, left, k = 1, _largest(more), FIRST
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


@inner_no_memory
def _blur_again(texture: Any, turn_number: int, more: Any, unit: float, apart: int, room: Any) -> None:
    """The surface after so many turns, blurred once more: from one place in `room` (2, n, n) to the other."""
    if turn_number == 0:
        _blur_once(texture, more, unit, apart, room[0])
    else:
        _blur_once(room[(turn_number - 1) % 2], more, unit, apart, room[turn_number % 2])


@inner_fast_sums_no_memory
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
