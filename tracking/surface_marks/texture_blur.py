"""Textures as cubic B-spline surfaces: their values, slopes and curvature, and their blur.

A texture is as blurred as the mean of the frames that it was learned from. A frame is compared with the texture at
the frame's own blur: the difference of the two, a 2 × 2 covariance on the face, is added by passes of a 3 × 3
stencil. A face seen aslant is blurred more along its short side, which makes a round mark look longer there; at a
lens blur of half a pixel this alone turned dice by 0.2 degrees.
"""

from __future__ import annotations

from math import floor, sqrt
from typing import Any

import numpy as np

from ...model.compiled import inner_fast_sums_no_memory, inner_no_memory, inner_nogil
from ..picture import defocus_variance
from .kernel_types import STENCIL_BLUR_TEXEL2, ZERO, Optics


@inner_no_memory
def _weights_along(s: float) -> tuple[float, float, float, float]:
    """Weights of the four coefficients about a point that lies `s` (0 to 1) beyond the second of them."""
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
def spline_laplacian(coef: Any, x: float, y: float) -> float:
    """Sum of the second derivatives by x and by y [1/texel²] of a cubic B-spline surface."""
    j, i = floor(x), floor(y)
    s, t = x - j, y - i
    bx, by = _weights_along(s), _weights_along(t)
    curvature = (1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t)
    v = 0.0
    for k in range(4):
        row = coef[i - 1 + k]
        c0, c1, c2, c3 = row[j - 1], row[j], row[j + 1], row[j + 2]
        v += by[k] * ((1.0 - s) * (c0 - 2.0 * c1 + c2) + s * (c1 - 2.0 * c2 + c3))
        v += curvature[k] * (c0 * bx[0] + c1 * bx[1] + c2 * bx[2] + c3 * bx[3])
    return v


@inner_nogil
def blur_on_face(
    optics: Optics, E: Any, origin: Any, offset: float, velocity: Any, omega: Any, lens: Any, motion: Any
) -> None:
    """Fill the blur of a face in face coordinates, as variances aa, ab, bb: `lens` (3,) [m²] for a lens blur of one
    pixel, and `motion` (3,) [m²] for motion and defocus.

    The lens blurs equally in all directions of the picture, so on the face it blurs most along the foreshortened
    direction. Motion during the exposure is a uniform distribution: its variance is the squared length of the path
    over twelve.
    """
    K, Rcw, exposure = optics.matrix, optics.rotation, optics.exposure
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
                q[i] += Rcw[i, j] * velocity[j]
                w[i] += Rcw[i, j] * omega[j]
        q[0] += offset * (w[1] * E[2, 2] - w[2] * E[2, 1])
        q[1] += offset * (w[2] * E[2, 0] - w[0] * E[2, 2])
        q[2] += offset * (w[0] * E[2, 1] - w[1] * E[2, 0])
        slip = (E[2, 0] * q[0] + E[2, 1] * q[1] + E[2, 2] * q[2]) / (E[2, 0] * x + E[2, 1] * y + E[2, 2])
        ma = exposure * (E[0, 0] * (slip * x - q[0]) + E[0, 1] * (slip * y - q[1]) + E[0, 2] * (slip - q[2]))
        mb = exposure * (E[1, 0] * (slip * x - q[0]) + E[1, 1] * (slip * y - q[1]) + E[1, 2] * (slip - q[2]))
        motion[0], motion[1], motion[2] = ma * ma / 12.0, ma * mb / 12.0, mb * mb / 12.0
    if optics.aperture > 0.0:
        defocus = defocus_variance(optics.aperture, optics.focus, K[0, 0], origin[2])
        for k in range(3):
            motion[k] += defocus * lens[k]


@inner_no_memory
def _largest_eigenvalue(blur: Any) -> float:
    """Magnitude of the largest eigenvalue of the covariance xx, xy, yy."""
    return abs(0.5 * (blur[0] + blur[2])) + sqrt(0.25 * (blur[0] - blur[2]) ** 2 + blur[1] * blur[1])


@inner_no_memory
def relative_blur(lens: Any, motion: Any, blur_px: float, texture_blur: Any, texel: float, relative: Any) -> float:
    """Fill `relative` (3,), the covariance xx, xy, yy [texel²] of a frame's blur minus that of the texture; return
    the magnitude of its largest eigenvalue. `texture_blur` (2, 3) is the texture's, of the lens at one pixel and of
    motion."""
    iv = 1.0 / (texel * texel)
    s = blur_px * blur_px
    for k in range(3):
        relative[k] = (s * (lens[k] - texture_blur[0, k]) + motion[k] - texture_blur[1, k]) * iv
    return _largest_eigenvalue(relative)


@inner_no_memory
def blur_texture(texture: Any, blur: Any, scratch: Any) -> int:
    """Blur a surface (n, n), values on a grid or coefficients of its spline, by the covariance `blur` (3,) xx, xy, yy
    [texel²].

    Returns the index of the result in `scratch` (2, n, n). A negative blur is the same stencil subtracted, in one
    pass: more passes would amplify the texture's noise.
    """
    spacing, remaining, k = 1, _largest_eigenvalue(blur), ZERO
    if remaining == 0.0:
        # A face that was learned on one frame has the blur of that frame.
        for i in range(texture.shape[0]):
            for j in range(texture.shape[1]):
                scratch[0, i, j] = texture[i, j]
        return ZERO
    whole, positive = remaining, blur[0] + blur[2] > 0.0
    while positive and remaining > STENCIL_BLUR_TEXEL2 * spacing * spacing:
        _blur_again(texture, k, blur, 1.0 / (3.0 * whole), spacing, scratch)
        remaining -= spacing * spacing / 3.0
        spacing *= 2
        k += 1
    passes = max(int(3.0 * remaining / (spacing * spacing) + 0.5), 1) if positive else 1
    for _ in range(passes):
        _blur_again(texture, k, blur, remaining / (whole * passes * spacing * spacing), spacing, scratch)
        k += 1
    return (k - 1) % 2


@inner_no_memory
def _blur_again(texture: Any, passes: int, blur: Any, unit: float, spacing: int, scratch: Any) -> None:
    """One more pass after `passes` of them, from one array of `scratch` (2, n, n) to the other."""
    if passes == 0:
        _blur_once(texture, blur, unit, spacing, scratch[0])
    else:
        _blur_once(scratch[(passes - 1) % 2], blur, unit, spacing, scratch[passes % 2])


@inner_fast_sums_no_memory
def _blur_once(texture: Any, blur: Any, unit: float, spacing: int, out: Any) -> None:
    """Add half of `unit` times the covariance times the second differences over `spacing` texels; the border stays."""
    n = texture.shape[0]
    xx, xy, yy = 0.5 * unit * blur[0], 0.25 * unit * blur[1], 0.5 * unit * blur[2]
    middle, inside, far = 1.0 - 2.0 * (xx + yy), n - 2 * spacing, 2 * spacing
    for i in range(n):
        here, blurred = texture[i], out[i]
        for j in range(n):
            blurred[j] = here[j]
        if i < spacing or i >= n - spacing:
            continue
        # Slices instead of offsets: an index that might be negative prevents the compiler from vectorising the loop.
        left, centre, right = here[:inside], here[spacing : n - spacing], here[far:]
        above, below = texture[i - spacing], texture[i + spacing]
        a, b, c = above[:inside], above[spacing : n - spacing], above[far:]
        d, e, f = below[:inside], below[spacing : n - spacing], below[far:]
        new = blurred[spacing : n - spacing]
        for j in range(inside):
            across, along = left[j] + right[j], b[j] + e[j]
            new[j] = middle * centre[j] + xx * across + yy * along + xy * (a[j] - c[j] - d[j] + f[j])
